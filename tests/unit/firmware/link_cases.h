// Link: golden vectors, what a session says first, events. The fuzz target of the decoder (../../
// protocol/fuzz) has stuffing and garbage.
//
// golden_vectors.h is written by test_firmware_core.py from protocol/golden.json: for each vector
// the typed message built from the vector's fields, its frame and its bytes on the wire.
#ifndef THIGMO_TESTS_FIRMWARE_LINK_CASES_H_
#define THIGMO_TESTS_FIRMWARE_LINK_CASES_H_

#include <algorithm>
#include <cstring>
#include <string>

#include "check.h"
#include "link/session.h"

namespace link_cases {

using namespace thigmo;
using Bytes = std::vector<uint8_t>;

inline std::vector<Frame> frames_of(FrameDecoder& decoder, const Bytes& bytes) {
  std::vector<Frame> frames;
  for (size_t at = 0; at < bytes.size();) {
    uint8_t taken = 0;
    const uint8_t part = static_cast<uint8_t>(std::min<size_t>(40, bytes.size() - at));
    if (decoder.push(bytes.data() + at, part, &taken) == FrameDecoder::Result::kFrame) {
      frames.push_back(decoder.frame());
    }
    at += taken;
  }
  return frames;
}

inline Bytes wire_of(const Frame& frame) {
  uint8_t wire[protocol::kMaxWire];
  return Bytes(wire, wire + encode(frame, wire));
}

template <typename Message>
Bytes wire_of(const Message& message, uint16_t seq, uint16_t session) {
  Frame frame;
  frame.set(message, seq, session);
  return wire_of(frame);
}

inline Bytes from_hex(const char* text) {
  Bytes bytes;
  for (; *text != 0; text += 2) {
    bytes.push_back(static_cast<uint8_t>(std::stoi(std::string(text, 2), nullptr, 16)));
  }
  return bytes;
}

// One golden vector: the message encodes to the frame and the wire, and both decode to it.
template <typename Message>
void check_vector(const Message& message, uint16_t seq, uint16_t session, const char* raw_hex,
                  const char* wire_hex) {
  const Bytes raw = from_hex(raw_hex);
  const Bytes wire = from_hex(wire_hex);
  Frame frame;
  frame.set(message, seq, session);
  CHECK(Bytes(frame.bytes, frame.bytes + frame.size) == Bytes(raw.begin(), raw.end() - 2));
  CHECK_EQUAL(crc16(frame.bytes, frame.size), raw[raw.size() - 2] | raw[raw.size() - 1] << 8);
  CHECK(wire_of(frame) == wire);
  FrameDecoder decoder;
  const std::vector<Frame> frames = frames_of(decoder, wire);
  CHECK_EQUAL(frames.size(), 1u);
  if (frames.size() != 1) return;
  CHECK_EQUAL(frames[0].id(), Message::kId);
  CHECK_EQUAL(frames[0].seq(), seq);
  CHECK_EQUAL(frames[0].session(), session);
  Message decoded = {};
  CHECK(Message::decode(frames[0].payload(), frames[0].payload_size(), &decoded));
  uint8_t again[protocol::kMaxPayload];
  decoded.encode(again);
  CHECK(std::memcmp(again, frames[0].payload(), Message::kSize) == 0);
  CHECK(!Message::decode(frames[0].payload(), Message::kSize + 1, &decoded));
}

}  // namespace link_cases

#include "golden_vectors.h"

namespace link_cases {

TEST(golden_vectors_encode_and_decode) {
  for (const auto check : kGoldenVectors) check();
}

TEST(golden_bad_frames_are_refused) {
  for (const char* hex : kGoldenBadFrames) {
    const Bytes wire = from_hex(hex);
    FrameDecoder decoder;
    CHECK_EQUAL(frames_of(decoder, wire).size(), 0u);
    // And the next good one is found.
    CHECK_EQUAL(frames_of(decoder, wire_of(protocol::Arm{}, 1, 2)).size(), 1u);
  }
}

// The other end, for the session's tests.
struct Device {
  Session session;
  EventQueue events;
  std::vector<uint16_t> executed;  // the argument of each command, in order
  std::vector<uint32_t> stops;
  int heartbeats = 0;
  int hellos = 0;
  bool defer = false;
  uint32_t tick = 0;

  explicit Device(uint32_t nonce = 0x12345678) {
    session.begin({nonce, protocol::BoardKind::kVirtual, protocol::ResetCause::kPowerOn});
  }
  Handled execute(const Frame& command, Frame* reply) {
    protocol::ClearFaults m = {};
    if (!protocol::ClearFaults::decode(command.payload(), command.payload_size(), &m)) {
      m.mask = command.id();
    }
    executed.push_back(m.mask);
    if (defer) return Handled::kDeferred;
    reply->set(protocol::Ack{protocol::Status::kOk, protocol::Reason::kNone, m.mask}, command.seq(),
               command.session());
    return Handled::kReplied;
  }
  void heartbeat() { ++heartbeats; }
  void stop(uint32_t nonce) { stops.push_back(nonce); }
  void hello(bool) {
    ++hellos;
    events.resend();
  }
  void take(const Bytes& bytes) {
    for (const uint8_t byte : bytes) {
      session.receive(&byte, 1);
      if (session.heard()) session.answer(4711, *this);
    }
  }
  // All that waits, as if the line were infinitely fast.
  std::vector<Frame> give() {
    std::vector<Frame> out;
    while (const Frame* frame = session.next(tick, true, events)) out.push_back(*frame);
    return out;
  }
  uint16_t greet(uint32_t nonce, uint16_t seq = 0) {
    take(wire_of(protocol::Hello{protocol::kProtocol, protocol::kSchemaHash, nonce}, seq, 0));
    give();
    return session.session();
  }
};

inline Bytes command(uint16_t value, uint16_t seq, uint16_t session) {
  return wire_of(protocol::ClearFaults{value}, seq, session);
}

TEST(a_stop_is_obeyed_and_echoed_before_the_session_may_speak) {
  Device device;
  device.session = Session();  // its boot counter is not stored yet
  CHECK(device.give().empty());
  for (const uint16_t any : {0, 7, 0xFFFF}) {
    device.take(wire_of(protocol::Stop{0xABCD0000u + any}, any, any));
    CHECK_EQUAL(device.stops.back(), 0xABCD0000u + any);
    const std::vector<Frame> sent = device.give();
    CHECK_EQUAL(sent.size(), 1u);
    protocol::Stopped echo = {};
    CHECK(sent[0].id() == protocol::kStopped);
    CHECK(protocol::Stopped::decode(sent[0].payload(), sent[0].payload_size(), &echo));
    CHECK_EQUAL(echo.nonce, 0xABCD0000u + any);
  }
  CHECK_EQUAL(device.stops.size(), 3u);
}

TEST(a_stop_is_echoed_before_all_else_though_the_line_is_full) {
  Device device;
  const uint16_t session = device.greet(1);
  device.events.post(protocol::EventCode::kPeak, 1, 2, 3);
  device.session.offer(protocol::Telemetry{});
  device.defer = true;
  device.take(command(1, 1, session));
  device.take(wire_of(protocol::Stop{5}, 0, 0));
  const Frame* first = device.session.next(0, false, device.events);
  CHECK(first != nullptr && first->id() == protocol::kStopped);
  device.session.finish(protocol::Ack{protocol::Status::kOk, protocol::Reason::kNone, 0});
  CHECK_EQUAL(device.executed.size(), 1u);  // the conversation goes on
}

TEST(a_new_hello_forgets_the_deferred_command) {
  Device device;
  const uint16_t session = device.greet(1);
  device.defer = true;
  device.take(command(1, 1, session));
  const uint16_t next = device.greet(2);
  device.session.finish({protocol::Status::kOk, protocol::Reason::kNone, 42});
  CHECK(device.give().empty());
  device.defer = false;
  device.take(command(2, 1, next));
  CHECK_EQUAL(device.give().size(), 1u);
}

TEST(events_go_first_and_are_repeated_until_acknowledged) {
  Device device;
  device.greet(1);
  device.events.post(protocol::EventCode::kPeak, 1, 2, 3);
  device.events.post(protocol::EventCode::kContact, 4, 5, 6);
  device.session.offer(protocol::Telemetry{});
  std::vector<Frame> sent = device.give();
  CHECK_EQUAL(sent.size(), 3u);
  CHECK_EQUAL(sent[0].id(), protocol::kEvent);
  CHECK_EQUAL(sent[1].id(), protocol::kEvent);
  CHECK_EQUAL(sent[2].id(), protocol::kTelemetry);
  CHECK(wire_of(sent[0]).size() <= 24);
  int repeats = 0;
  for (device.tick = 1; device.tick <= 1000; ++device.tick) {
    repeats += static_cast<int>(device.give().size());
  }
  CHECK_EQUAL(repeats, 10);
  device.events.acknowledge(1);
  repeats = 0;
  for (; device.tick <= 2000; ++device.tick) repeats += static_cast<int>(device.give().size());
  CHECK_EQUAL(repeats, 5);
  device.greet(2);  // a new host hears of it at once
  sent = device.give();
  device.events.acknowledge(2);
  CHECK_EQUAL(device.events.count(), 0);
}

TEST(a_crowd_of_events_lets_telemetry_through) {
  Device device;
  device.greet(1);
  for (int i = 0; i < 6; ++i) device.events.post(protocol::EventCode::kEverted, 0, i, 0);
  device.session.offer(protocol::Telemetry{});
  const std::vector<Frame> sent = device.give();
  CHECK_EQUAL(sent.size(), 7u);
  for (int i = 0; i < 7; ++i) {
    CHECK_EQUAL(sent[i].id(), i == 2 ? protocol::kTelemetry : protocol::kEvent);
  }
}

TEST(a_full_event_queue_leaves_a_gap_and_keeps_the_oldest) {
  EventQueue events;
  for (int i = 0; i < EventQueue::kPlaces + 5; ++i) {
    events.post(protocol::EventCode::kPeak, 0, i, 0);
  }
  CHECK_EQUAL(events.newest(), EventQueue::kPlaces + 5);
  CHECK_EQUAL(events.take_due(0)->value, 0);
  events.acknowledge(EventQueue::kPlaces);
  CHECK_EQUAL(events.count(), 0);
  events.post(protocol::EventCode::kPeak, 0, 77, 0);
  CHECK_EQUAL(events.take_due(0)->number, EventQueue::kPlaces + 6);
}

}  // namespace link_cases

#endif  // THIGMO_TESTS_FIRMWARE_LINK_CASES_H_
