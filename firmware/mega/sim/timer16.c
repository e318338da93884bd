// The chip's 16-bit timers 1, 3, 4 and 5 (data sheet 17): exact counts, compare and overflow flags,
// TEMP register, CTC, fast and phase-correct PWM, output modes.
//
// Flags are derived from the cycle count when something looks, so a timer that only makes PWM costs
// nothing to simulate, and libsimavr's floating-point periods and its missing edges of
// phase-correct PWM do not matter: duties are read from the registers (bridge_pwm_read). Compare
// registers take effect at once, in PWM modes too (the chip waits for the period's end there).
#include "chip.h"

enum { CR_A = 0, CR_B = 1, COUNT = 4, CAPTURE = 6, COMPARE = 8 };  // offsets from TCCRnA
static const uint16_t kBase[4] = {0x80, 0x90, 0xA0, 0x120};
static const uint16_t kFlags[4] = {0x36, 0x38, 0x39, 0x3A};
static const uint16_t kMasks[4] = {0x6F, 0x71, 0x72, 0x73};
static const uint8_t kVector[4] = {17, 32, 42, 47};  // compare A; B, C and overflow follow
static const uint8_t kFlagBit[TIMER_EVENTS] = {1, 2, 3, 0};

static unsigned mode(const timer16* t) {
  const uint8_t* d = t->c->avr->data + t->base;
  return (d[CR_A] & 3) | (d[CR_B] >> 1 & 0xC);
}
static bool dual_slope(unsigned m) { return (m >= 1 && m <= 3) || (m >= 8 && m <= 11); }
static bool clears_on_top(unsigned m) { return m == 4 || m == 12; }
static uint32_t top(const timer16* t) {
  switch (mode(t)) {
    case 1:
    case 5:
      return 0xFF;
    case 2:
    case 6:
      return 0x1FF;
    case 3:
    case 7:
      return 0x3FF;
    case 4:
    case 9:
    case 11:
    case 15:
      return t->compare[0];
    case 8:
    case 10:
    case 12:
    case 14:
      return t->capture;
    default:
      return 0xFFFF;
  }
}
static uint32_t period(const timer16* t) {  // in timer clocks
  const uint32_t last = top(t);
  return dual_slope(mode(t)) ? (last ? 2 * last : 1) : last + 1;
}

// First match of an event after a cycle; NEVER if there is none.
static cycles next_match(const timer16* t, int event, cycles after) {
  if (!t->prescale) return NEVER;
  const unsigned m = mode(t);
  const uint32_t last = top(t), round = period(t);
  uint32_t place[2], places = 1;
  if (event == TIMER_OVERFLOW) {
    if (clears_on_top(m)) return NEVER;  // it never reaches MAX
    place[0] = round;
  } else {
    if (t->compare[event] > last) return NEVER;
    place[0] = t->compare[event] + 1u;
    if (dual_slope(m)) place[places++] = round - t->compare[event] + 1;
  }
  const cycles length = (cycles)round * t->prescale;
  const cycles start = after < t->zero ? t->zero : t->zero + (after - t->zero) / length * length;
  cycles best = NEVER;
  for (uint32_t i = 0; i < places; i++) {
    const cycles offset = (cycles)(place[i] % round) * t->prescale;
    for (cycles base = start; base <= start + length; base += length) {
      const cycles match = base + offset;
      if (match > after && match > t->zero && match < best) best = match;
    }
  }
  return best;
}

static bool flag(const timer16* t, int event, cycles now) {
  return (t->latched >> event & 1) || next_match(t, event, t->cleared[event]) <= now;
}

static bool masked_in(const timer16* t, int event) {
  return t->c->avr->data[t->masks] >> kFlagBit[event] & 1;
}
static bool triggers_adc(const timer16* t, int event) {
  return event == TIMER_B && t == &t->c->timer[0] && adc_listens(t->c);
}

static avr_cycle_count_t on_match(avr_t* avr, avr_cycle_count_t when, void* param);

static cycles next_event(const timer16* t, cycles after) {
  cycles best = NEVER;
  for (int e = 0; e < TIMER_EVENTS; e++)
    if (masked_in(t, e) || triggers_adc(t, e)) {
      const cycles match = next_match(t, e, after);
      if (match < best) best = match;
    }
  return best;
}

static void schedule(timer16* t) {
  avr_t* avr = t->c->avr;
  const cycles match = next_event(t, avr->cycle);
  if (match == NEVER)
    avr_cycle_timer_cancel(avr, on_match, t);
  else
    avr_cycle_timer_register(avr, match - avr->cycle, on_match, t);
}

static avr_cycle_count_t on_match(avr_t* avr, avr_cycle_count_t when, void* param) {
  timer16* t = param;
  (void)avr;
  for (int e = 0; e < TIMER_EVENTS; e++) {
    if (next_match(t, e, when - 1) != when) continue;
    if (triggers_adc(t, e)) {
      if (flag(t, e, when - 1))  // only a rising flag triggers
        t->c->analog.lost_triggers++;
      else
        adc_trigger(t->c, when);
    }
    if (masked_in(t, e)) request(t->c, t->vector[e]);
  }
  const cycles next = next_event(t, when);
  return next == NEVER ? 0 : next;
}

// Fix what the flags are before clock, top, count or a compare value changes.
static void settle(timer16* t) {
  const cycles now = t->c->avr->cycle;
  for (int e = 0; e < TIMER_EVENTS; e++) {
    if (flag(t, e, now)) t->latched |= 1 << e;
    t->cleared[e] = now;
  }
}

static void clear_flag(timer16* t, int event) {
  t->latched &= (uint8_t)~(1 << event);
  t->cleared[event] = t->c->avr->cycle;
  withdraw(t->c, t->vector[event]);
}

static uint16_t count(const timer16* t) {
  if (!t->prescale) return t->held;
  const uint32_t round = period(t);
  const cycles now = t->c->avr->cycle;
  const uint32_t place = now < t->zero ? 0 : (uint32_t)((now - t->zero) / t->prescale % round);
  return (uint16_t)(dual_slope(mode(t)) && place > top(t) ? round - place : place);
}

static void set_count(timer16* t, uint16_t value) {
  const cycles now = t->c->avr->cycle;
  t->held = value;
  const cycles back = (cycles)value * t->prescale;
  t->zero = now > back ? now - back : 0;
  if (t == &t->c->timer[0] && t->prescale)
    t->c->tick_origin = value ? t->zero + (cycles)period(t) * t->prescale : t->zero;
}

static void write_control(avr_t* avr, avr_io_addr_t address, uint8_t value, void* param) {
  timer16* t = param;
  static const uint16_t kPrescale[8] = {0, 1, 8, 64, 256, 1024, 0, 0};
  settle(t);
  const uint16_t counter = count(t);
  avr->data[address] = value;
  t->prescale = kPrescale[avr->data[t->base + CR_B] & 7];
  set_count(t, counter);
  schedule(t);
}

static uint8_t read_high(avr_t* avr, avr_io_addr_t address, void* param) {
  (void)avr, (void)address;
  return ((timer16*)param)->high;
}
static void write_high(avr_t* avr, avr_io_addr_t address, uint8_t value, void* param) {
  (void)avr, (void)address;
  ((timer16*)param)->high = value;
}

static uint8_t read_count(avr_t* avr, avr_io_addr_t address, void* param) {
  (void)avr, (void)address;
  timer16* t = param;
  const uint16_t value = count(t);
  t->high = value >> 8;
  return (uint8_t)value;
}
static void write_count(avr_t* avr, avr_io_addr_t address, uint8_t value, void* param) {
  (void)avr, (void)address;
  timer16* t = param;
  settle(t);
  set_count(t, (uint16_t)(t->high << 8 | value));
  schedule(t);
}

// OCRnx and ICRn: only TCNT and ICR go through TEMP when read.
static uint16_t* compare_or_capture(timer16* t, avr_io_addr_t address) {
  const int offset = address - t->base;
  return offset < COMPARE ? &t->capture : &t->compare[(offset - COMPARE) / 2];
}
static void write_compare(avr_t* avr, avr_io_addr_t address, uint8_t value, void* param) {
  (void)avr;
  timer16* t = param;
  settle(t);
  const uint16_t counter = count(t);
  const uint32_t before = top(t);
  *compare_or_capture(t, address) = (uint16_t)(t->high << 8 | value);
  if (top(t) != before && t->prescale) set_count(t, counter);
  schedule(t);
}
static uint8_t read_compare_low(avr_t* avr, avr_io_addr_t address, void* param) {
  (void)avr;
  return (uint8_t)*compare_or_capture(param, address);
}
static uint8_t read_compare_high(avr_t* avr, avr_io_addr_t address, void* param) {
  (void)avr;
  return (uint8_t)(*compare_or_capture(param, (avr_io_addr_t)(address - 1)) >> 8);
}

static uint8_t read_flags(avr_t* avr, avr_io_addr_t address, void* param) {
  (void)address;
  timer16* t = param;
  uint8_t value = 0;
  for (int e = 0; e < TIMER_EVENTS; e++)
    if (flag(t, e, avr->cycle)) value |= 1 << kFlagBit[e];
  return value;
}
static void write_flags(avr_t* avr, avr_io_addr_t address, uint8_t value, void* param) {
  (void)avr, (void)address;
  timer16* t = param;
  for (int e = 0; e < TIMER_EVENTS; e++)
    if (value >> kFlagBit[e] & 1) clear_flag(t, e);
}

static void write_masks(avr_t* avr, avr_io_addr_t address, uint8_t value, void* param) {
  timer16* t = param;
  avr->data[address] = value;
  for (int e = 0; e < TIMER_EVENTS; e++) {
    if (!masked_in(t, e))
      withdraw(t->c, t->vector[e]);
    else if (flag(t, e, avr->cycle))
      request(t->c, t->vector[e]);
  }
  schedule(t);
}

// Acceptance clears the flag.
static void on_accept(struct avr_irq_t* irq, uint32_t running, void* param) {
  if (!running) return;
  timer16* t = param;
  for (int e = 0; e < TIMER_EVENTS; e++)
    if (t->vector[e]->irq + AVR_INT_IRQ_RUNNING == irq) {
      t->latched &= (uint8_t)~(1 << e);
      t->cleared[e] = t->c->avr->cycle;
    }
}

void timer16_attach(chip* c) {
  for (int n = 0; n < 4; n++) {
    timer16* t = &c->timer[n];
    t->c = c;
    t->base = kBase[n];
    t->flags = kFlags[n];
    t->masks = kMasks[n];
    for (int e = 0; e < TIMER_EVENTS; e++) {
      t->vector[e] = vector_of(c, kVector[n] + e);
      avr_irq_register_notify(t->vector[e]->irq + AVR_INT_IRQ_RUNNING, on_accept, t);
    }
    hook(c, t->base + CR_A, 0, write_control, t);
    hook(c, t->base + CR_B, 0, write_control, t);
    hook(c, t->base + COUNT, read_count, write_count, t);
    hook(c, t->base + COUNT + 1, read_high, write_high, t);
    hook(c, t->base + CAPTURE, read_compare_low, write_compare, t);
    hook(c, t->base + CAPTURE + 1, read_compare_high, write_high, t);
    for (int x = 0; x < 3; x++) {
      hook(c, (uint16_t)(t->base + COMPARE + 2 * x), read_compare_low, write_compare, t);
      hook(c, (uint16_t)(t->base + COMPARE + 2 * x + 1), read_compare_high, write_high, t);
    }
    hook(c, t->flags, read_flags, write_flags, t);
    hook(c, t->masks, 0, write_masks, t);
  }
}

void timer16_reset(chip* c) {
  for (int n = 0; n < 4; n++) {
    timer16* t = &c->timer[n];
    t->compare[0] = t->compare[1] = t->compare[2] = t->capture = 0;
    t->high = 0;
    t->held = 0;
    t->prescale = 0;
    t->zero = c->avr->cycle;
    t->latched = 0;
    for (int e = 0; e < TIMER_EVENTS; e++) t->cleared[e] = c->avr->cycle;
  }
  c->tick_origin = 0;
}

void bridge_pwm_read(chip* c, int number, bridge_pwm* out) {
  const timer16* t = &c->timer[number == 1 ? 0 : number - 2];
  const uint8_t control = c->avr->data[t->base + CR_A];
  *out = (bridge_pwm){.top = t->prescale ? (uint16_t)top(t) : 0,
                      .period = t->prescale ? period(t) * t->prescale : 0};
  for (int x = 0; x < 3; x++) {
    const int output = control >> (6 - 2 * x) & 3;
    out->connected[x] = output >= 2;
    out->inverted[x] = output == 3;
    out->compare[x] = t->compare[x];
  }
}
