// Flex sensors: from conversions to readings, resistance and curvature.
//
// Divider: 5 V - sensor - pin - 22 kOhm - ground, so the count is 1024 * 22k / (22k + R), floored;
// half a count is added back to the mean. Curvature is scale * (R - R at the last zeroing): one
// division of 32 bits a reading, no float.
#ifndef THIGMO_CORE_SENSING_FLEX_H_
#define THIGMO_CORE_SENSING_FLEX_H_

#include <stdint.h>

#include "../board.h"
#include "../config/derived.h"
#include "../control/fixed_point.h"

namespace thigmo {

// A mean count, half a count added, in 1/64: 32..65504. From a sum of 2^log2 conversions.
inline uint16_t count_q6(uint32_t sum, uint8_t log2) {
  // Up to 64 conversions, 16 bits hold the sum.
  const uint16_t scaled = log2 <= 6
                              ? static_cast<uint16_t>(static_cast<uint16_t>(sum) << (6 - log2))
                              : static_cast<uint16_t>(sum >> (log2 - 6));
  return static_cast<uint16_t>(scaled + 32);
}

// The next bits of a long division by hand: quotient bits of remainder << bits, remainder <
// divisor.
__attribute__((always_inline)) inline uint8_t next_bits(uint16_t* remainder, uint16_t divisor,
                                                        uint8_t bits) {
  uint16_t left = *remainder;
  uint8_t quotient = 0;
  for (; bits != 0; --bits) {
    const bool carry = (left & 0x8000u) != 0;
    left = static_cast<uint16_t>(left << 1);
    quotient = static_cast<uint8_t>(quotient << 1);
    if (carry || left >= divisor) {
      left = static_cast<uint16_t>(left - divisor);
      ++quotient;
    }
  }
  *remainder = left;
  return quotient;
}

// Sensor resistance plus divider in 1/16 ohm: 22 kOhm * 1024 / count, which is 22000 << 20 over a
// count in 1/64. Divided by hand, bit by bit with a 16-bit remainder: a third of the time that an
// AVR's library takes for 32 bits, and the trigger needs it every second millisecond.
THIGMO_NOINLINE inline int32_t total_ohm_q4(uint16_t count) {
  static_assert(kDividerOhm < 0x8000, "the remainder must fit 16 bits");
  uint16_t remainder = static_cast<uint16_t>(kDividerOhm);
  uint32_t quotient = 0;
  if (remainder >= count) {  // sensors above 43 kOhm
    quotient = static_cast<uint32_t>(remainder / count) << 20;
    remainder = static_cast<uint16_t>(remainder % count);
  }
  const uint8_t high = next_bits(&remainder, count, 4);
  const uint8_t middle = next_bits(&remainder, count, 8);
  const uint8_t low = next_bits(&remainder, count, 8);
  quotient |= static_cast<uint32_t>(high) << 16 | static_cast<uint16_t>(middle << 8) | low;
  return static_cast<int32_t>(quotient);
}

// The same from a zero, which is stored in 1/256 of a sum of 2^log2 conversions: 22000 << (23 +
// log2) over twice the zero plus half a count for each conversion.
inline int32_t total_ohm_q4_of_zero(uint32_t zero_sum_q8, uint8_t log2) {
  const uint32_t count = zero_sum_q8 * 2 + (static_cast<uint32_t>(256) << log2);  // below 2^26
  return static_cast<int32_t>(long_quotient(kDividerOhm, count, static_cast<uint8_t>(23 + log2)));
}

// Curvature in 1e-5/cm of two total resistances, saturated.
inline int16_t curvature_e5(int32_t total, int32_t total_at_zero, int32_t gain_q16) {
  const int32_t change = limited<int32_t>(total - total_at_zero, -2000000, 2000000);
  // Usual bends and gains fit 32 bits, which an AVR multiplies in a third of the time.
  if (change > -65536 && change < 65536 && gain_q16 > -32768 && gain_q16 < 32768) {
    return saturated16((change * static_cast<int16_t>(gain_q16) + 0x8000) >> 16);
  }
  return saturated16(
      multiply_q16(change < 0 ? -gain_q16 : gain_q16, static_cast<uint32_t>(magnitude(change))));
}

// Sums conversions of the sensors into readings, and watches their wires.
class FlexReadings {
 public:
  // Conversions outside the plausible band that make an open or short circuit: so many in a row, or
  // a fourth of all for long enough, as LeakyCount has it; here beside the sign of the last one.
  static constexpr uint8_t kBadLimit = 25;
  static constexpr uint8_t kBadMemory = 3;
  static constexpr uint16_t kOpenBelow = 16;     // R > 1.4 MOhm
  static constexpr uint16_t kShortAbove = 1000;  // R < 530 Ohm

  void set_oversampling(uint8_t log2) {
    if (full_ != 0 && log2 == log2_) return;
    log2_ = log2;
    full_ = static_cast<uint8_t>(1u << log2);
    restart();
    for (uint8_t i = 0; i < kSensors; ++i) channels_[i].latest = 0;
    ready_ = 0;
  }

  // Drops half-done sums, so that the next readings begin now.
  void restart() {
    for (uint8_t i = 0; i < kSensors; ++i) channels_[i].sum = 0;
    base_taken_ = 0;
    taken_[0] = taken_[1] = 0;
  }

  // Takes a tick's flex conversions, in the order of adc_channel(). Returns the sensors whose
  // readings they completed, as bits.
  uint16_t add_tick(bool odd, const uint16_t* count) {
    constexpr uint16_t kOthers = ((1u << (kColumn - 1)) - 1) << 1;  // of the first column
    // The base sensors are converted in each tick, either column's others in every second.
    const bool base_full = full(&base_taken_);
    for (uint8_t i = 0; i < kColumns; ++i) add(channels_ + base_input(i), count[i], base_full);
    const bool column_full = full(&taken_[odd]);
    Channel* channel = channels_ + (odd ? kColumn + 1 : 1);
    for (uint8_t i = kColumns; i < kColumns + kColumn - 1; ++i, ++channel)
      add(channel, count[i], column_full);
    uint16_t done = base_full ? 1u << 0 | 1u << kColumn : 0;
    if (column_full) done |= odd ? kOthers << kColumn : kOthers;
    ready_ |= done;
    return done;
  }

  // Adds sensors' latest readings, by bits, to sums and counts of all sensors.
  THIGMO_NOINLINE void add_to(uint32_t* sum, uint16_t* taken, uint16_t sensors) const {
    const Channel* channel = channels_;
    for (; sensors != 0; sensors = static_cast<uint16_t>(sensors >> 1)) {
      if ((sensors & 1) != 0) {
        *sum += channel->latest;
        ++*taken;
      }
      ++channel;
      ++sum;
      ++taken;
    }
  }

  uint16_t latest(uint8_t sensor) const { return channels_[sensor].latest; }  // sum of 2^log2
  bool all_ready() const { return ready_ == (1u << kSensors) - 1; }
  uint8_t log2() const { return log2_; }
  bool open(uint8_t sensor) const { return channels_[sensor].bad == -kBadFull; }
  bool shorted(uint8_t sensor) const { return channels_[sensor].bad == kBadFull; }
  bool any_bad() const { return bad_count_ != 0; }  // some sensor is open or shorted

 private:
  struct Channel {
    uint16_t sum;
    uint16_t latest;
    int8_t bad;  // count of bad conversions; negative if the last was below the plausible band
  };
  static constexpr int8_t kBadFull = kBadLimit * kBadMemory;

  // Counts a conversion; true when it is a reading's last.
  bool full(uint8_t* taken) const {
    if (++*taken < full_) return false;
    *taken = 0;
    return true;
  }

  void add(Channel* channel, uint16_t count, bool full) {
    // One comparison for both ends of the band.
    if (static_cast<uint16_t>(count - kOpenBelow) > kShortAbove - kOpenBelow) {
      watch(channel, count < kOpenBelow);
    } else if (channel->bad != 0) {
      recover(channel);
    }
    channel->sum = static_cast<uint16_t>(channel->sum + count);
    if (!full) return;
    channel->latest = channel->sum;
    channel->sum = 0;
  }

  // Counts an implausible conversion. One that is open and shorted in turn is bad all the time.
  void watch(Channel* channel, bool open) {
    int8_t size = static_cast<int8_t>(channel->bad < 0 ? -channel->bad : channel->bad);
    if (size != kBadFull) {
      size = static_cast<int8_t>(lesser<int16_t>(size + kBadMemory, kBadFull));
      if (size == kBadFull) ++bad_count_;
    }
    channel->bad = static_cast<int8_t>(open ? -size : size);
  }

  void recover(Channel* channel) {
    if (channel->bad == kBadFull || channel->bad == -kBadFull) --bad_count_;
    channel->bad = static_cast<int8_t>(channel->bad + (channel->bad < 0 ? 1 : -1));
  }

  Channel channels_[kSensors] = {};
  uint16_t ready_ = 0;
  uint8_t base_taken_ = 0;  // conversions in the running sums
  uint8_t taken_[kColumns] = {};
  uint8_t bad_count_ = 0;
  uint8_t full_ = 0;  // conversions in a reading
  uint8_t log2_ = 0;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_SENSING_FLEX_H_
