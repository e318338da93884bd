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
  X(level) X(excluded) X(held_excluded) X(five_sigma) X(hopeless) X(slight_map_odds) X(slight_offset_odds) X(slight_map) \
  X(slight_offset) X(turned_odds) X(far_odds) X(not_given_odds) X(small_fold_odds) X(small_fold) \
  X(correlated_odds) X(dense) X(untouched) X(dropped_row) X(trust) X(end_cell) X(misfit_deviate) X(noise_deviate) X(contact_unsure) X(detected) X(swept)
// clang-format on
struct Priors {
  Row moments, noise_levels, noise_factors, noise_odds, correlations;
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
  double offset, map_scale,
      length;                       // offset and map: NaN if they are not stated
  double base_fold;                 // angle of a small fold at the base; NaN: not stated
  double correlation;               // of neighbouring readings' noise; NaN: not stated
  double largest_noise;             // factor by which the noise may at most exceed that stated
  double couple_odds;               // prior odds of a contact that bears a couple
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
  // Of a body in space: its readings' axes, and what bends it beside contacts.
  Matrix axis;           // (N, 3) unit vector of the turn that each measures; none in a plane
  Matrix curvature_map;  // (2 cells, N) the body's bends in each cell, from readings
  Row compliance;        // EI over the stiffness against each component of a moment
  Row weight;            // of a body of length one, over EI
  Priors priors;
};

// One frame: rows have N numbers, or one for all sensors. `free` is empty if not given.
struct Input {
  Row curvature, free, body;
};

struct Readings {
  Frame frame;
  std::vector<int> index;  // (N,) places in the caller's arrays
  Row bad;                 // (N,) standard deviation of a bad reading
  Row log_bad;             // (N,) log prior odds of one
  Row free;                // (N,) free readings over the inverse of the length
  bool given;              // whether the caller gave those
  double noise, turn;      // mean white noise, 1/length; turn of the free body
  bool known;              // whether the noise is known
};

// Why a frame is refused; validation.py has the sentences, and checks what holds for every frame.
enum class InputProblem { none, infinite, no_reading, free, too_tight, constant, curls };

inline double pick(const Row& values, std::size_t i) { return values[values.size() == 1 ? 0 : i]; }
inline double free_of(const Input& in, std::size_t i) {
  return in.free.empty() ? 0.0 : pick(in.free, i);
}

// Where a sensor begins and ends on the body, over the length.
inline std::pair<double, double> ends_of_sensor(const Options& options, std::size_t i) {
  const double half = 0.5 * pick(options.span, i);
  const auto on_body = [&](double x) {
    return std::clamp(x, 0.0, options.length) / options.length;
  };
  return {on_body(options.position[i] - half), on_body(options.position[i] + half)};
}

// Why the frame is refused, and the number that shows it.
inline std::pair<InputProblem, double> input_problem(const Input& in, const Options& options) {
  const std::size_t n = in.curvature.size();
  double tightest = 0.0, sum = 0.0;
  std::size_t finite = 0;
  bool same = true, passive = true;
  for (std::size_t i = 0; i < n; ++i) {
    const double k = in.curvature[i], g = free_of(in, i);
    if (std::isinf(k)) return {InputProblem::infinite, k};
    if (!std::isfinite(g)) return {InputProblem::free, g};
    tightest = std::max(tightest, std::abs(g));
    passive = passive && g == 0.0;
    if (std::isnan(k)) continue;
    tightest = std::max(tightest, std::abs(k)), sum += k;
    same = same && (finite == 0 || k == in.curvature[i - 1]);
    ++finite;
  }
  if (finite == 0) return {InputProblem::no_reading, 0.0};
  if (tightest * options.radius * options.length > 1.0) return {InputProblem::too_tight, tightest};
  // No real body curls into a whole ring, but one whose curvature and length have different units
  // seems to.
  const double turn = std::abs(sum) / static_cast<double>(finite) * options.length;
  if (options.axis.rows == 0 && turn > 2.0 * std::numbers::pi) return {InputProblem::curls, turn};
  // Without loads, the same curvature at every sensor can only be zero.
  if (n >= 3 && same && passive && finite == n && in.curvature[0] != 0.0) {
    return {InputProblem::constant, in.curvature[0]};
  }
  return {InputProblem::none, 0.0};
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
    const double arc = k * length / (kNodes - 1);
    while (next + 1 < order.size() && position[order[next]] <= arc) ++next;
    const int a = order[next - 1], b = order[next];
    const double apart = std::max(position[b] - position[a], 1e-300);
    const double share = std::clamp((arc - position[a]) / apart, 0.0, 1.0);
    rest[k] = (body[a] + share * (body[b] - body[a])) * length;
  }
  return rest;
}

// What a fold of one radian, spread over one diameter from the base, adds to a
// reading.
inline double fold_of(const Frame& frame, int i, double radius) {
  const double diameter = 2.0 * radius, span = frame.high[i] - frame.low[i];
  if (span < kPoint) return (frame.low[i] < diameter) / diameter;
  const double inside = std::min(frame.high[i], diameter) - frame.low[i];
  return std::max(inside, 0.0) / span / diameter;
}

// The table of mistakes: what may be wrong with the readings beyond what the
// caller stated. Stating an error removes its row. `rest`: curvature of the
// free body at the nodes, empty in space, where neither folds nor correlated
// noise are weighed.
inline std::vector<ErrorRow> mistakes(const Readings& readings, const Options& options,
                                      const Row& rest) {
  const Priors& priors = options.priors;
  const Frame& frame = readings.frame;
  const int n = frame.size();
  const bool map_stated = !std::isnan(options.map_scale);
  const bool offset_stated = !std::isnan(options.offset);
  const bool in_space = rest.empty();
  const bool bends = readings.turn > 0.0;
  std::vector<ErrorRow> out(1);
  const auto add = [&](Mistake mistake, double odds, int columns) -> ErrorRow& {
    ErrorRow& row = out.emplace_back();
    row.mistake = mistake, row.log_odds = std::log(odds), row.columns = Matrix(columns, n);
    return row;
  };
  // The map a little off, and an offset as large as the noise or twice that.
  const auto slight = [&](ErrorRow& row, int first) {
    for (int i = 0; i < n; ++i) {
      int k = first;
      if (!map_stated && bends) row.columns[k++][i] = priors.slight_map * readings.free[i];
      if (!offset_stated && readings.known) {
        row.columns[k++][i] = priors.slight_offset * readings.noise * options.length;
      }
    }
  };
  const int slight_columns = (!map_stated && bends) + (!offset_stated && readings.known);
  if (slight_columns > 0) {
    const double odds = (!map_stated && bends ? priors.slight_map_odds : 0.0) +
                        (!offset_stated && readings.known ? priors.slight_offset_odds : 0.0);
    slight(add(Mistake::slight, odds, slight_columns), 0);
  }
  if (!map_stated && bends) {
    ErrorRow& sign = add(Mistake::sign, priors.turned_odds, slight_columns);
    slight(sign, 0), sign.mirrored = true;
    for (const double g : readings.free) sign.shift.push_back(2.0 * g);
    ErrorRow& twice = add(Mistake::twice, priors.turned_odds, slight_columns);
    slight(twice, 0), twice.shift = readings.free;
  }
  if (!map_stated) {
    // A free curvature of any size, constant along the body: in space, towards
    // both directions.
    const int towards = in_space ? 2 : 1, scaled = bends;
    const bool given = readings.given;
    ErrorRow& far = add(given ? Mistake::far : Mistake::not_given,
                        given ? priors.far_odds : priors.not_given_odds, scaled + towards);
    for (int i = 0; i < n; ++i) {
      if (scaled) far.columns[0][i] = readings.free[i];
      for (int k = 0; k < towards; ++k) {
        const int reading = readings.index[i];
        far.columns[scaled + k][i] = in_space ? options.axis[reading][k + 1] : 1.0;
      }
    }
    if (!in_space) {
      far.bends = Matrix(scaled + towards, kNodes);
      if (scaled) std::copy(rest.begin(), rest.end(), far.bends[0]);
      std::fill_n(far.bends[scaled], kNodes, 1.0);
    }
  }
  if (!in_space && std::isnan(options.base_fold)) {
    ErrorRow& fold = add(Mistake::fold, priors.small_fold_odds, 1);
    double most = 0.0;
    for (int i = 0; i < n; ++i) {
      fold.columns[0][i] = priors.small_fold * fold_of(frame, i, options.radius);
      most = std::max(most, fold.columns[0][i]);
    }
    if (most == 0.0) out.pop_back();  // no sensor sees it
  }
  if (!in_space && !std::isnan(options.correlation)) {
    for (ErrorRow& row : out) row.correlation = options.correlation;
  } else if (!in_space && n >= priors.dense) {
    for (const double correlation : priors.correlations) {
      add(Mistake::correlated, priors.correlated_odds, 0).correlation = correlation;
    }
  }
  double rest_of_odds = 1.0;
  for (std::size_t row = 1; row < out.size(); ++row) rest_of_odds -= std::exp(out[row].log_odds);
  out[0].log_odds = std::log(rest_of_odds);
  return out;
}

inline Readings normalised(const Input& in, const Options& options) {
  const Priors& priors = options.priors;
  const double length = options.length;
  Readings out;
  Frame& frame = out.frame;
  double most = 1e-6, square = 0.0;
  out.turn = out.noise = 0.0;
  Row free;
  out.given = !in.free.empty();
  std::vector<int> order(in.curvature.size());
  std::iota(order.begin(), order.end(), 0);
  if (options.axis.rows == 0) {
    std::stable_sort(order.begin(), order.end(),
                     [&](int a, int b) { return options.position[a] < options.position[b]; });
  }
  out.index.reserve(in.curvature.size());
  for (Row* row : {&frame.excess, &frame.low, &frame.high, &frame.noise, &frame.gain, &free,
                   &out.bad, &out.log_bad}) {
    row->reserve(in.curvature.size());
  }
  for (std::size_t place = 0; place < order.size(); ++place) {
    const std::size_t i = order[place];
    if (std::isnan(in.curvature[i])) continue;
    frame.rank.push_back(static_cast<int>(place));
    const double g = free_of(in, i);
    const auto [low, high] = ends_of_sensor(options, i);
    const double excess = (in.curvature[i] - g) * length;
    out.index.push_back(static_cast<int>(i));
    frame.excess.push_back(excess);
    frame.low.push_back(low);
    frame.high.push_back(high);
    frame.noise.push_back(options.noise.empty() ? 1.0 : pick(options.noise, i) * length);
    // A gain error is relative to the curvature: the larger of reading and free curvature.
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
  out.free = free;
  const int stated_errors =
      (options.offset > 0.0) + (options.map_scale > 0.0) + (options.base_fold > 0.0);
  frame.shared = Matrix(stated_errors + options.shared.rows, n);
  for (int i = 0; i < n; ++i) {
    int k = 0;
    if (options.offset > 0.0) frame.shared[k++][i] = options.offset * length;
    if (options.map_scale > 0.0) frame.shared[k++][i] = options.map_scale * free[i];
    if (options.base_fold > 0.0) {
      frame.shared[k++][i] = options.base_fold * fold_of(frame, i, options.radius);
    }
    for (int j = 0; j < options.shared.rows; ++j) {
      frame.shared[k++][i] = options.shared[j][out.index[i]] * length;
    }
  }
  return out;
}

}  // namespace thigmo
