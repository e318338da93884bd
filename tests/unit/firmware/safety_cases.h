// Safety: the supervisor's tables over every combination, against rules written another way.
#ifndef THIGMO_TESTS_FIRMWARE_SAFETY_CASES_H_
#define THIGMO_TESTS_FIRMWARE_SAFETY_CASES_H_

#include "check.h"
#include "safety/faults.h"
#include "safety/leaky_count.h"
#include "virtual_board.h"

namespace safety_cases {

using namespace thigmo;

constexpr int kConditions = 1 << protocol::kConditionCount;

// The rules as prose would have them.
inline State expected(State state, int conditions, int signals) {
  const bool fault = (signals & bit(Signal::kFaultLatched)) != 0;
  const bool hello = (signals & bit(Signal::kHello)) != 0;
  const bool arm = (signals & bit(Signal::kArm)) != 0;
  const bool disarm = (signals & bit(Signal::kDisarm)) != 0;
  const bool active = (signals & bit(Signal::kActive)) != 0;
  if (fault) return State::kFault;
  switch (state) {
    case State::kFault:
      return State::kSafe;
    case State::kBoot:
      return hello ? State::kSafe : State::kBoot;
    case State::kSafe: {
      const bool good = (conditions & mask(Condition::kConfigValid)) != 0 &&
                        (conditions & mask(Condition::kSupplyGood)) != 0 &&
                        (conditions & mask(Condition::kHostAlive)) != 0 &&
                        (conditions & mask(Condition::kEstop)) == 0;
      return arm && !disarm && good ? State::kReady : State::kSafe;
    }
    case State::kReady:
      return disarm ? State::kSafe : (active ? State::kMoving : State::kReady);
    case State::kMoving:
      return disarm ? State::kSafe : (active ? State::kMoving : State::kReady);
  }
  return state;
}

TEST(every_transition_is_the_prescribed_one) {
  for (int state = 0; state < protocol::kStateCount; ++state) {
    for (int conditions = 0; conditions < kConditions; ++conditions) {
      for (int signals = 0; signals < 32; ++signals) {
        const State from = static_cast<State>(state);
        const State to =
            next_state(from, static_cast<uint16_t>(conditions), static_cast<uint8_t>(signals));
        if (to != expected(from, conditions, signals)) {
          CHECK_EQUAL(static_cast<int>(to), static_cast<int>(expected(from, conditions, signals)));
          return;
        }
      }
    }
  }
}

TEST(outputs_are_allowed_in_ready_and_moving_only) {
  CHECK(!may_energise(State::kBoot) && !may_energise(State::kSafe) && !may_energise(State::kFault));
  CHECK(may_energise(State::kReady) && may_energise(State::kMoving));
}

TEST(every_refusal_has_its_reason) {
  const auto has = [](int conditions, Condition c) { return (conditions & mask(c)) != 0; };
  for (int kind = 0; kind <= static_cast<int>(Permit::kTestMotor); ++kind) {
    const Permit permit = static_cast<Permit>(kind);
    for (int s = 0; s < protocol::kStateCount; ++s) {
      const State state = static_cast<State>(s);
      for (int a = 0; a < protocol::kActivityCount; ++a) {
        const Activity activity = static_cast<Activity>(a);
        for (int c = 0; c < kConditions; ++c) {
          const Reason reason = refusal(permit, state, activity, static_cast<uint16_t>(c));
          const bool bend = permit == Permit::kBend || permit == Permit::kPress;
          const bool wind = permit == Permit::kGrow || permit == Permit::kRetract;
          const bool arm = permit == Permit::kArm;
          const bool confirm = permit == Permit::kConfirm;
          const bool setup =
              permit == Permit::kZone || permit == Permit::kConfigure || permit == Permit::kSave;
          const bool air = permit == Permit::kAir;
          const bool test = permit == Permit::kTestValve || permit == Permit::kTestMotor;
          bool state_good = state == State::kReady || state == State::kMoving;
          if (arm) state_good = state_good || state == State::kSafe;
          if (confirm || setup) state_good = state != State::kBoot;
          Reason want = Reason::kNone;
          if (!state_good) {
            want = state == State::kFault ? Reason::kFaultLatched : Reason::kWrongState;
          } else if (arm ? activity == Activity::kSaving
                         : !air && activity != Activity::kIdle &&
                               !(permit == Permit::kPress && activity == Activity::kPressing) &&
                               !(test && activity == Activity::kTesting)) {
            want = Reason::kBusy;
          } else if (arm && has(c, Condition::kEstop)) {
            want = Reason::kEstop;
          } else if (arm && !has(c, Condition::kConfigValid)) {
            want = Reason::kBadConfig;
          } else if (arm && !has(c, Condition::kSupplyGood)) {
            want = Reason::kWrongState;
          } else if (arm && !has(c, Condition::kHostAlive)) {
            want = Reason::kHostSilent;
          } else if ((wind || permit == Permit::kHome || permit == Permit::kTestMotor) &&
                     !has(c, Condition::kSpoolFitted)) {
            want = Reason::kDoesNotGrow;
          } else if ((bend || wind || permit == Permit::kZero) &&
                     !has(c, Condition::kLengthKnown)) {
            want = Reason::kLengthUnknown;
          } else if (bend && has(c, Condition::kHalfEverted)) {
            want = Reason::kHalfEverted;
          } else if (bend && !has(c, Condition::kZoneKnown)) {
            want = Reason::kZoneUnknown;
          } else if ((permit == Permit::kBend || wind || permit == Permit::kHome || confirm ||
                      permit == Permit::kZero || permit == Permit::kTestMotor) &&
                     !has(c, Condition::kVented)) {
            want = Reason::kNotVented;
          } else if (bend && !has(c, Condition::kZeroed)) {
            want = Reason::kNotZeroed;
          } else if (bend && !has(c, Condition::kBaseUsable)) {
            want = Reason::kNoBaseSensor;
          } else if (setup && has(c, Condition::kEnergised)) {
            want = Reason::kBusy;
          }
          if (reason != want) {
            std::printf("permit %d state %d activity %d conditions %x\n", kind, s, a, c);
            CHECK_EQUAL(static_cast<int>(reason), static_cast<int>(want));
            return;
          }
        }
      }
    }
  }
}

TEST(what_was_permitted_ends_with_the_conditions_that_must_last) {
  const auto has = [](int conditions, Condition c) { return (conditions & mask(c)) != 0; };
  for (int kind = 0; kind <= static_cast<int>(Permit::kTestMotor); ++kind) {
    const Permit permit = static_cast<Permit>(kind);
    const bool bend = permit == Permit::kBend || permit == Permit::kPress;
    const bool wind =
        permit == Permit::kGrow || permit == Permit::kRetract || permit == Permit::kZero;
    const bool turn = permit == Permit::kGrow || permit == Permit::kRetract ||
                      permit == Permit::kHome || permit == Permit::kTestMotor;
    const bool empty = wind || turn;
    for (int c = 0; c < kConditions; ++c) {
      Reason want = Reason::kNone;
      if (turn && !has(c, Condition::kSpoolFitted)) {
        want = Reason::kDoesNotGrow;
      } else if ((bend || wind) && !has(c, Condition::kLengthKnown)) {
        want = Reason::kLengthUnknown;
      } else if (bend && has(c, Condition::kHalfEverted)) {
        want = Reason::kHalfEverted;
      } else if (bend && !has(c, Condition::kZoneKnown)) {
        want = Reason::kZoneUnknown;
      } else if (empty && !has(c, Condition::kVented)) {
        want = Reason::kNotVented;
      } else if (bend && !has(c, Condition::kZeroed)) {
        want = Reason::kNotZeroed;
      } else if (bend && !has(c, Condition::kBaseUsable)) {
        want = Reason::kNoBaseSensor;
      }
      const Reason lost = loss(permit, static_cast<uint16_t>(c));
      if (lost != want) {
        std::printf("permit %d conditions %x\n", kind, c);
        CHECK_EQUAL(static_cast<int>(lost), static_cast<int>(want));
        return;
      }
      // And nothing ends that would be permitted now.
      const Reason refused =
          refusal(permit, State::kReady, Activity::kIdle, static_cast<uint16_t>(c));
      CHECK(refused != Reason::kNone || lost == Reason::kNone);
    }
  }
}

TEST(a_leaky_count_is_full_after_bad_samples_in_a_row_or_a_share_of_them) {
  using Count = LeakyCount<uint16_t, 4>;
  const auto samples_until_full = [](int bad, int good, uint8_t weight = 1) {
    Count count;
    for (int i = 0; i < 5000; ++i) {
      count.add(i % (bad + good) < bad, 100, weight);
      if (count.full(100)) return i + 1;
    }
    return 0;
  };
  CHECK_EQUAL(samples_until_full(1, 0), 100);
  CHECK_EQUAL(samples_until_full(1, 0, 30), 4);
  CHECK(samples_until_full(1, 3) > 100 && samples_until_full(20, 40) > 100);
  CHECK_EQUAL(samples_until_full(1, 4), 0);
  Count count;
  for (int i = 0; i < 1000; ++i) count.add(true, 100);
  CHECK(count.full(100));
  count.add(false, 100);
  CHECK(!count.full(100));  // the cause is gone, and not forgotten
  count.add(true, 100);
  CHECK(count.full(100));
  for (int i = 0; i < 400; ++i) count.add(false, 100);
  for (int i = 0; i < 99; ++i) count.add(true, 100);
  CHECK(!count.full(100));
  Count heavy;  // no weight takes it beyond the limit
  for (int i = 0; i < 4; ++i) heavy.add(true, 100, 30);
  CHECK(heavy.full(100));
  heavy.add(false, 100);
  CHECK(!heavy.full(100));
}

TEST(outputs_that_something_disturbs_are_written_anew_within_three_periods) {
  VirtualBoard board(1, "");
  while (!board.running()) board.step(1);
  board.step(50);
  board.drive(0, 300), board.drive(1, 400), board.motor(500);  // behind the core's back
  board.step(3);
  CHECK_EQUAL(board.drive()[0], 0);
  CHECK_EQUAL(board.drive()[1], 0);
  CHECK_EQUAL(board.motor(), 0);
}

}  // namespace safety_cases

#endif  // THIGMO_TESTS_FIRMWARE_SAFETY_CASES_H_
