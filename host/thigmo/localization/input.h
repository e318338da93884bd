// One frame from the caller's units to a normalised one, checked.
#pragma once

#include <numeric>

#include "whitening.h"

namespace thigmo {

// The constants of priors.py, by their names there in small letters; passed with every call.
// clang-format off
#define THIGMO_PRIORS(X) \
  X(least_lever) X(contact) X(end) X(end_straight) X(held) X(held_straight) X(another) X(hinge) \
  X(base_fold) X(bad_deviation) X(angle) X(near_fold) X(straight) X(end_turn) X(shape_rests) \
  X(level) X(excluded) X(held_excluded) X(five_sigma) X(noise_factor) X(noise_odds) X(hopeless) \
  X(trust) X(end_cell) X(misfit_deviate) X(noise_deviate) X(contact_unsure) X(felt) X(swept)
// clang-format on
struct Priors {
  Row moments, noise_levels;
#define THIGMO_PRIOR(name) double name;
  THIGMO_PRIORS(THIGMO_PRIOR)
#undef THIGMO_PRIOR
};

struct Window {
  double near, far;
  bool operator==(const Window&) const = default;
};

// What holds for all frames of the same sensors, under the names that localizer.py gives. Rows have
// N numbers, or one for all sensors.
struct Options {
  Row position, span, noise, gain, bad_odds;
  Matrix shared;  // (K, N) in the caller's unit
  double offset, map_scale, length;
  double radius;                    // of the tube, over the length
  double critical, critical_error;  // base moment that folds it, and its relative standard error
  bool folds_perhaps;               // at a moment that is not known
  // Whether something holds the end, so that it bears any couple: surely not, perhaps, or surely.
  enum class Held { no, perhaps, yes } held_end;
  // Prior odds, against a contact on the side, of one on the end and of a held end; NaN: usual.
  double end_odds, held_odds;
  int contacts;  // how many there are known to be, or -1
  Window within;
  double width_limit;
  double number_level;  // probability of the number, below which nothing is localized
  // Of a body in space: its readings' directions, and what bends it beside contacts.
  Matrix direction;      // (N, 3) axis of the turn that each measures; none in a plane
  Matrix curvature_map;  // (2 cells, N) the body's bends in each cell, from readings
  Row compliance;        // EI over the stiffness against each component of a moment
  Row weight;            // of a body of length one, over EI
  Priors priors;
};

// One frame: rows have N numbers, or one for all sensors.
struct Input {
  Row curvature, free, body;
};

struct Readings {
  Frame frame;
  std::vector<int> index;  // (N,) places in the caller's arrays
  Row bad;                 // (N,) standard deviation of a bad reading
  Row log_bad;             // (N,) log prior odds of one
  double noise, turn;      // mean white noise; turn of the free body
  bool known;              // whether the noise is known
};

// Why a frame is refused; validation.py has the sentences, and checks what holds for every frame.
enum class Problem { none, infinite, no_reading, free, too_tight, constant };

inline double pick(const Row& values, std::size_t i) { return values[values.size() == 1 ? 0 : i]; }

// Where a sensor begins and ends on the body, over the length.
inline std::pair<double, double> ends_of_sensor(const Options& of, std::size_t i) {
  const double half = 0.5 * pick(of.span, i);
  const auto on_body = [&](double x) { return std::clamp(x, 0.0, of.length) / of.length; };
  return {on_body(of.position[i] - half), on_body(of.position[i] + half)};
}

// The problem, and a number that shows it.
inline std::pair<Problem, double> problem_of(const Input& in, const Options& options) {
  const std::size_t n = in.curvature.size();
  double tightest = 0.0;
  std::size_t finite = 0;
  bool same = true, passive = true;
  for (std::size_t i = 0; i < n; ++i) {
    const double k = in.curvature[i], g = pick(in.free, i);
    if (std::isinf(k)) return {Problem::infinite, k};
    if (!std::isfinite(g)) return {Problem::free, g};
    tightest = std::max(tightest, std::abs(g));
    passive = passive && g == 0.0;
    if (std::isnan(k)) continue;
    tightest = std::max(tightest, std::abs(k));
    same = same && (finite == 0 || k == in.curvature[i - 1]);
    ++finite;
  }
  if (finite == 0) return {Problem::no_reading, 0.0};
  if (tightest * options.radius * options.length > 1.0) return {Problem::too_tight, tightest};
  // A body that nothing bends reads no constant curvature but zero.
  if (n >= 3 && same && passive && finite == n && in.curvature[0] != 0.0) {
    return {Problem::constant, in.curvature[0]};
  }
  return {Problem::none, 0.0};
}

// Curvature of the free body at the nodes, linear between sensors.
inline Row rest_of(const Row& body, const Row& position, double length) {
  Row rest(kNodes, body[0] * length);
  if (body.size() == 1) return rest;
  std::vector<int> order(body.size());
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](int a, int b) { return position[a] < position[b]; });
  std::size_t next = 1;
  for (int k = 0; k < kNodes; ++k) {
    const double at = k * length / (kNodes - 1);
    while (next + 1 < order.size() && position[order[next]] <= at) ++next;
    const int a = order[next - 1], b = order[next];
    const double apart = std::max(position[b] - position[a], 1e-300);
    const double share = std::clamp((at - position[a]) / apart, 0.0, 1.0);
    rest[k] = (body[a] + share * (body[b] - body[a])) * length;
  }
  return rest;
}

inline Readings normalised(const Input& in, const Options& options) {
  const Priors& priors = options.priors;
  const double length = options.length;
  Readings out;
  Frame& frame = out.frame;
  double most = 1e-6, square = 0.0;
  out.turn = out.noise = 0.0;
  Row free;
  out.index.reserve(in.curvature.size());
  for (Row* each : {&frame.excess, &frame.low, &frame.high, &frame.noise, &frame.gain, &free,
                    &out.bad, &out.log_bad}) {
    each->reserve(in.curvature.size());
  }
  for (std::size_t i = 0; i < in.curvature.size(); ++i) {
    if (std::isnan(in.curvature[i])) continue;
    const double g = pick(in.free, i);
    const auto [low, high] = ends_of_sensor(options, i);
    const double excess = (in.curvature[i] - g) * length;
    out.index.push_back(static_cast<int>(i));
    frame.excess.push_back(excess);
    frame.low.push_back(low);
    frame.high.push_back(high);
    frame.noise.push_back(options.noise.empty() ? 1.0 : pick(options.noise, i) * length);
    // A share of the curvature, which is near what is read, or that of the free body.
    frame.gain.push_back(pick(options.gain, i) * length *
                         std::max(std::abs(in.curvature[i]), std::abs(g)));
    free.push_back(g * length);
    out.bad.push_back(
        std::sqrt(priors.bad_deviation * priors.bad_deviation + g * g * length * length));
    out.log_bad.push_back(std::log(std::max(pick(options.bad_odds, i), 1e-300)));
    most = std::max({most, std::abs(excess), std::abs(g * length)});
    out.turn = std::max(out.turn, std::abs(g * length));
    square += excess * excess;
  }
  const int n = frame.size();
  const double trust = priors.trust * most;
  for (double& gain : frame.gain) gain = std::sqrt(gain * gain + trust * trust);
  out.known = !options.noise.empty();
  frame.levels = {{1.0, 0.0}};
  if (!out.known) {
    const double scale = std::max(std::sqrt(square / n), trust);
    frame.levels.clear();
    const double odds = -std::log(static_cast<double>(priors.noise_levels.size()));
    for (const double level : priors.noise_levels) frame.levels.push_back({level * scale, odds});
  }
  for (const double noise : frame.noise) out.noise += noise / n / length;
  const int own = (options.offset > 0.0) + (options.map_scale > 0.0);
  frame.shared = Matrix(own + options.shared.rows, n);
  for (int i = 0; i < n; ++i) {
    int k = 0;
    if (options.offset > 0.0) frame.shared[k++][i] = options.offset * length;
    if (options.map_scale > 0.0) frame.shared[k++][i] = options.map_scale * free[i];
    for (int j = 0; j < options.shared.rows; ++j) {
      frame.shared[k++][i] = options.shared[j][out.index[i]] * length;
    }
  }
  return out;
}

}  // namespace thigmo
