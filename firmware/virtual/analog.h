// The analog inputs of an emulated board, and their converter: levels become counts at the instants
// of the schedule, with noise, or are replaced by recorded ones.
#ifndef THIGMO_VIRTUAL_ANALOG_H_
#define THIGMO_VIRTUAL_ANALOG_H_

#include <algorithm>
#include <array>
#include <cstdint>
#include <unordered_map>
#include <vector>

#include "../core/board.h"
#include "adc_noise.h"

namespace thigmo {

class Analog {
 public:
  static constexpr int kChannels = kSensors + kMuscles > 16 ? kSensors + kMuscles : 16;

  // A converter's bits, and how long after its tick began a frame is complete.
  Analog(uint64_t seed, uint8_t bits, uint16_t frame_us)
      : seed_(seed), bits_(bits), conversion_us_(frame_us / kAdcSlots) {}

  // Counts in 1/1024 of the reference, at a step's start and end, for each channel.
  void set_levels(const double* counts) {
    for (int c = 0; c < kChannels; ++c) level_[c] = {counts[2 * c], counts[2 * c + 1]};
  }
  void set_noise(const double* sigma) { std::copy(sigma, sigma + kChannels, noise_.begin()); }
  // The step is over: levels stay at its end.
  void settle() {
    for (auto& level : level_) level[0] = level[1];
  }

  // Replaces conversions by recorded ones: tick (since the firmware's start), channel, count.
  void feed(const int64_t* rows, size_t count) {
    fed_.clear();
    for (size_t i = 0; i < count; ++i) {
      fed_[key(static_cast<uint32_t>(rows[3 * i]), static_cast<uint8_t>(rows[3 * i + 1]))] =
          static_cast<uint16_t>(rows[3 * i + 2]);
    }
  }
  void record(bool on) {
    recording_ = on;
    recorded_.clear();
  }
  const std::vector<std::array<int64_t, 3>>& recorded() const { return recorded_; }

  // The conversions of a tick that begins at a share of the step and lasts another.
  AdcFrame frame(uint32_t tick, double start, double duration) {
    AdcFrame frame;
    frame.tick = tick;
    for (uint8_t slot = 0; slot < kAdcSlots; ++slot) {
      const uint8_t channel = adc_channel((tick & 1) != 0, slot);
      frame.count[slot] =
          conversion(tick, channel, start + duration * 1e-3 * (slot * conversion_us_ + kSampleUs));
      if (recording_) recorded_.push_back({tick, channel, frame.count[slot]});
    }
    return frame;
  }

 private:
  static constexpr uint64_t kSampleUs = 12;  // sample-and-hold: 1.5 clocks of 125 kHz

  static uint64_t key(uint32_t tick, uint8_t channel) {
    return static_cast<uint64_t>(tick) * kChannels + channel;
  }

  uint16_t conversion(uint32_t tick, uint8_t channel, double share) const {
    if (!fed_.empty()) {
      const auto sample = fed_.find(key(tick, channel));
      if (sample != fed_.end()) return sample->second;
    }
    double ideal = level_[channel][0] + (level_[channel][1] - level_[channel][0]) * share;
    if (noise_[channel] > 0.0) ideal += noise_[channel] * adc_noise(seed_, tick, channel);
    ideal *= 1u << (bits_ - kAdcBits);
    const uint16_t top = static_cast<uint16_t>((1u << bits_) - 1);
    if (!(ideal > 0.0)) return 0;
    return ideal >= top ? top : static_cast<uint16_t>(ideal);
  }

  const uint64_t seed_;
  const uint8_t bits_;
  const uint64_t conversion_us_;
  bool recording_ = false;
  std::array<std::array<double, 2>, kChannels> level_{};
  std::array<double, kChannels> noise_{};
  std::unordered_map<uint64_t, uint16_t> fed_;
  std::vector<std::array<int64_t, 3>> recorded_;
};

}  // namespace thigmo

#endif  // THIGMO_VIRTUAL_ANALOG_H_
