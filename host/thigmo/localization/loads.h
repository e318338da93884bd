// Evidence of loads on a body, given one frame of readings.
//
// Once the places of the loads and the bent shape are given, readings are linear in the loads:
//     d = C f + e,   f ~ N(0, S),   e ~ N(0, V),
// so the evidence of a set of places is a closed form (any text on Bayesian linear models):
//     log B = 1/2 b' (S^-1 + C'V^-1 C)^-1 b - 1/2 log |I + S C'V^-1 C|,   b = C'V^-1 d.
// Levers are those of the bent shape, which follows from the likeliest places; shape and grid are
// refined together, until the shape rests and no cell of the grid holds most of the mass.
#pragma once

#include <bit>
#include <cstdint>
#include <numeric>
#include <optional>
#include <utility>

#include "errors.h"

namespace thigmo {

struct ForcePrior {
  Row scales;       // standard deviations of the largest moment, equally likely
  double least;     // the prior widens no more than at this share of the largest lever
  double critical;  // base moment at which the base folds; infinite if it does not
  double straight;  // turn (rad) below which a body counts as straight
  double rests;     // change of curvature below which a shape rests
  double felt;      // standard errors by which a contact that counts moves the readings
  double swept;     // share of contacts that a sweep brought about

  // Of a contact's place on a body of length one. A bend of the whole body carries each point
  // across an area that grows as the square of its arc.
  double density(double arc) const { return 1.0 - swept + 3.0 * swept * arc * arc; }
};

struct Window {
  double near, far;
};

constexpr int kMostPasses = 9;
constexpr int kMostTurns = 24;
constexpr double kResolved = 0.35;          // mass of a cell above which the grid is too coarse
constexpr double kOutside = 1e-6;           // mass of a cell below which the grid may leave it out
constexpr double kNothing = 25.0;           // nats below the likeliest place that weigh nothing
constexpr double kNearlyNothing = 1.4e-11;  // the same as a weight

// e^x for x up to 700, to 11 digits; what is below e^-200 counts as that. Without branches or
// calls, so that loops over places become vector code, and the same on every machine.
[[gnu::always_inline]] inline double exponential(double x) {
  constexpr double kShift = 6755399441055744.0;  // 1.5 * 2^52: adding it rounds to a whole number
  x = x > -200.0 ? x : -200.0;
  const double shifted = x * std::numbers::log2e + kShift, whole = shifted - kShift;
  // The rest, at most ln(2) / 2, by Taylor's series.
  const double r = (x - whole * 0x1.62e42fefa0000p-1) - whole * 0x1.cf79abc9e3b3ap-40;
  constexpr std::array kTerms{1.0,           1.0,           1.0 / 2.0,   1.0 / 6.0,
                              1.0 / 24.0,    1.0 / 120.0,   1.0 / 720.0, 1.0 / 5040.0,
                              1.0 / 40320.0, 1.0 / 362880.0};
  double sum = kTerms.back();
  for (int k = 8; k >= 0; --k) sum = sum * r + kTerms[k];
  const auto bits = std::bit_cast<std::uint64_t>(shifted) + 1023;
  return sum * std::bit_cast<double>(bits << 52);
}

// Four at a time, as a processor does.
THIGMO_WIDE inline double largest(const double* value, int count) {
  std::array<double, 4> top;
  top.fill(-INFINITY);
  for (; count >= 4; count -= 4, value += 4) {
    for (int j = 0; j < 4; ++j) top[j] = value[j] > top[j] ? value[j] : top[j];
  }
  for (int j = 0; j < count; ++j) top[j] = value[j] > top[j] ? value[j] : top[j];
  return std::max(std::max(top[0], top[1]), std::max(top[2], top[3]));
}

// Probability that a normal number lies within plus and minus a limit.
inline double probability_within(double mean, double variance, double limit) {
  const double scale = 1.0 / std::sqrt(2.0 * std::max(variance, 1e-300));
  return 0.5 * (std::erf((limit - mean) * scale) + std::erf((limit + mean) * scale));
}

// Probability that a load which moves the readings by `moved` standard errors, give or take
// `deviation` of them, moves them by `least` or more: the normal integral to 2e-7 (Abramowitz and
// Stegun, 7.1.26).
[[gnu::always_inline]] inline double probability_felt(double moved, double deviation,
                                                      double least) {
  deviation = deviation > 1e-12 ? deviation : 1e-12;
  const double deviate = (moved - least) / deviation;
  const double t = 1.0 / (1.0 + 0.3275911 / std::numbers::sqrt2 * std::abs(deviate));
  const double series =
      ((((1.061405429 * t - 1.453152027) * t + 1.421413741) * t - 0.284496736) * t + 0.254829592) *
      t;
  const double beyond = 0.5 * series * exponential(-0.5 * deviate * deviate);
  return deviate > 0.0 ? 1.0 - beyond : beyond;
}

// Normal density of up to four loads. `gram` and `told` are products of their whitened columns, in
// units of prior deviations, with each other and with the readings; so the prior is N(0, I).
struct Solution {
  static constexpr int kMost = 4;
  using Square = std::array<std::array<double, kMost>, kMost>;
  double gain = 0.0, volume = 1.0;  // log evidence is gain / 2 - log(volume)
  std::array<double, kMost> mean{}, deviation{};

  Solution(int count, Square gram, const std::array<double, kMost>& told) {
    Square inverse{};
    for (int j = 0; j < count; ++j) {  // Cholesky of I + gram, and the inverse of its factor
      gram[j][j] += 1.0;
      for (int k = 0; k <= j; ++k) {
        for (int l = 0; l < k; ++l) gram[j][k] -= gram[j][l] * gram[k][l];
        if (k < j) gram[j][k] /= gram[k][k];
      }
      gram[j][j] = std::sqrt(gram[j][j]);
      volume *= gram[j][j];
      double half = 0.0;
      for (int k = 0; k <= j; ++k) {
        double sum = j == k;
        for (int l = k; l < j; ++l) sum -= gram[j][l] * inverse[l][k];
        inverse[j][k] = sum / gram[j][j];
        half += inverse[j][k] * told[k];
      }
      gain += half * half;
      for (int k = 0; k <= j; ++k) {
        mean[k] += inverse[j][k] * half;
        deviation[k] += inverse[j][k] * inverse[j][k];
      }
    }
    for (double& value : deviation) value = std::sqrt(value);
  }
};

// Loads (K, N) on the body, fitted at one level of the noise.
inline Solution solve(const Whitened::At& at, const Matrix& loads) {
  const int n = loads.columns;
  Solution::Square gram{};
  std::array<double, Solution::kMost> told{};
  std::vector<Row> white;
  for (int j = 0; j < loads.rows; ++j) {
    white.push_back(at.by(Row(loads[j], loads[j] + n)));
    told[j] = Whitener::dot(white[j].data(), at.read.data(), n);
    for (int k = 0; k <= j; ++k) {
      gram[j][k] = Whitener::dot(white[j].data(), white[k].data(), n);
    }
  }
  return Solution(loads.rows, gram, told);
}

// Prior standard deviations of the forces, for a largest moment of one.
inline Row prior_deviations(const ForcePrior& prior, const Row& largest) {
  const double widest = *std::max_element(largest.begin(), largest.end());
  const double least = std::max(prior.least * widest, 1e-12);
  Row out(largest);
  for (double& value : out) value = 1.0 / std::max(value, least);
  return out;
}

inline double turn_of(const Nodes& curvature) {
  double heading = 0.0, most = 0.0;
  for (const double value : curvature) {
    heading += value;
    most = std::max(most, std::abs(heading));
  }
  return most / kNodes;
}

// A body on its way to rest under loads that are found on it, which bend it to another shape.
class Body {
 public:
  Nodes curvature;

  // `bends`: whether it is never to be taken as straight.
  Body(const Frame& frame, const ForcePrior& prior, const Nodes& start, bool bends = false)
      : curvature(start), frame_(frame), prior_(prior) {
    straight_ = !bends && turn_of(start) < prior.straight;
  }

  // Of normal forces, until the next call. `keep`: for the next frame, if the body is straight.
  const Levers& levers(const Row& place, bool keep = false) {
    if (!straight_) shape_ = Shape(curvature);
    const bool first = !std::exchange(asked_, true);
    if (first && straight_ && keep) return first_levers(place);
    return levers_ = point_levers(place);
  }

  // Its shape when levers were last asked for.
  const Shape& shape() const {
    static const Shape straight{Nodes{}};
    return straight_ ? straight : *shape_;
  }

  // Bend to another curvature, as loads on that shape ask; whether it then rests.
  bool settle(const Nodes& bent) {
    const Nodes before = std::exchange(curvature, bent);
    if (straight_) return straight_ = turn_of(bent) < prior_.straight;
    double change = 0.0;
    for (int k = 0; k < kNodes; ++k) change = std::max(change, std::abs(bent[k] - before[k]));
    return ++passes_ >= kMostPasses || change < prior_.rests;
  }

 private:
  // Those that a straight body begins with, kept for the next frame: most have the same sensors.
  const Levers& first_levers(const Row& place) const {
    struct Kept {
      Row place, low, high;
      Levers levers{0, 0};
    };
    static thread_local Kept kept;
    if (kept.place != place || kept.low != frame_.low || kept.high != frame_.high) {
      kept = {place, frame_.low, frame_.high, point_levers(place)};
    }
    return kept.levers;
  }

  Levers point_levers(const Row& place) const {
    Levers out(frame_.size(), static_cast<int>(place.size()));
    if (straight_) {
      straight_levers(place, frame_.low, frame_.high, out);
    } else {
      bent_levers(*shape_, place, frame_.low, frame_.high, out);
    }
    return out;
  }

  const Frame& frame_;
  const ForcePrior& prior_;
  bool straight_;
  std::optional<Shape> shape_;
  Levers levers_{0, 0};
  bool asked_ = false;
  int passes_ = 0;
};

inline Row middles(Window window, int cells) {
  Row place(cells);
  for (int m = 0; m < cells; ++m) {
    place[m] = window.near + (m + 0.5) * (window.far - window.near) / cells;
  }
  return place;
}

// Cells that hold all but nothing of a mass, widened by some: where a finer grid is laid.
inline Window support(const double* mass, int cells, Window window, double outside, int more) {
  int first = 0, last = cells - 1;
  while (first < last && mass[first] < outside) ++first;
  while (last > first && mass[last] < outside) --last;
  const double width = (window.far - window.near) / cells;
  return {window.near + std::max(first - more, 0) * width,
          window.near + std::min(last + 1 + more, cells) * width};
}

// What every load that was fitted tells.
struct Fit {
  double log_evidence = -INFINITY;
  double misfit = INFINITY,
         noise = 1.0;  // squared whitened residual; likeliest factor of the noise
  Nodes curvature{};   // of the body that the likeliest loads bend
  Matrix loads{};      // (K, N) columns of these, in units of prior deviations
  Row known{};  // (N,) readings that the loads' prior means cause; empty where these are zero
  std::vector<Vector> bent{};  // in space: curvature of that body, in each of its cells
};

// Posterior of one contact's place, over M cells of the body.
struct Marginal {
  Row place;           // (M,) middles of the cells
  double width = 0.0;  // of a cell
  Row mass;            // (M,) of sum one
  Row force, spread;   // (M,) its mean and standard deviation
  Row felt;            // (M,) probability that it moves the readings by enough to count
  // Adds a force's moments; `average` then makes mean and deviation of their sums.
  void add(std::size_t cell, double share, double mean, double deviation) {
    mass[cell] += share, force[cell] += share * mean;
    spread[cell] += share * (mean * mean + deviation * deviation);
  }
  void average() {
    for (std::size_t m = 0; m < mass.size(); ++m) {
      if (mass[m] == 0.0) continue;
      force[m] /= mass[m], felt[m] /= mass[m];
      spread[m] = std::sqrt(std::max(spread[m] / mass[m] - force[m] * force[m], 0.0));
    }
  }
};

struct OneContact : Fit, Marginal {
  int top = 0;  // index of the likeliest place
};

// Explanations that a contact shares the readings with, one at a time: their columns, and log prior
// odds of each.
struct Rivals {
  const Columns& column;
  const Row& log_odds;
  double best, hopeless;  // log evidence of the best explanation so far; what counts against it
  double misfit;          // of the contact alone, beyond which they are not weighed
};

// Contacts beside some of them, by their index, weighed on the same grid of the same shape.
using ContactsBeside = std::vector<std::pair<int, OneContact>>;

// Of contacts at places of a grid, with a force of prior variance `power` times `unit`: weight, and
// mean and variance of the force.
inline void weigh_places(int count, double constant, double power, const double* __restrict told,
                         const double* __restrict square, const double* __restrict unit,
                         double* __restrict weight, double* __restrict force,
                         double* __restrict left) {
  for (int m = 0; m < count; ++m) {
    const double variance = power * unit[m], share = 1.0 / (1.0 + square[m] * variance);
    left[m] = variance * share;
    force[m] = told[m] * left[m];
    weight[m] = exponential(constant + 0.5 * told[m] * force[m]) * std::sqrt(share);
  }
}

// Weighs one contact at all places of a grid, over levels of noise and scales of the force.
class OneContactGrid {
 public:
  OneContactGrid(const Whitened& readings, const ForcePrior& prior)
      : readings_(readings), prior_(prior), products_(readings.levels.size()) {}

  // Fills mass, force, spread, evidence and misfit for the levers of a grid of the body.
  // Returns whether any place is possible.
  THIGMO_WIDE bool weigh(const Levers& levers, OneContact& out) {
    base_ = levers.base;
    unit_ = prior_deviations(prior_, levers.largest);
    for (double& value : unit_) value *= value;
    for (std::size_t s = 0; s < products_.size(); ++s) {
      const Whitened::At& at = readings_.levels[s];
      Products& of = products_[s];
      of.constant = at.log_density, of.free = at.square;
      at.by(levers.sensor, of.white);
      const int count = of.white.columns;
      of.told.assign(count, 0.0), of.square.assign(count, 0.0);
      for (int i = 0; i < of.white.rows; ++i) {
        const double *row = of.white[i], read = at.read[i];
        double *told = of.told.data(), *square = of.square.data();
        for (int m = 0; m < count; ++m) {
          told[m] += row[m] * read;
          square[m] += row[m] * row[m];
        }
      }
    }
    return mix(products_, out);
  }

  // The same beside a further column, on the grid that was weighed last.
  THIGMO_WIDE bool weigh_beside(const Columns::Column& column, OneContact& out) {
    std::vector<Products> products(products_.size());
    for (std::size_t s = 0; s < products.size(); ++s) {
      const Products& plain = products_[s];
      const Whitened::At::Beside beside = readings_.levels[s].beside(column);
      along(column, beside.scale, plain.white, along_);
      Products& of = products[s];
      of.constant = plain.constant + beside.gain;
      of.free = plain.free - beside.told * beside.told;
      of.told = plain.told, of.square = plain.square;
      for (std::size_t m = 0; m < along_.size(); ++m) {
        of.told[m] -= along_[m] * beside.told;
        of.square[m] -= along_[m] * along_[m];
      }
    }
    return mix(products, out);
  }

  // Log likelihood that each column adds at most to that of the likeliest place, whichever place
  // that then is, at the noise that suits the place or at less of it. Readies `weigh_beside`.
  THIGMO_WIDE Row gains(const Columns& columns) {
    const double widest = *std::max_element(prior_.scales.begin(), prior_.scales.end());
    Row out(columns.size(), -INFINITY), square, ratio(unit_.size());
    double plain = -INFINITY;
    for (std::size_t s = 0; s < products_.size(); ++s) {
      const Whitened::At& at = readings_.levels[s];
      Products& of = products_[s];
      at.by.raise(of.white);
      if (at.factor > readings_.levels[level_].factor) continue;
      square = of.square;
      for (std::size_t m = 0; m < square.size(); ++m) {
        square[m] += 1.0 / (widest * widest * unit_[m]);
        ratio[m] = of.told[m] * of.told[m] / square[m];
      }
      const int count = static_cast<int>(ratio.size());
      plain = std::max(plain, of.constant + 0.5 * largest(ratio.data(), count));
      for (int e = 0; e < columns.size(); ++e) {
        const Whitened::At::Beside beside = at.beside(columns[e]);
        along(columns[e], beside.scale, of.white, along_);
        const double *told = of.told.data(), *own = square.data(), *both = along_.data();
        double* __restrict to = ratio.data();
        for (int m = 0; m < count; ++m) {
          const double left = told[m] - both[m] * beside.told;
          to[m] = left * left / (own[m] - both[m] * both[m]);
        }
        const double most = largest(ratio.data(), count);
        out[e] = std::max(out[e], of.constant + beside.gain + 0.5 * most);
      }
    }
    for (double& gain : out) gain -= plain;
    return out;
  }

 private:
  // At one level of noise: log density and square of the readings, products of each whitened lever
  // with the readings and with itself, the levers.
  struct Products {
    double constant, free;
    Row told, square;
    Matrix white;
  };

  // Products of a column, times its scale, with levers that are raised.
  static void along(const Columns::Column& column, double scale, const Matrix& raised, Row& out) {
    out.resize(raised.columns);
    double* sum = out.data();
    for (int i = 0; i < column.count; ++i) {
      const double share = scale * column.value[i];
      const double* row = raised[column.from + i];
      for (int m = 0; m < raised.columns; ++m) {
        sum[m] = i == 0 ? row[m] * share : sum[m] + row[m] * share;
      }
    }
  }

  THIGMO_WIDE bool mix(const std::vector<Products>& products, OneContact& out) {
    const int count = static_cast<int>(unit_.size());
    const double widest = *std::max_element(prior_.scales.begin(), prior_.scales.end());
    Row best_of(products.size()), each(3 * count);
    double top = -INFINITY, best = 0.0;
    double* __restrict weight = each.data(), * __restrict force = weight + count;
    double* __restrict left = force + count;
    for (std::size_t s = 0; s < products.size(); ++s) {
      const Products& of = products[s];
      for (int m = 0; m < count; ++m) {
        weight[m] = of.told[m] * of.told[m] / (of.square[m] + 1.0 / (widest * widest * unit_[m]));
      }
      best_of[s] = of.constant + 0.5 * largest(weight, count);
      top = std::max(top, best_of[s]);
    }
    for (Row* of : {&out.mass, &out.force, &out.spread, &out.felt}) of->assign(count, 0.0);
    double* __restrict mass = out.mass.data(), * __restrict first = out.force.data();
    double* __restrict second = out.spread.data();
    for (std::size_t s = 0; s < products.size(); ++s) {
      if (best_of[s] < top - kNothing) continue;
      const Products& of = products[s];
      const double *told = of.told.data(), *square = of.square.data(), *unit = unit_.data();
      for (const double scale : prior_.scales) {
        const double power = scale * scale, constant = of.constant - top;
        weigh_places(count, constant, power, told, square, unit, weight, force, left);
        if (prior_.critical < INFINITY) {
          for (int m = 0; m < count; ++m) {
            const bool nothing = weight[m] < kNearlyNothing;
            weight[m] *= nothing ? 0.0 : below_fold(force[m], left[m], power * unit[m], base_[m]);
          }
        }
        for (int m = 0; m < count; ++m) {
          mass[m] += weight[m];
          first[m] += weight[m] * force[m];
          second[m] += weight[m] * (force[m] * force[m] + left[m]);
        }
        const double most = largest(weight, count);
        if (most <= best) continue;
        best = most;
        const auto m = std::find(weight, weight + count, most) - weight;
        level_ = s, out.noise = readings_.levels[s].factor;
        out.misfit = of.free - force[m] * (2.0 * told[m] - square[m] * force[m]);
      }
    }
    double total = 0.0;
    for (int m = 0; m < count; ++m) {
      const double mass = std::max(out.mass[m], 1e-300);
      total += out.mass[m] *= prior_.density(out.place[m]);
      out.force[m] /= mass;
      out.spread[m] = std::sqrt(std::max(out.spread[m] / mass - out.force[m] * out.force[m], 0.0));
    }
    if (!(total > 0.0)) return false;
    out.top =
        static_cast<int>(std::max_element(out.mass.begin(), out.mass.end()) - out.mass.begin());
    const double scales = static_cast<double>(prior_.scales.size());
    out.log_evidence = top + std::log(total * out.width / scales);
    const double *square = products[level_].square.data(), *force_of = first, *spread = second;
    double* __restrict felt = out.felt.data();
    for (int m = 0; m < count; ++m) {
      const double unit = std::sqrt(std::max(square[m], 0.0));
      mass[m] /= total;
      felt[m] = probability_felt(std::abs(force_of[m]) * unit, spread[m] * unit, prior_.felt);
    }
    return true;
  }

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

  const Whitened& readings_;
  const ForcePrior& prior_;
  std::vector<Products> products_;
  Row base_, unit_;  // levers at the base; prior variances for a largest moment of one
  Row along_;
  std::size_t level_ = 0;
};

// One contact anywhere on the body; and beside rivals, those that are worth weighing.
inline OneContact one_contact(const Whitened& readings, const ForcePrior& prior, int cells,
                              const Nodes& start, const Rivals* rivals = nullptr,
                              ContactsBeside* beside = nullptr) {
  const Frame& frame = *readings.frame;
  OneContactGrid grid(readings, prior);
  OneContact out;
  out.curvature = start;
  Window part{0.0, 1.0};
  Body body(frame, prior, start);
  for (int turn = 0; turn < kMostTurns; ++turn) {
    out.place = middles(part, cells);
    out.width = (part.far - part.near) / cells;
    if (!grid.weigh(body.levers(out.place, true), out)) break;
    out.curvature = frame.rest;
    body.shape().add_moment(body.shape().at(out.place[out.top]), out.force[out.top], out.curvature);
    if (!body.settle(out.curvature)) continue;
    const bool resolved = out.mass[out.top] < kResolved || out.width < 1e-7;
    const Window finer = support(out.mass.data(), cells, part, kOutside, 1);
    if (!resolved && finer.far - finer.near < 0.7 * (part.far - part.near)) {
      part = finer;
      continue;
    }
    if (!rivals || out.misfit > rivals->misfit) return out;
    OneContact wide = out;  // beside another explanation the contact may lie anywhere
    if (part.near > 0.0 || part.far < 1.0) {
      wide.place = middles({0.0, 1.0}, cells), wide.width = 1.0 / cells;
      if (!grid.weigh(body.levers(wide.place), wide)) return out;
    }
    const Row gain = grid.gains(rivals->column);
    const double least = std::max(rivals->best, out.log_evidence) + rivals->hopeless;
    for (int e = 0; e < rivals->column.size(); ++e) {
      if (wide.log_evidence + gain[e] + rivals->log_odds[e] < least) continue;
      OneContact other = wide;
      if (grid.weigh_beside(rivals->column[e], other)) beside->emplace_back(e, std::move(other));
    }
    return out;
  }
  return out;
}

// Two or three contacts that are felt together, base to tip: of each its index among those that
// were placed, its cell there, and its force.
constexpr std::size_t kMostContacts = 3;
struct FeltSet {
  double mass = 0.0;
  std::uint8_t count = 0;
  std::array<std::uint8_t, kMostContacts> contact{}, cell{};
  std::array<double, kMostContacts> force{}, spread{};
};

// Posterior of two or three contacts, each in a window of its own. In `contacts` is the mass of
// sets of which no other contact is felt, in `sets` that of the others.
struct SeveralContacts : Fit {
  std::vector<Marginal> contacts;
  std::vector<FeltSet> sets;
};

// Numbers of four sets of places, as a processor takes them.
using Four [[gnu::vector_size(32), gnu::aligned(8)]] = double;
inline const Four& four(const double* from) { return *reinterpret_cast<const Four*>(from); }
inline Four& four(double* from) { return *reinterpret_cast<Four*>(from); }

// Normal equations of K numbers: products with the readings and, lower half, with each other;
// precision of the prior.
template <int K>
struct Normal {
  Four told[K], lower[K][K], prior[K];
};

// The same, one number eliminated after another (Gauss).
template <int K>
struct Eliminated {
  Four lower[K][K], inverse[K], left[K], gain{}, volume = 1.0 + Four{};
  [[gnu::always_inline]] explicit Eliminated(const Normal<K>& of) {
    for (int j = 0; j < K; ++j) {
      Four raw[K];
      left[j] = of.told[j];
      Four own = of.prior[j] + of.lower[j][j];
      for (int l = 0; l < j; ++l) {
        raw[l] = of.lower[j][l];
        for (int k = 0; k < l; ++k) raw[l] -= raw[k] * lower[l][k];
        lower[j][l] = raw[l] * inverse[l];
        left[j] -= lower[j][l] * left[l];
        own -= raw[l] * lower[j][l];
      }
      own = own > of.prior[j] ? own : of.prior[j];  // no less, but for rounding
      inverse[j] = 1.0 / own;
      gain += left[j] * left[j] * inverse[j], volume *= own;
    }
  }
  // Means and variances.
  [[gnu::always_inline]] void solve(Four* mean, Four* variance) const {
    Four up[K][K];  // transposed inverse of the lower triangle
    for (int j = K; j-- > 0;) {
      mean[j] = left[j] * inverse[j], variance[j] = inverse[j];
      for (int k = j + 1; k < K; ++k) {
        mean[j] -= lower[k][j] * mean[k];
        up[j][k] = -lower[k][j];
        for (int l = j + 1; l < k; ++l) up[j][k] -= lower[l][j] * up[l][k];
        variance[j] += up[j][k] * up[j][k] * inverse[k];
      }
    }
  }
  // Variance of a sum of the numbers, whose shares are overwritten.
  [[gnu::always_inline]] void variance(Four* of, Four& out) const {
    out = Four{};
    for (int k = 0; k < K; ++k) {
      for (int l = 0; l < k; ++l) of[k] -= lower[k][l] * of[l];
      out += of[k] * of[k] * inverse[k];
    }
  }
};

// Sets of places, one of each contact's cells, base to tip. What their evidence needs stands side
// by side, set after set, so that loops over sets become vector code.
class SetsGrid {
 public:
  // Begins anew; memory is kept.
  void reset(int count, int cells) {
    count_ = count, cells_ = cells;
    best.assign(count, 0);
  }

  Row place, width;           // (k M,) of all columns; (k,)
  Row mass;                   // of each set
  Matrix mean, spread, felt;  // (k, S) of forces; probability that they count
  std::vector<int> best;      // (k,) columns of the likeliest set
  std::size_t level = 0;      // of the noise and scale of the forces that suit it
  double scale = 0.0, total = 0.0, top = -INFINITY;

  int size() const { return static_cast<int>(mass.size()); }
  int count() const { return count_; }
  Row places(int contact) const {
    const auto first = place.begin() + contact * cells_;
    return {first, first + cells_};
  }
  int padded() const { return (size() + 3) / 4 * 4; }  // to whole vectors of four
  int cell(int contact, int set) const { return column_[contact][set] - contact * cells_; }

  // Lists all sets whose contacts are half a cell apart at least.
  void list() {
    const double gap = *std::min_element(width.begin(), width.end()) * 0.5;
    std::size_t most = 1;
    for (int j = 0; j < count_; ++j) most *= cells_;
    if (column_[count_ - 1].size() < most) column_.fill(std::vector<int>(most));
    const auto after = [&](int contact, int column) {
      int m = contact * cells_;
      while (m < (contact + 1) * cells_ && place[m] - place[column] < gap) ++m;
      return m;
    };
    int sets = 0;
    const auto row = [&](int first, int column) {  // of the last contact's cells
      for (int m = after(count_ - 1, column); m < count_ * cells_; ++m, ++sets) {
        column_[0][sets] = first, column_[count_ - 2][sets] = column, column_[count_ - 1][sets] = m;
      }
    };
    for (int first = 0; first < cells_; ++first) {
      if (count_ == 2) {
        row(first, first);
        continue;
      }
      for (int m = after(1, first); m < 2 * cells_; ++m) row(first, m);
    }
    mass.assign(sets, 0.0);
    total = 0.0, top = -INFINITY, peak_ = -1.0;
  }

  // Takes all columns at one level of noise: whitened levers, the readings, levers at the base, and
  // deviations of the forces for a largest moment of one.
  THIGMO_WIDE void set(const Matrix& white, const Row& read, const Row& base, const Row& unit,
                       const ForcePrior& prior) {
    const int wide = white.columns, sets = size(), cells = cells_;
    of_.resize(kRows, padded());
    products_.resize(4 + cells, wide);
    double* __restrict told = products_[0], * __restrict square = products_[1];
    double* __restrict variance = products_[2], * __restrict precision = products_[3];
    for (int k = 0; k < wide; ++k) {
      variance[k] = unit[k] * unit[k];
      precision[k] = 1.0 / variance[k];
      variance[k] /= std::pow(prior.density(place[k]), 2);
    }
    std::fill_n(told, 2 * wide, 0.0);
    for (int i = 0; i < white.rows; ++i) {
      const double *row = white[i], own = read[i];
      for (int k = 0; k < wide; ++k) told[k] += row[k] * own, square[k] += row[k] * row[k];
    }
    for (int j = 0; j < count_; ++j) {
      const int* at = column_[j].data();
      gather(at, told, of_[kTold + j]), gather(at, square, of_[gram(j, j)]);
      gather(at, base.data(), of_[kBase + j]), gather(at, variance, of_[kVariance + j]);
      gather(at, precision, of_[kPrecision + j]);
      for (int l = 0; l < j; ++l) {
        for (int m = 0; m < cells; ++m) {
          for (int k = 0; k < cells; k += 12) {
            Four sum[3]{};
            for (int i = 0; i < white.rows; ++i) {
              const double *row = white[i] + j * cells + k, own = white[i][l * cells + m];
              for (int part = 0; part < 3; ++part) sum[part] += own * four(row + 4 * part);
            }
            for (int part = 0; part < 3; ++part) four(products_[4 + m] + k + 4 * part) = sum[part];
          }
        }
        const int* beside = column_[l].data();
        const double* from = products_[4] - l * cells * wide - j * cells;
        double* __restrict to = of_[gram(j, l)];
        for (int s = 0; s < sets; ++s) to[s] = from[beside[s] * wide + at[s]];
      }
    }
  }

  // Adds the weights of all sets at that level and one scale of the forces.
  THIGMO_WIDE void weigh(double constant, double critical, std::size_t at_level, double at_scale) {
    const int sets = size();
    products_.resize(2, padded());
    double* __restrict weight = products_[0], * __restrict volume = products_[1];
    const double tight = 1.0 / (at_scale * at_scale);
    count_ == 2 ? exponents<2>(tight, critical, weight, volume)
                : exponents<3>(tight, critical, weight, volume);
    const double most = largest(weight, sets) + constant;
    if (!(most > -INFINITY) || most < top - kNothing) return;
    if (most > top + kNothing) {  // what was added so far is small beside this
      const double shrink = std::exp(top - most);
      for (double& value : mass) value *= shrink;
      total *= shrink, peak_ *= shrink, top = most;
    }
    const double shift = constant - top;
    double* __restrict to = mass.data();
    for (int s = 0; s < sets; ++s) {
      weight[s] = exponential(weight[s] + shift) / std::sqrt(volume[s]);
      to[s] += weight[s];
    }
    for (int s = 0; s < sets; ++s) total += weight[s];
    const double heaviest = largest(weight, sets);
    if (heaviest <= peak_) return;
    peak_ = heaviest, level = at_level, scale = at_scale;
    const auto found = std::find(weight, weight + sets, heaviest) - weight;
    for (int j = 0; j < count_; ++j) best[j] = column_[j][found];
  }

  // Forces of all sets, at the level that was taken last and the likeliest scale, and whether they
  // move the readings by `least` standard errors.
  THIGMO_WIDE void solve(double least) {
    for (Matrix* each : {&mean, &spread, &felt}) each->resize(count_, padded());
    count_ == 2 ? forces<2>() : forces<3>();
    const double* force = mean.value.data();
    double* __restrict deviation = spread.value.data(), * __restrict likely = felt.value.data();
    for (std::size_t k = 0; k < felt.value.size(); ++k) {
      const double moves = std::sqrt(likely[k]);
      deviation[k] = std::sqrt(deviation[k]);
      likely[k] = probability_felt(std::abs(force[k]) * moves, deviation[k] * moves, least);
    }
  }

  // Probability that all contacts of a set are felt.
  double all_felt() const {
    double sum = 0.0;
    for (int s = 0; s < size(); ++s) {
      double likely = mass[s];
      for (int j = 0; j < count_; ++j) likely *= felt[j][s];
      sum += likely;
    }
    return sum / total;
  }

 private:
  // Rows of numbers of sets: products of the readings with whitened levers; the prior's precision;
  // levers at the base; products of levers with each other.
  static constexpr int kTold = 0, kPrecision = kMostContacts, kVariance = 2 * kMostContacts;
  static constexpr int kBase = 3 * kMostContacts, kGram = 4 * kMostContacts, kRows = kGram + 6;
  static constexpr int gram(int j, int l) { return kGram + j * (j + 1) / 2 + l; }

  // Numbers of columns for all sets.
  void gather(const int* at, const double* from, double* __restrict to) const {
    const int sets = size(), wide = padded();
    for (int s = 0; s < sets; ++s) to[s] = from[at[s]];
    for (int s = sets; s < wide; ++s) to[s] = from[at[0]];
  }

  // Of four sets, with the forces' prior.
  template <int K>
  [[gnu::always_inline]] Normal<K> normal(double tight, int s) const {
    Normal<K> out;
    for (int j = 0; j < K; ++j) {
      out.told[j] = four(of_[kTold + j] + s), out.prior[j] = tight * four(of_[kPrecision + j] + s);
      for (int l = 0; l <= j; ++l) out.lower[j][l] = four(of_[gram(j, l)] + s);
    }
    return out;
  }

  template <int K>
  [[gnu::always_inline]] void exponents(double tight, double critical, double* exponent,
                                        double* volume) const {
    const int sets = size();
    const double wider = std::pow(tight, -K);
    for (int s = 0; s < sets; s += 4) {
      const Eliminated<K> found(normal<K>(tight, s));
      four(exponent + s) = 0.5 * found.gain, four(volume + s) = found.volume * wider;
      for (int j = 0; j < K; ++j) four(volume + s) *= four(of_[kVariance + j] + s);
      if (!(critical < INFINITY)) continue;
      Four force[K], variance[K], moment{};
      found.solve(force, variance);
      for (int j = 0; j < K; ++j) moment += force[j] * four(of_[kBase + j] + s);
      for (int m = 0; m < 4; ++m) {
        if (std::abs(moment[m]) > critical) exponent[s + m] = -INFINITY;
      }
    }
  }

  template <int K>
  [[gnu::always_inline]] void forces() {
    const double tight = 1.0 / (scale * scale);
    for (int s = 0; s < size(); s += 4) {
      Four force[K], variance[K];
      Eliminated<K>(normal<K>(tight, s)).solve(force, variance);
      for (int j = 0; j < K; ++j) {
        four(mean[j] + s) = force[j], four(spread[j] + s) = variance[j];
        four(felt[j] + s) = four(of_[gram(j, j)] + s);
      }
    }
  }

  int count_ = 0, cells_ = 0;
  std::array<std::vector<int>, kMostContacts> column_;  // of each set
  Matrix of_, products_;
  double peak_ = -1.0;
};

// The likeliest set of a grid: misfit, and the body at rest under its forces, from a shape near it.
// `unit`: prior deviations of the forces for a largest moment of one.
inline void likeliest_set(const Whitened& readings, const ForcePrior& prior, const SetsGrid& sets,
                          const Row& unit, const Nodes& start, SeveralContacts& out) {
  const Frame& frame = *readings.frame;
  const int n = frame.size(), count = static_cast<int>(sets.best.size());
  const Whitened::At& at = readings.levels[sets.level];
  Row best(count);
  for (int j = 0; j < count; ++j) best[j] = sets.place[sets.best[j]];
  out.loads.resize(count, n);
  Body body(frame, prior, start);
  do {
    const Levers& levers = body.levers(best);
    for (int j = 0; j < count; ++j) {
      const double deviation = sets.scale * unit[sets.best[j]];
      for (int i = 0; i < n; ++i) out.loads[j][i] = deviation * levers.sensor[i][j];
    }
    const Solution found = solve(at, out.loads);
    out.noise = at.factor, out.misfit = at.square - found.gain;
    out.curvature = frame.rest;
    for (int j = 0; j < count; ++j) {
      const double force = found.mean[j] * sets.scale * unit[sets.best[j]];
      body.shape().add_moment(body.shape().at(best[j]), force, out.curvature);
    }
  } while (!body.settle(out.curvature));
}

// Mass in each cell of each contact (k, M).
inline std::vector<Row> marginals(const SetsGrid& sets, int cells) {
  std::vector<Row> out(sets.width.size(), Row(cells, 0.0));
  for (std::size_t j = 0; j < out.size(); ++j) {
    for (int s = 0; s < sets.size(); ++s) {
      out[j][sets.cell(static_cast<int>(j), s)] += sets.mass[s] / sets.total;
    }
  }
  return out;
}

// Shares the mass of a grid out among the contacts that are felt. All are taken for felt if `all`
// says so. Leaves out sets that hold a share of less than `nothing`.
template <class Sets>
void share_out(const Sets& sets, bool all, double nothing, SeveralContacts& out) {
  constexpr double kUnlikely = 1e-3;
  const int count = sets.count();
  for (int j = 0; j < count; ++j) {
    Row places = sets.places(j);
    const Row none(places.size(), 0.0);
    out.contacts[j] = {std::move(places), sets.width[j], none, none, none, none};
  }
  const double least = nothing * sets.total;
  double kept = 0.0;
  for (const double mass : sets.mass) kept += mass < least ? 0.0 : mass;
  std::array<std::array<double, 2>, kMostContacts> odds{};  // that each is not felt, and that it is
  out.sets.reserve(sets.size());
  for (int s = 0; s < sets.size(); ++s) {
    if (sets.mass[s] < least) continue;
    int strongest = 0;
    for (int j = 0; j < count; ++j) {
      const double likely = all ? 1.0 : sets.felt[j][s];
      odds[j] = {1.0 - likely, likely};
      if (likely > odds[strongest][1]) strongest = j;
    }
    for (unsigned way = 0; way < 1u << count; ++way) {
      double share = odds[0][way & 1];
      for (int j = 1; j < count; ++j) share *= odds[j][way >> j & 1];
      if (share < kUnlikely) continue;
      share *= sets.mass[s] / kept;
      if ((way & (way - 1)) == 0) {  // one at most
        const int only = way ? std::countr_zero(way) : strongest, cell = sets.cell(only, s);
        out.contacts[only].add(cell, share, sets.mean[only][s], sets.spread[only][s]);
        if (way) out.contacts[only].felt[cell] += share;
        continue;
      }
      FeltSet& set = out.sets.emplace_back(share);
      for (int j = 0; j < count; ++j) {
        if (!(way >> j & 1)) continue;
        set.contact[set.count] = j, set.cell[set.count] = sets.cell(j, s);
        set.force[set.count] = sets.mean[j][s], set.spread[set.count++] = sets.spread[j][s];
      }
    }
  }
  for (Marginal& contact : out.contacts) contact.average();
}

// `all`: how many there are is known. `matters`: log evidence from which a grid is laid finer even
// where it tells most places apart. They are not weighed further, and their evidence is nothing, if
// on the first grid the log evidence that all are felt is less than `least`.
inline SeveralContacts several_contacts(const Whitened& readings, const ForcePrior& prior,
                                        int count, int cells, const Nodes& start, bool all,
                                        double matters, double least) {
  constexpr double kCoarse = 0.9;  // mass of a cell above which the grid tells nothing
  constexpr double kNothingOfAll = 1e-4;
  const Frame& frame = *readings.frame;
  SeveralContacts out;
  out.contacts.resize(count);
  std::vector<Window> window(count, Window{0.0, 1.0});
  Body body(frame, prior, start);
  thread_local SetsGrid sets;  // the next frame needs as much memory
  sets.reset(count, cells);
  Matrix white;
  bool whole = true;
  for (int turn = 0; turn < kMostTurns; ++turn) {
    sets.place.clear(), sets.width.clear();
    double log_volume = 0.0;
    for (int j = 0; j < count; ++j) {
      const Row part = middles(window[j], cells);
      sets.place.insert(sets.place.end(), part.begin(), part.end());
      sets.width.push_back((window[j].far - window[j].near) / cells);
      log_volume += std::log((j + 1.0) * sets.width[j]);
    }
    sets.list();
    // On the whole body the sets listed are all there are: their prior sums to one.
    if (whole) log_volume = -std::log(static_cast<double>(sets.size()));
    const Levers& levers = body.levers(sets.place);
    const Row unit = prior_deviations(prior, levers.largest);
    const auto take = [&](const Whitened::At& at) {
      at.by(levers.sensor, white);
      sets.set(white, at.read, levers.base, unit, prior);
    };
    for (std::size_t s = 0; s < readings.levels.size(); ++s) {
      take(readings.levels[s]);
      for (const double scale : prior.scales) {
        sets.weigh(readings.levels[s].log_density, prior.critical, s, scale);
      }
    }
    if (!(sets.total > 0.0)) return out;
    const double scales = static_cast<double>(prior.scales.size());
    out.log_evidence = sets.top + std::log(sets.total / scales) + log_volume;
    const auto solve = [&] {
      if (sets.level + 1 < readings.levels.size()) take(readings.levels[sets.level]);
      sets.solve(prior.felt);
    };
    if (turn == 0 && out.log_evidence < least) return {};
    if (turn == 0 && least > -INFINITY) {
      solve();
      if (out.log_evidence + std::log(sets.all_felt()) < least) return {};
    }
    likeliest_set(readings, prior, sets, unit, body.curvature, out);
    const bool rests = body.settle(out.curvature);
    bool finer = false;
    const std::vector<Row> each = rests ? marginals(sets, cells) : std::vector<Row>{};
    const double coarse = all || out.log_evidence > matters ? kResolved : kCoarse;
    for (std::size_t j = 0; j < each.size(); ++j) {
      const Row& mass = each[j];
      if (*std::max_element(mass.begin(), mass.end()) < coarse) continue;
      const Window part = support(mass.data(), cells, window[j], 10.0 * kOutside, 2);
      if (part.far - part.near < 0.75 * (window[j].far - window[j].near) && sets.width[j] > 1e-6) {
        window[j] = part;
        finer = true, whole = false;
      }
    }
    if (finer || !(rests || turn + 1 == kMostTurns)) continue;
    const double nothing = kNothingOfAll * std::exp(std::min(matters - out.log_evidence, 3.0));
    solve();
    share_out(sets, all, nothing, out);
    return out;
  }
  return out;
}

// A load on the end of the body: normal and tangential force and a couple there.
struct EndWrench : Fit {
  std::array<double, 3> load{}, spread{};  // normal and tangential force, couple
  double felt = 0.0;                       // probability that it moves the readings enough to count
};

// `radius`: of the tube, the longest arm of a tangential force, unless something `held` the end.
// Then the couple is free and the tangential force may pull as well.
inline EndWrench end_wrench(const Whitened& readings, const ForcePrior& prior, double radius,
                            bool held, const Nodes& start) {
  const Frame& frame = *readings.frame;
  const int n = frame.size();
  EndWrench out;
  Body body(frame, prior, start, true);
  Levers along(n, 1);
  Matrix loads(3, n);
  Row each;
  do {
    const Levers& normal = body.levers({1.0});
    const Shape& shape = body.shape();
    bent_levers(shape, {1.0}, frame.low, frame.high, along, true);
    const double arm = std::max({normal.largest[0], along.largest[0], 1e-6});
    double best = -INFINITY;
    each.clear();
    for (const double scale : prior.scales) {
      const double force = scale / arm, couple = held ? scale : force * radius;
      const std::array<double, 3> unit{force, force, couple};
      for (int i = 0; i < n; ++i) {
        loads[0][i] = force * normal.sensor[i][0];
        loads[1][i] = force * along.sensor[i][0];
        loads[2][i] = couple;
      }
      for (const Whitened::At& at : readings.levels) {
        const Solution found = solve(at, loads);
        double log_weight = at.log_density + 0.5 * found.gain - std::log(found.volume);
        if (!held) {  // a peg pushes the end back, and never pulls it
          const double pushed =
              std::erfc(-found.mean[1] / (std::numbers::sqrt2 * found.deviation[1]));
          log_weight += std::log(std::max(pushed, 1e-300));
        }
        each.push_back(log_weight);
        if (log_weight <= best) continue;
        best = log_weight;
        out.noise = at.factor, out.loads = loads;
        out.misfit = at.square - found.gain;
        out.felt = probability_felt(std::sqrt(found.gain), 1.0, prior.felt);
        for (int j = 0; j < 3; ++j) {
          out.load[j] = found.mean[j] * unit[j];
          out.spread[j] = found.deviation[j] * unit[j];
          out.misfit -= found.mean[j] * found.mean[j];
        }
      }
    }
    out.log_evidence = log_sum_exp(each) - std::log(static_cast<double>(prior.scales.size()));
    out.curvature = frame.rest;
    shape.add_moment(shape.at(1.0), out.load[0], out.curvature);
    shape.add_moment(shape.at(1.0).turned(), out.load[1], out.curvature);
    for (double& value : out.curvature) value += out.load[2];
  } while (!body.settle(out.curvature));
  return out;
}

// A contact that has folded the base: its moment there is the critical one, and the fold's angle
// has its sign.
struct FoldedContact : OneContact {
  Row angle;  // (M,)
};

// `fold` (N,): what a fold of one prior standard deviation adds to each reading. `tolerance`:
// relative standard error of the critical moment.
inline FoldedContact folded_contact(const Whitened& readings, const ForcePrior& prior,
                                    double tolerance, const Row& fold, int cells,
                                    const Nodes& start) {
  const Frame& frame = *readings.frame;
  const int n = frame.size();
  FoldedContact out;
  Body body(frame, prior, start, true);
  out.place = middles({0.0, 1.0}, cells);
  out.width = 1.0 / cells;
  out.force = out.spread = out.felt = out.angle = Row(cells);
  Matrix white;
  do {
    const Levers& levers = body.levers(out.place);
    std::vector<Row> each(cells);
    Row top(cells, -INFINITY);
    double best = -INFINITY;
    for (const Whitened::At& at : readings.levels) {
      at.by(levers.sensor, white);
      const Row kink = at.by(fold);
      const double bent = Whitener::dot(kink.data(), kink.data(), n);
      const double seen = Whitener::dot(kink.data(), at.read.data(), n);
      for (int m = 0; m < cells; ++m) {
        const double lever = levers.base[m];
        if (std::abs(lever) < 0.02) continue;
        double square = 0.0, told = 0.0, both = 0.0;
        for (int i = 0; i < n; ++i) {
          square += white[i][m] * white[i][m];
          told += white[i][m] * at.read[i];
          both += white[i][m] * kink[i];
        }
        for (const double sign : {-1.0, 1.0}) {
          const double mean = sign * prior.critical / std::abs(lever), unit = tolerance * mean;
          const Solution found(2, {{{unit * unit * square}, {unit * both, bent}}},
                               {unit * (told - mean * square), seen - mean * both});
          // The prior of the angle is one-sided: its sign is the moment's.
          const double own = lever > 0.0 ? sign : -sign;
          const double z = -own * found.mean[1] / found.deviation[1];
          const double share = std::erfc(z / std::numbers::sqrt2);
          const double free = at.square - mean * (2.0 * told - mean * square);
          const double log_weight = at.by.log_det - 0.5 * free + 0.5 * found.gain -
                                    std::log(found.volume) + std::log(std::max(share, 1e-300)) +
                                    std::log(prior.density(out.place[m]));
          each[m].push_back(log_weight);
          if (log_weight <= top[m]) continue;
          top[m] = log_weight;
          out.force[m] = mean * (1.0 + tolerance * found.mean[0]);
          out.spread[m] = tolerance * std::abs(out.force[m]);
          out.angle[m] = found.mean[1];
          const double moves = std::sqrt(square);
          out.felt[m] = probability_felt(std::abs(out.force[m]) * moves,
                                         std::max(out.spread[m] * moves, 1.0), prior.felt);
          if (log_weight <= best) continue;
          best = log_weight;
          out.top = m, out.noise = at.factor, out.misfit = free - found.gain;
        }
      }
    }
    Row log_mass(cells, -INFINITY);
    for (int m = 0; m < cells; ++m) {  // of either sign
      if (!each[m].empty()) log_mass[m] = log_sum_exp(each[m]) - std::log(2.0);
    }
    out.log_evidence = log_sum_exp(log_mass) - std::log(static_cast<double>(cells));
    out.mass.assign(cells, 0.0);
    double total = 0.0;
    for (int m = 0; m < cells; ++m) {
      total += out.mass[m] = std::exp(log_mass[m] - out.log_evidence);
    }
    for (double& mass : out.mass) mass /= total;
    out.curvature = frame.rest;
    body.shape().add_moment(body.shape().at(out.place[out.top]), out.force[out.top], out.curvature);
    out.known.resize(n), out.loads = Matrix(2, n);
    for (int i = 0; i < n; ++i) {
      out.known[i] = out.force[out.top] * levers.sensor[i][out.top];
      out.loads[0][i] = tolerance * out.known[i], out.loads[1][i] = fold[i];
    }
  } while (!body.settle(out.curvature));
  return out;
}

}  // namespace thigmo
