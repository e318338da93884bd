// Noise of one analog conversion, as a pure function of (seed, tick, channel), so that the virtual
// board and the simulated Mega see identical counts however their exchanges are cut. C and C++.
//
// Sum of twelve uniform 16-bit numbers (Irwin-Hall), integers only: the same bits on any machine.
// Mean 0, standard deviation 1 (to 1e-5), never beyond +-6; the tails are thinner than a Gaussian's
// from 3 on (beyond 4: 1.3e-5 instead of 6.3e-5, both sides together).
#ifndef THIGMO_VIRTUAL_ADC_NOISE_H_
#define THIGMO_VIRTUAL_ADC_NOISE_H_

#include <stdint.h>

// SplitMix64's output function (Steele, Lea, Flood 2014).
static inline uint64_t adc_noise_mix(uint64_t z) {
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ull;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBull;
  return z ^ (z >> 31);
}

static inline double adc_noise(uint64_t seed, uint64_t tick, uint32_t channel) {
  const uint64_t step = 0x9E3779B97F4A7C15ull;
  uint64_t state = adc_noise_mix(adc_noise_mix(seed + step) ^ (tick * 16u + channel + 1u));
  int64_t sum = 0;
  for (int word = 0; word < 3; word++) {
    state += step;
    const uint64_t bits = adc_noise_mix(state);
    sum += (int64_t)(bits & 0xFFFF) + (int64_t)(bits >> 16 & 0xFFFF) +
           (int64_t)(bits >> 32 & 0xFFFF) + (int64_t)(bits >> 48);
  }
  return (double)(2 * sum - 12 * 65535) / 131072.0;
}

#endif  // THIGMO_VIRTUAL_ADC_NOISE_H_
