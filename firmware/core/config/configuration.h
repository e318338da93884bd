// The running configuration: every parameter of the schema and the free-curvature maps.
//
// The host sets it value by value (config/staged.h), has it applied as a whole, and has it stored
// (config/store.h). Control code never reads it at its own rate: derived.h turns it into the scaled
// constants that the loops use, once after each change.
#ifndef THIGMO_CORE_CONFIG_CONFIGURATION_H_
#define THIGMO_CORE_CONFIG_CONFIGURATION_H_

#include <stdint.h>

#include "../board.h"
#include "../control/fixed_point.h"

namespace thigmo {

using protocol::Param;

constexpr uint8_t kBranches = 2;
constexpr uint8_t kZoneUnknown = 255;

// Free curvature of a muscle until its calibration is sent: 0.04 1/cm * tanh(p / 10 psi), a guess
// that the host's robot.toml shares; every second muscle bends the other way.
constexpr int16_t kGuessedMap[protocol::kMapPoints] THIGMO_PROGMEM = {
    0, 790, 1520, 2148, 2656, 3046, 3335, 3541, 3687, 3787, 3856};

// A host that dies while the body grows is noticed after heartbeat_ms; what follows until the spool
// stands still (a control step, the output, the braked motor's run-out) takes no longer than this.
constexpr int32_t kReactionMs = 100;
// The farthest that the body may grow after its host has died. The promise is 2 cm; the rest is for
// a loop that overshoots its speed and for a tail that pulls.
constexpr int32_t kOrphanUm = 17000;

struct Configuration {
  int32_t value[protocol::kParamCount];
  int16_t map[kBodyPressures][kMuscles][kBranches][protocol::kMapPoints];

  int32_t get(Param name, uint8_t element = 0) const {
    return value[static_cast<uint16_t>(name) + element];
  }

  static protocol::ParamRow row(uint16_t index) {
    const protocol::ParamRow* limits = protocol::kParamRows.row + index;
    return {static_cast<int32_t>(THIGMO_FLASH_U32(&limits->low)),
            static_cast<int32_t>(THIGMO_FLASH_U32(&limits->high)),
            static_cast<int32_t>(THIGMO_FLASH_U32(&limits->initial))};
  }

  // Whether there is such a parameter and the value lies within its limits.
  static bool allows(uint16_t index, int32_t wanted) {
    if (index >= protocol::kParamCount) return false;
    const protocol::ParamRow limits = row(index);
    return wanted >= limits.low && wanted <= limits.high;
  }

  // Sets one parameter; false when index or value is out of range.
  bool set(uint16_t index, int32_t wanted) {
    if (!allows(index, wanted)) return false;
    value[index] = wanted;
    return true;
  }

  // Parameters, then maps.
  static constexpr uint16_t kItems = protocol::kParamCount + kBodyPressures * kMuscles * kBranches;

  // Puts one item back to its default; true if that changed it.
  bool load_default(uint16_t item) {
    if (item < protocol::kParamCount) {
      const int32_t initial = row(item).initial;
      const bool differs = value[item] != initial;
      value[item] = initial;
      return differs;
    }
    const uint8_t map_index = static_cast<uint8_t>(item - protocol::kParamCount);
    const uint8_t muscle = static_cast<uint8_t>(map_index / kBranches % kMuscles);
    int16_t* const points = map[map_index / (kBranches * kMuscles)][muscle][map_index % kBranches];
    bool differs = false;
    for (uint8_t i = 0; i < protocol::kMapPoints; ++i) {
      const int16_t guess = static_cast<int16_t>(THIGMO_FLASH_U16(kGuessedMap + i));
      const int16_t initial = muscle % 2 == 0 ? guess : static_cast<int16_t>(-guess);
      differs = differs || points[i] != initial;
      points[i] = initial;
    }
    return differs;
  }

  void load_defaults() {
    for (uint16_t i = 0; i < kItems; ++i) load_default(i);
  }

  // Index of the first parameter that is out of range, or -1: for what comes from the store. set()
  // lets none in.
  int16_t first_out_of_range() const {
    for (uint16_t i = 0; i < protocol::kParamCount; ++i) {
      const protocol::ParamRow limits = row(i);
      if (value[i] < limits.low || value[i] > limits.high) return static_cast<int16_t>(i);
    }
    return -1;
  }

  // The fastest tip whose host or firmware may die: speed x (time until that is noticed + reaction)
  // stays within kOrphanUm.
  static int32_t top_speed_um_s(int32_t heartbeat_ms) {
    return kOrphanUm * 1000 / (greater<int32_t>(heartbeat_ms, kWatchdogMs) + kReactionMs);
  }

  // Index of the first parameter that contradicts another, or -1.
  int16_t first_conflict() const {
    return conflict_of([this](Param name) { return get(name); });
  }

  // The same of parameters that are got by a function of their name.
  template <typename Get>
  static int16_t conflict_of(const Get& value_of) {
    // The transducer's span divides the feed-forward; from 13 psi on its slope fits 16 bits.
    if (value_of(Param::kDrive20maCpsi) < value_of(Param::kDrive4maCpsi) + 1300) {
      return static_cast<int16_t>(Param::kDrive20maCpsi);
    }
    // Set points must stay clear of the fault, or overshoot would be one.
    if (value_of(Param::kOverPressureCpsi) <= value_of(Param::kMaxPressureCpsi)) {
      return static_cast<int16_t>(Param::kOverPressureCpsi);
    }
    // A sensor shows nothing beyond its range.
    if (value_of(Param::kOverPressureCpsi) > value_of(Param::kPressureFullCpsi)) {
      return static_cast<int16_t>(Param::kPressureFullCpsi);
    }
    const int32_t fastest = top_speed_um_s(value_of(Param::kHeartbeatMs));
    if (value_of(Param::kSpoolSpeedUmS) > fastest)
      return static_cast<int16_t>(Param::kSpoolSpeedUmS);
    if (value_of(Param::kHomeSpeedUmS) > fastest) return static_cast<int16_t>(Param::kHomeSpeedUmS);
    return -1;
  }
};

// The store writes the structure's bytes, so it must have no holes; all boards are little-endian.
static_assert(sizeof(Configuration) == 4 * protocol::kParamCount + 2 * kBodyPressures * kMuscles *
                                                                       kBranches *
                                                                       protocol::kMapPoints,
              "the stored image has holes");

}  // namespace thigmo

#endif  // THIGMO_CORE_CONFIG_CONFIGURATION_H_
