// The sweep: half a sine of pressure on one muscle after the other.
//
// It runs on the board because its peak decides when the ten readings are taken. A muscle whose
// amplitude is 0 is left out, with its half of the time.
#ifndef THIGMO_CORE_CONTROL_SWEEP_H_
#define THIGMO_CORE_CONTROL_SWEEP_H_

#include <stdint.h>

#include "../board.h"
#include "fixed_point.h"

namespace thigmo {

class Sweep {
 public:
  // At least one amplitude is above zero.
  void start(const int16_t* amplitude_cpsi, uint32_t period_ms, uint8_t cycles, uint32_t tick) {
    for (uint8_t i = 0; i < kMuscles; ++i) amplitude_[i] = amplitude_cpsi[i];
    half_ms_ = period_ms / 2;
    phase_per_ms_ = 0xFFFFFFFFu / period_ms;
    cycles_left_ = cycles;
    muscle_ = kMuscles - 1;
    next();
    begun_ = tick;
    fresh_ = true;
  }

  // Moves on to this tick; false when the last half is over.
  bool advance(uint32_t tick) {
    fresh_ = false;
    if (tick - begun_ < half_ms_) return true;
    begun_ += half_ms_;
    if (next() && --cycles_left_ == 0) return false;
    fresh_ = true;
    return true;
  }

  uint8_t muscle() const { return muscle_; }
  bool half_began() const { return fresh_; }  // at the last advance() or start()
  uint32_t peak_tick() const { return begun_ + half_ms_ / 2; }

  // Set point of the active muscle.
  int16_t set_cpsi(uint32_t tick) const {
    const uint32_t phase = (tick - begun_) * phase_per_ms_;
    return static_cast<int16_t>(
        static_cast<int32_t>(amplitude_[muscle_]) * static_cast<int32_t>(half_sine(phase)) >> 15);
  }

 private:
  // Turns to the next muscle; whether a round is over.
  bool next() {
    bool over = false;
    do {
      over = over || muscle_ == kMuscles - 1;
      muscle_ = static_cast<uint8_t>(muscle_ == kMuscles - 1 ? 0 : muscle_ + 1);
    } while (amplitude_[muscle_] <= 0);
    return over;
  }

  uint32_t half_ms_ = 0;
  uint32_t phase_per_ms_ = 0;  // 2^32 = a whole period
  uint32_t begun_ = 0;         // tick at which the running half began
  int16_t amplitude_[kMuscles] = {};
  uint8_t cycles_left_ = 0;
  uint8_t muscle_ = 0;
  bool fresh_ = false;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_CONTROL_SWEEP_H_
