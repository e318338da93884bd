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
    position_q16_ = static_cast<int64_t>(from_counts) * 65536;
    target_q16_ = static_cast<int64_t>(to_counts) * 65536;
    forward_ = to_counts >= from_counts;
    // Rounded down so that whole steps of it make up the top speed.
    const int32_t steps = (speed_q16 + accel_q16 - 1) / accel_q16;
    accel_q16_ = greater<int32_t>(speed_q16 / steps, 1);
    top_q16_ = speed_q16;
    speed_q16_ = 0;
    stopping_q16_ = 0;
  }

  // One control step. Returns the counts to be reached now.
  int32_t step() {
    int64_t left = target_q16_ - position_q16_;
    if (!forward_) left = -left;
    if (left <= 0) {
      speed_q16_ = 0;
      return position();
    }
    if (left <= stopping_q16_) {
      // Brake, but keep creeping.
      if (speed_q16_ > accel_q16_) {
        stopping_q16_ -= speed_q16_;
        speed_q16_ -= accel_q16_;
      }
    } else if (speed_q16_ + accel_q16_ <= top_q16_ &&
               left > stopping_q16_ + speed_q16_ + speed_q16_ + accel_q16_) {
      speed_q16_ += accel_q16_;
      stopping_q16_ += speed_q16_;
    }
    const int32_t move = left < greater(speed_q16_, accel_q16_) ? static_cast<int32_t>(left)
                                                                : greater(speed_q16_, accel_q16_);
    position_q16_ += forward_ ? move : -move;
    return position();
  }

  int32_t position() const { return static_cast<int32_t>((position_q16_ + 0x8000) >> 16); }
  int32_t speed_q16() const { return forward_ ? speed_q16_ : -speed_q16_; }  // counts a step
  bool done() const { return position_q16_ == target_q16_; }
  bool forward() const { return forward_; }

 private:
  int64_t position_q16_ = 0;
  int64_t target_q16_ = 0;
  int64_t stopping_q16_ = 0;  // way to standstill from the present speed
  int32_t top_q16_ = 0;
  int32_t accel_q16_ = 0;
  int32_t speed_q16_ = 0;  // per step
  bool forward_ = true;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_CONTROL_PROFILE_H_
