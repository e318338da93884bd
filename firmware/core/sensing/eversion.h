// Which sensors have everted, since when, and whether one lies in the tip's fold.
//
// The tip's fold is at the everted length. A sensor that lies in it, with a margin on both ends, is
// half everted: a bend would crease it, so bending is refused. A sensor that has just left the fold
// still decays to rest, so its settle clock starts then and its zero is void.
#ifndef THIGMO_CORE_SENSING_EVERSION_H_
#define THIGMO_CORE_SENSING_EVERSION_H_

#include <stdint.h>

#include "../config/configuration.h"
#include "../control/fixed_point.h"

namespace thigmo {

class Eversion {
 public:
  // An encoder that trembles by a count must not make a sensor evert again and again.
  static constexpr int32_t kHysteresisUm = 500;
  // No tip moves so far in a control step; a length that was confirmed may.
  static constexpr int32_t kStepUm = 2000;

  // Takes the everted length; returns the mask of sensors that have just everted. While the tip
  // moves, half of the sensors are looked at in a call, and the other half in the next.
  uint16_t update(bool length_known, int32_t length_um, uint32_t tick, const Configuration& c,
                  uint16_t enabled_mask) {
    if (!length_known) {
      half_mask_ = 0;
      moved_ = true;
      return 0;
    }
    uint16_t fresh = 0;
    const bool jumped = moved_ || magnitude(length_um - length_um_) > kStepUm;
    if (length_um != length_um_) unseen_halves_ = 2;
    length_um_ = length_um;
    if (jumped) {
      moved_ = false;
      unseen_halves_ = 0;
      fresh = look(0, kSensors, tick, c, enabled_mask);
    } else if (unseen_halves_ != 0) {
      --unseen_halves_;
      second_half_ = !second_half_;
      fresh = second_half_ ? look(kSensors / 2, kSensors, tick, c, enabled_mask)
                           : look(0, kSensors / 2, tick, c, enabled_mask);
    }
    const uint32_t settle = static_cast<uint32_t>(c.get(Param::kSettleMs));
    uint16_t waiting = static_cast<uint16_t>(everted_mask_ & ~settled_mask_);
    for (uint8_t i = 0; waiting != 0; ++i, waiting = static_cast<uint16_t>(waiting >> 1)) {
      if ((waiting & 1) != 0 && tick - everted_tick_[i] >= settle) {
        settled_mask_ = static_cast<uint16_t>(settled_mask_ | (1u << i));
      }
    }
    return fresh;
  }

  // Sensors were moved or switched by a change of the configuration.
  void reconsider() { moved_ = true; }

  // The operator vouches for the length: whatever everted, did so long ago, or counts from now.
  void confirm(bool settled, uint32_t tick) {
    settled_mask_ = settled ? everted_mask_ : 0;
    if (settled) return;
    for (uint8_t i = 0; i < kSensors; ++i) everted_tick_[i] = tick;
  }

  uint16_t everted_mask() const { return everted_mask_; }
  uint16_t settled_mask() const { return settled_mask_; }
  uint16_t half_mask() const { return half_mask_; }
  uint32_t everted_tick(uint8_t sensor) const { return everted_tick_[sensor]; }

  uint32_t settle_left_ms(uint8_t sensor, uint32_t tick, uint32_t settle_ms) const {
    if ((settled_mask_ >> sensor & 1) != 0) return 0;
    if ((everted_mask_ >> sensor & 1) == 0) return settle_ms;
    const uint32_t age = tick - everted_tick_[sensor];
    return age < settle_ms ? settle_ms - age : 0;
  }

 private:
  // Finds the place of sensors relative to the fold: needed only when the tip has moved.
  uint16_t look(uint8_t first, uint8_t end, uint32_t tick, const Configuration& c,
                uint16_t enabled_mask) {
    uint16_t fresh = 0;
    const int32_t margin = c.get(Param::kFoldMarginUm);
    // A body that does not grow is out at its full length.
    const int32_t length_um = c.get(Param::kGrows) != 0 ? length_um_ : INT32_MAX;
    uint16_t bit = static_cast<uint16_t>(1u << first);
    for (uint8_t i = first; i < end; ++i, bit = static_cast<uint16_t>(bit << 1)) {
      half_mask_ = static_cast<uint16_t>(half_mask_ & ~bit);
      const int32_t center = c.get(Param::kFlexCenterUm, i);
      const int32_t reach = (c.get(Param::kFlexSpanUm, i) >> 1) + margin;
      if (length_um >= center + reach) {
        if ((everted_mask_ & bit) == 0) {
          fresh = static_cast<uint16_t>(fresh | bit);
          everted_tick_[i] = tick;
        }
      } else if ((everted_mask_ & bit) == 0 || length_um_ < center + reach - kHysteresisUm) {
        everted_mask_ = static_cast<uint16_t>(everted_mask_ & ~bit);
        settled_mask_ = static_cast<uint16_t>(settled_mask_ & ~bit);
        if (length_um > center - reach && (enabled_mask & bit) != 0) {
          half_mask_ = static_cast<uint16_t>(half_mask_ | bit);
        }
      }
    }
    everted_mask_ = static_cast<uint16_t>(everted_mask_ | fresh);
    settled_mask_ = static_cast<uint16_t>(settled_mask_ & ~fresh);
    return fresh;
  }

  uint32_t everted_tick_[kSensors] = {};
  int32_t length_um_ = 0;
  uint16_t everted_mask_ = 0;
  uint16_t settled_mask_ = 0;
  uint16_t half_mask_ = 0;
  uint8_t unseen_halves_ = 0;  // of the sensors, since the length changed
  bool second_half_ = false;   // was looked at last
  bool moved_ = true;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_SENSING_EVERSION_H_
