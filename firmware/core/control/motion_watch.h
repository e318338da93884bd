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
  // step, signed). Only growth is judged for missing counts; the pull of a body that is seen to
  // grow counts as duty.
  void step(int32_t counts, int16_t duty, int32_t wanted_q16, bool growing, int32_t pull_duty,
            const Configuration& c, const Derived& d) {
    const int32_t moved_q16 = limited<int32_t>(counts - last_, -12000, 12000) * 65536;
    last_ = counts;
    const int32_t beyond = magnitude(duty) - c.get(Param::kSpoolDeadZone);
    const int32_t top = beyond > 0 ? beyond * d.motor_slope_q16 : 0;
    speed_q16_ += share_q16((duty < 0 ? -top : top) - speed_q16_, kLagShare);

    if (growing) {
      const int32_t least =
          speed_q16_ - (speed_q16_ >> 4) - d.speed_margin_q16 + pull_duty * d.motor_slope_q16;
      const int32_t sum = missed_q16_ + greater<int32_t>(least, 0) - moved_q16;
      missed_q16_ = limited<int32_t>(sum, 0, d.missed_q16 + 1);
      // A motor that is not driven says nothing of the speed at which the body pulls it.
      if (beyond > 0) {
        const int32_t most = speed_q16_ + (speed_q16_ >> 4) + d.helped_q16;
        excess_q16_ = limited<int32_t>(excess_q16_ + moved_q16 - most, 0, d.excess_q16 + 1);
      }
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
  static constexpr uint16_t kLagShare = 4520;  // of 1/65536 in 5 ms: a lag of 70 ms

  void watch(uint8_t way, int32_t moved_q16, int32_t most_q16, const Derived& d) {
    const int32_t most = most_q16 > 0 ? most_q16 + (most_q16 >> 3) : 0;
    const int32_t sum = astray_q16_[way] + moved_q16 - most - d.astray_speed_q16;
    astray_q16_[way] = limited<int32_t>(sum, 0, d.astray_q16 + 1);
  }

  int32_t last_ = 0;
  int32_t speed_q16_ = 0;  // that the motor must have, without load
  int32_t missed_q16_ = 0;
  int32_t excess_q16_ = 0;
  int32_t astray_q16_[2] = {};  // out, in
};

}  // namespace thigmo

#endif  // THIGMO_CORE_CONTROL_MOTION_WATCH_H_
