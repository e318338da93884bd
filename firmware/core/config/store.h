// The configuration in EEPROM, and the boot counter.
//
// Two slots are written in turn, so that the older one stays whole until the newer one is: a save
// first spoils the target slot's commit byte, then writes header, configuration and check sequence,
// and sets the commit byte last. A power cut at any byte leaves a slot without commit byte, and the
// other one is loaded. One byte takes 3.4 ms, so a save proceeds a byte at a time, between other
// work; bytes that already hold their value are skipped, which spares the cells. Every byte written
// is read back.
//
// The boot counter makes each boot's nonce differ. Its bytes are written from the highest changed
// one downwards: a cut in between leaves a larger count, never one that was used before.
#ifndef THIGMO_CORE_CONFIG_STORE_H_
#define THIGMO_CORE_CONFIG_STORE_H_

#include <stdint.h>

#include "../link/frame.h"
#include "configuration.h"

namespace thigmo {

// Layout in the EEPROM.
constexpr uint16_t kCounterAt = 0;  // u32, little-endian
constexpr uint16_t kSlotAt[2] = {16, 1032};
constexpr uint16_t kSlotRoom = 1016;
// In a slot: commit byte, schema hash u32, generation u32, length u16, configuration, crc u16.
constexpr uint16_t kSlotHeader = 11;
constexpr uint16_t kSlotSize = kSlotHeader + sizeof(Configuration) + 2;
constexpr uint8_t kCommitted = 0xA5;
constexpr uint8_t kSpoiled = 0x00;
static_assert(kSlotSize <= kSlotRoom, "the configuration outgrew its slot");
static_assert(16 + 2 * kSlotRoom <= kEepromUsed, "the slots outgrew the EEPROM's used part");

// What was found at start; the value of the fault bad_config.
enum class LoadResult : uint8_t { kLoaded = 0, kBlank = 1, kDamaged = 2, kOtherSchema = 3 };

class ConfigStore {
 public:
  enum class Step : uint8_t { kIdle, kBusy, kDone, kFailed };

  uint32_t generation() const { return generation_; }  // of the newest whole slot; 0 = none
  uint8_t slot() const { return slot_; }
  bool counted() const { return counter_step_ == kCounterDone; }
  uint32_t boot_count() const { return boot_count_; }

  // Reads the newest whole slot into the configuration, or loads defaults. Blocks for about 3 ms.
  template <typename Board>
  LoadResult begin(Board& board, Configuration* configuration) {
    boot_count_ = read32(board, kCounterAt) + 1;
    LoadResult worst = LoadResult::kBlank;
    generation_ = 0;
    slot_ = 1;
    for (uint8_t slot = 0; slot < 2; ++slot) {
      const LoadResult found = check(board, slot);
      if (found == LoadResult::kLoaded) {
        const uint32_t generation = read32(board, kSlotAt[slot] + 5u);
        if (generation_ == 0 || static_cast<int32_t>(generation - generation_) > 0) {
          generation_ = generation;
          slot_ = slot;
        }
      } else if (found > worst) {
        worst = found;
      }
    }
    if (generation_ == 0) {
      configuration->load_defaults();
      return worst;
    }
    uint8_t* image = reinterpret_cast<uint8_t*>(configuration);
    for (uint16_t i = 0; i < sizeof(Configuration); ++i) {
      image[i] = board.eeprom_read(static_cast<uint16_t>(kSlotAt[slot_] + kSlotHeader + i));
    }
    if (configuration->first_out_of_range() >= 0 || configuration->first_conflict() >= 0) {
      configuration->load_defaults();
      return LoadResult::kDamaged;
    }
    return LoadResult::kLoaded;
  }

  // Starts a save of the configuration, which must not change until step() ends it.
  void save() {
    next_ = 0;
    crc_ = Crc{};
    saving_ = true;
    verify_ = false;
  }

  bool saving() const { return saving_; }

  // Does one byte's work; never blocks. To be called from the main loop.
  template <typename Board>
  Step step(Board& board, const Configuration& configuration) {
    if (!board.eeprom_ready()) return saving_ ? Step::kBusy : Step::kIdle;
    if (counter_step_ != kCounterDone) {
      step_counter(board);
      return saving_ ? Step::kBusy : Step::kIdle;
    }
    if (!saving_) return Step::kIdle;
    if (verify_) {
      verify_ = false;
      if (board.eeprom_read(address_) != byte_) {
        saving_ = false;
        return Step::kFailed;
      }
    }
    const uint8_t target = static_cast<uint8_t>(slot_ ^ 1);
    // Bytes that need no write cost no waiting; a few a call keep the loop short.
    for (uint8_t tries = 0; tries < 8; ++tries) {
      if (next_ > kSlotSize) {
        saving_ = false;
        slot_ = target;
        ++generation_;
        if (generation_ == 0) generation_ = 1;
        return Step::kDone;
      }
      uint16_t offset = next_;
      if (next_ == 0) {
        byte_ = kSpoiled;
      } else if (next_ == kSlotSize) {
        offset = 0;
        byte_ = kCommitted;
      } else {
        byte_ = image_byte(configuration, offset);
      }
      ++next_;
      address_ = static_cast<uint16_t>(kSlotAt[target] + offset);
      if (board.eeprom_read(address_) != byte_) {
        board.eeprom_write(address_, byte_);
        verify_ = true;
        return Step::kBusy;
      }
    }
    return Step::kBusy;
  }

 private:
  static constexpr uint8_t kCounterDone = 4;

  template <typename Board>
  static uint32_t read32(Board& board, uint16_t address) {
    uint32_t value = 0;
    for (uint8_t i = 4; i > 0; --i) {
      value = value << 8 | board.eeprom_read(static_cast<uint16_t>(address + i - 1));
    }
    return value;
  }

  template <typename Board>
  static LoadResult check(Board& board, uint8_t slot) {
    const uint16_t at = kSlotAt[slot];
    const uint8_t commit = board.eeprom_read(at);
    if (commit == 0xFF) return LoadResult::kBlank;
    if (commit != kCommitted) return LoadResult::kDamaged;
    if (read32(board, at + 1u) != protocol::kSchemaHash) return LoadResult::kOtherSchema;
    Crc crc;
    for (uint16_t i = 1; i < kSlotSize - 2; ++i) {
      crc.add(board.eeprom_read(static_cast<uint16_t>(at + i)));
    }
    const uint16_t stored = static_cast<uint16_t>(
        board.eeprom_read(static_cast<uint16_t>(at + kSlotSize - 2)) |
        static_cast<uint16_t>(board.eeprom_read(static_cast<uint16_t>(at + kSlotSize - 1))) << 8);
    if (crc.value() != stored || read32(board, at + 5u) == 0) return LoadResult::kDamaged;
    return LoadResult::kLoaded;
  }

  // The byte at an offset of the slot's image; offsets are asked in order, for the check sequence.
  uint8_t image_byte(const Configuration& configuration, uint16_t offset) {
    uint8_t byte;
    if (offset >= kSlotSize - 2) {
      return offset == kSlotSize - 2 ? crc_.low : crc_.high;
    }
    if (offset < 5) {
      byte = static_cast<uint8_t>(protocol::kSchemaHash >> (8 * (offset - 1)));
    } else if (offset < 9) {
      const uint32_t next = generation_ == 0xFFFFFFFFu ? 1 : generation_ + 1;
      byte = static_cast<uint8_t>(next >> (8 * (offset - 5)));
    } else if (offset < kSlotHeader) {
      byte = static_cast<uint8_t>(sizeof(Configuration) >> (8 * (offset - 9)));
    } else {
      byte = reinterpret_cast<const uint8_t*>(&configuration)[offset - kSlotHeader];
    }
    crc_.add(byte);
    return byte;
  }

  template <typename Board>
  void step_counter(Board& board) {
    const uint8_t index = static_cast<uint8_t>(3 - counter_step_);
    const uint16_t address = static_cast<uint16_t>(kCounterAt + index);
    const uint8_t byte = static_cast<uint8_t>(boot_count_ >> (8 * index));
    if (board.eeprom_read(address) != byte) {
      board.eeprom_write(address, byte);
    } else {
      ++counter_step_;
    }
  }

  uint32_t boot_count_ = 0;
  uint32_t generation_ = 0;
  uint16_t next_ = 0;
  Crc crc_;
  uint16_t address_ = 0;
  uint8_t byte_ = 0;
  uint8_t slot_ = 1;
  uint8_t counter_step_ = 0;
  bool saving_ = false;
  bool verify_ = false;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_CONFIG_STORE_H_
