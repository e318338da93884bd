// Fixed-point arithmetic with explicit widths, and the sine table.
//
// Every board must compute the same integers, and `int` has 16 bits on an AVR, so all products are
// taken in a named width and nothing here uses float or libm. Right shifts of negative numbers are
// arithmetic in every compiler that builds this (gcc, clang), and round down.
#ifndef THIGMO_CORE_CONTROL_FIXED_POINT_H_
#define THIGMO_CORE_CONTROL_FIXED_POINT_H_

#include <stdint.h>

#include "../flash.h"

namespace thigmo {

// The lesser and the greater of two numbers, and a number limited to a range.
template <typename T>
constexpr T lesser(T a, T b) {
  return a < b ? a : b;
}
template <typename T>
constexpr T greater(T a, T b) {
  return a < b ? b : a;
}
template <typename T>
constexpr T limited(T value, T low, T high) {
  return value < low ? low : (high < value ? high : value);
}

constexpr int32_t magnitude(int32_t value) { return value < 0 ? -value : value; }

constexpr int16_t saturated16(int32_t value) {
  return static_cast<int16_t>(limited<int32_t>(value, -32768, 32767));
}

// value >> kShift, 8 < kShift < 16, when that fits 16 bits. An AVR shifts by whole bytes for
// nothing, and by other numbers bit by bit: so the few bits that lack 16 are shifted the other way
// first.
template <uint8_t kShift>
constexpr int16_t shifted16(int32_t value) {
  static_assert(kShift > 8 && kShift < 16, "other shifts are as quick as they are");
  return static_cast<int16_t>(value * (int32_t{1} << (16 - kShift)) >> 16);
}

// A number with 12 fraction bits; shifted by bytes and back, for the same reason.
constexpr int32_t q12(int16_t value) { return static_cast<int32_t>(value) * 65536 >> 4; }

// a * b / 65536, rounded to nearest; the result must fit 32 bits. By halves, in a third of the time
// that an AVR's library takes for 64 bits.
THIGMO_NOINLINE inline int32_t multiply_q16(int32_t a, uint32_t b) {
  const uint16_t low_a = static_cast<uint16_t>(a);
  const uint16_t low_b = static_cast<uint16_t>(b);
  const uint16_t high_b = static_cast<uint16_t>(b >> 16);
  const uint32_t high = static_cast<uint32_t>(static_cast<int32_t>(a >> 16)) * b;
  const uint32_t middle = static_cast<uint32_t>(low_a) * high_b;
  const uint32_t low = (static_cast<uint32_t>(low_a) * low_b + 0x8000u) >> 16;
  return static_cast<int32_t>(high + middle + low);  // what is carried away is never missed
}

// A number of 48 bits: whole ones and 1/65536. An AVR's library takes several times as long for 64.
struct Fine {
  int32_t whole;
  uint16_t fraction;

  void add(int32_t q16) {
    const uint32_t low = static_cast<uint32_t>(fraction) + static_cast<uint16_t>(q16);
    fraction = static_cast<uint16_t>(low);
    whole += static_cast<int16_t>(q16 >> 16);
    whole += static_cast<uint8_t>(low >> 16);
  }
  bool zero() const { return whole == 0 && fraction == 0; }
  bool less(const Fine& other) const {
    return whole != other.whole ? whole < other.whole : fraction < other.fraction;
  }
};

// a * b / 65536, rounded down, for a share b below 1: two products of 16 bits.
inline int32_t share_q16(int32_t a, uint16_t b) {
  const int32_t high = static_cast<int16_t>(a >> 16) * static_cast<int32_t>(b);
  const uint32_t low = static_cast<uint32_t>(static_cast<uint16_t>(a)) * b;
  return high + static_cast<int32_t>(low >> 16);
}

// (numerator << bits) / denominator, rounded down, for denominators below 2^31: a long division by
// hand, in a third of the time that an AVR's library takes for 64 bits.
THIGMO_NOINLINE inline uint32_t long_quotient(uint32_t numerator, uint32_t denominator,
                                              uint8_t bits) {
  uint32_t quotient = 0;
  uint32_t remainder = numerator;
  if (remainder >= denominator) {
    quotient = remainder / denominator;
    remainder %= denominator;
  }
  for (; bits > 0; --bits) {
    remainder <<= 1;
    quotient <<= 1;
    if (remainder >= denominator) {
      remainder -= denominator;
      quotient |= 1;
    }
  }
  return quotient;
}

// A sum over control steps of gain (1/256) times error, as an output: sum / (256 * 200). Dividing
// by 25 is multiplying by 20972 / 2^19, but for 2e-5 of it; good for sums below 2^26.
inline int16_t integral_output(int32_t sum) {
  const int32_t product = static_cast<int32_t>(shifted16<11>(sum)) * int16_t{20972};
  return static_cast<int16_t>(static_cast<int16_t>(product >> 16) >> 3);
}

// sin(phase) for phase = 0 .. 2^31 standing for 0 .. pi, in 1/32768. Linear between 64 points a
// quarter: off by at most 1.1e-4, 0.002 psi of an 18 psi sweep.
constexpr uint16_t kQuarterSine[65] THIGMO_PROGMEM = {
    0,     804,   1608,  2411,  3212,  4011,  4808,  5602,  6393,  7180,  7962,  8740,  9512,
    10279, 11039, 11793, 12540, 13279, 14010, 14733, 15447, 16151, 16846, 17531, 18205, 18868,
    19520, 20160, 20788, 21403, 22006, 22595, 23170, 23732, 24279, 24812, 25330, 25833, 26320,
    26791, 27246, 27684, 28106, 28511, 28899, 29269, 29622, 29957, 30274, 30572, 30853, 31114,
    31357, 31581, 31786, 31972, 32138, 32286, 32413, 32522, 32610, 32679, 32729, 32758, 32768};

inline uint16_t half_sine(uint32_t phase) {
  const uint32_t folded = phase <= 0x40000000u ? phase : 0x80000000u - phase;
  if (folded >= 0x40000000u) return folded == 0x40000000u ? 32768 : 0;  // the peak; no such phase
  const uint8_t index = static_cast<uint8_t>(folded >> 24);
  const uint16_t below = THIGMO_FLASH_U16(kQuarterSine + index);
  const uint16_t above = THIGMO_FLASH_U16(kQuarterSine + index + 1);
  const uint32_t fraction = (folded >> 8) & 0xFFFFu;
  return static_cast<uint16_t>(below + (((above - below) * fraction + 0x8000u) >> 16));
}

}  // namespace thigmo

#endif  // THIGMO_CORE_CONTROL_FIXED_POINT_H_
