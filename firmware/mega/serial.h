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
    UCSR0B = kOn;
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

  // The interrupt routine of a received byte.
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

  // The transmit interrupt below is written in assembly and shares these.
  static constexpr uint8_t kOn = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
  static uint8_t tx_[kTxRing];
  static volatile uint8_t tx_in_, tx_out_;

 private:
  static constexpr uint8_t kNearlyEmpty = 7;

  static uint8_t rx_[kRxRing];
  static volatile uint8_t rx_in_, rx_out_;
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

// The next byte of the ring, or no more interrupts: 48 cycles where a compiler's takes 67, and it
// runs 25 times a millisecond when the line is full.
ISR(USART0_UDRE_vect, ISR_NAKED) {
  __asm__ volatile(
      "push r24            \n\t"
      "in   r24, %[sreg]   \n\t"
      "push r24            \n\t"
      "push r30            \n\t"
      "push r31            \n\t"
      "lds  r30, %[out]    \n\t"
      "lds  r24, %[in]     \n\t"
      "cp   r24, r30       \n\t"
      "breq 1f             \n\t"
      "mov  r24, r30       \n\t"
      "inc  r24            \n\t"
      "sts  %[out], r24    \n\t"
      "ldi  r31, 0         \n\t"
      "subi r30, lo8(-(%[ring])) \n\t"
      "sbci r31, hi8(-(%[ring])) \n\t"
      "ld   r24, Z         \n\t"
      "sts  %[data], r24   \n\t"
      "0: pop r31          \n\t"
      "pop  r30            \n\t"
      "pop  r24            \n\t"
      "out  %[sreg], r24   \n\t"
      "pop  r24            \n\t"
      "reti                \n\t"
      "1: ldi r24, %[on]   \n\t"
      "sts  %[control], r24 \n\t"
      "rjmp 0b             \n\t"
      :
      : [sreg] "I"(_SFR_IO_ADDR(SREG)), [out] "i"(&thigmo::mega::Serial0::tx_out_),
        [in] "i"(&thigmo::mega::Serial0::tx_in_), [ring] "i"(&thigmo::mega::Serial0::tx_),
        [data] "i"(_SFR_MEM_ADDR(UDR0)), [control] "i"(_SFR_MEM_ADDR(UCSR0B)),
        [on] "n"(thigmo::mega::Serial0::kOn));
}

#endif  // THIGMO_MEGA_SERIAL_H_
