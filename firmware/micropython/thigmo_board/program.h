// What a Python program asks of the controller (controller.h).
//
// Runs where the controller runs, between two passes of its main loop.
#ifndef THIGMO_MICROPYTHON_PROGRAM_H_
#define THIGMO_MICROPYTHON_PROGRAM_H_

#include <stdint.h>
#include <string.h>

#include "../../core/robot.h"
#include "controller.h"

namespace thigmo {

template <typename Board>
class Program {
 public:
  explicit Program(Robot<Board>& robot) : robot_(robot) {}

  // After a pass: keeps what has happened for the program, before a host can acknowledge it. True
  // if there is something new.
  bool look() {
    EventQueue& queue = robot_.events();
    bool news = false;
    while (seen_ != queue.newest()) {
      const protocol::Event* const event = queue.after(seen_);
      if (event == nullptr) {  // the queue was full
        seen_ = queue.newest();
        break;
      }
      seen_ = event->number;
      if (static_cast<uint8_t>(in_ - out_) == kEvents) ++out_;  // the oldest is lost
      events_[in_++ % kEvents] = *event;
      news = true;
    }
    if (news && owns()) queue.acknowledge(seen_);
    return news;
  }

  void answer(thigmo_request_t* request) {
    request->outcome = THIGMO_DONE;
    switch (request->kind) {
      case THIGMO_TAKE:
        return take(request);
      case THIGMO_BEAT:
        if (!owns()) request->outcome = THIGMO_HOSTED;
        if (owns()) robot_.beat();
        return;
      case THIGMO_COMMAND:
        return execute(request);
      case THIGMO_STOP:
        return robot_.stop(protocol::detail::get32(request->bytes));
      case THIGMO_CURVATURE:
        request->size = 2 * kSensors;
        for (uint8_t i = 0; i < kSensors; ++i) {
          const Controller& controller = robot_.controller();
          const int16_t bend = controller.reads(i) ? controller.bend_e5(i) : INT16_MIN;
          protocol::detail::put16(request->bytes + 2 * i, static_cast<uint16_t>(bend));
        }
        return;
      case THIGMO_EVENT:
        request->size = 0;
        if (in_ == out_) return;
        events_[out_++ % kEvents].encode(request->bytes);
        request->size = protocol::Event::kSize;
        return;
    }
    request->outcome = THIGMO_NOT_SO;
  }

 private:
  static constexpr uint8_t kEvents = 32;

  bool owns() const { return taken_ && !robot_.hosted(); }

  void take(thigmo_request_t* request) {
    if (owns()) return;
    const bool alive = (robot_.controller().conditions() & mask(Condition::kHostAlive)) != 0;
    if (robot_.hosted() && alive) {
      request->outcome = THIGMO_HOSTED;
      return;
    }
    robot_.take();
    taken_ = true;
  }

  static bool asks(uint8_t id) {
    return id == protocol::kGetStatus || id == protocol::kGetSensor ||
           id == protocol::kGetParameter || id == protocol::kGetCapacity;
  }
  // Their answers come later, to a host on the line.
  static bool deferred(uint8_t id) {
    return id == protocol::kApplyParameters || id == protocol::kSaveConfig ||
           id == protocol::kLoadDefaults;
  }

  void execute(thigmo_request_t* request) {
    const uint8_t id = request->id;
    if (protocol::inboundSize(id) != request->size || id == protocol::kHello ||
        id == protocol::kHeartbeat || id == protocol::kStop || deferred(id)) {
      request->outcome = THIGMO_NOT_SO;
      return;
    }
    if (!asks(id) && !owns()) {
      request->outcome = THIGMO_HOSTED;
      return;
    }
    Frame command = {};
    command.bytes[0] = id;
    memcpy(command.bytes + protocol::kHeaderSize, request->bytes, request->size);
    command.size = static_cast<uint8_t>(protocol::kHeaderSize + request->size);
    Frame reply = {};
    robot_.execute(command, &reply);
    request->id = reply.id();
    request->size = reply.payload_size();
    memcpy(request->bytes, reply.payload(), request->size);
  }

  Robot<Board>& robot_;
  protocol::Event events_[kEvents];
  uint16_t seen_ = 0;
  uint8_t in_ = 0, out_ = 0;
  bool taken_ = false;
};

}  // namespace thigmo

#endif  // THIGMO_MICROPYTHON_PROGRAM_H_
