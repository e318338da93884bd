// Internal: the parts of the simulated chip and how they hang on libsimavr.
#ifndef THIGMO_MEGA_SIM_CHIP_H_
#define THIGMO_MEGA_SIM_CHIP_H_

#include <stdbool.h>
#include <stdint.h>

#include "avr_eeprom.h"
#include "bridge.h"
#include "sim_avr.h"
#include "sim_cycle_timers.h"
#include "sim_interrupts.h"

typedef avr_cycle_count_t cycles;
#define NEVER UINT64_MAX

// --- timer16.c: one 16-bit timer -----------------------------------------------------------------
enum { TIMER_A, TIMER_B, TIMER_C, TIMER_OVERFLOW, TIMER_EVENTS };
typedef struct {
  chip* c;
  uint16_t base;          // data address of TCCRnA
  uint16_t flags, masks;  // data addresses of TIFRn, TIMSKn
  avr_int_vector_t* vector[TIMER_EVENTS];
  uint16_t compare[3], capture;  // OCRnA..C, ICRn
  uint8_t high;                  // the shared TEMP register of 16-bit accesses
  uint16_t held;                 // TCNT while stopped
  uint32_t prescale;             // 0 = stopped
  cycles zero;                   // cycle at which TCNT was (or would have been) 0
  cycles cleared[TIMER_EVENTS];  // flags count matches after these cycles
  uint8_t latched;               // flags raised before the last change of clock or top
} timer16;

// --- usart.c -------------------------------------------------------------------------------------
enum { LINE_ROOM = 1 << 16 };
typedef struct {
  chip* c;
  avr_int_vector_t *received, *empty, *sent;
  uint32_t host_baud;
  // wire to board
  uint8_t in[LINE_ROOM];
  uint32_t in_read, in_write;
  bool frame_running;
  uint8_t frame_byte;
  bool frame_bad;
  // receiver: two bytes of buffer and the shift register
  uint8_t fifo[2], shift;
  bool fifo_bad[2], shift_bad, shift_full, overrun_flag;
  uint8_t depth;
  uint64_t overruns;
  // transmitter
  bool sending, waiting;
  uint8_t sending_byte, waiting_byte;
  uint8_t out[LINE_ROOM];
  cycles out_cycle[LINE_ROOM];
  uint32_t out_read, out_write;
} usart;

// --- adc.c ---------------------------------------------------------------------------------------
typedef struct {
  double start[BRIDGE_CHANNELS], end[BRIDGE_CHANNELS];
  cycles from, to;
} analog_window;

typedef struct {
  chip* c;
  avr_int_vector_t* done;
  bool first, running;
  uint8_t channel;  // locked when the conversion starts
  cycles phase;     // of the ADC's prescaler
  cycles sampled, ends;
  uint16_t result;
  analog_window now, before;
  uint64_t seed;
  double sigma[BRIDGE_CHANNELS];
  uint16_t* feed;
  uint64_t feed_first, feed_ticks;
  bool recording;
  bridge_conversion* trace;
  uint32_t trace_count, trace_room;
  uint32_t lost_triggers;
} adc;

// --- eeprom.c ------------------------------------------------------------------------------------
typedef struct {
  chip* c;
  avr_eeprom_t* store;
  avr_int_vector_t* ready;
  bool enabled;  // EEMPE was set less than four cycles ago
  bool busy;
  uint16_t address;
  uint8_t value;
  int64_t cut_after;  // -1: never
  uint64_t writes;
} eeprom;

typedef struct {
  chip* c;
  avr_int_vector_t* vector;
  cycles requested, accepted;
  bridge_interrupt figures;
} interrupt_watch;

typedef struct {
  cycles cycle;
  char port;
  uint8_t bit, level;
} edge;
enum { EDGE_ROOM = 4096, MARK_ROOM = 1 << 16, PORTS = 12 };

struct chip {
  avr_t* avr;
  timer16 timer[4];  // 1, 3, 4, 5
  usart line;
  adc analog;
  eeprom eeprom;
  interrupt_watch watch[BRIDGE_VECTORS];
  edge edges[EDGE_ROOM];
  uint32_t edge_read, edge_write;
  bridge_mark* marks;
  uint32_t mark_count;
  bool marking;
  uint32_t supply_mv;
  bool in_brown_out, power_cut;
  bool was_reset;  // by the watchdog, inside avr_run
  cycles asleep;
  void (*core_reset)(avr_t* avr);
  uint8_t driven[PORTS], level[PORTS];  // inputs, by port
  uint64_t resets[4];
  uint64_t filler;
  cycles tick_origin;  // cycle of timer 1's tick 0
};

// Timer n is timer[slot]: 1 -> 0, 3 -> 1, 4 -> 2, 5 -> 3.
void timer16_attach(chip* c);
void timer16_reset(chip* c);
void usart_attach(chip* c);
void usart_reset(chip* c);
void adc_attach(chip* c);
void adc_reset(chip* c);
void adc_trigger(chip* c, cycles when);  // timer 1's compare match B
bool adc_listens(chip* c);               // to that match
void eeprom_attach(chip* c);
void eeprom_reset(chip* c);
void eeprom_power_cut(chip* c);

// A device register gets these handlers, instead of libsimavr's.
void hook(chip* c, uint16_t address, avr_io_read_t read, avr_io_write_t write, void* param);
avr_int_vector_t* vector_of(chip* c, int number);
// Request an interrupt whose flag is set; nothing happens while it is masked.
void request(chip* c, avr_int_vector_t* vector);
void withdraw(chip* c, avr_int_vector_t* vector);
void stall(chip* c, unsigned count);  // the processor waits so many cycles

#endif  // THIGMO_MEGA_SIM_CHIP_H_
