// What the Python module asks of the controller, and what the controller asks of the port.
//
// thigmo_begin() constructs the controller and starts it; thigmo_end() puts the outputs off and
// then destroys it. In between it runs where neither Python nor its garbage collector reaches: on
// the Pico's second core, in an interrupt of the Cortex-M3, in a thread of the unix port.
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
// The controller puts the outputs off at its next pass, and does nothing more. For interrupt
// routines and signal handlers; `why` is kept for thigmo_halted().
void thigmo_halt(const char* why);
// Why the controller was halted, or null.
const char* thigmo_halted(void);
bool thigmo_runs(void);
uint32_t thigmo_schema_hash(void);

// What a program asks; the answer is in the same bytes.
typedef enum {
  THIGMO_TAKE,       // the robot, from a host that is silent
  THIGMO_BEAT,       // its heart
  THIGMO_COMMAND,    // bytes: a payload of the message `id`; answer: the payload of the reply
  THIGMO_STOP,       // bytes: a nonce
  THIGMO_CURVATURE,  // answer: i16 for each input, in 1e-5/cm; -32768 reads none
  THIGMO_EVENT,      // answer: the oldest that it has not had; no bytes if there is none
} thigmo_what_t;
typedef enum {
  THIGMO_DONE,
  THIGMO_HOSTED,  // a host on the line has the robot
  THIGMO_NOT_SO,  // no such command, or not with so many bytes
} thigmo_outcome_t;
typedef struct {
  uint8_t kind, outcome, id, size;
  uint8_t bytes[96];
} thigmo_request_t;
// Has the controller answer, between two passes of its main loop. False if none runs.
bool thigmo_ask(thigmo_request_t* request);

// Of the module, for a port: something waits for thigmo_serve() or for the program's callback.
// Python is told when it next can be. Callable in an interrupt and in the controller's thread.
void thigmo_call_soon(void);
// Of the port, on Python's thread: what must be done there, such as writing flash.
void thigmo_serve(void);
// Of the port: the next key of the prompt; what Python has been told meanwhile is done.
int thigmo_key(void);

#ifdef __cplusplus
}
#endif

#endif  // THIGMO_MICROPYTHON_CONTROLLER_H_
