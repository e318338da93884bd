// The byte store on flash: power cut at any byte, worn little, kept whole.
#ifndef THIGMO_TESTS_FIRMWARE_FLASH_STORE_CASES_H_
#define THIGMO_TESTS_FIRMWARE_FLASH_STORE_CASES_H_

#include <cstring>
#include <memory>
#include <random>
#include <vector>

#include "../../../firmware/micropython/thigmo_board/flash_store.h"
#include "check.h"

namespace flash_store_cases {

using namespace thigmo;

// NOR flash: programs clear bits; power can fail in any byte, which then holds anything between.
struct Flash {
  uint8_t cells[2 * kFlashSector];
  long cut_after = -1;  // bytes until the power fails; -1 = never
  long bytes = 0;
  int erased = 0;
  bool dead = false;
  uint8_t garbage = 0;
  Flash() { std::memset(cells, 0xFF, sizeof cells); }
  const uint8_t* data() const { return cells; }
  bool survives() {
    if (dead) return false;
    dead = bytes++ == cut_after;
    return !dead;
  }
  void erase(uint8_t sector) {
    ++erased;
    for (int i = 0; i < kFlashSector && !dead; ++i) {
      uint8_t& cell = cells[sector * kFlashSector + i];
      cell = survives() ? 0xFF : static_cast<uint8_t>(cell | garbage);
    }
  }
  void program(uint32_t address, const uint8_t* page) {
    for (int i = 0; i < kFlashPage && !dead; ++i) {
      uint8_t& cell = cells[address + i];
      const uint8_t wanted = static_cast<uint8_t>(cell & page[i]);
      if (page[i] == 0xFF) continue;
      cell = survives() ? wanted : static_cast<uint8_t>(wanted | (cell & garbage));
    }
  }
};

using Image = std::vector<uint8_t>;

inline Image image(const FlashStore<Flash>& store) {
  Image bytes;
  for (uint16_t i = 0; i < kEepromUsed; ++i) bytes.push_back(store.read(i));
  return bytes;
}

inline Image reboot(Flash& flash) {
  FlashStore<Flash> store(flash);
  flash.dead = false;
  flash.cut_after = -1;
  store.begin();
  return image(store);
}

inline void write_all(FlashStore<Flash>& store, uint32_t seed) {
  std::mt19937 random(seed);
  for (uint16_t i = 0; i < kEepromUsed; ++i) store.write(i, static_cast<uint8_t>(random()));
}

TEST(a_blank_flash_is_a_blank_store) {
  Flash flash;
  CHECK(reboot(flash) == Image(kEepromUsed, 0xFF));
}

TEST(what_is_committed_is_there_and_what_is_not_is_not) {
  Flash flash;
  FlashStore<Flash> store(flash);
  store.begin();
  write_all(store, 1);
  CHECK(reboot(flash) == Image(kEepromUsed, 0xFF));
  store.commit();
  CHECK(reboot(flash) == image(store));
}

TEST(a_power_cut_at_any_byte_of_the_flash_leaves_the_old_or_the_new) {
  for (const uint8_t garbage : {0x00, 0xA5, 0xFF}) {
    // An image over an old one, and over a blank flash; a boot's count as a journal entry.
    for (int kind = 0; kind < 3; ++kind) {
      for (long cut = 0;; ++cut) {
        Flash flash;
        FlashStore<Flash> store(flash);
        store.begin();
        if (kind != 1) {
          for (uint32_t n = 0; n < 2; ++n) {
            write_all(store, n);
            store.commit();
          }
          store.write(3, 0x77);
          store.commit();
        }
        const Image before = image(store);
        if (kind == 2) {
          for (uint16_t i = 0; i < 4; ++i) store.write(i, static_cast<uint8_t>(i + 1));
        } else {
          write_all(store, 9);
        }
        const Image after = image(store);
        flash.bytes = 0;
        flash.cut_after = cut;
        flash.garbage = garbage;
        store.commit();
        const bool was_cut = flash.dead;
        const Image kept = reboot(flash);
        CHECK(kept == before || kept == after);
        if (!was_cut) {
          CHECK(kept == after);
          break;
        }
        // And the store works on: what comes next is kept.
        FlashStore<Flash> next(flash);
        next.begin();
        next.write(1000, 0x42);
        next.commit();
        CHECK_EQUAL(reboot(flash)[1000], 0x42);
        CHECK_EQUAL(reboot(flash)[3], kept[3]);
        if (cut > 40 && cut < kFlashSector - 40) cut += 37;  // far from what decides
      }
    }
  }
}

TEST(no_flipped_bit_brings_the_older_sector_back) {
  Flash good;
  FlashStore<Flash> store(good);
  store.begin();
  for (uint32_t n = 0; n < 2; ++n) {
    write_all(store, n);
    store.commit();
  }
  const Image newest = image(store);
  // What is damaged is handed on as it is: the core's slots have check sequences.
  const auto flipped_bits = [&newest](const Image& damaged) {
    int bits = 0;
    for (size_t i = 0; i < damaged.size(); ++i) {
      for (int left = damaged[i] ^ newest[i]; left != 0; left &= left - 1) ++bits;
    }
    return bits;
  };
  for (uint32_t bit = 0; bit < 8 * kFlashSector; bit += bit < 8 * kFlashPage ? 1 : 37) {
    Flash flash = good;
    flash.cells[kFlashSector + bit / 8] ^= static_cast<uint8_t>(1u << bit % 8);
    CHECK(flipped_bits(reboot(flash)) <= 1);
  }
}

TEST(a_boot_wears_no_sector_until_its_journal_is_full) {
  Flash flash;
  FlashStore<Flash> store(flash);
  store.begin();
  const int boots = 1000;
  for (uint32_t boot = 0; boot < boots; ++boot) {
    store.begin();
    std::vector<uint8_t> count(4);
    std::memcpy(count.data(), &boot, 4);
    for (uint16_t i = 0; i < 4; ++i) store.write(i, count[i]);
    store.commit();
    CHECK(std::equal(count.begin(), count.end(), reboot(flash).begin()));
  }
  CHECK(flash.erased <= boots / 112 + 2);
}

}  // namespace flash_store_cases

#endif  // THIGMO_TESTS_FIRMWARE_FLASH_STORE_CASES_H_
