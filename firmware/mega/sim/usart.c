// USART0 and the wire to it (data sheet 22): exact bit rate and frame length, double-buffered
// transmitter, receiver of two bytes plus shift register with overrun, polled or by interrupts.
//
// libsimavr 1.6 counts 11 bits for 8N1, keeps a stale rate when UBRR is set before U2X, and hides
// overruns behind a 64-byte queue.
#include <string.h>

#include "chip.h"

enum { UCSRA = 0xC0, UCSRB = 0xC1, UCSRC = 0xC2, UBRRL = 0xC4, UBRRH = 0xC5, UDR = 0xC6 };
enum { RXC = 0x80, TXC = 0x40, UDRE = 0x20, FE = 0x10, DOR = 0x08, U2X = 0x02 };
enum { RXCIE = 0x80, TXCIE = 0x40, UDRIE = 0x20, RXEN = 0x10, TXEN = 0x08 };

static uint32_t bit_cycles(const usart* u) {
  const uint8_t* d = u->c->avr->data;
  return ((d[UBRRL] | (d[UBRRH] & 15) << 8) + 1u) * (d[UCSRA] & U2X ? 8 : 16);
}
static uint32_t frame_bits(const usart* u) {
  const uint8_t* d = u->c->avr->data;
  const uint32_t data = d[UCSRB] & 4 ? 9 : 5 + (d[UCSRC] >> 1 & 3);
  return 1 + data + (d[UCSRC] & 0x20 ? 1 : 0) + (d[UCSRC] & 8 ? 2 : 1);
}
static double host_bit(const usart* u) {
  return u->host_baud ? (double)BRIDGE_HZ / u->host_baud : (double)bit_cycles(u);
}

// What a receiver sampling with `receiver_bit` cycles a bit reads of a byte sent with `sender_bit`
// cycles a bit (8N1, line idle afterwards). *bad: no stop bit where it should be.
static uint8_t resample(uint8_t byte, double sender_bit, double receiver_bit, bool* bad) {
  const uint32_t sent = 0xFFFFFE00u | (uint32_t)byte << 1;  // start bit 0, data, stop and idle 1
  uint8_t value = 0;
  for (int i = 0; i < 8; i++) {
    const double bit = (1.5 + i) * receiver_bit / sender_bit;
    if (bit >= 31 || sent >> (int)bit & 1) value |= (uint8_t)(1 << i);
  }
  const double stop = 9.5 * receiver_bit / sender_bit;
  *bad = stop < 31 && !(sent >> (int)stop & 1);
  return value;
}

// --- transmitter ---------------------------------------------------------------------------------
static avr_cycle_count_t sent_frame(avr_t* avr, avr_cycle_count_t when, void* param);

static void follow(chip* c, avr_int_vector_t* vector, bool flag) {
  if (flag)
    request(c, vector);
  else
    withdraw(c, vector);
}

static void update_flags(usart* u) {
  follow(u->c, u->received, u->depth > 0);
  follow(u->c, u->empty, !u->waiting);
  uint8_t* a = u->c->avr->data + UCSRA;
  *a &= (uint8_t)~(RXC | UDRE | FE | DOR);
  if (u->depth) *a |= RXC;
  if (u->depth && u->fifo_bad[0]) *a |= FE;
  if (u->overrun_flag) *a |= DOR;
  if (!u->waiting) *a |= UDRE;
}

static void start_sending(usart* u, uint8_t byte) {
  u->sending = true;
  u->sending_byte = byte;
  avr_cycle_timer_register(u->c->avr, (cycles)bit_cycles(u) * frame_bits(u), sent_frame, u);
}

static avr_cycle_count_t sent_frame(avr_t* avr, avr_cycle_count_t when, void* param) {
  usart* u = param;
  bool bad;
  const double sender_bit = bit_cycles(u), receiver_bit = host_bit(u);
  const uint8_t byte = sender_bit == receiver_bit
                           ? u->sending_byte
                           : resample(u->sending_byte, sender_bit, receiver_bit, &bad);
  if (u->out_write - u->out_read < LINE_ROOM) {
    u->out[u->out_write % LINE_ROOM] = byte;
    u->out_cycle[u->out_write++ % LINE_ROOM] = when;
  }
  u->sending = false;
  if (u->waiting) {
    u->waiting = false;
    u->sending = true;
    u->sending_byte = u->waiting_byte;
    update_flags(u);
    return when + (cycles)bit_cycles(u) * frame_bits(u);
  }
  avr->data[UCSRA] |= TXC;
  if (avr->data[UCSRB] & TXCIE) request(u->c, u->sent);
  return 0;
}

// --- receiver ------------------------------------------------------------------------------------
static avr_cycle_count_t received_frame(avr_t* avr, avr_cycle_count_t when, void* param);

static cycles frame_cycles(const usart* u) {
  const double wire = host_bit(u) * 10, board = (double)bit_cycles(u) * frame_bits(u);
  return (cycles)(wire > board ? wire : board);
}

// A start bit while buffer and shift register are full loses what the register holds.
static void begin_frame(usart* u) {
  if (u->shift_full) {
    u->shift_full = false;
    u->overrun_flag = true;
    u->overruns++;
    update_flags(u);
  }
  const double sender_bit = host_bit(u), receiver_bit = bit_cycles(u);
  u->frame_bad = false;
  u->frame_byte = u->in[u->in_read++ % LINE_ROOM];
  if (sender_bit > receiver_bit * 1.04 || sender_bit < receiver_bit * 0.96)
    u->frame_byte = resample(u->frame_byte, sender_bit, receiver_bit, &u->frame_bad);
  u->frame_running = true;
}

static avr_cycle_count_t received_frame(avr_t* avr, avr_cycle_count_t when, void* param) {
  usart* u = param;
  u->frame_running = false;
  if (avr->data[UCSRB] & RXEN) {
    if (u->depth < 2) {
      u->fifo_bad[u->depth] = u->frame_bad;
      u->fifo[u->depth++] = u->frame_byte;
    } else {
      u->shift = u->frame_byte;
      u->shift_bad = u->frame_bad;
      u->shift_full = true;
    }
    update_flags(u);
  }
  if (u->in_read == u->in_write) return 0;
  begin_frame(u);
  return when + frame_cycles(u);
}

// --- registers -----------------------------------------------------------------------------------
static uint8_t read_data(avr_t* avr, avr_io_addr_t address, void* param) {
  (void)address;
  usart* u = param;
  if (!(avr->data[UCSRB] & RXEN)) return 0;
  const uint8_t value = u->fifo[0];
  if (u->depth) {
    u->fifo[0] = u->fifo[1];
    u->fifo_bad[0] = u->fifo_bad[1];
    u->depth--;
    if (u->shift_full) {
      u->fifo_bad[u->depth] = u->shift_bad;
      u->fifo[u->depth++] = u->shift;
      u->shift_full = false;
    }
    u->overrun_flag = false;
    update_flags(u);
  }
  return value;
}

static void write_data(avr_t* avr, avr_io_addr_t address, uint8_t value, void* param) {
  (void)address;
  usart* u = param;
  if (!(avr->data[UCSRB] & TXEN)) return;
  if (!u->sending) {
    start_sending(u, value);
  } else if (!u->waiting) {
    u->waiting = true;
    u->waiting_byte = value;
  }
  update_flags(u);
}

static uint8_t read_status(avr_t* avr, avr_io_addr_t address, void* param) {
  (void)param;
  return avr->data[address];
}

static void write_status(avr_t* avr, avr_io_addr_t address, uint8_t value, void* param) {
  usart* u = param;
  uint8_t kept = avr->data[address] & (uint8_t)~(U2X | 1);
  if (value & TXC) {
    kept &= (uint8_t)~TXC;
    withdraw(u->c, u->sent);
  }
  avr->data[address] = kept | (value & (U2X | 1));
}

static void write_control(avr_t* avr, avr_io_addr_t address, uint8_t value, void* param) {
  usart* u = param;
  const uint8_t before = avr->data[address];
  avr->data[address] = value;
  if (before & RXEN && !(value & RXEN)) {
    u->depth = 0;
    u->shift_full = u->overrun_flag = false;
  }
  if (value & TXCIE && avr->data[UCSRA] & TXC)
    request(u->c, u->sent);
  else if (!(value & TXCIE))
    withdraw(u->c, u->sent);
  update_flags(u);
}

// RXC and UDRE are levels: the request stands as long as the flag does.
static void on_return(struct avr_irq_t* irq, uint32_t running, void* param) {
  (void)irq;
  if (!running) update_flags(param);
}
static void on_sent_accept(struct avr_irq_t* irq, uint32_t running, void* param) {
  (void)irq;
  usart* u = param;
  if (running) u->c->avr->data[UCSRA] &= (uint8_t)~TXC;
}

void usart_attach(chip* c) {
  usart* u = &c->line;
  u->c = c;
  u->received = vector_of(c, 25);
  u->empty = vector_of(c, 26);
  u->sent = vector_of(c, 27);
  avr_irq_register_notify(u->received->irq + AVR_INT_IRQ_RUNNING, on_return, u);
  avr_irq_register_notify(u->empty->irq + AVR_INT_IRQ_RUNNING, on_return, u);
  avr_irq_register_notify(u->sent->irq + AVR_INT_IRQ_RUNNING, on_sent_accept, u);
  static const uint16_t kRate[] = {UCSRC, UBRRL, UBRRH};
  for (int i = 0; i < 3; i++) c->avr->io[AVR_DATA_TO_IO(kRate[i])].w.c = 0;
  hook(c, UDR, read_data, write_data, u);
  hook(c, UCSRA, read_status, write_status, u);
  hook(c, UCSRB, 0, write_control, u);
}

void usart_reset(chip* c) {
  usart* u = &c->line;
  u->depth = 0;
  u->shift_full = u->overrun_flag = u->sending = u->waiting = false;
  uint8_t* d = c->avr->data;
  d[UCSRA] = UDRE;
  d[UCSRB] = 0;
  d[UCSRC] = 6;
  if (u->frame_running)  // the wire does not know that the chip was reset
    avr_cycle_timer_register(c->avr, frame_cycles(u), received_frame, u);
}

void bridge_line_baud(chip* c, uint32_t baud) { c->line.host_baud = baud; }

uint32_t bridge_line_send(chip* c, const uint8_t* bytes, uint32_t count) {
  usart* u = &c->line;
  uint32_t i = 0;
  for (; i < count && u->in_write - u->in_read < LINE_ROOM; i++)
    u->in[u->in_write++ % LINE_ROOM] = bytes[i];
  if (i && !u->frame_running) {
    begin_frame(u);
    avr_cycle_timer_register(c->avr, frame_cycles(u), received_frame, u);
  }
  return i;
}

uint32_t bridge_line_take(chip* c, uint8_t* bytes, uint64_t* when, uint32_t room) {
  usart* u = &c->line;
  uint32_t i = 0;
  for (; i < room && u->out_read != u->out_write; i++, u->out_read++) {
    bytes[i] = u->out[u->out_read % LINE_ROOM];
    when[i] = u->out_cycle[u->out_read % LINE_ROOM];
  }
  return i;
}

uint32_t bridge_line_backlog(chip* c) {
  return c->line.in_write - c->line.in_read + (c->line.frame_running ? 1 : 0);
}
uint64_t bridge_line_overruns(chip* c) { return c->line.overruns; }
void bridge_line_clear(chip* c) {
  c->line.in_read = c->line.in_write;
  c->line.out_read = c->line.out_write;
}
uint32_t bridge_line_cycles(chip* c) {
  const usart* u = &c->line;
  return c->avr->data[UCSRB] & (RXEN | TXEN) ? bit_cycles(u) * frame_bits(u) : 0;
}
