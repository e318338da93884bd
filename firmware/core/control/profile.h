// A trapezoid of speed towards a position, one step each control period.
//
// Speed is a whole number of acceleration steps, and the braking distance the sum of the speeds
// that were passed: it is kept along, so that neither root nor product is needed. Positions are in
// encoder counts, in 1/65536.
#ifndef THIGMO_CORE_CONTROL_PROFILE_H_
#define THIGMO_CORE_CONTROL_PROFILE_H_

#include <stdint.h>

#include "fixed_point.h"

namespace thigmo {

class Profile {
 public:
  void start(int32_t from_counts, int32_t to_counts, int32_t speed_q16, int32_t accel_q16) {
    target_ = to_counts;
    forward_ = to_counts >= from_counts;
    left_ = {forward_ ? to_counts - from_counts : from_counts - to_counts, 0};
    // Rounded down so that whole steps of it make up the top speed.
    const int32_t steps = (speed_q16 + accel_q16 - 1) / accel_q16;
    accel_q16_ = greater<int32_t>(speed_q16 / steps, 1);
    top_q16_ = speed_q16;
    speed_q16_ = 0;
    stopping_ = {0, 0};
  }

  // One control step. Returns the counts to be reached now.
  int32_t step() {
    if (done()) {
      speed_q16_ = 0;
      return position();
    }
    if (!stopping_.less(left_)) {
      // Brake, but keep creeping.
      if (speed_q16_ > accel_q16_) {
        stopping_.add(-speed_q16_);
        speed_q16_ -= accel_q16_;
      }
    } else if (speed_q16_ + accel_q16_ <= top_q16_) {
      Fine needed = stopping_;
      needed.add(speed_q16_);
      needed.add(speed_q16_ + accel_q16_);
      if (needed.less(left_)) {
        speed_q16_ += accel_q16_;
        stopping_.add(speed_q16_);
      }
    }
    Fine left = left_;
    left.add(-greater(speed_q16_, accel_q16_));
    left_ = left.whole < 0 ? Fine{0, 0} : left;
    return position();
  }

  // Rounded to nearest.
  int32_t position() const {
    if (forward_) return target_ - left_.whole - (left_.fraction > 0x8000 ? 1 : 0);
    return target_ + left_.whole + (left_.fraction >= 0x8000 ? 1 : 0);
  }
  int32_t speed_q16() const { return forward_ ? speed_q16_ : -speed_q16_; }  // counts a step
  bool done() const { return left_.zero(); }
  bool forward() const { return forward_; }

 private:
  Fine left_ = {0, 0};      // to the target, counts
  Fine stopping_ = {0, 0};  // way to standstill from the present speed
  int32_t target_ = 0;
  int32_t top_q16_ = 0;
  int32_t accel_q16_ = 0;
  int32_t speed_q16_ = 0;  // per step
  bool forward_ = true;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_CONTROL_PROFILE_H_
