// Entry of the Arduino library that this folder is (library.properties): the robot controller and
// its binding to the Mega. The sketch firmware/mega/mega.ino is its only user.
#ifndef THIGMO_MEGA_H_
#define THIGMO_MEGA_H_

#include "mega/mega_board.h"
#include "mega/signature.h"
// The core needs the board's access to flash tables, defined above.
#include "core/robot.h"

#endif  // THIGMO_MEGA_H_
