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
    Place& place = places_[(first_ + count_) % kPlaces];
    ++count_;
    place.event = {number_, code, t_us, arg, value};
    place.sent = false;
  }

  // Unlatches events up to and including a number.
  void acknowledge(uint16_t number) {
    while (count_ > 0 && static_cast<int16_t>(places_[first_].event.number - number) <= 0) {
      first_ = static_cast<uint8_t>((first_ + 1) % kPlaces);
      --count_;
    }
  }

  // The oldest event that is to be sent at this tick, or null.
  const protocol::Event* due(uint32_t tick) const {
    for (uint8_t i = 0; i < count_; ++i) {
      const Place& place = places_[(first_ + i) % kPlaces];
      if (!place.sent || tick - place.sent_tick >= kRepeatMs) return &place.event;
    }
    return nullptr;
  }

  // Marks an event from due() as sent.
  void sent(const protocol::Event* event, uint32_t tick) {
    for (uint8_t i = 0; i < kPlaces; ++i) {
      if (&places_[i].event == event) {
        places_[i].sent = true;
        places_[i].sent_tick = tick;
      }
    }
  }

  // A new conversation: all that is latched is to be sent anew.
  void resend() {
    for (uint8_t i = 0; i < kPlaces; ++i) places_[i].sent = false;
  }

  uint16_t newest() const { return number_; }
  uint8_t count() const { return count_; }

 private:
  struct Place {
    protocol::Event event;
    uint32_t sent_tick;
    bool sent;
  };

  Place places_[kPlaces] = {};
  uint16_t number_ = 0;
  uint8_t first_ = 0;
  uint8_t count_ = 0;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_LINK_EVENTS_H_
