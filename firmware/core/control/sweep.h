// The sweep: half a sine of pressure on the left muscle, then half a sine on the right.
//
// It runs on the board because its peak decides when the ten readings are taken. A side whose
// amplitude is 0 is left out, with its half of the time.
#ifndef THIGMO_CORE_CONTROL_SWEEP_H_
#define THIGMO_CORE_CONTROL_SWEEP_H_

#include <stdint.h>

#include "../board.h"
#include "fixed_point.h"

namespace thigmo {

class Sweep {
 public:
  void start(int16_t left_cpsi, int16_t right_cpsi, uint32_t period_ms, uint8_t cycles,
             uint32_t tick) {
    amplitude_[0] = left_cpsi;
    amplitude_[1] = right_cpsi;
    half_ms_ = period_ms / 2;
    phase_per_ms_ = 0xFFFFFFFFu / period_ms;
    cycles_left_ = cycles;
    side_ = left_cpsi > 0 ? 0 : 1;
    begun_ = tick;
    fresh_ = true;
  }

  // Moves on to this tick; false when the last half is over.
  bool advance(uint32_t tick) {
    fresh_ = false;
    if (tick - begun_ < half_ms_) return true;
    begun_ += half_ms_;
    const bool both = amplitude_[0] > 0 && amplitude_[1] > 0;
    if (side_ == 1 || !both) {
      if (--cycles_left_ == 0) return false;
    }
    if (both) side_ ^= 1;
    fresh_ = true;
    return true;
  }

  uint8_t side() const { return side_; }
  bool half_began() const { return fresh_; }  // at the last advance() or start()
  uint32_t peak_tick() const { return begun_ + half_ms_ / 2; }

  // Set point of the active side.
  int16_t set_cpsi(uint32_t tick) const {
    const uint32_t phase = (tick - begun_) * phase_per_ms_;
    return static_cast<int16_t>(
        static_cast<int32_t>(amplitude_[side_]) * static_cast<int32_t>(half_sine(phase)) >> 15);
  }

 private:
  uint32_t half_ms_ = 0;
  uint32_t phase_per_ms_ = 0;  // 2^32 = a whole period
  uint32_t begun_ = 0;         // tick at which the running half began
  int16_t amplitude_[kSides] = {};
  uint8_t cycles_left_ = 0;
  uint8_t side_ = 0;
  bool fresh_ = false;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_CONTROL_SWEEP_H_
