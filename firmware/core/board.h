// The Board policy: all that the robot controller asks of the hardware.
//
// `Robot<Board>` (robot.h) is a template over a class with the members of `BoardPolicy` below; the
// bindings are firmware/mega (pins and registers) and firmware/virtual (inside Python). A binding
// moves bytes, counts and duties and decides nothing: every limit, unit, filter, state and safe
// reaction is the core's, so that all boards compute identical integers from identical inputs.
//
// Who calls what. The binding constructs one Robot<Board>, calls `robot.begin()` once, then
// `robot.loop()` for ever, as often as it can. All members below are called from there only, never
// from an interrupt routine, so the binding makes the reads of what its own interrupts write atomic
// inside these members; the core holds no critical section and disables no interrupt.
//
// Time. There is one clock: the 1 kHz control tick. Tick n begins at n * 1000 us (tick 0 at start);
// `micros()` counts on the same clock, so that sampling instants, control steps and time stamps are
// exact multiples of each other. The core does the work of tick n when the ADC frame of tick n
// arrives (`frame_us()` into it); it kicks the watchdog only after such a pass, so that a dead ADC,
// a dead tick timer and a hung loop all end in a reset. A pass must follow each frame within
// kAdcFrames ticks.
//
// Any member that starts something (eeprom_write, tx_write) returns at once.
#ifndef THIGMO_CORE_BOARD_H_
#define THIGMO_CORE_BOARD_H_

#include <stdint.h>

#include "capacity.h"
#include "flash.h"
#include "latches.h"
#include "link/protocol.h"

namespace thigmo {

// Flex inputs come in two columns; the first of each is a base sensor's, for the contact trigger.
constexpr uint8_t kColumns = 2;
constexpr uint8_t kColumn = kSensors / kColumns;  // inputs in each
constexpr uint8_t base_input(uint8_t column) { return static_cast<uint8_t>(column * kColumn); }
static_assert(kSensors == kColumns * kColumn && kColumn > 1 && kSensors <= 16,
              "masks have 16 bits");

// Scales of the core's outputs. A binding maps them to whatever its timers count.
constexpr int16_t kDriveFull = 1599;  // transducer duty of 20 mA
constexpr int16_t kMotorFull = 800;   // motor duty of full voltage

// ADC channels: flex inputs, then the muscles' pressures (on the Mega A0..A9, A10 and A11).
constexpr uint8_t kPressureChannel = kSensors;
// Conversions in each tick: pressures, base sensors, and one column's others.
constexpr uint8_t kAdcSlots = kMuscles + kColumns + kColumn - 1;
constexpr uint8_t kAdcFrames = 4;  // frames that a binding must be able to hold for the core
constexpr uint8_t kAdcBits = 10;   // of the counts that sums, limits and the wire are made of
constexpr uint16_t kAdcTop = (1u << kAdcBits) - 1;

// Channel converted in a slot of a tick: all pressures, both base sensors, then the others of the
// first column on even ticks and of the second on odd ticks. Usable in an interrupt.
constexpr uint8_t adc_channel(bool odd_tick, uint8_t slot) {
  return slot < kMuscles ? static_cast<uint8_t>(kPressureChannel + slot)
         : slot < kMuscles + kColumns
             ? base_input(static_cast<uint8_t>(slot - kMuscles))
             : static_cast<uint8_t>(slot - kMuscles - kColumns + 1 + base_input(odd_tick ? 1 : 0));
}

// The conversions of one tick, count[slot] of adc_channel(tick & 1, slot), of kAdcBits each.
struct AdcFrame {
  uint16_t count[kAdcSlots];
  uint32_t tick;
#if THIGMO_IMUS
  uint16_t restarted = 0;  // inputs whose zero means nothing since the frame before
#endif
};

// Parts of a main-loop pass, as marked for a stop-watch by BoardPolicy::task(); 0 = none.
enum class Task : uint8_t {
  kReceive = 1,    // bytes, frames, commands
  kSense = 2,      // conversions into readings
  kControl = 3,    // the loop whose turn it is
  kDecide = 4,     // trigger, peak, zeroing, supervisor; outputs written
  kTelemetry = 5,  // filling a telemetry message
  kStore = 6,      // configuration store
  kTransmit = 7,   // frames to the line
};

// Ring sizes that the binding should have; powers of two of at most 256 let an 8-bit chip use
// one-byte indices, which are atomic. The core never has more than about 180 bytes in the tx ring,
// because a long queue would delay events.
constexpr uint16_t kRxRing = 256;
constexpr uint16_t kTxRing = 256;

// The longest silence of the main loop after which a board may still run on; the spool's top speed
// allows for it (config/configuration.h).
constexpr uint16_t kWatchdogMs = 285;

// What the board holds on for as long as its program runs.
struct Enables {
  bool muscles;  // air
  bool body;
  bool motor;  // the contact in the motor's supply
  bool brake;  // the brake's coil: released
};

// Bytes of EEPROM that the core uses, from address 0: boot counter and two configuration slots.
// (config/store.h lays them out; a binding may use what lies beyond.)
constexpr uint16_t kEepromUsed = kMuscles * kBodyPressures > 6 ? 8192 : 2048;

// The policy itself. This class is documentation and is never defined: a binding is any class with
// these members (static or not).
class BoardPolicy {
 public:
  // Reported in the hello. A board that the schema does not list takes a number from 128 up.
  static constexpr protocol::BoardKind kKind = protocol::BoardKind::kMega;

  // --- clock -------------------------------------------------------------------------------------
  uint32_t micros();  // tick * 1000 + microseconds into the tick; wraps
  // A stop-watch for passes of the main loop, microseconds from anywhere, within 4; wraps. Its own,
  // for an 8-bit chip reads a timer in a fifth of the time that micros() takes.
  uint16_t micros16();

  // --- analog ------------------------------------------------------------------------------------
  // When a frame is complete, microseconds into its tick; below 1000, the same for the whole run.
  uint16_t frame_us();
  // The oldest completed frame not yet taken, or null; it holds until the next call. Frames come in
  // order of tick; when the core is late by more than kAdcFrames, the binding drops the newest and
  // the core sees the gap in `tick`. Frame 0 is that of tick 0. A count is floor(1024 * voltage /
  // reference); a converter with more bits passes its frames through Narrowing
  // (sensing/narrowing.h). Frame time and bits are the converter's profile: boards that share it
  // give the same telemetry from the same counts.
  const AdcFrame* take_frame();

  // --- outputs -----------------------------------------------------------------------------------
  // All outputs are off from reset until the core's first call.
  void drive(uint8_t muscle, int16_t duty);  // transducer current, 0..kDriveFull = 0..20 mA
  void drive_off(uint8_t muscle);            // true zero: compare output disconnected, pin low
  // Motor duty -kMotorFull..kMotorFull, positive pays out. The core passes through brake() or 0 for
  // at least one control period (5 ms) before the sign changes; set DIR then.
  void motor(int16_t duty);
  void brake();  // PWM 0, driver braking
  // Once a tick: which enables are wanted. A binding toggles a wanted enable's pin and leaves the
  // others alone, so that a program that stops, stops air and motor (docs/hardware/electronics.md).
  void enable(Enables wanted);

  // --- inputs ------------------------------------------------------------------------------------
  int32_t encoder_count();    // x4 counts since start, positive = paying out; wraps
  uint16_t encoder_errors();  // illegal transitions since start: edges lost, or noise; wraps
  uint16_t supply_mv();  // latest measurement, against a reference of 1.1 V; 10 Hz or so suffice
  bool estop();          // true = pressed (or its wire broken); not debounced
  bool motor_power();    // true = the motor's driver has its supply, behind all contacts

  // --- UART --------------------------------------------------------------------------------------
  // How many received bytes lie at `first`, the oldest of them; more may wait elsewhere. They stay
  // there until they are dropped.
  uint8_t rx_waiting(const uint8_t** first);
  void rx_drop(uint8_t count);
  uint16_t rx_overruns();  // received bytes lost (ring full, or hardware overrun) since start
  uint16_t tx_free();      // bytes that tx_write accepts now
  uint16_t tx_pending();   // bytes not yet handed to the wire
  void tx_write(const uint8_t* bytes, uint8_t count);  // count <= tx_free()

  // --- EEPROM ------------------------------------------------------------------------------------
  // kEepromUsed bytes that keep their values without power; blank ones read 0xFF. The core writes
  // only while the outputs are off. A power cut in eeprom_write may leave anything in that byte and
  // changes no other. A memory that writes in larger pieces may hold writes back until
  // eeprom_commit(): a cut then leaves either what was before or all of them.
  bool eeprom_ready();                                 // no write in progress
  uint8_t eeprom_read(uint16_t address);               // called only while ready
  void eeprom_write(uint16_t address, uint8_t value);  // called only while ready; returns at once
  void eeprom_commit();  // called only while ready: once ready again, all writes are permanent

  // --- start and stop ----------------------------------------------------------------------------
  protocol::ResetCause reset_cause();  // of this start
  // What was last kept, if power has been on since; else none. LatchRecord (latches.h) does this
  // for RAM that no start-up code touches. Kept when a fault is latched,
  // and after each command.
  Latches kept_latches();
  void keep_latches(const Latches& latches);
  void task(uint8_t id);  // a part of the pass begins (Task); may do nothing
  void kick_watchdog();   // every tick; time-out 120..kWatchdogMs
};

}  // namespace thigmo

#endif  // THIGMO_CORE_BOARD_H_
