// Counts of a converter that is finer than the core's, without losing what is finer.
//
// Sums, limits and the wire are made of counts of kAdcBits. The binding of a converter with more
// bits passes its frames through this class. What a count loses is carried to the channel's next
// one, so that a sum of conversions errs by less than one count however many it holds.
#ifndef THIGMO_CORE_SENSING_NARROWING_H_
#define THIGMO_CORE_SENSING_NARROWING_H_

#include <stdint.h>

#include "../board.h"
#include "../control/fixed_point.h"

namespace thigmo {

class Narrowing {
 public:
  // Of a converter of so many bits, kAdcBits..16: a count is floor(2^bits * voltage / reference).
  explicit Narrowing(uint8_t bits) : extra_(static_cast<uint8_t>(bits - kAdcBits)) {}

  // Narrows a frame's counts in place.
  void apply(AdcFrame* frame) {
    if (extra_ == 0) return;
    const bool odd = (frame->tick & 1) != 0;
    for (uint8_t slot = 0; slot < kAdcSlots; ++slot) {
      int32_t* const carry = &carry_[adc_channel(odd, slot)];
      // In halves of the finer count. A floor loses half a count on average. The core gives half of
      // its own back (flex.h, pressure.h), so the loss must be that, not the finer one.
      const int32_t due = *carry + 2 * frame->count[slot] + 1 - (int32_t{1} << extra_);
      const int32_t count = limited<int32_t>(due >> (extra_ + 1), 0, kAdcTop);
      const int32_t most = int32_t{2} << extra_;  // at the ends of the range
      *carry = limited<int32_t>(due - (count << (extra_ + 1)), -most, most);
      frame->count[slot] = static_cast<uint16_t>(count);
    }
  }

 private:
  uint8_t extra_;
  int32_t carry_[kPressureChannel + kMuscles] = {};  // of each channel
};

}  // namespace thigmo

#endif  // THIGMO_CORE_SENSING_NARROWING_H_
