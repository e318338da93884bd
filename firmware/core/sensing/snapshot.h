// Captured readings: one at the trigger, ten around a sweep's peak.
//
// There is one peak buffer: the peak captured last wins. The host has half a sweep period, less the
// peak's own length, to fetch it before the next muscle's peak begins to overwrite it, and each
// snapshot names its muscle.
#ifndef THIGMO_CORE_SENSING_SNAPSHOT_H_
#define THIGMO_CORE_SENSING_SNAPSHOT_H_

#include <stdint.h>

#include "../board.h"

namespace thigmo {

struct Reading {
  uint32_t t_us;
  uint16_t flex_sum[kSensors];
  int16_t cpsi[kMuscles];
  int16_t lagged_cpsi;
  int16_t base_e5;
  int16_t free_e5;
  uint8_t muscle;
  protocol::Branch branch;
};

constexpr uint8_t kPeakReadings = 10;
constexpr uint8_t kTriggerSnapshot = 255;

class Snapshots {
 public:
  void store_trigger(const Reading& reading) {
    trigger_ = reading;
    triggered_ = true;
  }

  // Plans ten readings, `spacing` ticks apart, the first at a tick.
  void plan_peak(uint32_t first_tick, uint16_t spacing) {
    next_tick_ = first_tick;
    spacing_ = spacing;
    planned_ = true;
    begun_ = false;
  }

  void cancel_peak() { planned_ = false; }

  // Whether a planned reading falls on this tick (or was missed by a dropped frame).
  bool due(uint32_t tick) const { return planned_ && static_cast<int32_t>(tick - next_tick_) >= 0; }

  // Stores a due reading; true when it was the last of ten.
  bool store_peak(const Reading& reading) {
    if (!begun_) {
      begun_ = true;
      count_ = 0;
    }
    peak_[count_++] = reading;
    next_tick_ += spacing_;
    if (count_ < kPeakReadings) return false;
    planned_ = false;
    return true;
  }

  uint8_t count() const { return count_; }

  // By index as in get_snapshot; null when there is none.
  const Reading* find(uint8_t index) const {
    if (index == kTriggerSnapshot) return triggered_ ? &trigger_ : nullptr;
    return index < count_ ? &peak_[index] : nullptr;
  }

 private:
  Reading peak_[kPeakReadings] = {};
  Reading trigger_ = {};
  uint32_t next_tick_ = 0;
  uint16_t spacing_ = 0;
  uint8_t count_ = 0;
  bool planned_ = false;
  bool begun_ = false;
  bool triggered_ = false;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_SENSING_SNAPSHOT_H_
