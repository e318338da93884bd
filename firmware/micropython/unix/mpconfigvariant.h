// MicroPython's standard variant of the unix port, with one change.
#include "ports/unix/variants/standard/mpconfigvariant.h"

// Ctrl-C waits for the next bytecode: a jump out of the signal handler would keep the module's
// lock, and pass by the function that puts the outputs off.
#undef MICROPY_ASYNC_KBD_INTR
#define MICROPY_ASYNC_KBD_INTR (0)
