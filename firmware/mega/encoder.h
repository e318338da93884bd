// Quadrature encoder of the spool on INT4 and INT5, every edge counted.
#ifndef THIGMO_MEGA_ENCODER_H_
#define THIGMO_MEGA_ENCODER_H_

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#include "pins.h"
#include "program_memory.h"

namespace thigmo {
namespace mega {

class Encoder {
 public:
  static void begin() {
    state_ = read_pins();
    EICRB = _BV(ISC40) | _BV(ISC50);  // any edge
    EIFR = _BV(INTF4) | _BV(INTF5);
    EIMSK = _BV(INT4) | _BV(INT5);
  }

  // Counts since start, positive = paying out (A leads B). The interrupt keeps 16 bits; this must
  // be called at least every 32767 counts (ten seconds at full speed), and is, every control step.
  static int32_t count() {
    int16_t now;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { now = count_; }
    total_ += static_cast<int16_t>(now - seen_);
    seen_ = now;
    return total_;
  }

  static inline void on_edge() {
    const uint8_t now = read_pins();
    const uint8_t turn = static_cast<uint8_t>(state_ << 2) | now;
    state_ = now;
    // A bounce back to the same state counts nothing; a jump over one is an edge lost, or noise.
    const int8_t step = kStep[turn];
    if (step == kIllegal) {
      illegal_ = static_cast<uint8_t>(illegal_ + 1);
    } else {
      count_ = static_cast<int16_t>(count_ + step);
    }
  }

  // Jumps since start; as often to be called as count() (a byte of them is kept).
  static uint16_t errors() {
    const uint8_t now = illegal_;
    errors_ = static_cast<uint16_t>(errors_ + static_cast<uint8_t>(now - illegal_seen_));
    illegal_seen_ = now;
    return errors_;
  }

 private:
  static inline uint8_t read_pins() { return (PINE >> kEncoderShift) & 3; }  // A bit 0, B bit 1

  static constexpr int8_t kIllegal = 2;
  static const int8_t kStep[16];
  static uint8_t state_;
  static volatile int16_t count_;
  static int16_t seen_;
  static int32_t total_;
  static volatile uint8_t illegal_;
  static uint8_t illegal_seen_;
  static uint16_t errors_;
};

// By old state * 4 + new state; forwards runs 00, 01 (A), 11, 10 (B), 00.
const int8_t Encoder::kStep[16] = {0, 1,        -1, kIllegal, -1,       0,  kIllegal, 1,
                                   1, kIllegal, 0,  -1,       kIllegal, -1, 1,        0};
uint8_t Encoder::state_;
volatile int16_t Encoder::count_;
int16_t Encoder::seen_;
int32_t Encoder::total_;
volatile uint8_t Encoder::illegal_;
uint8_t Encoder::illegal_seen_;
uint16_t Encoder::errors_;

}  // namespace mega
}  // namespace thigmo

ISR(INT4_vect, THIGMO_FAST) { thigmo::mega::Encoder::on_edge(); }
ISR(INT5_vect, THIGMO_FAST) { thigmo::mega::Encoder::on_edge(); }

#endif  // THIGMO_MEGA_ENCODER_H_
