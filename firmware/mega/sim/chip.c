// Life cycle, lockstep run loop, interrupts, pins and measurement of the simulated chip.
#include "chip.h"

#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include "avr_extint.h"
#include "avr_ioport.h"
#include "sim_io.h"

enum {
  kGpior0 = 0x3E,
  kGpior1 = 0x4A,
  kGpior2 = 0x4B,
  kEifr = 0x3C,
  kMcusr = 0x54,
  kSram = 0x200,
  kBrownOutMv = 2700,        // extended fuse 0xFD, as the Arduino Mega ships
  kBrownOutRecoverMv = 2750  // 50 mV of hysteresis
};

// A 22-bit program counter makes acceptance of an interrupt take five cycles (data sheet 7.8.1);
// libsimavr counts none.
static const unsigned kAcceptCycles = 5;
static const unsigned kRetiCycles = 5;

static void quiet(avr_t* avr, const int level, const char* format, va_list arguments) {
  (void)avr, (void)level, (void)format, (void)arguments;
}
static chip* chip_of(avr_t* avr) { return avr->custom.data; }

// Asleep until the next cycle timer, without slowing the host down.
static void on_sleep(avr_t* avr, avr_cycle_count_t howlong) { chip_of(avr)->asleep += howlong + 1; }

void hook(chip* c, uint16_t address, avr_io_read_t read, avr_io_write_t write, void* param) {
  const int io = AVR_DATA_TO_IO(address);
  if (read) c->avr->io[io].r.c = read, c->avr->io[io].r.param = param;
  if (write) c->avr->io[io].w.c = write, c->avr->io[io].w.param = param;
}

avr_int_vector_t* vector_of(chip* c, int number) {
  for (int i = 0; i < c->avr->interrupts.vector_count; i++)
    if (c->avr->interrupts.vector[i]->vector == number) return c->avr->interrupts.vector[i];
  return 0;
}

void request(chip* c, avr_int_vector_t* vector) {
  if (!vector->pending && avr_regbit_get(c->avr, vector->enable)) {
    if (c->watch[vector->vector].requested == NEVER)
      c->watch[vector->vector].requested = c->avr->cycle;
    avr_raise_interrupt(c->avr, vector);
  }
}

void withdraw(chip* c, avr_int_vector_t* vector) {
  c->watch[vector->vector].requested = NEVER;
  if (!vector->pending) return;
  uint8_t* flags =
      c->avr->data + vector->raised.reg;  // avr_clear_interrupt clears the flag as well
  const uint8_t kept = *flags;
  avr_clear_interrupt(c->avr, vector);
  if (vector->raised.reg) *flags = kept;
}

// The processor stands still; cycle timers must not be late by that.
void stall(chip* c, unsigned count) {
  avr_t* avr = c->avr;
  avr->cycle += count;
  avr->run_cycle_count = avr->run_cycle_count > count ? avr->run_cycle_count - count : 1;
}

static void on_pending(struct avr_irq_t* irq, uint32_t value, void* param) {
  (void)irq;
  interrupt_watch* w = param;
  const avr_int_vector_t* vector = w->vector;
  if (value && w->requested == NEVER && avr_regbit_get(w->c->avr, vector->enable))
    w->requested = w->c->avr->cycle;
}

static void on_running(struct avr_irq_t* irq, uint32_t value, void* param) {
  (void)irq;
  interrupt_watch* w = param;
  avr_t* avr = w->c->avr;
  if (value) {
    w->accepted = avr->cycle;
    if (w->requested != NEVER && avr->cycle - w->requested > w->figures.waited)
      w->figures.waited = avr->cycle - w->requested;
    w->requested = NEVER;
    stall(w->c, kAcceptCycles);
  } else if (w->accepted != NEVER) {
    const uint64_t took = avr->cycle + kRetiCycles - w->accepted;
    bridge_interrupt* f = &w->figures;
    f->count++;
    f->total += took;
    if (took > f->longest) f->longest = took;
    if (took < f->shortest) f->shortest = took;
    w->accepted = NEVER;
  }
}

static uint8_t* data_of(chip* c) { return c->avr->data; }

static void on_mark(avr_t* avr, avr_io_addr_t address, uint8_t value, void* param) {
  chip* c = param;
  avr->data[address] = value;
  if (!c->marking || c->mark_count == MARK_ROOM) return;
  c->marks[c->mark_count++] = (bridge_mark){
      .cycle = avr->cycle,
      .reg = address == kGpior0 ? 0 : (uint8_t)(address - kGpior1 + 1),
      .value = value,
  };
}

// libsimavr calls this from avr_reset, after it has dropped all cycle timers.
static void on_reset(avr_t* avr) {
  chip* c = chip_of(avr);
  if (c->core_reset) c->core_reset(avr);
  c->was_reset = true;
}

// Levels of the pins that are driven from outside. libsimavr needs them as "external" values, or an
// enabled pull-up would win; `again`: it forgets them at a reset, and ignores a level that it saw
// last.
static void drive(chip* c, int port, int bit, int level, bool again) {
  const char name = (char)('A' + port);
  avr_irq_t* irq = avr_io_getirq(c->avr, AVR_IOCTL_IOPORT_GETIRQ(name), bit);
  if (!irq) return;
  avr_ioport_external_t outside = {
      .name = (unsigned char)name, .mask = c->driven[port], .value = c->level[port]};
  avr_ioctl(c->avr, AVR_IOCTL_IOPORT_SET_EXTERNAL(name), &outside);
  if (again) irq->value = !level;
  avr_raise_irq(irq, level ? 1 : 0);
}

static avr_cycle_count_t run_edges(avr_t* avr, avr_cycle_count_t when, void* param) {
  (void)when;
  chip* c = param;
  while (c->edge_read != c->edge_write) {
    const edge* e = &c->edges[c->edge_read % EDGE_ROOM];
    if (e->cycle > avr->cycle) return e->cycle;
    c->edge_read++;
    bridge_pin(c, e->port, e->bit, e->level);
  }
  return 0;
}

static avr_cycle_count_t wake(avr_t* avr, avr_cycle_count_t when, void* param) {
  (void)avr, (void)when, (void)param;
  return 0;
}

static uint64_t mix(uint64_t z) {  // SplitMix64's output function
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ull;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBull;
  return z ^ (z >> 31);
}

chip* bridge_new(void) {
  avr_global_logger_set(quiet);
  avr_t* avr = avr_make_mcu_by_name("atmega2560");
  chip* c = calloc(1, sizeof *c);
  if (!avr || !c) return 0;
  c->avr = avr;
  c->marks = calloc(MARK_ROOM, sizeof *c->marks);
  avr_init(avr);
  avr->custom.data = c;
  c->core_reset = avr->reset;
  avr->reset = on_reset;
  avr->frequency = BRIDGE_HZ;
  avr->run_cycle_limit =
      BRIDGE_HZ;  // batches end at the next cycle timer, not after each instruction
  avr->sleep = on_sleep;
  avr->log = LOG_NONE;
  c->supply_mv = 5000;
  avr->vcc = avr->avcc = avr->aref = 5000;
  memset(avr->flash, 0xFF, avr->flashend + 1);
  c->eeprom.cut_after = -1;
  for (int v = 1; v < BRIDGE_VECTORS; v++) {
    interrupt_watch* w = &c->watch[v];
    w->c = c, w->vector = vector_of(c, v), w->requested = w->accepted = NEVER;
    if (!w->vector) continue;
    avr_irq_register_notify(w->vector->irq + AVR_INT_IRQ_PENDING, on_pending, w);
    avr_irq_register_notify(w->vector->irq + AVR_INT_IRQ_RUNNING, on_running, w);
  }
  timer16_attach(c);
  usart_attach(c);
  adc_attach(c);
  eeprom_attach(c);
  hook(c, kGpior0, 0, on_mark, c);
  hook(c, kGpior1, 0, on_mark, c);
  hook(c, kGpior2, 0, on_mark, c);
  bridge_measure_reset(c);
  bridge_reset(c, BRIDGE_POWER_ON, 0);
  return c;
}

void bridge_free(chip* c) {
  if (!c) return;
  avr_terminate(c->avr);
  free(c->analog.feed);
  free(c->analog.trace);
  free(c->marks);
  free(c);
}

// Parts lose their state with any reset; memory of the chip (SRAM, flash, EEPROM) does not.
static void after_reset(chip* c, int cause) {
  avr_t* avr = c->avr;
  c->was_reset = false;
  timer16_reset(c);
  usart_reset(c);
  adc_reset(c);
  eeprom_reset(c);
  for (int v = 1; v < BRIDGE_VECTORS; v++) c->watch[v].requested = c->watch[v].accepted = NEVER;
  // A pin that is low while its interrupt is level-triggered (as after reset) would be polled in
  // every cycle.
  for (uint8_t n = 0; n < 8; n++) avr_extint_set_strict_lvl_trig(avr, n, 0);
  for (int port = 0; port < PORTS; port++)
    for (int bit = 0; bit < 8; bit++)
      if (c->driven[port] >> bit & 1) drive(c, port, bit, c->level[port] >> bit & 1, true);
  avr->data[kEifr] = 0;
  avr->data[kMcusr] = (uint8_t)cause;
  for (int bit = 0; bit < 4; bit++)
    if (cause == 1 << bit) c->resets[bit]++;
  if (c->edge_read != c->edge_write)
    avr_cycle_timer_register(avr,
                             c->edges[c->edge_read % EDGE_ROOM].cycle > avr->cycle
                                 ? c->edges[c->edge_read % EDGE_ROOM].cycle - avr->cycle
                                 : 1,
                             run_edges, c);
}

void bridge_reset(chip* c, int cause, uint64_t filler) {
  if (cause == BRIDGE_POWER_ON) {
    c->filler = filler;
    c->power_cut = false;
    for (uint32_t a = kSram; a <= c->avr->ramend; a++)
      c->avr->data[a] = (uint8_t)mix(filler * 0x10000u + a);
  }
  avr_reset(c->avr);
  after_reset(c, cause);
}

void bridge_boot_at(chip* c, uint32_t address) { c->avr->reset_pc = address; }

int bridge_run(chip* c, uint64_t target) {
  avr_t* avr = c->avr;
  if (c->in_brown_out || c->power_cut) {  // held in reset: time passes, nothing happens
    if (target > avr->cycle) avr->cycle = target;
    return 0;
  }
  if (avr->cycle >= target) return 0;
  avr_cycle_timer_register(avr, target - avr->cycle, wake, c);
  while (avr->cycle < target) {
    const int state = avr_run(avr);
    if (c->was_reset) {
      after_reset(c, BRIDGE_WATCHDOG);
      avr_cycle_timer_register(avr, target > avr->cycle ? target - avr->cycle : 1, wake, c);
    }
    if (c->power_cut) {
      avr_reset(avr);
      after_reset(c, 0);
      avr->cycle = target;
      return 0;
    }
    if (state == cpu_Done || state == cpu_Crashed) return 1;
  }
  return 0;
}

int bridge_hang(chip* c, int interrupts) {
  avr_t* avr = c->avr;
  uint32_t trap = 0;
  while (trap < avr->flashend && (avr->flash[trap] != 0xFF || avr->flash[trap + 1] != 0xCF))
    trap += 2;
  if (trap >= avr->flashend) return -1;
  for (int i = 0; i < BRIDGE_HZ / 100; i++) {
    if (!avr->interrupts.running_ptr && avr->sreg[S_I]) break;
    bridge_run(c, avr->cycle + 1);
  }
  avr->pc = trap;
  avr->sreg[S_I] = interrupts ? 1 : 0;
  if (avr->state == cpu_Sleeping) avr->state = cpu_Running;
  return 0;
}

uint64_t bridge_cycle(chip* c) { return c->avr->cycle; }
uint32_t bridge_pc(chip* c) { return c->avr->pc; }
uint64_t bridge_asleep(chip* c) { return c->asleep; }
uint64_t bridge_resets(chip* c, int cause) {
  for (int bit = 0; bit < 4; bit++)
    if (cause == 1 << bit) return c->resets[bit];
  return 0;
}

void bridge_flash_write(chip* c, uint32_t address, const uint8_t* bytes, uint32_t count) {
  memcpy(c->avr->flash + address, bytes, count);
}
void bridge_flash_read(chip* c, uint32_t address, uint8_t* bytes, uint32_t count) {
  memcpy(bytes, c->avr->flash + address, count);
}
void bridge_ram_write(chip* c, uint32_t address, const uint8_t* bytes, uint32_t count) {
  memcpy(data_of(c) + address, bytes, count);
}
void bridge_ram_read(chip* c, uint32_t address, uint8_t* bytes, uint32_t count) {
  memcpy(bytes, data_of(c) + address, count);
}

void bridge_supply(chip* c, uint32_t millivolt) {
  c->supply_mv = millivolt;
  if (millivolt < kBrownOutMv && !c->in_brown_out) {
    c->in_brown_out = true;
    avr_reset(c->avr);
    after_reset(c, 0);
  } else if (millivolt >= kBrownOutRecoverMv && c->in_brown_out) {
    c->in_brown_out = false;
    bridge_reset(c, BRIDGE_BROWN_OUT, 0);
  }
}

void bridge_pin(chip* c, char port, int bit, int level) {
  const int n = port - 'A';
  if (n < 0 || n >= PORTS || bit < 0 || bit > 7) return;
  c->driven[n] |= 1 << bit;
  c->level[n] = (uint8_t)((c->level[n] & ~(1 << bit)) | (level ? 1 << bit : 0));
  drive(c, n, bit, level, false);
}

int bridge_pin_at(chip* c, uint64_t cycle, char port, int bit, int level) {
  if (c->edge_write - c->edge_read == EDGE_ROOM) return -1;
  const bool idle = c->edge_read == c->edge_write;
  c->edges[c->edge_write++ % EDGE_ROOM] =
      (edge){.cycle = cycle, .port = port, .bit = (uint8_t)bit, .level = (uint8_t)level};
  if (idle)
    avr_cycle_timer_register(c->avr, cycle > c->avr->cycle ? cycle - c->avr->cycle : 1, run_edges,
                             c);
  return 0;
}

int bridge_port(chip* c, char port) {
  avr_ioport_state_t state;
  if (avr_ioctl(c->avr, AVR_IOCTL_IOPORT_GETSTATE(port), &state) < 0) return -1;
  return state.pin << 16 | state.ddr << 8 | state.port;
}

// Channels follow the Gray code of the count's low two bits, A leading when the count rises.
static void encoder_edge(chip* c, char port, int a, int b, int64_t from, int64_t to, cycles cycle) {
  const int was = (int)(from & 3), is = (int)(to & 3);
  const int was_a = was == 1 || was == 2, is_a = is == 1 || is == 2;
  const int was_b = was >= 2, is_b = is >= 2;
  if (was_a != is_a) bridge_pin_at(c, cycle, port, a, is_a);
  if (was_b != is_b) bridge_pin_at(c, cycle, port, b, is_b);
}

void bridge_encoder(chip* c, char port, int bit_a, int bit_b, double start, double end,
                    uint64_t from, uint64_t to) {
  int64_t count = (int64_t)floor(start);
  const int64_t last = (int64_t)floor(end);
  if (last == count) return;
  const double per_cycle = (end - start) / (double)(to - from);
  while (count != last) {
    const int64_t next = end > start ? count + 1 : count - 1;
    const double crossing = end > start ? (double)next : (double)count;
    cycles cycle = from + (cycles)((crossing - start) / per_cycle);
    if (cycle > to) cycle = to;
    encoder_edge(c, port, bit_a, bit_b, count, next, cycle);
    count = next;
  }
}

void bridge_interrupt_read(chip* c, int vector, bridge_interrupt* out) {
  *out = c->watch[vector].figures;
}

void bridge_measure_reset(chip* c) {
  for (int v = 0; v < BRIDGE_VECTORS; v++)
    c->watch[v].figures = (bridge_interrupt){.shortest = UINT64_MAX};
  c->asleep = 0;
}

void bridge_marks_on(chip* c, int on) { c->marking = on; }
uint32_t bridge_marks(chip* c, bridge_mark* out, uint32_t room) {
  const uint32_t count = c->mark_count < room ? c->mark_count : room;
  memcpy(out, c->marks, count * sizeof *out);
  memmove(c->marks, c->marks + count, (c->mark_count - count) * sizeof *out);
  c->mark_count -= count;
  return count;
}
uint64_t bridge_tick_origin(chip* c) { return c->tick_origin; }
uint32_t bridge_lost_triggers(chip* c) { return c->analog.lost_triggers; }
int bridge_power_is_cut(chip* c) { return c->power_cut; }
