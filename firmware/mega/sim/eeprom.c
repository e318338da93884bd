// The EEPROM (data sheet 8.4): the four-cycle write enable, 3.4 ms a byte during which EEPE reads
// 1, the ready interrupt, and power that may fail in the middle of a write.
//
// In libsimavr 1.6 a write takes no time.
#include <string.h>

#include "chip.h"

enum { EECR = 0x3F, EEDR = 0x40, EEARL = 0x41, EEARH = 0x42 };
enum { EERE = 1, EEPE = 2, EEMPE = 4, EERIE = 8, MODE = 0x30 };
enum { kWriteCycles = 54400, kHalfWriteCycles = 28800 };  // 3.4 ms; erase or write only 1.8 ms

static avr_cycle_count_t window_over(avr_t* avr, avr_cycle_count_t when, void* param) {
  (void)when;
  eeprom* e = param;
  e->enabled = false;
  avr->data[EECR] &= (uint8_t)~EEMPE;
  return 0;
}

static void follow(eeprom* e) {
  if (!e->busy && e->c->avr->data[EECR] & EERIE)
    request(e->c, e->ready);
  else
    withdraw(e->c, e->ready);
}

static avr_cycle_count_t written(avr_t* avr, avr_cycle_count_t when, void* param) {
  (void)when;
  eeprom* e = param;
  uint8_t* cell = &e->store->eeprom[e->address];
  switch (avr->data[EECR] & MODE) {
    case 0x10:
      *cell = 0xFF;
      break;
    case 0x20:
      *cell &= e->value;
      break;
    default:
      *cell = e->value;
  }
  e->busy = false;
  avr->data[EECR] &= (uint8_t)~EEPE;
  follow(e);
  return 0;
}

// The cell is between erase and write: some of its bits are already the new ones.
static avr_cycle_count_t torn(avr_t* avr, avr_cycle_count_t when, void* param) {
  (void)avr, (void)when;
  eeprom* e = param;
  const uint8_t set = (uint8_t)(0x5A ^ e->address * 0x35u);
  e->store->eeprom[e->address] = (uint8_t)(e->value | set);
  e->c->power_cut = true;
  return 0;
}

static void write_control(avr_t* avr, avr_io_addr_t address, uint8_t value, void* param) {
  (void)address;
  eeprom* e = param;
  const uint8_t kept = avr->data[EECR] & EEPE;
  const bool may = e->enabled;
  avr->data[EECR] = (uint8_t)((value & ~(EERE | EEPE)) | kept);
  if (value & EEMPE && !may) {
    e->enabled = true;
    avr_cycle_timer_register(avr, 6, window_over, e);  // four cycles after the write's own two
  }
  if (value & EEPE && may && !e->busy) {
    e->enabled = false;
    avr_cycle_timer_cancel(avr, window_over, e);
    avr->data[EECR] = (uint8_t)((avr->data[EECR] & ~EEMPE) | EEPE);
    e->address = (uint16_t)((avr->data[EEARL] | avr->data[EEARH] << 8) & 0xFFF);
    e->value = avr->data[EEDR];
    e->busy = true;
    const cycles takes = value & MODE ? kHalfWriteCycles : kWriteCycles;
    e->writes++;
    if (e->cut_after == 0)
      avr_cycle_timer_register(avr, takes / 2, torn, e);
    else
      avr_cycle_timer_register(avr, takes, written, e);
    if (e->cut_after >= 0) e->cut_after--;
    stall(e->c, 2);
  } else if (value & EERE && !e->busy) {
    avr->data[EEDR] = e->store->eeprom[(avr->data[EEARL] | avr->data[EEARH] << 8) & 0xFFF];
    stall(e->c, 4);
  }
  follow(e);
}

static void on_return(struct avr_irq_t* irq, uint32_t running, void* param) {
  (void)irq;
  if (!running) follow(param);
}

void eeprom_attach(chip* c) {
  eeprom* e = &c->eeprom;
  e->c = c;
  e->ready = vector_of(c, 30);
  for (avr_io_t* io = c->avr->io_port; io; io = io->next)
    if (io->kind && !strcmp(io->kind, "eeprom")) e->store = (avr_eeprom_t*)io;
  avr_irq_register_notify(e->ready->irq + AVR_INT_IRQ_RUNNING, on_return, e);
  hook(c, EECR, 0, write_control, e);
}

// A write that a reset meets goes on to its end on the chip's own oscillator.
void eeprom_reset(chip* c) {
  eeprom* e = &c->eeprom;
  e->enabled = false;
  if (e->busy && !c->power_cut) written(c->avr, c->avr->cycle, e);
  e->busy = false;
}

void bridge_eeprom_write(chip* c, uint32_t address, const uint8_t* bytes, uint32_t count) {
  memcpy(c->eeprom.store->eeprom + address, bytes, count);
}
void bridge_eeprom_read(chip* c, uint32_t address, uint8_t* bytes, uint32_t count) {
  memcpy(bytes, c->eeprom.store->eeprom + address, count);
}
void bridge_eeprom_cut(chip* c, int64_t writes) { c->eeprom.cut_after = writes; }
uint64_t bridge_eeprom_writes(chip* c) { return c->eeprom.writes; }
