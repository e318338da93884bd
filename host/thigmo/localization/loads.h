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
inline double exponential(double x) {
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
// `deviation` of them, moves them by `least` or more.
inline double probability_felt(double moved, double deviation, double least) {
  const double deviate = (moved - least) / std::max(deviation, 1e-12);
  if (std::abs(deviate) > 3.5) return deviate > 0.0;
  return 0.5 * std::erfc(-deviate / std::numbers::sqrt2);
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
      total += out.mass[m];
      out.force[m] /= mass;
      out.spread[m] = std::sqrt(std::max(out.spread[m] / mass - out.force[m] * out.force[m], 0.0));
    }
    if (!(total > 0.0)) return false;
    out.top =
        static_cast<int>(std::max_element(out.mass.begin(), out.mass.end()) - out.mass.begin());
    const double scales = static_cast<double>(prior_.scales.size());
    out.log_evidence = top + std::log(total * out.width / scales);
    const Row& square = products[level_].square;
    for (int m = 0; m < count; ++m) {
      out.mass[m] /= total;
      if (out.mass[m] < kOutside) continue;
      const double unit = std::sqrt(std::max(square[m], 0.0));
      out.felt[m] =
          probability_felt(std::abs(out.force[m]) * unit, out.spread[m] * unit, prior_.felt);
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

// Weighs all sets of places, one of each contact's cells, by eliminating one contact after another
// (Gauss): each adds to the gain, to the log determinant, and to the mean moment at the base.
class SetsGrid {
 public:
  SetsGrid(int count, int cells)
      : count_(count), cells_(cells), at_(count), left_(count), weight_(count * cells) {
    std::size_t sets = 1;
    for (int j = 0; j < count; ++j) sets *= static_cast<std::size_t>(cells);
    mass.resize(sets);
  }

  Row place, width;       // (k M,) of all columns; (k,)
  Row mass;               // of each set, cells of the last contact next to each other
  std::vector<int> best;  // (k,) columns of the likeliest set
  std::size_t level = 0;  // of the noise and scale of the forces that suit it
  double scale = 0.0, total = 0.0, top = -INFINITY;

  void clear() {
    std::fill(mass.begin(), mass.end(), 0.0);
    place.clear(), width.clear();
    total = 0.0, top = -INFINITY, peak_ = -1.0;
  }

  // At one level of noise.
  THIGMO_WIDE void set(const Matrix& white, const Row& read, const Row& base) {
    const int wide = white.columns;
    for (Products& each : left_) {
      each.diagonal.resize(wide), each.told.resize(wide), each.base = base;
      // Two places of one contact are never weighed together.
      if (&each != &left_.back()) each.gram.resize(wide - cells_, wide);
    }
    Products& to = left_[0];
    square_.assign(wide, 0.0), to.told.assign(wide, 0.0);
    double* __restrict told = to.told.data(), * __restrict square = square_.data();
    for (int i = 0; i < white.rows; ++i) {
      const double* row = white[i];
      for (int k = 0; k < wide; ++k) told[k] += row[k] * read[i], square[k] += row[k] * row[k];
    }
    for (int k = 0; k < wide - cells_; ++k) {
      const int from = (k / cells_ + 1) * cells_;
      double* __restrict gram = to.gram[k];
      std::fill(gram + from, gram + wide, 0.0);
      for (int i = 0; i < white.rows; ++i) {
        const double *row = white[i], own = row[k];
        for (int l = from; l < wide; ++l) gram[l] += own * row[l];
      }
    }
  }

  // Take a prior of the forces: deviations (k M,) for a largest moment of one, times a scale.
  void prepare(const Row& unit, double scale) {
    gap_ = *std::min_element(width.begin(), width.end()) * 0.5;
    variance_.resize(unit.size());
    for (std::size_t k = 0; k < unit.size(); ++k) {
      variance_[k] = scale * scale * unit[k] * unit[k];
      left_[0].diagonal[k] = 1.0 / variance_[k] + square_[k];
    }
  }

  // Adds the weights of all sets at that level and one prior of the forces.
  void weigh(const Row& unit, double constant, double critical, std::size_t at_level,
             double at_scale) {
    prepare(unit, at_scale);
    critical_ = critical, level_ = at_level, scale_ = at_scale;
    place_contact(0, {constant, 1.0, 0.0}, [this](int first, Sum sum) { place_last(first, sum); });
  }

  // Forces of a row of sets, of each contact (k, M): means and deviations; and how far a unit force
  // moves the readings, in standard errors.
  struct Forces {
    Matrix mean, deviation, moves;
  };

  // Calls `each` for all sets that share all but the last contact: with the columns of those, the
  // masses of the last one's cells, the first of its cells, and the forces as they were prepared.
  template <class Each>
  void each_row(const Each& each) {
    Forces of{Matrix(count_, cells_), Matrix(count_, cells_), Matrix(count_, cells_)};
    place_contact(0, {0.0, 1.0, 0.0}, [&](int first, Sum) {
      solve_row(of);
      each(at_, mass.data() + row() * cells_, first - (count_ - 1) * cells_, of);
    });
  }

 private:
  // Of the columns of all contacts: whitened levers' products with each other, above the diagonal,
  // and with the readings; levers at the base. Less what the contacts that are placed explain.
  struct Products {
    Matrix gram;
    Row diagonal, told, base;
  };

  struct Sum {
    double exponent, volume, moment;
  };

  // Calls `last` with the first column of the last contact, all others being placed.
  template <class Last>
  void place_contact(int contact, Sum sum, const Last& last) {
    const Products& left = left_[contact];
    const int end = (contact + 1) * cells_;
    int m = contact * cells_;
    while (contact > 0 && m < end && place[m] - place[at_[contact - 1]] < gap_) ++m;
    if (contact + 1 == count_) return last(m, sum);
    for (; m < end; ++m) {
      at_[contact] = m;
      const double share = left.told[m] / left.diagonal[m];
      eliminate(left, m, end, left_[contact + 1]);
      place_contact(
          contact + 1,
          {sum.exponent + 0.5 * left.told[m] * share, sum.volume * left.diagonal[m] * variance_[m],
           sum.moment + share * left.base[m]},
          last);
    }
  }

  // Index of the row of sets to which the contacts that are placed belong.
  std::size_t row() const {
    std::size_t row = 0;
    for (int j = 0; j + 1 < count_; ++j) row = row * cells_ + at_[j] - j * cells_;
    return row;
  }

  static void take_out(int count, double inverse, const double* __restrict row, double own,
                       const double* __restrict old, double* __restrict fresh) {
    for (int k = 0; k < count; ++k) fresh[k] = old[k] - inverse * row[k] * own;
  }

  // Take the contact in column m out of those from `end` on.
  THIGMO_WIDE void eliminate(const Products& from, int m, int end, Products& to) const {
    const int wide = count_ * cells_;
    const double inverse = 1.0 / from.diagonal[m], *row = from.gram[m];
    take_out(wide - end, inverse, row + end, from.told[m], &from.told[end], &to.told[end]);
    if (critical_ < INFINITY) {
      take_out(wide - end, inverse, row + end, from.base[m], &from.base[end], &to.base[end]);
    }
    const auto take = [=](const double* __restrict rows, const double* __restrict old,
                          double* __restrict fresh) {
      for (int k = 0; k < wide - end; ++k) fresh[k] = old[k] - inverse * rows[k] * rows[k];
    };
    take(row + end, &from.diagonal[end], &to.diagonal[end]);
    for (int k = end; k < wide - cells_; ++k) {
      const int last = wide - cells_;
      take_out(cells_, inverse, row + last, row[k], from.gram[k] + last, to.gram[k] + last);
    }
  }

  // From exponents to weights.
  static void add_weights(int count, double top, double volume, const double* __restrict diagonal,
                          const double* __restrict variance, double* __restrict weight,
                          double* __restrict mass) {
    for (int m = 0; m < count; ++m) {
      const double root = std::sqrt(volume * diagonal[m] * variance[m]);
      const double value = exponential(weight[m] - top) / root;
      weight[m] = weight[m] > -INFINITY ? value : 0.0;
      mass[m] += weight[m];
    }
  }

  // Adds the sets that the columns from `first` on complete.
  THIGMO_WIDE void place_last(int first, Sum sum) {
    const int from = (count_ - 1) * cells_;
    const Products& left = left_.back();
    const double* __restrict told = left.told.data() + from;
    const double* __restrict diagonal = left.diagonal.data() + from;
    const double* __restrict base = left.base.data() + from;
    const double* __restrict variance = variance_.data() + from;
    double* __restrict weight = weight_.data();
    first -= from;
    // Whole vectors of four cells: what lies nearer than `first` weighs nothing.
    const int begin = first - first % 4, cells = cells_;
    for (int m = begin; m < cells; ++m) {
      const double share = told[m] / diagonal[m];
      const double exponent = sum.exponent + 0.5 * told[m] * share;
      const bool folds = std::abs(sum.moment + share * base[m]) > critical_;
      weight[m] = folds || m < first ? -INFINITY : exponent;
    }
    const double most = largest(weight + begin, cells - begin);
    if (!(most > -INFINITY) || most < top - kNothing) return;
    if (most > top + kNothing) {  // what was added so far is small beside this
      const double shrink = std::exp(top - most);
      for (double& value : mass) value *= shrink;
      total *= shrink, peak_ *= shrink, top = most;
    }
    double* to = mass.data() + row() * cells;
    std::array<double, 4> sums{};
    add_weights(cells - begin, top, sum.volume, diagonal + begin, variance + begin, weight + begin,
                to + begin);
    for (int m = begin; m < cells; m += 4) {
      for (int j = 0; j < 4; ++j) sums[j] += weight[m + j];
    }
    total += (sums[0] + sums[1]) + (sums[2] + sums[3]);
    const double heaviest = largest(weight + begin, cells - begin);
    if (heaviest <= peak_) return;
    peak_ = heaviest, level = level_, scale = scale_;
    at_.back() =
        from + static_cast<int>(std::find(weight + begin, weight + cells, heaviest) - weight);
    best = at_;
  }

  // Forces of the sets that the cells of the last contact complete, by substitution backwards. The
  // mean of contact j is z_j - u_j x that of those behind it; its variance has a share of theirs.
  THIGMO_WIDE void solve_row(Forces& of) const {
    const int last = count_ - 1, from = last * cells_, cells = cells_;
    const double *diagonal = left_[last].diagonal.data() + from, *square = square_.data() + from;
    const double* told = left_[last].told.data() + from;
    const auto alone = [=](double* __restrict mean, double* __restrict deviation,
                           double* __restrict moves) {
      for (int m = 0; m < cells; ++m) {
        mean[m] = told[m] / diagonal[m];
        deviation[m] = std::sqrt(1.0 / diagonal[m]);
        moves[m] = std::sqrt(square[m]);
      }
    };
    alone(of.mean[last], of.deviation[last], of.moves[last]);
    for (int j = last; j-- > 0;) {
      const Products& own = left_[j];
      const double *row = own.gram[at_[j]], inverse = 1.0 / own.diagonal[at_[j]];
      double mean = own.told[at_[j]] * inverse, variance = inverse, further = 0.0;
      const double* behind = row;
      if (j + 1 < last) {  // of three contacts, that in the middle
        const Products& next = left_[j + 1];
        const int at = at_[j + 1];
        const double share = row[at] * inverse;
        further = share / next.diagonal[at], behind = next.gram[at];
        mean -= further * next.told[at], variance += further * share;
      }
      const double* later = of.mean[last];
      const auto beside = [=](double* __restrict means, double* __restrict deviation) {
        for (int m = 0; m < cells; ++m) {
          const double share = row[from + m] * inverse - further * behind[from + m];
          means[m] = mean - share * later[m];
          deviation[m] = std::sqrt(variance + share * share / diagonal[m]);
        }
      };
      beside(of.mean[j], of.deviation[j]);
      std::fill_n(of.moves[j], cells, std::sqrt(square_[at_[j]]));
    }
  }

  int count_, cells_;
  std::vector<int> at_;         // columns of the set that is being weighed
  std::vector<Products> left_;  // by how many contacts are placed
  Row square_, variance_, weight_;
  double gap_ = 0.0, critical_ = INFINITY, scale_ = 0.0, peak_ = -1.0;
  std::size_t level_ = 0;
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
  for (std::size_t k = 0; k < sets.mass.size(); ++k) {
    if (sets.mass[k] == 0.0) continue;
    std::size_t left = k;
    for (auto mass = out.rbegin(); mass != out.rend(); ++mass, left /= cells) {
      (*mass)[left % cells] += sets.mass[k] / sets.total;
    }
  }
  return out;
}

// Shares the mass of a grid out among the contacts that are felt, by forces at the noise and prior
// that suit the likeliest set. All are taken for felt if `all` says so. Leaves out `nothing` of it.
inline void share_out(const Whitened& readings, const Levers& levers, const Row& unit, double felt,
                      bool all, double nothing, int cells, SetsGrid& sets, SeveralContacts& out) {
  constexpr double kUnlikely = 1e-3;
  const Whitened::At& at = readings.levels[sets.level];
  const int count = static_cast<int>(sets.width.size());
  const Row none(cells, 0.0);
  for (int j = 0; j < count; ++j) {
    const auto first = sets.place.begin() + j * cells;
    out.contacts[j] = {{first, first + cells}, sets.width[j], none, none, none, none};
  }
  if (sets.level + 1 < readings.levels.size()) {  // else it was weighed last
    Matrix white;
    at.by(levers.sensor, white);
    sets.set(white, at.read, levers.base);
  }
  sets.prepare(unit, sets.scale);
  const double least = nothing * sets.total;
  double kept = 0.0;
  for (const double mass : sets.mass) kept += mass < least ? 0.0 : mass;
  std::array<double, kMostContacts> mean{}, deviation{};
  std::array<std::array<double, 2>, kMostContacts> odds{};  // that each is not felt, and that it is
  std::array<int, kMostContacts> cell{};
  sets.each_row([&](const std::vector<int>& columns, const double* mass, int first,
                    const SetsGrid::Forces& of) {
    for (int j = 0; j + 1 < count; ++j) cell[j] = columns[j] - j * cells;
    for (int m = first; m < cells; ++m) {
      if (mass[m] < least) continue;
      cell[count - 1] = m;
      int strongest = 0;
      for (int j = 0; j < count; ++j) {
        const double moves = of.moves[j][m];
        mean[j] = of.mean[j][m], deviation[j] = of.deviation[j][m];
        const double likely =
            all ? 1.0 : probability_felt(std::abs(mean[j]) * moves, deviation[j] * moves, felt);
        odds[j] = {1.0 - likely, likely};
        if (likely > odds[strongest][1]) strongest = j;
      }
      for (unsigned way = 0; way < 1u << count; ++way) {
        double share = odds[0][way & 1];
        for (int j = 1; j < count; ++j) share *= odds[j][way >> j & 1];
        if (share < kUnlikely) continue;
        share *= mass[m] / kept;
        if ((way & (way - 1)) == 0) {  // one at most
          const int only = way ? std::countr_zero(way) : strongest;
          out.contacts[only].add(cell[only], share, mean[only], deviation[only]);
          if (way) out.contacts[only].felt[cell[only]] += share;
          continue;
        }
        FeltSet& set = out.sets.emplace_back(share);
        for (int j = 0; j < count; ++j) {
          if (!(way >> j & 1)) continue;
          set.contact[set.count] = j, set.cell[set.count] = cell[j];
          set.force[set.count] = mean[j], set.spread[set.count++] = deviation[j];
        }
      }
    }
  });
  for (Marginal& contact : out.contacts) contact.average();
}

// `all`: how many there are is known. `matters`: log evidence from which a grid is laid finer even
// where it tells most places apart.
inline SeveralContacts several_contacts(const Whitened& readings, const ForcePrior& prior,
                                        int count, int cells, const Nodes& start, bool all,
                                        double matters) {
  constexpr double kCoarse = 0.9;  // mass of a cell above which the grid tells nothing
  constexpr double kNothingOfAll = 1e-4;
  const Frame& frame = *readings.frame;
  SeveralContacts out;
  out.contacts.resize(count);
  std::vector<Window> window(count, Window{0.0, 1.0});
  Body body(frame, prior, start);
  SetsGrid sets(count, cells);
  Matrix white;
  for (int turn = 0; turn < kMostTurns; ++turn) {
    sets.clear();
    double log_volume = 0.0;
    for (int j = 0; j < count; ++j) {
      const Row part = middles(window[j], cells);
      sets.place.insert(sets.place.end(), part.begin(), part.end());
      sets.width.push_back((window[j].far - window[j].near) / cells);
      log_volume += std::log((j + 1.0) * sets.width[j]);
    }
    const Levers& levers = body.levers(sets.place);
    const Row unit = prior_deviations(prior, levers.largest);
    for (std::size_t s = 0; s < readings.levels.size(); ++s) {
      const Whitened::At& at = readings.levels[s];
      at.by(levers.sensor, white);
      sets.set(white, at.read, levers.base);
      for (const double scale : prior.scales) {
        sets.weigh(unit, at.log_density, prior.critical, s, scale);
      }
    }
    if (!(sets.total > 0.0)) return out;
    const double scales = static_cast<double>(prior.scales.size());
    out.log_evidence = sets.top + std::log(sets.total / scales) + log_volume;
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
        finer = true;
      }
    }
    if (finer || !(rests || turn + 1 == kMostTurns)) continue;
    const double nothing = kNothingOfAll * std::exp(std::min(matters - out.log_evidence, 3.0));
    share_out(readings, levers, unit, prior.felt, all, nothing, cells, sets, out);
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
                                    std::log(found.volume) + std::log(std::max(share, 1e-300));
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
