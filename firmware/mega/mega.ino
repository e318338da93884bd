// The robot's firmware for the Arduino Mega 2560. firmware/mega/README.md says how to build it, by
// `make firmware` or with the Arduino IDE alone.
#include <thigmo_mega.h>

static thigmo::mega::MegaBoard board;
static thigmo::Robot<thigmo::mega::MegaBoard> robot(board);

void setup() {
  thigmo::mega::sign_image();
  board.begin();
  robot.begin();
  board.start();
}

void loop() {
  // Never back to main(): a pass would save its registers each time.
  for (;;) {
    robot.loop();
    board.task(0);
    board.idle();
  }
}
