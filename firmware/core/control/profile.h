// A trapezoid of speed towards a position, one step each control period.
//
// Speed is a whole number of acceleration steps, so that the braking distance is a triangular
// number and neither root nor division is needed. Positions are in encoder counts, in 1/65536.
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
    top_q16_ = speed_q16;
    accel_q16_ = lesser(accel_q16, speed_q16);
    steps_ = 0;
    speed_q16_ = 0;
  }

  // One control step. Returns the counts to be reached now.
  int32_t step() {
    const int64_t left = forward_ ? target_q16_ - position_q16_ : position_q16_ - target_q16_;
    const int64_t stopping = stopping_q16(steps_);
    if (left <= 0) {
      steps_ = 0;
      speed_q16_ = 0;
      return position();
    }
    if (left <= stopping) {
      if (steps_ > 1) --steps_;
    } else if (static_cast<int64_t>(accel_q16_) * steps_ < top_q16_ &&
               left > stopping_q16(steps_ + 1) + speed_q16_) {
      ++steps_;
    }
    int64_t move = lesser<int64_t>(static_cast<int64_t>(accel_q16_) * steps_, top_q16_);
    move = lesser(greater<int64_t>(move, accel_q16_), left);
    speed_q16_ = static_cast<int32_t>(move);
    position_q16_ += forward_ ? move : -move;
    return position();
  }

  int32_t position() const { return static_cast<int32_t>((position_q16_ + 0x8000) >> 16); }
  int32_t speed_q16() const { return forward_ ? speed_q16_ : -speed_q16_; }  // counts a step
  bool done() const { return position_q16_ == target_q16_; }
  bool forward() const { return forward_; }

 private:
  int64_t stopping_q16(int32_t steps) const {
    return static_cast<int64_t>(accel_q16_) * steps * (steps + 1) >> 1;
  }

  int64_t position_q16_ = 0;
  int64_t target_q16_ = 0;
  int32_t top_q16_ = 0;
  int32_t accel_q16_ = 0;
  int32_t speed_q16_ = 0;
  int32_t steps_ = 0;
  bool forward_ = true;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_CONTROL_PROFILE_H_
