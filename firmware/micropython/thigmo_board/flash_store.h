// The core's byte store on two sectors of a NOR flash.
//
// A sector holds an image of all kEepromUsed bytes, its header programmed last, and behind it a
// journal of small changes. Reads and writes meet a copy in RAM; eeprom_commit() makes what changed
// permanent: up to eight neighbouring bytes (a boot's count) as one journal entry, more (a saved
// configuration) as a new image in the other sector. Either is there whole or not at all, wherever
// the power is cut: an entry and a header carry check sequences, and the older sector stays until
// the newer one's header is programmed.
//
// Bits may flip later. A header stands twice in its page, so that one that is damaged does not
// bring back the older sector. A damaged image is handed to the core, whose slots have check
// sequences (config/store.h).
//
// Wear: a save erases one sector, a boot none until the 112 entries are full. At 100 000 erasures a
// sector that is 200 000 saves, or 22 million boots.
#ifndef THIGMO_MICROPYTHON_FLASH_STORE_H_
#define THIGMO_MICROPYTHON_FLASH_STORE_H_

#include <stdint.h>
#include <string.h>

#include "../../core/board.h"
#include "../../core/link/frame.h"

namespace thigmo {

// Of the chip, or three in a row where the core keeps more.
constexpr uint16_t kFlashSector = kEepromUsed > 2048 ? 3 * 4096 : 4096;
constexpr uint16_t kFlashPage = 256;

// Flash has `const uint8_t* data()`, both sectors in a row; `erase(sector)`; and
// `program(address, page)` of kFlashPage bytes, which clears bits and sets none.
template <typename Flash>
class FlashStore {
 public:
  explicit FlashStore(Flash& flash) : flash_(flash) {}

  // Finds the newest image and replays its journal.
  void begin() {
    memset(image_, 0xFF, sizeof image_);
    generation_ = 0;
    sector_ = 1;
    next_entry_ = kEntries;  // the first commit writes an image
    for (uint8_t sector = 0; sector < 2; ++sector) {
      for (const uint16_t place : kHeaderAt) {
        Header header;
        memcpy(&header, sector_bytes(sector) + place, sizeof header);
        if (header.check != check(header)) continue;
        if (generation_ != 0 && static_cast<int32_t>(header.generation - generation_) <= 0) {
          continue;
        }
        generation_ = header.generation;
        sector_ = sector;
      }
    }
    clean();
    if (generation_ == 0) return;
    memcpy(image_, sector_bytes(sector_) + kImageAt, sizeof image_);
    for (next_entry_ = 0; next_entry_ < kEntries; ++next_entry_) {
      Entry entry;
      memcpy(&entry, sector_bytes(sector_) + kJournalAt + next_entry_ * sizeof entry, sizeof entry);
      if (blank(entry)) break;
      if (entry.check != check(entry) || entry.count > sizeof entry.data ||
          entry.address + entry.count > kEepromUsed) {
        continue;  // its power was cut
      }
      memcpy(image_ + entry.address, entry.data, entry.count);
    }
  }

  uint8_t read(uint16_t address) const { return image_[address]; }

  void write(uint16_t address, uint8_t value) {
    image_[address] = value;
    if (address < first_) first_ = address;
    if (address > last_) last_ = address;
  }

  // Returns when all that was written is permanent.
  void commit() {
    if (first_ > last_) return;
    if (next_entry_ < kEntries && last_ - first_ < kEntryData) {
      add_entry();
    } else {
      write_image();
    }
    clean();
  }

 private:
  static constexpr uint8_t kEntryData = 8;
  struct Header {
    uint32_t generation;
    uint16_t reserved;
    uint16_t check;  // of the fields before it
  };
  struct Entry {
    uint16_t address;
    uint8_t count;
    uint8_t spare;
    uint8_t data[kEntryData];
    uint16_t reserved;
    uint16_t check;  // of the fields before it
  };
  static constexpr uint16_t kHeaderAt[2] = {0, kFlashPage / 2};
  static constexpr uint16_t kImageAt = kFlashPage;
  static constexpr uint16_t kJournalAt = kImageAt + kEepromUsed;
  static constexpr uint16_t kEntries = (kFlashSector - kJournalAt) / sizeof(Entry);
  static_assert(kFlashPage % sizeof(Entry) == 0, "an entry lies in one page");

  const uint8_t* sector_bytes(uint8_t sector) const {
    return flash_.data() + sector * kFlashSector;
  }

  template <typename Record>
  static uint16_t check(const Record& record) {
    return crc16(reinterpret_cast<const uint8_t*>(&record),
                 static_cast<uint8_t>(sizeof record - sizeof record.check));
  }

  static bool blank(const Entry& entry) {
    const uint8_t* const bytes = reinterpret_cast<const uint8_t*>(&entry);
    for (uint8_t i = 0; i < sizeof entry; ++i) {
      if (bytes[i] != 0xFF) return false;
    }
    return true;
  }

  void clean() {
    first_ = kEepromUsed;
    last_ = 0;
  }

  void add_entry() {
    Entry entry;
    memset(&entry, 0, sizeof entry);
    entry.address = first_;
    entry.count = static_cast<uint8_t>(last_ - first_ + 1);
    memcpy(entry.data, image_ + first_, entry.count);
    entry.check = check(entry);
    const uint16_t place = static_cast<uint16_t>(kJournalAt + next_entry_ * sizeof entry);
    uint8_t page[kFlashPage];
    memset(page, 0xFF, sizeof page);
    memcpy(page + place % kFlashPage, &entry, sizeof entry);
    flash_.program(sector_ * kFlashSector + place / kFlashPage * kFlashPage, page);
    ++next_entry_;
  }

  void write_image() {
    const uint8_t sector = static_cast<uint8_t>(sector_ ^ 1);
    const uint32_t base = static_cast<uint32_t>(sector) * kFlashSector;
    flash_.erase(sector);
    for (uint16_t done = 0; done < kEepromUsed; done = static_cast<uint16_t>(done + kFlashPage)) {
      flash_.program(base + kImageAt + done, image_ + done);
    }
    Header header;
    header.generation = generation_ + 1 == 0 ? 1 : generation_ + 1;
    header.reserved = 0;
    header.check = check(header);
    uint8_t page[kFlashPage];
    memset(page, 0xFF, sizeof page);
    for (const uint16_t place : kHeaderAt) memcpy(page + place, &header, sizeof header);
    flash_.program(base, page);
    generation_ = header.generation;
    sector_ = sector;
    next_entry_ = 0;
  }

  Flash& flash_;
  uint8_t image_[kEepromUsed];
  uint32_t generation_;
  uint16_t first_, last_;  // changed since the last commit
  uint16_t next_entry_;
  uint8_t sector_;
};

template <typename Flash>
constexpr uint16_t FlashStore<Flash>::kHeaderAt[2];

}  // namespace thigmo

#endif  // THIGMO_MICROPYTHON_FLASH_STORE_H_
