// Transducers (timer 5, 10 kHz, 1600 steps), motor (timer 4, 20 kHz, 800 steps), enables.
//
// Fast PWM holds its pin high for OCR + 1 cycles, so even OCR = 0 gives a spike each period. A true
// zero therefore disconnects the compare output and leaves the port bit, always low, on the pin.
#ifndef THIGMO_MEGA_ACTUATORS_H_
#define THIGMO_MEGA_ACTUATORS_H_

#include <avr/io.h>

#include "../core/board.h"
#include "pins.h"

namespace thigmo {
namespace mega {

class Actuators {
 public:
  static void begin() {
    OCR5A = OCR5B = 0;
    ICR5 = kDriveFull;
    TCCR5A = _BV(WGM51);  // fast PWM, top ICR5, outputs disconnected
    TCCR5B = _BV(WGM53) | _BV(WGM52) | _BV(CS50);
    OCR4A = 0;
    ICR4 = kMotorFull - 1;
    TCCR4A = _BV(WGM41);
    TCCR4B = _BV(WGM43) | _BV(WGM42) | _BV(CS40);
  }

  static void drive(uint8_t side, int16_t duty) {
    if (duty <= 0) {
      drive_off(side);
    } else if (side == 0) {
      OCR5A = static_cast<uint16_t>(duty - 1);
      TCCR5A |= _BV(COM5A1);
    } else {
      OCR5B = static_cast<uint16_t>(duty - 1);
      TCCR5A |= _BV(COM5B1);
    }
  }

  static void drive_off(uint8_t side) {
    if (side == 0) {
      TCCR5A &= static_cast<uint8_t>(~_BV(COM5A1));
      OCR5A = 0;  // the next drive's first period must not show the old duty
    } else {
      TCCR5A &= static_cast<uint8_t>(~_BV(COM5B1));
      OCR5B = 0;
    }
  }

  // A driver of the MD10C family brakes while its PWM input is low. DIR only moves then.
  static void motor(int16_t duty) {
    if (duty == 0) {
      brake();
      return;
    }
    const uint8_t direction = duty > 0 ? kMotorDirection : 0;
    if ((PORTH & kMotorDirection) != direction) {
      brake();
      // One instruction on the port: no interrupt routine touches port H.
      PORTH = static_cast<uint8_t>((PORTH & ~kMotorDirection) | direction);
    }
    OCR4A = static_cast<uint16_t>((duty > 0 ? duty : -duty) - 1);
    TCCR4A |= _BV(COM4A1);
  }

  // Writing a one to PIN toggles the port bit (data sheet 13.2.2). Program, not timer: what a timer
  // toggles goes on when the program hangs.
  static void enable(Enables wanted) {
    PINA =
        static_cast<uint8_t>((wanted.muscles ? kMuscleAir : 0) | (wanted.body ? kBodyAir : 0) |
                             (wanted.motor ? kMotorEnable : 0) | (wanted.brake ? kBrakeEnable : 0));
  }

  static void brake() {
    TCCR4A &= static_cast<uint8_t>(~_BV(COM4A1));
    OCR4A = 0;
  }
};

}  // namespace mega
}  // namespace thigmo

#endif  // THIGMO_MEGA_ACTUATORS_H_
