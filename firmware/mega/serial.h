// USART0, the USB bridge's line: two rings of 256 bytes, moved by interrupts.
#ifndef THIGMO_MEGA_SERIAL_H_
#define THIGMO_MEGA_SERIAL_H_

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#include "../core/board.h"
#include "program_memory.h"
#include "wake.h"

// 250 000 and 500 000 baud divide the clock exactly; 115 200 would be 2.1 % off.
#ifndef THIGMO_BAUD
#define THIGMO_BAUD 250000UL
#endif

namespace thigmo {
namespace mega {

class Serial0 {
 public:
  static void begin() {
    static_assert(F_CPU % (16 * THIGMO_BAUD) == 0, "the baud rate must divide the clock exactly");
    static_assert(kRxRing == 256 && kTxRing == 256, "one-byte indices wrap by themselves");
    UBRR0 = F_CPU / (16 * THIGMO_BAUD) - 1;
    UCSR0A = 0;
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);  // 8N1
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
  }

  static bool read(uint8_t* byte) {
    const uint8_t out = rx_out_;
    if (rx_in_ == out) return false;
    *byte = rx_[out];
    rx_out_ = out + 1;
    // A pass ends with a frame; there may be another.
    if (*byte == 0) wake::ask();
    return true;
  }

  static uint16_t overruns() {
    uint16_t count;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { count = overruns_; }
    return count;
  }

  static uint16_t pending() { return static_cast<uint8_t>(tx_in_ - tx_out_); }
  static uint16_t room() { return kTxRing - 1 - pending(); }

  static void write(const uint8_t* bytes, uint8_t count) {
    uint8_t in = tx_in_;
    while (count-- != 0) tx_[in++] = *bytes++;
    tx_in_ = in;
    draining_ = true;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { UCSR0B |= _BV(UDRIE0); }
  }

  // Once after each write: what is left lasts 280 us at 250 kbaud, time to hand over the next
  // frame.
  static bool nearly_empty() {
    if (!draining_ || pending() > kNearlyEmpty) return false;
    draining_ = false;
    return true;
  }

  // --- interrupt routines
  // --------------------------------------------------------------------------
  static inline void on_received() {
    const uint8_t status = UCSR0A;  // before UDR0, which moves the flags on
    const uint8_t byte = UDR0;
    if ((status & _BV(DOR0)) != 0) ++overruns_;
    const uint8_t in = rx_in_, next = in + 1;
    if (next == rx_out_) {
      ++overruns_;
      return;
    }
    rx_[in] = byte;
    rx_in_ = next;
    // A frame is whole. Noise without delimiters waits for the next tick, 25 bytes at most.
    if (byte == 0) wake::ask();
  }

  static inline void on_empty() {
    const uint8_t out = tx_out_;
    if (out == tx_in_) {
      UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
      return;
    }
    UDR0 = tx_[out];
    tx_out_ = out + 1;
  }

 private:
  static constexpr uint8_t kNearlyEmpty = 7;

  static uint8_t rx_[kRxRing];
  static uint8_t tx_[kTxRing];
  static volatile uint8_t rx_in_, rx_out_, tx_in_, tx_out_;
  static bool draining_;
  static uint16_t overruns_;
};

uint8_t Serial0::rx_[kRxRing];
uint8_t Serial0::tx_[kTxRing];
volatile uint8_t Serial0::rx_in_, Serial0::rx_out_, Serial0::tx_in_, Serial0::tx_out_;
bool Serial0::draining_;
uint16_t Serial0::overruns_;

}  // namespace mega
}  // namespace thigmo

ISR(USART0_RX_vect, THIGMO_FAST) { thigmo::mega::Serial0::on_received(); }
ISR(USART0_UDRE_vect, THIGMO_FAST) { thigmo::mega::Serial0::on_empty(); }

#endif  // THIGMO_MEGA_SERIAL_H_
