// Scaled constants that the loops use, computed from the configuration after each change, so that
// the expensive divisions (64 bits wide here and there) happen while nothing moves. After a change
// of parameters the quick ones follow at once, and the slow ones part by part: until none of those
// waits, constants and parameters may contradict each other, and nothing may be driven by them.
#ifndef THIGMO_CORE_CONFIG_DERIVED_H_
#define THIGMO_CORE_CONFIG_DERIVED_H_

#include <stdint.h>

#include "../control/fixed_point.h"
#include "configuration.h"

namespace thigmo {

constexpr uint8_t kControlMs = 5;  // one control step of each loop
constexpr int32_t kControlHz = 200;
// The transducer is never driven further above the highest set point, by its map: room for the
// loop's corrections, whatever a sensor claims.
constexpr int32_t kDriveMarginCpsi = 100;
// The tip is never driven further ahead of its profile, whatever the gains.
constexpr int32_t kLeadUm = 1000;
// A profile this far ahead means that the motor ought to be turning.
constexpr int32_t kStallLagUm = 250;
// Motion that nothing commanded: a fault once it has gone this far, faster than a body that pulls
// at a braked motor.
constexpr int32_t kAstrayUm = 800;
constexpr int32_t kAstrayUmS = 10000;
// Growth that the encoder may miss before the motor's speed tells.
constexpr int32_t kMissedUm = 3000;
// Growth that it may show beyond what motor and body can have made. The body is then half of the
// shown growth behind at most.
constexpr int32_t kExcessUm = 20000;
// Friction of motor and gearbox changes by this share of the dead zone with wear and temperature.
constexpr int32_t kFrictionShare = 5;
// The charge pump that feeds an enable is empty so long after its pin stopped toggling.
constexpr int32_t kEnableDecayMs = 30;
// Share of the line's rating for a winding spool's momentum.
constexpr int32_t kMomentumShare = 4;
constexpr uint32_t kDividerOhm = 22000;  // between pin and ground (thesis)

// A gain below 1 as 16 bits and a shift: gain = mantissa / 2^(16 + shift). Products then take two
// multiplications of 16 bits and lose nothing.
struct Gain16 {
  uint16_t mantissa;
  uint16_t half;  // of 2^shift
  uint8_t shift;

  void set(uint32_t numerator, uint32_t denominator) {
    shift = 0;
    while (numerator * 2 < denominator && shift < 14) {
      numerator *= 2;
      ++shift;
    }
    // numerator / denominator is now at least a half, if the gain is not absurdly small.
    mantissa = numerator >= denominator
                   ? uint16_t{65535}
                   : static_cast<uint16_t>(long_quotient(numerator, denominator, 16));
    half = static_cast<uint16_t>((1u << shift) >> 1);
  }

  // Rounded to nearest.
  int32_t apply(int32_t value) const { return (share_q16(value, mantissa) + half) >> shift; }
};

struct Derived {
  int32_t flex_gain_q16[kSensors];          // 1e-5/cm per 1/16 ohm
  Gain16 pressure_gain[kMuscles];           // 0.01 psi per 1/64 count of a sum of five
  uint32_t reversal_inverse_q24[kMuscles];  // rounded up, so that the whole width gives 256 / 256
  uint16_t lag_alpha_q16[kMuscles];         // share of the way to the input in one control step
  uint16_t supports_per_cpsi_q22;           // of a free-curvature map
  int16_t drive_ceiling_cpsi;               // highest transducer output that a loop may ask for
  uint16_t drive_slope_q16;                 // duty per 0.01 psi
  uint32_t um_per_count_q16;                // tip movement per encoder count
  uint32_t counts_per_um_q24;               // and the other way
  uint32_t step_per_um_s_q32;               // counts in a control step at a tip speed
  int32_t accel_q16;                        // counts per control step and step, in 1/65536
  int32_t top_speed_um_s;                   // the fastest tip whose host or firmware may die
  int32_t slip_counts;
  int32_t tolerance_counts;
  int32_t lead_counts;
  int32_t stall_lag_counts;
  int16_t top_duty;  // that the line holds, a sudden stop included
  int16_t homing_duty;
  int16_t holding_duty;        // by which the body pulls harder than friction holds
  int16_t pull_duty;           // that balances the most the body pulls
  int32_t winding_speed_um_s;  // fastest tip of a retraction
  int32_t home_speed_um_s;
  int32_t motor_slope_q16;   // counts a control step for each duty beyond the dead zone
  int32_t speed_margin_q16;  // the same of speed_margin_duty
  int32_t friction_q16;      // the same of what less friction saves
  int32_t missed_q16;        // counts, in 1/65536
  int32_t excess_q16;
  int32_t astray_q16;
  int32_t astray_speed_q16;  // counts a control step
  int32_t slew_q8;           // fastest set-point change in a control step, 1/256 of 0.01 psi
  uint8_t brake_steps;  // until the brake has closed, its enable's decay included; 0 = none fitted
  bool grows;           // by a spool
  uint16_t stuck_steps;
  uint16_t stall_steps;
  uint16_t stall_forgiven;  // steps that a count of progress forgives
  uint16_t enabled_mask = 0;
  uint8_t fitted_mask = 0;  // muscles
  uint16_t bases_mask = 0;  // sensors that the trigger works on while one of these is driven
  bool telemetry_aligned;
  bool judges_encoder;  // by the motor's duty, and by the sensors that pass the tip
  uint8_t oversample_log2;
  uint8_t trigger_log2;
  uint8_t waiting = 0;  // parts that are not up to date

  // All of them.
  void update(const Configuration& c) {
    for (uint8_t i = 0; i < kSensors; ++i) update_flex(c, i);
    for (uint8_t muscle = 0; muscle < kMuscles; ++muscle) {
      update_gain(c, muscle);
      update_reversal(c, muscle);
      update_lag(c, muscle);
      update_fitted(c, muscle);
    }
    update_bases(c);
    waiting = kEveryPart;
    while (waits()) step(c);
    update_supports(c);
    update_drive(c);
    update_top_speed(c);
    update_slew(c);
    update_stuck(c);
    update_brake(c);
    update_telemetry(c);
  }

  // After a change of one parameter: only what follows from it, to keep the pass short. Parts that
  // take several divisions then wait for step().
  void update(const Configuration& c, uint16_t index) {
    const auto within = [index](Param first, uint8_t count) {
      return index >= static_cast<uint16_t>(first) && index < static_cast<uint16_t>(first) + count;
    };
    if (within(Param::kFlexScale, kSensors)) {
      update_flex(c, static_cast<uint8_t>(index - static_cast<uint16_t>(Param::kFlexScale)));
    } else if (within(Param::kFlexEnabled, kSensors)) {
      update_flex(c, static_cast<uint8_t>(index - static_cast<uint16_t>(Param::kFlexEnabled)));
    } else if (within(Param::kCountsPerM, 1) || within(Param::kPayoutQ8, 1)) {
      waiting = kEveryPart;
    } else if (within(Param::kSlipUm, 1) || within(Param::kSpoolToleranceUm, 1)) {
      wait_for(kDistances);
    } else if (within(Param::kLineSpeedUmS, 2)) {
      wait_for(kMotor);
    } else if (within(Param::kBodyPullN, 1)) {
      wait_for(kPull | kForce);
    } else if (within(Param::kSpoolDeadZone, 1)) {
      wait_for(kMotor | kForce);
    } else if (within(Param::kMotorStallN, 1)) {
      wait_for(kPull | kForce);
    } else if (within(Param::kLineRatingN, 2) || within(Param::kHomeSpeedUmS, 1)) {
      wait_for(kForce);
    } else if (within(Param::kSpoolAccelUmS2, 1)) {
      wait_for(kAcceleration);
    } else if (within(Param::kPressureSpan, kMuscles)) {
      update_gain(c, static_cast<uint8_t>(index - static_cast<uint16_t>(Param::kPressureSpan)));
    } else if (within(Param::kPressureFullCpsi, 1)) {
      for (uint8_t muscle = 0; muscle < kMuscles; ++muscle) update_gain(c, muscle);
    } else if (within(Param::kReversalCpsi, kMuscles)) {
      update_reversal(c, static_cast<uint8_t>(index - static_cast<uint16_t>(Param::kReversalCpsi)));
    } else if (within(Param::kLagMs, kMuscles)) {
      update_lag(c, static_cast<uint8_t>(index - static_cast<uint16_t>(Param::kLagMs)));
    } else if (within(Param::kMuscleFitted, kMuscles)) {
      update_fitted(c, static_cast<uint8_t>(index - static_cast<uint16_t>(Param::kMuscleFitted)));
      update_bases(c);
    } else if (within(Param::kTriggerWhen, kSensors)) {
      update_bases(c);
    } else if (within(Param::kDrive4maCpsi, 1) || within(Param::kDrive20maCpsi, 1)) {
      update_drive(c);
    } else if (within(Param::kMapTopCpsi, 1)) {
      update_supports(c);
    } else if (within(Param::kHeartbeatMs, 1)) {
      update_top_speed(c);
    } else if (within(Param::kPressureSlewCpsiS, 1)) {
      update_slew(c);
    } else if (within(Param::kStuckMs, 1)) {
      update_stuck(c);
    } else if (within(Param::kStallMs, 1)) {
      update_stall(c);
    } else if (within(Param::kBrakeFitted, 1) || within(Param::kBrakeClosesMs, 1) ||
               within(Param::kGrows, 1)) {
      update_brake(c);
    } else if (within(Param::kTelemetryMs, 1)) {
      update_telemetry(c);
    } else {
      update_plain(c);
    }
  }

  bool waits() const { return waiting != 0; }

  // Brings one part up to date, in an order in which each uses those before it.
  void step(const Configuration& c) {
    if (take(kScale)) return update_scale(c);
    if (take(kDistances)) return update_distances(c);
    if (take(kTolerances)) return update_tolerances();
    if (take(kAcceleration)) return update_acceleration(c);
    if (take(kMotor)) {
      update_motor(c);
      return wait_for(kPull);
    }
    if (take(kPull)) return update_pull(c);
    if (take(kForce)) update_force(c);
  }

  // A slew rate as the most change in a control step, 1/256 of 0.01 psi.
  static int32_t slew_step_q8(uint16_t cpsi_s) {
    return greater<int32_t>(static_cast<int32_t>(cpsi_s) * 256 / kControlHz, 1);
  }

  // Encoder counts of a tip movement, rounded to nearest.
  int32_t counts(int32_t um) const {
    return static_cast<int32_t>(
        (static_cast<int64_t>(um) * static_cast<int64_t>(counts_per_um_q24) + 0x800000) >> 24);
  }

  // Tip movement of encoder counts.
  int32_t um(int32_t counts) const { return multiply_q16(counts, um_per_count_q16); }

  // Tip speed as profile steps: counts per control step, in 1/65536.
  int32_t speed_q16(int32_t um_s) const {
    return greater<int32_t>(
        static_cast<int32_t>(
            (static_cast<int64_t>(um_s) * static_cast<int64_t>(step_per_um_s_q32)) >> 16),
        1);
  }

 private:
  // Parts that take several divisions.
  static constexpr uint8_t kScale = 1;
  static constexpr uint8_t kDistances = 2;
  static constexpr uint8_t kTolerances = 4;
  static constexpr uint8_t kAcceleration = 8;
  static constexpr uint8_t kMotor = 16;
  static constexpr uint8_t kPull = 32;
  static constexpr uint8_t kForce = 64;
  static constexpr uint8_t kEveryPart = 127;

  void wait_for(uint8_t parts) { waiting = static_cast<uint8_t>(waiting | parts); }

  // Whether a part waits, and no longer does.
  bool take(uint8_t part) {
    const bool waited = (waiting & part) != 0;
    waiting = static_cast<uint8_t>(waiting & ~part);
    return waited;
  }

  void update_flex(const Configuration& c, uint8_t i) {
    // 1e-9/cm per ohm -> 1e-5/cm per 1/16 ohm: / 160000; times 65536 is 256 / 625.
    flex_gain_q16[i] = c.get(Param::kFlexScale, i) * 256 / 625;
    const uint16_t bit = static_cast<uint16_t>(1u << i);
    enabled_mask = static_cast<uint16_t>(c.get(Param::kFlexEnabled, i) != 0 ? enabled_mask | bit
                                                                            : enabled_mask & ~bit);
  }

  void update_gain(const Configuration& c, uint8_t muscle) {
    pressure_gain[muscle].set(static_cast<uint32_t>(c.get(Param::kPressureFullCpsi)),
                              static_cast<uint32_t>(c.get(Param::kPressureSpan, muscle)) * 5u);
  }

  void update_reversal(const Configuration& c, uint8_t muscle) {
    reversal_inverse_q24[muscle] =
        0x1000000u / static_cast<uint32_t>(c.get(Param::kReversalCpsi, muscle)) + 1;
  }

  void update_lag(const Configuration& c, uint8_t muscle) {
    // First-order lag, exact to second order in step / lag; a lag below half a step passes all.
    const int32_t lag = c.get(Param::kLagMs, muscle);
    const int32_t alpha = 2 * kControlMs * 65536 / (2 * lag + kControlMs);
    lag_alpha_q16[muscle] = static_cast<uint16_t>(lesser<int32_t>(alpha, 65535));
  }

  void update_fitted(const Configuration& c, uint8_t muscle) {
    const uint8_t bit = static_cast<uint8_t>(1u << muscle);
    fitted_mask = static_cast<uint8_t>(
        c.get(Param::kMuscleFitted, muscle) != 0 ? fitted_mask | bit : fitted_mask & ~bit);
  }

  void update_bases(const Configuration& c) {
    bases_mask = 0;
    for (uint8_t i = 0; i < kColumns; ++i) {
      const uint8_t input = base_input(i);
      if ((c.get(Param::kTriggerWhen, input) & fitted_mask) != 0)
        bases_mask = static_cast<uint16_t>(bases_mask | 1u << input);
    }
  }

  void update_scale(const Configuration& c) {
    // At most 1e6 counts/m times 4, in 1/256: 2^30.
    const uint32_t scale = static_cast<uint32_t>(c.get(Param::kCountsPerM)) *
                           static_cast<uint32_t>(c.get(Param::kPayoutQ8));
    um_per_count_q16 = long_quotient(uint32_t{1000000} << 12, scale, 12);
    counts_per_um_q24 = long_quotient(scale, 1000000, 16);
    step_per_um_s_q32 = long_quotient(scale, 1000000 * uint32_t{kControlHz} >> 8, 16);
  }

  void update_acceleration(const Configuration& c) {
    accel_q16 = greater<int32_t>(speed_q16(c.get(Param::kSpoolAccelUmS2)) / kControlHz, 1);
  }

  void update_distances(const Configuration& c) {
    slip_counts = greater<int32_t>(counts(c.get(Param::kSlipUm)), 2);
    tolerance_counts = greater<int32_t>(counts(c.get(Param::kSpoolToleranceUm)), 1);
    lead_counts = greater<int32_t>(counts(kLeadUm), 1);
    stall_lag_counts = greater<int32_t>(counts(kStallLagUm), 1);
    update_stall(c);
  }

  void update_motor(const Configuration& c) {
    const int32_t tip_um_s = c.get(Param::kLineSpeedUmS) * 256 / c.get(Param::kPayoutQ8);
    motor_slope_q16 = speed_q16(tip_um_s) / (kMotorFull - c.get(Param::kSpoolDeadZone));
    speed_margin_q16 = c.get(Param::kSpeedMarginDuty) * motor_slope_q16;
    friction_q16 = c.get(Param::kSpoolDeadZone) / kFrictionShare * motor_slope_q16;
    judges_encoder = c.get(Param::kSpeedMarginDuty) < kMotorFull;
  }

  void update_pull(const Configuration& c) {
    pull_duty = saturated16(c.get(Param::kBodyPullN) * kMotorFull / c.get(Param::kMotorStallN));
    holding_duty = static_cast<int16_t>(
        limited<int32_t>(pull_duty - c.get(Param::kSpoolDeadZone), 0, kMotorFull / 2));
  }

  void update_tolerances() {
    excess_q16 = speed_q16(kExcessUm * kControlHz);
    missed_q16 = speed_q16(kMissedUm * kControlHz);
    astray_q16 = greater<int32_t>(speed_q16(kAstrayUm * kControlHz), 3 * 65536);
    astray_speed_q16 = speed_q16(kAstrayUmS);
  }

  // A line that is stopped at once bears the motor's pull and its momentum. The momentum may take
  // an eighth of what line and tail are rated for: an encoder that shows half of its counts lets
  // the spool turn twice as fast, and a body that is home then stops it. Homing, as a session's
  // first move, pulls half as hard, or as hard as a thick body's pull needs.
  void update_force(const Configuration& c) {
    const int32_t rating_n = c.get(Param::kLineRatingN);
    const int32_t stall_n = c.get(Param::kMotorStallN) * 9 / 8;
    top_duty = static_cast<int16_t>(
        lesser<int32_t>((rating_n - rating_n / kMomentumShare) * kMotorFull / stall_n, kMotorFull));
    const int32_t turns = c.get(Param::kSpoolDeadZone) +
                          greater<int32_t>(kMotorFull / 8, pull_duty + kMotorFull / 16);
    homing_duty =
        static_cast<int16_t>(lesser<int32_t>(greater<int32_t>(top_duty / 2, turns), top_duty));
    // um/s of the tip at which the momentum takes its share: N / (N s/m) is m/s of line.
    const int32_t touch = greater<int32_t>(c.get(Param::kTouchNSM), 1);
    const int32_t line_um_s = rating_n * 1000 / touch * (1000 / kMomentumShare);
    winding_speed_um_s = line_um_s / c.get(Param::kPayoutQ8) * 128;
    home_speed_um_s = lesser(c.get(Param::kHomeSpeedUmS), winding_speed_um_s);
  }

  void update_supports(const Configuration& c) {
    constexpr uint32_t kLastQ22 = uint32_t{protocol::kMapPoints - 1} << 22;
    const uint32_t top = static_cast<uint32_t>(c.get(Param::kMapTopCpsi));
    supports_per_cpsi_q22 = static_cast<uint16_t>((kLastQ22 + top / 2) / top);
  }

  void update_drive(const Configuration& c) {
    // 16 mA of 20 mA is 4/5 of the full duty. A span too small for 16 bits is never armed.
    const int32_t span =
        greater<int32_t>(c.get(Param::kDrive20maCpsi) - c.get(Param::kDrive4maCpsi), 1300);
    drive_slope_q16 =
        static_cast<uint16_t>(static_cast<int32_t>(kDriveFull) * 65536 / 5 * 4 / span);
    update_plain(c);
  }

  // What takes no division.
  void update_plain(const Configuration& c) {
    drive_ceiling_cpsi = static_cast<int16_t>(
        lesser(c.get(Param::kMaxPressureCpsi) + kDriveMarginCpsi, c.get(Param::kDrive20maCpsi)));
    oversample_log2 = static_cast<uint8_t>(c.get(Param::kOversampleLog2));
    trigger_log2 = static_cast<uint8_t>(c.get(Param::kTriggerFilterLog2));
  }

  void update_top_speed(const Configuration& c) {
    top_speed_um_s = Configuration::top_speed_um_s(c.get(Param::kHeartbeatMs));
  }

  void update_slew(const Configuration& c) {
    slew_q8 = slew_step_q8(static_cast<uint16_t>(c.get(Param::kPressureSlewCpsiS)));
  }

  void update_stuck(const Configuration& c) {
    stuck_steps = static_cast<uint16_t>(c.get(Param::kStuckMs) / kControlMs);
  }

  void update_stall(const Configuration& c) {
    stall_steps = static_cast<uint16_t>(c.get(Param::kStallMs) / kControlMs);
    stall_forgiven = static_cast<uint16_t>(greater<int32_t>(stall_steps / stall_lag_counts, 1));
  }

  void update_brake(const Configuration& c) {
    const int32_t closing_ms = c.get(Param::kBrakeClosesMs) + kEnableDecayMs;
    const int32_t steps = (closing_ms + kControlMs - 1) / kControlMs;
    grows = c.get(Param::kGrows) != 0;
    brake_steps = static_cast<uint8_t>(grows && c.get(Param::kBrakeFitted) != 0 ? steps : 0);
  }

  void update_telemetry(const Configuration& c) {
    telemetry_aligned = c.get(Param::kTelemetryMs) % kControlMs == 0;
  }
};

}  // namespace thigmo

#endif  // THIGMO_CORE_CONFIG_DERIVED_H_
