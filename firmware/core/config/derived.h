// Scaled constants that the loops use, computed from the configuration after each change, so that
// the expensive divisions (64 bits wide here and there) happen while nothing moves.
#ifndef THIGMO_CORE_CONFIG_DERIVED_H_
#define THIGMO_CORE_CONFIG_DERIVED_H_

#include <stdint.h>

#include "../control/fixed_point.h"
#include "configuration.h"

namespace thigmo {

constexpr uint8_t kControlMs = 5;  // one control step of each loop
constexpr int32_t kControlHz = 200;
constexpr uint32_t kDividerOhm = 22000;  // between pin and ground (thesis)

struct Derived {
  int32_t flex_gain_q16[kSensors];        // 1e-5/cm per 1/16 ohm
  int32_t pressure_gain_q24[kSides];      // 0.01 psi per 1/64 count of a sum of five
  uint32_t reversal_inverse_q24[kSides];  // rounded up, so that the whole width gives 256 / 256
  uint16_t lag_alpha_q16[kSides];         // share of the way to the input in one control step
  int32_t drive_slope_q16;                // duty per 0.01 psi
  uint32_t um_per_count_q16;              // tip movement per encoder count
  int32_t slip_counts;
  int32_t tolerance_counts;
  int32_t slew_q8;  // fastest set-point change in a control step, 1/256 of 0.01 psi
  uint16_t stuck_steps;
  uint16_t stall_steps;
  uint16_t enabled_mask;
  bool telemetry_aligned;
  uint8_t oversample_log2;
  uint8_t trigger_log2;

  void update(const Configuration& c) {
    enabled_mask = 0;
    for (uint8_t i = 0; i < kSensors; ++i) {
      // 1e-9/cm per ohm -> 1e-5/cm per 1/16 ohm: / 160000; times 65536 is 256 / 625.
      flex_gain_q16[i] = c.get(Param::kFlexScale, i) * 256 / 625;
      if (c.get(Param::kFlexEnabled, i) != 0) {
        enabled_mask = static_cast<uint16_t>(enabled_mask | (1u << i));
      }
    }
    for (uint8_t side = 0; side < kSides; ++side) {
      pressure_gain_q24[side] =
          static_cast<int32_t>((static_cast<uint64_t>(c.get(Param::kPressureFullCpsi)) << 24) /
                               (static_cast<uint32_t>(c.get(Param::kPressureSpan, side)) * 5u));
      reversal_inverse_q24[side] =
          0x1000000u / static_cast<uint32_t>(c.get(Param::kReversalCpsi, side)) + 1;
      // First-order lag, exact to second order in step / lag; a lag below half a step passes all.
      const int32_t lag = c.get(Param::kLagMs, side);
      const int32_t alpha = 2 * kControlMs * 65536 / (2 * lag + kControlMs);
      lag_alpha_q16[side] = static_cast<uint16_t>(lesser<int32_t>(alpha, 65535));
    }
    // 16 mA of 20 mA is 4/5 of the full duty.
    drive_slope_q16 = static_cast<int32_t>(kDriveFull) * 65536 / 5 * 4 /
                      (c.get(Param::kDrive20maCpsi) - c.get(Param::kDrive4maCpsi));
    um_per_count_q16 = static_cast<uint32_t>((static_cast<uint64_t>(1000000) * 256 << 16) /
                                             (static_cast<uint32_t>(c.get(Param::kCountsPerM)) *
                                              static_cast<uint64_t>(c.get(Param::kPayoutQ8))));
    slip_counts = greater<int32_t>(counts(c.get(Param::kSlipUm)), 2);
    tolerance_counts = greater<int32_t>(counts(c.get(Param::kSpoolToleranceUm)), 1);
    slew_q8 = slew_step_q8(static_cast<uint16_t>(c.get(Param::kPressureSlewCpsiS)));
    stuck_steps = static_cast<uint16_t>(c.get(Param::kStuckMs) / kControlMs);
    stall_steps = static_cast<uint16_t>(c.get(Param::kStallMs) / kControlMs);
    telemetry_aligned = c.get(Param::kTelemetryMs) % kControlMs == 0;
    oversample_log2 = static_cast<uint8_t>(c.get(Param::kOversampleLog2));
    trigger_log2 = static_cast<uint8_t>(c.get(Param::kTriggerFilterLog2));
  }

  // A slew rate as the most change in a control step, 1/256 of 0.01 psi.
  static int32_t slew_step_q8(uint16_t cpsi_s) {
    return greater<int32_t>(static_cast<int32_t>(cpsi_s) * 256 / kControlHz, 1);
  }

  // Encoder counts of a tip movement, rounded to nearest. One 64-bit division.
  int32_t counts(int32_t um) const {
    const int64_t scaled = static_cast<int64_t>(um) * 65536;
    const int64_t half = um_per_count_q16 / 2;
    return static_cast<int32_t>((scaled < 0 ? scaled - half : scaled + half) /
                                static_cast<int64_t>(um_per_count_q16));
  }

  // Tip movement of encoder counts.
  int32_t um(int32_t counts) const {
    return static_cast<int32_t>(
        (static_cast<int64_t>(counts) * static_cast<int64_t>(um_per_count_q16) + 0x8000) >> 16);
  }

  // Tip speed as profile steps: counts per control step, in 1/65536.
  int32_t speed_q16(int32_t um_s) const {
    return static_cast<int32_t>(greater<int64_t>(
        (static_cast<int64_t>(um_s) * 65536 * 65536 / kControlHz) / um_per_count_q16, 1));
  }

  // Tip acceleration as profile steps: counts per control step and step, in 1/65536.
  int32_t accel_q16(int32_t um_s2) const {
    return static_cast<int32_t>(
        greater<int64_t>((static_cast<int64_t>(um_s2) * 65536 * 65536 / (kControlHz * kControlHz)) /
                             um_per_count_q16,
                         1));
  }
};

}  // namespace thigmo

#endif  // THIGMO_CORE_CONFIG_DERIVED_H_
