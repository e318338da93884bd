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

// Where a pressure lies between a map's supports. `supports_per_cpsi_q22` is Derived's: a support's
// place is met to 1/1000 of the way to the next.
struct MapPlace {
  uint8_t index;
  uint16_t share_q14;  // of the way to the next support

  MapPlace(int16_t cpsi, uint16_t supports_per_cpsi_q22) : index(0), share_q14(0) {
    if (cpsi <= 0) return;
    const uint32_t place_q14 =
        static_cast<uint32_t>(static_cast<uint16_t>(cpsi)) * supports_per_cpsi_q22 >> 8;
    index = static_cast<uint8_t>(place_q14 << 2 >> 16);
    if (index >= protocol::kMapPoints - 1) {
      index = protocol::kMapPoints - 1;
      return;
    }
    share_q14 = static_cast<uint16_t>(place_q14) & 0x3FFF;
  }
};

// A map at a place, linear between its supports, held beyond them. 1e-5/cm.
inline int16_t map_at(const int16_t* map, const MapPlace& place) {
  const int16_t below = map[place.index];
  if (place.share_q14 == 0) return below;
  const int32_t rise = static_cast<int32_t>(map[place.index + 1]) - below;
  // The way may exceed 16 bits, but not its sum with `below`: what is carried away is never missed.
  const uint32_t way_q14 = static_cast<uint32_t>(rise * place.share_q14 + 0x2000);
  return static_cast<int16_t>(static_cast<uint16_t>(below) +
                              static_cast<uint16_t>((way_q14 << 2) >> 16));
}

// One muscle's lag filter and play operator; update() once each control step.
class MuscleState {
 public:
  void update(int16_t measured_cpsi, uint16_t lag_alpha_q16, int16_t reversal_cpsi,
              uint32_t reversal_inverse_q24) {
    const int32_t input = q12(measured_cpsi);
    if (!started_) {
      started_ = true;
      lagged_q12_ = input;
      floor_ = measured_cpsi;
    }
    lagged_q12_ += share_q16(input - lagged_q12_, lag_alpha_q16);
    lagged_cpsi_ = shifted16<12>(lagged_q12_ + 0x800);
    const int16_t lagged = lagged_cpsi_;
    // Play: the floor trails a rising pressure by the width and is pushed down by a falling one.
    if (lagged < floor_) floor_ = lagged;
    if (static_cast<int32_t>(lagged) - floor_ > reversal_cpsi) {
      floor_ = static_cast<int16_t>(lagged - reversal_cpsi);
    }
    inflating_q8_ = static_cast<uint16_t>(
        (static_cast<uint16_t>(lagged - floor_) * reversal_inverse_q24) >> 16);
  }

  int16_t lagged_cpsi() const { return lagged_cpsi_; }
  protocol::Branch branch() const {
    return inflating_q8_ >= 128 ? protocol::Branch::kInflate : protocol::Branch::kDeflate;
  }

  // Free curvature by a muscle's two maps.
  int16_t free_e5(const int16_t maps[kBranches][protocol::kMapPoints],
                  uint16_t supports_per_cpsi_q22) const {
    const MapPlace place(lagged_cpsi(), supports_per_cpsi_q22);
    const int32_t up = map_at(maps[0], place);
    const int32_t down = map_at(maps[1], place);
    return static_cast<int16_t>(down + ((up - down) * inflating_q8_ >> 8));
  }

 private:
  int32_t lagged_q12_ = 0;
  int16_t lagged_cpsi_ = 0;
  int16_t floor_ = 0;
  uint16_t inflating_q8_ = 0;  // 256 = the inflate map alone
  bool started_ = false;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_SENSING_FREE_CURVATURE_H_
