// Control: sine, PID and pressure loop on a plant, sweep, profile, spool.
#ifndef THIGMO_TESTS_FIRMWARE_CONTROL_CASES_H_
#define THIGMO_TESTS_FIRMWARE_CONTROL_CASES_H_

#include <cmath>
#include <cstring>

#include "check.h"
#include "control/pressure_loop.h"
#include "control/spool.h"
#include "control/sweep.h"

namespace control_cases {

using namespace thigmo;

// The configuration by default, with its scaled constants.
struct Settings {
  Configuration c;
  Derived d;
  Settings() {
    c.load_defaults();
    d.update(c);
  }
  void set(Param name, int32_t value, uint8_t element = 0) {
    CHECK(c.set(static_cast<uint16_t>(static_cast<uint16_t>(name) + element), value));
    d.update(c);
  }
};

TEST(a_change_of_one_parameter_updates_all_that_follows_from_it) {
  std::mt19937 random(11);
  Settings s;
  Derived all = s.d;
  for (uint16_t i = 0; i < protocol::kParamCount; ++i) {
    const protocol::ParamRow row = Configuration::row(i);
    const uint32_t span = static_cast<uint32_t>(row.high - row.low) + 1u;
    s.c.value[i] = row.low + static_cast<int32_t>(random() % span);
    s.d.update(s.c, i);
    while (s.d.waits()) s.d.step(s.c);
    all.update(s.c);
    CHECK(std::memcmp(&s.d, &all, sizeof(Derived)) == 0);
  }
}

TEST(sine_is_within_its_stated_error) {
  double worst = 0;
  for (int i = 0; i <= 100000; ++i) {
    const uint32_t phase = static_cast<uint32_t>(i * (2147483648.0 / 100000));
    worst = std::fmax(
        worst, std::fabs(half_sine(phase) / 32768.0 - std::sin(M_PI * phase / 2147483648.0)));
  }
  CHECK(worst < 1.1e-4);
  CHECK(worst > 1e-5);  // suspiciously good would be the wrong function
  CHECK_EQUAL(half_sine(0), 0);
  CHECK_EQUAL(half_sine(0x40000000u), 32768);
  CHECK_EQUAL(half_sine(0x80000000u), 0);
  CHECK_EQUAL(half_sine(0x80000001u), 0);  // beyond the half period
  CHECK_EQUAL(half_sine(0xFFFFFFFFu), 0);
}

TEST(products_round_to_nearest) {
  std::mt19937 random(1);
  for (int i = 0; i < 100000; ++i) {
    const int32_t a = static_cast<int32_t>(random()) >> 8;
    const uint32_t b = static_cast<uint32_t>(random()) >> (9 + i % 20);
    const int64_t product = static_cast<int64_t>(a) * static_cast<int64_t>(b);
    CHECK_EQUAL(multiply_q16(a, b), static_cast<int32_t>((product + 0x8000) >> 16));
  }
}

TEST(fine_numbers_are_those_of_64_bits) {
  std::mt19937 random(12);
  Fine sum = {0, 0};
  int64_t expected = 0;
  for (int i = 0; i < 100000; ++i) {
    const int32_t q16 = static_cast<int32_t>(random()) >> (i % 30);
    const Fine before = sum;
    sum.add(q16);
    expected += q16;
    CHECK_EQUAL(sum.whole, static_cast<int32_t>(expected >> 16));
    CHECK_EQUAL(sum.fraction, static_cast<uint16_t>(expected));
    CHECK_EQUAL(sum.less(before), q16 < 0);
    CHECK_EQUAL(before.less(sum), q16 > 0);
    CHECK_EQUAL(sum.zero(), expected == 0);
  }
}

TEST(shares_are_the_products_rounded_down) {
  std::mt19937 random(10);
  for (int i = 0; i < 100000; ++i) {
    const int32_t a = static_cast<int32_t>(random()) >> (i % 20);
    const uint16_t b = static_cast<uint16_t>(random());
    CHECK_EQUAL(share_q16(a, b), static_cast<int32_t>((static_cast<int64_t>(a) * b) >> 16));
  }
}

TEST(duty_follows_the_transducers_map) {
  Settings s;
  // 2 psi at 4 mA, 60 psi at 20 mA; 1599 = 20 mA.
  CHECK_NEAR(PressureLoop::duty(200, s.c, s.d), 0.2 * 1599, 0.51);
  CHECK_EQUAL(PressureLoop::duty(6000, s.c, s.d), 1599);
  for (int cpsi = 200; cpsi < 6000; cpsi += 7) {
    const double milliampere = 4 + 16.0 * (cpsi - 200) / 5800;
    CHECK_NEAR(PressureLoop::duty(cpsi, s.c, s.d), milliampere / 20 * 1599, 0.52);
  }
}

// Transducer and muscle as one lag behind a delay; the transducer is off by gain and offset.
struct Muscle {
  double psi = 0;
  double gain = 1.01;
  double offset = -0.3;
  double lag_s = 0.25;
  std::vector<double> delay = std::vector<double>(6, 0.0);  // 30 ms
  void step(int16_t duty) {
    double wanted = 0;
    if (duty >= 0) {
      const double milliampere = 20.0 * duty / 1599;
      wanted = std::fmax(0.0, gain * (2 + 58 * (milliampere - 4) / 16) + offset);
      if (milliampere < 4) wanted = 0;
    }
    delay.push_back(wanted);
    psi += (delay.front() - psi) * 0.005 / lag_s;
    delay.erase(delay.begin());
  }
  int16_t cpsi() const { return static_cast<int16_t>(std::lround(psi * 100)); }
};

TEST(pressure_reaches_its_set_point_without_offset) {
  Settings s;
  for (const int target : {300, 800, 1800}) {
    PressureLoop loop;
    Muscle muscle;
    loop.set_target(static_cast<int16_t>(target), Derived::slew_step_q8(1500));
    double most = 0;
    for (int i = 0; i < 200 * 8; ++i) {
      muscle.step(loop.step(muscle.cpsi(), s.c, s.d));
      most = std::fmax(most, muscle.psi * 100);
      CHECK(!loop.stuck(s.d) && !loop.mismatched(s.d));
    }
    CHECK_NEAR(muscle.cpsi(), target, 4);
    CHECK(most < target + 0.15 * target + 20);
  }
}

TEST(set_point_moves_no_faster_than_its_slew) {
  Settings s;
  PressureLoop loop;
  Muscle muscle;
  loop.set_target(PressureLoop::kProofCpsi, Derived::slew_step_q8(10000));
  for (int i = 0; i < 400; ++i) muscle.step(loop.step(muscle.cpsi(), s.c, s.d));
  loop.set_target(1800, Derived::slew_step_q8(600));
  int previous = PressureLoop::kProofCpsi;
  int steps = 0;
  while (loop.set_cpsi() < 1800 && steps < 2000) {
    muscle.step(loop.step(muscle.cpsi(), s.c, s.d));
    CHECK(loop.set_cpsi() - previous <= 4);  // 3 a step of 5 ms, and rounding
    previous = loop.set_cpsi();
    ++steps;
  }
  CHECK_NEAR(steps, 467, 3);  // 14 psi at 6 psi/s: 2.3 s
}

TEST(a_set_point_waits_at_the_proof_until_its_own_sensor_follows) {
  Settings s;
  PressureLoop loop;
  loop.set_target(1800, Derived::slew_step_q8(10000));
  int16_t most = 0;
  for (int i = 0; i < 400; ++i) most = greater(most, loop.step(0, s.c, s.d));
  CHECK_EQUAL(loop.set_cpsi(), PressureLoop::kProofCpsi);
  CHECK(most <= PressureLoop::duty(PressureLoop::kProofCpsi, s.c, s.d));
  CHECK(loop.stuck(s.d) && loop.mismatched(s.d));
}

TEST(a_sensor_that_lies_for_half_of_the_time_is_noticed_and_one_that_errs_for_a_moment_is_not) {
  Settings s;
  // A muscle at 10 psi whose sensor then shows 4 psi less, or the truth, in turn.
  const auto noticed = [&s](int bad_steps, int good_steps) {
    PressureLoop loop;
    Muscle muscle;
    loop.set_target(1000, Derived::slew_step_q8(1500));
    for (int i = 0; i < 800; ++i) muscle.step(loop.step(muscle.cpsi(), s.c, s.d));
    for (int i = 0; i < 200 * 30; ++i) {
      const bool lies = i % (bad_steps + good_steps) < bad_steps;
      muscle.step(loop.step(static_cast<int16_t>(muscle.cpsi() - (lies ? 400 : 0)), s.c, s.d));
      if (loop.stuck(s.d) || loop.mismatched(s.d)) return true;
    }
    return false;
  };
  CHECK(noticed(1, 0) && noticed(1, 1) && noticed(97, 3) && noticed(40, 60));
  CHECK(!noticed(1, 4) && !noticed(40, 200));
}

TEST(a_channel_that_is_never_proven_is_a_mismatch) {
  Settings s;
  PressureLoop loop;
  Muscle muscle;
  loop.set_target(1800, Derived::slew_step_q8(10000));
  int steps = 0;
  // Right for 45 ms, and then wrong for 5 ms: neither a proof nor an error that lasts.
  for (; steps < 4000 && !loop.mismatched(s.d); ++steps) {
    muscle.step(loop.step(steps % 10 == 0 ? int16_t{0} : muscle.cpsi(), s.c, s.d));
    CHECK(loop.set_cpsi() <= PressureLoop::kProofCpsi);
  }
  CHECK(steps > 300 && steps < 500);
}

TEST(the_integrator_is_frozen_below_the_live_zero_and_re_enters_without_a_bump) {
  Settings s;
  // Pressure 0.6 s after the set point comes back, before the integral has had time to learn.
  const auto soon = [&](PressureLoop& loop, Muscle& muscle) {
    loop.set_target(1000, Derived::slew_step_q8(1500));
    for (int i = 0; i < 120; ++i) {
      muscle.step(loop.step(muscle.cpsi(), s.c, s.d));
    }
    return muscle.psi;
  };
  PressureLoop loop;
  Muscle muscle;
  muscle.offset = -1.5;
  const double first = soon(loop, muscle);
  for (int i = 0; i < 200 * 10; ++i) muscle.step(loop.step(muscle.cpsi(), s.c, s.d));
  CHECK_NEAR(muscle.psi, 10, 0.03);
  loop.set_target(0, Derived::slew_step_q8(1500));
  for (int i = 0; i < 200 * 20; ++i) muscle.step(loop.step(muscle.cpsi(), s.c, s.d));
  CHECK_EQUAL(loop.output(), PressureLoop::kOff);
  CHECK(muscle.psi < 0.01);
  // The transducer's offset was learnt, and remembered over 20 s of venting.
  const double again = soon(loop, muscle);
  CHECK(again > first + 0.5);
  for (int i = 0; i < 200 * 5; ++i) {
    muscle.step(loop.step(muscle.cpsi(), s.c, s.d));
    CHECK(muscle.psi < 10.1);  // and no bump
  }
}

TEST(a_saturated_output_does_not_wind_the_integrator_up) {
  PressurePid pid;
  const PressurePid::Gains gains = {256, 2560, 0};
  for (int i = 0; i < 10000; ++i) CHECK_EQUAL(pid.step(1800, 0, 1800, gains, 200, 2300), 2300);
  const int32_t wound = pid.integral_cpsi();
  CHECK(wound <= 500);
  // Once the error is gone, the output leaves its limit within a few steps.
  int steps = 0;
  while (pid.step(1800, 1900, 1800, gains, 200, 2300) >= 2300 && steps < 200) ++steps;
  CHECK(steps < 5);
}

TEST(the_derivative_acts_on_the_measurement_alone) {
  PressurePid a;
  const PressurePid::Gains gains = {0, 0, 256};
  CHECK_EQUAL(a.step(500, 0, 1000, gains, 0, 5000), 1000);
  CHECK_EQUAL(a.step(900, 0, 1000, gains, 0, 5000), 1000);  // a set-point step is no kick
  CHECK_EQUAL(a.step(900, 10, 1000, gains, 0, 5000), 0);    // 10 cpsi in 5 ms: -2000
}

TEST(a_pressure_that_does_not_follow_is_stuck_and_a_sweep_is_not) {
  Settings s;
  PressureLoop loop;
  loop.set_target(800, Derived::slew_step_q8(1500));
  int steps = 0;
  while (!loop.stuck(s.d) && steps < 4000) {
    loop.step(0, s.c, s.d);
    ++steps;
  }
  CHECK(steps > 300 && steps < 600);  // 1.5 s after the set point passed 2 psi
  PressureLoop moving;
  Muscle muscle;
  Sweep sweep;
  const int16_t amplitudes[kMuscles] = {1800, 0};
  sweep.start(amplitudes, 8000, 3, 0);
  uint32_t tick = 0;
  while (sweep.advance(tick)) {
    moving.set_target(sweep.set_cpsi(tick), Derived::slew_step_q8(1500));
    muscle.step(moving.step(muscle.cpsi(), s.c, s.d));
    CHECK(!moving.stuck(s.d) && !moving.mismatched(s.d));
    tick += 5;
  }
}

TEST(a_sweep_is_a_half_sine_left_then_right) {
  Sweep sweep;
  const int16_t amplitudes[kMuscles] = {1800, 1200};
  sweep.start(amplitudes, 20000, 2, 1000);
  int halves = 0;
  uint32_t tick = 1000;
  for (; sweep.advance(tick); tick += 5) {
    if (sweep.half_began()) ++halves;
    const double t = std::fmod((tick - 1000) * 1e-3, 20.0);
    const bool left = t < 10;
    CHECK_EQUAL(sweep.muscle(), left ? 0 : 1);
    const double want = (left ? 1800 : 1200) * std::sin(M_PI * std::fmod(t, 10.0) / 10);
    CHECK_NEAR(sweep.set_cpsi(tick), want, 1.2);
  }
  CHECK_EQUAL(tick, 41000);
  CHECK_EQUAL(halves, 3);  // beside the first, which start() begins
}

TEST(a_side_without_amplitude_is_left_out) {
  Sweep sweep;
  const int16_t amplitudes[kMuscles] = {0, 1000};
  sweep.start(amplitudes, 10000, 2, 0);
  uint32_t tick = 0;
  for (; sweep.advance(tick); tick += 5) CHECK_EQUAL(sweep.muscle(), 1);
  CHECK_EQUAL(tick, 10000);
  CHECK_EQUAL(sweep.peak_tick() % 5000, 2500);
}

TEST(a_sweep_survives_the_clocks_wrap) {
  Sweep sweep;
  const uint32_t start = 0xFFFFF000u;
  const int16_t amplitudes[kMuscles] = {1800, 1800};
  sweep.start(amplitudes, 20000, 1, start);
  for (uint32_t i = 0; i < 20000; i += 5) {
    CHECK(sweep.advance(start + i));
    const double t = std::fmod(i * 1e-3, 10.0);
    CHECK_NEAR(sweep.set_cpsi(start + i), 1800 * std::sin(M_PI * t / 10), 1.2);
  }
  CHECK(!sweep.advance(start + 20000));
}

TEST(the_profile_is_a_trapezoid_that_ends_on_its_target) {
  std::mt19937 random(2);
  for (int i = 0; i < 400; ++i) {
    const int32_t from = static_cast<int32_t>(random() % 20000) - 10000;
    const int32_t to = static_cast<int32_t>(random() % 20000) - 10000;
    const int32_t speed = 1000 + static_cast<int32_t>(random() % 2000000);
    const int32_t accel = 100 + static_cast<int32_t>(random() % 40000);
    Profile profile;
    profile.start(from, to, speed, accel);
    int64_t last_speed = 0;
    int64_t steps = 0;
    const int32_t way = to >= from ? 1 : -1;
    int32_t last = from;
    while (!profile.done() && steps < 40000000) {
      const int32_t at = profile.step();
      const int64_t now = static_cast<int64_t>(profile.speed_q16()) * way;
      CHECK(now >= 0 && now <= speed);
      CHECK(now - last_speed <= lesser(accel, speed));
      CHECK(last_speed - now <= lesser<int64_t>(2 * lesser(accel, speed), 2 * accel));
      CHECK(way * (at - last) >= 0);
      last = at;
      last_speed = now;
      ++steps;
    }
    CHECK(profile.done());
    CHECK_EQUAL(profile.position(), to);
    // No slower than a trapezoid by more than a tenth and some steps at each end.
    const double way_q16 = std::fabs(static_cast<double>(to) - from) * 65536;
    const double top = speed;
    const double a = lesser(accel, speed);
    const double ramps = top * top / a;
    const double least = way_q16 > ramps ? way_q16 / top + top / a : 2 * std::sqrt(way_q16 / a);
    CHECK(steps <= 1.1 * least + 40);
  }
}

// A geared motor: speed follows the duty beyond a dead zone, with a lag.
struct Motor {
  double counts = 0;
  double speed = 0;  // counts/s
  double pull = 0;   // counts/s that the body's air adds
  bool jammed = false;
  void step(int duty) {
    const double beyond = std::fmax(0.0, std::abs(duty) - 60.0);
    const double wanted = (duty < 0 ? -1 : 1) * 1790.0 * beyond / 740 + (duty != 0 ? pull : 0);
    speed += (wanted - speed) * 0.005 / 0.07;
    if (jammed || duty == 0) speed = 0;
    counts += speed * 0.005;
  }
  int32_t read() const { return static_cast<int32_t>(std::floor(counts)); }
};

TEST(the_spool_arrives_within_its_tolerance) {
  Settings s;
  for (const int32_t um : {2000, 100000, 530000}) {
    SpoolLoop spool;
    Motor motor;
    const int32_t target = s.d.counts(um);
    spool.start(0, target, s.d.speed_q16(20000), s.d.accel_q16, kMotorFull);
    SpoolLoop::Outcome outcome = SpoolLoop::Outcome::kMoving;
    int steps = 0;
    while (outcome == SpoolLoop::Outcome::kMoving && steps < 20000) {
      outcome = spool.step(motor.read(), s.c, s.d);
      CHECK(spool.duty() >= 0);
      motor.step(spool.duty());
      ++steps;
    }
    CHECK(outcome == SpoolLoop::Outcome::kArrived);
    CHECK_EQUAL(spool.duty(), 0);
    CHECK_NEAR(motor.read(), target, 2 * s.d.tolerance_counts + 2);
    CHECK(steps * 0.005 < um / 20000.0 + 2.0);
  }
}

TEST(a_jammed_spool_is_a_stall_and_a_pulled_one_is_braked) {
  Settings s;
  SpoolLoop spool;
  Motor motor;
  motor.jammed = true;
  const auto steps_to_stall = [&](int32_t target) {
    spool.start(0, target, s.d.speed_q16(20000), s.d.accel_q16, kMotorFull);
    int steps = 0;
    while (spool.step(motor.read(), s.c, s.d) == SpoolLoop::Outcome::kMoving && steps < 1000) {
      motor.step(spool.duty());
      ++steps;
    }
    CHECK_EQUAL(spool.duty(), 0);
    return steps;
  };
  const int in = steps_to_stall(-1000);
  CHECK(in > 80 && in < 160);  // 400 ms of standing still
  const int out = steps_to_stall(1000);
  CHECK(out > 40 && out < 90);  // 3 mm of the profile, which gathers speed

  // Air pulls harder than the profile: the loop brakes, it never winds in.
  Motor pulled;
  pulled.pull = 600;
  spool.start(0, 1000, s.d.speed_q16(20000), s.d.accel_q16, kMotorFull);
  SpoolLoop::Outcome outcome = SpoolLoop::Outcome::kMoving;
  for (int i = 0; i < 2000 && outcome == SpoolLoop::Outcome::kMoving; ++i) {
    outcome = spool.step(pulled.read(), s.c, s.d);
    CHECK(spool.duty() >= 0);
    pulled.step(spool.duty());
  }
  CHECK(outcome == SpoolLoop::Outcome::kArrived);
}

TEST(gains_that_are_wrong_do_not_outrun_the_profile) {
  Settings s;
  s.set(Param::kSpoolKp, 0);
  s.set(Param::kSpoolKff, 32767);
  SpoolLoop spool;
  Motor motor;
  spool.start(0, s.d.counts(100000), s.d.speed_q16(20000), s.d.accel_q16, kMotorFull);
  const double profile_counts_s = 0.02 * 2 * 7600;
  for (int i = 1; i <= 400; ++i) {
    CHECK(spool.step(motor.read(), s.c, s.d) == SpoolLoop::Outcome::kMoving);
    CHECK(!spool.overrun());
    motor.step(spool.duty());
    CHECK(motor.counts < i * 0.005 * profile_counts_s + 2 * s.d.lead_counts);
  }
}

TEST(a_dead_encoder_costs_less_than_two_centimetres_of_growth) {
  for (const int32_t speed_um_s : {5000, 20000, 48000}) {
    Settings s;
    SpoolLoop spool;
    Motor motor;
    spool.start(0, s.d.counts(400000), s.d.speed_q16(speed_um_s), s.d.accel_q16, kMotorFull);
    for (int i = 0; i < 300; ++i) {
      CHECK(spool.step(motor.read(), s.c, s.d) == SpoolLoop::Outcome::kMoving);
      motor.step(spool.duty());
    }
    const int32_t place = motor.read();
    while (spool.step(place, s.c, s.d) == SpoolLoop::Outcome::kMoving) motor.step(spool.duty());
    CHECK(motor.read() - place < s.d.counts(15000));
  }
}

TEST(a_tail_that_no_brake_holds_slips_while_the_spool_pays_out) {
  Settings s;
  SpoolLoop spool;
  spool.start(0, s.d.counts(100000), s.d.speed_q16(5000), s.d.accel_q16, kMotorFull);
  int32_t counts = 0;
  int32_t ahead = 0;
  while (!spool.overrun() && counts < 10000) {
    CHECK(spool.step(counts, s.c, s.d) == SpoolLoop::Outcome::kMoving);
    if (counts > 60) CHECK_EQUAL(spool.duty(), 0);
    ahead = counts;
    counts += 3;
  }
  CHECK(ahead > s.d.lead_counts + s.d.slip_counts);
  CHECK(ahead < 2 * (s.d.lead_counts + s.d.slip_counts));
}

TEST(movement_with_the_motor_off_is_a_slip_after_coasting) {
  SlipWatch slip;
  const int32_t limit = 45;
  for (int i = 0; i < 100; ++i) CHECK(!slip.step(i * 2, true, limit));
  int32_t counts = 200;
  for (int i = 1; i < SlipWatch::kCoastSteps; ++i) CHECK(!slip.step(counts += 3, false, limit));
  for (int i = 0; i < limit; ++i) CHECK(!slip.step(++counts, false, limit));
  CHECK(slip.step(++counts, false, limit));
  slip.accept(counts);
  CHECK(!slip.step(counts, false, limit));
  CHECK(slip.step(counts - limit - 1, false, limit));  // either way
}

TEST(length_and_counts_agree_both_ways) {
  Settings s;
  CHECK_NEAR(s.d.counts(530000), 0.53 * 2 * 7600, 1);
  for (int32_t um = 0; um < 530000; um += 137) CHECK_NEAR(s.d.um(s.d.counts(um)), um, 34);
  for (const int32_t per_m : {100, 7600, 1000000}) {
    s.set(Param::kCountsPerM, per_m);
    for (const int32_t um : {-5000000, -1000, 0, 1000, 5000000}) {
      CHECK_NEAR(s.d.counts(um), um * 2e-6 * per_m, 0.51 + std::fabs(um) * 1e-6);
    }
  }
}

}  // namespace control_cases

#endif  // THIGMO_TESTS_FIRMWARE_CONTROL_CASES_H_
