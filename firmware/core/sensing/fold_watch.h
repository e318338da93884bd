// What a growing body's own sensors say of its length: the tip's fold bends each as it passes.
//
// A sensor in the tail rests. While the fold passes, its reading swings out and back, and is
// furthest out when its centre is in the fold. How far a sensor swings is not needed, only that it
// does. Where the encoder then is, less the sensor's centre, is its lag. Sensors are judged in
// pairs, in the order in which they pass, for one may be bad: two that agree by their mean, others
// by the one that accuses less. The encoder loses counts if a pair
//
// - lags by less than places and the confirmed length may be off, or
// - lags by less than the pair before it, beyond what places are in doubt: between the two the body
//   grew more than was counted. How far apart the two of a pair pass shows that doubt.
//
// While a reading still swings out the tip moves: the body then pulls at the tail.
#ifndef THIGMO_CORE_SENSING_FOLD_WATCH_H_
#define THIGMO_CORE_SENSING_FOLD_WATCH_H_

#include <stdint.h>

#include "flex.h"

namespace thigmo {

class FoldWatch {
 public:
  static constexpr int32_t kSwingE5 = 5000;  // 0.05/cm: more than a sensor in the tail is bent
  // A top is noticed some 0.7 cm behind the centre, once an eighth of the swing is gone. Places of
  // sensors and the confirmed length may be off by 1.1 cm.
  static constexpr int32_t kEarlyUm = 4000;
  // Between two pairs only the sensors' places are in doubt: by the largest spread of a pair so
  // far.
  static constexpr int32_t kApartUm = 4000;
  static constexpr int32_t kApartSpreads = 3;
  static constexpr int32_t kAgreeUm = 10000;  // lags of a pair
  // A swing that grows by so much, more than noise, is of a tip that moved within the last looks.
  static constexpr int32_t kRiseE5 = 200;
  static constexpr uint8_t kMovesSteps = 30;

  // Growth begins from here. A sensor whose near end lies in the fold already still swings enough.
  void begin(int32_t length_um, uint16_t enabled, const Configuration& c) {
    watched_ = 0;
    for (uint8_t i = 0; i < kSensors; ++i) {
      const bool ahead = length_um < c.get(Param::kFlexCenterUm, i) - 2 * kEarlyUm;
      if (ahead) watched_ = static_cast<uint16_t>(watched_ | (enabled & 1u << i));
    }
    unseen_ = watched_;
    next_ = moves_ = 0;
  }

  // Forgets what earlier growth felt: when the spool winds in, and when a length is confirmed.
  void restart() {
    waits_ = false;
    before_um_ = -kEarlyUm;
    spread_um_ = 0;
  }

  // Looks at one sensor, in turn. True when a pair has passed the tip too early.
  bool step(const FlexReadings& flex, int32_t length_um, const Configuration& c, const Derived& d) {
    if (moves_ != 0) --moves_;
    const uint8_t i = next_;
    next_ = static_cast<uint8_t>(next_ + 1 == kSensors ? 0 : next_ + 1);
    const uint16_t bit = static_cast<uint16_t>(1u << i);
    if ((watched_ & bit) == 0) return false;
    const int32_t total = total_ohm_q4(count_q6(flex.latest(i), flex.log2()));
    if ((unseen_ & bit) != 0) {
      unseen_ = static_cast<uint16_t>(unseen_ & ~bit);
      rest_[i] = total;
      top_e5_[i] = 0;
      return false;
    }
    const int32_t swing = magnitude(curvature_e5(total, rest_[i], d.flex_gain_q16[i]));
    if (swing > top_e5_[i] + kRiseE5) {
      top_e5_[i] = saturated16(swing);
      moves_ = kMovesSteps;
      return false;
    }
    if (top_e5_[i] < kSwingE5 || swing > top_e5_[i] - (top_e5_[i] >> 3)) return false;
    watched_ = static_cast<uint16_t>(watched_ & ~bit);
    return judge(length_um - c.get(Param::kFlexCenterUm, i));
  }

  // Whether a sensor in the fold shows that the tip moves.
  bool moves() const { return moves_ != 0; }

 private:
  bool judge(int32_t lag_um) {
    waits_ = !waits_;
    if (waits_) {
      first_um_ = lag_um;
      return false;
    }
    const int32_t most = greater(first_um_, lag_um);
    const int32_t least = lesser(first_um_, lag_um);
    const bool agree = most - least < kAgreeUm;
    const int32_t mean = least + (most - least) / 2;
    spread_um_ = greater(spread_um_, most - least);
    const int32_t doubt = kApartUm + kApartSpreads * spread_um_;
    if ((agree ? mean : most) < greater(-kEarlyUm, before_um_ - doubt)) return true;
    before_um_ = agree ? mean : least;
    return false;
  }

  int32_t first_um_ = 0;           // lag of a pair's first sensor
  int32_t before_um_ = -kEarlyUm;  // lag of the pair before
  int32_t spread_um_ = 0;          // largest difference within a pair
  int32_t rest_[kSensors] = {};    // total resistance, in the tail
  int16_t top_e5_[kSensors] = {};
  uint16_t watched_ = 0;
  uint16_t unseen_ = 0;  // no resting value yet
  uint8_t next_ = 0;
  bool waits_ = false;  // a pair's first sensor for the second
  uint8_t moves_ = 0;   // control steps for which the tip counts as moving
};

}  // namespace thigmo

#endif  // THIGMO_CORE_SENSING_FOLD_WATCH_H_
