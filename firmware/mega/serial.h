// USART0, the USB bridge's line: two rings of 256 bytes, moved by interrupts.
//
// A full line has 25 interrupts a millisecond each way, so both routines are in assembly and touch
// no flags: SREG need not be saved. Each ring begins at a multiple of 256, so that an index is the
// low byte of an address and wraps by itself.
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
    GPIOR2 = tx_in_;
  }

  // Those up to the ring's end, if the others lie at its begin.
  static uint8_t waiting(const uint8_t** first) {
    const uint8_t in = rx_in_;
    fence();  // the bytes are read after the index that says they are there
    const uint8_t out = rx_out_;
    *first = rings_.rx + out;
    return static_cast<uint8_t>((in < out ? 0 : in) - out);
  }

  static void drop(uint8_t count) {
    const uint8_t out = static_cast<uint8_t>(rx_out_ + count);
    const bool frame_ended = rings_.rx[static_cast<uint8_t>(out - 1)] == 0;
    fence();  // and before their places are given back
    rx_out_ = out;
    // A pass ends with a frame; there may be another.
    if (frame_ended && rx_in_ != out) wake::ask();
  }

  static uint16_t overruns() {
    uint16_t count;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { count = overruns_; }
    return count;
  }

  static uint16_t pending() { return static_cast<uint8_t>(tx_in_ - GPIOR2); }
  static uint16_t room() { return kTxRing - 1 - pending(); }

  static void write(const uint8_t* bytes, uint8_t count) {
    if (count == 0) return;
    const uint8_t in = tx_in_;
    const uint8_t before_end = static_cast<uint8_t>(-in);  // 0 = all of the ring
    const bool wraps = before_end != 0 && count > before_end;
    const uint8_t first = wraps ? before_end : count;
    copy(rings_.tx + in, bytes, first);
    copy(rings_.tx, bytes + first, static_cast<uint8_t>(count - first));
    const uint8_t after = static_cast<uint8_t>(in + count);
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
      tx_in_ = after;
      if (pending() > kNearlyEmpty) {
        tx_stop_ = static_cast<uint8_t>(after - kNearlyEmpty);
      } else {
        tx_stop_ = after;
        wake::ask();
      }
      UCSR0B = kOn | _BV(UDRIE0);
    }
  }

  // The interrupt routines below share these. GPIOR2 is the place of the next byte to send: an
  // index that `in` and `out` reach takes half the time of one in RAM.
  static constexpr uint8_t kOn = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
  struct Rings {
    uint8_t tx[kTxRing];
    uint8_t rx[kRxRing];
  };
  static Rings rings_;
  static volatile uint8_t rx_in_, rx_out_, tx_in_;
  static volatile uint8_t tx_stop_;  // where the transmitter wakes the main loop, then stops
  static volatile uint16_t overruns_;

 private:
  // Four bytes a turn: 4.75 cycles a byte, where the compiler's loops take 7 or 8.
  static void copy(uint8_t* target, const uint8_t* source, uint8_t count) {
    __asm__ volatile(
        "rjmp 2f               \n\t"
        "1: ld r0, %a[source]+ \n\t"
        "st   %a[target]+, r0  \n\t"
        "ld   r0, %a[source]+  \n\t"
        "st   %a[target]+, r0  \n\t"
        "ld   r0, %a[source]+  \n\t"
        "st   %a[target]+, r0  \n\t"
        "ld   r0, %a[source]+  \n\t"
        "st   %a[target]+, r0  \n\t"
        "2: subi %[count], 4   \n\t"
        "brcc 1b               \n\t"
        "subi %[count], -4     \n\t"
        "breq 4f               \n\t"
        "3: ld r0, %a[source]+ \n\t"
        "st   %a[target]+, r0  \n\t"
        "dec  %[count]         \n\t"
        "brne 3b               \n\t"
        "4:                    \n\t"
        : [target] "+e"(target), [source] "+e"(source), [count] "+d"(count)
        :
        : "memory");
  }

  // Lasts 280 us at 250 kbaud: time to hand over the next frame.
  static constexpr uint8_t kNearlyEmpty = 7;
};

// In a section of its own, or the linker would align all of .bss by it, part by part.
Serial0::Rings Serial0::rings_ __attribute__((aligned(256), section(".bss.rings")));
volatile uint8_t Serial0::rx_in_, Serial0::rx_out_, Serial0::tx_in_, Serial0::tx_stop_;
volatile uint16_t Serial0::overruns_;

}  // namespace mega
}  // namespace thigmo

// A received byte: into the ring's free place, which becomes the ring's if another one is left. The
// main loop wakes when a frame is whole; noise without delimiters waits for the next tick, 25 bytes
// at most. 45 cycles.
ISR(USART0_RX_vect, ISR_NAKED) {
  __asm__ volatile(
      "push r24              \n\t"
      "push r30              \n\t"
      "push r31              \n\t"
      "lds  r30, %[status]   \n\t"  // before the data register, which moves the flags on
      "lds  r24, %[data]     \n\t"
      "sbrc r30, %[overrun]  \n\t"
      "rjmp 3f               \n\t"
      "1: lds r30, %[in]     \n\t"
      "ldi  r31, hi8(%[ring]) \n\t"
      "st   Z+, r24          \n\t"
      "lds  r31, %[out]      \n\t"
      "cpse r30, r31         \n\t"
      "rjmp 2f               \n\t"
      "rcall 4f              \n\t"  // full
      "rjmp 5f               \n\t"
      "2: sts %[in], r30     \n\t"
      "ldi  r31, 0           \n\t"
      "cpse r24, r31         \n\t"
      "rjmp 5f               \n\t"
      "sbi  %[wake], 0       \n\t"
      "5: pop r31            \n\t"
      "pop  r30              \n\t"
      "pop  r24              \n\t"
      "reti                  \n\t"
      "3: rcall 4f           \n\t"
      "rjmp 1b               \n\t"
      "4: in r30, %[sreg]    \n\t"  // ++overruns_
      "push r30              \n\t"
      "lds  r30, %[lost]     \n\t"
      "lds  r31, %[lost]+1   \n\t"
      "adiw r30, 1           \n\t"
      "sts  %[lost]+1, r31   \n\t"
      "sts  %[lost], r30     \n\t"
      "pop  r30              \n\t"
      "out  %[sreg], r30     \n\t"
      "ret                   \n\t"
      :
      : [sreg] "I"(_SFR_IO_ADDR(SREG)), [status] "i"(_SFR_MEM_ADDR(UCSR0A)),
        [data] "i"(_SFR_MEM_ADDR(UDR0)), [overrun] "I"(DOR0),
        [in] "i"(&thigmo::mega::Serial0::rx_in_), [out] "i"(&thigmo::mega::Serial0::rx_out_),
        [ring] "i"(thigmo::mega::Serial0::rings_.rx), [wake] "I"(_SFR_IO_ADDR(GPIOR0)),
        [lost] "i"(&thigmo::mega::Serial0::overruns_));
}

// The next byte of the ring. At the stop the main loop wakes, to hand over more; at the end there
// are no more interrupts. 37 cycles for the usual byte.
ISR(USART0_UDRE_vect, ISR_NAKED) {
  __asm__ volatile(
      "push r24              \n\t"
      "push r30              \n\t"
      "push r31              \n\t"
      "in   r30, %[out]      \n\t"
      "ldi  r31, hi8(%[ring]) \n\t"
      "ld   r24, Z+          \n\t"
      "sts  %[data], r24     \n\t"
      "out  %[out], r30      \n\t"
      "lds  r24, %[stop]     \n\t"
      "cpse r30, r24         \n\t"
      "rjmp 1f               \n\t"
      "lds  r24, %[in]       \n\t"
      "cpse r30, r24         \n\t"
      "rjmp 2f               \n\t"
      "ldi  r24, %[on]       \n\t"
      "sts  %[control], r24  \n\t"
      "1: pop r31            \n\t"
      "pop  r30              \n\t"
      "pop  r24              \n\t"
      "reti                  \n\t"
      "2: sts %[stop], r24   \n\t"
      "sbi  %[wake], 0       \n\t"
      "rjmp 1b               \n\t"
      :
      : [out] "I"(_SFR_IO_ADDR(GPIOR2)), [ring] "i"(thigmo::mega::Serial0::rings_.tx),
        [data] "i"(_SFR_MEM_ADDR(UDR0)), [stop] "i"(&thigmo::mega::Serial0::tx_stop_),
        [in] "i"(&thigmo::mega::Serial0::tx_in_), [wake] "I"(_SFR_IO_ADDR(GPIOR0)),
        [control] "i"(_SFR_MEM_ADDR(UCSR0B)), [on] "n"(thigmo::mega::Serial0::kOn));
}

#endif  // THIGMO_MEGA_SERIAL_H_
