// What the Python module asks of the controller, and what the controller asks of the port.
//
// The controller lives while Python is inside thigmo_board.run(): thigmo_begin() constructs it,
// thigmo_end() puts the outputs off and then destroys it. In between it runs where the garbage
// collector does not reach: on the Pico's second core, in an interrupt of the Cortex-M3, in a
// thread of the unix port.
#ifndef THIGMO_MICROPYTHON_CONTROLLER_H_
#define THIGMO_MICROPYTHON_CONTROLLER_H_

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

// The pins of robot/pins.py, in its order; -1 = none. A port without pins ignores them.
enum {
  THIGMO_DRIVE_LEFT,
  THIGMO_DRIVE_RIGHT,
  THIGMO_MOTOR_PWM,
  THIGMO_MOTOR_DIRECTION,
  THIGMO_MUSCLE_AIR,
  THIGMO_BODY_AIR,
  THIGMO_MOTOR_POWER,
  THIGMO_MOTOR_ENABLE,
  THIGMO_BRAKE_ENABLE,
  THIGMO_ENCODER_A,
  THIGMO_ENCODER_B,
  THIGMO_ESTOP,
  THIGMO_LINK_TX,
  THIGMO_LINK_RX,
  THIGMO_ADC_SCK,
  THIGMO_ADC_MOSI,
  THIGMO_ADC_MISO,
  THIGMO_ADC_SELECT_FLEX,
  THIGMO_ADC_SELECT_OTHER,
  THIGMO_SUPPLY,
  THIGMO_PINS
};

// Puts the outputs off, then starts the controller. A sentence if it cannot, else null.
const char* thigmo_begin(const int8_t* pins);
// Outputs off, then the controller ends. Safe at any time, also when none runs.
void thigmo_end(void);
// A moment of Python's wait in run(); false when the controller ended by itself.
bool thigmo_wait(void);

#ifdef __cplusplus
}
#endif

#endif  // THIGMO_MICROPYTHON_CONTROLLER_H_
