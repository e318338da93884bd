// Controller: what the host may ask. Included by controller.h only.
//
// Each command is checked against the interlock table first, then its values, and only then does
// anything change. Values: first what is impossible (bad_value), then what is too much
// (over_limit).
#ifndef THIGMO_CORE_CONTROLLER_COMMANDS_H_
#define THIGMO_CORE_CONTROLLER_COMMANDS_H_

#include "controller.h"

namespace thigmo {

constexpr Outcome kAccepted = {Reason::kNone, 0};

// What one host began is not for another one to find moving.
inline void Controller::greet(bool same_host) {
  if (greeted_ && !same_host) {
    make_safe(Reason::kOtherHost);
    supervise(bit(Signal::kDisarm));
  }
  greeted_ = true;
  if (change_ != Change::kApply) staged_.clear();  // what another host has left
  events_.resend();
  supervise(0);
}

inline Outcome Controller::arm() {
  const Outcome allowed = permit(Permit::kArm);
  if (allowed.reason != Reason::kNone) return allowed;
  const bool was_safe = state_ == State::kSafe;
  supervise(bit(Signal::kArm));
  if (was_safe && state_ == State::kReady) {
    spool_.doubt();
    if (brake_fitted()) prove_brake();
  }
  return kAccepted;
}

// The motor pays out against the closed brake. What it cannot turn now, the body cannot later.
inline void Controller::prove_brake() {
  const int32_t push = kProofN * kMotorFull / config_.get(Param::kMotorStallN);
  const int32_t duty = config_.get(Param::kSpoolDeadZone) + push;
  test_ = {protocol::Output::kMotor, 0,
           static_cast<int16_t>(lesser<int32_t>(duty, derived_.top_duty)), kProofMs};
  test_tick_ = tick_;
  proof_count_ = encoder_;
  proving_ = true;
  start(Activity::kTesting, Permit::kArm);
}

inline Outcome Controller::vent() {
  if (activity_ == Activity::kTesting) end_test();
  for (uint8_t i = 0; i < kMuscles; ++i) {
    loop_[i].cut();
    outputs_.drive[i] = PressureLoop::kOff;
  }
  if (activity_ == Activity::kSweeping) {
    snapshots_.cancel_peak();
    finish_activity(protocol::EventCode::kActivityAborted, static_cast<uint8_t>(Reason::kNone));
  } else if (bending()) {
    snapshots_.cancel_peak();
    finish_activity(protocol::EventCode::kActivityDone, length_um_);
  }
  supervise(0);
  return kAccepted;
}

inline Outcome Controller::disarm() {
  supervise(bit(Signal::kDisarm));
  make_safe(Reason::kNone);
  return kAccepted;
}

inline void Controller::stop(uint32_t nonce) {
  stop_ = {true, nonce};
  raise(Fault::kStopped, static_cast<int32_t>(nonce));
  supervise(0);
  make_safe(Reason::kFaultLatched);
}

// The cause of fault stopped is the latch itself: clear_faults leaves both.
inline Outcome Controller::clear_stop(uint32_t nonce) {
  if (!stop_.latched) return kAccepted;
  if (nonce != stop_.nonce) return {Reason::kStoppedAgain, 0};
  stop_ = StopLatch{};
  return clear_faults(mask(Fault::kStopped));
}

inline Outcome Controller::clear_faults(uint16_t wanted) {
  if ((wanted & mask(Fault::kSpoolSlip)) != 0) {
    slip_.accept(encoder_);
    motion_.restart(encoder_);
    slipping_ = false;
  }
  assemble_conditions();  // a heartbeat may have come just before
  const uint16_t left = faults_.clear(wanted, causes());
  supervise(0);
  return {Reason::kNone, left};
}

inline uint8_t Controller::above_zero(const int16_t* cpsi) {
  uint8_t count = 0;
  for (uint8_t i = 0; i < kMuscles; ++i) count = static_cast<uint8_t>(count + (cpsi[i] > 0));
  return count;
}

inline int16_t Controller::highest(const int16_t* cpsi) const {
  int16_t most = 0;
  for (uint8_t i = 0; i < kMuscles; ++i) most = greater<int16_t>(most, cpsi[i]);
  return most;
}

// Pressures of muscles: none below zero, at most so many above it, and those only where a muscle
// is.
inline bool Controller::acceptable(const int16_t* cpsi, uint8_t most) const {
  for (uint8_t i = 0; i < kMuscles; ++i) {
    if (cpsi[i] < 0 || (cpsi[i] > 0 && !fitted(i))) return false;
  }
  return above_zero(cpsi) <= most;
}

// Whether the contact trigger has a base sensor that it can read while a muscle bends the body.
inline bool Controller::guarded(uint8_t muscle) const {
  const uint16_t usable = usable_mask();
  for (uint8_t i = 0; i < kColumns; ++i) {
    const uint8_t input = base_input(i);
    const int32_t counts = config_.get(Param::kTriggerWhen, input);
    if ((usable >> input & 1) != 0 && (counts >> muscle & 1) != 0) return true;
  }
  return false;
}

inline Outcome Controller::set_pressure(const protocol::SetPressure& wanted) {
  const bool release = above_zero(wanted.set_cpsi) == 0;
  if (!release) {
    const Outcome allowed = permit(Permit::kPress);
    if (allowed.reason != Reason::kNone) return allowed;
  } else if (activity_ != Activity::kPressing && activity_ != Activity::kIdle) {
    return {Reason::kBusy, 0};
  }
  if (!acceptable(wanted.set_cpsi, 1)) return {Reason::kBadValue, 0};
  const int32_t most = config_.get(Param::kMaxPressureCpsi);
  if (highest(wanted.set_cpsi) > most) return {Reason::kOverLimit, most};
  const uint16_t fastest = static_cast<uint16_t>(config_.get(Param::kPressureSlewCpsiS));
  const uint16_t slew =
      wanted.ramp_cpsi_s == 0 ? fastest : lesser<uint16_t>(wanted.ramp_cpsi_s, fastest);
  const int32_t step_q8 = Derived::slew_step_q8(slew);
  bool unguarded = false;
  for (uint8_t i = 0; i < kMuscles; ++i) {
    unguarded = unguarded || (wanted.set_cpsi[i] > 0 && !guarded(i));
    // One muscle at a time: what another one held falls at once, and by the ramp if all are let go.
    if (!release && wanted.set_cpsi[i] == 0) {
      loop_[i].cut();
    } else {
      loop_[i].set_target(wanted.set_cpsi[i], step_q8);
    }
  }
  if (!release && activity_ == Activity::kIdle) start(Activity::kPressing, Permit::kPress);
  return {Reason::kNone, unguarded};
}

// The spool's next two turns start the move, and its first step is one turn later: command,
// acknowledgement, telemetry and a step would be too much for one millisecond.
inline void Controller::start_spool(Activity activity, int32_t target_counts, int32_t speed_um_s) {
  start_ = Start::kSensors;
  target_counts_ = target_counts;
  target_speed_um_s_ = speed_um_s;
  errors_before_ = encoder_errors_;
  moved_from_ = encoder_;
  start(activity, activity == Activity::kGrowing  ? Permit::kGrow
                  : activity == Activity::kHoming ? Permit::kHome
                                                  : Permit::kRetract);
}

THIGMO_NOINLINE inline void Controller::begin_move() {
  const bool growing = activity_ == Activity::kGrowing;
  const bool homing = activity_ == Activity::kHoming;
  if (start_ == Start::kSensors) {
    fold_.begin(length_um_, growing, homing ? uint16_t{0} : derived_.enabled_mask,
                eversion_.settled_mask(), config_);
    start_ = Start::kSpool;
    return;
  }
  start_ = Start::kDone;
  // A line cannot be pushed: what winds in is bounded by what the line holds.
  const int32_t most = homing ? derived_.home_speed_um_s : derived_.winding_speed_um_s;
  const int32_t speed = growing ? target_speed_um_s_ : lesser(target_speed_um_s_, most);
  spool_.start(encoder_, target_counts_, derived_.speed_q16(speed), derived_.accel_q16,
               homing ? derived_.homing_duty : derived_.top_duty);
  // What growth has missed adds up over the moves that follow each other.
  if (!growing) motion_.restart(encoder_);
}

inline Outcome Controller::wind_to(Permit kind, int32_t length_um, uint32_t speed_um_s) {
  const Outcome allowed = permit(kind);
  if (allowed.reason != Reason::kNone) return allowed;
  const bool growing = kind == Permit::kGrow;
  // A place within the tolerance counts as reached, whichever side of it the tip is.
  const int32_t slack = config_.get(Param::kSpoolToleranceUm);
  if (length_um < 0 || speed_um_s > 200000u ||
      (growing ? length_um < length_um_ - slack : length_um > length_um_ + slack)) {
    return {Reason::kBadValue, length_um_};
  }
  const int32_t most = config_.get(Param::kFullLengthUm);
  if (length_um > most) return {Reason::kOverLimit, most};
  const int32_t usual = config_.get(Param::kSpoolSpeedUmS);
  const int32_t speed = speed_um_s == 0 ? usual : static_cast<int32_t>(speed_um_s);
  if (speed > derived_.top_speed_um_s) return {Reason::kOverLimit, derived_.top_speed_um_s};
  const int32_t target = zero_count_ + derived_.counts(length_um);
  const bool reached = growing ? target <= encoder_ : target >= encoder_;
  start_spool(growing ? Activity::kGrowing : Activity::kRetracting, reached ? encoder_ : target,
              speed);
  return kAccepted;
}

inline Outcome Controller::grow_to(int32_t length_um, uint32_t speed_um_s) {
  return wind_to(Permit::kGrow, length_um, speed_um_s);
}

inline Outcome Controller::retract_to(int32_t length_um, uint32_t speed_um_s) {
  return wind_to(Permit::kRetract, length_um, speed_um_s);
}

inline Outcome Controller::home() {
  const Outcome allowed = permit(Permit::kHome);
  if (allowed.reason != Reason::kNone) return allowed;
  homing_ = Homing::kSeek;
  const int32_t full = config_.get(Param::kFullLengthUm);
  start_spool(Activity::kHoming, encoder_ - derived_.counts(full + full / kHomingExcess),
              config_.get(Param::kHomeSpeedUmS));
  return kAccepted;
}

inline Outcome Controller::confirm_length(int32_t length_um, bool settled) {
  const Outcome allowed = permit(Permit::kConfirm);
  if (allowed.reason != Reason::kNone) return allowed;
  if (length_um < 0) return {Reason::kBadValue, 0};
  const int32_t most = config_.get(Param::kFullLengthUm);
  if (length_um > most) return {Reason::kOverLimit, most};
  zero_count_ = encoder_ - derived_.counts(length_um);
  length_known_ = true;
  slip_.accept(encoder_);
  motion_.restart(encoder_);
  fold_.restart(length_um);
  follow_length();  // nothing everts by being vouched for: no events
  eversion_.confirm(settled, tick_);
  if (!settled) zeros_.invalidate(0xFFFF);
  assemble_conditions();
  return kAccepted;
}

inline Outcome Controller::select_zone(uint8_t zone) {
  const Outcome allowed = permit(Permit::kZone);
  if (allowed.reason != Reason::kNone) return allowed;
  if (zone >= kBodyPressures && zone != kZoneUnknown) return {Reason::kBadValue, 0};
  zone_ = zone;
  free_step();
  assemble_conditions();
  return kAccepted;
}

inline Outcome Controller::body_air(uint8_t open) {
  if (open > 1) return {Reason::kBadValue, open};
  if (open != 0) {
    const Outcome allowed = permit(Permit::kAir);
    if (allowed.reason != Reason::kNone) return allowed;
  }
  body_air_ = open != 0;
  assemble_conditions();
  return kAccepted;
}

inline Outcome Controller::test_output(const protocol::TestOutput& wanted) {
  const bool motor = wanted.output == protocol::Output::kMotor;
  const Outcome allowed = permit(motor ? Permit::kTestMotor : Permit::kTestValve);
  if (allowed.reason != Reason::kNone) return allowed;
  if (static_cast<uint8_t>(wanted.output) >= protocol::kOutputCount || wanted.duration_ms == 0 ||
      (!motor && (wanted.level < 0 || wanted.muscle >= kMuscles || !fitted(wanted.muscle)))) {
    return {Reason::kBadValue, 0};
  }
  const int16_t most = motor ? kTestMotorMost : kTestDriveMost;
  if (magnitude(static_cast<int32_t>(wanted.level)) > most) return {Reason::kOverLimit, most};
  if (wanted.duration_ms > kTestMostMs) return {Reason::kOverLimit, kTestMostMs};
  if (activity_ == Activity::kTesting &&
      (proving_ || wanted.output != test_.output || wanted.muscle != test_.muscle)) {
    return {Reason::kBusy, 0};
  }
  test_ = wanted;
  test_tick_ = tick_;
  if (activity_ == Activity::kIdle) {
    start(Activity::kTesting, motor ? Permit::kTestMotor : Permit::kTestValve);
  }
  return kAccepted;
}

inline Outcome Controller::sweep(const protocol::Sweep& wanted) {
  const Outcome allowed = permit(Permit::kBend);
  if (allowed.reason != Reason::kNone) return allowed;
  // The ten readings of a peak must lie within their half.
  const uint32_t peak_ms = 10 * static_cast<uint32_t>(config_.get(Param::kPeakSpacingMs));
  if (!acceptable(wanted.amplitude_cpsi, kMuscles) || above_zero(wanted.amplitude_cpsi) == 0 ||
      wanted.cycles == 0 || wanted.period_ms < 1000 || wanted.period_ms > 600000 ||
      wanted.period_ms / 2 < peak_ms) {
    return {Reason::kBadValue, 0};
  }
  const int32_t most = config_.get(Param::kMaxPressureCpsi);
  if (highest(wanted.amplitude_cpsi) > most) return {Reason::kOverLimit, most};
  for (uint8_t i = 0; i < kMuscles; ++i) {
    if (wanted.amplitude_cpsi[i] > 0 && !guarded(i)) return {Reason::kNoBaseSensor, i};
  }
  sweep_options_ = wanted.options;
  sweep_.start(wanted.amplitude_cpsi, wanted.period_ms, wanted.cycles, tick_);
  start(Activity::kSweeping, Permit::kBend);
  begin_half();
  return kAccepted;
}

inline Outcome Controller::zero_sensors(uint16_t wanted) {
  const Outcome allowed = permit(Permit::kZero);
  if (allowed.reason != Reason::kNone) return allowed;
  if (wanted == 0 || static_cast<uint32_t>(wanted) >> kSensors != 0) return {Reason::kBadValue, 0};
  for (uint8_t i = 0; i < kSensors; ++i) {
    const uint16_t sensor_bit = static_cast<uint16_t>(1u << i);
    if ((wanted & sensor_bit) == 0) continue;
    if (!enabled(i)) return {Reason::kBadValue, i};
    if ((eversion_.settled_mask() & sensor_bit) == 0) return {Reason::kNotSettled, i};
  }
  zeros_.begin(wanted);
  averaging_ = false;
  zeroing_next_ = 0;
  drift_.begin_window(tick_);
  zeroing_window_ = drift_.closed();
  start(Activity::kZeroing, Permit::kZero);
  return kAccepted;
}

inline Outcome Controller::set_parameter(uint16_t index, int32_t value) {
  const Outcome allowed = permit(Permit::kConfigure);
  if (allowed.reason != Reason::kNone) return allowed;
  if (!staged_.set(index, value)) return {Reason::kBadValue, index};
  return kAccepted;
}

inline Outcome Controller::begin_apply() {
  const Outcome allowed = permit(Permit::kConfigure);
  if (allowed.reason != Reason::kNone) return allowed;
  const int16_t conflict = staged_.first_conflict(config_);
  if (conflict >= 0) return {Reason::kContradiction, conflict};
  begin_change(Change::kApply);
  return kAccepted;
}

inline Outcome Controller::begin_defaults() {
  const Outcome allowed = permit(Permit::kConfigure);
  if (allowed.reason != Reason::kNone) return allowed;
  staged_.clear();
  begin_change(Change::kDefaults);
  return kAccepted;
}

inline void Controller::begin_change(Change change) {
  activity_ = Activity::kSaving;
  change_ = change;
  next_item_ = 0;
}

// All at once would keep the loop busy for milliseconds: so in a control period one item that
// changes, and after all items one part of the constants that follow from them. Until the last one
// nothing else may begin, arming included, whoever stops the robot or says hello meanwhile.
inline bool Controller::configure_step() {
  if (phase_ != kSparePhase || change_ == Change::kNone) return false;
  const uint16_t items = change_ == Change::kApply ? protocol::kParamCount : Configuration::kItems;
  if (next_item_ < items) {
    change_items(items);
  } else {
    const Scales before = scales();
    derived_.step(config_);
    take_over(before);
  }
  if (next_item_ < items || derived_.waits()) return false;
  if (change_ == Change::kDefaults) config_valid_ = !store_damaged_;
  change_ = Change::kNone;
  staged_.clear();
  activity_ = Activity::kIdle;
  assemble_conditions();
  return true;
}

inline void Controller::change_items(uint16_t items) {
  const uint8_t most = change_ == Change::kApply ? kAppliedAtOnce : kDefaultsAtOnce;
  for (uint8_t tries = 0; tries < most && next_item_ < items; ++tries) {
    const uint16_t item = next_item_++;
    if (!change_item(item)) continue;
    if (item < protocol::kParamCount) take_parameter(item);
    return;
  }
}

// Whether that changed it.
inline bool Controller::change_item(uint16_t item) {
  if (change_ == Change::kDefaults) return config_.load_default(item);
  const int32_t wanted = staged_.get(config_, item);
  const bool changes = wanted != config_.value[item];
  config_.value[item] = wanted;
  return changes;
}

inline void Controller::take_parameter(uint16_t index) {
  const Scales before = scales();
  derived_.update(config_, index);
  take_over(before);
  if (index == static_cast<uint16_t>(Param::kReferenceMv)) scale_supply();
  if (index == static_cast<uint16_t>(Param::kGrows)) length_known_ = false;
}

// After a change of the scaled constants: what it voids.
inline void Controller::take_over(const Scales& before) {
  eversion_.reconsider();
  if (derived_.oversample_log2 != before.oversample) {
    flex_.set_oversampling(derived_.oversample_log2);
    zeros_.invalidate(0xFFFF);
    drift_.set_quiet(false, tick_);
  }
  if (derived_.trigger_log2 != before.trigger) {
    for (MovingSum& sum : base_sum_) sum.start(derived_.trigger_log2);
  }
  // Another scale of length is another length.
  if (derived_.um_per_count_q16 != before.um_per_count) length_known_ = false;
  assemble_conditions();
}

inline Outcome Controller::set_map(const protocol::SetMap& wanted) {
  const Outcome allowed = permit(Permit::kConfigure);
  if (allowed.reason != Reason::kNone) return allowed;
  const uint8_t branch = static_cast<uint8_t>(wanted.branch);
  if (wanted.zone >= kBodyPressures || wanted.muscle >= kMuscles || branch >= kBranches) {
    return {Reason::kBadValue, 0};
  }
  for (uint8_t i = 0; i < protocol::kMapPoints; ++i) {
    config_.map[wanted.zone][wanted.muscle][branch][i] = wanted.curvature_e5[i];
  }
  return kAccepted;
}

inline Outcome Controller::begin_save() {
  const Outcome allowed = permit(Permit::kSave);
  if (allowed.reason != Reason::kNone) return allowed;
  activity_ = Activity::kSaving;
  return kAccepted;
}

inline void Controller::end_save(bool good, uint8_t slot, uint32_t generation) {
  activity_ = Activity::kIdle;
  if (good) {
    store_damaged_ = false;
    config_valid_ = true;
    post(protocol::EventCode::kSaved, slot, static_cast<int32_t>(generation));
  }
  assemble_conditions();
}

}  // namespace thigmo

#endif  // THIGMO_CORE_CONTROLLER_COMMANDS_H_
