// What a board holds: fixed when its firmware is compiled, and reported to the host in `capacity`.
//
// The defaults are those of the thesis's robot. A build for more defines the macros, all four.
#ifndef THIGMO_CORE_CAPACITY_H_
#define THIGMO_CORE_CAPACITY_H_

#include <stdint.h>

#ifndef THIGMO_MUSCLES
#define THIGMO_MUSCLES 2
#define THIGMO_SENSORS 10
#define THIGMO_BODY_PRESSURES 3
#define THIGMO_IMUS 0
#endif

namespace thigmo {

constexpr uint8_t kMuscles = THIGMO_MUSCLES;
constexpr uint8_t kSensors = THIGMO_SENSORS;
constexpr uint8_t kBodyPressures = THIGMO_BODY_PRESSURES;
// Inputs that may be the turn from one IMU to the next: all, or none.
constexpr uint8_t kImus = THIGMO_IMUS;

}  // namespace thigmo

#endif  // THIGMO_CORE_CAPACITY_H_
