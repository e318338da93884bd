// Frames on the wire: byte stuffing (COBS) and the check sequence (CRC-16 CCITT-FALSE).
//
// The serial path may lose, flip, insert and replay bytes, so the decoder trusts nothing: whatever
// arrives, it recovers at the next zero byte, and what it hands on had a good check sequence.
#ifndef THIGMO_CORE_LINK_FRAME_H_
#define THIGMO_CORE_LINK_FRAME_H_

#include <stdint.h>

#include "../flash.h"
#include "protocol.h"

namespace thigmo {

// The check sequence by table, a byte of it at a time: an AVR so takes 15 cycles a byte instead of
// 90 bit by bit. High and low bytes lie apart, because bytes need no shifts.
struct CrcTable {
  uint8_t high[256];
  uint8_t low[256];
};

constexpr CrcTable crc_table() {
  CrcTable table{};
  for (uint16_t i = 0; i < 256; ++i) {
    uint16_t crc = static_cast<uint16_t>(i << 8);
    for (uint8_t bit = 0; bit < 8; ++bit) {
      crc = static_cast<uint16_t>((crc & 0x8000u) != 0 ? (crc << 1) ^ 0x1021u : crc << 1);
    }
    table.high[i] = static_cast<uint8_t>(crc >> 8);
    table.low[i] = static_cast<uint8_t>(crc);
  }
  return table;
}
constexpr CrcTable kCrcTable THIGMO_PROGMEM = crc_table();

// A running check sequence.
struct Crc {
  uint8_t high = 0xFF;
  uint8_t low = 0xFF;

  // Inlined by order: a call would cost as much as the step.
  __attribute__((always_inline)) inline void add(uint8_t byte) {
    const uint8_t* const row = kCrcTable.high + static_cast<uint8_t>(high ^ byte);
    high = static_cast<uint8_t>(low ^ THIGMO_FLASH_U8(row));
    low = THIGMO_FLASH_U8(row + sizeof(kCrcTable.high));
  }

  uint16_t value() const { return static_cast<uint16_t>(static_cast<uint16_t>(high << 8) | low); }
};

THIGMO_NOINLINE inline uint16_t crc16(const uint8_t* bytes, uint8_t count) {
  Crc crc;
  for (; count != 0; --count) crc.add(*bytes++);
  return crc.value();
}

// Header and payload of one frame, unstuffed; behind them lies room for the check sequence.
struct Frame {
  uint8_t bytes[protocol::kMaxFrame];
  uint8_t size;  // without the check sequence; 0 = none

  uint8_t id() const { return bytes[0]; }
  uint16_t seq() const { return protocol::detail::get16(bytes + 1); }
  uint16_t session() const { return protocol::detail::get16(bytes + 3); }
  const uint8_t* payload() const { return bytes + protocol::kHeaderSize; }
  uint8_t payload_size() const { return static_cast<uint8_t>(size - protocol::kHeaderSize); }

  // Fills the frame with a message.
  template <typename Message>
  void set(const Message& message, uint16_t seq, uint16_t session) {
    bytes[0] = Message::kId;
    protocol::detail::put16(bytes + 1, seq);
    protocol::detail::put16(bytes + 3, session);
    message.encode(bytes + protocol::kHeaderSize);
    size = protocol::kHeaderSize + Message::kSize;
  }
};

// A frame as it goes on the wire, check sequence and delimiter added, in one pass over its bytes.
// Returns the number of bytes, at most kMaxWire.
//
// Each byte is stored as it is; a zero then becomes the place of the next block's length, which is
// filled in when that block ends.
THIGMO_NOINLINE inline uint8_t encode(const Frame& frame, uint8_t* wire) {
  Crc crc;
  uint8_t* code = wire;  // where the length of the running block goes
  uint8_t* next = wire + 1;
  const auto put = [&code, &next](uint8_t byte) {
    *next = byte;
    if (byte == 0) {
      *code = static_cast<uint8_t>(next - code);
      code = next;
    }
    ++next;
  };
  const uint8_t* payload = frame.bytes;
  for (uint8_t left = frame.size; left != 0; --left) {
    const uint8_t byte = *payload++;
    crc.add(byte);
    put(byte);
  }
  put(crc.low);
  put(crc.high);
  put(0);  // the delimiter ends the last block
  return static_cast<uint8_t>(next - wire);
}

// Unstuffs a stream.
class FrameDecoder {
 public:
  enum class Result : uint8_t { kMore, kFrame, kBad };

  // Takes bytes as they came, up to the first zero; `taken` says how many. After kFrame, frame() is
  // valid until the next call. What changes from byte to byte stays in registers: byte by byte, an
  // AVR would take six times as long. Of what is longer than any frame, bytes are only passed over:
  // noise must not load a robot that moves.
  THIGMO_NOINLINE Result push(const uint8_t* bytes, uint8_t count, uint8_t* taken) {
    const uint8_t* const top = frame_.bytes + protocol::kMaxFrame;
    uint8_t* output = frame_.bytes + count_;
    uint8_t left = left_;
    uint8_t unread = count;
    while (unread != 0) {
      --unread;
      uint8_t byte = *bytes++;
      if (byte == 0) {
        *taken = static_cast<uint8_t>(count - unread);
        return finish(static_cast<uint8_t>(output - frame_.bytes), left == 0);
      }
      if (overlong_) continue;
      if (left == 0) {
        // A code byte: so many bytes to the next zero, which the code before it stood for (the code
        // 255 stands for none, but no frame is that long).
        left = static_cast<uint8_t>(byte - 1);
        byte = 0;
        overlong_ = left > top - output;
        if (!begun_) {
          begun_ = true;
          continue;
        }
      } else {
        --left;
      }
      if (output == top) {
        overlong_ = true;
      } else {
        *output++ = byte;
      }
    }
    count_ = static_cast<uint8_t>(output - frame_.bytes);
    left_ = left;
    *taken = count;
    return Result::kMore;
  }

  const Frame& frame() const { return frame_; }

 private:
  // A zero has come after so many bytes; `complete`: after all that the last code promised.
  Result finish(uint8_t count, bool complete) {
    const bool empty = !begun_;
    const bool whole = complete && !overlong_;
    count_ = 0;
    left_ = 0;
    begun_ = false;
    overlong_ = false;
    if (empty) return Result::kMore;
    if (!whole || count < protocol::kHeaderSize + protocol::kCrcSize) return Result::kBad;
    const uint8_t body = static_cast<uint8_t>(count - protocol::kCrcSize);
    if (crc16(frame_.bytes, body) != protocol::detail::get16(frame_.bytes + body)) {
      return Result::kBad;
    }
    frame_.size = body;
    return Result::kFrame;
  }

  Frame frame_{};
  uint8_t count_ = 0;
  uint8_t left_ = 0;
  bool begun_ = false;
  bool overlong_ = false;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_LINK_FRAME_H_
