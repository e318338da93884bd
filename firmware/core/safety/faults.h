// Latched faults: named, reported once each, cleared only by command and only with the cause gone.
#ifndef THIGMO_CORE_SAFETY_FAULTS_H_
#define THIGMO_CORE_SAFETY_FAULTS_H_

#include <stdint.h>

#include "../link/events.h"
#include "supervisor.h"

namespace thigmo {

class Faults {
 public:
  // Latches a fault; `value` tells the channel or detail.
  void raise(Fault fault, int32_t value, uint32_t t_us, EventQueue* events) {
    if ((latched_ & mask(fault)) != 0) return;
    latched_ = static_cast<uint16_t>(latched_ | mask(fault));
    events->post(protocol::EventCode::kFault, static_cast<uint8_t>(fault), value, t_us);
  }

  // Clears those of `wanted` whose cause is not in `present`. Returns what remains latched.
  uint16_t clear(uint16_t wanted, uint16_t present) {
    latched_ = static_cast<uint16_t>(latched_ & ~(wanted & ~present));
    return latched_;
  }

  uint16_t latched() const { return latched_; }

 private:
  uint16_t latched_ = 0;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_SAFETY_FAULTS_H_
