// One muscle's pressure loop: set point in, transducer current out, 200 times a second.
//
// The I/P transducer maps 4..20 mA to some 2..60 psi, so its map is fed forward and the PID
// corrects what is left (offset, gain, hysteresis). The map has a live zero: below about 2.2 psi
// nothing can be commanded, so lower set points mean true zero (0 mA); the integrator, which by
// then holds the transducer's offset, is frozen and carries on when the set point comes back: no
// bump.
#ifndef THIGMO_CORE_CONTROL_PRESSURE_LOOP_H_
#define THIGMO_CORE_CONTROL_PRESSURE_LOOP_H_

#include <stdint.h>

#include "../config/derived.h"
#include "../safety/leaky_count.h"
#include "fixed_point.h"

namespace thigmo {

// PID on 0.01 psi, gains in 1/256; derivative on the measurement; conditional anti-windup.
class PressurePid {
 public:
  // The correction is meant for a transducer's errors, not for the whole range.
  static constexpr int32_t kIntegralLimitCpsi = 600;

  // As near as this to the highest output, and as far as this from the set point, the output does
  // not suffice; more than noise, and less than would hurt.
  static constexpr int32_t kShortCpsi = 25;

  struct Gains {
    int16_t kp;
    int16_t ki;
    int16_t kd;
  };

  // One step: feed-forward plus correction, limited to low..high.
  int32_t step(int16_t set, int16_t measured, int32_t feed_forward, const Gains& gains, int32_t low,
               int32_t high) {
    const int32_t error = limited<int32_t>(static_cast<int32_t>(set) - measured, -6000, 6000);
    const int32_t proportional = static_cast<int32_t>(gains.kp) * error >> 8;
    // 300 * 32767 * 200 fits 31 bits; faster change than 600 psi/s is noise.
    const int32_t change = limited<int32_t>(static_cast<int32_t>(measured) - last_, -300, 300);
    const int32_t derivative = change * gains.kd * kControlHz >> 8;
    last_ = measured;

    const int32_t wanted = feed_forward + proportional + integral_cpsi() - derivative;
    const int32_t output = limited(wanted, low, high);
    // Integrate unless the output is at a limit and the error pushes further into it.
    short_ = wanted > high - kShortCpsi && error > kShortCpsi;
    if (!((wanted > high && error > 0) || (wanted < low && error < 0))) {
      constexpr int32_t kLimit = kIntegralLimitCpsi * 256 * kControlHz;
      sum_ = limited<int32_t>(sum_ + gains.ki * error, -kLimit, kLimit);
    }
    return output;
  }

  // While the output is off: keeps the derivative's memory, freezes the integrator.
  void idle(int16_t measured) { last_ = measured; }

  void reset() {
    sum_ = 0;
    short_ = false;
  }

  int32_t integral_cpsi() const { return integral_output(sum_); }

  // The highest output does not suffice, at the last step.
  bool falls_short() const { return short_; }

 private:
  int32_t sum_ = 0;  // of ki * error, per step
  int16_t last_ = 0;
  bool short_ = false;
};

// Set point slew, live zero, PID, output map, and two checks: that the pressure follows its set
// point, and that it is the one that the transducer's current stands for. The second is what tells
// a sensor that lies: the loop makes its reading follow, whatever the muscle then holds.
class PressureLoop {
 public:
  static constexpr int16_t kOff = -1;  // output: true zero

  // The pressure is compared with a follower of the set point, a first-order lag of 2^6 steps =
  // 0.32 s, about that of transducer and muscle together: a moving set point then neither winds the
  // integrator up (with it, a ramp of 15 psi/s to 10 psi overshoots by 1.1 psi) nor is a fault.
  static constexpr uint8_t kFollowLog2 = 6;

  // Each armed session starts in doubt: of the plugs (whose sensor, whose transducer) and of the
  // transducer's map. Until the pressure has been seen to follow the map by itself, at this
  // pressure for 50 ms, the output goes no higher. A set point on its way up passes it anyway.
  static constexpr int16_t kProofCpsi = 400;
  static constexpr int16_t kDoubtMostCpsi = 500;  // of the loop at set points below it
  static constexpr uint8_t kProofSteps = 10;
  // Control steps in which pressure and set point, or pressure and current, agree that forgive one
  // in which they do not: a sensor is noticed that lies for a third of the time.
  static constexpr uint16_t kMemory = 2;
  // A pressure above the map's is a fault so many times sooner then.
  static constexpr uint8_t kDoubtHaste = 30;

  // Slew as of Derived::slew_step_q8().
  void set_target(int16_t cpsi, int32_t slew_q8) {
    target_ = cpsi;
    slew_q8_ = slew_q8;
  }

  // True zero at once; what the integrator has learnt of the transducer stays (vent).
  void cut() {
    target_ = 0;
    set_q8_ = 0;
  }

  // True zero, and nothing is remembered: the integral may have been wound up by what went wrong.
  void disarm() {
    cut();
    pid_.reset();
    stuck_.clear();
    mismatch_.clear();
    proof_steps_ = 0;
    unproven_steps_ = 0;
  }

  // One control step; returns the duty 0..kDriveFull, or kOff. Inlined by order, once for each
  // muscle, as Controller::pressure_step is.
  __attribute__((always_inline)) inline int16_t step(int16_t measured, const Configuration& c,
                                                     const Derived& d) {
    if (target_ == 0 && set_q8_ == 0 && follower_q12_ == 0) {
      // At rest: nothing moves but what should not.
      watch_following(0, measured, c.get(Param::kStuckCpsi), d.stuck_steps);
      pid_.idle(measured);
      drive_q12_ = 0;
      mismatch_.add(false, d.stuck_steps);
      output_ = kOff;
      return output_;
    }
    const bool doubtful = proof_steps_ < kProofSteps;
    const bool proving = doubtful && target_ >= kProofCpsi;
    const int32_t goal = static_cast<int32_t>(proving ? kProofCpsi : target_) * 256;
    set_q8_ += limited<int32_t>(goal - set_q8_, -slew_q8_, slew_q8_);
    const int16_t set = set_cpsi();
    const bool on = set >= c.get(Param::kLiveZeroCpsi) && set > 0;
    // Twelve fraction bits keep the follower from stopping short of the set point.
    follower_q12_ += (q12(on ? set : 0) - follower_q12_) * (1 << (8 - kFollowLog2)) >> 8;
    const int16_t due = shifted16<12>(follower_q12_);
    watch_following(due, measured, c.get(Param::kStuckCpsi), d.stuck_steps);
    if (!on) {
      pid_.idle(measured);
      watch_drive(0, measured, c, d);
      output_ = kOff;
      return output_;
    }
    const PressurePid::Gains gains = {static_cast<int16_t>(c.get(Param::kPressureKp)),
                                      static_cast<int16_t>(c.get(Param::kPressureKi)),
                                      static_cast<int16_t>(c.get(Param::kPressureKd))};
    const int32_t floor = c.get(Param::kDrive4maCpsi);
    int32_t wanted = greater<int32_t>(floor, set);
    if (proving) {
      pid_.idle(measured);  // it would hide what is wrong with the map
    } else {
      wanted = pid_.step(due, measured, set, gains, floor,
                         greater<int32_t>(floor, doubtful ? kDoubtMostCpsi : d.drive_ceiling_cpsi));
    }
    watch_drive(static_cast<int16_t>(wanted), measured, c, d);
    if (proving) prove(measured, c, d);
    output_ = duty(wanted, c, d);
    return output_;
  }

  // Duty of a transducer output pressure by its 4..20 mA map.
  static int16_t duty(int32_t cpsi, const Configuration& c, const Derived& d) {
    const int32_t above = cpsi - c.get(Param::kDrive4maCpsi);
    // 4 mA of 20 mA is a fifth of the full duty: 319.8.
    constexpr int32_t kFourMaQ16 = static_cast<int32_t>(kDriveFull) * 65536 / 5;
    // 20 000 * 65 535 and the 4 mA fit 31 bits.
    const int32_t q16 = kFourMaQ16 + above * d.drive_slope_q16 + 0x8000;
    return static_cast<int16_t>(limited<int32_t>(q16 >> 16, 0, kDriveFull));
  }

  int16_t set_cpsi() const { return static_cast<int16_t>(set_q8_ >> 8); }
  int16_t target_cpsi() const { return target_; }
  int16_t output() const { return output_; }
  bool stuck(const Derived& d) const { return stuck_.full(d.stuck_steps); }
  // What the transducer gives out by its map is not what is measured, or is not enough; or the
  // channel was not proven.
  bool mismatched(const Derived& d) const {
    return mismatch_.full(d.stuck_steps) || unproven_steps_ >= d.stuck_steps;
  }
  bool astray() const { return astray_; }  // off its follower, at the last step

 private:
  void watch_following(int16_t due, int16_t measured, int32_t most, uint16_t steps) {
    astray_ = magnitude(static_cast<int32_t>(due) - measured) > most;
    stuck_.add(astray_, steps);
  }

  // The transducer's output by its map, lagged as the pressure is, against the pressure. An output
  // at its ceiling that still falls short is one as well.
  void watch_drive(int16_t output_cpsi, int16_t measured, const Configuration& c,
                   const Derived& d) {
    drive_q12_ += (q12(output_cpsi) - drive_q12_) * (1 << (8 - kFollowLog2)) >> 8;
    const int32_t above = static_cast<int32_t>(measured) - shifted16<12>(drive_q12_);
    const int32_t most = c.get(Param::kDriveToleranceCpsi);
    const bool bad = output_cpsi != 0 && (magnitude(above) > most || pid_.falls_short());
    const bool hasty = proof_steps_ < kProofSteps && above > most;
    mismatch_.add(bad, d.stuck_steps, hasty ? kDoubtHaste : uint8_t{1});
  }

  // The sensor of this muscle has to see what this muscle's transducer gives out by its map; the
  // other muscle's would see nothing. It has as long for it as a pressure that is stuck.
  void prove(int16_t measured, const Configuration& c, const Derived& d) {
    const int16_t due = shifted16<12>(drive_q12_);
    if (due <= kProofCpsi * 3 / 4) {
      proof_steps_ = 0;
      return;
    }
    const bool right = measured > due / 2 && magnitude(static_cast<int32_t>(due) - measured) <=
                                                 c.get(Param::kDriveToleranceCpsi);
    proof_steps_ = right ? static_cast<uint8_t>(proof_steps_ + 1) : 0;
    if (unproven_steps_ < d.stuck_steps) ++unproven_steps_;
    if (proof_steps_ >= kProofSteps) unproven_steps_ = 0;
  }

  PressurePid pid_;
  int32_t drive_q12_ = 0;
  int32_t set_q8_ = 0;
  int32_t follower_q12_ = 0;
  int16_t target_ = 0;
  int16_t output_ = kOff;
  int32_t slew_q8_ = 0;
  LeakyCount<uint16_t, kMemory> stuck_;
  LeakyCount<uint16_t, kMemory> mismatch_;
  uint16_t unproven_steps_ = 0;  // at the proof's pressure
  uint8_t proof_steps_ = 0;
  bool astray_ = false;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_CONTROL_PRESSURE_LOOP_H_
