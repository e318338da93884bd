// The skeleton on QEMU's MPS2-AN385: start-up, and the stream of its hardware on UART 1.
#include "../../micropython/thigmo_board/uart_mps2.h"

extern uint32_t bss_begin, bss_end, stack_top;

const char* stream_open(void) {
  uart1_open(0);
  return 0;
}

void thigmo_call_soon(void) {}  // no Python here

static void reset(void) {
  for (uint32_t* word = &bss_begin; word < &bss_end; ++word) *word = 0;
  thigmo_begin(0);
  for (;;) stream_wait();
}

static void stand_still(void) {
  for (;;) {
  }
}

typedef void (*vector_t)(void);
__attribute__((section(".vectors"), used)) static const vector_t vectors[16 + 32] = {
    (vector_t)&stack_top, reset,       stand_still,
    stand_still,          stand_still, stand_still,
    stand_still,          0,           [16 + UART1_RX] = uart1_receive,
};
