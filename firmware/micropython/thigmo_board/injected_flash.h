// The simulated parts that boards on injected hardware share: a byte ring and a flash.
#ifndef THIGMO_MICROPYTHON_INJECTED_FLASH_H_
#define THIGMO_MICROPYTHON_INJECTED_FLASH_H_

#include <stdint.h>

#include "flash_store.h"

namespace thigmo {

constexpr uint8_t kPasses = 4;  // of the main loop in a tick

// Bytes in order; kSize is a power of two.
template <uint16_t kSize>
class Ring {
 public:
  uint16_t size() const { return static_cast<uint16_t>(in_ - out_); }
  bool push(uint8_t byte) {
    if (size() == kSize) return false;
    bytes_[in_++ % kSize] = byte;
    return true;
  }
  const uint8_t& front() const { return bytes_[out_ % kSize]; }
  uint8_t pop() { return bytes_[out_++ % kSize]; }
  void clear() { out_ = in_; }

 private:
  uint8_t bytes_[kSize];
  uint16_t in_ = 0, out_ = 0;
};

// Two sectors of NOR flash whose power can fail at any byte.
class InjectedFlash {
 public:
  const uint8_t* data() const { return cells; }

  void erase(uint8_t sector) {
    for (uint16_t i = 0; i < kFlashSector; ++i) {
      if (!byte_survives()) return;
      cells[sector * kFlashSector + i] = 0xFF;
    }
    ++erased[sector];
  }

  void program(uint32_t address, const uint8_t* page) {
    for (uint16_t i = 0; i < kFlashPage; ++i) {
      if (page[i] != 0xFF && !byte_survives()) return;
      cells[address + i] = static_cast<uint8_t>(cells[address + i] & page[i]);
    }
  }

  uint8_t cells[2 * kFlashSector];
  uint32_t erased[2];
  uint32_t cut_after;  // bytes until the power fails; UINT32_MAX = never
  bool powered;

 private:
  bool byte_survives() {
    if (!powered) return false;
    if (cut_after == UINT32_MAX) return true;
    powered = cut_after-- != 0;
    return powered;
  }
};

}  // namespace thigmo

#endif  // THIGMO_MICROPYTHON_INJECTED_FLASH_H_
