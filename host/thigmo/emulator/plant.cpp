// The plant's parts over one step of 10 ms: a muscle with its transducer, the body's swing, the
// spool and a flex sensor. The extension module thigmo.emulator._plant, with types in _plant.pyi.
//
// Quasi-static mechanics (thigmo.mechanics) stand between the muscles, which yield the free
// curvature, and the sensors, which turn the body's curvature into ADC counts. plant.py puts the
// parts together and is their only user.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

namespace nb = nanobind;

namespace {

constexpr double kStepS = 0.01;
constexpr double kDutyFull = 800.0;
constexpr double kStickingCmS = 0.5;   // line speed over which friction falls to sliding [G]
constexpr double kOpenWindings = 0.1;  // damping left in an open circuit: bearings, brushes [G]

// Share of the way to its goal that a first-order lag goes in a step.
double share(double tau_s) { return 1.0 - std::exp(-kStepS / tau_s); }

class Delay {
 public:
  explicit Delay(double delay_s)
      : steps_(delay_s / kStepS), past_(static_cast<std::size_t>(steps_) + 2, 0.0) {}

  // Takes a value and returns the one so long ago, linear between steps.
  double pass(double value) {
    const std::size_t size = past_.size();
    const auto whole = static_cast<std::size_t>(steps_);
    head_ = (head_ + 1) % size;
    past_[head_] = value;
    const double a = past_[(head_ + size - whole) % size];
    const double b = past_[(head_ + size - whole - 1) % size];
    return a + (steps_ - static_cast<double>(whole)) * (b - a);
  }

 private:
  double steps_;
  std::vector<double> past_;
  std::size_t head_ = 0;
};

// Curvature over pressure: amplitude * (tanh((p - offset) / scale) - tanh(-offset / scale)).
struct Map {
  double amplitude, scale, offset;
  double curvature(double psi) const {
    return amplitude * (std::tanh((psi - offset) / scale) - std::tanh(-offset / scale));
  }
};

struct Muscle {
  double at_4ma_psi, at_20ma_psi, gain, lag_s, delay_s, play_psi, slew_psi_s, supply_psi;
  double inflate_tau_s, deflate_tau_s, muscle_delay_s, reversal_psi;

  Map inflate{0.0, 1.0, 0.0}, deflate{0.0, 1.0, 0.0};
  Delay drive{delay_s}, outlet{muscle_delay_s};
  double play = 0.0;
  double outlet_psi = 0.0;
  double bend_psi = 0.0;
  double deflating = 0.0;  // 0 on the branch of inflation, 1 on that of deflation

  // Returns the free curvature's size. forced_psi overrides the transducer unless it is nan.
  double advance(double current_ma, double forced_psi) {
    double psi = at_4ma_psi + (current_ma - 4.0) / 16.0 * (at_20ma_psi - at_4ma_psi);
    psi = current_ma > 0.0 ? std::min(std::max(psi * gain, 0.0), supply_psi) : 0.0;
    // Play between command and output.
    const double commanded = drive.pass(psi);
    play = commanded <= 0.0 ? 0.0
                            : std::min(std::max(play, commanded - play_psi), commanded + play_psi);
    const double goal = std::isnan(forced_psi) ? play : forced_psi;
    const double most = slew_psi_s * kStepS;
    outlet_psi += std::min(std::max((goal - outlet_psi) * share(lag_s), -most), most);
    if (goal == 0.0 && outlet_psi < 1e-6) outlet_psi = 0.0;
    const double delayed_psi = outlet.pass(outlet_psi);
    const double before = bend_psi;
    bend_psi +=
        (delayed_psi - before) * share(delayed_psi > before ? inflate_tau_s : deflate_tau_s);
    if (delayed_psi == 0.0 && bend_psi < 1e-6) bend_psi = 0.0;
    deflating = std::clamp(deflating - (bend_psi - before) / reversal_psi, 0.0, 1.0);
    if (bend_psi == 0.0) deflating = 0.0;
    return (1.0 - deflating) * inflate.curvature(bend_psi) +
           deflating * deflate.curvature(bend_psi);
  }
};

// A second-order body that follows its target by an exact step.
class Swing {
 public:
  Swing(double frequency_hz, double damping) {
    const double w = 2.0 * std::numbers::pi * frequency_hz;
    const double a = damping * w;
    const double d = w * std::sqrt(std::fabs(1.0 - damping * damping));
    double c = 1.0;
    double s = kStepS;
    if (damping < 1.0) {
      c = std::cos(d * kStepS);
      s = std::sin(d * kStepS) / d;
    } else if (damping > 1.0) {
      c = std::cosh(d * kStepS);
      s = std::sinh(d * kStepS) / d;
    }
    const double e = std::exp(-a * kStepS);
    transition_ = {e * (c + a * s), e * s, -e * w * w * s, e * (c - a * s)};
  }

  double curvature() const { return curvature_; }

  void follow(double target) {
    const double away = curvature_ - target;
    const double rate = rate_;
    curvature_ = target + transition_[0] * away + transition_[1] * rate;
    rate_ = transition_[2] * away + transition_[3] * rate;
    if (std::fabs(curvature_ - target) < 1e-10 && std::fabs(rate_) < 1e-9) {
      curvature_ = target;
      rate_ = 0.0;
    }
  }

 private:
  std::array<double, 4> transition_;
  double curvature_ = 0.0, rate_ = 0.0;
};

// Motor and line. Windings that are shorted (braked, or between the pulses of the drive) damp: they
// take as much force as the line is fast, and none at rest. What holds at rest is friction; it
// falls from holding to sliding as the line begins to move.
struct Spool {
  double damping, lag_s, stall_n, sliding_n, holding_n, touch_n_s_cm, line_cm;

  double speed = 0.0;
  double stop_cm = 0.0;  // line at which the tail is tight: against the base, or jammed
  double line_n = 0.0;   // pull on the line; at a stop, with the momentum that it takes up

  // pull_n: the tail's tension, which pays out.
  // brake_n: friction of a closed brake.
  void advance(int duty, bool shorted, bool stuck, double pull_n, double brake_n) {
    const double drive = stall_n * duty / kDutyFull + pull_n;
    line_n = pull_n;
    const double wound_n = std::max(-stall_n * duty / kDutyFull, 0.0);
    if (line_cm <= stop_cm && speed == 0.0) {
      line_n += wound_n;
      if (drive < 0.0) return;
    }
    const double friction =
        brake_n + sliding_n + (holding_n - sliding_n) * std::exp(-std::fabs(speed) / kStickingCmS);
    if (speed == 0.0 && std::fabs(drive) <= friction) return;
    const double way = speed != 0.0 ? speed : drive;
    const double taken = damping * (shorted ? 1.0 : kOpenWindings);
    const double goal = (drive - std::copysign(friction, way)) / taken;
    speed = goal + (speed - goal) * std::exp(-kStepS / (lag_s * damping / taken));
    if (speed * way <= 0.0 && std::fabs(drive) <= holding_n + brake_n) speed = 0.0;
    if (stuck) speed = 0.0;
    line_cm += speed * kStepS;
    if (line_cm < stop_cm) {
      line_n = pull_n + wound_n - touch_n_s_cm * std::min(speed, 0.0);
      line_cm = stop_cm;
      speed = 0.0;
    }
  }
};

struct FlexSensor {
  // What ails all sensors.
  double loop_width, against_gain, wrinkle, wrinkle_start_psi, wrinkle_full_psi, fold_bend;
  // Its own.
  double center_cm, span_cm, scale_per_ohm, zero_ohm, divider_ohm, bend_sign, loop, creep_tau_s;
  double stowed, phase_1, phase_2;

  bool everted = false;
  double everted_at_s = 0.0, offset = 0.0, creep = 0.0;
  double turn = 0.0, bent = 0.0;  // of the loop

  // Comes out of the tip: begins to creep, from an offset of this eversion.
  void evert(double at_s, double of_eversion, double creep_size) {
    everted = true;
    everted_at_s = at_s;
    offset = of_eversion;
    creep = creep_size * (bend_sign != 0.0 ? bend_sign : 1.0);
    turn = 0.0;
  }

  // Goes back into the tail and forgets.
  void stow() { everted = false; }

  // Ideal ADC count at a mean curvature (over the everted part), under its side's muscle.
  double count(double curvature, double length_cm, double t_s, double muscle_psi) {
    double value = curvature * bend_sign < 0.0 ? curvature * against_gain : curvature;
    // Dahl's model of the loop: the lag saturates after loop_width of bending.
    const double change = curvature - bent;
    bent = curvature;
    if (change != 0.0) {
      const double end = std::copysign(1.0, change);
      turn = end + (turn - end) * std::exp(-std::fabs(change) / loop_width);
    }
    value -= loop * turn;
    // Garbage while this side's muscle wrinkles the wall under it.
    const double wrinkled = std::clamp(
        (muscle_psi - wrinkle_start_psi) / (wrinkle_full_psi - wrinkle_start_psi), 0.0, 1.0);
    if (wrinkled > 0.0) {
      const double garbage = 0.3 * value + wrinkle * (std::sin(phase_1 + 0.9 * muscle_psi) +
                                                      0.6 * std::sin(phase_2 + 3.1 * muscle_psi));
      value += wrinkled * wrinkled * (3.0 - 2.0 * wrinkled) * (garbage - value);
    }
    if (everted) {
      value += offset;
      const double age_s = t_s - everted_at_s;
      if (age_s < 12.0 * creep_tau_s) value += creep * std::exp(-age_s / creep_tau_s);
    } else {
      // In the tail, or passing through the tip's fold.
      const double out =
          std::clamp((length_cm - (center_cm - 0.5 * span_cm)) / std::max(span_cm, 1e-9), 0.0, 1.0);
      const double sign = bend_sign != 0.0 ? bend_sign : 1.0;
      const double fold = sign * fold_bend * (1.0 - std::cos(2.0 * std::numbers::pi * out)) * 0.5;
      value = out * value + (1.0 - out) * stowed + fold;
    }
    const double ohm = std::max(zero_ohm + value / scale_per_ohm, 500.0);
    return 1024.0 * divider_ohm / (divider_ohm + ohm);
  }
};

}  // namespace

NB_MODULE(_plant, m) {
  // At exit nanobind lists what is still held, as by a daemon thread that serves a robot: no leak,
  // and an operator who ends a program shall read one line.
  nb::set_leak_warnings(false);
  m.doc() = "The emulated plant's parts.";
  m.attr("STEP_S") = kStepS;
  using D = double;
  nb::class_<Muscle>(m, "Muscle")
      .def(nb::init<D, D, D, D, D, D, D, D, D, D, D, D>(), nb::kw_only(), nb::arg("at_4ma_psi"),
           nb::arg("at_20ma_psi"), nb::arg("gain"), nb::arg("lag_s"), nb::arg("delay_s"),
           nb::arg("play_psi"), nb::arg("slew_psi_s"), nb::arg("supply_psi"),
           nb::arg("inflate_tau_s"), nb::arg("deflate_tau_s"), nb::arg("muscle_delay_s"),
           nb::arg("reversal_psi"))
      .def("set_maps",
           [](Muscle& muscle, std::array<double, 3> inflate, std::array<double, 3> deflate) {
             muscle.inflate = {inflate[0], inflate[1], inflate[2]};
             muscle.deflate = {deflate[0], deflate[1], deflate[2]};
           })
      .def("advance", &Muscle::advance)
      .def_ro("outlet_psi", &Muscle::outlet_psi)
      .def_ro("bend_psi", &Muscle::bend_psi);
  nb::class_<Swing>(m, "Swing")
      .def(nb::init<D, D>(), nb::kw_only(), nb::arg("frequency_hz"), nb::arg("damping"))
      .def("follow", &Swing::follow)
      .def_prop_ro("curvature", &Swing::curvature);
  nb::class_<Spool>(m, "Spool")
      .def(nb::init<D, D, D, D, D, D, D>(), nb::kw_only(), nb::arg("damping"), nb::arg("lag_s"),
           nb::arg("stall_n"), nb::arg("sliding_n"), nb::arg("holding_n"), nb::arg("touch_n_s_cm"),
           nb::arg("line_cm"))
      .def("advance", &Spool::advance)
      .def_ro("damping", &Spool::damping)
      .def_ro("sliding_n", &Spool::sliding_n)
      .def_ro("line_n", &Spool::line_n)
      .def_rw("stop_cm", &Spool::stop_cm)
      .def_ro("line_cm", &Spool::line_cm);
  nb::class_<FlexSensor>(m, "FlexSensor")
      .def(nb::init<D, D, D, D, D, D, D, D, D, D, D, D, D, D, D, D, D>(), nb::kw_only(),
           nb::arg("loop_width"), nb::arg("against_gain"), nb::arg("wrinkle"),
           nb::arg("wrinkle_start_psi"), nb::arg("wrinkle_full_psi"), nb::arg("fold_bend"),
           nb::arg("center_cm"), nb::arg("span_cm"), nb::arg("scale_per_ohm"), nb::arg("zero_ohm"),
           nb::arg("divider_ohm"), nb::arg("bend_sign"), nb::arg("loop"), nb::arg("creep_tau_s"),
           nb::arg("stowed"), nb::arg("phase_1"), nb::arg("phase_2"))
      .def("evert", &FlexSensor::evert)
      .def("stow", &FlexSensor::stow)
      .def("count", &FlexSensor::count)
      .def_ro("everted", &FlexSensor::everted)
      .def_ro("center_cm", &FlexSensor::center_cm)
      .def_ro("span_cm", &FlexSensor::span_cm);
}
