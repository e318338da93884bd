// Every pin of the robot, in one table. docs/hardware/wiring.md says what hangs on each.
//
// clang-format off
// | Arduino pin | AVR       | signal                     | direction | idle (reset, boot loader)      |
// | ----------- | --------- | -------------------------- | --------- | ------------------------------ |
// | A0..A4      | ADC0..4   | flex sensors left, 0 base  | analog    | divider 5 V - sensor - 22 kOhm |
// | A5..A9      | ADC5..9   | flex sensors right, 0 base | analog    | divider 5 V - sensor - 22 kOhm |
// | A10         | ADC10     | muscle pressure left       | analog    | pull-down 100 kOhm             |
// | A11         | ADC11     | muscle pressure right      | analog    | pull-down 100 kOhm             |
// | A12         | ADC12     | spare                      | analog    | pull-down 100 kOhm             |
// | 46          | PL3 OC5A  | transducer current left    | output    | pull-down 10 kOhm: 0 mA        |
// | 45          | PL4 OC5B  | transducer current right   | output    | pull-down 10 kOhm: 0 mA        |
// | 6           | PH3 OC4A  | motor PWM, 20 kHz          | output    | pull-down 10 kOhm: braked      |
// | 7           | PH4       | motor DIR, high pays out   | output    | pull-down 10 kOhm              |
// | 2           | PE4 INT4  | encoder A                  | input     | pull-up (internal)             |
// | 3           | PE5 INT5  | encoder B                  | input     | pull-up (internal)             |
// | 22          | PA0       | emergency stop             | input     | pull-up; closed to GND = run   |
// | 24          | PA2       | air enable of the muscles  | output    | floats, and still: valves fall |
// | 26          | PA4       | air enable of the body     | output    | the same; toggled = air on     |
// | 27          | PA5       | motor's supply is there    | input     | divider's 4.7 kOhm to GND: no  |
// | 28          | PA6       | enable of motor's supply   | output    | floats: K2 falls               |
// | 29          | PA7       | enable of the brake's coil | output    | floats: the brake closes       |
// | 0, 1        | RXD0 TXD0 | USB bridge                 | serial    |                                |
// clang-format on
//
// Not used on purpose: 13 blinks in the boot loader; 20 and 21 are I2C; 44 (OC5C) stays free beside
// the transducers.
#ifndef THIGMO_MEGA_PINS_H_
#define THIGMO_MEGA_PINS_H_

#include <avr/io.h>

namespace thigmo {
namespace mega {

constexpr uint8_t kDriveLeft = _BV(PL3);
constexpr uint8_t kDriveRight = _BV(PL4);
constexpr uint8_t kMotorPwm = _BV(PH3);
constexpr uint8_t kMotorDirection = _BV(PH4);
constexpr uint8_t kEncoderA = _BV(PE4);
constexpr uint8_t kEncoderB = _BV(PE5);
constexpr uint8_t kEncoderShift = PE4;
constexpr uint8_t kEstop = _BV(PA0);
constexpr uint8_t kMuscleAir = _BV(PA2);
constexpr uint8_t kBodyAir = _BV(PA4);
constexpr uint8_t kMotorPower = _BV(PA5);
constexpr uint8_t kMotorEnable = _BV(PA6);
constexpr uint8_t kBrakeEnable = _BV(PA7);
constexpr uint8_t kEnables = kMuscleAir | kBodyAir | kMotorEnable | kBrakeEnable;

// Inputs have pull-ups, outputs are driven low; unused pins keep their reset state.
inline void pins_begin() {
  PORTL &= static_cast<uint8_t>(~(kDriveLeft | kDriveRight));
  DDRL |= kDriveLeft | kDriveRight;
  PORTH &= static_cast<uint8_t>(~(kMotorPwm | kMotorDirection));
  DDRH |= kMotorPwm | kMotorDirection;
  DDRE &= static_cast<uint8_t>(~(kEncoderA | kEncoderB));
  PORTE |= kEncoderA | kEncoderB;
  PORTA = static_cast<uint8_t>((PORTA | kEstop) & ~(kEnables | kMotorPower));
  DDRA = static_cast<uint8_t>((DDRA & ~(kEstop | kMotorPower)) | kEnables);
  DIDR0 = 0xFF;  // A0..A12 are analog: no digital input buffers
  DIDR2 = 0x1F;
}

}  // namespace mega
}  // namespace thigmo

#endif  // THIGMO_MEGA_PINS_H_
