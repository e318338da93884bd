// The Arduino Mega 2560 as a Board policy (firmware/core/board.h): registers and rings, no
// decisions.
#ifndef THIGMO_MEGA_MEGA_BOARD_H_
#define THIGMO_MEGA_MEGA_BOARD_H_

#include <avr/cpufunc.h>
#include <avr/interrupt.h>
#include <avr/sleep.h>
#include <util/atomic.h>

#include "program_memory.h"
// The core comes after the access to its tables is defined.
#include "../core/board.h"
#include "actuators.h"
#include "eeprom.h"
#include "encoder.h"
#include "guard.h"
#include "pins.h"
#include "restart.h"
#include "sampler.h"
#include "serial.h"
#include "wake.h"

namespace thigmo {
namespace mega {

class MegaBoard {
 public:
  static constexpr protocol::BoardKind kKind = protocol::BoardKind::kMega;

  // Outputs first: whatever follows, nothing moves.
  static void begin() {
    pins_begin();
    Actuators::begin();
    Restart::begin();
    Encoder::begin();
    Serial0::begin();
    TCCR3A = 0;
    TCCR3B = _BV(CS31) | _BV(CS30);
    set_sleep_mode(SLEEP_MODE_IDLE);
    sleep_enable();
  }

  // Once the robot is ready for its first tick.
  static void start() {
    Restart::guard();
    Sampler::begin();
    sei();
    while (!Sampler::started()) {
    }
  }

  // Sleep until a frame of readings or of the host is there, or the line wants more.
  static void idle() {
    for (;;) {
      cli();
      if (wake::asked()) break;
      sei();
      sleep_cpu();  // the instruction after sei is executed before any interrupt
      _NOP();       // simavr serves what is pending one instruction later than the chip
    }
    wake::clear();
    sei();
  }

  static uint32_t micros() { return Sampler::micros(); }
  // Timer 3, which counts 4 us.
  static uint16_t micros16() {
    uint16_t count;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { count = TCNT3; }
    return static_cast<uint16_t>(count << 2);
  }
  static constexpr uint16_t frame_us() { return 832; }  // eight conversions of 104 us
  static const AdcFrame* take_frame() { return Sampler::take(); }

  static void drive(uint8_t side, int16_t duty) { Actuators::drive(side, duty); }
  static void drive_off(uint8_t side) { Actuators::drive_off(side); }
  static void motor(int16_t duty) { Actuators::motor(duty); }
  static void brake() { Actuators::brake(); }
  static void enable(Enables wanted) { Actuators::enable(wanted); }

  static int32_t encoder_count() { return Encoder::count(); }
  static uint16_t encoder_errors() { return Encoder::errors(); }
  static bool estop() { return (PINA & kEstop) != 0; }
  static bool motor_power() { return (PINA & kMotorPower) != 0; }
  // From the bandgap against AVcc: 1.1 V, +-10 % from chip to chip (data sheet 31.7); the core
  // scales it by what this chip's was found to be.
  static uint16_t supply_mv() {
    const uint16_t sum = Sampler::bandgap_sum();
    if (sum != supply_sum_) {
      supply_sum_ = sum;
      supply_mv_ = static_cast<uint16_t>(kBandgapMv * 1024 * Sampler::kBandgapCount / sum);
    }
    return supply_mv_;
  }

  static uint8_t rx_waiting(const uint8_t** first) { return Serial0::waiting(first); }
  static void rx_drop(uint8_t count) { Serial0::drop(count); }
  static uint16_t rx_overruns() { return Serial0::overruns(); }
  static uint16_t tx_free() { return Serial0::room(); }
  static uint16_t tx_pending() { return Serial0::pending(); }
  static void tx_write(const uint8_t* bytes, uint8_t count) { Serial0::write(bytes, count); }

  static bool eeprom_ready() { return Eeprom::ready(); }
  static uint8_t eeprom_read(uint16_t address) { return Eeprom::read(address); }
  static void eeprom_write(uint16_t address, uint8_t value) { Eeprom::write(address, value); }
  static void eeprom_commit() {}  // a byte written is permanent

  static protocol::ResetCause reset_cause() { return Restart::cause(); }
  static Latches kept_latches() { return Restart::kept_latches(); }
  static void keep_latches(const Latches& latches) { Restart::keep_latches(latches); }
  static void kick_watchdog() {
    Restart::note_supply(Sampler::bandgap() > kBandgapMv * 1024 / kLowMv);
    Restart::kick();
  }

  // A mark for the simulator's stop-watch (tools/budgets.py); one cycle.
  static void task(uint8_t id) { GPIOR1 = id; }

 private:
  static constexpr uint32_t kBandgapMv = 1100;
  static constexpr uint32_t kLowMv = 4300;  // a reset below this is called a brown-out

  static uint16_t supply_sum_, supply_mv_;
};

uint16_t MegaBoard::supply_sum_;
uint16_t MegaBoard::supply_mv_ = 5000;  // until the first average, 17 ms after start

}  // namespace mega
}  // namespace thigmo

#endif  // THIGMO_MEGA_MEGA_BOARD_H_
