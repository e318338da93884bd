// Controller: the work of a tick. Included by controller.h only.
#ifndef THIGMO_CORE_CONTROLLER_TICK_H_
#define THIGMO_CORE_CONTROLLER_TICK_H_

#include "controller.h"

namespace thigmo {

inline void Controller::begin(LoadResult loaded, protocol::ResetCause cause, const Latches& kept) {
  derived_.update(config_);
  flex_.set_oversampling(derived_.oversample_log2);
  for (MovingSum& sum : base_sum_) sum.start(derived_.trigger_log2);
  config_valid_ = loaded == LoadResult::kLoaded;
  store_damaged_ = loaded == LoadResult::kDamaged;
  if (!config_valid_) raise(Fault::kBadConfig, static_cast<uint8_t>(loaded));
  if (cause == protocol::ResetCause::kWatchdog) raise(Fault::kWatchdog, 0);
  if (cause == protocol::ResetCause::kBrownOut) raise(Fault::kBrownOut, 0);
  // The stop has a latch of its own, and the configuration is judged anew at each start.
  constexpr uint16_t kJudgedAnew =
      static_cast<uint16_t>(mask(Fault::kStopped) | mask(Fault::kBadConfig));
  const uint16_t faults = static_cast<uint16_t>(kept.faults & ~kJudgedAnew);
  for (uint8_t i = 0; i < protocol::kFaultCount; ++i) {
    if ((faults >> i & 1) != 0) raise(static_cast<Fault>(i), kBeforeReset);
  }
  if (kept.stop.latched) stop(kept.stop.nonce);
}

inline void Controller::sense(const Inputs& in) {
  elapsed_ = in.frame->tick - tick_;
  tick_ = in.frame->tick;
  if (grows()) {  // inputs without an encoder float
    encoder_ = in.encoder;
    encoder_errors_ = in.encoder_errors;
  }
  if (in.supply_mv != supply_raw_mv_) {
    supply_raw_mv_ = in.supply_mv;
    scale_supply();
  }
  rx_overruns_ = in.rx_overruns;
  motor_power_ = in.motor_power;
  if (in.estop && !estop_ && brake_fitted() && power_wanted()) {
    stop_tick_ = tick_;
    proving_stop_ = true;
  }
  estop_ = in.estop;
  const bool odd = (in.frame->tick & 1) != 0;
  const uint16_t* count = in.frame->count;
  for (uint8_t i = 0; i < kMuscles; ++i) pressure_[i].add(count[i]);
  for (uint8_t i = 0; i < kColumns; ++i) base_sum_[i].add(count[kMuscles + i]);
#if THIGMO_IMUS
  zeros_.invalidate(in.frame->restarted);
#endif
  const uint16_t done = flex_.add_tick(odd, count + kMuscles);
  if (done == 0) return;
  drift_.add(done, flex_);
  if (averaging_) zeros_.add(done, flex_);
}

THIGMO_NOINLINE inline void Controller::scale_supply() {
  const int32_t reference = config_.get(Param::kReferenceMv);
  supply_mv_ = static_cast<uint16_t>(supply_raw_mv_ * reference / kReferenceMv);
}

inline void Controller::control() {
  // A lost frame must not cost a loop its step.
  const uint8_t due = elapsed_ < 5 ? static_cast<uint8_t>(elapsed_) : 5;
  for (uint8_t i = 0; i < due; ++i) {
    phase_ = static_cast<uint8_t>(phase_ == 4 ? 0 : phase_ + 1);
    run_phase(phase_);
  }
}

THIGMO_NOINLINE inline void Controller::decide() {
  if (activity_ == Activity::kZeroing) zeroing_step();
  if (activity_ == Activity::kTesting && tick_ - test_tick_ >= test_.duration_ms) end_test();
  trigger_step();
  if (snapshots_.due(tick_)) take_peak();
  if (estop_) raise(Fault::kEstop, 0);
  watch_power();
  supervise(0);
  uint16_t period = static_cast<uint16_t>(config_.get(Param::kTelemetryMs));
  if (winding() && (period == 0 || period > kWindingTelemetryMs)) period = kWindingTelemetryMs;
  const uint16_t waited = static_cast<uint16_t>(tick_ - telemetry_tick_);
  // A period of whole control steps falls on their lightest tick.
  telemetry_due_ = period != 0 && waited >= period && flex_.all_ready() &&
                   (!derived_.telemetry_aligned || phase_ == kTelemetryPhase);
  if (telemetry_due_) telemetry_tick_ = static_cast<uint16_t>(tick_);
}

// Out of line, as all that is rare in a tick: it needs many registers, which each tick would save.
THIGMO_NOINLINE inline void Controller::take_peak() {
  if (!snapshots_.store_peak(reading())) return;
  post(protocol::EventCode::kPeak, peak_muscle_, kPeakReadings);
}

inline void Controller::run_phase(uint8_t phase) {
  switch (phase) {
    case 0:
      if (activity_ == Activity::kSweeping) advance_sweep();
      // Muscles rest while the body moves, so this turn has room.
      if (moves() && length_known_ && derived_.judges_encoder) watch_fold();
      for (uint8_t i = 0; i < kMuscles; i += 2) pressure_step(i);
      break;
    case 1:
      for (uint8_t i = 1; i < kMuscles; i += 2) pressure_step(i);
      // A press that was let go ends when all set points are back at zero.
      if (activity_ == Activity::kPressing && released()) {
        finish_activity(protocol::EventCode::kActivityDone, length_um_);
      }
      break;
    case 2:
      spool_step();
      break;
    case 3:
      body_step();
      break;
    default:
      free_step();
      assemble_conditions();
      watch_faults();
      break;
  }
}

inline void Controller::advance_sweep() {
  if (!sweep_.advance(tick_)) {
    for (PressureLoop& loop : loop_) loop.cut();
    finish_activity(protocol::EventCode::kActivityDone, length_um_);
    return;
  }
  if (sweep_.half_began()) begin_half();
  press_only(sweep_.muscle(), sweep_.set_cpsi(tick_));
}

// One muscle's set point; the others' are zero at once.
inline void Controller::press_only(uint8_t muscle, int16_t cpsi) {
  for (uint8_t i = 0; i < kMuscles; ++i) {
    if (i == muscle) {
      loop_[i].set_target(cpsi, derived_.slew_q8);
    } else {
      loop_[i].cut();
    }
  }
}

inline bool Controller::released() const {
  for (const PressureLoop& loop : loop_) {
    if (loop.target_cpsi() != 0 || loop.set_cpsi() != 0) return false;
  }
  return true;
}

inline void Controller::begin_half() {
  trigger_.rearm();
  const uint32_t spacing = static_cast<uint32_t>(config_.get(Param::kPeakSpacingMs));
  // Ten readings, nine gaps, centred on the peak.
  snapshots_.plan_peak(sweep_.peak_tick() - 9 * spacing / 2, static_cast<uint16_t>(spacing));
  peak_muscle_ = sweep_.muscle();
}

// Inlined by order, once for each muscle: places that are known then cost a fifth of the work less.
__attribute__((always_inline)) inline void Controller::pressure_step(uint8_t muscle) {
  if (!fitted(muscle)) return;
  PressureReading& sensor = pressure_[muscle];
  sensor.update(config_.get(Param::kPressureZero, muscle), derived_.pressure_gain[muscle]);
  const int16_t measured = sensor.cpsi();
  muscle_[muscle].update(measured, derived_.lag_alpha_q16[muscle],
                         static_cast<int16_t>(config_.get(Param::kReversalCpsi, muscle)),
                         derived_.reversal_inverse_q24[muscle]);
  // Under test the output is what the host says, and the loop stands by.
  const int16_t duty =
      testing(muscle) ? test_.level : loop_[muscle].step(measured, config_, derived_);
  outputs_.drive[muscle] = may_energise(state_) ? duty : PressureLoop::kOff;

  if (!sensor.doubtful()) {
    over_[muscle].add(measured > config_.get(Param::kOverPressureCpsi), kPressureSteps);
  }
}

inline void Controller::spool_step() {
  watch_motion(outputs_.motor);
  if (winding() && !moves()) {
    begin_move();
    outputs_.motor = 0;
  } else if (winding()) {
    SpoolLoop::Outcome outcome = spool_.step(encoder_, config_, derived_);
    if (activity_ == Activity::kHoming && homing_ == Homing::kBackOff &&
        outcome == SpoolLoop::Outcome::kMoving && tick_ - back_off_tick_ > kBackOffMs) {
      outcome = SpoolLoop::Outcome::kStalled;
    }
    outputs_.motor = may_energise(state_) ? spool_.duty() : static_cast<int16_t>(0);
    if (outcome == SpoolLoop::Outcome::kAgainst) {
      outputs_.motor = 0;
      length_known_ = false;
      raise(Fault::kSpoolSlip, static_cast<uint8_t>(protocol::SlipCause::kAgainst));
    } else if (outcome == SpoolLoop::Outcome::kStalled) {
      finish_spool(false);
    } else if (outcome == SpoolLoop::Outcome::kArrived) {
      finish_spool(true);
    }
  } else {
    outputs_.motor = testing(protocol::Output::kMotor) && may_energise(state_)
                         ? test_.level
                         : static_cast<int16_t>(0);
  }
  slipping_ = slip_.step(encoder_, outputs_.motor != 0, derived_.slip_counts) ||
              (moves() && spool_.overrun()) || motion_.astray(derived_);
  // Drift is known of a spool that stands still, whose turn is a light one.
  if (!winding()) drift_.update(tick_, flex_.log2(), derived_.flex_gain_q16);
}

// Before the next duty is known, of the one since the last step. A driver under test is watched by
// its own test.
inline void Controller::watch_motion(int16_t duty) {
  if (activity_ == Activity::kTesting) {
    motion_.restart(encoder_);
    if (proving_ && magnitude(encoder_ - proof_count_) > derived_.counts(kProofUm)) {
      outputs_.motor = 0;
      length_known_ = false;
      raise(Fault::kSpoolSlip, static_cast<uint8_t>(protocol::SlipCause::kBrake));
    }
    return;
  }
  const bool growing = activity_ == Activity::kGrowing;
  const int32_t pull_duty = zone_ < kBodyPressures ? config_.get(Param::kPullDuty, zone_) : 0;
  motion_.step(encoder_, duty, moves() ? spool_.wanted_q16() : 0, growing, fold_.moves(), pull_duty,
               config_, derived_);
  if (growing && motion_.missed(derived_)) stall(protocol::StallCause::kSlow);
  if (growing && motion_.exceeds(derived_)) stall(protocol::StallCause::kFast);
  if (!winding()) return;
  const uint16_t jumps = static_cast<uint16_t>(encoder_errors_ - errors_before_);
  if (jumps > kJumps && jumps > magnitude(encoder_ - moved_from_) >> 5) {
    stall(protocol::StallCause::kJumps);
  }
}

THIGMO_NOINLINE inline void Controller::watch_fold() {
  switch (fold_.step(flex_, length_um_, config_, derived_)) {
    case FoldWatch::Verdict::kNone:
      break;
    case FoldWatch::Verdict::kEarly:
      stall(protocol::StallCause::kEverted);
      break;
    case FoldWatch::Verdict::kLate:
      stall(protocol::StallCause::kLate);
      break;
    case FoldWatch::Verdict::kOutwards:
      stall(protocol::StallCause::kOutwards);
      break;
  }
}

// The motor has its supply while it moves by command, and else none: what its driver does then does
// not matter, and the brake holds. A robot without contacts and brake has no use for the enable.
inline bool Controller::power_wanted() const {
  return may_energise(state_) && (winding() || testing(protocol::Output::kMotor));
}

inline Enables Controller::enables() const {
  const bool armed = may_energise(state_);
  const bool power = power_wanted();
  // Homing's stages follow each other with the brake open.
  const bool closes = activity_ != Activity::kHoming && moves() && spool_.braked();
  return {armed && !testing_vent(), armed && body_air_, power || proving_stop_,
          power && !proving_ && !closes};
}

// Whether the motor's supply follows its enable, and the emergency stop's contact cuts it.
inline void Controller::watch_power() {
  if (!brake_fitted()) return;
  if (proving_stop_ && tick_ - stop_tick_ >= kStopProofMs) {
    proving_stop_ = false;
    power_tick_ = tick_;
    if (estop_ && motor_power_) {
      raise(Fault::kSpoolSlip, static_cast<uint8_t>(protocol::SlipCause::kStop));
    }
  }
  const bool wanted = power_wanted();
  if (wanted != power_was_wanted_) {
    power_was_wanted_ = wanted;
    power_tick_ = tick_;
  }
  if (tick_ - power_tick_ < kPowerMs) return;
  power_wrong_ = motor_power_ != wanted;
  if (!power_wrong_) return;
  raise(Fault::kSpoolSlip, static_cast<uint8_t>(wanted ? protocol::SlipCause::kUnpowered
                                                       : protocol::SlipCause::kSupply));
}

// The supervisor ends the activity.
THIGMO_NOINLINE inline void Controller::stall(protocol::StallCause cause) {
  outputs_.motor = 0;
  length_known_ = false;
  raise(Fault::kSpoolStall, static_cast<uint8_t>(cause));
}

inline void Controller::finish_spool(bool arrived) {
  outputs_.motor = 0;
  if (activity_ == Activity::kHoming) {
    finish_homing_stage(arrived);
    return;
  }
  if (!arrived) return stall(protocol::StallCause::kStill);
  length_um_ = derived_.um(encoder_ - zero_count_);
  finish_activity(protocol::EventCode::kActivityDone, length_um_);
  body_step();
}

THIGMO_NOINLINE inline void Controller::finish_homing_stage(bool arrived) {
  const auto wind = [this](Homing stage, int32_t um, int32_t speed_um_s, int16_t duty) {
    homing_ = stage;
    spool_.start(encoder_, encoder_ + derived_.counts(um), derived_.speed_q16(speed_um_s),
                 derived_.accel_q16, duty);
  };
  switch (homing_) {
    case Homing::kSeek:
      // Further than the whole body, and no base met: the tail is loose.
      if (arrived) return lose_home();
      touch_count_ = encoder_;
      back_off_tick_ = tick_;
      wind(Homing::kBackOff, kBackOffUm, kBackOffUmS,
           static_cast<int16_t>(config_.get(Param::kSpoolDeadZone) + kBackOffDuty));
      return;
    case Homing::kBackOff:
      if (!arrived) {
        // Nothing turns, or the encoder does not see it: the stall was not the base's.
        return stall(protocol::StallCause::kStill);
      }
      wind(Homing::kTouch, -2 * kBackOffUm, derived_.home_speed_um_s, derived_.homing_duty);
      return;
    case Homing::kTouch:
      break;
  }
  const auto apart = [this](int32_t count, int32_t um) {
    return magnitude(derived_.um(encoder_ - count)) > um;
  };
  if (arrived || apart(touch_count_, kTouchUm)) return lose_home();
  if (length_known_ && apart(zero_count_, kHomeUm)) return lose_home();
  // An unknown length stays unknown: a jam stalls twice at one place as well.
  zero_count_ = encoder_;
  fold_.restart(0);
  finish_activity(protocol::EventCode::kActivityDone, 0);
  body_step();
}

inline void Controller::lose_home() {
  length_known_ = false;
  finish_activity(protocol::EventCode::kActivityAborted,
                  static_cast<uint8_t>(Reason::kLengthUnknown));
}

// Takes the length over; returns the sensors that it has everted since the last call.
inline uint16_t Controller::follow_length() {
  length_um_ = derived_.um(encoder_ - zero_count_);
  const uint16_t fresh =
      eversion_.update(length_known_, length_um_, tick_, config_, derived_.enabled_mask);
  zeros_.invalidate(static_cast<uint16_t>(fresh | ~eversion_.everted_mask()));
  return fresh;
}

inline void Controller::body_step() {
  const uint16_t fresh = follow_length();
  if (fresh != 0) {
    for (uint8_t i = 0; i < kSensors; ++i) {
      if ((fresh >> i & 1) != 0) post(protocol::EventCode::kEverted, i, length_um_);
    }
  }
  const int32_t limit = config_.get(Param::kVentCpsi);
  bool low = true, driven = false, doubtful = false;
  for (uint8_t i = 0; i < kMuscles; ++i) {
    driven = driven || outputs_.drive[i] >= 0;
    if (!fitted(i)) continue;
    low = low && pressure_[i].cpsi() < limit;
    doubtful = doubtful || pressure_[i].doubtful();
  }
  if (!doubtful) unvented_.add(!low, kPressureSteps);
  if (driven || unvented_.full(kPressureSteps)) {
    vented_steps_ = 0;
  } else if (low && !doubtful && vented_steps_ < kRestSteps) {
    ++vented_steps_;
  }
  drift_.set_quiet(vented_steps_ >= kVentedSteps && outputs_.motor == 0 && !slipping_, tick_);
}

inline void Controller::free_step() {
  if (zone_ >= kBodyPressures) {
    free_e5_ = 0;
    return;
  }
  // The muscles that are not driven hold (almost) no pressure and add (almost) nothing.
  int32_t sum = 0;
  for (uint8_t i = 0; i < kMuscles; ++i) {
    sum += muscle_[i].free_e5(config_.map[zone_][i], derived_.supports_per_cpsi_q22);
  }
  free_e5_ = saturated16(sum);
}

THIGMO_NOINLINE inline void Controller::zeroing_step() {
  const uint16_t mask = zeros_.mask();
  if ((conditions_ & protocol::mask(Condition::kVented)) == 0 || slipping_) {
    averaging_ = false;
    finish_activity(protocol::EventCode::kActivityAborted,
                    static_cast<uint8_t>(Reason::kNotVented));
    return;
  }
  if (!averaging_) {
    if (zeroing_next_ > 0) {
      // Averages become zeros, one sensor a control period.
      if (phase_ != kSparePhase) return;
      zeros_.finish(static_cast<uint8_t>(zeroing_next_ - 1), flex_.log2());
      if (zeroing_next_++ < kSensors) return;
      zeroing_next_ = 0;
      post(protocol::EventCode::kZeroed, mask, 0);
      finish_activity(protocol::EventCode::kActivityDone, length_um_);
      return;
    }
    // A drift that begins now shows in the window that began with the command.
    if (!drift_.known() || drift_.closed() == zeroing_window_) return;
    const int32_t limit = config_.get(Param::kDriftLimitE5);
    for (uint8_t i = 0; i < kSensors; ++i) {
      if ((mask >> i & 1) != 0 && magnitude(drift_.drift_e5_s(i)) > limit) {
        finish_activity(protocol::EventCode::kActivityAborted,
                        static_cast<uint8_t>(Reason::kDrifting));
        return;
      }
    }
    zeros_.begin(mask);
    flex_.restart();
    zeroing_tick_ = tick_;
    averaging_ = true;
    return;
  }
  // The longest reading must fit at least once.
  const uint32_t needed =
      greater<uint32_t>(static_cast<uint32_t>(config_.get(Param::kZeroMs)), 2u << flex_.log2());
  if (tick_ - zeroing_tick_ < needed) return;
  averaging_ = false;
  zeroing_next_ = 1;
}

// The muscle that bends the body: the one that is driven, or the one with more pressure left.
inline uint8_t Controller::active_muscle() const {
  if (activity_ == Activity::kSweeping) return sweep_.muscle();
  if (activity_ == Activity::kHolding) return peak_muscle_;
  uint8_t most = 0;
  for (uint8_t i = 1; i < kMuscles; ++i) {
    if (muscle_[i].lagged_cpsi() > muscle_[most].lagged_cpsi()) most = i;
  }
  return most;
}

// Whether a muscle bends the body towards negative curvature, by its map.
inline bool Controller::bends_back(uint8_t muscle) const {
  return config_.map[zone_][muscle][0][protocol::kMapPoints - 1] < 0;
}

THIGMO_NOINLINE inline void Controller::look_at_base(uint8_t column) {
  const uint8_t sensor = base_input(column);
  const int32_t total = total_ohm_q4(count_q6(base_sum_[column].sum(), derived_.trigger_log2));
  column_e5_[column] =
      curvature_e5(total, zeros_.total_at_zero(sensor), derived_.flex_gain_q16[sensor]);
}

inline int16_t Controller::bend_e5(uint8_t sensor) const {
  const int32_t total = total_ohm_q4(count_q6(flex_.latest(sensor), flex_.log2()));
  return curvature_e5(total, zeros_.total_at_zero(sensor), derived_.flex_gain_q16[sensor]);
}

THIGMO_NOINLINE inline void Controller::trigger_step() {
  const uint16_t usable = usable_mask();
  const bool vented = (conditions_ & mask(Condition::kVented)) != 0 && !bending();
  const uint8_t active = active_muscle();
  const uint8_t now = vented ? kAtRest : static_cast<uint8_t>(1u << active);
  int32_t sum = 0;
  uint8_t count = 0;
  bool wrinkled = false;
  const int16_t empty_cpsi = static_cast<int16_t>(config_.get(Param::kVentCpsi));
  for (uint8_t i = 0; i < kColumns; ++i) {
    const bool known = column_known_[i];
    column_known_[i] = false;
    // A sensor under a muscle wrinkles while that holds pressure: its readings are worth nothing.
    const uint8_t counts = static_cast<uint8_t>(config_.get(Param::kTriggerWhen, base_input(i)));
    if ((counts & now) == 0) continue;
    const uint16_t bit = static_cast<uint16_t>(i == 0 ? 1u : 1u << kColumn);
    if ((usable & bit) == 0 || !base_sum_[i].full()) continue;
    // A mean of many conversions moves little in a millisecond: each is looked at on every second
    // tick, and when it begins to count.
    if ((tick_ & 1) == i || !known) look_at_base(i);
    column_known_[i] = true;
    sum += column_e5_[i];
    ++count;
    // So does one whose muscle still empties after its own half.
    for (uint8_t m = 0; m < kMuscles; ++m) {
      if ((counts >> m & 1) == 0 && pressure_[m].cpsi() >= empty_cpsi) wrinkled = true;
    }
  }
  base_e5_ = static_cast<int16_t>(count == 2 ? sum >> 1 : sum);
  const bool swings = vented && vented_steps_ < kRestSteps;
  if (count == 0 || wrinkled || swings || zone_ >= kBodyPressures || !may_energise(state_)) {
    trigger_.interrupt();
    return;
  }
  const int32_t difference = static_cast<int32_t>(base_e5_) - free_e5_;
  const int32_t threshold = config_.get(Param::kTriggerE5);
  if (activity_ == Activity::kIdle && trigger_.latched()) {
    quiet_run_ = magnitude(difference) * 2 < threshold ? static_cast<uint16_t>(quiet_run_ + 1) : 0;
    if (quiet_run_ >= kRearmMs) trigger_.rearm();
  } else {
    quiet_run_ = 0;
  }
  const int32_t held_back = bends_back(active) ? difference : -difference;
  if (!trigger_.update(vented ? magnitude(difference) : held_back, threshold,
                       static_cast<uint16_t>(config_.get(Param::kTriggerDebounceMs)))) {
    return;
  }
  take_contact(active, difference);
}

THIGMO_NOINLINE inline void Controller::take_contact(uint8_t muscle, int32_t difference_e5) {
  snapshots_.store_trigger(reading());
  post(protocol::EventCode::kContact, muscle, difference_e5);
  if (activity_ == Activity::kSweeping &&
      (sweep_options_ & mask(protocol::SweepOption::kHoldOnContact)) != 0) {
    hold_contact(muscle);
  }
}

inline void Controller::hold_contact(uint8_t muscle) {
  activity_ = Activity::kHolding;
  press_only(muscle, pressure_[muscle].cpsi());
  peak_muscle_ = muscle;
  // The ten readings are taken here instead, once the body has come to rest.
  const uint32_t wait =
      2 * static_cast<uint32_t>(config_.get(Param::kLagMs, muscle)) + kHoldSettleMs;
  snapshots_.plan_peak(tick_ + wait, static_cast<uint16_t>(config_.get(Param::kPeakSpacingMs)));
}

inline Reading Controller::reading() const {
  Reading r;
  const uint8_t active = active_muscle();
  r.t_us = t_us();
  for (uint8_t i = 0; i < kSensors; ++i) r.flex_sum[i] = flex_.latest(i);
  for (uint8_t i = 0; i < kMuscles; ++i) r.cpsi[i] = pressure_[i].cpsi();
  r.lagged_cpsi = muscle_[active].lagged_cpsi();
  r.base_e5 = base_e5_;
  r.free_e5 = free_e5_;
  r.muscle = active;
  r.branch = muscle_[active].branch();
  return r;
}

inline void Controller::assemble_conditions() {
  const uint16_t in_use = static_cast<uint16_t>(derived_.enabled_mask & eversion_.everted_mask());
  bool energised = outputs_.motor != 0;
  for (const int16_t drive : outputs_.drive) energised = energised || drive >= 0;
  const uint32_t patience = static_cast<uint32_t>(config_.get(Param::kHeartbeatMs));
  uint16_t c = 0;
  if (length_known_) {
    c = mask(Condition::kLengthKnown);
    if ((in_use & ~eversion_.settled_mask()) == 0) c |= mask(Condition::kSettled);
    if ((in_use & ~zeros_.valid_mask()) == 0) c |= mask(Condition::kZeroed);
    if (eversion_.half_mask() != 0) c |= mask(Condition::kHalfEverted);
    if ((usable_mask() & derived_.bases_mask) != 0) c |= mask(Condition::kBaseUsable);
  }
  if (grows()) c |= mask(Condition::kSpoolFitted);
  if (zone_ < kBodyPressures) c |= mask(Condition::kZoneKnown);
  if (vented_steps_ >= kVentedSteps) c |= mask(Condition::kVented);
  if (beaten_ && tick_ - beat_tick_ <= patience) c |= mask(Condition::kHostAlive);
  if (energised) c |= mask(Condition::kEnergised);
  if (estop_) c |= mask(Condition::kEstop);
  if (config_valid_) c |= mask(Condition::kConfigValid);
  if (supply_mv_ >= config_.get(Param::kSupplyMinMv)) c |= mask(Condition::kSupplyGood);
  if (trigger_.latched()) c |= mask(Condition::kContact);
  if (body_air_) c |= mask(Condition::kBodyAir);
  conditions_ = c;
}

// Faults whose cause is present now.
inline uint16_t Controller::causes() const {
  uint16_t present = 0;
  const auto put = [&present](Fault fault, bool holds) {
    if (holds) present = static_cast<uint16_t>(present | mask(fault));
  };
  const auto is = [this](Condition condition) { return (conditions_ & mask(condition)) != 0; };
  bool over = false;
  bool wire = false;
  bool stuck = false;
  for (uint8_t i = 0; i < kMuscles; ++i) {
    over = over || over_[i].full(kPressureSteps);
    wire = wire || (fitted(i) && pressure_[i].wire_broken());
    stuck = stuck || loop_[i].astray();
  }
  bool open = false;
  bool shorted = false;
  for (uint8_t i = 0; flex_.any_bad() && i < kSensors; ++i) {
    open = open || (enabled(i) && flex_.open(i));
    shorted = shorted || (enabled(i) && flex_.shorted(i));
  }
  put(Fault::kOverPressure, over);
  put(Fault::kPressureWire, wire);
  put(Fault::kPressureStuck, stuck);
  put(Fault::kFlexOpen, open);
  put(Fault::kFlexShort, shorted);
  put(Fault::kSpoolSlip, slipping_ || power_wrong_);
  put(Fault::kBrownOut, !is(Condition::kSupplyGood));
  put(Fault::kBadConfig, !config_valid_);
  put(Fault::kEstop, estop_);
  // Gone for the purpose of clearing only when the host speaks again and the muscles are empty.
  put(Fault::kHostSilent, !is(Condition::kHostAlive));
  put(Fault::kInterlock, !is(Condition::kVented));
  put(Fault::kStopped, stop_.latched);
  return present;
}

inline void Controller::watch_faults() {
  const auto is = [this](Condition condition) { return (conditions_ & mask(condition)) != 0; };
  // The dead-man looks at the last beat alone: outputs flicker, as a tail that overruns its profile
  // is braked and driven in turn.
  if (may_energise(state_) && !is(Condition::kHostAlive)) {
    raise(Fault::kHostSilent, static_cast<int32_t>(tick_ - beat_tick_));
  }
  for (uint8_t i = 0; i < kMuscles; ++i) {
    if (!fitted(i)) continue;
    if (over_[i].full(kPressureSteps)) raise(Fault::kOverPressure, i);
    if (pressure_[i].wire_broken()) raise(Fault::kPressureWire, i);
    if (loop_[i].stuck(derived_)) raise(Fault::kPressureStuck, i);
    if (loop_[i].mismatched(derived_)) raise(Fault::kPressureMismatch, i);
  }
  for (uint8_t i = 0; flex_.any_bad() && i < kSensors; ++i) {
    if (!enabled(i)) continue;
    if (flex_.open(i)) raise(Fault::kFlexOpen, i);
    if (flex_.shorted(i)) raise(Fault::kFlexShort, i);
  }
  if (slipping_) {
    raise(Fault::kSpoolSlip, static_cast<uint8_t>(protocol::SlipCause::kTurned));
    length_known_ = false;
  }
  if (!is(Condition::kSupplyGood)) raise(Fault::kBrownOut, supply_mv_);
  if (rx_overruns_ != overruns_seen_) {
    overruns_seen_ = rx_overruns_;
    raise(Fault::kLinkOverrun, rx_overruns_);
  }
  // Zeroing energises nothing, and ends by itself.
  if (activity_ != Activity::kIdle && activity_ != Activity::kSaving &&
      activity_ != Activity::kZeroing) {
    const Reason lost = loss(permit_, conditions_);
    if (lost != Reason::kNone) raise(Fault::kInterlock, static_cast<uint8_t>(lost));
  }
}

inline void Controller::supervise(uint8_t requests) {
  uint8_t signals = requests;
  if (faults_.latched() != 0) signals = static_cast<uint8_t>(signals | bit(Signal::kFaultLatched));
  if (greeted_) signals = static_cast<uint8_t>(signals | bit(Signal::kHello));
  if (activity_ != Activity::kIdle && activity_ != Activity::kSaving) {
    signals = static_cast<uint8_t>(signals | bit(Signal::kActive));
  }
  // The table is walked only when something it reads has changed.
  if (signals == judged_signals_ && conditions_ == judged_conditions_) return;
  judged_signals_ = signals;
  judged_conditions_ = conditions_;
  const State next = next_state(state_, conditions_, signals);
  if (next != state_) {
    state_ = next;
    judged_signals_ = static_cast<uint8_t>(~signals);
    if (!may_energise(next)) {
      make_safe(next == State::kFault ? Reason::kFaultLatched : Reason::kNone);
    }
  }
}

// Valves to 0 mA, motor braked, body emptied, activity ended. Never a retraction.
inline void Controller::make_safe(Reason reason) {
  for (uint8_t i = 0; i < kMuscles; ++i) {
    loop_[i].disarm();
    outputs_.drive[i] = PressureLoop::kOff;
  }
  outputs_.motor = 0;
  body_air_ = false;
  proving_ = false;
  averaging_ = false;
  zeroing_next_ = 0;
  snapshots_.cancel_peak();
  if (activity_ != Activity::kIdle && activity_ != Activity::kSaving) {
    finish_activity(protocol::EventCode::kActivityAborted, static_cast<uint8_t>(reason));
  }
}

inline void Controller::end_test() {
  for (uint8_t i = 0; i < kMuscles; ++i) {
    if (testing(i)) outputs_.drive[i] = PressureLoop::kOff;
  }
  outputs_.motor = 0;
  proving_ = false;
  finish_activity(protocol::EventCode::kActivityDone, length_um_);
}

inline void Controller::start(Activity activity, Permit permit) {
  activity_ = activity;
  permit_ = permit;
  trigger_.rearm();
  quiet_run_ = 0;
  supervise(0);
}

inline void Controller::finish_activity(protocol::EventCode code, int32_t value) {
  const Activity ended = activity_;
  start_ = Start::kDone;
  activity_ = Activity::kIdle;
  post(code, static_cast<uint8_t>(ended), value);
}

THIGMO_NOINLINE inline void Controller::fill(protocol::Telemetry* out) const {
  out->t_us = t_us();
  for (uint8_t i = 0; i < kSensors; ++i) out->flex_sum[i] = flex_.latest(i);
  for (uint8_t i = 0; i < kMuscles; ++i) {
    out->pressure_cpsi[i] = pressure_[i].cpsi();
    out->set_cpsi[i] = loop_[i].set_cpsi();
    out->drive[i] = static_cast<uint16_t>(greater<int16_t>(outputs_.drive[i], 0));
  }
  out->length_um = length_um_;
  out->motor = outputs_.motor;
  out->base_e5 = base_e5_;
  out->free_e5 = free_e5_;
  out->state_activity =
      static_cast<uint8_t>(static_cast<uint8_t>(state_) * 16 + static_cast<uint8_t>(activity_));
  out->faults = faults_.latched();
}

inline void Controller::fill(protocol::StatusReport* out) const {
  out->status = protocol::Status::kOk;
  out->state = state_;
  out->activity = activity_;
  out->zone = zone_;
  out->faults = faults_.latched();
  out->conditions = conditions_;
  out->t_us = t_us();
  out->length_um = length_um_;
  for (uint8_t i = 0; i < kMuscles; ++i) out->pressure_cpsi[i] = pressure_[i].cpsi();
  out->everted_mask = eversion_.everted_mask();
  out->settled_mask = eversion_.settled_mask();
  out->zeroed_mask = zeros_.valid_mask();
  out->event_number = events_.newest();
  out->supply_mv = supply_mv_;
  out->encoder_errors = encoder_errors_;
  out->stop_nonce = stop_.nonce;
  out->config_generation = 0;  // the robot, which owns the store, fills it in
}

inline void Controller::fill(uint8_t sensor, protocol::SensorReport* out) const {
  out->status = protocol::Status::kOk;
  out->sensor = sensor;
  out->flex_sum = flex_.latest(sensor);
  out->zero_sum_q8 = zeros_.zero_sum_q8(sensor);
  out->drift_e5 = drift_.drift_e5_s(sensor);
  out->settle_left_ms =
      eversion_.settle_left_ms(sensor, tick_, static_cast<uint32_t>(config_.get(Param::kSettleMs)));
  out->everted_t_us = eversion_.everted_tick(sensor) * 1000u;
  const auto flag = [sensor](uint16_t mask, uint8_t to) {
    return static_cast<uint8_t>((mask >> sensor & 1u) << to);
  };
  out->flags =
      static_cast<uint8_t>(flag(eversion_.everted_mask(), 0) | flag(eversion_.settled_mask(), 1) |
                           flag(zeros_.valid_mask(), 2) | (flex_.open(sensor) ? 8 : 0) |
                           (flex_.shorted(sensor) ? 16 : 0) | flag(derived_.enabled_mask, 5));
}

}  // namespace thigmo

#endif  // THIGMO_CORE_CONTROLLER_TICK_H_
