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

#include "mega/mega_board.h"
#include "mega/signature.h"
// The core needs the board's access to flash tables, defined above.
#include "core/robot.h"

#endif  // THIGMO_MEGA_H_
