// Evidence of loads on a body, given one frame of readings.
//
// Once the places of the loads and the bent shape are given, readings are linear in the loads:
//     d = C f + e,   f ~ N(0, S),   e ~ N(0, V),
// so the evidence of a set of places is a closed form (any text on Bayesian linear models):
//     log B = 1/2 b' (S^-1 + C'V^-1 C)^-1 b - 1/2 log |I + S C'V^-1 C|,   b = C'V^-1 d.
// Levers are those of the bent shape, which follows from the likeliest places; shape and grid are
// refined together, until the shape rests and no cell of the grid holds most of the mass.
#pragma once

#include <optional>

#include "errors.h"

namespace thigmo {

struct ForcePrior {
  Row scales;       // standard deviations of the largest moment, equally likely
  double least;     // the prior widens no more than at this share of the largest lever
  double critical;  // base moment at which the base folds; infinite if it does not
  double straight;  // turn (rad) below which a body counts as straight
  double rests;     // change of curvature below which a shape rests
};

struct Window {
  double near, far;
};

constexpr int kMostPasses = 9;
constexpr int kMostTurns = 24;
constexpr double kResolved = 0.35;  // mass of a cell above which the grid is too coarse
constexpr double kOutside = 1e-6;   // mass of a cell below which the grid may leave it out

// Probability that a normal number lies within plus and minus a limit.
inline double probability_within(double mean, double variance, double limit) {
  const double scale = 1.0 / std::sqrt(2.0 * std::max(variance, 1e-300));
  return 0.5 * (std::erf((limit - mean) * scale) + std::erf((limit + mean) * scale));
}

// Normal density of up to four loads on whitened readings.
struct Solution {
  static constexpr int kMost = 4;
  int count;
  double gain, log_volume;  // log evidence is gain / 2 - log_volume / 2
  std::array<double, kMost> mean, deviation;

  // `column` are whitened and in units of their prior deviations, so the prior is N(0, I).
  Solution(const std::vector<Row>& column, const Row& read) : count(column.size()) {
    const int n = static_cast<int>(read.size());
    double a[kMost][kMost], inverse[kMost][kMost] = {}, told[kMost];
    for (int j = 0; j < count; ++j) {
      told[j] = Whitener::dot(column[j].data(), read.data(), n);
      for (int k = 0; k <= j; ++k) {
        a[j][k] = (j == k) + Whitener::dot(column[j].data(), column[k].data(), n);
      }
    }
    log_volume = 0.0;
    for (int j = 0; j < count; ++j) {  // Cholesky, and the inverse of its factor
      for (int k = 0; k <= j; ++k) {
        for (int l = 0; l < k; ++l) a[j][k] -= a[j][l] * a[k][l];
        if (k < j) a[j][k] /= a[k][k];
      }
      a[j][j] = std::sqrt(a[j][j]);
      log_volume += 2.0 * std::log(a[j][j]);
      for (int k = 0; k <= j; ++k) {
        double sum = j == k;
        for (int l = k; l < j; ++l) sum -= a[j][l] * inverse[l][k];
        inverse[j][k] = sum / a[j][j];
      }
    }
    gain = 0.0;
    mean = deviation = {};
    for (int j = 0; j < count; ++j) {
      double half = 0.0;
      for (int k = 0; k <= j; ++k) half += inverse[j][k] * told[k];
      gain += half * half;
      for (int k = 0; k <= j; ++k) {
        mean[k] += inverse[j][k] * half;
        deviation[k] += inverse[j][k] * inverse[j][k];
      }
    }
    for (int j = 0; j < count; ++j) deviation[j] = std::sqrt(deviation[j]);
  }
};

// Levers of normal forces on a shape, or on a straight body; of loads spread evenly over `half` to
// either side.
inline Levers levers_at(const Frame& frame, const std::optional<Shape>& shape, const Row& place,
                        double half) {
  constexpr int kPoints = 5;  // of a spread load
  const int count = static_cast<int>(place.size());
  Levers out(frame.size(), count);
  const auto fill = [&](const Row& at, Levers& into) {
    if (shape) {
      bent_levers(*shape, at, frame.low, frame.high, into);
    } else {
      straight_levers(at, frame.low, frame.high, into);
    }
  };
  if (half == 0.0) {
    fill(place, out);
    return out;
  }
  Levers part(frame.size(), count);
  Row moved(count);
  for (int p = 0; p < kPoints; ++p) {
    for (int m = 0; m < count; ++m) {
      moved[m] = std::clamp(place[m] + half * (2.0 * p / (kPoints - 1) - 1.0), 0.0, 1.0);
    }
    fill(moved, part);
    const auto add = [](Row& to, const Row& from) {
      for (std::size_t k = 0; k < to.size(); ++k) to[k] += from[k] / kPoints;
    };
    add(out.sensor.value, part.sensor.value);
    add(out.largest, part.largest);
    add(out.base, part.base);
  }
  return out;
}

inline Row prior_deviations(const ForcePrior& prior, const Row& largest, double scale) {
  const double widest = *std::max_element(largest.begin(), largest.end());
  Row out(largest.size());
  for (std::size_t m = 0; m < out.size(); ++m) {
    out[m] = scale / std::max(largest[m], std::max(prior.least * widest, 1e-12));
  }
  return out;
}

inline double largest_change(const Nodes& a, const Nodes& b) {
  double most = 0.0;
  for (int k = 0; k < kNodes; ++k) most = std::max(most, std::abs(a[k] - b[k]));
  return most;
}

inline double turn_of(const Nodes& curvature) {
  double heading = 0.0, most = 0.0;
  for (const double value : curvature) {
    heading += value / kNodes;
    most = std::max(most, std::abs(heading));
  }
  return most;
}

// Cells that hold all but nothing of a mass, widened by one: where a finer grid is laid.
inline Window support(const double* mass, int cells, Window window, double outside) {
  int first = 0, last = cells - 1;
  while (first < last && mass[first] < outside) ++first;
  while (last > first && mass[last] < outside) --last;
  const double width = (window.far - window.near) / cells;
  return {window.near + std::max(first - 1, 0) * width,
          window.near + std::min(last + 2, cells) * width};
}

// Posterior of one contact over M cells of the body.
struct OneContact {
  Row place;           // (M,) middles of the cells
  double width = 0.0;  // of a cell
  Row mass;            // (M,) of sum one
  Row force, spread;   // (M,) its mean and standard deviation
  Nodes curvature;     // of the body bent by the force at the likeliest place
  double log_evidence = -INFINITY, misfit = INFINITY, noise = 1.0;
  int top = 0;  // index of the likeliest place
};

// Explanations that a contact shares the readings with, one at a time: columns (E, N) in units of
// their deviation, and log prior odds of each.
struct Rivals {
  Matrix column;
  Row log_odds;
  double best, hopeless;  // log evidence of the best explanation so far; what counts against it
};

// A contact beside one of them, weighed on the same grid of the same shape.
struct RivalContact {
  int index;
  OneContact contact;
};

// Weighs one contact at all places of a grid, over levels of noise and scales of the force.
class OneContactGrid {
 public:
  OneContactGrid(const Frame& frame, const Matrix& shared, const ForcePrior& prior)
      : frame_(frame), prior_(prior) {
    for (const Level& level : frame.levels) {
      white_.emplace_back(frame, level, shared);
      read_.push_back(white_.back()(frame.excess.data()));
    }
  }

  // Fills mass, force, spread, evidence and misfit, for a window of the body; beside a further
  // column (N,) in units of its deviation, if there is one. Returns whether any place is possible.
  bool weigh(const Levers& levers, double window, const double* extra, OneContact& out) {
    const int n = frame_.size(), count = levers.sensor.columns;
    const int levels = static_cast<int>(white_.size());
    const int scales = static_cast<int>(prior_.scales.size());
    Matrix told(levels, count), square(levels, count), white(n, count);
    Matrix variance(scales, count);
    for (int p = 0; p < scales; ++p) {
      const Row deviation = prior_deviations(prior_, levers.largest, prior_.scales[p]);
      for (int m = 0; m < count; ++m) variance[p][m] = deviation[m] * deviation[m];
    }
    Row constant(levels), free(levels);
    double top = -INFINITY;
    for (int s = 0; s < levels; ++s) {
      white_[s](levers.sensor, white);
      products(white, read_[s], told[s], square[s]);
      free[s] = Whitener::dot(read_[s].data(), read_[s].data(), n);
      constant[s] = white_[s].log_det - 0.5 * free[s];
      if (extra) {
        const Beside beside(white_[s].column(extra), read_[s]);
        Row along(count);
        beside.along(white, along.data());
        for (int m = 0; m < count; ++m) {
          told[s][m] -= along[m] * beside.told;
          square[s][m] -= along[m] * along[m];
        }
        constant[s] += beside.gain;
        free[s] -= beside.told * beside.told;
      }
      for (int p = 0; p < scales; ++p) {
        double best = 0.0;
        for (int m = 0; m < count; ++m) {
          const double v = variance[p][m];
          const double gain = told[s][m] * told[s][m] * v / (1.0 + square[s][m] * v);
          best = gain > best ? gain : best;
        }
        top = std::max(top, constant[s] + 0.5 * best);
      }
    }
    out.mass.assign(count, 0.0);
    out.force.assign(count, 0.0);
    out.spread.assign(count, 0.0);
    double best = 0.0;
    for (int s = 0; s < levels; ++s) {
      for (int p = 0; p < scales; ++p) {
        for (int m = 0; m < count; ++m) {
          const double q = 1.0 / (1.0 + square[s][m] * variance[p][m]);
          const double v = variance[p][m] * q, f = told[s][m] * v;
          const double exponent = constant[s] - top + 0.5 * told[s][m] * f;
          if (exponent < -kNothing) continue;
          double w = std::exp(exponent) * std::sqrt(q);
          if (prior_.critical < INFINITY) {
            w *= below_fold(f, v, variance[p][m], levers.base[m]);
          }
          out.mass[m] += w;
          out.force[m] += w * f;
          out.spread[m] += w * (f * f + v);
          if (w > best) {
            best = w;
            level_ = s, out.noise = frame_.levels[s].factor;
            out.misfit = free[s] - f * (2.0 * told[s][m] - square[s][m] * f);
          }
        }
      }
    }
    double total = 0.0;
    for (int m = 0; m < count; ++m) {
      if (out.mass[m] <= 0.0) continue;
      total += out.mass[m];
      out.force[m] /= out.mass[m];
      out.spread[m] = out.spread[m] / out.mass[m] - out.force[m] * out.force[m];
      out.spread[m] = std::sqrt(std::max(out.spread[m], 0.0));
    }
    if (!(total > 0.0)) return false;
    out.top =
        static_cast<int>(std::max_element(out.mass.begin(), out.mass.end()) - out.mass.begin());
    out.log_evidence = top + std::log(total * out.width / (window * scales));
    for (double& mass : out.mass) mass /= total;
    return true;
  }

  // Log likelihood that each column adds at most to that of the likeliest place, whichever place
  // that then is, at the noise that suits the place or at less of it.
  Row gains(const Levers& levers, const Matrix& columns) const {
    const int n = frame_.size(), count = levers.sensor.columns;
    Matrix white(n, count);
    const double widest = *std::max_element(prior_.scales.begin(), prior_.scales.end());
    Row precision = prior_deviations(prior_, levers.largest, widest);
    for (double& value : precision) value = 1.0 / (value * value);
    Row told(count), square(count), along(count), out(columns.rows, -INFINITY);
    double plain = -INFINITY;
    for (std::size_t s = 0; s < white_.size(); ++s) {
      if (frame_.levels[s].factor > frame_.levels[level_].factor) continue;
      const Row& read = read_[s];
      white_[s](levers.sensor, white);
      products(white, read, told.data(), square.data());
      const double constant = white_[s].log_det - 0.5 * Whitener::dot(read.data(), read.data(), n);
      double best = 0.0;
      for (int m = 0; m < count; ++m) {
        square[m] += precision[m];
        best = std::max(best, told[m] * told[m] / square[m]);
      }
      plain = std::max(plain, constant + 0.5 * best);
      for (int e = 0; e < columns.rows; ++e) {
        const Beside beside(white_[s].column(columns[e]), read);
        beside.along(white, along.data());
        best = 0.0;
        for (int m = 0; m < count; ++m) {
          const double b = told[m] - along[m] * beside.told, g = square[m] - along[m] * along[m];
          const double gain = b * b / g;
          best = gain > best ? gain : best;
        }
        out[e] = std::max(out[e], constant + beside.gain + 0.5 * best);
      }
    }
    for (double& gain : out) gain -= plain;
    return out;
  }

 private:
  static constexpr double kNothing = 25.0;  // nats below the likeliest place that weigh nothing

  // Products of each whitened lever with the readings and with itself.
  static void products(const Matrix& white, const Row& read, double* told, double* square) {
    std::fill(told, told + white.columns, 0.0);
    std::fill(square, square + white.columns, 0.0);
    for (int i = 0; i < white.rows; ++i) {
      const double* row = white[i];
      for (int m = 0; m < white.columns; ++m) {
        told[m] += row[m] * read[i];
        square[m] += row[m] * row[m];
      }
    }
  }

  // One more column of the covariance: a rank-one change of every product. `told` and `along` are
  // products with the column, scaled so that their own products are what is taken away.
  struct Beside {
    Whitener::Column column;
    double scale, told, gain;
    Beside(Whitener::Column&& whitened, const Row& read) : column(std::move(whitened)) {
      const double* value = column.value.data();
      const double c = 1.0 + Whitener::dot(value, value, column.count);
      scale = 1.0 / std::sqrt(c);
      told = scale * Whitener::dot(value, read.data() + column.from, column.count);
      gain = 0.5 * (told * told - std::log(c));
    }
    void along(const Matrix& white, double* out) const {
      std::fill(out, out + white.columns, 0.0);
      for (int i = 0; i < column.count; ++i) {
        const double share = scale * column.value[i];
        const double* row = white[column.from + i];
        for (int m = 0; m < white.columns; ++m) out[m] += row[m] * share;
      }
    }
  };

  // Share of the force's posterior, over that of its prior, that does not fold the base.
  double below_fold(double mean, double variance, double prior, double lever) const {
    const double reach = std::abs(lever), limit = prior_.critical;
    double share = 1.0;
    if (reach * (std::abs(mean) + 5.0 * std::sqrt(variance)) > limit) {
      share *= probability_within(mean * reach, variance * reach * reach, limit);
    }
    if (reach * 5.0 * std::sqrt(prior) > limit) {
      share /= probability_within(0.0, prior * reach * reach, limit);
    }
    return share;
  }

  const Frame& frame_;
  const ForcePrior& prior_;
  std::vector<Whitener> white_;
  std::vector<Row> read_;
  int level_ = 0;
};

inline Row middles(Window window, int cells) {
  Row place(cells);
  for (int m = 0; m < cells; ++m) {
    place[m] = window.near + (m + 0.5) * (window.far - window.near) / cells;
  }
  return place;
}

// One contact in a window of the body; and beside rivals, those that are worth weighing.
inline OneContact one_contact(const Frame& frame, const Matrix& shared, const ForcePrior& prior,
                              Window window, int cells, double half, const Nodes& start,
                              const Rivals* rivals = nullptr,
                              std::vector<RivalContact>* beside = nullptr) {
  OneContactGrid grid(frame, shared, prior);
  OneContact out;
  Window part = window;
  out.curvature = start;
  bool straight = turn_of(start) < prior.straight;
  std::optional<Shape> shape;
  for (int turn = 0; turn < kMostTurns; ++turn) {
    out.place = middles(part, cells);
    out.width = (part.far - part.near) / cells;
    if (!straight) shape.emplace(out.curvature);
    const Levers levers = levers_at(frame, shape, out.place, half);
    if (!grid.weigh(levers, window.far - window.near, nullptr, out)) break;
    Nodes bent = frame.rest;
    const double arc = out.place[out.top], force = out.force[out.top];
    if (straight) {
      for (int k = 0; k < kNodes; ++k) {
        bent[k] += force * std::max(arc - k / (kNodes - 1.0), 0.0);
      }
    } else {
      shape->add_moment(shape->at(arc), force, bent);
    }
    bool rests = largest_change(bent, out.curvature) < prior.rests || turn >= kMostPasses;
    if (straight) {
      straight = turn_of(bent) < prior.straight;
      rests = straight;
    }
    out.curvature = bent;
    if (!rests) continue;
    const bool resolved = out.mass[out.top] < kResolved || out.width < 1e-7;
    const Window finer = support(out.mass.data(), cells, part, kOutside);
    if (!resolved && finer.far - finer.near < 0.7 * (part.far - part.near)) {
      part = finer;
      continue;
    }
    if (!rivals) return out;
    const Row gain = grid.gains(levers, rivals->column);
    const double least = std::max(rivals->best, out.log_evidence) + rivals->hopeless;
    for (int e = 0; e < rivals->column.rows; ++e) {
      if (out.log_evidence + gain[e] + rivals->log_odds[e] < least) continue;
      OneContact other = out;
      if (grid.weigh(levers, window.far - window.near, rivals->column[e], other)) {
        beside->push_back({e, std::move(other)});
      }
    }
    return out;
  }
  return out;
}

// Two or three contacts, base to tip, over M cells each.
struct SeveralContacts {
  std::vector<Row> place, mass;  // of each contact's cells; marginal mass of sum one
  Row width;                     // of each contact's cells
  Row best, force, spread;       // the likeliest set of places; its mean forces, deviations
  Nodes curvature;               // of the body that it bends
  double log_evidence = -INFINITY, misfit = INFINITY, noise = 1.0;
};

class SetsGrid {
 public:
  SetsGrid(int count, int cells) : count_(count), cells_(cells) {}

  Row place, precision, base;  // (k M,) of all columns
  Matrix gram;                 // (k M, k M) products of whitened levers
  Row told;                    // (k M,) and with the readings
  std::vector<Row> mass;       // (k, M)
  Row best, force, spread;     // (k,)
  double total = 0.0, misfit = INFINITY, noise = 1.0, top = -INFINITY;
  double factor = 1.0;  // of the noise that is weighed

  void clear() {
    mass.assign(count_, Row(cells_, 0.0));
    best.assign(count_, 0.0);
    force = spread = best;
    total = 0.0, misfit = INFINITY, top = -INFINITY, peak_ = -1.0;
  }

  // Adds the weights of all sets at one level of noise and one prior of the forces.
  void weigh(double log_scale, double free, double critical, double gap) {
    for (int m = 0; m < cells_; ++m) {
      const double a = gram[m][m] + precision[m], u = told[m];
      for (int n = cells_; n < 2 * cells_; ++n) {
        if (place[n] - place[m] < gap) continue;
        const double b = gram[n][n] + precision[n], v = told[n], c = gram[m][n];
        const double pair = a * b - c * c;
        const double volume = pair / (precision[m] * precision[n]);
        if (count_ == 2) {
          const double x = (u * b - v * c) / pair, y = (v * a - u * c) / pair;
          const double moment = x * base[m] + y * base[n];
          const std::array<int, 3> at{m, n, 0};
          add(log_scale, u * x + v * y, volume, free, moment, critical, at, {x, y, 0.0},
              {b / pair, a / pair, 0.0});
          continue;
        }
        for (int o = 2 * cells_; o < 3 * cells_; ++o) {
          if (place[o] - place[n] < gap) continue;
          const double d = gram[o][o] + precision[o], w = told[o];
          const double e = gram[m][o], f = gram[n][o];
          // Cofactors of [[a c e] [c b f] [e f d]].
          const double aa = b * d - f * f, ac = e * f - c * d, ae = c * f - b * e;
          const double bb = a * d - e * e, bf = c * e - a * f;
          const double det = a * aa + c * ac + e * ae;
          const double x = (aa * u + ac * v + ae * w) / det;
          const double y = (ac * u + bb * v + bf * w) / det;
          const double z = (ae * u + bf * v + pair * w) / det;
          const double moment = x * base[m] + y * base[n] + z * base[o];
          const double all = det / (precision[m] * precision[n] * precision[o]);
          add(log_scale, u * x + v * y + w * z, all, free, moment, critical, {m, n, o}, {x, y, z},
              {aa / det, bb / det, pair / det});
        }
      }
    }
  }

 private:
  void add(double log_scale, double gain, double volume, double free, double moment,
           double critical, std::array<int, 3> at, std::array<double, 3> f,
           std::array<double, 3> variance) {
    const double exponent = log_scale + 0.5 * gain;
    if (exponent < top - 25.0 || std::abs(moment) > critical) return;
    if (exponent > top + 25.0) {  // what was added so far is small beside this
      const double shrink = std::exp(top - exponent);
      for (Row& row : mass) {
        for (double& value : row) value *= shrink;
      }
      total *= shrink, peak_ *= shrink, top = exponent;
    }
    const double weight = std::exp(exponent - top) / std::sqrt(volume);
    for (int j = 0; j < count_; ++j) mass[j][at[j] - j * cells_] += weight;
    total += weight;
    if (weight > peak_) {
      peak_ = weight, misfit = free - gain, noise = factor;
      for (int j = 0; j < count_; ++j) {
        best[j] = place[at[j]], force[j] = f[j], spread[j] = std::sqrt(variance[j]);
      }
    }
  }

  int count_, cells_;
  double peak_ = -1.0;
};

inline SeveralContacts several_contacts(const Frame& frame, const Matrix& shared,
                                        const ForcePrior& prior, int count, int cells,
                                        const Nodes& start) {
  const int n = frame.size(), wide = count * cells;
  SeveralContacts out;
  std::vector<Window> window(count, Window{0.0, 1.0});
  out.curvature = start;
  bool straight = turn_of(start) < prior.straight;
  std::optional<Shape> shape;
  SetsGrid sets(count, cells);
  Matrix white(n, wide);
  for (int turn = 0; turn < kMostTurns; ++turn) {
    sets.place.clear();
    out.width.clear();
    double log_volume = 0.0, gap = 1.0;
    for (int j = 0; j < count; ++j) {
      const Row part = middles(window[j], cells);
      sets.place.insert(sets.place.end(), part.begin(), part.end());
      out.width.push_back((window[j].far - window[j].near) / cells);
      log_volume += std::log((j + 1.0) * out.width[j]);
      gap = std::min(gap, 0.5 * out.width[j]);
    }
    if (!straight) shape.emplace(out.curvature);
    const Levers levers = levers_at(frame, shape, sets.place, 0.0);
    sets.base = levers.base;
    sets.clear();
    for (const Level& level : frame.levels) {
      const Whitener by(frame, level, shared);
      const Row read = by(frame.excess.data());
      by(levers.sensor, white);
      sets.factor = level.factor;
      sets.gram = Matrix(wide, wide);
      sets.told.assign(wide, 0.0);
      for (int i = 0; i < n; ++i) {
        const double* row = white[i];
        for (int k = 0; k < wide; ++k) {
          sets.told[k] += row[k] * read[i];
          double* to = sets.gram[k];
          for (int l = k; l < wide; ++l) to[l] += row[k] * row[l];
        }
      }
      const double free = Whitener::dot(read.data(), read.data(), n);
      for (const double scale : prior.scales) {
        const Row deviation = prior_deviations(prior, levers.largest, scale);
        sets.precision.resize(wide);
        for (int k = 0; k < wide; ++k) {
          sets.precision[k] = 1.0 / (deviation[k] * deviation[k]);
        }
        sets.weigh(by.log_det - 0.5 * free, free, prior.critical, gap);
      }
    }
    if (!(sets.total > 0.0)) return out;
    out.best = sets.best, out.force = sets.force, out.spread = sets.spread;
    out.misfit = sets.misfit, out.noise = sets.noise;
    const double weights = static_cast<double>(prior.scales.size());
    out.log_evidence = sets.top + std::log(sets.total / weights) + log_volume;
    out.place.clear();
    for (int j = 0; j < count; ++j) {
      for (double& mass : sets.mass[j]) mass /= sets.total;
      out.place.emplace_back(sets.place.begin() + j * cells, sets.place.begin() + (j + 1) * cells);
    }
    out.mass = sets.mass;
    Nodes bent = frame.rest;
    const Shape levered = shape.value_or(Shape(Nodes{}));
    for (int j = 0; j < count; ++j) {
      levered.add_moment(levered.at(out.best[j]), out.force[j], bent);
    }
    bool rests = largest_change(bent, out.curvature) < prior.rests || turn >= kMostPasses;
    if (straight) {
      straight = turn_of(bent) < prior.straight;
      rests = straight;
    }
    out.curvature = bent;
    if (!rests) continue;
    bool finer = false;
    for (int j = 0; j < count; ++j) {
      const Row& mass = out.mass[j];
      if (*std::max_element(mass.begin(), mass.end()) < kResolved) continue;
      const Window part = support(mass.data(), cells, window[j], 10.0 * kOutside);
      if (part.far - part.near < 0.75 * (window[j].far - window[j].near) && out.width[j] > 1e-6) {
        window[j] = part;
        finer = true;
      }
    }
    if (!finer) return out;
  }
  return out;
}

// A load on the end of the body: normal and tangential force and a couple there.
struct EndWrench {
  std::array<double, 3> load{}, spread{};  // normal and tangential force, couple
  Nodes curvature;                         // of the body that it bends
  double log_evidence = -INFINITY, misfit = INFINITY, noise = 1.0;
};

// `radius`: of the tube, the longest arm of a tangential force, unless something `held` the end.
// Then the couple is free and the tangential force may pull as well.
inline EndWrench end_wrench(const Frame& frame, const Matrix& shared, const ForcePrior& prior,
                            double radius, bool held, const Nodes& start) {
  const int n = frame.size();
  EndWrench out;
  out.curvature = start;
  for (int turn = 0; turn < kMostPasses; ++turn) {
    const Shape shape(out.curvature);
    Levers normal(n, 1), along(n, 1);
    bent_levers(shape, {1.0}, frame.low, frame.high, normal);
    bent_levers(shape, {1.0}, frame.low, frame.high, along, true);
    const double arm = std::max({normal.largest[0], along.largest[0], 1e-6});
    Row each;
    double best = -INFINITY;
    for (const Level& level : frame.levels) {
      const Whitener by(frame, level, shared);
      const Row read = by(frame.excess.data());
      const double free = Whitener::dot(read.data(), read.data(), n);
      for (const double scale : prior.scales) {
        const double force = scale / arm, couple = held ? scale : force * radius;
        const std::array<double, 3> unit{force, force, couple};
        Row column[3] = {Row(n), Row(n), Row(n, couple)};
        for (int i = 0; i < n; ++i) {
          column[0][i] = force * normal.sensor[i][0];
          column[1][i] = force * along.sensor[i][0];
        }
        const Solution found({by(column[0].data()), by(column[1].data()), by(column[2].data())},
                             read);
        double log_weight = by.log_det - 0.5 * free + 0.5 * found.gain - 0.5 * found.log_volume;
        if (!held) {  // a peg pushes the end back, and never pulls it
          const double pushed =
              std::erfc(-found.mean[1] / (std::numbers::sqrt2 * found.deviation[1]));
          log_weight += std::log(std::max(pushed, 1e-300));
        }
        each.push_back(log_weight);
        if (log_weight > best) {
          best = log_weight;
          out.noise = level.factor;
          for (int j = 0; j < 3; ++j) {
            out.load[j] = found.mean[j] * unit[j];
            out.spread[j] = found.deviation[j] * unit[j];
          }
          const Row r = by([&] {
            Row rest(n);
            for (int i = 0; i < n; ++i) {
              rest[i] = frame.excess[i] - found.mean[0] * column[0][i] -
                        found.mean[1] * column[1][i] - found.mean[2] * column[2][i];
            }
            return rest;
          }()
                               .data());
          out.misfit = Whitener::dot(r.data(), r.data(), n);
        }
      }
    }
    out.log_evidence = log_sum_exp(each) - std::log(static_cast<double>(prior.scales.size()));
    Nodes bent = frame.rest;
    shape.add_moment(shape.at(1.0), out.load[0], bent);
    shape.add_moment(shape.at(1.0).turned(), out.load[1], bent);
    for (double& value : bent) value += out.load[2];
    const bool rests = largest_change(bent, out.curvature) < prior.rests;
    out.curvature = bent;
    if (rests) break;
  }
  return out;
}

// A contact that has folded the base: its moment there is the critical one, and the fold's angle
// has its sign.
struct FoldedContact {
  Row place, mass, force, angle;  // (M,)
  Nodes curvature;
  double log_evidence = -INFINITY, misfit = INFINITY, noise = 1.0;
  int top = 0;
};

// `fold` (N,): what a fold of one radian adds to each reading. `tolerance`: relative standard error
// of the critical moment. `spread`: prior standard deviation of the fold's angle.
inline FoldedContact folded_contact(const Frame& frame, const Matrix& shared,
                                    const ForcePrior& prior, double critical, double tolerance,
                                    const Row& fold, double spread, int cells, const Nodes& start) {
  const int n = frame.size();
  FoldedContact out;
  out.curvature = start;
  out.place = middles({0.0, 1.0}, cells);
  std::vector<Whitener> white;
  for (const Level& level : frame.levels) white.emplace_back(frame, level, shared);
  for (int turn = 0; turn < kMostPasses; ++turn) {
    const std::optional<Shape> shape(out.curvature);
    const Levers levers = levers_at(frame, shape, out.place, 0.0);
    Row log_mass(cells, -INFINITY);
    out.force.assign(cells, 0.0);
    out.angle.assign(cells, 0.0);
    double best = -INFINITY;
    for (int m = 0; m < cells; ++m) {
      const double lever = levers.base[m];
      if (std::abs(lever) < 0.02) continue;
      Row each;
      double top = -INFINITY;
      for (std::size_t s = 0; s < white.size(); ++s) {
        const Whitener& by = white[s];
        for (const double sign : {-1.0, 1.0}) {
          const double mean = sign * critical / std::abs(lever);
          Row contact(n), column(n), rest(n);
          for (int i = 0; i < n; ++i) {
            rest[i] = frame.excess[i] - mean * levers.sensor[i][m];
            contact[i] = tolerance * mean * levers.sensor[i][m];
            column[i] = spread * fold[i];
          }
          const Row read = by(rest.data());
          const Solution found({by(contact.data()), by(column.data())}, read);
          // The prior of the angle is one-sided: its sign is the moment's.
          const double own = lever > 0.0 ? sign : -sign;
          const double z = -own * found.mean[1] / found.deviation[1];
          const double share = std::erfc(z / std::numbers::sqrt2);
          const double free = Whitener::dot(read.data(), read.data(), n);
          const double log_weight = by.log_det - 0.5 * free + 0.5 * found.gain -
                                    0.5 * found.log_volume + std::log(std::max(share, 1e-300));
          each.push_back(log_weight);
          if (log_weight > top) {
            top = log_weight;
            out.force[m] = mean * (1.0 + tolerance * found.mean[0]);
            out.angle[m] = spread * found.mean[1];
            if (log_weight > best) {
              best = log_weight;
              out.top = m;
              out.noise = frame.levels[s].factor;
              out.misfit = free - found.gain;
            }
          }
        }
      }
      log_mass[m] = log_sum_exp(each) - std::log(2.0);  // of either sign
    }
    out.log_evidence = log_sum_exp(log_mass) - std::log(static_cast<double>(cells));
    out.mass.assign(cells, 0.0);
    double total = 0.0;
    for (int m = 0; m < cells; ++m) {
      total += out.mass[m] = std::exp(log_mass[m] - out.log_evidence);
    }
    for (double& mass : out.mass) mass /= total;
    Nodes bent = frame.rest;
    shape->add_moment(shape->at(out.place[out.top]), out.force[out.top], bent);
    const bool rests = largest_change(bent, out.curvature) < prior.rests;
    out.curvature = bent;
    if (rests) break;
  }
  return out;
}

}  // namespace thigmo
