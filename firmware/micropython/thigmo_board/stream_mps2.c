// The stream of QEMU's MPS2-AN385: UART 1, by its receive interrupt. UART 0 is Python's prompt.
#include "controller.h"
#include "py/runtime.h"
#include "shared/runtime/interrupt_char.h"
#include "stream.h"

typedef struct {
  volatile uint32_t data, state, control, interrupt, divider;
} uart_t;
#define UART0 ((uart_t*)0x40004000)
#define UART1 ((uart_t*)0x40005000)
enum { TX_FULL = 1, RX_FULL = 2 };                        // state
enum { TX_ENABLE = 1, RX_ENABLE = 2, RX_INTERRUPT = 8 };  // control
enum { RX_PENDING = 2 };                                  // interrupt
enum { UART0_RX = 0, UART1_RX = 2 };                      // vector, after the core's 16

#define VECTOR_TABLE (*(volatile uint32_t*)0xE000ED08)
#define INTERRUPT_ENABLE (*(volatile uint32_t*)0xE000E100)

static uint32_t vectors[64] __attribute__((aligned(256)));

static void receive(void) {
  UART1->interrupt = RX_PENDING;
  while (UART1->state & RX_FULL) {
    const uint8_t byte = (uint8_t)UART1->data;
    injected_receive(&byte, 1);
  }
}

// Keys that were typed before somebody asked for them.
static uint8_t keys[256];
static volatile uint8_t keys_in, keys_out;

static void receive_key(void) {
  UART0->interrupt = RX_PENDING;
  while (UART0->state & RX_FULL) {
    const uint8_t key = (uint8_t)UART0->data;
    if (key == mp_interrupt_char) {
      mp_sched_keyboard_interrupt();
    } else {
      keys[keys_in++] = key;
    }
  }
}

int __real_mp_hal_stdin_rx_chr(void);
int thigmo_key(void) {
  if (!(UART1->control & RX_ENABLE)) return __real_mp_hal_stdin_rx_chr();
  while (keys_in == keys_out) {
    mp_handle_pending(false);
    __asm volatile("wfi");
  }
  return keys[keys_out++];
}

const char* stream_open(void) {
  if (UART1->control & RX_ENABLE) return NULL;
  const uint32_t* const old = (const uint32_t*)VECTOR_TABLE;
  for (int i = 0; i < 16; ++i) vectors[i] = old[i];
  vectors[16 + UART0_RX] = (uint32_t)(uintptr_t)receive_key;
  vectors[16 + UART1_RX] = (uint32_t)(uintptr_t)receive;
  VECTOR_TABLE = (uint32_t)(uintptr_t)vectors;
  UART1->divider = 16;
  UART0->control |= RX_INTERRUPT;
  UART1->control = TX_ENABLE | RX_ENABLE | RX_INTERRUPT;
  INTERRUPT_ENABLE = 1u << UART0_RX | 1u << UART1_RX;
  (void)UART1->data;  // QEMU looks for waiting bytes after a read only
  return NULL;
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
