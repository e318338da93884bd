// The conversation with the host: sessions, sequence, repeats, and who may speak next.
//
// Commands execute exactly once and in order, whatever the line loses, repeats or replays: a
// command must carry the session of the last hello and the next sequence number; the same number
// again gets the stored reply; anything else is dropped and counted. What waits to be sent is kept
// here, one place a kind, and goes to the line in the order of its urgency: events first.
#ifndef THIGMO_CORE_LINK_SESSION_H_
#define THIGMO_CORE_LINK_SESSION_H_

#include <stdint.h>

#include "../board.h"
#include "events.h"
#include "frame.h"

namespace thigmo {

constexpr uint8_t kFirmwareVersion[3] = {0, 2, 0};

// What happened to a command.
enum class Handled : uint8_t {
  kReplied,   // the reply is in the frame given
  kDeferred,  // Session::finish() will follow
};

class Session {
 public:
  struct Identity {
    uint32_t boot_nonce;
    protocol::Board board;
    protocol::ResetCause reset_cause;
  };

  struct Counters {
    uint32_t rx_frames;
    uint16_t rx_bad;
    uint16_t rx_stale;
    uint16_t rx_repeats;
    uint16_t tx_dropped;
  };

  void begin(const Identity& identity) {
    identity_ = identity;
    open_ = true;
  }

  // Takes received bytes, up to the end of a frame; returns how many. A whole frame waits in
  // heard() until it is dealt with.
  uint8_t receive(const uint8_t* bytes, uint8_t count) {
    uint8_t taken;
    heard_ = decoder_.push(bytes, count, &taken);
    return taken;
  }
  bool heard() const { return heard_ != FrameDecoder::Result::kMore; }

  // Deals with the frame that was heard, at a time. `handler` has
  //   Handled execute(const Frame& command, Frame* reply);
  //   void heartbeat();
  //   void hello(bool same_host);  // it goes on after a session that was spoilt
  //   void stop(uint32_t nonce);
  // Returns whether it was whole: one that was not changes nothing.
  template <typename Handler>
  bool answer(uint32_t now_us, Handler& handler) {
    const bool whole = heard_ == FrameDecoder::Result::kFrame;
    if (whole) {
      take(decoder_.frame(), now_us, handler);
    } else {
      ++counters_.rx_bad;
    }
    heard_ = FrameDecoder::Result::kMore;
    return whole;
  }

  // The reply to the deferred command.
  void finish(const protocol::Ack& ack) {
    if (!deferred_) return;  // its session is over
    deferred_ = false;
    reply_.set(ack, last_seq_, session_);
    reply_waits_ = true;
  }

  // Telemetry of this tick; an older one still waiting is dropped and counted.
  void offer(const protocol::Telemetry& telemetry) {
    if (session_ == 0) return;
    if (telemetry_waits_) {
      ++counters_.tx_dropped;
      dropped_ = true;
    }
    telemetry_.set(telemetry, ++telemetry_seq_, session_);
    telemetry_waits_ = true;
  }

  // The next frame to send, or null; it holds until the session is next called. `idle` says that
  // the line has (almost) nothing left to send: only events are queued before that, so that nothing
  // long ever lies ahead of an event.
  const Frame* next(uint32_t tick, bool idle, EventQueue& events) {
    if (stopped_waits_) {
      stopped_waits_ = false;
      scratch_.set(stopped_, 0, 0);
      return &scratch_;
    }
    if (!open_) return nullptr;
    // A crowd of events lets telemetry through between them, or some would be lost.
    const bool crowd = telemetry_waits_ && events_in_row_ >= kCrowd;
    // Events of a session that its host does not know yet would be lost on it.
    if (session_ != 0 && notice_.kind != Notice::kHello && !crowd) {
      const protocol::Event* event = events.take_due(tick);
      if (event != nullptr) {
        if (events_in_row_ < kCrowd) ++events_in_row_;
        scratch_.set(*event, 0, session_);
        return &scratch_;
      }
    }
    if (!idle) return nullptr;
    if (crowd) return send_telemetry();
    if (pulse_waits_) {
      pulse_waits_ = false;
      scratch_.set(pulse_, 0, session_);
      return &scratch_;
    }
    if (notice_.kind != Notice::kNone) {
      send_notice();
      return &scratch_;
    }
    if (reply_waits_) {
      reply_waits_ = false;
      return &reply_;
    }
    if (session_ == 0) {
      if (announced_ && tick - announced_tick_ < kAnnounceMs) return nullptr;
      announced_ = true;
      announced_tick_ = tick;
      announce();
      return &scratch_;
    }
    return telemetry_waits_ ? send_telemetry() : nullptr;
  }

  // Ends the host's session, if there is one: it has to say hello anew.
  void leave() {
    if (session_ == 0) return;
    left_ = session_;
    session_ = 0;
    deferred_ = false;
    reply_waits_ = false;
    pulse_waits_ = false;
    telemetry_waits_ = false;
  }

  uint16_t session() const { return session_; }  // 0 while no host has one
  const Counters& counters() const { return counters_; }

  // Whether telemetry was dropped; clear_dropped() when that was reported.
  bool dropped() const { return dropped_; }
  void clear_dropped() { dropped_ = false; }

 private:
  static constexpr uint16_t kAnnounceMs = 500;
  static constexpr uint8_t kNonces = 8;
  static constexpr uint8_t kCrowd = 2;

  // An answer that is not a command's reply, so that it must not displace the stored one.
  struct Notice {
    enum Kind : uint8_t { kNone, kAck, kHello, kNoHello };
    Kind kind;
    protocol::Status status;
    protocol::Reason reason;
    uint16_t seq;
    uint16_t session;
    uint32_t host_nonce;
  };

  template <typename Handler>
  THIGMO_NOINLINE void take(const Frame& frame, uint32_t now_us, Handler& handler) {
    ++counters_.rx_frames;
    // Before anything else is asked: whose it is, which layout he speaks, whether we are ready.
    if (frame.id() == protocol::kStop) {
      take_stop(frame, handler);
      return;
    }
    // Until the boot counter is stored, this boot has no name to give.
    if (!open_) return;
    switch (frame.id()) {
      case protocol::kHello:
        take_hello(frame, handler);
        break;
      case protocol::kHeartbeat:
        take_heartbeat(frame, now_us, handler);
        break;
      default:
        take_command(frame, handler);
        break;
    }
  }

  template <typename Handler>
  void take_hello(const Frame& frame, Handler& handler) {
    protocol::Hello hello;
    if (!protocol::Hello::decode(frame.payload(), frame.payload_size(), &hello)) {
      ++counters_.rx_stale;
      return;
    }
    if (hello.protocol != protocol::kProtocol || hello.schema_hash != protocol::kSchemaHash) {
      refuse(protocol::Reason::kWrongSchema, frame.seq(), hello.host_nonce);
      return;
    }
    if (frame.session() != 0) {
      take_return(frame, hello.host_nonce, handler);
      return;
    }
    if (session_ == 0 || hello.host_nonce != host_nonce_) {
      // A late copy of what this host said before, to an earlier boot maybe: its nonces count up.
      bool stale = session_ != 0 && host_nonce_ - hello.host_nonce < kNonces;
      for (uint8_t i = 0; i < nonce_count_; ++i) {
        stale = stale || nonces_[i] == hello.host_nonce;  // of a conversation that is over
      }
      if (stale) {
        ++counters_.rx_stale;
        return;
      }
      nonces_[nonce_next_] = hello.host_nonce;
      nonce_next_ = static_cast<uint8_t>((nonce_next_ + 1) % kNonces);
      if (nonce_count_ < kNonces) ++nonce_count_;
      host_nonce_ = hello.host_nonce;
      open_session(frame.seq());
      left_ = 0;
      handler.hello(false);
    } else {
      ++counters_.rx_repeats;
    }
    welcome(frame.seq());
  }

  // A hello with a session: its host lost that one and proves by its nonce that it is the same.
  template <typename Handler>
  void take_return(const Frame& frame, uint32_t host_nonce, Handler& handler) {
    if (session_ == 0 || host_nonce != host_nonce_) {
      refuse(protocol::Reason::kBadSession, frame.seq(), host_nonce);
    } else if (frame.session() == session_) {
      left_ = session_;
      open_session(frame.seq());
      handler.hello(true);
      welcome(frame.seq());
    } else if (frame.session() == left_) {
      ++counters_.rx_repeats;
      welcome(frame.seq());
    } else {
      ++counters_.rx_stale;
    }
  }

  void welcome(uint16_t seq) {
    notice_ = {Notice::kHello, protocol::Status::kOk, protocol::Reason::kNone, seq, 0, host_nonce_};
  }
  void refuse(protocol::Reason reason, uint16_t seq, uint32_t host_nonce) {
    notice_ = {Notice::kNoHello, protocol::Status::kRefused, reason, seq, 0, host_nonce};
  }

  void open_session(uint16_t seq) {
    // Differs at each hello, and from other boots' as well as 16 bits can.
    const uint16_t before = session_ != 0 ? session_ : left_;
    session_ = static_cast<uint16_t>(before == 0 ? identity_.boot_nonce ^ identity_.boot_nonce >> 16
                                                 : before + 1);
    if (session_ == 0) session_ = 1;
    last_seq_ = seq;
    heartbeat_ = 0;
    telemetry_seq_ = 0;
    has_reply_ = false;
    reply_waits_ = false;
    deferred_ = false;
    pulse_waits_ = false;
    telemetry_waits_ = false;
  }

  template <typename Handler>
  void take_stop(const Frame& frame, Handler& handler) {
    protocol::Stop stop;
    if (!protocol::Stop::decode(frame.payload(), frame.payload_size(), &stop)) {
      ++counters_.rx_stale;
      return;
    }
    handler.stop(stop.nonce);
    stopped_.nonce = stop.nonce;
    stopped_waits_ = true;
  }

  template <typename Handler>
  void take_heartbeat(const Frame& frame, uint32_t now_us, Handler& handler) {
    protocol::Heartbeat beat;
    if (session_ == 0 || frame.session() != session_ ||
        !protocol::Heartbeat::decode(frame.payload(), frame.payload_size(), &beat) ||
        static_cast<int32_t>(beat.counter - heartbeat_) <= 0) {
      ++counters_.rx_stale;
      return;
    }
    heartbeat_ = beat.counter;
    pulse_ = {beat.counter, now_us};
    pulse_waits_ = true;
    handler.heartbeat();
  }

  template <typename Handler>
  void take_command(const Frame& frame, Handler& handler) {
    if (session_ == 0 || frame.session() != session_) {
      ++counters_.rx_stale;
      if (notice_.kind == Notice::kNone) {
        notice_ = {Notice::kAck,
                   protocol::Status::kRefused,
                   protocol::Reason::kBadSession,
                   frame.seq(),
                   frame.session(),
                   0};
      }
      return;
    }
    const uint16_t seq = frame.seq();
    if (seq == last_seq_ && has_reply_ && frame.id() == last_id_) {
      ++counters_.rx_repeats;
      if (deferred_) {
        notice_ = {
            Notice::kAck, protocol::Status::kInProgress, protocol::Reason::kNone, seq, session_, 0};
      } else {
        reply_waits_ = true;
      }
      return;
    }
    if (seq != static_cast<uint16_t>(last_seq_ + 1) || deferred_) {
      ++counters_.rx_stale;
      return;
    }
    last_seq_ = seq;
    last_id_ = frame.id();
    has_reply_ = true;  // or will have
    const uint8_t size = protocol::inboundSize(frame.id());
    if (size != frame.payload_size()) {
      const protocol::Reason reason = size == protocol::kUnknownMessage
                                          ? protocol::Reason::kUnknownId
                                          : protocol::Reason::kBadLength;
      reply_.set(protocol::Ack{protocol::Status::kRefused, reason, frame.id()}, seq, session_);
      reply_waits_ = true;
      return;
    }
    if (handler.execute(frame, &reply_) == Handled::kDeferred) {
      deferred_ = true;
    } else {
      reply_waits_ = true;
    }
  }

  const Frame* send_telemetry() {
    telemetry_waits_ = false;
    events_in_row_ = 0;
    return &telemetry_;
  }

  void send_notice() {
    if (notice_.kind == Notice::kAck) {
      scratch_.set(protocol::Ack{notice_.status, notice_.reason, 0}, notice_.seq, notice_.session);
    } else {
      protocol::HelloReply reply;
      reply.status = notice_.status;
      reply.reason = notice_.reason;
      reply.protocol = protocol::kProtocol;
      reply.schema_hash = protocol::kSchemaHash;
      for (uint8_t i = 0; i < 3; ++i) reply.firmware_version[i] = kFirmwareVersion[i];
      reply.board = identity_.board;
      reply.boot_nonce = identity_.boot_nonce;
      reply.session = notice_.kind == Notice::kHello ? session_ : 0;
      reply.reset_cause = identity_.reset_cause;
      reply.receive_window = kRxRing - 1;
      reply.host_nonce = notice_.host_nonce;
      scratch_.set(reply, notice_.seq, 0);
    }
    notice_.kind = Notice::kNone;
  }

  void announce() {
    protocol::Announce message;
    message.protocol = protocol::kProtocol;
    message.schema_hash = protocol::kSchemaHash;
    for (uint8_t i = 0; i < 3; ++i) message.firmware_version[i] = kFirmwareVersion[i];
    message.board = identity_.board;
    message.boot_nonce = identity_.boot_nonce;
    message.reset_cause = identity_.reset_cause;
    scratch_.set(message, 0, 0);
  }

  FrameDecoder decoder_;
  FrameDecoder::Result heard_ = FrameDecoder::Result::kMore;
  Frame reply_{};  // of the last command
  Frame telemetry_{};
  Frame scratch_{};  // what is made when it is sent
  protocol::Pulse pulse_{};
  protocol::Stopped stopped_{};
  Notice notice_{};
  Identity identity_{};
  Counters counters_{};
  uint32_t nonces_[kNonces] = {};
  uint32_t host_nonce_ = 0;
  uint32_t heartbeat_ = 0;
  uint32_t announced_tick_ = 0;
  uint16_t session_ = 0;
  uint16_t left_ = 0;  // the session before this one, if its host came back or was left
  uint16_t last_seq_ = 0;
  uint16_t telemetry_seq_ = 0;
  uint8_t last_id_ = 0;
  uint8_t events_in_row_ = 0;  // since the last telemetry, at most kCrowd
  uint8_t nonce_next_ = 0;
  uint8_t nonce_count_ = 0;
  bool open_ = false;
  bool announced_ = false;
  bool has_reply_ = false;
  bool reply_waits_ = false;
  bool deferred_ = false;
  bool pulse_waits_ = false;
  bool stopped_waits_ = false;
  bool telemetry_waits_ = false;
  bool dropped_ = false;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_LINK_SESSION_H_
