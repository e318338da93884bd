// The contact trigger: base curvature away from free curvature for long enough.
//
// While a muscle bends the body only a base that is held back counts: what stands in the way of a
// bend takes curvature from it. A base that bends further than the map says is the map's error. A
// body at rest may be pushed either way; one that still swings back from a bend tells nothing.
//
// Works on the base sensors' conversions of every tick, averaged over the last 2^n of them, because
// one ADC count is a third of the threshold. The average of more than 32 samples moves in blocks of
// 2^(n-5) samples, so that 32 places a sensor hold any width.
#ifndef THIGMO_CORE_SENSING_TRIGGER_H_
#define THIGMO_CORE_SENSING_TRIGGER_H_

#include <stdint.h>

#include "../control/fixed_point.h"

namespace thigmo {

// Mean of the last 2^log2 samples of one sensor.
class MovingSum {
 public:
  static constexpr uint8_t kPlaces = 32;

  void start(uint8_t log2) {
    places_ = static_cast<uint8_t>(log2 > 5 ? kPlaces : 1u << log2);
    block_samples_ = static_cast<uint8_t>(log2 > 5 ? 1u << (log2 - 5) : 1u);
    next_ = 0;
    filled_ = 0;
    in_block_ = 0;
    block_ = 0;
    sum_ = 0;
    for (uint8_t i = 0; i < kPlaces; ++i) ring_[i] = 0;
  }

  void add(uint16_t sample) {
    if (block_samples_ != 1) {
      block_ = static_cast<uint16_t>(block_ + sample);
      if (++in_block_ < block_samples_) return;
      sample = block_;
      block_ = 0;
      in_block_ = 0;
    }
    uint16_t& place = ring_[next_];
    sum_ += sample;
    sum_ -= place;
    place = sample;
    next_ = static_cast<uint8_t>((next_ + 1) & (places_ - 1));
    if (filled_ != places_) ++filled_;
  }

  bool full() const { return filled_ == places_; }
  uint32_t sum() const { return sum_; }  // of 2^log2 samples, once full

 private:
  uint16_t ring_[kPlaces] = {};
  uint32_t sum_ = 0;
  uint16_t block_ = 0;
  uint8_t in_block_ = 0;
  uint8_t next_ = 0;
  uint8_t filled_ = 0;
  uint8_t places_ = 1;
  uint8_t block_samples_ = 1;
};

// Debounce and latch.
class ContactTrigger {
 public:
  // One sample of the curvature that is missing or in excess; true when it fires. It fires once,
  // until rearm().
  bool update(int32_t excess_e5, int32_t threshold_e5, uint16_t debounce_samples) {
    if (excess_e5 <= threshold_e5) {
      run_ = 0;
      return false;
    }
    if (run_ < debounce_samples) ++run_;
    if (latched_ || run_ < debounce_samples) return false;
    latched_ = true;
    return true;
  }

  // The reading is unusable now: what was counted so far does not count.
  void interrupt() { run_ = 0; }

  void rearm() {
    run_ = 0;
    latched_ = false;
  }

  bool latched() const { return latched_; }

 private:
  uint16_t run_ = 0;
  bool latched_ = false;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_SENSING_TRIGGER_H_
