// The configuration in EEPROM, and the boot counter.
//
// A slot holds entries: id, type, count and values of each parameter, and of the maps as one. Ids
// are for ever (protocol/schema.yaml), so a firmware reads what another one stored: what it does
// not know it leaves out, what is missing stays at its default, and StoredReport tells both.
//
// Two slots are written in turn, so that the older one stays whole until the newer one is: a save
// first spoils the target slot's commit byte, then writes header, configuration and check sequence,
// and sets the commit byte last. A power cut in between leaves a spoiled slot, and the other one is
// loaded. One byte takes 3.4 ms, so a save proceeds a byte at a time, between other work; bytes
// that already hold their value are skipped, which spares the cells. Every byte written is read
// back.
//
// A slot that was committed and fails its check is damaged, and so is one whose commit byte is none
// of blank, spoiled and committed: the other slot's configuration may be an older one then, so the
// robot is not armed until a host has saved. Only a commit byte of which three bits (to blank) or
// five (to spoiled) flipped looks like a save that was cut. A power cut while the commit byte
// itself is being written may leave any value in it, and then counts as damage.
//
// The boot counter makes each boot's nonce differ. It is the sum of four, the first of which is
// raised; if a cell of that is worn, the next one is. Its bytes are written from the highest
// changed one downwards: a cut in between leaves a larger count, never one that was used before.
#ifndef THIGMO_CORE_CONFIG_STORE_H_
#define THIGMO_CORE_CONFIG_STORE_H_

#include <stdint.h>

#include "../link/frame.h"
#include "configuration.h"

namespace thigmo {

// Layout in the EEPROM.
constexpr uint16_t kCounterAt = 0;  // four of u32, little-endian
constexpr uint8_t kCounters = 4;
constexpr uint16_t kSlotRoom = kEepromUsed / 2 - 8;
constexpr uint16_t kSlotAt[2] = {16, 16 + kSlotRoom};
// In a slot: commit byte, generation u32, length of the entries u16, entries, crc u16 from the
// generation on.
constexpr uint16_t kSlotHeader = 7;
constexpr uint16_t kSlotMost = kSlotRoom - kSlotHeader - 2;  // bytes of entries
// An entry: id, bytes of a value, number of values, values (signed, little-endian).
constexpr uint8_t kEntryHeader = 3;
// Of the maps: points, or whole maps where a byte does not hold the number of points.
constexpr uint16_t kMapPointCount = kBodyPressures * kMuscles * kBranches * protocol::kMapPoints;
constexpr uint8_t kMapWidth = kMapPointCount <= 255 ? 2 : 2 * protocol::kMapPoints;
constexpr uint8_t kMapCount = kMapPointCount * 2 / kMapWidth;
constexpr uint16_t kEntriesSize = kEntryHeader * (protocol::kParamKeys + 1) + sizeof(Configuration);
constexpr uint16_t kSlotSize = kSlotHeader + kEntriesSize + 2;
constexpr uint8_t kCommitted = 0xA7;
constexpr uint8_t kSpoiled = 0x00;
constexpr uint8_t kNeverWritten = 0xFF;
static_assert(kSlotSize <= kSlotRoom, "the configuration outgrew its slot");
static_assert(16 + 2 * kSlotRoom <= kEepromUsed, "the slots outgrew the EEPROM's used part");

// What the start came to; beside `kLoaded`, the value of the fault bad_config. In the order in
// which one slot's trouble outweighs the other's.
enum class LoadResult : uint8_t {
  kLoaded = 0,
  kBlank = static_cast<uint8_t>(protocol::ConfigCause::kBlank),
  kInterrupted = static_cast<uint8_t>(protocol::ConfigCause::kInterrupted),
  kDamaged = static_cast<uint8_t>(protocol::ConfigCause::kDamaged),
  kOutOfLimits = static_cast<uint8_t>(protocol::ConfigCause::kOutOfLimits),
};

// A list of ids: all are counted, the first eight are kept.
struct IdList {
  uint8_t count = 0;
  uint8_t id[8] = {};

  void add(uint8_t entry) {
    if (count < sizeof(id)) id[count] = entry;
    ++count;
  }
};

// How the stored configuration fits this firmware.
struct StoredReport {
  uint8_t kept = 0;
  IdList fresh;    // parameters that were not stored
  IdList unknown;  // stored, but not of this firmware
};

class ConfigStore {
 public:
  enum class Step : uint8_t { kIdle, kBusy, kDone, kFailed };

  uint32_t generation() const { return generation_; }  // of the newest whole slot; 0 = none
  uint8_t slot() const { return slot_; }
  bool counted() const { return counter_step_ == kCounterDone; }
  uint32_t boot_count() const { return boot_count_; }
  const StoredReport& report() const { return report_; }

  // Reads the newest whole slot into the configuration, or loads defaults. If the other slot is
  // damaged, what was read may be out of date, and the result is kDamaged. Blocks for about 3 ms.
  template <typename Board>
  LoadResult begin(Board& board, Configuration* configuration) {
    boot_count_ = kCounters;  // blank ones are -1 each: the first boot is number 0
    for (uint8_t i = 0; i < kCounters; ++i) boot_count_ += read32(board, counter_at(i));
    raised_ = read32(board, kCounterAt) + 1;
    LoadResult worst = LoadResult::kBlank;
    generation_ = 0;
    slot_ = 1;
    for (uint8_t slot = 0; slot < 2; ++slot) {
      const LoadResult state = check(board, slot);
      if (state == LoadResult::kLoaded) {
        const uint32_t generation = read32(board, kSlotAt[slot] + 1u);
        if (generation_ == 0 || static_cast<int32_t>(generation - generation_) > 0) {
          generation_ = generation;
          slot_ = slot;
        }
      } else if (state > worst) {
        worst = state;
      }
    }
    configuration->load_defaults();
    if (generation_ == 0) return worst;
    LoadResult result = LoadResult::kLoaded;
    if (!read_entries(board, configuration)) {
      result = LoadResult::kDamaged;
    } else if (configuration->first_out_of_range() >= 0 || configuration->first_conflict() >= 0) {
      result = LoadResult::kOutOfLimits;
    }
    // Never some of the stored values beside some defaults.
    if (result != LoadResult::kLoaded) configuration->load_defaults();
    return worst == LoadResult::kDamaged ? worst : result;
  }

  // Starts a save of the configuration, which must not change until step() ends it.
  void save() {
    next_ = 0;
    entry_ = 0;
    entry_offset_ = 0;
    values_ = 0;
    crc_ = Crc{};
    saving_ = true;
    verify_ = false;
    committed_ = false;
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
    for (uint8_t tries = 0; tries < 3; ++tries) {
      if (next_ > kSlotSize) {
        if (!committed_) {
          committed_ = true;
          board.eeprom_commit();
          return Step::kBusy;
        }
        saving_ = false;
        slot_ = target;
        ++generation_;
        if (generation_ == 0) generation_ = 1;
        report_ = StoredReport{};
        report_.kept = protocol::kParamKeys + 1;
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
  // Steps of the boot counter: its four bytes, highest first; then these.
  static constexpr uint8_t kCounterCommit = 4;
  static constexpr uint8_t kCounterWait = 5;
  static constexpr uint8_t kCounterDone = 6;
  static constexpr uint8_t kTries = 3;  // to write a cell

  static constexpr uint16_t counter_at(uint8_t counter) {
    return static_cast<uint16_t>(kCounterAt + 4 * counter);
  }

  template <typename Board>
  static uint32_t read32(Board& board, uint16_t address) {
    uint32_t value = 0;
    for (uint8_t i = 4; i > 0; --i) {
      value = value << 8 | board.eeprom_read(static_cast<uint16_t>(address + i - 1));
    }
    return value;
  }

  template <typename Board>
  static uint16_t read16(Board& board, uint16_t address) {
    return static_cast<uint16_t>(
        board.eeprom_read(address) |
        static_cast<uint16_t>(board.eeprom_read(static_cast<uint16_t>(address + 1))) << 8);
  }

  template <typename Board>
  static LoadResult check(Board& board, uint8_t slot) {
    const uint16_t start = kSlotAt[slot];
    const uint8_t commit = board.eeprom_read(start);
    if (commit == kNeverWritten) return LoadResult::kBlank;
    if (commit == kSpoiled) return LoadResult::kInterrupted;
    if (commit != kCommitted) return LoadResult::kDamaged;
    const uint16_t length = read16(board, start + 5u);
    if (length > kSlotMost) return LoadResult::kDamaged;
    const uint16_t end = static_cast<uint16_t>(start + kSlotHeader + length);
    Crc crc;
    for (uint16_t i = static_cast<uint16_t>(start + 1); i < end; ++i) crc.add(board.eeprom_read(i));
    if (board.eeprom_read(end) != crc.low ||
        board.eeprom_read(static_cast<uint16_t>(end + 1)) != crc.high ||
        read32(board, start + 1u) == 0) {
      return LoadResult::kDamaged;
    }
    return LoadResult::kLoaded;
  }

  // A kind of entry as this firmware has it: the parameters in the order of their indices, then the
  // maps. In the order of their places in Configuration, which has no holes.
  struct Kind {
    uint8_t id;
    uint8_t width;  // bytes of a value
    uint8_t count;
    uint16_t size() const { return static_cast<uint16_t>(width * count); }
  };

  static Kind kind(uint8_t index) {
    if (index == protocol::kParamKeys) return {protocol::kMapId, kMapWidth, kMapCount};
    const protocol::ParamKey* const key = protocol::kParamKeyTable + index;
    return {THIGMO_FLASH_U8(&key->id), 4, THIGMO_FLASH_U8(&key->count)};
  }

  // Takes over the entries of the newest slot; false if they do not add up to its length.
  template <typename Board>
  bool read_entries(Board& board, Configuration* configuration) {
    uint8_t* const image = reinterpret_cast<uint8_t*>(configuration);
    uint8_t stored_mask[(protocol::kParamKeys + 8) / 8] = {};
    report_ = StoredReport{};
    uint16_t address = static_cast<uint16_t>(kSlotAt[slot_] + kSlotHeader);
    const uint16_t end = static_cast<uint16_t>(address + read16(board, address - 2u));
    while (address != end) {
      const Kind stored = {board.eeprom_read(address),
                           board.eeprom_read(static_cast<uint16_t>(address + 1)),
                           board.eeprom_read(static_cast<uint16_t>(address + 2))};
      address = static_cast<uint16_t>(address + kEntryHeader);
      if (address > end || end - address < stored.size()) return false;
      uint16_t place = 0;
      uint8_t index = 0;
      Kind known = kind(0);
      while (known.id != stored.id && index < protocol::kParamKeys) {
        place = static_cast<uint16_t>(place + known.size());
        known = kind(++index);
      }
      if (known.id == stored.id && known.width == stored.width && known.count == stored.count) {
        for (uint16_t i = 0; i < stored.size(); ++i) {
          image[place + i] = board.eeprom_read(static_cast<uint16_t>(address + i));
        }
        stored_mask[index / 8] = static_cast<uint8_t>(stored_mask[index / 8] | 1u << index % 8);
        ++report_.kept;
      } else {
        report_.unknown.add(stored.id);
      }
      address = static_cast<uint16_t>(address + stored.size());
    }
    for (uint8_t i = 0; i <= protocol::kParamKeys; ++i) {
      if ((stored_mask[i / 8] >> i % 8 & 1) == 0) report_.fresh.add(kind(i).id);
    }
    return true;
  }

  // The byte at an offset of the slot's image; offsets are asked in order, each once, for the check
  // sequence and the place among the entries.
  uint8_t image_byte(const Configuration& configuration, uint16_t offset) {
    uint8_t byte;
    if (offset >= kSlotSize - 2) {
      return offset == kSlotSize - 2 ? crc_.low : crc_.high;
    }
    if (offset < 5) {
      const uint32_t next = generation_ == 0xFFFFFFFFu ? 1 : generation_ + 1;
      byte = static_cast<uint8_t>(next >> (8 * (offset - 1)));
    } else if (offset < kSlotHeader) {
      byte = static_cast<uint8_t>(kEntriesSize >> (8 * (offset - 5)));
    } else {
      byte = entry_byte(configuration);
    }
    crc_.add(byte);
    return byte;
  }

  uint8_t entry_byte(const Configuration& configuration) {
    const Kind now = kind(entry_);
    const uint16_t offset = entry_offset_++;
    if (offset == 0) return now.id;
    if (offset == 1) return now.width;
    if (offset == 2) return now.count;
    if (entry_offset_ == kEntryHeader + now.size()) {
      ++entry_;
      entry_offset_ = 0;
    }
    return reinterpret_cast<const uint8_t*>(&configuration)[values_++];
  }

  template <typename Board>
  void step_counter(Board& board) {
    if (counter_step_ >= kCounterCommit) {
      if (counter_step_ == kCounterCommit) board.eeprom_commit();
      ++counter_step_;
      return;
    }
    const uint8_t index = static_cast<uint8_t>(3 - counter_step_);
    const uint16_t address = static_cast<uint16_t>(counter_at(counter_) + index);
    const uint8_t byte = static_cast<uint8_t>(raised_ >> (8 * index));
    if (board.eeprom_read(address) == byte) {
      ++counter_step_;
      tries_ = 0;
    } else if (tries_ < kTries) {
      board.eeprom_write(address, byte);
      ++tries_;
    } else if (++counter_ < kCounters) {
      raised_ = read32(board, counter_at(counter_)) + 1;
      counter_step_ = 0;
      tries_ = 0;
    } else {
      counter_step_ = kCounterCommit;  // all are worn: the robot must start nevertheless
    }
  }

  uint32_t boot_count_ = 0;
  uint32_t raised_ = 0;  // the counter that is written, one more
  uint32_t generation_ = 0;
  StoredReport report_;
  uint16_t next_ = 0;
  uint16_t entry_offset_ = 0;  // byte of the entry in work
  uint16_t values_ = 0;        // bytes of the configuration written
  uint8_t entry_ = 0;
  Crc crc_;
  uint16_t address_ = 0;
  uint8_t byte_ = 0;
  uint8_t slot_ = 1;
  uint8_t counter_step_ = 0;
  uint8_t counter_ = 0;
  uint8_t tries_ = 0;
  bool saving_ = false;
  bool verify_ = false;
  bool committed_ = false;  // what was written last
};

}  // namespace thigmo

#endif  // THIGMO_CORE_CONFIG_STORE_H_
