// The skeleton on QEMU's MPS2-AN385: start-up, and the stream of its hardware on UART 1.
#include "../../micropython/thigmo_board/controller.h"
#include "../../micropython/thigmo_board/stream.h"

typedef struct {
  volatile uint32_t data, state, control, interrupt, divider;
} uart_t;
#define UART1 ((uart_t*)0x40005000)
enum { TX_FULL = 1, RX_FULL = 2 };                        // state
enum { TX_ENABLE = 1, RX_ENABLE = 2, RX_INTERRUPT = 8 };  // control
enum { RX_PENDING = 2 };                                  // interrupt
enum { UART1_RX = 2 };                                    // vector, after the core's 16
#define INTERRUPT_ENABLE (*(volatile uint32_t*)0xE000E100)

extern uint32_t bss_begin, bss_end, stack_top;

static void receive(void) {
  UART1->interrupt = RX_PENDING;
  while (UART1->state & RX_FULL) {
    const uint8_t byte = (uint8_t)UART1->data;
    injected_receive(&byte, 1);
  }
}

const char* stream_open(void) {
  UART1->divider = 16;
  UART1->control = TX_ENABLE | RX_ENABLE | RX_INTERRUPT;
  INTERRUPT_ENABLE = 1u << UART1_RX;
  (void)UART1->data;  // QEMU looks for waiting bytes after a read only
  return 0;
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
    stand_still,          0,           [16 + UART1_RX] = receive,
};
