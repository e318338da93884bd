// Parameters that were set and not applied yet.
//
// The host sets parameters one by one, and what is valid between two of them may contradict itself.
// So they wait here until the host has them applied: then they are checked as a whole, together
// with those that stay, and either all of them become the running configuration or none.
#ifndef THIGMO_CORE_CONFIG_STAGED_H_
#define THIGMO_CORE_CONFIG_STAGED_H_

#include <stdint.h>

#include "configuration.h"

namespace thigmo {

class StagedParameters {
 public:
  // False when index or value is outside the limits that are compiled in.
  bool set(uint16_t index, int32_t wanted) {
    if (!Configuration::allows(index, wanted)) return false;
    value_[index] = wanted;
    waits_[index / 8] = static_cast<uint8_t>(waits_[index / 8] | 1u << index % 8);
    return true;
  }

  bool waits(uint16_t index) const { return (waits_[index / 8] >> index % 8 & 1) != 0; }

  // What the parameter will be, once applied.
  int32_t get(const Configuration& running, uint16_t index) const {
    return waits(index) ? value_[index] : running.value[index];
  }

  // Index of the first parameter that would contradict another, or -1.
  int16_t first_conflict(const Configuration& running) const {
    return Configuration::conflict_of(
        [&](Param name) { return get(running, static_cast<uint16_t>(name)); });
  }

  void clear() {
    for (uint8_t& byte : waits_) byte = 0;
  }

 private:
  int32_t value_[protocol::kParamCount] = {};
  uint8_t waits_[protocol::kParamCount / 8 + 1] = {};
};

}  // namespace thigmo

#endif  // THIGMO_CORE_CONFIG_STAGED_H_
