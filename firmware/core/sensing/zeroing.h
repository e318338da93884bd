// Sensor zeros, and the drift that forbids taking them.
//
// Drift is the change of a sensor's mean between two windows of about 2 s that lie back to back in
// a quiet time (vented, spool still): with 1.5 counts of noise that is 5e-5 1/cm/s of standard
// deviation, an eighth of the default limit, which one second could not give. Windows slide on by
// one when full, so the drift is known about 4 s after the robot came to rest, and stays fresh.
#ifndef THIGMO_CORE_SENSING_ZEROING_H_
#define THIGMO_CORE_SENSING_ZEROING_H_

#include <stdint.h>

#include "flex.h"

namespace thigmo {

class DriftWatch {
 public:
  static constexpr uint16_t kWindowMs = 2000;

  // Once a control period: whether the robot is vented and still. A disturbance starts it over;
  // what was measured stays readable.
  void set_quiet(bool quiet, uint32_t tick) {
    if (quiet == quiet_) return;
    quiet_ = quiet;
    windows_ = 0;
    pending_ = kSensors;
    begin_window(tick);
  }

  // Drops the running window and begins one now; the one before it still counts.
  void begin_window(uint32_t tick) {
    begun_ = tick;
    for (uint8_t i = 0; i < kSensors; ++i) {
      sum_[i] = 0;
      taken_[i] = 0;
    }
  }

  // Takes the readings (sums of 2^log2) that were completed, by bits.
  void add(uint16_t done, const FlexReadings& flex) {
    if (quiet_) flex.add_to(sum_, taken_, done);
  }

  // Once a control period; closes a full window. The divisions are spread over ten of them.
  void update(uint32_t tick, uint8_t log2, const int32_t* gain_q16) {
    if (pending_ < kSensors) {
      settle_account(pending_, log2, gain_q16[pending_]);
      ++pending_;
      if (pending_ == kSensors) {
        ++closed_count_;
        if (windows_ < 2) ++windows_;
      }
      return;
    }
    if (!quiet_ || tick - begun_ < kWindowMs) return;
    for (uint8_t i = 0; i < kSensors; ++i) {
      closed_[i] = sum_[i];
      closed_taken_[i] = taken_[i];
    }
    apart_ms_ = begun_ - closed_begun_;
    closed_begun_ = begun_;
    begin_window(tick);
    pending_ = 0;
  }

  bool known() const { return windows_ >= 2; }      // two windows since the last disturbance
  uint8_t closed() const { return closed_count_; }  // windows so far; wraps
  int16_t drift_e5_s(uint8_t sensor) const { return drift_e5_s_[sensor]; }

 private:
  void settle_account(uint8_t i, uint8_t log2, int32_t gain_q16) {
    if (closed_taken_[i] == 0) return;
    // Mean count in 1/64 with half a count added; the sum of one window fits 32 bits shifted by 6
    // only because 2 s hold 2000 conversions of 10 bits.
    const uint32_t conversions = static_cast<uint32_t>(closed_taken_[i]) << log2;
    const uint16_t count = static_cast<uint16_t>((closed_[i] << 6) / conversions + 32);
    const int32_t total = total_ohm_q4(count);
    if (windows_ > 0) {
      drift_e5_s_[i] =
          saturated16(static_cast<int32_t>(curvature_e5(total, last_total_[i], gain_q16)) * 1000 /
                      static_cast<int32_t>(apart_ms_));
    }
    last_total_[i] = total;
  }

  uint32_t sum_[kSensors] = {};
  uint32_t closed_[kSensors] = {};
  int32_t last_total_[kSensors] = {};
  uint16_t taken_[kSensors] = {};
  uint16_t closed_taken_[kSensors] = {};
  int16_t drift_e5_s_[kSensors] = {};
  uint32_t begun_ = 0;
  uint32_t closed_begun_ = 0;
  uint32_t apart_ms_ = kWindowMs;  // from window to window
  uint8_t pending_ = kSensors;
  uint8_t windows_ = 0;
  uint8_t closed_count_ = 0;
  bool quiet_ = false;
};

// The zeros, and their averaging.
class SensorZeros {
 public:
  void begin(uint16_t mask) {
    mask_ = mask;
    for (uint8_t i = 0; i < kSensors; ++i) {
      sum_[i] = 0;
      taken_[i] = 0;
    }
  }

  // Takes the readings (sums of 2^log2) that were completed, by bits. At most 10 s of them, so that
  // no count runs over.
  void add(uint16_t done, const FlexReadings& flex) {
    flex.add_to(sum_, taken_, static_cast<uint16_t>(done & mask_));
  }

  // Turns the average of one sensor into its zero; call for each sensor, one a tick (64-bit
  // division). Sensors without a reading keep their old state.
  void finish(uint8_t sensor, uint8_t log2) {
    if ((mask_ >> sensor & 1) == 0 || taken_[sensor] == 0) return;
    // At most 10 s of conversions: 10 000 * 1023 * 256 fits 32 bits.
    zero_sum_q8_[sensor] = sum_[sensor] * 256u / taken_[sensor];
    total_at_zero_[sensor] = total_ohm_q4_of_zero(zero_sum_q8_[sensor], log2);
    valid_ = static_cast<uint16_t>(valid_ | (1u << sensor));
  }

  // Voids zeros: the sensors everted again, or readings changed their scale.
  void invalidate(uint16_t mask) { valid_ = static_cast<uint16_t>(valid_ & ~mask); }

  uint16_t valid_mask() const { return valid_; }
  uint16_t mask() const { return mask_; }
  uint32_t zero_sum_q8(uint8_t sensor) const { return zero_sum_q8_[sensor]; }
  int32_t total_at_zero(uint8_t sensor) const { return total_at_zero_[sensor]; }

 private:
  uint32_t sum_[kSensors] = {};
  uint32_t zero_sum_q8_[kSensors] = {};
  int32_t total_at_zero_[kSensors] = {};
  uint16_t taken_[kSensors] = {};
  uint16_t mask_ = 0;
  uint16_t valid_ = 0;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_SENSING_ZEROING_H_
