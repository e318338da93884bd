// Free curvature g(p): what the body bends without any touch, from the calibrated maps.
//
// A muscle has a map for rising and one for falling pressure (hysteresis is about 10 % of g). Which
// holds is decided by a play operator on the pressure: after a reversal the share of the inflate
// map runs from 1 to 0 (or back) over `reversal_cpsi`. The pressure is first filtered by the
// calibrated lag from measured pressure to bend: without that, a sweep of 20 s would err by more
// than half the trigger's threshold.
#ifndef THIGMO_CORE_SENSING_FREE_CURVATURE_H_
#define THIGMO_CORE_SENSING_FREE_CURVATURE_H_

#include <stdint.h>

#include "../config/configuration.h"
#include "../control/fixed_point.h"

namespace thigmo {

// A map at a pressure, linear between its supports, held beyond them. 1e-5/cm.
inline int16_t map_at(const int16_t* map, int16_t cpsi) {
  if (cpsi <= 0) return map[0];
  const uint16_t index = static_cast<uint16_t>(cpsi) / protocol::kMapStepCpsi;
  if (index >= protocol::kMapPoints - 1) return map[protocol::kMapPoints - 1];
  const int32_t above = cpsi - static_cast<int16_t>(index * protocol::kMapStepCpsi);
  const int32_t rise = static_cast<int32_t>(map[index + 1]) - map[index];
  return static_cast<int16_t>(map[index] + rise * above / protocol::kMapStepCpsi);
}

// One muscle's lag filter and play operator; update() once each control step.
class MuscleState {
 public:
  void update(int16_t measured_cpsi, int32_t lag_alpha_q16, int32_t reversal_cpsi) {
    const int32_t input = static_cast<int32_t>(measured_cpsi) * 65536;
    if (!started_) {
      started_ = true;
      lagged_q16_ = input;
      floor_ = measured_cpsi;
    }
    // Both are within +-2^31 apart only if halved: pressures of 15 bits in 1/65536 fill an i32.
    const int64_t step = static_cast<int64_t>(input) - lagged_q16_;
    lagged_q16_ += static_cast<int32_t>((step * lag_alpha_q16) >> 16);
    const int16_t lagged = lagged_cpsi();
    // Play: the floor trails a rising pressure by the width and is pushed down by a falling one.
    if (lagged < floor_) floor_ = lagged;
    const int16_t width = static_cast<int16_t>(reversal_cpsi);
    if (static_cast<int32_t>(lagged) - floor_ > width) {
      floor_ = static_cast<int16_t>(lagged - width);
    }
    inflating_q8_ =
        static_cast<uint16_t>((static_cast<uint32_t>(static_cast<uint16_t>(lagged - floor_)) << 8) /
                              static_cast<uint16_t>(width));
  }

  int16_t lagged_cpsi() const { return static_cast<int16_t>((lagged_q16_ + 0x8000) >> 16); }
  uint16_t inflating_q8() const { return inflating_q8_; }  // 256 = the inflate map alone
  protocol::Branch branch() const {
    return inflating_q8_ >= 128 ? protocol::Branch::kInflate : protocol::Branch::kDeflate;
  }

  // Free curvature by a muscle's two maps.
  int16_t free_e5(const int16_t maps[kBranches][protocol::kMapPoints]) const {
    const int16_t cpsi = lagged_cpsi();
    const int32_t up = map_at(maps[0], cpsi);
    const int32_t down = map_at(maps[1], cpsi);
    return static_cast<int16_t>(down + ((up - down) * inflating_q8_ >> 8));
  }

 private:
  int32_t lagged_q16_ = 0;
  int16_t floor_ = 0;
  uint16_t inflating_q8_ = 0;
  bool started_ = false;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_SENSING_FREE_CURVATURE_H_
