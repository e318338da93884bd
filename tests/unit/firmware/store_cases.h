// The configuration store: power cut at every byte, worn cells, boot counter.
#ifndef THIGMO_TESTS_FIRMWARE_STORE_CASES_H_
#define THIGMO_TESTS_FIRMWARE_STORE_CASES_H_

#include <algorithm>
#include <cstring>

#include "check.h"
#include "config/store.h"

namespace store_cases {

using namespace thigmo;

// An EEPROM that can lose power in the middle of a byte, and wear out.
struct Eeprom {
  uint8_t cells[kEepromUsed];
  int writes = 0;
  int commits = 0;
  int cut_at = -1;  // the write that is cut; -1 = none
  uint8_t garbage = 0;
  int worn = -1;  // a cell that keeps its value
  bool dead = false;
  Eeprom() { std::memset(cells, 0xFF, sizeof(cells)); }
  bool eeprom_ready() { return true; }
  uint8_t eeprom_read(uint16_t address) { return cells[address]; }
  void eeprom_commit() { ++commits; }
  void eeprom_write(uint16_t address, uint8_t value) {
    if (writes++ == cut_at) {
      cells[address] = garbage;
      dead = true;
    } else if (address != worn) {
      cells[address] = value;
    }
  }
};

inline LoadResult boot(Eeprom& eeprom, ConfigStore& store, Configuration& c) {
  const LoadResult result = store.begin(eeprom, &c);
  for (int i = 0; i < 40 && !store.counted() && !eeprom.dead; ++i) store.step(eeprom, c);
  return result;
}

inline bool save(Eeprom& eeprom, ConfigStore& store, const Configuration& c) {
  store.save();
  for (int i = 0; i < 5000 && !eeprom.dead; ++i) {
    const ConfigStore::Step step = store.step(eeprom, c);
    if (step == ConfigStore::Step::kDone) return true;
    if (step == ConfigStore::Step::kFailed) return false;
  }
  return false;
}

inline Configuration config(uint32_t seed) {
  Configuration c;
  std::mt19937 random(seed);
  c.load_defaults();
  for (uint8_t i = 0; i < kSensors; ++i) {
    CHECK(c.set(static_cast<uint16_t>(static_cast<uint16_t>(Param::kFlexScale) + i),
                static_cast<int32_t>(random() % 1000000)));
  }
  for (auto& zone : c.map) {
    for (auto& side : zone) {
      for (auto& branch : side) {
        for (int16_t& point : branch) point = static_cast<int16_t>(random());
      }
    }
  }
  return c;
}

inline bool same(const Configuration& a, const Configuration& b) {
  return std::memcmp(&a, &b, sizeof(a)) == 0;
}

// A store that has booted.
struct Booted {
  Eeprom eeprom;
  ConfigStore store;
  Configuration c;
  LoadResult result = boot(eeprom, store, c);
};

// And in which a configuration was saved.
struct Saved : Booted {
  Saved() { CHECK(save(eeprom, store, config(1))); }
  // The next start: what it loads, and what it says of that.
  LoadResult again() {
    store = ConfigStore();
    return boot(eeprom, store, c);
  }
};

TEST(a_blank_store_gives_defaults_and_says_so) {
  Booted blank;
  CHECK(blank.result == LoadResult::kBlank);
  Configuration defaults;
  defaults.load_defaults();
  CHECK(same(blank.c, defaults));
  CHECK_EQUAL(blank.store.generation(), 0u);
}

TEST(a_stored_value_outside_its_limits_or_against_another_is_bad_and_no_silent_default) {
  const auto stored = [](Param name, int32_t value) {
    Saved s;
    Configuration c = config(7);
    c.value[static_cast<uint16_t>(name)] = value;
    CHECK(save(s.eeprom, s.store, c));
    const LoadResult result = s.again();
    Configuration defaults;
    defaults.load_defaults();
    CHECK(same(s.c, result == LoadResult::kLoaded ? c : defaults));
    return result;
  };
  CHECK(stored(Param::kMaxPressureCpsi, 1800) == LoadResult::kLoaded);
  CHECK(stored(Param::kMaxPressureCpsi, 6000) == LoadResult::kOutOfLimits);
  CHECK(stored(Param::kVentCpsi, 4) == LoadResult::kOutOfLimits);
  CHECK(stored(Param::kOverPressureCpsi, 1700) == LoadResult::kOutOfLimits);
  CHECK(stored(Param::kHeartbeatMs, 5000) == LoadResult::kOutOfLimits);
}

TEST(a_save_is_done_and_a_boot_counted_after_the_commit_only) {
  struct Slow : Eeprom {
    int busy = 0;  // questions until it is ready again
    int written_last = 0;
    bool eeprom_ready() { return busy == 0 || --busy == 0; }
    void eeprom_commit() {
      ++commits;
      written_last = writes;
      busy = 5;
    }
  };
  Slow eeprom;
  ConfigStore store;
  Configuration c;
  store.begin(eeprom, &c);
  const auto until = [&](auto done) {
    for (int i = 0; i < 5000 && !done(); ++i) {
    }
  };
  until([&] {
    store.step(eeprom, c);
    return store.counted();
  });
  CHECK(store.counted() && eeprom.commits == 1 && eeprom.busy == 0);
  store.save();
  until([&] { return store.step(eeprom, c) == ConfigStore::Step::kDone; });
  CHECK_EQUAL(eeprom.commits, 2);
  CHECK_EQUAL(eeprom.written_last, eeprom.writes);
  CHECK_EQUAL(eeprom.busy, 0);
}

TEST(saves_alternate_slots_and_the_newest_is_loaded) {
  Eeprom eeprom;
  for (uint32_t round = 1; round <= 6; ++round) {
    ConfigStore store;
    Configuration c;
    const LoadResult result = boot(eeprom, store, c);
    if (round > 1) {
      CHECK(result == LoadResult::kLoaded);
      CHECK(same(c, config(round - 1)));
    }
    CHECK(save(eeprom, store, config(round)));
    CHECK_EQUAL(store.generation(), round);
    CHECK_EQUAL(store.slot(), (round - 1) % 2);
  }
}

TEST(a_power_cut_at_any_byte_keeps_a_whole_configuration) {
  Saved twice;
  CHECK(save(twice.eeprom, twice.store, config(2)));
  const Eeprom& before = twice.eeprom;
  const Configuration old = config(2);
  const Configuration wanted = config(3);
  int cuts = 0, strange = 0;
  for (int cut = 0;; ++cut) {
    bool cut_happened = false;
    for (const int garbage : {0x00, 0xFF, 0xA5, 0xA7}) {
      Eeprom eeprom = before;
      ConfigStore store;
      Configuration c;
      boot(eeprom, store, c);
      CHECK(same(c, old));
      eeprom.cut_at = eeprom.writes + cut;
      eeprom.garbage = static_cast<uint8_t>(garbage);
      const bool saved = save(eeprom, store, wanted);
      cut_happened = cut_happened || eeprom.dead;
      CHECK(saved != eeprom.dead);
      // The slot in work is spoiled before anything else is touched.
      if (eeprom.dead && cut > 0 && garbage != kCommitted) {
        CHECK(eeprom.cells[kSlotAt[0]] != kCommitted);
      }
      eeprom.dead = false;
      eeprom.cut_at = -1;
      ConfigStore next;
      Configuration loaded;
      const LoadResult result = boot(eeprom, next, loaded);
      // Old or new, but whole; new only when the commit byte itself happened to be right. A commit
      // byte that holds anything else is no silence.
      const bool is_new = same(loaded, wanted);
      const uint8_t commit = eeprom.cells[kSlotAt[0]];
      const bool spoiled = commit == kSpoiled || commit == kNeverWritten || commit == kCommitted;
      CHECK(result == (spoiled ? LoadResult::kLoaded : LoadResult::kDamaged));
      CHECK(is_new || same(loaded, old));
      strange += !spoiled;
      CHECK_EQUAL(next.generation(), is_new ? 3u : 2u);
      // And the next save works.
      CHECK(save(eeprom, next, config(4)));
      ConfigStore last;
      CHECK(boot(eeprom, last, loaded) == LoadResult::kLoaded);
      CHECK(same(loaded, config(4)));
    }
    if (!cut_happened) break;
    ++cuts;
  }
  CHECK(cuts > 250);        // the bytes that differ
  CHECK_EQUAL(strange, 2);  // cuts of the commit byte's own writes: spoiled, then committed
}

TEST(a_power_cut_in_the_first_save_leaves_none) {
  for (int cut = 0; cut < 700; cut += 13) {
    Booted b;
    b.eeprom.cut_at = b.eeprom.writes + cut;
    b.eeprom.garbage = 0x33;
    if (save(b.eeprom, b.store, config(1))) break;
    b.eeprom.dead = false;
    ConfigStore next;
    const LoadResult result = boot(b.eeprom, next, b.c);
    CHECK(result == (cut == 0 ? LoadResult::kDamaged : LoadResult::kInterrupted));
    CHECK_EQUAL(next.generation(), 0u);
  }
}

TEST(any_flipped_byte_of_the_only_slot_is_found) {
  const Saved good;
  for (uint16_t i = 0; i < kSlotSize; ++i) {
    Saved s = good;
    s.eeprom.cells[kSlotAt[0] + i] ^= 0x10;
    CHECK(s.again() != LoadResult::kLoaded);
  }
}

TEST(no_flipped_bit_of_either_slot_brings_an_older_configuration_back_in_silence) {
  Saved twice;
  CHECK(save(twice.eeprom, twice.store, config(2)));
  for (const uint8_t slot : {0, 1}) {
    for (uint16_t bit = 0; bit < 8 * kSlotSize; ++bit) {
      Saved s = twice;
      s.eeprom.cells[kSlotAt[slot] + bit / 8] ^= static_cast<uint8_t>(1u << bit % 8);
      CHECK(s.again() == LoadResult::kDamaged);
      CHECK(same(s.c, config(slot == 1 ? 1 : 2)));
    }
  }
  // Stored anew, it is whole, and stays so.
  twice.eeprom.cells[kSlotAt[1] + 100] ^= 4;
  CHECK(twice.again() == LoadResult::kDamaged);
  CHECK(save(twice.eeprom, twice.store, config(3)));
  CHECK(twice.again() == LoadResult::kLoaded);
  CHECK(same(twice.c, config(3)));
}

TEST(three_flipped_bits_of_the_commit_byte_are_the_fewest_that_look_like_a_cut_save) {
  Saved twice;
  CHECK(save(twice.eeprom, twice.store, config(2)));
  int fewest = 8;
  for (int flips = 1; flips < 256; ++flips) {
    Saved s = twice;
    s.eeprom.cells[kSlotAt[1]] ^= static_cast<uint8_t>(flips);
    int bits = 0;
    for (int left = flips; left != 0; left &= left - 1) ++bits;
    if (s.again() == LoadResult::kLoaded) fewest = std::min(fewest, bits);
  }
  CHECK_EQUAL(fewest, 3);
}

using Entry = std::vector<uint8_t>;

// The entries of the first slot.
inline std::vector<Entry> entries(const Eeprom& eeprom) {
  const uint8_t* at = eeprom.cells + kSlotAt[0] + kSlotHeader;
  const uint8_t* const end = at + (at[-2] | at[-1] << 8);
  std::vector<Entry> parts;
  while (at < end) {
    parts.emplace_back(at, at + kEntryHeader + at[1] * at[2]);
    at += parts.back().size();
  }
  return parts;
}

// Puts other entries there, as another firmware would have stored them.
inline void put(Eeprom& eeprom, const std::vector<Entry>& wanted) {
  uint8_t* const slot = eeprom.cells + kSlotAt[0];
  uint8_t* at = slot + kSlotHeader;
  for (const Entry& entry : wanted) {
    std::memcpy(at, entry.data(), entry.size());
    at += entry.size();
  }
  const size_t length = static_cast<size_t>(at - slot) - kSlotHeader;
  CHECK(length <= kSlotMost);
  slot[5] = static_cast<uint8_t>(length);
  slot[6] = static_cast<uint8_t>(length >> 8);
  Crc crc;
  for (const uint8_t* byte = slot + 1; byte != at; ++byte) crc.add(*byte);
  at[0] = crc.low;
  at[1] = crc.high;
}

inline uint16_t index_of(uint8_t key) {
  uint16_t index = 0;
  for (uint8_t i = 0; i < key; ++i) {
    index = static_cast<uint16_t>(index + protocol::kParamKeyTable[i].count);
  }
  return index;
}

TEST(another_firmwares_parameters_are_kept_by_their_ids) {
  const Saved s;
  const Eeprom& saved = s.eeprom;
  const Configuration stored = config(1);
  CHECK_EQUAL(s.store.report().kept, protocol::kParamKeys + 1);
  const std::vector<Entry> whole = entries(saved);
  CHECK_EQUAL(whole.size(), protocol::kParamKeys + 1u);
  const auto load = [&saved](const std::vector<Entry>& wanted, ConfigStore& next) {
    Eeprom eeprom = saved;
    put(eeprom, wanted);
    Configuration c;
    CHECK(boot(eeprom, next, c) == LoadResult::kLoaded);
    return c;
  };
  Configuration defaults;
  defaults.load_defaults();
  for (uint8_t key = 0; key <= protocol::kParamKeys; ++key) {
    Configuration without = stored;
    if (key == protocol::kParamKeys) {
      std::memcpy(without.map, defaults.map, sizeof(without.map));
    } else {
      for (uint8_t i = 0; i < protocol::kParamKeyTable[key].count; ++i) {
        without.value[index_of(key) + i] = defaults.value[index_of(key) + i];
      }
    }
    // One that this firmware has and the other had not.
    std::vector<Entry> fewer = whole;
    fewer.erase(fewer.begin() + key);
    ConfigStore next;
    CHECK(same(load(fewer, next), without));
    CHECK_EQUAL(next.report().kept, protocol::kParamKeys);
    CHECK_EQUAL(next.report().fresh.count, 1);
    CHECK_EQUAL(next.report().fresh.id[0], whole[key][0]);
    CHECK_EQUAL(next.report().unknown.count, 0);
    // The other had one of another id in its place, or of another number of values, or type.
    for (const int change : {0, 1, 2}) {
      std::vector<Entry> changed = whole;
      changed[key][0] = change == 0 ? 254 : changed[key][0];
      if (change == 1) changed[key][1] = changed[key][1] == 4 ? 2 : 1;
      if (change == 2) --changed[key][2];
      changed[key].resize(kEntryHeader + changed[key][1] * changed[key][2]);
      ConfigStore third;
      CHECK(same(load(changed, third), without));
      CHECK_EQUAL(third.report().fresh.id[0], whole[key][0]);
      CHECK_EQUAL(third.report().unknown.count, 1);
      CHECK_EQUAL(third.report().unknown.id[0], changed[key][0]);
    }
  }
}

TEST(the_order_of_the_entries_is_no_matter) {
  Saved s;
  std::vector<Entry> turned = entries(s.eeprom);
  std::reverse(turned.begin(), turned.end());
  put(s.eeprom, turned);
  CHECK(s.again() == LoadResult::kLoaded);
  CHECK(same(s.c, config(1)));
}

TEST(many_unknown_entries_are_counted_and_eight_are_named) {
  Saved s;
  std::vector<Entry> wanted;
  for (int i = 0; i < 20; ++i) wanted.push_back({static_cast<uint8_t>(200 + i), 4, 1, 1, 2, 3, 4});
  put(s.eeprom, wanted);
  CHECK(s.again() == LoadResult::kLoaded);
  CHECK_EQUAL(s.store.report().kept, 0);
  CHECK_EQUAL(s.store.report().fresh.count, protocol::kParamKeys + 1);
  CHECK_EQUAL(s.store.report().unknown.count, 20);
  CHECK_EQUAL(s.store.report().unknown.id[7], 207);
  // A save by this firmware holds what it has, and only that.
  CHECK(save(s.eeprom, s.store, s.c));
  CHECK(s.again() == LoadResult::kLoaded);
  CHECK_EQUAL(s.store.report().kept, protocol::kParamKeys + 1);
  CHECK_EQUAL(s.store.report().fresh.count + s.store.report().unknown.count, 0);
}

TEST(entries_that_do_not_add_up_are_damage) {
  const Saved saved;
  for (const Entry& last :
       {Entry{7, 4, 2, 0, 0, 0, 0}, Entry{7, 4}, Entry{7}, Entry{7, 255, 255}}) {
    Saved s = saved;
    std::vector<Entry> wanted = entries(s.eeprom);
    wanted.push_back(last);
    put(s.eeprom, wanted);
    CHECK(s.again() == LoadResult::kDamaged);
  }
  Saved s = saved;
  s.eeprom.cells[kSlotAt[0] + 6] = 0xFF;  // a length beyond the slot is not read
  CHECK(s.again() == LoadResult::kDamaged);
}

TEST(a_worn_cell_fails_the_save_and_keeps_the_old_one) {
  Saved s;
  s.eeprom.worn = kSlotAt[1] + 300;
  CHECK(!save(s.eeprom, s.store, config(2)));
  CHECK_EQUAL(s.store.generation(), 1u);
  CHECK(s.again() == LoadResult::kLoaded);
  CHECK(same(s.c, config(1)));
}

TEST(a_save_skips_bytes_that_are_there_already) {
  Saved s;
  CHECK(save(s.eeprom, s.store, config(1)));
  const int before = s.eeprom.writes;
  CHECK(save(s.eeprom, s.store, config(1)));
  CHECK(s.eeprom.writes - before < 8);
}

TEST(no_boot_count_comes_twice_though_power_is_cut) {
  std::mt19937 random(9);
  Eeprom eeprom;
  // Just before carries through every byte.
  for (const uint32_t start : {0xFFFFFFF0u, 0x000000F0u, 0x0000FFF0u, 0x00FFFFF0u}) {
    for (int i = 0; i < 4; ++i) eeprom.cells[i] = static_cast<uint8_t>(start >> (8 * i));
    std::vector<uint32_t> counts;
    for (int i = 0; i < 40; ++i) {
      ConfigStore store;
      Configuration c;
      if (i % 3 != 0) {
        eeprom.cut_at = eeprom.writes + static_cast<int>(random() % 4);
        // A cut write leaves the erased cell, the old or the new value: here the erased one is
        // left out, as the chip erases and writes in one go only after the supply was checked.
      }
      store.begin(eeprom, &c);
      for (int k = 0; k < 20 && !store.counted() && !eeprom.dead; ++k) {
        if (eeprom.writes == eeprom.cut_at) {
          eeprom.dead = true;
          break;
        }
        store.step(eeprom, c);
      }
      if (store.counted()) {
        // Ever upwards, round the corner too: so none comes twice.
        if (!counts.empty()) {
          CHECK(static_cast<int32_t>(store.boot_count() - counts.back()) > 0);
        }
        counts.push_back(store.boot_count());
      }
      eeprom.dead = false;
      eeprom.cut_at = -1;
    }
    CHECK(counts.size() > 14);
  }
}

TEST(a_worn_counter_cell_keeps_no_robot_from_starting_and_no_count_comes_twice) {
  for (int worn = 0; worn < 4; ++worn) {
    Eeprom eeprom;
    eeprom.worn = worn;
    eeprom.cells[worn] = 0x5A;
    std::vector<uint32_t> counts;
    for (int i = 0; i < 40; ++i) {
      ConfigStore store;
      Configuration c;
      const int before = eeprom.writes;
      boot(eeprom, store, c);
      CHECK(store.counted());
      CHECK(eeprom.writes - before < 12);  // and it is not worn further
      for (const uint32_t count : counts) CHECK(store.boot_count() != count);
      counts.push_back(store.boot_count());
    }
  }
}

TEST(a_wholly_worn_counter_keeps_no_robot_from_starting) {
  struct : Eeprom {
    void eeprom_write(uint16_t, uint8_t) { ++writes; }
  } eeprom;
  ConfigStore store;
  Configuration c;
  store.begin(eeprom, &c);
  for (int i = 0; i < 100 && !store.counted(); ++i) store.step(eeprom, c);
  CHECK(store.counted());
}

}  // namespace store_cases

#endif  // THIGMO_TESTS_FIRMWARE_STORE_CASES_H_
