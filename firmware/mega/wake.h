// What the main loop shares with interrupt routines: why it should run, one bit in a register that
// they set in two cycles; and the fence between an index of theirs and what it stands for.
#ifndef THIGMO_MEGA_WAKE_H_
#define THIGMO_MEGA_WAKE_H_

#include <avr/io.h>

namespace thigmo {
namespace mega {

// The compiler moves no access to memory across; `volatile` alone orders only the index.
inline void fence() { __asm__ volatile("" : : : "memory"); }

namespace wake {

// GPIOR0 lies where sbi and cbi reach; its bit 1 is the sampler's (sampler.h). GPIOR1 marks tasks
// (mega_board.h), GPIOR2 is the transmitter's (serial.h).
inline void ask() { GPIOR0 |= 1; }
inline void clear() { GPIOR0 &= static_cast<uint8_t>(~1); }
inline bool asked() { return (GPIOR0 & 1) != 0; }

}  // namespace wake
}  // namespace mega
}  // namespace thigmo

#endif  // THIGMO_MEGA_WAKE_H_
