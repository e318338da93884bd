// The spool: position loop along a trapezoid profile, stall detection, slip detection.
//
// A move drives the motor in its own direction only: while growing, the motor never winds in, for a
// bent body that is wound in buckles; too fast a spool is braked instead. Where the body pulls
// harder than friction and shorted windings hold, the motor holds back with what is missing, and no
// more: a taut tail is not wound in by that, and it ends with the first step in which nothing is
// paid out. A change of direction always passes through the brake.
//
// At its target a move lets the spring-applied brake close while the driver, which still has its
// supply, brakes the motor; only then does it end. Without that, a body that pulls hard would turn
// the spool by millimetres in the time that the brake takes.
//
// The first moves of an armed session have homing's duty until the encoder has followed the command
// for 2 mm: swapped leads show within 1 mm.
#ifndef THIGMO_CORE_CONTROL_SPOOL_H_
#define THIGMO_CORE_CONTROL_SPOOL_H_

#include <stdint.h>

#include "../config/derived.h"
#include "profile.h"

namespace thigmo {

class SpoolLoop {
 public:
  enum class Outcome : uint8_t { kMoving, kArrived, kStalled, kAgainst };

  static constexpr int32_t kIntegralDuty = kMotorFull / 2;

  // A session begins: that the encoder follows the command is to be proven.
  void doubt() { proven_ = false; }

  void start(int32_t from_counts, int32_t to_counts, int32_t speed_q16, int32_t accel_q16,
             int16_t top_duty) {
    profile_.start(from_counts, to_counts, speed_q16, accel_q16);
    target_ = to_counts;
    from_ = from_counts;
    furthest_ = last_ = from_counts;
    top_duty_ = top_duty;
    sum_ = 0;
    still_steps_ = 0;
    rest_steps_ = 0;
    brake_steps_ = 0;
    duty_ = 0;
    overrun_ = false;
    at_target_ = false;
    for (uint8_t i = 0; i < kSpeedSteps; ++i) past_[i] = from_counts;
    oldest_ = 0;
  }

  // One control step; duty() then holds the motor's duty.
  Outcome step(int32_t counts, const Configuration& c, const Derived& d) {
    overrun_ = false;
    const int32_t goal = profile_.step();
    const int32_t way = profile_.forward() ? 1 : -1;
    const int32_t error = saturated16(goal - counts);  // beyond, the duty is full anyway
    const int32_t ahead = way * (target_ - counts);
    if (profile_.done() && ahead <= d.tolerance_counts) at_target_ = true;
    if (at_target_) {
      // A motor without a spring-applied brake drives again if the body pulls it off its target.
      at_target_ = d.brake_steps != 0;
      duty_ = pays_out(counts) ? static_cast<int16_t>(-d.holding_duty) : int16_t{0};
      return rests(counts, d.brake_steps) ? Outcome::kArrived : Outcome::kMoving;
    }
    if (!proven_) {
      const int32_t followed = way * (counts - from_);
      proven_ = followed > 2 * d.lead_counts;
      if (followed < -d.lead_counts) {
        duty_ = 0;
        return Outcome::kAgainst;
      }
    }
    watch_stall(counts, way * error >= d.stall_lag_counts, way, d);
    if (still_steps_ >= d.stall_steps || unseen(way * (goal - counts), way, d)) {
      duty_ = 0;
      return Outcome::kStalled;
    }

    // Speeds in counts/s; beyond 20 000 the loop saturates anyway.
    const int32_t wanted_speed =
        limited<int32_t>((profile_.speed_q16() >> 8) * kControlHz >> 8, -20000, 20000);
    const int32_t speed =
        limited<int32_t>((counts - past_[oldest_]) * (kControlHz / kSpeedSteps), -20000, 20000);
    past_[oldest_] = counts;
    oldest_ = static_cast<uint8_t>((oldest_ + 1) % kSpeedSteps);
    const int32_t least = way > 0 && pays_out(counts) ? -d.holding_duty : 0;
    last_ = counts;

    int32_t duty = (c.get(Param::kSpoolKp) * error >> 8) + integral_output(sum_) +
                   (c.get(Param::kSpoolKd) * (wanted_speed - speed) >> 8) +
                   (c.get(Param::kSpoolKff) * wanted_speed >> 8);
    if (way * duty > 0) duty += way * c.get(Param::kSpoolDeadZone);
    const int32_t top = proven_ ? top_duty_ : lesser(top_duty_, d.homing_duty);
    const bool saturated = way * duty >= top || way * duty <= least;
    if (!saturated || (way * duty >= top) != (way * error > 0)) {
      constexpr int32_t kLimit = kIntegralDuty * 256 * kControlHz;
      sum_ = limited<int32_t>(sum_ + c.get(Param::kSpoolKi) * error, -kLimit, kLimit);
    }
    int32_t driven = limited<int32_t>(way * duty, least, top);
    // Whatever the gains are, the motor drives nothing beyond the profile: a dead host's cost is
    // counted by it. What runs on though it is braked slips.
    const int32_t lead = way * (counts - goal);
    if (lead > d.lead_counts) driven = least;
    if (driven * way * duty_ < 0) driven = 0;
    duty_ = static_cast<int16_t>(way * driven);
    overrun_ = lead > d.lead_counts + d.slip_counts;
    return Outcome::kMoving;
  }

  int16_t duty() const { return duty_; }
  // Speed of the profile, counts a control step, signed, in 1/65536.
  int32_t wanted_q16() const { return profile_.speed_q16(); }
  // The spring-applied brake closes, or is closed.
  bool braked() const { return at_target_; }
  // The tail is further ahead of the profile than a brake that holds would let it.
  bool overrun() const { return overrun_; }

 private:
  static constexpr uint8_t kSpeedSteps = 4;
  static constexpr uint8_t kRestSteps = 10;    // 50 ms without a count
  static constexpr uint8_t kBrakeSteps = 60;   // 0.3 s, as SlipWatch grants
  static constexpr uint8_t kUnseenSteps = 10;  // 50 ms without a count

  bool pays_out(int32_t counts) const { return counts > last_; }

  // At its target, braked: a pulled tail runs on for a while, and the length is the one at rest. A
  // tail that the brake does not hold is for the slip watch.
  bool rests(int32_t counts, uint8_t closing_steps) {
    rest_steps_ = counts == last_ ? static_cast<uint8_t>(rest_steps_ + 1) : 0;
    last_ = counts;
    ++brake_steps_;
    if (brake_steps_ >= kBrakeSteps) return true;
    return rest_steps_ >= kRestSteps && brake_steps_ >= closing_steps;
  }

  // Counts steps without progress, and forgives all of stall_ms for kStallLagUm of progress: a
  // single count now and then hides no stall. However small the duty: it never is below the dead
  // zone, and homing's may be no more than that.
  void watch_stall(int32_t counts, bool lags, int32_t way, const Derived& d) {
    const int32_t progress = way * (counts - furthest_);
    if (progress > 0) {
      furthest_ = counts;
      uint16_t forgiven = still_steps_;
      if (progress < d.stall_lag_counts) {
        const uint16_t share = static_cast<uint16_t>(progress);
        forgiven = lesser(forgiven, static_cast<uint16_t>(share * d.stall_forgiven));
      }
      still_steps_ = static_cast<uint16_t>(still_steps_ - forgiven);
    } else if (duty_ != 0 && (lags || profile_.done()) && still_steps_ < 0xFFFF) {
      ++still_steps_;
    }
  }

  // A spool that pays out has nothing to push against. If its counts stand still all the same, the
  // encoder may be dead and the body growing ever faster: there a stall is one of 3 mm as well.
  bool unseen(int32_t lag, int32_t way, const Derived& d) const {
    return way > 0 && still_steps_ >= kUnseenSteps && lag > 3 * d.lead_counts;
  }

  Profile profile_;
  int32_t from_ = 0;
  int32_t target_ = 0;
  int32_t furthest_ = 0;
  int32_t sum_ = 0;  // of ki * error, per step
  int32_t past_[kSpeedSteps] = {};
  int32_t last_ = 0;
  int16_t duty_ = 0;
  int16_t top_duty_ = 0;
  uint16_t still_steps_ = 0;
  uint8_t oldest_ = 0;
  uint8_t rest_steps_ = 0;
  uint8_t brake_steps_ = 0;
  bool overrun_ = false;
  bool at_target_ = false;
  bool proven_ = false;
};

// Movement while the motor is off: the body's air pulls the tail out.
class SlipWatch {
 public:
  static constexpr uint8_t kCoastSteps = 60;  // 0.3 s for the spool to come to rest

  // One control step. True while the spool is further than allowed from where it stopped.
  bool step(int32_t counts, bool driven, int32_t slip_counts) {
    if (driven) coast_ = kCoastSteps;
    if (coast_ > 0) {
      --coast_;
      rest_ = counts;
      return false;
    }
    return magnitude(counts - rest_) > slip_counts;
  }

  // Takes the present place as the place of rest.
  void accept(int32_t counts) { rest_ = counts; }

 private:
  int32_t rest_ = 0;
  uint8_t coast_ = kCoastSteps;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_CONTROL_SPOOL_H_
