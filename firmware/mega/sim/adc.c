// The analog-to-digital converter (data sheet 26): 16 single-ended channels, bandgap, ground,
// single, free-running and timer-1-triggered conversions, with the instant at which the input is
// held. Counts come from the exchange's analog values plus noise, or from a trace.
//
// libsimavr 1.6 keeps values of eight channels only (the others overrun the array), ignores MUX5
// and knows no timer trigger.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "../../virtual/adc_noise.h"
#include "chip.h"

enum { ADCL = 0x78, ADCH = 0x79, ADCSRA = 0x7A, ADCSRB = 0x7B, ADMUX = 0x7C };
enum {
  ADEN = 0x80,
  ADSC = 0x40,
  ADATE = 0x20,
  ADIF = 0x10,
  ADIE = 0x08,
  MUX5 = 0x08,
  ADLAR = 0x20
};
enum { TRIGGER_FREE = 0, TRIGGER_TIMER1_B = 5 };
enum { kBandgapMv = 1100, kBandgap = 30, kGround = 31, kTickCycles = 16000 };

static uint8_t reg(const adc* a, int address) { return a->c->avr->data[address]; }
static cycles clock_cycles(const adc* a) {
  const unsigned select = reg(a, ADCSRA) & 7;
  return 1u << (select ? select : 1);
}
static uint8_t selected(const adc* a) {
  const uint8_t mux = reg(a, ADMUX) & 31;
  if (reg(a, ADCSRB) & MUX5) return mux < 8 ? mux + 8 : kGround;
  return mux < 8 || mux == kBandgap ? mux : kGround;  // differential channels: not modelled
}

static double level(const adc* a, int channel, cycles cycle) {
  const analog_window* w = cycle < a->now.from ? &a->before : &a->now;
  if (cycle <= w->from || w->to <= w->from)
    return cycle <= w->from ? w->start[channel] : w->end[channel];
  if (cycle >= w->to) return w->end[channel];
  const double part = (double)(cycle - w->from) / (double)(w->to - w->from);
  return w->start[channel] + (w->end[channel] - w->start[channel]) * part;
}

static uint16_t convert(adc* a, uint32_t tick) {
  double ideal;
  if (a->channel == kGround) return 0;
  if (a->channel == kBandgap) {
    ideal = kBandgapMv * 1024.0 / a->c->supply_mv;
  } else {
    if (a->feed && tick >= a->feed_first && tick - a->feed_first < a->feed_ticks) {
      const uint16_t count = a->feed[(tick - a->feed_first) * BRIDGE_CHANNELS + a->channel];
      if (count != 0xFFFF) return count;
    }
    ideal = level(a, a->channel, a->sampled);
    const double sigma = a->sigma[a->channel];
    if (sigma > 0) ideal += sigma * adc_noise(a->seed, tick, a->channel);
  }
  const double count = floor(ideal);
  return count < 0 ? 0 : count > 1023 ? 1023 : (uint16_t)count;
}

static avr_cycle_count_t complete(avr_t* avr, avr_cycle_count_t when, void* param);

// The input multiplexer is locked when a conversion starts.
static void lock(adc* a, cycles start, double hold, double length) {
  const cycles clock = clock_cycles(a);
  a->channel = selected(a);
  a->sampled = start + (cycles)(hold * (double)clock);
  a->ends = start + (cycles)(length * (double)clock);
  a->running = true;
  a->c->avr->data[ADCSRA] |= ADSC;
}

static void start_single(adc* a) {
  avr_t* avr = a->c->avr;
  const cycles clock = clock_cycles(a);
  const cycles start = a->phase + (avr->cycle - a->phase + clock - 1) / clock * clock;
  lock(a, start, a->first ? 13.5 : 1.5, a->first ? 25 : 13);
  a->first = false;
  avr_cycle_timer_register(avr, a->ends - avr->cycle, complete, a);
}

bool adc_listens(chip* c) {
  const adc* a = &c->analog;
  return (reg(a, ADCSRA) & (ADEN | ADATE)) == (ADEN | ADATE) &&
         (reg(a, ADCSRB) & 7) == TRIGGER_TIMER1_B;
}

void adc_trigger(chip* c, cycles when) {
  adc* a = &c->analog;
  if (a->running) {  // an edge during a conversion is ignored
    a->lost_triggers++;
    return;
  }
  a->phase = when;  // the trigger resets the prescaler
  lock(a, when, a->first ? 13.5 : 2, a->first ? 25 : 13.5);
  a->first = false;
  avr_cycle_timer_register(c->avr, a->ends - c->avr->cycle, complete, a);
}

static avr_cycle_count_t complete(avr_t* avr, avr_cycle_count_t when, void* param) {
  adc* a = param;
  const cycles origin = a->c->tick_origin;
  const uint32_t tick =
      origin && a->sampled >= origin ? (uint32_t)((a->sampled - origin) / kTickCycles) : UINT32_MAX;
  a->result = convert(a, tick);
  if (a->recording) {
    if (a->trace_count == a->trace_room) {
      a->trace_room = a->trace_room ? 2 * a->trace_room : 4096;
      a->trace = realloc(a->trace, a->trace_room * sizeof *a->trace);
    }
    a->trace[a->trace_count++] = (bridge_conversion){
        .sampled = a->sampled, .tick = tick, .count = a->result, .channel = a->channel};
  }
  a->running = false;
  avr->data[ADCSRA] = (uint8_t)((avr->data[ADCSRA] & ~ADSC) | ADIF);
  if (avr->data[ADCSRA] & ADIE) request(a->c, a->done);
  if (avr->data[ADCSRA] & ADATE && (avr->data[ADCSRB] & 7) == TRIGGER_FREE) {
    lock(a, when, 1.5, 13);
    return a->ends;
  }
  return 0;
}

static uint8_t read_result(avr_t* avr, avr_io_addr_t address, void* param) {
  const adc* a = param;
  const uint16_t value = avr->data[ADMUX] & ADLAR ? (uint16_t)(a->result << 6) : a->result;
  return address == ADCL ? (uint8_t)value : (uint8_t)(value >> 8);
}

// Compare matches of timer 1 are simulated only while something waits for them.
static void look_at_trigger(chip* c) {
  const uint16_t masks = c->timer[0].masks;
  c->avr->io[AVR_DATA_TO_IO(masks)].w.c(c->avr, masks, c->avr->data[masks], &c->timer[0]);
}

static void write_control(avr_t* avr, avr_io_addr_t address, uint8_t value, void* param) {
  adc* a = param;
  const uint8_t before = avr->data[address];
  uint8_t after = value & (uint8_t)~(ADSC | ADIF);
  if (before & ADIF && !(value & ADIF)) after |= ADIF;  // cleared by writing 1
  if (value & ADIF) withdraw(a->c, a->done);
  if (a->running) after |= ADSC;
  avr->data[address] = after;
  if (!(value & ADEN)) {
    avr_cycle_timer_cancel(avr, complete, a);
    a->running = false;
    avr->data[address] &= (uint8_t)~ADSC;
  } else if (!(before & ADEN)) {
    a->first = true;
    a->phase = avr->cycle;
  }
  if (value & ADEN && value & ADSC && !a->running) start_single(a);
  if (avr->data[address] & ADIF && value & ADIE)
    request(a->c, a->done);
  else if (!(value & ADIE))
    withdraw(a->c, a->done);
  look_at_trigger(a->c);
}

static void write_trigger(avr_t* avr, avr_io_addr_t address, uint8_t value, void* param) {
  avr->data[address] = value;
  look_at_trigger(((adc*)param)->c);
}

static void on_accept(struct avr_irq_t* irq, uint32_t running, void* param) {
  (void)irq;
  if (running) ((adc*)param)->c->avr->data[ADCSRA] &= (uint8_t)~ADIF;
}

void adc_attach(chip* c) {
  adc* a = &c->analog;
  a->c = c;
  a->done = vector_of(c, 29);
  avr_irq_register_notify(a->done->irq + AVR_INT_IRQ_RUNNING, on_accept, a);
  c->avr->io[AVR_DATA_TO_IO(ADMUX)].w.c = 0;
  hook(c, ADCL, read_result, 0, a);
  hook(c, ADCH, read_result, 0, a);
  hook(c, ADCSRA, 0, write_control, a);
  hook(c, ADCSRB, 0, write_trigger, a);
}

void adc_reset(chip* c) {
  adc* a = &c->analog;
  a->running = a->first = false;
  a->result = 0;
}

void bridge_analog(chip* c, const double* start, const double* end, uint64_t from, uint64_t to) {
  adc* a = &c->analog;
  a->before = a->now;
  memcpy(a->now.start, start, sizeof a->now.start);
  memcpy(a->now.end, end, sizeof a->now.end);
  a->now.from = from;
  a->now.to = to;
}

void bridge_noise(chip* c, uint64_t seed, const double* sigma) {
  c->analog.seed = seed;
  memcpy(c->analog.sigma, sigma, sizeof c->analog.sigma);
}

void bridge_trace_feed(chip* c, const uint16_t* table, uint64_t first, uint64_t ticks) {
  adc* a = &c->analog;
  free(a->feed);
  a->feed = 0;
  if (!ticks) return;
  const size_t size = ticks * BRIDGE_CHANNELS * sizeof *table;
  a->feed = malloc(size);
  memcpy(a->feed, table, size);
  a->feed_first = first;
  a->feed_ticks = ticks;
}

void bridge_trace_record(chip* c, int on) { c->analog.recording = on; }
uint32_t bridge_trace_read(chip* c, bridge_conversion* out, uint32_t room) {
  adc* a = &c->analog;
  const uint32_t count = a->trace_count < room ? a->trace_count : room;
  memcpy(out, a->trace, count * sizeof *out);
  memmove(a->trace, a->trace + count, (a->trace_count - count) * sizeof *out);
  a->trace_count -= count;
  return count;
}
