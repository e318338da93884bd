// What the skeleton asks of a chip. Replace each body by the registers of yours.
//
// These are the registers of a chip that does not exist: words in memory, which the emulator reads
// and writes on QEMU's MPS2 (mps2/injected_skeleton.h). Keep what the comments promise.
#ifndef THIGMO_SKELETON_CHIP_H_
#define THIGMO_SKELETON_CHIP_H_

#include <stdint.h>

namespace thigmo {
namespace chip {

enum Pwm : uint8_t { kDriveLeft, kDriveRight, kMotor, kPwms };
enum Output : uint8_t { kMuscleAir, kBodyAir, kMotorEnable, kBrakeEnable, kDirection, kOutputs };
enum Input : uint8_t { kEncoderA, kEncoderB, kEstop, kMotorPower, kInputs };

struct Registers {
  uint32_t micros;
  int16_t duty[kPwms];  // -1 = the timer is disconnected, and the pin is low
  bool output[kOutputs];
  bool input[kInputs];
  uint8_t channel;   // that is converted
  uint16_t adc[16];  // what conversions give, by channel
  uint16_t supply_mv;
  uint8_t received;
  bool idle;  // the line takes a byte
  uint8_t sent;
  uint32_t kicked_us;
};
inline Registers& registers() {
  static Registers all;
  return all;
}

// --- clock ---------------------------------------------------------------------------------------
// Free-running, 1 MHz, 32 bits. The tick's timer and the converter's are slaves of the same clock.
inline uint32_t micros() { return registers().micros; }

// --- outputs -------------------------------------------------------------------------------------
// Clocks on, pins as outputs, all low. The first thing that runs after a reset.
inline void set_up() {
  Registers& r = registers();
  r = Registers();
  for (int16_t& duty : r.duty) duty = -1;
}
// A duty that takes effect at the timer's next period, without a spike. Full is kDriveFull for the
// transducers at 10 kHz, kMotorFull for the motor at 20 kHz; scale if your timer counts otherwise.
inline void pwm(Pwm pin, int16_t duty) { registers().duty[pin] = duty; }
// Disconnected from its timer and low: a duty of 0 may leave a spike in each period.
inline void low(Pwm pin) { registers().duty[pin] = -1; }
// By software only, never by a timer or DMA, which go on after the program has died.
inline void write(Output pin, bool high) { registers().output[pin] = high; }
inline bool level(Output pin) { return registers().output[pin]; }

// --- inputs --------------------------------------------------------------------------------------
inline bool read(Input pin) { return registers().input[pin]; }
// Half of the 5 V rail by the chip's own converter, against its own reference; 10 Hz suffice.
inline uint16_t supply_mv() { return registers().supply_mv; }

// --- converter -----------------------------------------------------------------------------------
// Bits of one conversion, and when the last of a tick is complete.
constexpr uint8_t kAdcBits = 10;
constexpr uint16_t kFrameUs = 832;
// Begins a conversion; its end interrupts.
inline void convert(uint8_t channel) { registers().channel = channel; }
inline uint16_t conversion() { return registers().adc[registers().channel]; }

// --- line ----------------------------------------------------------------------------------------
// 250 kbaud, 8N1, both directions by interrupt.
inline uint8_t received() { return registers().received; }
inline void send(uint8_t byte) {
  registers().sent = byte;
  registers().idle = false;
}
inline bool idle() { return registers().idle; }

// --- watchdog ------------------------------------------------------------------------------------
// Resets the chip 120 to 250 ms after the last kick.
inline void kick() { registers().kicked_us = micros(); }

}  // namespace chip
}  // namespace thigmo

#endif  // THIGMO_SKELETON_CHIP_H_
