// Events that the host must see: latched in order until it acknowledges them.
//
// Each is sent at once and again every 200 ms. The queue is longer than the number of faults plus
// the events of a whole sweep; should it run full all the same (no host), later events are lost and
// leave a gap in the numbers, while every fault stays visible in the status.
#ifndef THIGMO_CORE_LINK_EVENTS_H_
#define THIGMO_CORE_LINK_EVENTS_H_

#include <stdint.h>

#include "protocol.h"

namespace thigmo {

class EventQueue {
 public:
  static constexpr uint8_t kPlaces = 20;
  static constexpr uint16_t kRepeatMs = 200;

  void post(protocol::EventCode code, uint16_t arg, int32_t value, uint32_t t_us) {
    ++number_;
    if (count_ == kPlaces) return;
    Place& place = places_[wrapped(static_cast<uint8_t>(first_ + count_))];
    ++count_;
    place.event = {number_, code, t_us, arg, value};
    place.sent = false;
    waiting_ = true;
  }

  // Unlatches events up to and including a number.
  void acknowledge(uint16_t number) {
    while (count_ > 0 && static_cast<int16_t>(places_[first_].event.number - number) <= 0) {
      first_ = wrapped(static_cast<uint8_t>(first_ + 1));
      --count_;
    }
  }

  // The oldest event that is to be sent at this tick, or null; it then counts as sent.
  const protocol::Event* take_due(uint32_t tick) {
    // Between a repeat and the next there is nothing to look for.
    if (count_ == 0 || (!waiting_ && tick - looked_tick_ < kLookMs)) return nullptr;
    uint8_t index = first_;
    for (uint8_t i = 0; i < count_; ++i) {
      Place& place = places_[index];
      if (!place.sent || tick - place.sent_tick >= kRepeatMs) {
        place.sent = true;
        place.sent_tick = tick;
        waiting_ = true;  // there may be more
        return &place.event;
      }
      index = wrapped(static_cast<uint8_t>(index + 1));
    }
    waiting_ = false;
    looked_tick_ = tick;
    return nullptr;
  }

  // A new conversation: everything latched is to be sent again.
  void resend() {
    for (uint8_t i = 0; i < kPlaces; ++i) places_[i].sent = false;
    waiting_ = true;
  }

  // The oldest latched event after a number, or null.
  const protocol::Event* after(uint16_t number) const {
    for (uint8_t i = 0; i < count_; ++i) {
      const protocol::Event& event = places_[wrapped(static_cast<uint8_t>(first_ + i))].event;
      if (static_cast<int16_t>(event.number - number) > 0) return &event;
    }
    return nullptr;
  }

  uint16_t newest() const { return number_; }
  uint8_t count() const { return count_; }

 private:
  struct Place {
    protocol::Event event;
    uint32_t sent_tick;
    bool sent;
  };

  static constexpr uint16_t kLookMs = 10;

  static uint8_t wrapped(uint8_t index) {
    return index < kPlaces ? index : static_cast<uint8_t>(index - kPlaces);
  }

  Place places_[kPlaces] = {};
  uint32_t looked_tick_ = 0;
  uint16_t number_ = 0;
  uint8_t first_ = 0;
  uint8_t count_ = 0;
  bool waiting_ = false;  // some event may be due
};

}  // namespace thigmo

#endif  // THIGMO_CORE_LINK_EVENTS_H_
