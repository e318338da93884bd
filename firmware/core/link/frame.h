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

// A table of 512 bytes of flash makes a byte cost some 22 cycles of an AVR instead of 90.
constexpr uint16_t kCrcTable[256] THIGMO_PROGMEM = {
    0x0000, 0x1021, 0x2042, 0x3063, 0x4084, 0x50A5, 0x60C6, 0x70E7, 0x8108, 0x9129, 0xA14A, 0xB16B,
    0xC18C, 0xD1AD, 0xE1CE, 0xF1EF, 0x1231, 0x0210, 0x3273, 0x2252, 0x52B5, 0x4294, 0x72F7, 0x62D6,
    0x9339, 0x8318, 0xB37B, 0xA35A, 0xD3BD, 0xC39C, 0xF3FF, 0xE3DE, 0x2462, 0x3443, 0x0420, 0x1401,
    0x64E6, 0x74C7, 0x44A4, 0x5485, 0xA56A, 0xB54B, 0x8528, 0x9509, 0xE5EE, 0xF5CF, 0xC5AC, 0xD58D,
    0x3653, 0x2672, 0x1611, 0x0630, 0x76D7, 0x66F6, 0x5695, 0x46B4, 0xB75B, 0xA77A, 0x9719, 0x8738,
    0xF7DF, 0xE7FE, 0xD79D, 0xC7BC, 0x48C4, 0x58E5, 0x6886, 0x78A7, 0x0840, 0x1861, 0x2802, 0x3823,
    0xC9CC, 0xD9ED, 0xE98E, 0xF9AF, 0x8948, 0x9969, 0xA90A, 0xB92B, 0x5AF5, 0x4AD4, 0x7AB7, 0x6A96,
    0x1A71, 0x0A50, 0x3A33, 0x2A12, 0xDBFD, 0xCBDC, 0xFBBF, 0xEB9E, 0x9B79, 0x8B58, 0xBB3B, 0xAB1A,
    0x6CA6, 0x7C87, 0x4CE4, 0x5CC5, 0x2C22, 0x3C03, 0x0C60, 0x1C41, 0xEDAE, 0xFD8F, 0xCDEC, 0xDDCD,
    0xAD2A, 0xBD0B, 0x8D68, 0x9D49, 0x7E97, 0x6EB6, 0x5ED5, 0x4EF4, 0x3E13, 0x2E32, 0x1E51, 0x0E70,
    0xFF9F, 0xEFBE, 0xDFDD, 0xCFFC, 0xBF1B, 0xAF3A, 0x9F59, 0x8F78, 0x9188, 0x81A9, 0xB1CA, 0xA1EB,
    0xD10C, 0xC12D, 0xF14E, 0xE16F, 0x1080, 0x00A1, 0x30C2, 0x20E3, 0x5004, 0x4025, 0x7046, 0x6067,
    0x83B9, 0x9398, 0xA3FB, 0xB3DA, 0xC33D, 0xD31C, 0xE37F, 0xF35E, 0x02B1, 0x1290, 0x22F3, 0x32D2,
    0x4235, 0x5214, 0x6277, 0x7256, 0xB5EA, 0xA5CB, 0x95A8, 0x8589, 0xF56E, 0xE54F, 0xD52C, 0xC50D,
    0x34E2, 0x24C3, 0x14A0, 0x0481, 0x7466, 0x6447, 0x5424, 0x4405, 0xA7DB, 0xB7FA, 0x8799, 0x97B8,
    0xE75F, 0xF77E, 0xC71D, 0xD73C, 0x26D3, 0x36F2, 0x0691, 0x16B0, 0x6657, 0x7676, 0x4615, 0x5634,
    0xD94C, 0xC96D, 0xF90E, 0xE92F, 0x99C8, 0x89E9, 0xB98A, 0xA9AB, 0x5844, 0x4865, 0x7806, 0x6827,
    0x18C0, 0x08E1, 0x3882, 0x28A3, 0xCB7D, 0xDB5C, 0xEB3F, 0xFB1E, 0x8BF9, 0x9BD8, 0xABBB, 0xBB9A,
    0x4A75, 0x5A54, 0x6A37, 0x7A16, 0x0AF1, 0x1AD0, 0x2AB3, 0x3A92, 0xFD2E, 0xED0F, 0xDD6C, 0xCD4D,
    0xBDAA, 0xAD8B, 0x9DE8, 0x8DC9, 0x7C26, 0x6C07, 0x5C64, 0x4C45, 0x3CA2, 0x2C83, 0x1CE0, 0x0CC1,
    0xEF1F, 0xFF3E, 0xCF5D, 0xDF7C, 0xAF9B, 0xBFBA, 0x8FD9, 0x9FF8, 0x6E17, 0x7E36, 0x4E55, 0x5E74,
    0x2E93, 0x3EB2, 0x0ED1, 0x1EF0};

constexpr uint16_t kCrcStart = 0xFFFF;

// Inlined by order: a call would cost as much as the step.
__attribute__((always_inline)) inline uint16_t crc16_add(uint16_t crc, uint8_t byte) {
  const uint8_t index = static_cast<uint8_t>((crc >> 8) ^ byte);
  return static_cast<uint16_t>((crc << 8) ^ THIGMO_FLASH_U16(kCrcTable + index));
}

THIGMO_NOINLINE inline uint16_t crc16(const uint8_t* bytes, uint8_t count) {
  uint16_t crc = kCrcStart;
  for (uint8_t i = 0; i < count; ++i) crc = crc16_add(crc, bytes[i]);
  return crc;
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

// Stuffs bytes into a wire frame.
class Stuffer {
 public:
  explicit Stuffer(uint8_t* out) : out_(out), code_(out), next_(out + 1) {}

  void put(uint8_t byte) {
    if (byte == 0) {
      close();
      code_ = next_++;
    } else {
      *next_++ = byte;
    }
  }

  // Ends the frame with the delimiter; returns the number of bytes.
  uint8_t end() {
    close();
    *next_++ = 0;
    return static_cast<uint8_t>(next_ - out_);
  }

 private:
  void close() { *code_ = static_cast<uint8_t>(next_ - code_); }

  uint8_t* const out_;
  uint8_t* code_;  // where the length of the running block goes
  uint8_t* next_;
};

// A frame as it goes on the wire, check sequence and delimiter added, in one pass over its bytes.
// Returns the number of bytes, at most kMaxWire.
THIGMO_NOINLINE inline uint8_t encode(const Frame& frame, uint8_t* wire) {
  Stuffer stuffer(wire);
  uint16_t crc = kCrcStart;
  const uint8_t* const end = frame.bytes + frame.size;
  for (const uint8_t* at = frame.bytes; at != end; ++at) {
    crc = crc16_add(crc, *at);
    stuffer.put(*at);
  }
  stuffer.put(static_cast<uint8_t>(crc));
  stuffer.put(static_cast<uint8_t>(crc >> 8));
  return stuffer.end();
}

// Unstuffs a stream byte by byte.
class FrameDecoder {
 public:
  enum class Result : uint8_t { kMore, kFrame, kBad };

  // Takes one byte. After kFrame, frame() is valid until the next call.
  Result push(uint8_t byte) {
    if (byte == 0) return finish();
    if (left_ == 0) {
      // A code byte: so many bytes to the next zero, which the code before it stood for (the code
      // 255 stands for none, but no frame is that long).
      if (begun_) append(0);
      begun_ = true;
      left_ = static_cast<uint8_t>(byte - 1);
    } else {
      append(byte);
      --left_;
    }
    return Result::kMore;
  }

  const Frame& frame() const { return frame_; }

 private:
  void append(uint8_t byte) {
    if (count_ < protocol::kMaxFrame) {
      frame_.bytes[count_++] = byte;
    } else {
      overlong_ = true;
    }
  }

  Result finish() {
    const uint8_t count = count_;
    const bool empty = !begun_;
    const bool whole = left_ == 0 && !overlong_;
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
