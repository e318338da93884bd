// Whether the spool moves as its motor is driven: by the motor's constant, whatever the loop wants.
//
// The speed that a duty must give is known within the tolerance of friction, supply and heat. Three
// sums of what the encoder shows against it (CUSUM, Page 1954) are kept, in counts:
//
// - Missed: growth that the motor must have made and the encoder has not shown. A loop that closes
//   on an encoder which loses counts drives the body further than asked, and nothing else tells.
// - Excess: growth that the encoder has shown and motor and body together cannot have made.
// - Astray: motion that neither the motor nor the profile accounts for, either way: a driver that
//   is shorted, a brake that lets go.
//
// Sums forget what is within tolerance, so that they can watch for ever.
#ifndef THIGMO_CORE_CONTROL_MOTION_WATCH_H_
#define THIGMO_CORE_CONTROL_MOTION_WATCH_H_

#include <stdint.h>

#include "../config/derived.h"

namespace thigmo {

class MotionWatch {
 public:
  // Forgets what was: when the spool winds in, and when a length or a fault's end is confirmed.
  void restart(int32_t counts) {
    last_ = counts;
    missed_q16_ = excess_q16_ = astray_q16_[0] = astray_q16_[1] = 0;
  }

  // One control step: the encoder, the duty since the last step, the profile's speed (counts a
  // step, signed). Only growth is judged for missing and excessive counts. The body's pull counts
  // as duty, `pull_duty` as calibrated at this body pressure (0: not calibrated): for missing
  // counts while `pulls`, when the body is seen to grow.
  void step(int32_t counts, int16_t duty, int32_t wanted_q16, bool growing, bool pulls,
            int32_t pull_duty, const Configuration& c, const Derived& d) {
    const int32_t moved_q16 = limited<int32_t>(counts - last_, -12000, 12000) * 65536;
    last_ = counts;
    const int32_t friction = c.get(Param::kSpoolDeadZone);
    const int32_t beyond = magnitude(duty) - friction;
    const int32_t top = beyond > 0 ? beyond * d.motor_slope_q16 : 0;
    speed_q16_ += share_q16((duty < 0 ? -top : top) - speed_q16_, kLagShare);

    if (growing) {
      // Of a spool that turns outwards, whether the motor drives it or holds it back.
      outwards_q16_ += share_q16((duty - friction) * d.motor_slope_q16 - outwards_q16_, kLagShare);
      const int32_t doubt = magnitude(outwards_q16_) >> 4;
      const int32_t gauge_duty = magnitude(pull_duty) >> kGaugeShift;
      const int32_t pulled_q16 = pulls ? (pull_duty - gauge_duty) * d.motor_slope_q16 : 0;
      const int32_t least = outwards_q16_ - doubt - d.speed_margin_q16 + pulled_q16;
      const int32_t missed = missed_q16_ + greater<int32_t>(least, 0) - moved_q16;
      missed_q16_ = limited<int32_t>(missed, 0, d.missed_q16 + 1);
      const int32_t stated_duty = pull_duty != 0 ? pull_duty : d.pull_duty;
      const int32_t most_duty = stated_duty + (stated_duty >> kGaugeShift);
      const int32_t most = outwards_q16_ + doubt + d.friction_q16 + most_duty * d.motor_slope_q16;
      const int32_t excess = excess_q16_ + moved_q16 - greater<int32_t>(most, 0);
      excess_q16_ = limited<int32_t>(excess, 0, d.excess_q16 + 1);
    } else {
      outwards_q16_ = 0;
    }
    watch(0, moved_q16, greater(speed_q16_, wanted_q16), d);
    watch(1, -moved_q16, greater(-speed_q16_, -wanted_q16), d);
  }

  bool missed(const Derived& d) const { return d.judges_encoder && missed_q16_ > d.missed_q16; }
  bool exceeds(const Derived& d) const { return d.judges_encoder && excess_q16_ > d.excess_q16; }
  bool astray(const Derived& d) const {
    return astray_q16_[0] > d.astray_q16 || astray_q16_[1] > d.astray_q16;
  }

 private:
  // The body's pressure is set by hand, by a gauge that may be off by 1/32 (class 2.5).
  static constexpr uint8_t kGaugeShift = 5;
  static constexpr uint16_t kLagShare = 4520;  // of 1/65536 in 5 ms: a lag of 70 ms

  void watch(uint8_t way, int32_t moved_q16, int32_t most_q16, const Derived& d) {
    const int32_t most = most_q16 > 0 ? most_q16 + (most_q16 >> 3) : 0;
    const int32_t sum = astray_q16_[way] + moved_q16 - most - d.astray_speed_q16;
    astray_q16_[way] = limited<int32_t>(sum, 0, d.astray_q16 + 1);
  }

  int32_t last_ = 0;
  int32_t speed_q16_ = 0;     // that the motor must have, without load
  int32_t outwards_q16_ = 0;  // the same if it turns outwards: negative if it holds back
  int32_t missed_q16_ = 0;
  int32_t excess_q16_ = 0;
  int32_t astray_q16_[2] = {};  // out, in
};

}  // namespace thigmo

#endif  // THIGMO_CORE_CONTROL_MOTION_WATCH_H_
