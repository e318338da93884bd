// Tables of the core stay in flash. Include before anything of firmware/core.
#ifndef THIGMO_MEGA_PROGRAM_MEMORY_H_
#define THIGMO_MEGA_PROGRAM_MEMORY_H_

#include <avr/pgmspace.h>

#define THIGMO_PROGMEM PROGMEM
#define THIGMO_FLASH_U8(pointer) pgm_read_byte(pointer)
#define THIGMO_FLASH_U16(pointer) pgm_read_word(pointer)
#define THIGMO_FLASH_U32(pointer) pgm_read_dword(pointer)

// Interrupt routines are compiled for speed, all else for size.
#define THIGMO_FAST __attribute__((optimize("O2")))

#endif  // THIGMO_MEGA_PROGRAM_MEMORY_H_
