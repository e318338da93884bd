// The robot controller without its board: conversions in, duties out, once a millisecond.
//
// This class wires sensing, control and safety together and holds the schedule; each part's own
// header says what it does. It knows nothing of pins, bytes or time beyond the tick. Work is spread
// over the five ticks of a control period, so that no tick has more than one loop's load:
//
//   tick % 5   every tick: conversions, trigger, peak readings, emergency stop, supervisor
//      0       sweep generator; pressure loop, lag and branch of every second muscle; sensors in
//              the fold
//      1       pressure loop, lag and branch of the other muscles
//      2       spool: profile, position loop, stall; slip, motion by duty
//      3       everted length, eversion, settle clocks, vented, quiet
//      4       free curvature by the maps, conditions, faults
//
// Commands (commands.h) call the public methods between ticks.
#ifndef THIGMO_CORE_CONTROLLER_H_
#define THIGMO_CORE_CONTROLLER_H_

#include <stdint.h>

#include "config/configuration.h"
#include "config/derived.h"
#include "config/staged.h"
#include "config/store.h"
#include "control/motion_watch.h"
#include "control/pressure_loop.h"
#include "control/spool.h"
#include "control/sweep.h"
#include "link/events.h"
#include "safety/faults.h"
#include "safety/leaky_count.h"
#include "safety/supervisor.h"
#include "sensing/eversion.h"
#include "sensing/flex.h"
#include "sensing/fold_watch.h"
#include "sensing/free_curvature.h"
#include "sensing/pressure.h"
#include "sensing/snapshot.h"
#include "sensing/trigger.h"
#include "sensing/zeroing.h"

namespace thigmo {

// What a command came to.
struct Outcome {
  Reason reason;  // none = accepted
  int32_t detail;
};

struct Inputs {
  const AdcFrame* frame;
  int32_t encoder;
  uint16_t encoder_errors;
  uint16_t supply_mv;
  uint16_t rx_overruns;
  bool estop;
  bool motor_power;
};

struct Outputs {
  int16_t drive[kMuscles];  // duty, or PressureLoop::kOff
  int16_t motor;            // 0 = brake
};

class Controller {
 public:
  // A tick's conversions are complete so long after it.
  explicit Controller(uint16_t frame_us) : frame_us_(frame_us) {}

  void begin(LoadResult loaded, protocol::ResetCause cause, const Latches& kept);

  // One tick's work: conversions into readings; the loops whose turn it is; then trigger, peak,
  // zeroing, faults and supervisor. In this order, once each.
  void sense(const Inputs& in);
  void control();
  void decide();

  // Commands.
  Outcome arm();
  Outcome vent();
  Outcome disarm();
  Outcome clear_stop(uint32_t nonce);
  Outcome clear_faults(uint16_t wanted);
  Outcome set_pressure(const protocol::SetPressure& wanted);
  Outcome grow_to(int32_t length_um, uint32_t speed_um_s);
  Outcome retract_to(int32_t length_um, uint32_t speed_um_s);
  Outcome home();
  Outcome confirm_length(int32_t length_um, bool settled);
  Outcome select_zone(uint8_t zone);
  Outcome body_air(uint8_t open);
  Outcome test_output(const protocol::TestOutput& wanted);
  Outcome sweep(const protocol::Sweep& wanted);
  Outcome zero_sensors(uint16_t mask);
  Outcome set_parameter(uint16_t index, int32_t value);
  Outcome set_map(const protocol::SetMap& wanted);
  Outcome begin_apply();
  Outcome begin_defaults();
  bool configure_step();  // once a tick; true when the parameters are applied or defaults loaded
  Outcome begin_save();   // the robot then drives the store, and calls end_save()
  void end_save(bool good, uint8_t slot, uint32_t generation);

  // Somebody stops the robot; at once, in every state.
  void stop(uint32_t nonce);

  // A host said hello, the same as before or another; a heartbeat arrived.
  void greet(bool same_host);
  void beat() {
    beat_tick_ = tick_;
    beaten_ = true;
  }

  // What the wire reports.
  void fill(protocol::Telemetry* out) const;
  void fill(protocol::StatusReport* out) const;
  void fill(uint8_t sensor, protocol::SensorReport* out) const;
  bool telemetry_due() const { return telemetry_due_; }

  const Outputs& outputs() const { return outputs_; }
  const Configuration& configuration() const { return config_; }
  int32_t parameter(uint16_t index) const { return staged_.get(config_, index); }
  Configuration* mutable_configuration() { return &config_; }  // for the store, at start
  const Snapshots& snapshots() const { return snapshots_; }
  EventQueue& events() { return events_; }
  uint32_t now() const { return tick_; }
  State state() const { return state_; }
  Activity activity() const { return activity_; }
  uint16_t conditions() const { return conditions_; }
  uint16_t faults() const { return faults_.latched(); }
  int32_t length_um() const { return length_um_; }
  // Where the tip was last known apart from the encoder (sensing/fold_watch.h).
  uint8_t seen_sensor() const { return fold_.seen_sensor(); }
  int32_t seen_um() const { return fold_.seen_um(); }
  // Whether a sensor reads curvature: enabled, everted, zeroed.
  bool reads(uint8_t sensor) const { return (usable_mask() >> sensor & 1) != 0; }
  // Curvature by a sensor's latest reading, 1e-5/cm.
  int16_t bend_e5(uint8_t sensor) const;
  bool body_air() const { return body_air_; }
  Enables enables() const;
  Latches latches() const { return {stop_, faults_.latched()}; }

 private:
  static constexpr uint8_t kTelemetryPhase = 3;
  static constexpr uint8_t kSparePhase = 2;      // the spool's, which stands still then
  static constexpr int32_t kReferenceMv = 1100;  // by which a board measures its supply
  static constexpr uint8_t kAtRest = 0x80;       // of trigger_when: while no muscle bends the body
  static constexpr uint8_t kVentedSteps = 20;    // 0.1 s below the threshold
  static constexpr uint8_t kRestSteps = 250;     // 1.25 s: the body has swung back
  // Control steps above a limit of pressure that count, however far apart: one is forgotten after a
  // second. A sound muscle never is there.
  static constexpr uint8_t kPressureSteps = 3;
  static constexpr uint16_t kPressureMemory = 200;
  static constexpr uint8_t kAppliedAtOnce = 18;  // parameters looked at in a control period
  static constexpr uint8_t kDefaultsAtOnce = 8;  // and maps, for defaults
  static constexpr uint16_t kRearmMs = 200;
  // While the spool winds, telemetry comes so often at least, whatever its period: by it the host's
  // port process sees how far the body grows while the host hangs, and stops it.
  static constexpr uint16_t kWindingTelemetryMs = 20;
  static constexpr uint16_t kHoldSettleMs = 500;  // beyond twice the lag, before a hold is read
  static constexpr int32_t kHomingExcess = 5;     // homing gives up beyond the body's length by 1/5
  // After its first touch, homing backs off, bounded in time and duty as well, for the encoder may
  // be what fails; and touches again, at the same place.
  static constexpr int32_t kBackOffUm = 3000;
  static constexpr int32_t kBackOffUmS = 5000;
  static constexpr uint16_t kBackOffMs = 1500;
  static constexpr int16_t kBackOffDuty = kMotorFull / 8;  // beyond the dead zone
  // Jumps of the encoder in a move that are no fault, beside one in 32 counts.
  static constexpr uint16_t kJumps = 8;
  static constexpr int32_t kTouchUm = 1500;  // between the two touches
  static constexpr int32_t kHomeUm = 10000;  // between the base and a known length's 0
  // What test_output may do, whatever the parameters say.
  static constexpr int16_t kTestDriveMost = 400;  // 5 mA: 5.6 psi of a 2..60 psi transducer
  static constexpr int16_t kTestMotorMost = kMotorFull / 4;
  static constexpr uint16_t kTestMostMs = 500;
  // At arming the motor pulls at the closed brake with twice what a body can pull, and some.
  static constexpr int32_t kProofN = 20;
  static constexpr uint16_t kProofMs = 400;
  static constexpr int32_t kProofUm = 1000;  // the tip may go so far
  // A contact and what it feeds follow their enable within this.
  static constexpr uint16_t kPowerMs = 300;
  // The emergency stop's own contact cuts the motor's supply: the enable waits for so long, to see.
  static constexpr uint16_t kStopProofMs = 100;
  // Value of a fault's event that was latched before the last reset.
  static constexpr int32_t kBeforeReset = -1;

  bool enabled(uint8_t sensor) const { return (derived_.enabled_mask >> sensor & 1) != 0; }
  // Sensors that read curvature now, as bits.
  uint16_t usable_mask() const {
    return static_cast<uint16_t>(derived_.enabled_mask & eversion_.everted_mask() &
                                 zeros_.valid_mask());
  }
  uint32_t t_us() const { return tick_ * 1000u + frame_us_; }
  void post(protocol::EventCode code, uint16_t arg, int32_t value) {
    events_.post(code, arg, value, t_us());
  }
  void raise(Fault fault, int32_t value) { faults_.raise(fault, value, t_us(), &events_); }
  // Whether a command is allowed, by what holds at this moment.
  Outcome permit(Permit kind) {
    assemble_conditions();
    return {refusal(kind, state_, activity_, conditions_), 0};
  }

  void run_phase(uint8_t phase);
  void scale_supply();
  void advance_sweep();
  void begin_half();
  void pressure_step(uint8_t muscle);
  bool released() const;
  bool fitted(uint8_t muscle) const { return (derived_.fitted_mask >> muscle & 1) != 0; }
  bool acceptable(const int16_t* cpsi, uint8_t most) const;
  bool guarded(uint8_t muscle) const;
  static uint8_t above_zero(const int16_t* cpsi);
  int16_t highest(const int16_t* cpsi) const;
  void press_only(uint8_t muscle, int16_t cpsi);
  void end_test();
  bool testing(protocol::Output output) const {
    return activity_ == Activity::kTesting && test_.output == output;
  }
  // A transducer's current, its muscle's valve held or not.
  bool testing(uint8_t muscle) const {
    return activity_ == Activity::kTesting && test_.output != protocol::Output::kMotor &&
           test_.muscle == muscle;
  }
  bool testing_vent() const { return testing(protocol::Output::kVent); }
  void spool_step();
  void watch_motion(int16_t duty);
  void watch_fold();
  void watch_power();
  bool grows() const { return derived_.grows; }
  bool brake_fitted() const { return derived_.brake_steps != 0; }
  bool power_wanted() const;
  void prove_brake();
  void stall(protocol::StallCause cause);
  uint16_t follow_length();
  void body_step();
  void free_step();
  void zeroing_step();
  void trigger_step();
  void look_at_base(uint8_t column);
  void take_peak();
  void take_contact(uint8_t muscle, int32_t difference_e5);
  void hold_contact(uint8_t muscle);
  bool bends_back(uint8_t muscle) const;
  Reading reading() const;
  uint16_t causes() const;
  void watch_faults();
  void assemble_conditions();
  void supervise(uint8_t requests);
  void make_safe(Reason reason);
  void start(Activity activity, Permit permit);
  void finish_activity(protocol::EventCode code, int32_t value);
  void finish_spool(bool arrived);
  void finish_homing_stage(bool arrived);
  void lose_home();
  void begin_move();
  void start_spool(Activity activity, int32_t target_counts, int32_t speed_um_s);
  Outcome wind_to(Permit kind, int32_t length_um, uint32_t speed_um_s);
  // Scales whose change voids what was measured.
  struct Scales {
    uint32_t um_per_count;
    uint8_t oversample;
    uint8_t trigger;
  };
  Scales scales() const {
    return {derived_.um_per_count_q16, derived_.oversample_log2, derived_.trigger_log2};
  }
  void take_over(const Scales& before);
  // What is being changed: parameters that wait become the running ones, or all become defaults.
  enum class Change : uint8_t { kNone, kApply, kDefaults };
  void begin_change(Change change);
  void change_items(uint16_t items);
  bool change_item(uint16_t item);
  void take_parameter(uint16_t index);
  uint8_t active_muscle() const;
  bool bending() const {
    return activity_ == Activity::kSweeping || activity_ == Activity::kPressing ||
           activity_ == Activity::kHolding;
  }
  bool winding() const {
    return activity_ == Activity::kGrowing || activity_ == Activity::kRetracting ||
           activity_ == Activity::kHoming;
  }
  bool moves() const { return winding() && start_ == Start::kDone; }

  Configuration config_;
  StagedParameters staged_;
  Derived derived_;
  FlexReadings flex_;
  PressureReading pressure_[kMuscles];
  MovingSum base_sum_[kColumns];
  MuscleState muscle_[kMuscles];
  PressureLoop loop_[kMuscles];
  SpoolLoop spool_;
  SlipWatch slip_;
  MotionWatch motion_;
  FoldWatch fold_;
  Sweep sweep_;
  ContactTrigger trigger_;
  Snapshots snapshots_;
  Eversion eversion_;
  SensorZeros zeros_;
  DriftWatch drift_;
  Faults faults_;
  EventQueue events_;
  static Outputs safe_outputs() {
    Outputs safe;
    for (uint8_t i = 0; i < kMuscles; ++i) safe.drive[i] = PressureLoop::kOff;
    safe.motor = 0;
    return safe;
  }
  Outputs outputs_ = safe_outputs();

  const uint16_t frame_us_;
  uint32_t tick_ = 0;
  uint32_t elapsed_ = 0;  // ticks since the one before
  uint32_t beat_tick_ = 0;
  uint16_t telemetry_tick_ = 0;  // its low half
  uint32_t zeroing_tick_ = 0;
  protocol::TestOutput test_ = {};
  uint32_t test_tick_ = 0;
  uint32_t power_tick_ = 0;  // when the motor's supply was last switched
  uint32_t stop_tick_ = 0;   // when the emergency stop was pressed
  int32_t proof_count_ = 0;
  StopLatch stop_;
  int32_t encoder_ = 0;
  int32_t zero_count_ = 0;   // encoder at everted length 0
  int32_t touch_count_ = 0;  // encoder at homing's first touch
  uint32_t back_off_tick_ = 0;
  int32_t length_um_ = 0;
  uint16_t conditions_ = 0;
  uint16_t encoder_errors_ = 0;
  uint16_t errors_before_ = 0;  // when the move began
  int32_t target_counts_ = 0;   // of the move that starts
  int32_t target_speed_um_s_ = 0;
  int32_t moved_from_ = 0;      // where it began
  uint16_t supply_raw_mv_ = 0;  // against a reference of 1.1 V
  uint16_t supply_mv_ = 0;
  uint16_t rx_overruns_ = 0;
  uint16_t overruns_seen_ = 0;
  uint16_t judged_conditions_ = 0;
  uint16_t quiet_run_ = 0;            // ms below half the trigger's threshold
  int16_t column_e5_[kColumns] = {};  // by each base sensor, when last looked at
  int16_t base_e5_ = 0;
  int16_t free_e5_ = 0;
  State state_ = State::kBoot;
  Activity activity_ = Activity::kIdle;
  Permit permit_ = Permit::kArm;  // of the activity
  uint8_t zone_ = kZoneUnknown;
  uint8_t phase_ = 0;
  uint8_t judged_signals_ = 0;
  uint8_t vented_steps_ = 0;
  LeakyCount<uint16_t, kPressureMemory> over_[kMuscles];
  LeakyCount<uint16_t, kPressureMemory> unvented_;
  uint8_t sweep_options_ = 0;
  uint8_t zeroing_next_ = 0;
  Change change_ = Change::kNone;
  uint16_t next_item_ = 0;      // of what is being changed: parameters, then maps
  uint8_t zeroing_window_ = 0;  // drift windows closed when the zeroing began
  uint8_t peak_muscle_ = 0;
  enum class Homing : uint8_t { kSeek, kBackOff, kTouch } homing_ = Homing::kSeek;
  // Of a move, what the spool's next turn does first.
  enum class Start : uint8_t { kDone, kSensors, kSpool } start_ = Start::kDone;
  bool column_known_[kColumns] = {};
  bool greeted_ = false;
  bool beaten_ = false;
  bool length_known_ = false;
  bool config_valid_ = false;
  bool store_damaged_ = false;  // until a host has saved
  bool estop_ = false;
  bool slipping_ = false;
  bool motor_power_ = false;
  bool power_was_wanted_ = false;
  bool power_wrong_ = false;  // there where it must not be, or missing
  bool proving_ = false;      // the brake
  bool proving_stop_ = false;
  bool averaging_ = false;
  bool telemetry_due_ = false;
  bool body_air_ = false;
};

}  // namespace thigmo

#include "controller_commands.h"
#include "controller_tick.h"

#endif  // THIGMO_CORE_CONTROLLER_H_
