// Sensing: resistance and curvature, readings, pressure, free curvature, trigger, eversion, zeros.
#ifndef THIGMO_TESTS_FIRMWARE_SENSING_CASES_H_
#define THIGMO_TESTS_FIRMWARE_SENSING_CASES_H_

#include <cmath>
#include <cstdlib>

#include "check.h"
#include "sensing/eversion.h"
#include "sensing/flex.h"
#include "sensing/free_curvature.h"
#include "sensing/narrowing.h"
#include "sensing/pressure.h"
#include "sensing/snapshot.h"
#include "sensing/trigger.h"
#include "sensing/zeroing.h"

namespace sensing_cases {

using namespace thigmo;

// One conversion of one sensor, the others at a plausible count; whether it completed a reading.
inline bool convert(FlexReadings& readings, uint8_t sensor, uint16_t count) {
  uint16_t counts[6] = {500, 500, 500, 500, 500, 500};
  const uint8_t place = sensor % 5;
  const uint8_t slot = place == 0 ? sensor / 5 : static_cast<uint8_t>(place + 1);
  counts[slot] = count;
  return (readings.add_tick(sensor >= 5, counts) >> sensor & 1) != 0;
}

TEST(sums_of_a_finer_converter_err_by_less_than_a_count) {
  for (const uint8_t bits : {10, 12, 16}) {
    for (double share = 0.003; share < 0.997; share += 0.00171) {
      Narrowing narrowing(bits);
      const uint16_t wide = static_cast<uint16_t>(share * (1L << bits));
      // A floor loses half a count on average, in the finer counts and in the core's.
      const double mean = (wide + 0.5) * 1024 / (1L << bits) - 0.5;
      double sum[3] = {};  // a pressure, a base sensor, one that is converted in every second tick
      for (uint32_t tick = 0; tick < 32; ++tick) {
        AdcFrame frame;
        for (uint16_t& count : frame.count) count = wide;
        frame.tick = tick;
        narrowing.apply(&frame);
        sum[0] += frame.count[0];
        sum[1] += frame.count[2];
        if (tick % 2 == 1) sum[2] += frame.count[5];
        if (bits == 10) CHECK_EQUAL(frame.count[0], wide);
      }
      if (bits == 10) continue;
      CHECK_NEAR(sum[0], 32 * mean, 1.0);
      CHECK_NEAR(sum[1], 32 * mean, 1.0);
      CHECK_NEAR(sum[2], 16 * mean, 1.0);
    }
  }
}

TEST(a_finer_converters_ends_are_the_ends_and_forgotten_at_once) {
  Narrowing narrowing(12);
  const auto convert_all = [&narrowing](uint16_t count) {
    AdcFrame frame;
    for (uint16_t& raw : frame.count) raw = count;
    frame.tick = 0;
    narrowing.apply(&frame);
    return frame.count[0];
  };
  for (int i = 0; i < 1000; ++i) CHECK_EQUAL(convert_all(4095), 1023);
  CHECK_NEAR(convert_all(2048), 512, 2.0);
  for (int i = 0; i < 1000; ++i) CHECK_EQUAL(convert_all(0), 0);
  CHECK_NEAR(convert_all(2048), 512, 2.0);
}

TEST(resistance_is_exact_for_every_count) {
  for (uint32_t count = 32; count <= 65504; ++count) {
    const uint64_t want = (static_cast<uint64_t>(22000) << 20) / count;
    CHECK_EQUAL(static_cast<uint64_t>(total_ohm_q4(static_cast<uint16_t>(count))), want);
  }
}

TEST(resistance_of_a_zero_equals_that_of_the_same_mean) {
  for (uint8_t log2 = 0; log2 <= 6; ++log2) {
    for (uint32_t sum = 20u << log2; sum <= 1000u << log2; sum += 3u << log2) {
      CHECK_NEAR(total_ohm_q4_of_zero(sum * 256, log2), total_ohm_q4(count_q6(sum, log2)), 1);
    }
  }
}

TEST(curvature_is_scale_times_resistance_change) {
  Configuration c;
  c.load_defaults();
  Derived d;
  std::mt19937 random(3);
  for (const int32_t scale : {35000, -35000, 1000, 2000000}) {
    CHECK(c.set(static_cast<uint16_t>(Param::kFlexScale), scale));
    d.update(c);
    for (int i = 0; i < 2000; ++i) {
      const double flat = 8000 + random() % 8000;
      const double bent = flat + static_cast<int>(random() % 4001) - 2000;
      const int16_t got =
          curvature_e5(static_cast<int32_t>(16 * (bent + 22000)),
                       static_cast<int32_t>(16 * (flat + 22000)), d.flex_gain_q16[0]);
      const double want = std::fmin(32767, std::fmax(-32768, scale * 1e-9 * (bent - flat) * 1e5));
      CHECK_NEAR(got, want, 0.6 + std::fabs(want) * 1e-3);
    }
  }
}

TEST(an_oversampled_reading_is_the_sum_of_its_conversions) {
  std::mt19937 random(4);
  for (uint8_t log2 = 0; log2 <= 6; ++log2) {
    FlexReadings readings;
    readings.set_oversampling(log2);
    uint32_t sum = 0;
    for (int i = 1; i <= 640; ++i) {
      const uint16_t count = static_cast<uint16_t>(random() % 1024);
      sum += count;
      const bool full = convert(readings, 7, count);
      CHECK_EQUAL(full, i % (1 << log2) == 0);
      if (full) {
        CHECK_EQUAL(readings.latest(7), sum);
        sum = 0;
      }
    }
  }
}

TEST(readings_are_ready_when_every_sensor_has_one) {
  const uint16_t counts[6] = {500, 501, 502, 503, 504, 505};
  FlexReadings readings;
  readings.set_oversampling(1);
  // Base sensors are converted every tick, the others every second one.
  CHECK_EQUAL(readings.add_tick(false, counts), 0);
  CHECK_EQUAL(readings.add_tick(true, counts), 0x021);
  CHECK_EQUAL(readings.add_tick(false, counts), 0x01E);
  CHECK(!readings.all_ready());
  CHECK_EQUAL(readings.add_tick(true, counts), 0x3E1);
  CHECK(readings.all_ready());
  CHECK_EQUAL(readings.latest(0), 1000);
  CHECK_EQUAL(readings.latest(5), 1002);
  CHECK_EQUAL(readings.latest(4), 1010);
  CHECK_EQUAL(readings.latest(9), 1010);
  readings.set_oversampling(2);
  CHECK(!readings.all_ready());
}

TEST(open_and_short_circuits_need_bad_conversions_in_a_row_or_a_share_of_them) {
  constexpr int kGood = FlexReadings::kBadLimit * FlexReadings::kBadMemory;
  for (const bool open : {true, false}) {
    const uint16_t bad = open ? 0 : 1023;
    FlexReadings readings;
    readings.set_oversampling(4);
    const auto fault = [&] { return open ? readings.open(3) : readings.shorted(3); };
    const auto opposite_fault = [&] { return open ? readings.shorted(3) : readings.open(3); };
    for (int i = 0; i < FlexReadings::kBadLimit - 1; ++i) convert(readings, 3, bad);
    CHECK(!fault());
    for (int i = 0; i < kGood; ++i) convert(readings, 3, 500);  // a dropout ends, and is forgotten
    for (int i = 0; i < FlexReadings::kBadLimit; ++i) {
      CHECK(!fault() && !readings.any_bad());
      convert(readings, 3, bad);
    }
    CHECK(fault() && !opposite_fault() && !readings.open(4) && readings.any_bad());
    convert(readings, 3, open ? 1023 : 0);  // bad all the same
    CHECK(!fault() && opposite_fault() && readings.any_bad());
    convert(readings, 3, 500);
    CHECK(!fault() && !opposite_fault() && !readings.any_bad());
  }
  // A wire that chatters, between its ends or between one and the truth.
  const auto noticed = [](std::vector<uint16_t> counts) {
    FlexReadings readings;
    readings.set_oversampling(4);
    for (int i = 0; i < 2000; ++i) {
      convert(readings, 7, counts[i % counts.size()]);
      if (readings.any_bad()) return readings.open(7) || readings.shorted(7);
    }
    return false;
  };
  CHECK(noticed({0, 1023}) && noticed({0, 500}) && noticed({1023, 500, 0, 500, 500}));
  CHECK(!noticed({0, 500, 500, 500, 500}));
}

TEST(pressure_is_read_through_its_calibration) {
  Configuration c;
  c.load_defaults();
  Derived d;
  d.update(c);
  for (const int taken : {5, 4, 7}) {
    for (double psi = 0; psi < 50; psi += 0.37) {
      PressureReading reading;
      const double ideal = 1024 * (0.1 + 0.8 * psi / 60);
      // Dithered as noise would, so that the mean of the floors is the ideal less a half.
      for (int i = 0; i < taken; ++i) {
        reading.add(static_cast<uint16_t>(std::floor(ideal + (i + 0.5) / taken - 0.5)));
      }
      reading.update(c.get(Param::kPressureZero), d.pressure_gain[0]);
      CHECK_NEAR(reading.cpsi(), psi * 100, 7.4 / taken + 1.5);
      CHECK(!reading.wire_broken());
    }
  }
}

TEST(a_pressure_wire_is_broken_outside_its_band) {
  PressureReading reading;
  for (int i = 0; i < PressureReading::kWireLimit; ++i) {
    CHECK(!reading.wire_broken());
    reading.add(50);
  }
  CHECK(reading.wire_broken());
  reading.add(51);
  CHECK(!reading.wire_broken());
  for (int i = 0; i < PressureReading::kWireLimit; ++i) reading.add(974);
  CHECK(reading.wire_broken());
}

TEST(a_pressure_wire_that_chatters_is_broken_and_one_that_flickers_is_not) {
  const auto noticed = [](int bad, int good) {
    PressureReading reading;
    for (int i = 0; i < 1000; ++i) {
      reading.add(i % (bad + good) < bad ? 0 : 400);
      if (reading.wire_broken()) return true;
    }
    return false;
  };
  for (const int bad : {1, 2}) {
    for (int share = 35; share <= 65; share += 5) {
      CHECK(noticed(bad, (100 - share) * bad / share));
    }
  }
  CHECK(!noticed(1, 4) && !noticed(2, 50));
}

TEST(a_reading_with_a_broken_wires_conversions_is_doubtful) {
  Configuration c;
  c.load_defaults();
  Derived d;
  d.update(c);
  PressureReading reading;
  const auto update = [&] { reading.update(c.get(Param::kPressureZero), d.pressure_gain[0]); };
  for (const bool bad : {false, true, false}) {
    for (int i = 0; i < 5; ++i) reading.add(bad && i == 1 ? 1023 : 400);
    update();
    CHECK_EQUAL(reading.doubtful(), bad);
  }
}

TEST(a_map_is_linear_between_its_supports) {
  const int16_t map[protocol::kMapPoints] = {0,    790,  1520, 2148, 2656, 3046,
                                             3335, 3541, 3687, 3787, -3856};
  Configuration c;
  c.load_defaults();
  Derived d;
  for (const int top : {2000, 3500, 6000}) {
    CHECK(c.set(static_cast<uint16_t>(Param::kMapTopCpsi), top));
    d.update(c, static_cast<uint16_t>(Param::kMapTopCpsi));
    const uint16_t scale = d.supports_per_cpsi_q22;
    CHECK_EQUAL(map_at(map, MapPlace(-500, scale)), 0);
    CHECK_EQUAL(map_at(map, MapPlace(32000, scale)), -3856);
    for (int cpsi = 0; cpsi <= top; ++cpsi) {
      const int index = cpsi < top ? cpsi * 10 / top : 9;
      const double share = cpsi * 10.0 / top - index;
      const int rise = map[index + 1] - map[index];
      CHECK_NEAR(map_at(map, MapPlace(static_cast<int16_t>(cpsi), scale)),
                 map[index] + share * rise, 1.0 + std::abs(rise) * 1e-3);
    }
  }
}

constexpr uint16_t kScale = (10u << 22) / 2000;      // of maps to 20 psi
constexpr uint32_t kInverse = 0x1000000u / 100 + 1;  // of a reversal width of 1 psi

TEST(measured_pressure_is_filtered_by_the_calibrated_lag) {
  Configuration c;
  c.load_defaults();
  Derived d;
  for (const int32_t lag : {0, 50, 200, 1000}) {
    CHECK(c.set(static_cast<uint16_t>(Param::kLagMs), lag));
    d.update(c);
    MuscleState muscle;
    muscle.update(0, d.lag_alpha_q16[0], 100, kInverse);
    for (int i = 1; i < 600; ++i) {
      muscle.update(1000, d.lag_alpha_q16[0], 100, kInverse);
      // Midway between the steps, as a sampled input is held.
      const double t = i * 0.005;
      const double want = lag == 0 ? 1000 : 1000 * (1 - std::exp(-t / (lag * 1e-3)));
      CHECK_NEAR(muscle.lagged_cpsi(), want, lag == 50 ? 4 : 2);
    }
  }
}

TEST(the_branch_turns_over_the_reversal_width) {
  MuscleState muscle;
  const uint16_t all = 65535;  // no lag
  const int16_t maps[kBranches][protocol::kMapPoints] = {
      {1000, 1000, 1000, 1000, 1000, 1000, 1000, 1000, 1000, 1000, 1000}, {}};
  muscle.update(0, all, 100, kInverse);
  CHECK_EQUAL(muscle.free_e5(maps, kScale), 0);
  for (int16_t p = 0; p <= 500; p = static_cast<int16_t>(p + 10)) {
    muscle.update(p, all, 100, kInverse);
    CHECK_NEAR(muscle.free_e5(maps, kScale), 1000.0 * std::fmin(1.0, p / 100.0), 5);
  }
  CHECK(muscle.branch() == protocol::Branch::kInflate);
  for (int16_t p = 500; p >= 0; p = static_cast<int16_t>(p - 10)) {
    muscle.update(p, all, 100, kInverse);
    CHECK_NEAR(muscle.free_e5(maps, kScale), 1000.0 * std::fmax(0.0, 1 - (500 - p) / 100.0), 5);
  }
  CHECK(muscle.branch() == protocol::Branch::kDeflate);
  // A reversal of less than the width goes part of the way, and back.
  for (int16_t p = 0; p <= 300; p = static_cast<int16_t>(p + 10))
    muscle.update(p, all, 100, kInverse);
  muscle.update(250, all, 100, kInverse);
  CHECK_NEAR(muscle.free_e5(maps, kScale), 500, 5);
  muscle.update(300, all, 100, kInverse);
  CHECK_EQUAL(muscle.free_e5(maps, kScale), 1000);
}

TEST(the_moving_sum_equals_the_sum_of_the_last_samples) {
  std::mt19937 random(5);
  for (uint8_t log2 = 0; log2 <= 8; ++log2) {
    MovingSum moving;
    moving.start(log2);
    std::vector<uint32_t> samples;
    const size_t width = size_t{1} << log2;
    const size_t block = log2 > 5 ? size_t{1} << (log2 - 5) : 1;
    for (int i = 0; i < 2000; ++i) {
      samples.push_back(random() % 1024);
      moving.add(static_cast<uint16_t>(samples.back()));
      CHECK_EQUAL(moving.full(), samples.size() / block * block >= width);
      if (!moving.full()) continue;
      const size_t end = samples.size() / block * block;
      uint32_t sum = 0;
      for (size_t k = end - width; k < end; ++k) sum += samples[k];
      CHECK_EQUAL(moving.sum(), sum);
    }
  }
}

TEST(the_trigger_fires_once_after_its_debounce) {
  for (const int debounce : {1, 3, 20}) {
    ContactTrigger trigger;
    for (int i = 1; i < debounce; ++i) CHECK(!trigger.update(501, 500, debounce));
    CHECK(!trigger.update(500, 500, debounce));  // at the threshold is not beyond it
    for (int i = 0; i < 100; ++i) CHECK(!trigger.update(-900, 500, debounce));  // further is none
    for (int i = 1; i < debounce; ++i) CHECK(!trigger.update(501, 500, debounce));
    CHECK(trigger.update(501, 500, debounce));
    CHECK(trigger.latched());
    for (int i = 0; i < 100; ++i) CHECK(!trigger.update(900, 500, debounce));
    trigger.rearm();
    CHECK(!trigger.latched());
    for (int i = 1; i < debounce; ++i) CHECK(!trigger.update(900, 500, debounce));
    trigger.interrupt();
    for (int i = 1; i < debounce; ++i) CHECK(!trigger.update(900, 500, debounce));
    CHECK(trigger.update(900, 500, debounce));
  }
}

TEST(a_peak_is_ten_readings_evenly_spaced) {
  Snapshots snapshots;
  CHECK(snapshots.find(0) == nullptr && snapshots.find(kTriggerSnapshot) == nullptr);
  snapshots.plan_peak(100, 50);
  int taken = 0;
  for (uint32_t tick = 0; tick < 1000; ++tick) {
    if (!snapshots.due(tick)) continue;
    CHECK_EQUAL(tick, 100u + 50u * taken);
    Reading reading = {};
    reading.t_us = tick;
    const bool last = snapshots.store_peak(reading);
    ++taken;
    CHECK_EQUAL(last, taken == 10);
    CHECK_EQUAL(snapshots.count(), taken);
  }
  CHECK_EQUAL(taken, 10);
  for (uint8_t i = 0; i < 10; ++i) CHECK_EQUAL(snapshots.find(i)->t_us, 100u + 50u * i);
  CHECK(snapshots.find(10) == nullptr);
}

TEST(half_everted_means_the_fold_lies_within_the_margin) {
  Configuration c;
  c.load_defaults();  // centres 5, 15, .. cm, span 5.5, margin 0.5
  const uint16_t all = 0x3FF;
  for (int32_t um = 0; um <= 530000; um += 250) {
    Eversion eversion;
    eversion.update(true, um, 0, c, all);
    for (int i = 0; i < 10; ++i) {
      const double centre = 50000 + 100000.0 * (i % 5);
      const bool everted = um >= centre + 32500;
      const bool half = !everted && um > centre - 32500;
      CHECK_EQUAL(eversion.everted_mask() >> i & 1, everted ? 1 : 0);
      CHECK_EQUAL(eversion.half_mask() >> i & 1, half ? 1 : 0);
    }
  }
  Eversion unknown;
  CHECK_EQUAL(unknown.update(false, 50000, 0, c, all), 0);
  CHECK_EQUAL(unknown.half_mask(), 0);
  Eversion dead;
  dead.update(true, 50000, 0, c, 0x3FF & ~0x021);
  CHECK_EQUAL(dead.half_mask(), 0);
}

TEST(the_settle_clock_runs_from_each_sensors_eversion) {
  Configuration c;
  c.load_defaults();
  Eversion eversion;
  CHECK_EQUAL(eversion.update(true, 90000, 1000, c, 0x3FF), 0x021);
  CHECK_EQUAL(eversion.update(true, 190000, 11000, c, 0x3FF), 0x042);
  CHECK_EQUAL(eversion.settled_mask(), 0);
  eversion.update(true, 190000, 30999, c, 0x3FF);
  CHECK_EQUAL(eversion.settled_mask(), 0);
  CHECK_EQUAL(eversion.settle_left_ms(0, 30999, 30000), 1);
  eversion.update(true, 190000, 31000, c, 0x3FF);
  CHECK_EQUAL(eversion.settled_mask(), 0x021);
  eversion.update(true, 190000, 41000, c, 0x3FF);
  CHECK_EQUAL(eversion.settled_mask(), 0x063);
  // Wound in and everted again: anew. A tremble of the encoder is no eversion.
  CHECK_EQUAL(eversion.update(true, 182400, 42000, c, 0x3FF), 0);
  CHECK_EQUAL(eversion.settled_mask(), 0x063);
  CHECK_EQUAL(eversion.update(true, 150000, 43000, c, 0x3FF), 0);
  CHECK_EQUAL(eversion.everted_mask(), 0x021);
  CHECK_EQUAL(eversion.update(true, 190000, 50000, c, 0x3FF), 0x042);
  CHECK_EQUAL(eversion.settled_mask(), 0x021);
  eversion.confirm(true, 51000);
  CHECK_EQUAL(eversion.settled_mask(), 0x063);
  eversion.confirm(false, 52000);
  CHECK_EQUAL(eversion.settled_mask(), 0);
}

// Feeds a sensor whose count drifts; returns the drift found, 1e-5/cm/s.
inline int drift_of(double counts_per_s, double noise) {
  Configuration c;
  c.load_defaults();
  Derived d;
  d.update(c);
  FlexReadings readings;
  readings.set_oversampling(4);
  DriftWatch watch;
  std::mt19937 random(6);
  std::normal_distribution<double> normal;
  for (uint32_t tick = 0; tick < 4200; ++tick) {
    watch.set_quiet(true, tick);
    const double ideal = 650.5 + counts_per_s * tick * 1e-3 + noise * normal(random);
    if (convert(readings, 0, static_cast<uint16_t>(ideal))) watch.add(1, readings);
    watch.update(tick, 4, d.flex_gain_q16);
  }
  CHECK(watch.known());
  return watch.drift_e5_s(0);
}

TEST(drift_is_measured_between_two_quiet_windows) {
  // 650 counts: R = 12.66 k; one count is 53 ohm, 186e-5 1/cm at 3.5e-5 per ohm.
  CHECK_NEAR(drift_of(0, 1.5), 0, 15);
  CHECK_NEAR(drift_of(1, 1.5), -186, 25);
  CHECK_NEAR(drift_of(-1, 0.8), 186, 25);
}

TEST(a_disturbance_restarts_the_drift_windows) {
  DriftWatch watch;
  const int32_t gain[kSensors] = {};
  uint32_t tick = 0;
  for (; tick < 3000; ++tick) {
    watch.set_quiet(true, tick);
    watch.update(tick, 4, gain);
  }
  watch.set_quiet(false, tick);
  watch.update(tick, 4, gain);
  for (uint32_t end = tick + 3900; tick < end; ++tick) {
    watch.set_quiet(true, tick);
    watch.update(tick, 4, gain);
    CHECK(!watch.known());
  }
  for (uint32_t end = tick + 300; tick < end; ++tick) watch.update(tick, 4, gain);
  CHECK(watch.known());
}

TEST(a_zero_is_the_mean_of_the_named_sensors) {
  SensorZeros zeros;
  zeros.begin(0x021);
  FlexReadings readings;
  readings.set_oversampling(4);
  for (int tick = 0; tick < 60 * 32; ++tick) {
    // Of sensors 0 and 5, the base's: a reading takes 16 ticks, and every second one is 1 more.
    uint16_t counts[6] = {625, 630, 700, 700, 700, 700};
    if (tick % 32 == 0) {
      ++counts[0];
      ++counts[1];
    }
    zeros.add(readings.add_tick(tick % 2 != 0, counts), readings);
  }
  for (uint8_t i = 0; i < kSensors; ++i) zeros.finish(i, 4);
  CHECK_EQUAL(zeros.valid_mask(), 0x021);
  CHECK_EQUAL(zeros.zero_sum_q8(0), 10000 * 256 + 128);
  CHECK_EQUAL(zeros.zero_sum_q8(5), 10080 * 256 + 128);
  CHECK_EQUAL(zeros.zero_sum_q8(1), 0);
  zeros.invalidate(0x001);
  CHECK_EQUAL(zeros.valid_mask(), 0x020);
}

}  // namespace sensing_cases

#endif  // THIGMO_TESTS_FIRMWARE_SENSING_CASES_H_
