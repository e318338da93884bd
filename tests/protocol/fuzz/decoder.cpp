// Any stream into the frame decoder, in any parts: nothing but frames comes out, and each of them,
// sent again, comes out the same.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>

#include "../../../firmware/core/link/frame.h"

using thigmo::Frame;
using thigmo::FrameDecoder;

static void require(bool condition) {
  if (!condition) std::abort();
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  FrameDecoder decoder, whole;
  uint8_t taken;
  size_t part = 0;
  for (size_t i = 0; i < size; ++i) {
    const FrameDecoder::Result result = decoder.push(data + i, 1, &taken);
    if (data[i] == 0 || i - part == 39) {
      require(whole.push(data + part, static_cast<uint8_t>(i + 1 - part), &taken) == result);
      part = i + 1;
    }
    if (result != FrameDecoder::Result::kFrame) continue;
    const Frame& frame = decoder.frame();
    require(whole.frame().size == frame.size);
    require(std::memcmp(whole.frame().bytes, frame.bytes, frame.size) == 0);
    require(frame.size >= thigmo::protocol::kHeaderSize);
    require(frame.size <= thigmo::protocol::kMaxFrame - thigmo::protocol::kCrcSize);
    uint8_t wire[thigmo::protocol::kMaxWire];
    const uint8_t count = thigmo::encode(frame, wire);
    require(count <= thigmo::protocol::kMaxWire);
    FrameDecoder again;
    for (uint8_t k = 0; k + 1 < count; ++k) require(wire[k] != 0);
    require(again.push(wire, count, &taken) == FrameDecoder::Result::kFrame);
    require(again.frame().size == frame.size);
    require(std::memcmp(again.frame().bytes, frame.bytes, frame.size) == 0);
  }
  return 0;
}
