// Counts bad samples and forgets them more slowly: the detector of whatever lies now and then.
//
// A run that starts anew at one good sample never ends for a wire that chatters, or for a sensor
// that is true for a moment. Here a good sample takes 1 / kMemory of a bad one away. Bad samples in
// a row are noticed as by a run; and so is a lasting share of bad ones above 1 / (1 + kMemory),
// however they are spread (a CUSUM with two values; Page 1954).
#ifndef THIGMO_CORE_SAFETY_LEAKY_COUNT_H_
#define THIGMO_CORE_SAFETY_LEAKY_COUNT_H_

#include <stdint.h>

namespace thigmo {

// kMemory: good samples that forgive a bad one. Count holds kMemory times the largest limit.
template <typename Count, Count kMemory>
class LeakyCount {
 public:
  // Takes a sample. `limit` is in bad samples; one may weigh as much as several.
  void add(bool bad, uint16_t limit, uint8_t weight = 1) {
    if (!bad) {
      if (count_ != 0) --count_;
      return;
    }
    const Count most = static_cast<Count>(limit * kMemory);
    const Count step = static_cast<Count>(weight * kMemory);
    count_ = count_ < most && most - count_ > step ? static_cast<Count>(count_ + step) : most;
  }

  // The limit is reached, and the last sample was a bad one.
  bool full(uint16_t limit) const { return count_ >= static_cast<Count>(limit * kMemory); }

  void clear() { count_ = 0; }

 private:
  Count count_ = 0;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_SAFETY_LEAKY_COUNT_H_
