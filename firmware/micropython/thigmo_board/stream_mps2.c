// The stream of QEMU's MPS2-AN385: UART 1, by its receive interrupt. UART 0 is Python's prompt.
#include "py/runtime.h"
#include "shared/runtime/interrupt_char.h"
#include "uart_mps2.h"

#define UART0 ((uart_t*)0x40004000)
#define VECTOR_TABLE (*(volatile uint32_t*)0xE000ED08)

static uint32_t vectors[64] __attribute__((aligned(256)));

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
  vectors[16 + UART1_RX] = (uint32_t)(uintptr_t)uart1_receive;
  VECTOR_TABLE = (uint32_t)(uintptr_t)vectors;
  UART0->control |= RX_INTERRUPT;
  uart1_open(1u << UART0_RX);
  return NULL;
}
