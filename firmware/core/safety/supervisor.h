// The supervisor: which state the robot is in, and what may be done in it.
//
// Two tables. The first leads from state to state by condition bits and requests; the first row
// that matches wins. The second says for each kind of command in which states and activities and
// under which conditions it is accepted; the first condition that fails is the reason given to the
// operator. Both are data, tested by themselves over every combination.
#ifndef THIGMO_CORE_SAFETY_SUPERVISOR_H_
#define THIGMO_CORE_SAFETY_SUPERVISOR_H_

#include <stdint.h>

#include "../flash.h"
#include "../link/protocol.h"

namespace thigmo {

using protocol::Activity;
using protocol::Condition;
using protocol::Fault;
using protocol::Reason;
using protocol::State;

// What the transition table sees beside the conditions.
enum class Signal : uint8_t {
  kFaultLatched = 0,
  kHello = 1,  // a host has said hello since the boot
  kArm = 2,    // requests hold for one evaluation
  kDisarm = 3,
  kActive = 4,  // an activity that needs armed outputs runs
};

constexpr uint8_t bit(Signal signal) {
  return static_cast<uint8_t>(1u << static_cast<uint8_t>(signal));
}
constexpr uint8_t bit(State state) {
  return static_cast<uint8_t>(1u << static_cast<uint8_t>(state));
}
constexpr uint16_t bit(Activity activity) {
  return static_cast<uint16_t>(1u << static_cast<uint8_t>(activity));
}

struct Transition {
  uint8_t from;           // states, as bits
  uint8_t signals_set;    // all of these
  uint8_t signals_clear;  // none of these
  uint16_t required;      // conditions that must hold
  uint16_t forbidden;     // conditions that must not
  State to;
};

constexpr uint8_t kAnyState = 0x1F;

// What arming needs: among it a beating host, for from then on its silence is a fault.
constexpr uint16_t kArmable = static_cast<uint16_t>(
    mask(Condition::kConfigValid) | mask(Condition::kSupplyGood) | mask(Condition::kHostAlive));

constexpr Transition kTransitions[] THIGMO_PROGMEM = {
    // A fault takes the outputs from everyone, in any state.
    {kAnyState & static_cast<uint8_t>(~bit(State::kFault)), bit(Signal::kFaultLatched), 0, 0, 0,
     State::kFault},
    // Cleared, the robot is safe, not ready: the operator arms it again.
    {bit(State::kFault), 0, bit(Signal::kFaultLatched), 0, 0, State::kSafe},
    {bit(State::kBoot), bit(Signal::kHello), 0, 0, 0, State::kSafe},
    {static_cast<uint8_t>(bit(State::kReady) | bit(State::kMoving)), bit(Signal::kDisarm), 0, 0, 0,
     State::kSafe},
    {bit(State::kSafe), bit(Signal::kArm), bit(Signal::kDisarm), kArmable, mask(Condition::kEstop),
     State::kReady},
    {bit(State::kReady), bit(Signal::kActive), 0, 0, 0, State::kMoving},
    {bit(State::kMoving), 0, bit(Signal::kActive), 0, 0, State::kReady},
};
constexpr uint8_t kTransitionCount = sizeof(kTransitions) / sizeof(kTransitions[0]);

// The state that follows, by the table.
inline State next_state(State state, uint16_t conditions, uint8_t signals) {
  for (uint8_t i = 0; i < kTransitionCount; ++i) {
    const Transition* row = kTransitions + i;
    const uint8_t set = THIGMO_FLASH_U8(&row->signals_set);
    if ((THIGMO_FLASH_U8(&row->from) & bit(state)) == 0 || (signals & set) != set ||
        (signals & THIGMO_FLASH_U8(&row->signals_clear)) != 0) {
      continue;
    }
    const uint16_t required = THIGMO_FLASH_U16(&row->required);
    if ((conditions & required) != required ||
        (conditions & THIGMO_FLASH_U16(&row->forbidden)) != 0) {
      continue;
    }
    return static_cast<State>(THIGMO_FLASH_U8(reinterpret_cast<const uint8_t*>(&row->to)));
  }
  return state;
}

// Only these states let current out.
constexpr bool may_energise(State state) {
  return state == State::kReady || state == State::kMoving;
}

// Kinds of command, by their interlocks.
enum class Permit : uint8_t {
  kArm = 0,
  kBend = 1,   // sweep
  kPress = 2,  // set_pressure: a sweep's interlocks, but a held pressure may be changed
  kGrow = 3,
  kRetract = 4,
  kHome = 5,
  kConfirm = 6,
  kZone = 7,
  kZero = 8,
  kConfigure = 9,  // set_parameter, set_map, load_defaults
  kSave = 10,
  kAir = 11,  // body_air, on
  kTestValve = 12,
  kTestMotor = 13,
};

struct Interlock {
  Permit permit;
  uint8_t states;       // where it is accepted
  uint16_t activities;  // during which
  uint16_t required;    // conditions that must hold
  uint16_t forbidden;   // conditions that must not
  uint16_t lasting;     // which of both must stay so until what was begun ends
};

constexpr uint16_t kWholeBody =
    static_cast<uint16_t>(mask(Condition::kLengthKnown) | mask(Condition::kZoneKnown) |
                          mask(Condition::kZeroed) | mask(Condition::kBaseUsable));
// While something moves, the activity is what stands in the way: busy.
constexpr uint8_t kArmed = static_cast<uint8_t>(bit(State::kReady) | bit(State::kMoving));
constexpr uint8_t kNotBooting = kAnyState & static_cast<uint8_t>(~bit(State::kBoot));
constexpr uint16_t kBent = static_cast<uint16_t>(kWholeBody | mask(Condition::kHalfEverted));
constexpr uint16_t kStill =
    static_cast<uint16_t>(mask(Condition::kLengthKnown) | mask(Condition::kVented));
constexpr uint16_t kTurning =
    static_cast<uint16_t>(mask(Condition::kSpoolFitted) | mask(Condition::kVented));
constexpr uint16_t kWinding = static_cast<uint16_t>(kStill | kTurning);

// A row a permit, in their order. What arming needs has faults of its own.
constexpr Interlock kInterlocks[] THIGMO_PROGMEM = {
    {Permit::kArm,
     static_cast<uint8_t>(bit(State::kSafe) | bit(State::kReady) | bit(State::kMoving)),
     static_cast<uint16_t>(~bit(Activity::kSaving)), kArmable, mask(Condition::kEstop), 0},
    {Permit::kBend, kArmed, bit(Activity::kIdle),
     static_cast<uint16_t>(kWholeBody | mask(Condition::kVented)), mask(Condition::kHalfEverted),
     kBent},
    {Permit::kPress, kArmed, static_cast<uint16_t>(bit(Activity::kIdle) | bit(Activity::kPressing)),
     kWholeBody, mask(Condition::kHalfEverted), kBent},
    {Permit::kGrow, kArmed, bit(Activity::kIdle), kWinding, 0, kWinding},
    {Permit::kRetract, kArmed, bit(Activity::kIdle), kWinding, 0, kWinding},
    {Permit::kHome, kArmed, bit(Activity::kIdle), kTurning, 0, kTurning},
    {Permit::kConfirm, kNotBooting, bit(Activity::kIdle), mask(Condition::kVented), 0, 0},
    {Permit::kZone, kNotBooting, bit(Activity::kIdle), 0, mask(Condition::kEnergised), 0},
    {Permit::kZero, kArmed, bit(Activity::kIdle), kStill, 0, kStill},
    {Permit::kConfigure, kNotBooting, bit(Activity::kIdle), 0, mask(Condition::kEnergised), 0},
    {Permit::kSave, kNotBooting, bit(Activity::kIdle), 0, mask(Condition::kEnergised), 0},
    {Permit::kAir, kArmed, 0xFFFF, 0, 0, 0},
    {Permit::kTestValve, kArmed,
     static_cast<uint16_t>(bit(Activity::kIdle) | bit(Activity::kTesting)), 0, 0, 0},
    {Permit::kTestMotor, kArmed,
     static_cast<uint16_t>(bit(Activity::kIdle) | bit(Activity::kTesting)), kTurning, 0, kTurning},
};
constexpr uint8_t kPermits = sizeof(kInterlocks) / sizeof(kInterlocks[0]);
constexpr uint8_t in_order() {
  uint8_t row = 0;
  while (row < kPermits && static_cast<uint8_t>(kInterlocks[row].permit) == row) ++row;
  return row;
}
static_assert(in_order() == static_cast<uint8_t>(Permit::kTestMotor) + 1 && in_order() == kPermits,
              "each permit has its row");

// Conditions in the order in which they are named to the operator: first what takes longest to put
// right.
struct Complaint {
  uint16_t condition;
  Reason reason;
};
constexpr Complaint kComplaints[] THIGMO_PROGMEM = {
    {mask(Condition::kEstop), Reason::kEstop},
    {mask(Condition::kConfigValid), Reason::kBadConfig},
    {mask(Condition::kSupplyGood), Reason::kWrongState},
    {mask(Condition::kHostAlive), Reason::kHostSilent},
    {mask(Condition::kSpoolFitted), Reason::kDoesNotGrow},
    {mask(Condition::kLengthKnown), Reason::kLengthUnknown},
    {mask(Condition::kHalfEverted), Reason::kHalfEverted},
    {mask(Condition::kZoneKnown), Reason::kZoneUnknown},
    {mask(Condition::kVented), Reason::kNotVented},
    {mask(Condition::kZeroed), Reason::kNotZeroed},
    {mask(Condition::kBaseUsable), Reason::kNoBaseSensor},
    {mask(Condition::kEnergised), Reason::kBusy},
};

// The first complaint about conditions that are not as they must be, or none.
inline Reason first_complaint(uint16_t wrong) {
  if (wrong == 0) return Reason::kNone;
  for (const Complaint& complaint : kComplaints) {
    if ((wrong & THIGMO_FLASH_U16(&complaint.condition)) != 0) {
      return static_cast<Reason>(
          THIGMO_FLASH_U8(reinterpret_cast<const uint8_t*>(&complaint.reason)));
    }
  }
  return Reason::kWrongState;
}

// Why a command is refused now, or none.
inline Reason refusal(Permit permit, State state, Activity activity, uint16_t conditions) {
  const Interlock* row = kInterlocks + static_cast<uint8_t>(permit);
  if ((THIGMO_FLASH_U8(&row->states) & bit(state)) == 0) {
    return state == State::kFault ? Reason::kFaultLatched : Reason::kWrongState;
  }
  if ((THIGMO_FLASH_U16(&row->activities) & bit(activity)) == 0) return Reason::kBusy;
  return first_complaint(static_cast<uint16_t>((THIGMO_FLASH_U16(&row->required) & ~conditions) |
                                               (THIGMO_FLASH_U16(&row->forbidden) & conditions)));
}

// Why what was permitted may not go on, or none.
inline Reason loss(Permit permit, uint16_t conditions) {
  const Interlock* row = kInterlocks + static_cast<uint8_t>(permit);
  const uint16_t wrong = static_cast<uint16_t>((THIGMO_FLASH_U16(&row->required) & ~conditions) |
                                               (THIGMO_FLASH_U16(&row->forbidden) & conditions));
  return first_complaint(static_cast<uint16_t>(wrong & THIGMO_FLASH_U16(&row->lasting)));
}

}  // namespace thigmo

#endif  // THIGMO_CORE_SAFETY_SUPERVISOR_H_
