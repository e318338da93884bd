// Entry of the Arduino library that this folder is (library.properties): the robot controller and
// its binding to the Mega. The sketch firmware/mega/mega.ino is its only user.
#ifndef THIGMO_MEGA_H_
#define THIGMO_MEGA_H_

// Arduino.h, which the IDE puts before every sketch, defines macros with everyday names.
#undef abs
#undef bit
#undef max
#undef min
#undef round

// Speed before size, whatever the build's own choice (the IDE compiles for size): a fifth of the
// loop's time for twice the flash, of which there is plenty.
#pragma GCC optimize("O3", "no-inline-small-functions")

#include "mega/mega_board.h"
#include "mega/signature.h"
// The core needs the board's access to flash tables, defined above.
#include "core/robot.h"

#endif  // THIGMO_MEGA_H_
