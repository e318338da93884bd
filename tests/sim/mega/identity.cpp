// The controller's arithmetic on pseudo-random inputs, as one check sequence for each part.
//
// Built twice, for this machine and for the ATmega2560 (run in a simulator): `int` has 16 bits
// there and 32 here, so a product in the wrong width shows as another number.
// test_identity.py compares the two outputs.
#ifdef __AVR__
#include <avr/io.h>
#include <avr/pgmspace.h>
#include <avr/sleep.h>
#define THIGMO_PROGMEM PROGMEM
#define THIGMO_FLASH_U8(pointer) pgm_read_byte(pointer)
#define THIGMO_FLASH_U16(pointer) pgm_read_word(pointer)
#define THIGMO_FLASH_U32(pointer) pgm_read_dword(pointer)
#else
#include <stdio.h>
#endif

#include "controller.h"

using namespace thigmo;

namespace {

void put(char c) {
#ifdef __AVR__
  while ((UCSR0A & _BV(UDRE0)) == 0) {
  }
  UDR0 = static_cast<uint8_t>(c);
#else
  putchar(c);
#endif
}

void finish() {
#ifdef __AVR__
  while ((UCSR0A & _BV(UDRE0)) == 0) {
  }
  sleep_mode();  // without interrupts: the simulator ends
#endif
}

struct Random {
  uint32_t state = 1;
  uint32_t next() {
    state ^= state << 13;
    state ^= state >> 17;
    state ^= state << 5;
    return state;
  }
  int32_t in(int32_t low, int32_t high) {
    return low + static_cast<int32_t>(next() % (static_cast<uint32_t>(high - low) + 1u));
  }
};

struct Sum {
  Crc crc;
  void add(int32_t value) {
    for (uint8_t i = 0; i < 4; ++i) {
      crc.add(static_cast<uint8_t>(static_cast<uint32_t>(value) >> (8 * i)));
    }
  }
  void print(const char* name) {
    while (*name != 0) put(*name++);
    put(' ');
    for (int8_t shift = 12; shift >= 0; shift = static_cast<int8_t>(shift - 4)) {
      put("0123456789abcdef"[crc.value() >> shift & 15]);
    }
    put('\n');
  }
};

Random dice;
Configuration config;
Derived derived;

// A configuration within the schema's ranges, near the defaults or anywhere.
void draw_configuration(bool wild) {
  config.load_defaults();
  for (uint16_t i = 0; i < protocol::kParamCount; ++i) {
    const protocol::ParamRow row = Configuration::row(i);
    if (wild) {
      config.set(i, row.low + static_cast<int32_t>(
                                  dice.next() % (static_cast<uint32_t>(row.high - row.low) + 1u)));
    } else {
      config.set(i, limited<int32_t>(row.initial + dice.in(-50, 50), row.low, row.high));
    }
  }
  if (config.first_conflict() >= 0) config.load_defaults();
  for (uint8_t i = 0; i < protocol::kMapPoints; ++i) {
    config.map[0][0][0][i] = static_cast<int16_t>(dice.next());
    config.map[0][0][1][i] = static_cast<int16_t>(dice.next());
  }
  derived.update(config);
}

void arithmetic() {
  Sum sum;
  for (uint16_t i = 0; i < 300; ++i) {
    sum.add(half_sine(dice.next() >> 1));
    sum.add(multiply_q16(dice.in(-30000, 30000), dice.in(-1000000, 1000000)));
    sum.add(share_q16(static_cast<int32_t>(dice.next()), static_cast<uint16_t>(dice.next())));
    const uint16_t count = static_cast<uint16_t>(dice.in(32, 65504));
    sum.add(total_ohm_q4(count));
    const uint8_t log2 = static_cast<uint8_t>(i % 7);
    sum.add(total_ohm_q4_of_zero(static_cast<uint32_t>(dice.in(0, 1023)) * 256u << log2, log2));
    sum.add(
        count_q6(static_cast<uint32_t>(dice.in(0, 1023)) << (i % 9), static_cast<uint8_t>(i % 9)));
    sum.add(curvature_e5(dice.in(0, 2000000), dice.in(0, 2000000), dice.in(-900000, 900000)));
    sum.add(curvature_e5(dice.in(540000, 560000), dice.in(540000, 560000), dice.in(-20000, 20000)));
  }
  sum.print("arithmetic");
}

void constants() {
  Sum sum;
  for (uint8_t i = 0; i < 12; ++i) {
    draw_configuration(i % 2 == 0);
    for (const int32_t gain : derived.flex_gain_q16) sum.add(gain);
    for (uint8_t muscle = 0; muscle < kMuscles; ++muscle) {
      sum.add(derived.pressure_gain[muscle].mantissa);
      sum.add(derived.pressure_gain[muscle].shift);
      sum.add(static_cast<int32_t>(derived.reversal_inverse_q24[muscle]));
      sum.add(derived.lag_alpha_q16[muscle]);
    }
    sum.add(derived.drive_slope_q16);
    sum.add(static_cast<int32_t>(derived.um_per_count_q16));
    sum.add(derived.slip_counts);
    sum.add(derived.tolerance_counts);
    sum.add(derived.slew_q8);
    sum.add(derived.counts(dice.in(-500000, 500000)));
    sum.add(derived.um(dice.in(-20000, 20000)));
    sum.add(derived.speed_q16(dice.in(100, 200000)));
    sum.add(derived.accel_q16);
  }
  sum.print("constants");
}

// A part's sum over three configurations near the defaults and one anywhere.
template <typename Part>
void in_four_configurations(const char* name, const Part& part) {
  Sum sum;
  for (uint8_t round = 0; round < 4; ++round) {
    draw_configuration(round == 3);
    part(round == 3, sum);
  }
  sum.print(name);
}

void pressure() {
  in_four_configurations("pressure", [](bool, Sum& sum) {
    PressureLoop loop;
    PressureReading reading;
    MuscleState muscle;
    uint16_t count = 110;
    for (uint16_t i = 0; i < 200; ++i) {
      if (i % 50 == 0) {
        loop.set_target(static_cast<int16_t>(dice.in(0, 2300)),
                        Derived::slew_step_q8(static_cast<uint16_t>(dice.in(10, 10000))));
      }
      for (uint8_t k = 0; k < (i % 20 == 3 ? 4 : 5); ++k) {
        reading.add(count);
        count = static_cast<uint16_t>(limited<int32_t>(count + dice.in(-6, 7), 60, 900));
      }
      reading.update(config.get(Param::kPressureZero), derived.pressure_gain[0]);
      muscle.update(reading.cpsi(), derived.lag_alpha_q16[0],
                    static_cast<int16_t>(config.get(Param::kReversalCpsi)),
                    derived.reversal_inverse_q24[0]);
      sum.add(reading.cpsi());
      sum.add(loop.step(reading.cpsi(), config, derived));
      sum.add(loop.set_cpsi());
      sum.add(loop.stuck(derived));
      sum.add(muscle.lagged_cpsi());
      sum.add(muscle.free_e5(config.map[0][0], derived.supports_per_cpsi_q22));
    }
  });
}

void spool() {
  in_four_configurations("spool", [](bool wild, Sum& sum) {
    SpoolLoop loop;
    const int32_t target = wild ? dice.in(-2000, 2000) : dice.in(-400, 400);
    loop.start(0, target, derived.speed_q16(dice.in(2000, 50000)), derived.accel_q16, kMotorFull);
    int32_t counts = 0;
    for (uint16_t i = 0; i < 200; ++i) {
      sum.add(static_cast<uint8_t>(loop.step(counts, config, derived)));
      sum.add(loop.duty());
      counts += loop.duty() / 100;
    }
  });
}

void sensing() {
  Sum sum;
  draw_configuration(false);
  MovingSum moving[3];
  moving[0].start(0);
  moving[1].start(4);
  moving[2].start(8);
  FlexReadings flex;
  flex.set_oversampling(4);
  DriftWatch drift;
  SensorZeros zeros;
  zeros.begin(0x3FF);
  for (uint32_t tick = 0; tick < 4100; ++tick) {
    const uint16_t count = static_cast<uint16_t>(dice.in(600, 700));
    for (MovingSum& m : moving) m.add(count);
    uint16_t counts[kSensors];
    for (uint16_t& converted : counts) converted = static_cast<uint16_t>(dice.in(600, 700));
    const uint16_t done = flex.add_tick(tick % 2 != 0, counts);
    drift.add(done, flex);
    zeros.add(done, flex);
    drift.set_quiet(true, tick);
    drift.update(tick, 4, derived.flex_gain_q16);
    if (tick % 64 == 0) {
      for (const MovingSum& m : moving) sum.add(static_cast<int32_t>(m.sum()));
    }
  }
  for (uint8_t i = 0; i < kSensors; ++i) {
    zeros.finish(i, 4);
    sum.add(drift.drift_e5_s(i));
    sum.add(zeros.total_at_zero(i));
    sum.add(static_cast<int32_t>(zeros.zero_sum_q8(i)));
  }
  sum.print("sensing");
}

}  // namespace

int main() {
#ifdef __AVR__
  UCSR0A = _BV(U2X0);
  UCSR0B = _BV(TXEN0);
  UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
  UBRR0 = 0;
#endif
  arithmetic();
  constants();
  pressure();
  spool();
  sensing();
  finish();
  return 0;
}
