// The simulated ATmega2560, as host/thigmo/emulator/chip.py calls it (ctypes).
//
// libsimavr runs the instructions, ports, external interrupts, watchdog and flash; its 16-bit
// timers 1, 3, 4, 5, USART0, ADC and EEPROM are replaced by the models in this folder, for those of
// version 1.6 differ from the chip (see README.md here: each difference, its cure and its test).
// Everything is a pure function of the calls made: no wall clock, no randomness of its own.
#ifndef THIGMO_MEGA_SIM_BRIDGE_H_
#define THIGMO_MEGA_SIM_BRIDGE_H_

#include <stdint.h>

enum { BRIDGE_CHANNELS = 16, BRIDGE_HZ = 16000000, BRIDGE_VECTORS = 57 };

// Why the chip starts; bits of MCUSR.
enum { BRIDGE_POWER_ON = 1, BRIDGE_EXTERNAL = 2, BRIDGE_BROWN_OUT = 4, BRIDGE_WATCHDOG = 8 };

typedef struct chip chip;

typedef struct {
  uint64_t count, total, longest, shortest;  // cycles from acceptance to the end of RETI
  uint64_t waited;                           // longest from request to acceptance
} bridge_interrupt;

typedef struct {
  uint64_t cycle;
  uint8_t reg;  // 0..2: GPIOR0..2
  uint8_t value;
} bridge_mark;

typedef struct {
  uint64_t sampled;  // cycle at which the conversion's input was held
  uint32_t tick;     // of timer 1, 0xFFFFFFFF before the first
  uint16_t count;
  uint8_t channel;
} bridge_conversion;

typedef struct {
  uint8_t connected[3];  // compare outputs A, B, C reach their pins
  uint8_t inverted[3];
  uint16_t compare[3];
  uint16_t top;     // 0 when stopped
  uint32_t period;  // cycles of a full period; 0 when stopped
} bridge_pwm;

chip* bridge_new(void);
void bridge_free(chip* c);
void bridge_flash_write(chip* c, uint32_t address, const uint8_t* bytes, uint32_t count);
void bridge_flash_read(chip* c, uint32_t address, uint8_t* bytes, uint32_t count);
void bridge_eeprom_write(chip* c, uint32_t address, const uint8_t* bytes, uint32_t count);
void bridge_eeprom_read(chip* c, uint32_t address, uint8_t* bytes, uint32_t count);
void bridge_ram_write(chip* c, uint32_t address, const uint8_t* bytes, uint32_t count);
void bridge_ram_read(chip* c, uint32_t address, uint8_t* bytes, uint32_t count);
void bridge_boot_at(chip* c, uint32_t address);  // reset vector (BOOTRST fuse)
// Restart. Power-on also fills SRAM with bytes made from `filler`.
void bridge_reset(chip* c, int cause, uint64_t filler);
// The main program never returns from here (an endless loop of its own image), with interrupts on
// or off. -1 when the image holds no such loop.
int bridge_hang(chip* c, int interrupts);

// Run to an absolute cycle. 0, or 1 when the program died (bad address, sleep without interrupts).
int bridge_run(chip* c, uint64_t cycle);
uint64_t bridge_cycle(chip* c);
uint32_t bridge_pc(chip* c);      // byte address of the next instruction
uint64_t bridge_asleep(chip* c);  // cycles asleep since the last bridge_measure_reset
uint64_t bridge_resets(chip* c, int cause);

// Analog inputs: ideal counts (0..1024) at two cycles, linear in between, held after.
void bridge_analog(chip* c, const double* start, const double* end, uint64_t from, uint64_t to);
void bridge_noise(chip* c, uint64_t seed, const double* sigma);
void bridge_supply(chip* c, uint32_t millivolt);
// Counts to deliver instead of the analog inputs: table[tick - first][channel], 0xFFFF = none.
void bridge_trace_feed(chip* c, const uint16_t* table, uint64_t first, uint64_t ticks);
uint32_t bridge_trace_read(chip* c, bridge_conversion* out, uint32_t room);  // while recording
void bridge_trace_record(chip* c, int on);
uint64_t bridge_tick_origin(chip* c);  // cycle at which timer 1's tick 0 began, or 0
uint32_t bridge_lost_triggers(chip* c);

// Digital pins, by port letter and bit.
void bridge_pin(chip* c, char port, int bit, int level);
int bridge_pin_at(chip* c, uint64_t cycle, char port, int bit, int level);
int bridge_port(chip* c, char port);  // pin << 16 | ddr << 8 | port
// Quadrature: count position moves linearly from `start` to `end` between two cycles.
void bridge_encoder(chip* c, char port, int bit_a, int bit_b, double start, double end,
                    uint64_t from, uint64_t to);
void bridge_pwm_read(chip* c, int timer, bridge_pwm* out);

// USART0's wire. Bytes queue at the host's rate; baud 0: the host always matches the board.
void bridge_line_baud(chip* c, uint32_t baud);
uint32_t bridge_line_send(chip* c, const uint8_t* bytes, uint32_t count);
uint32_t bridge_line_take(chip* c, uint8_t* bytes, uint64_t* cycles, uint32_t room);
uint32_t bridge_line_backlog(chip* c);   // sent bytes not yet on the wire
uint64_t bridge_line_overruns(chip* c);  // bytes that the USART lost
void bridge_line_clear(chip* c);         // drop what waits in both directions
uint32_t bridge_line_cycles(chip* c);    // the board's cycles of one byte; 0 while off

// EEPROM: cut the power in the middle of the n-th write from now (0 = the next); the byte is torn.
void bridge_eeprom_cut(chip* c, int64_t writes);
int bridge_power_is_cut(chip* c);
uint64_t bridge_eeprom_writes(chip* c);

// Measurement.
void bridge_interrupt_read(chip* c, int vector, bridge_interrupt* out);
void bridge_measure_reset(chip* c);
uint32_t bridge_marks(chip* c, bridge_mark* out, uint32_t room);
void bridge_marks_on(chip* c, int on);

#endif  // THIGMO_MEGA_SIM_BRIDGE_H_
