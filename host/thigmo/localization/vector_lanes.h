// Vector code: how the kernel weighs several sets of places at once, and all that knows of it.
//
// The evidence of a set of places takes a few dozen multiplications, and a frame has thousands of
// sets. Numbers of neighbouring sets stand side by side in memory, so that one instruction of the
// processor computes four of them (AVX2), or eight (AVX-512), where plain code computes one. Plain
// code takes three to eight times as long. What is needed for that is here:
//
// - `Lanes<N>::Type` is a vector of N numbers, by the compilers' extension. `+`, `*`, `>` and
//   `a > b ? a : b` act on all lanes at once, so equations read as for a single number.
//   `lanes<N>(pointer)` takes N numbers from memory or puts them there; their address needs no
//   alignment. `Numbers{}` is zero in all lanes, and `x + Numbers{}` is x in all lanes.
// - `THIGMO_WIDE` compiles a function twice, with and without AVX2. `THIGMO_WIDEST` makes of a
//   template `name_by<N>` the function `name`, which takes eight numbers at once, four, or four
//   emulated ones, as the processor can. Which one runs is decided when the library is loaded.
// - `exponential`, `root` and `normal_integral` do for lanes what the library's functions do for a
//   number, since calls and branches would undo the gain. They are made of sums and products only.
//
// Answers do not depend on how many numbers a processor takes at once: multiplications and
// additions are not fused (CMakeLists.txt), sums over sets are taken in fours on every path, and
// each lane goes through the same operations. Where the compiler or the processor has none of this,
// the same code runs on emulated vectors.
//
// Whoever changes this measures it: `thigmo bench scaling` has the time of an answer.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#if defined(__x86_64__) && defined(__GLIBC__)
// Compiled for wide vectors too, and chosen when the library is loaded: the same numbers, sooner.
#define THIGMO_WIDE __attribute__((target_clones("avx2", "default")))
// A function of whose template `name`_by<N> takes as many numbers at once as the processor can.
#define THIGMO_WIDEST(result, name, parameter, argument)                          \
  __attribute__((target("avx512f"))) result name##_by_eight(parameter) {          \
    return name##_by<8>(argument);                                                \
  }                                                                               \
  THIGMO_WIDE result name##_by_four(parameter) { return name##_by<4>(argument); } \
  result name(parameter) {                                                        \
    static const bool eight = __builtin_cpu_supports("avx512f");                  \
    return eight ? name##_by_eight(argument) : name##_by_four(argument);          \
  }
#else
#define THIGMO_WIDE
#define THIGMO_WIDEST(result, name, parameter, argument) \
  result name(parameter) { return name##_by<4>(argument); }
#endif

namespace thigmo {

using Row = std::vector<double>;

template <int>
struct Lanes;
template <>
struct Lanes<4> {
  using Type [[gnu::vector_size(32), gnu::aligned(8)]] = double;
};
template <>
struct Lanes<8> {
  using Type [[gnu::vector_size(64), gnu::aligned(8)]] = double;
};
using Four = Lanes<4>::Type;
using Eight = Lanes<8>::Type;
template <int N>
[[gnu::always_inline]] inline const typename Lanes<N>::Type& lanes(const double* number) {
  return *reinterpret_cast<const typename Lanes<N>::Type*>(number);
}
template <int N>
[[gnu::always_inline]] inline typename Lanes<N>::Type& lanes(double* number) {
  return *reinterpret_cast<typename Lanes<N>::Type*>(number);
}
inline const Four& four(const double* number) { return lanes<4>(number); }
inline Four& four(double* number) { return lanes<4>(number); }

// Roots, of zero where a number is less.
[[gnu::always_inline]] inline Four root(Four value) {
  value = value > 0.0 ? value : Four{};
  return Four{std::sqrt(value[0]), std::sqrt(value[1]), std::sqrt(value[2]), std::sqrt(value[3])};
}
[[gnu::always_inline]] inline Eight root(Eight value) {
  value = value > 0.0 ? value : Eight{};
  return Eight{std::sqrt(value[0]), std::sqrt(value[1]), std::sqrt(value[2]), std::sqrt(value[3]),
               std::sqrt(value[4]), std::sqrt(value[5]), std::sqrt(value[6]), std::sqrt(value[7])};
}

inline double largest(const Four& value) {
  return std::max(std::max(value[0], value[1]), std::max(value[2], value[3]));
}

// e^x for x up to 700, to 11 digits; what is below e^-200 counts as that. Without branches or
// calls, and the same on every machine.
template <class Numbers>
[[gnu::always_inline]] inline Numbers exponential(Numbers x) {
  using Bits = decltype(x > x);
  constexpr double kShift = 6755399441055744.0;  // 1.5 * 2^52: adding it rounds to a whole number
  x = x > -200.0 ? x : -200.0 + Numbers{};
  const Numbers shifted = x * std::numbers::log2e + kShift, whole = shifted - kShift;
  // The rest, at most ln(2) / 2, by Taylor's series.
  const Numbers r = (x - whole * 0x1.62e42fefa0000p-1) - whole * 0x1.cf79abc9e3b3ap-40;
  constexpr std::array kTerms{1.0,           1.0,           1.0 / 2.0,   1.0 / 6.0,
                              1.0 / 24.0,    1.0 / 120.0,   1.0 / 720.0, 1.0 / 5040.0,
                              1.0 / 40320.0, 1.0 / 362880.0};
  Numbers sum = kTerms.back() + Numbers{};
  for (int k = 8; k >= 0; --k) sum = sum * r + kTerms[k];
  return sum * Numbers((Bits(shifted) + 1023) << 52);
}

// Of a whole number of fours.
THIGMO_WIDE inline double largest(const double* value, int count) {
  Four top = four(value);
  for (int s = 4; s < count; s += 4) top = four(value + s) > top ? four(value + s) : top;
  return largest(top);
}

// Sum of what is `least` or more, of a whole number of fours.
THIGMO_WIDE inline double sum_from(double least, const Row& value) {
  Four sum{};
  for (std::size_t s = 0; s < value.size(); s += 4) {
    const Four& values = four(&value[s]);
    sum += values >= least ? values : Four{};
  }
  return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

// Probability that a standard normal number is below `deviate`, to 2e-7 (Abramowitz and Stegun,
// 7.1.26).
template <class Numbers>
[[gnu::always_inline]] inline Numbers normal_integral(Numbers deviate) {
  const Numbers size = deviate > 0.0 ? deviate : -deviate;
  const Numbers t = 1.0 / (1.0 + 0.3275911 / std::numbers::sqrt2 * size);
  const Numbers series =
      ((((1.061405429 * t - 1.453152027) * t + 1.421413741) * t - 0.284496736) * t + 0.254829592) *
      t;
  const Numbers beyond = 0.5 * series * exponential(-0.5 * deviate * deviate);
  return deviate > 0.0 ? 1.0 - beyond : beyond;
}

}  // namespace thigmo
