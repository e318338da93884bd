// Muscle pressure: ratiometric sensor, five conversions averaged per control step.
#ifndef THIGMO_CORE_SENSING_PRESSURE_H_
#define THIGMO_CORE_SENSING_PRESSURE_H_

#include <stdint.h>

#include "../board.h"
#include "../config/derived.h"
#include "../control/fixed_point.h"

namespace thigmo {

class PressureReading {
 public:
  // A reading outside 5..95 % of the supply means a broken wire (docs/hardware/facts.md).
  static constexpr uint16_t kWireLow = 51;
  static constexpr uint16_t kWireHigh = 973;
  static constexpr uint8_t kWireRun = 3;

  void add(uint16_t count) {
    sum_ = static_cast<uint16_t>(sum_ + count);
    ++taken_;
    if (count >= kWireLow && count <= kWireHigh) {
      wire_run_ = 0;
    } else if (wire_run_ < kWireRun) {
      ++wire_run_;
    }
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
  }

  int16_t cpsi() const { return cpsi_; }
  bool wire_broken() const { return wire_run_ >= kWireRun; }
  bool wire_doubtful() const { return wire_run_ > 0; }

 private:
  uint16_t sum_ = 0;
  int16_t cpsi_ = 0;
  uint8_t taken_ = 0;
  uint8_t wire_run_ = 0;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_SENSING_PRESSURE_H_
