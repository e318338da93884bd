// Muscle pressure: ratiometric sensor, five conversions averaged per control step.
#ifndef THIGMO_CORE_SENSING_PRESSURE_H_
#define THIGMO_CORE_SENSING_PRESSURE_H_

#include <stdint.h>

#include "../board.h"
#include "../config/derived.h"
#include "../control/fixed_point.h"
#include "../safety/leaky_count.h"

namespace thigmo {

class PressureReading {
 public:
  // A reading outside 5..95 % of the supply means a broken wire (docs/hardware/facts.md).
  static constexpr uint16_t kWireLow = 51;
  static constexpr uint16_t kWireHigh = 973;
  static constexpr uint8_t kWireLimit = 3;   // conversions
  static constexpr uint8_t kWireMemory = 4;  // a wire that is broken for a fifth of the time

  void add(uint16_t count) {
    sum_ = static_cast<uint16_t>(sum_ + count);
    ++taken_;
    // One comparison for both ends of the band.
    const bool bad = static_cast<uint16_t>(count - kWireLow) > kWireHigh - kWireLow;
    wire_.add(bad, kWireLimit);
    if (bad) bad_taken_ = true;
  }

  // Averages what was taken since the last call into cpsi(): five conversions, or some other number
  // after a lost frame, which alone costs a division. Half a count is added for the converter's
  // floor; gain is for the sum of five.
  void update(int32_t zero_q6, const Gain16& gain_of_five) {
    if (taken_ == 0) return;
    int32_t sum_q6 = static_cast<int32_t>(sum_) * 64;
    if (taken_ != 5) sum_q6 = sum_q6 * 5 / taken_;
    cpsi_ = saturated16(gain_of_five.apply(sum_q6 + (32 - zero_q6) * 5));
    sum_ = 0;
    taken_ = 0;
    doubtful_ = bad_taken_;
    bad_taken_ = false;
  }

  int16_t cpsi() const { return cpsi_; }
  bool wire_broken() const { return wire_.full(kWireLimit); }
  // Some of cpsi()'s conversions were of a broken wire: they say nothing of the pressure.
  bool doubtful() const { return doubtful_; }

 private:
  uint16_t sum_ = 0;
  int16_t cpsi_ = 0;
  uint8_t taken_ = 0;
  LeakyCount<uint8_t, kWireMemory> wire_;
  bool bad_taken_ = false;
  bool doubtful_ = false;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_SENSING_PRESSURE_H_
