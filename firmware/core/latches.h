// What stays latched through every reset but a loss of power: the stop, and the faults.
//
// Opening the port resets a Mega, so a latch that a reset ended would be one that any program gets
// round. The core hands its latches to the board (BoardPolicy::keep_latches) and takes them back
// when it begins. Boards whose RAM survives a reset keep them in a LatchRecord.
#ifndef THIGMO_CORE_LATCHES_H_
#define THIGMO_CORE_LATCHES_H_

#include <stdint.h>

namespace thigmo {

// Whether somebody has stopped the robot, and which stop that was.
struct StopLatch {
  bool latched = false;
  uint32_t nonce = 0;
};

struct Latches {
  StopLatch stop;
  uint16_t faults = 0;  // by bit number
};

// Latches in RAM that no start-up code touches: each value has its complement beside it. A stop
// counts only if the two agree. A fault counts if either has it, so that a reset between the two
// writes loses none. After power-on, `keep({})` comes first.
struct LatchRecord {
  uint32_t stop_nonce;
  uint32_t stop_mark;  // its complement if a stop is latched
  uint16_t faults;
  uint16_t faults_mark;  // its complement

  void keep(const Latches& latches) {
    stop_nonce = latches.stop.nonce;
    stop_mark = latches.stop.latched ? ~latches.stop.nonce : latches.stop.nonce;
    faults = latches.faults;
    faults_mark = static_cast<uint16_t>(~latches.faults);
  }

  Latches kept() const {
    Latches latches;
    latches.stop.latched = stop_mark == ~stop_nonce;
    if (latches.stop.latched) latches.stop.nonce = stop_nonce;
    latches.faults = static_cast<uint16_t>(faults | ~faults_mark);
    return latches;
  }
};

}  // namespace thigmo

#endif  // THIGMO_CORE_LATCHES_H_
