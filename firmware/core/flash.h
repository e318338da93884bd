// Constant tables in program memory.
//
// An AVR reads its flash with other instructions than its RAM, and only its board knows them. The
// board of such a chip defines these four macros before it includes anything of the core (compile
// with `-include`, or include its own header first); everyone else gets plain memory.
#ifndef THIGMO_CORE_FLASH_H_
#define THIGMO_CORE_FLASH_H_

#include <stdint.h>

#if defined(__AVR__) && !defined(THIGMO_FLASH_U16)
#error "define THIGMO_PROGMEM and THIGMO_FLASH_U8/U16/U32 before including the firmware core"
#endif

#ifndef THIGMO_PROGMEM
#define THIGMO_PROGMEM  // attribute of a constant table
#endif
#ifndef THIGMO_FLASH_U16
#define THIGMO_FLASH_U8(pointer) (*(pointer))   // reads of one table element: pointer to uint8_t,
#define THIGMO_FLASH_U16(pointer) (*(pointer))  // to uint16_t or int16_t,
#define THIGMO_FLASH_U32(pointer) (*(pointer))  // to uint32_t or int32_t
#endif

// Keeps a function out of its callers. Whole-program optimisation would otherwise melt the main
// loop into one function, whose variables no longer fit the registers: a division by hand then
// takes four times as long.
#define THIGMO_NOINLINE __attribute__((noinline))

#endif  // THIGMO_CORE_FLASH_H_
