// Watchdog, and why the chip last started.
//
// The boot loader clears MCUSR before it starts us. After a watchdog's reset it means to start us
// at once, by an indirect call to address 0; but EIND is 1 there, so the call ends at 0x20000. The
// linker puts thigmo_watchdog_entry() to that place: it hands over the MCUSR that the boot loader
// still holds, and starts the program, without the boot loader's second of waiting. (An empty flash
// there runs on into the boot loader, and what an older program left there, for an upload erases
// only what it writes, would be run.)
//
// All other causes, and a watchdog's under another boot loader, are derived from a record in RAM
// that no start-up code touches (.noinit): whether it survived, how long the main loop had been
// silent, and what the supply was. A stop and faults that an operator has not cleared are kept
// there as well. .noinit lies behind .data and .bss, hence above the boot loader's variables
// (0x200..0x20D) and far below its stack (the top 400 bytes); tests/sim checks both.
//
// The watchdog runs in pure reset mode: its interrupt would need interrupts, and those may be what
// hangs.
#ifndef THIGMO_MEGA_RESTART_H_
#define THIGMO_MEGA_RESTART_H_

#include <avr/io.h>
#include <avr/wdt.h>

#include "../core/board.h"

namespace thigmo {
namespace mega {

// Left for the next start.
struct RestartRecord {
  uint32_t magic;
  volatile uint16_t silent_ms;  // since the main loop last kicked the watchdog
  volatile uint8_t supply_low;  // at the last look
  uint8_t mcusr;                // of this start, before it was cleared; the entry's included
  LatchRecord latches;
};
RestartRecord restart_record __attribute__((section(".noinit")));

class Restart {
 public:
  // First thing in setup(), before the watchdog or the tick runs.
  static void begin() {
    cause_ = judge();
    restart_record.magic = kMagic;
    restart_record.silent_ms = 0;
    restart_record.supply_low = 0;
    if (cause_ == protocol::ResetCause::kPowerOn) keep_latches(Latches{});
  }

  static Latches kept_latches() { return restart_record.latches.kept(); }
  static void keep_latches(const Latches& latches) { restart_record.latches.keep(latches); }

  static protocol::ResetCause cause() { return cause_; }

  static void guard() { wdt_enable(WDTO_250MS); }
  static void kick() {
    wdt_reset();
    restart_record.silent_ms = 0;
  }
  static void note_supply(bool low) { restart_record.supply_low = low; }

  // Interrupt routine of the tick.
  static inline void on_tick() { restart_record.silent_ms = restart_record.silent_ms + 1; }

 private:
  static constexpr uint32_t kMagic = 0x7468676D;  // "thgm"
  static constexpr uint16_t kSilent = 180;        // of the watchdog's 250 ms (its clock is +-10 %)

  static protocol::ResetCause judge() {
    const uint8_t flags = restart_record.mcusr;
    if ((flags & _BV(PORF)) != 0) return protocol::ResetCause::kPowerOn;
    if ((flags & _BV(WDRF)) != 0) return protocol::ResetCause::kWatchdog;
    if ((flags & _BV(BORF)) != 0) return protocol::ResetCause::kBrownOut;
    if (restart_record.magic != kMagic) return protocol::ResetCause::kPowerOn;
    if (restart_record.supply_low != 0) return protocol::ResetCause::kBrownOut;
    if (restart_record.silent_ms >= kSilent) return protocol::ResetCause::kWatchdog;
    return protocol::ResetCause::kExternal;
  }

  static protocol::ResetCause cause_;
};

protocol::ResetCause Restart::cause_;

}  // namespace mega
}  // namespace thigmo

// Where the boot loader goes after a watchdog's reset, its copy of MCUSR in r25 (stk500boot.c of
// 2011, the one that Arduino ships: `sbrs r25, 3` decides for the call). GPIOR2 is 0 after any
// reset. The Makefile tells the linker the place (with the Arduino IDE: README.md).
extern "C" void thigmo_watchdog_entry()
    __attribute__((naked, used, externally_visible, section(".watchdog_entry")));
extern "C" void thigmo_watchdog_entry() {
  __asm__ volatile(
      "out %0, r25\n\tjmp 0\n"
      ".global thigmo_watchdog_entry_end\nthigmo_watchdog_entry_end:"
      :
      : "I"(_SFR_IO_ADDR(GPIOR2)));
}

// Before any constructor; the guard handed the cause on, and its watchdog runs.
extern "C" void thigmo_first_instructions() __attribute__((naked, used, section(".init3")));
extern "C" void thigmo_first_instructions() {
  thigmo::mega::restart_record.mcusr = GPIOR2;
  GPIOR2 = 0;
}

#endif  // THIGMO_MEGA_RESTART_H_
