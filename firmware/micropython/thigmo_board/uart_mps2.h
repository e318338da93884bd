// UART 1 of QEMU's MPS2-AN385 as the stream of a board's hardware (stream.h). Included by the one C
// file of an image that opens it: the skeleton's, and MicroPython's.
#ifndef THIGMO_UART_MPS2_H_
#define THIGMO_UART_MPS2_H_

#include "controller.h"
#include "stream.h"

typedef struct {
  volatile uint32_t data, state, control, interrupt, divider;
} uart_t;
#define UART1 ((uart_t*)0x40005000)
enum { TX_FULL = 1, RX_FULL = 2 };                        // state
enum { TX_ENABLE = 1, RX_ENABLE = 2, RX_INTERRUPT = 8 };  // control
enum { RX_PENDING = 2 };                                  // interrupt
enum { UART0_RX = 0, UART1_RX = 2 };                      // vector, after the core's 16
#define INTERRUPT_ENABLE (*(volatile uint32_t*)0xE000E100)

static void uart1_receive(void) {
  UART1->interrupt = RX_PENDING;
  while (UART1->state & RX_FULL) {
    const uint8_t byte = (uint8_t)UART1->data;
    injected_receive(&byte, 1);
  }
}

// Its vector must be in place, and so must those of other interrupts that are to be enabled (bits).
static void uart1_open(uint32_t interrupts) {
  UART1->divider = 16;
  UART1->control = TX_ENABLE | RX_ENABLE | RX_INTERRUPT;
  INTERRUPT_ENABLE = 1u << UART1_RX | interrupts;
  (void)UART1->data;  // QEMU looks for waiting bytes after a read only
}

void stream_send(const uint8_t* bytes, uint32_t count) {
  for (; count != 0; --count) {
    while (UART1->state & TX_FULL) {
    }
    UART1->data = *bytes++;
  }
}

void stream_lock(void) { __asm volatile("cpsid i" ::: "memory"); }
void stream_unlock(void) { __asm volatile("cpsie i" ::: "memory"); }

bool stream_wait(void) {
  __asm volatile("wfi");
  return true;
}

#endif  // THIGMO_UART_MPS2_H_
