// What runs first after every reset: a look at whether the whole image is there.
//
// An upload that is cut leaves new pages before old ones, and a program of two halves may do
// anything with the outputs. So the reset vector leads here, right behind the vectors, at the start
// of page 1 (an erased page 0 runs on into it, too): outputs off, watchdog on, then the check. Only
// a whole image starts. What is not whole stays here, its outputs off, until the next upload.
//
// Registers only, and nothing is called: RAM keeps the record of the last run (restart.h), and of
// the flash nothing but this page has to be right. Why the chip started is handed on in GPIOR2.
//
// Two ways to know the whole:
// - The Makefile puts a CRC-32 over the watchdog's entry and the program behind the latter
//   (seal.py): what was erased, half written or left by another image changes it. Its polynomial is
//   0xAF, that of CRC-32/XFER: primitive, and short enough for 36 cycles a byte without a table.
// - The Arduino IDE cannot. There the image's last bytes must be the time of compilation that this
//   page carries: pages are written in rising order, so with them all others are there as well.
#ifndef THIGMO_MEGA_GUARD_H_
#define THIGMO_MEGA_GUARD_H_

#include <avr/io.h>
#include <avr/wdt.h>

#include "pins.h"

// Overrides the C library's start, which jumps over it straight to .init0. The page is 256 bytes.
extern "C" void __init()
    __attribute__((naked, used, externally_visible, section(".vectors"), aligned(256)));
extern "C" void __init() {
  __asm__ volatile(
      // Outputs off, whatever ran before: timers let go of their pins, and those are driven low.
      "cli\n\t"
      "clr r1\n\t"
      "sts %[motor_timer], r1\n\t"
      "sts %[drive_timer], r1\n\t"
      "sts %[port_h], r1\n\t"
      "sts %[port_l], r1\n\t"
      "out %[port_a], r1\n\t"
      "ldi r24, %[motor_pins]\n\t"
      "sts %[ddr_h], r24\n\t"
      "ldi r24, %[drive_pins]\n\t"
      "sts %[ddr_l], r24\n\t"
      "ldi r24, %[air_pins]\n\t"
      "out %[ddr_a], r24\n\t"
      // The cause, for restart.h: MCUSR has to be cleared before the watchdog obeys.
      "in r24, %[mcusr]\n\t"
      "in r25, %[kept_cause]\n\t"
      "or r25, r24\n\t"
      "out %[kept_cause], r25\n\t"
      "out %[mcusr], r1\n\t"
      // The watchdog, until MegaBoard::start() sets it again.
      "wdr\n\t"
      "ldi r24, %[unlock]\n\t"
      "ldi r25, %[watchdog]\n\t"
      "sts %[wdtcsr], r24\n\t"
      "sts %[wdtcsr], r25\n\t"
#ifdef THIGMO_SEALED
      // CRC in r27:r26:r25:r24, place in RAMPZ:Z, end of the segment in r20:r19:r18. First segment:
      // the watchdog's entry. t is the CRC's high byte with the next byte of flash; the rest of the
      // CRC moves up by a byte and takes in t * 0xAF, without carries: with b = t * (x^2 + 1) that
      // is b ^ (b ^ b << 4) << 1.
      "ldi r24, 0xff\n\t"
      "ldi r25, 0xff\n\t"
      "movw r26, r24\n\t"
      "ldi r18, lo8(thigmo_watchdog_entry_end)\n\t"
      "ldi r19, hi8(thigmo_watchdog_entry_end)\n\t"
      "ldi r20, hh8(thigmo_watchdog_entry_end)\n\t"
      "clr r30\n\t"
      "clr r31\n\t"
      "out %[rampz], r20\n"
      "1:\twdr\n\t"
      "elpm r0, Z+\n\t"
      "eor r27, r0\n\t"  // t
      "mov r22, r27\n\t"
      "clr r23\n\t"
      "lsl r22\n\t"
      "rol r23\n\t"
      "lsl r22\n\t"
      "rol r23\n\t"
      "eor r22, r27\n\t"  // b in r23:r22
      "mov r16, r22\n\t"
      "swap r16\n\t"
      "mov r17, r16\n\t"
      "andi r16, 0x0f\n\t"
      "andi r17, 0xf0\n\t"
      "mov r0, r23\n\t"
      "swap r0\n\t"
      "or r16, r0\n\t"  // b << 4 in r16:r17
      "eor r17, r22\n\t"
      "eor r16, r23\n\t"
      "lsl r17\n\t"
      "rol r16\n\t"
      "eor r22, r17\n\t"
      "eor r23, r16\n\t"  // t * 0xAF in r23:r22
      "mov r27, r26\n\t"
      "mov r26, r25\n\t"
      "eor r23, r24\n\t"
      "movw r24, r22\n\t"
      "in r16, %[rampz]\n\t"
      "cp r30, r18\n\t"
      "cpc r31, r19\n\t"
      "cpc r16, r20\n\t"
      "brne 1b\n\t"
      // Second segment: the program from 0, its data's initial values, and the CRC itself.
      "ldi r18, lo8(__data_load_end + 4)\n\t"
      "ldi r19, hi8(__data_load_end + 4)\n\t"
      "ldi r21, hh8(__data_load_end + 4)\n\t"
      "cpse r20, r21\n\t"
      "rjmp 2f\n\t"
      "or r24, r25\n\t"
      "or r24, r26\n\t"
      "or r24, r27\n\t"
      "breq 4f\n\t"
      "rjmp 3f\n"
      "2:\tmov r20, r21\n\t"
      "clr r30\n\t"
      "clr r31\n\t"
      "out %[rampz], r1\n\t"
      "rjmp 1b\n"
#else
      // X walks over the stamp of this page, RAMPZ:Z over the image's last bytes.
      "ldi r26, lo8(7f)\n\t"
      "ldi r27, hi8(7f)\n\t"
      "ldi r24, lo8(__data_load_end)\n\t"
      "ldi r25, hi8(__data_load_end)\n\t"
      "ldi r20, hh8(__data_load_end)\n\t"
      "sbiw r24, 8f - 7f\n\t"
      "sbc r20, r1\n\t"
      "ldi r18, lo8(thigmo_stamp)\n\t"  // keeps it in the image
      "ldi r18, 8f - 7f\n"
      "1:\twdr\n\t"
      "movw r30, r26\n\t"
      "lpm r22, Z+\n\t"
      "movw r26, r30\n\t"
      "movw r30, r24\n\t"
      "out %[rampz], r20\n\t"
      "elpm r23, Z+\n\t"
      "movw r24, r30\n\t"
      "in r20, %[rampz]\n\t"
      "cpse r22, r23\n\t"
      "rjmp 3f\n\t"
      "dec r18\n\t"
      "brne 1b\n\t"
      "rjmp 4f\n"
      "7:\t.ascii \"" __DATE__ " " __TIME__
      "\"\n"
      "8:\n\t"
      // The last that the linker puts into .data, and even, for nothing to be padded behind it.
      ".pushsection .gnu.linkonce.r.thigmo_stamp,\"aw\",@progbits\n\t"
      ".balign 2\n"
      "thigmo_stamp:\t.ascii \"" __DATE__ " " __TIME__
      "\"\n\t"
      ".popsection\n"
#endif
      // Not whole.
      "3:\twdr\n\t"
      "rjmp 3b\n"
      // Whole.
      "4:\tout %[rampz], r1\n\t"
      "jmp thigmo_start\n\t"
      ".pushsection .init0,\"ax\",@progbits\n"
      "thigmo_start:\n\t"
      ".popsection"
      :
      : [motor_timer] "n"(_SFR_MEM_ADDR(TCCR4A)), [drive_timer] "n"(_SFR_MEM_ADDR(TCCR5A)),
        [port_h] "n"(_SFR_MEM_ADDR(PORTH)), [ddr_h] "n"(_SFR_MEM_ADDR(DDRH)),
        [port_l] "n"(_SFR_MEM_ADDR(PORTL)), [ddr_l] "n"(_SFR_MEM_ADDR(DDRL)),
        [port_a] "I"(_SFR_IO_ADDR(PORTA)), [ddr_a] "I"(_SFR_IO_ADDR(DDRA)),
        [motor_pins] "M"(thigmo::mega::kMotorPwm | thigmo::mega::kMotorDirection),
        [drive_pins] "M"(thigmo::mega::kDriveLeft | thigmo::mega::kDriveRight),
        [air_pins] "M"(thigmo::mega::kMuscleAir | thigmo::mega::kBodyAir),
        [mcusr] "I"(_SFR_IO_ADDR(MCUSR)), [kept_cause] "I"(_SFR_IO_ADDR(GPIOR2)),
        [wdtcsr] "n"(_SFR_MEM_ADDR(WDTCSR)), [unlock] "M"(_BV(WDCE) | _BV(WDE)),
        [watchdog] "M"(_BV(WDE) | WDTO_250MS), [rampz] "I"(_SFR_IO_ADDR(RAMPZ)));
}

#endif  // THIGMO_MEGA_GUARD_H_
