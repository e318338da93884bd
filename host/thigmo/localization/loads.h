// Loads on a body, and the evidence of any set of them, given one frame of readings.
//
// Once places and the bent shape are given, readings are linear in the loads' numbers:
//     d = C f + e,   f ~ N(m, S),   e ~ N(0, V),
// so the evidence of a set of places is a closed form (any text on Bayesian linear models):
//     log B = 1/2 b' (S^-1 + C'V^-1 C)^-1 b - 1/2 log |I + S C'V^-1 C| - 1/2 m' S^-1 m,
//     b = C'V^-1 d + S^-1 m.
// A load is a row of a table: where it acts, what it bears there, and how its numbers are bounded.
// A body (plane.h, space.h) gives the columns C of a load at its cells; all else is the same for
// every load, in a plane and in space.
#pragma once

#include <bit>
#include <cstdint>

#include "input.h"

namespace thigmo {

// Where a load acts, and what it bears. Its numbers come in this order: forces across the body, one
// in a plane and two in space; a force along it; couples across it; one about it; a kink's angle.
struct Load {
  enum class Where { anywhere, end, base } where;
  // Couples of any size, of a contact or of what holds the end, or at most
  // those of the force on the face of the end.
  enum class Couples { none, of_face, of_contact, any };
  bool across = false, along = false;
  Couples couples = Couples::none;
  bool twists = false;    // with a couple about the body
  bool kinks = false;     // turns the body at a point
  bool pushes = false;    // the force along the body never pulls
  bool critical = false;  // its moment at the base is that which folds it
  bool is_contact() const { return across; }
  bool holds() const { return couples == Couples::any; }
  bool operator==(const Load&) const = default;
};
constexpr Load kTouch{.where = Load::Where::anywhere, .across = true};
constexpr Load kClamp{
    .where = Load::Where::anywhere, .across = true, .couples = Load::Couples::of_contact};
constexpr Load kFolding{.where = Load::Where::anywhere, .across = true, .critical = true};
constexpr Load kFold{.where = Load::Where::base, .kinks = true};
constexpr Load kFace{.where = Load::Where::end,
                     .across = true,
                     .along = true,
                     .couples = Load::Couples::of_face,
                     .pushes = true};
constexpr Load kGrip{
    .where = Load::Where::end, .across = true, .along = true, .couples = Load::Couples::any};
constexpr Load kTwist{.where = Load::Where::end,
                      .across = true,
                      .along = true,
                      .couples = Load::Couples::any,
                      .twists = true};

// Loads that act together: contacts first, base to tip.
struct HypothesisKind {
  const char* name;
  std::vector<Load> loads;
  int cells;  // of the first grid of each that may lie anywhere
};
inline const HypothesisKind kFree{"free body", {}, 0};
inline const HypothesisKind kHinge{"hinge", {}, 0};
inline const HypothesisKind kOne{"one contact", {kTouch}, 60};  // 0.9 cm of the 53 cm body
inline const HypothesisKind kOneWithCouple{"one contact with a couple", {kClamp}, 60};
inline const HypothesisKind kOneAndHinge{"one contact, hinge", {kTouch}, 60};
inline const HypothesisKind kTwo{"two contacts", {kTouch, kTouch}, 24};
inline const HypothesisKind kThree{"three contacts", {kTouch, kTouch, kTouch}, 12};
inline const HypothesisKind kEnd{"end wrench", {kFace}, 1};
inline const HypothesisKind kHeld{"end wrench", {kGrip}, 1};
inline const HypothesisKind kHeldTwisted{"end wrench", {kTwist}, 1};
inline const HypothesisKind kOneAndHeld{"one contact, end wrench", {kTouch, kGrip}, 24};
inline const HypothesisKind kOneFolded{"one contact, folded base", {kFolding, kFold}, 60};
inline const HypothesisKind kEndFolded{"end wrench, folded base", {kFace, kFold}, 1};

constexpr double kResolved = 0.35;          // mass of a cell above which the grid is too coarse
constexpr double kOutside = 1e-5;           // mass of a cell below which the grid may leave it out
constexpr double kNothing = 25.0;           // nats below the likeliest set that weigh nothing
constexpr double kNearlyNothing = 1.4e-11;  // the same as a weight
constexpr std::size_t kMostContacts = 3;

// Probability that a normal number lies within plus and minus a limit.
inline double probability_within(double mean, double variance, double limit) {
  const double scale = 1.0 / std::sqrt(2.0 * std::max(variance, 1e-300));
  return 0.5 * (std::erf((limit - mean) * scale) + std::erf((limit + mean) * scale));
}

// Probability that a load which moves the readings by `moved` standard errors, give or take
// `deviation` of them, moves them by `least` or more.
template <class Numbers>
[[gnu::always_inline]] inline Numbers probability_detected(Numbers moved, Numbers deviation,
                                                           double least) {
  return normal_integral((moved - least) / (deviation > 1e-12 ? deviation : 1e-12 + Numbers{}));
}

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

// Even cells of the body, in which a contact may lie.
struct Cells {
  Row place;     // (M,) their middles
  double width;  // of each
  bool operator==(const Cells&) const = default;
};

// Contacts that are detected together, base to tip: of each its index among those that were placed,
// its cell there and its arc, and the means of its force and of that squared. A contact is alone
// where no other is detected.
struct DetectedSet {
  double mass;
  double detected;  // probability that they are; less than one if a contact is alone
  int count = 0;
  std::array<std::uint8_t, kMostContacts> contact{}, cell{};
  std::array<double, kMostContacts> arc{}, force{}, square{};
  void add(int index, int in, double place, double mean, double mean_square) {
    contact[count] = static_cast<std::uint8_t>(index), cell[count] = static_cast<std::uint8_t>(in);
    arc[count] = place, force[count] = mean, square[count++] = mean_square;
  }
};

// Posterior of the contacts of an explanation, if it has any: cells of each, and sets of sum one.
struct Shares {
  std::vector<Cells> contacts{};
  std::vector<DetectedSet> sets{};
};

// Normal equations of K numbers: products with the readings and, lower half, with each other;
// precision of the prior.
template <int K, int N = 4>
struct Normal {
  using Numbers = typename Lanes<N>::Type;
  Numbers projection[K], lower[K][K], prior[K];
};

// The same, one number eliminated after another (Gauss).
template <int K, int N = 4>
struct Eliminated {
  using Numbers = typename Lanes<N>::Type;
  Numbers lower[K][K], inverse[K], left[K], gain{}, inverse_volume = 1.0 + Numbers{};
  [[gnu::always_inline]] explicit Eliminated(const Normal<K, N>& normal) {
#pragma GCC unroll 8
    for (int j = 0; j < K; ++j) {
      Numbers raw[K];
      left[j] = normal.projection[j];
      Numbers pivot = normal.prior[j] + normal.lower[j][j];
#pragma GCC unroll 8
      for (int l = 0; l < j; ++l) {
        raw[l] = normal.lower[j][l];
#pragma GCC unroll 8
        for (int k = 0; k < l; ++k) raw[l] -= raw[k] * lower[l][k];
        lower[j][l] = raw[l] * inverse[l];
        left[j] -= lower[j][l] * left[l];
        pivot -= raw[l] * lower[j][l];
      }
      pivot = pivot > normal.prior[j] ? pivot : normal.prior[j];  // no less, but for rounding
      inverse[j] = 1.0 / pivot;
      gain += left[j] * left[j] * inverse[j], inverse_volume *= inverse[j];
    }
  }
  // Means and variances.
  [[gnu::always_inline]] void solve(Numbers* mean, Numbers* variance) const {
    Numbers up[K][K];  // transposed inverse of the lower triangle
#pragma GCC unroll 8
    for (int j = K - 1; j >= 0; --j) {
      mean[j] = left[j] * inverse[j], variance[j] = inverse[j];
#pragma GCC unroll 8
      for (int k = j + 1; k < K; ++k) {
        mean[j] -= lower[k][j] * mean[k];
        up[j][k] = -lower[k][j];
#pragma GCC unroll 8
        for (int l = j + 1; l < k; ++l) up[j][k] -= lower[l][j] * up[l][k];
        variance[j] += up[j][k] * up[j][k] * inverse[k];
      }
    }
  }
  // Variance of a sum of the numbers, whose shares are overwritten.
  [[gnu::always_inline]] void variance(Numbers* shares, Numbers& out) const {
    out = Numbers{};
#pragma GCC unroll 8
    for (int k = 0; k < K; ++k) {
#pragma GCC unroll 8
      for (int l = 0; l < k; ++l) shares[k] -= lower[k][l] * shares[l];
      out += shares[k] * shares[k] * inverse[k];
    }
  }
};

// One of a load's numbers.
struct Number {
  bool scaled = true;  // whether its prior goes with the scale of the forces
  double mean = 0.0;   // of its prior, in standard deviations
  double side = 0.0;   // 1 or -1 if it never has the other sign
};

// A load's cells on a shape, and its columns there.
struct LoadColumns {
  const Load* load;
  int cells;
  std::vector<Number> number{};
  int across = 1;  // how many of its numbers are forces across the body
  Window window{0.0, 1.0};
  double width = 0.0;
  Row place{};
  Row density{};    // prior density of the places; empty: all alike
  Matrix column{};  // (N, numbers * cells), of one prior deviation at a scale of one
  Row unit{};       // (numbers * cells) such a deviation
  Row base{};       // (numbers * cells) the moment at the base that it causes; empty in space
  Row laid{};       // what all that hangs on; empty: on the shape
  int size() const { return static_cast<int>(number.size()); }
};

// A load at a place: its numbers, and their standard deviations.
constexpr int kMostNumbers = 6;
struct PlacedLoad {
  const Load* load;
  double arc;
  std::array<double, kMostNumbers> value{}, spread{};
};

// What is filled before use and of no use to a copy, which is made without it.
template <class Values>
struct Scratch : Values {
  Scratch() = default;
  Scratch(const Scratch&) : Values() {}
  Scratch(Scratch&&) = default;
  Scratch& operator=(const Scratch&) { return *this; }
  Scratch& operator=(Scratch&&) = default;
  ~Scratch() = default;
};

// Sets of places, one of each load's cells. What their evidence needs stands side by side, set
// after set, so that loops over sets become vector code.
class PlaceSets {
 public:
  std::vector<LoadColumns> load_columns;
  Row mass;  // of each set
  Matrix mean, spread,
      detected;  // (contacts, sets) force across the body; probability that it counts
  double total = 0.0, top = -INFINITY;
  std::size_t level = 0;  // model of the errors that suits the likeliest set

  int size() const { return sets_; }
  int count() const {  // of contacts
    return static_cast<int>(
        std::count_if(load_columns.begin(), load_columns.end(),
                      [](const LoadColumns& p) { return p.load->is_contact(); }));
  }
  int cell(int load, int set) const { return cell_[load][set]; }
  // A load on the end is drawn as one on the last cell.
  Cells cells(int load) const {
    const LoadColumns& p = load_columns[load];
    const bool anywhere = p.load->where == Load::Where::anywhere;
    return {anywhere ? p.place : Row{1.0 - 0.5 * p.width}, p.width};
  }

  // Lists all sets whose contacts are half a cell apart at least.
  void list() {
    std::vector<Window> windows;
    number_.clear(), number_origin_.clear();
    for (std::size_t j = 0; j < load_columns.size(); ++j) {
      for (int d = 0; d < load_columns[j].size(); ++d) {
        number_origin_.push_back({static_cast<int>(j), d});
        number_.push_back(load_columns[j].number[d]);
      }
      windows.push_back(load_columns[j].window);
    }
    if (windows != listed_) {
      listed_ = windows;
      cell_.assign(load_columns.size(), {});
      std::vector<int> chosen(load_columns.size());
      list(0, chosen);
      sets_ = static_cast<int>(cell_[0].size());
      for (std::vector<int>& cells_of_load : cell_)
        cells_of_load.resize(padded(), cells_of_load.empty() ? 0 : cells_of_load.back());
    }
    density_.assign(padded(), 0.0);
    std::fill_n(density_.begin(), sets_, 1.0);
    for (std::size_t j = 0; j < load_columns.size(); ++j) {
      const Row& density = load_columns[j].density;
      for (int s = 0; !density.empty() && s < sets_; ++s) density_[s] *= density[cell_[j][s]];
    }
  }

  // Takes columns and readings.
  void take(const Whitened& readings) {
    int wide = 0;
    first_.clear();
    for (std::size_t j = 0; j < load_columns.size(); ++j) {
      first_.push_back(twin(j) ? first_.back() : wide);
      if (!twin(j)) wide += load_columns[j].column.columns;
    }
    column_.resize(readings.frame->size(), wide);
    for (std::size_t j = 0; j < load_columns.size(); ++j) {
      const Matrix& column = load_columns[j].column;
      for (int i = 0; !twin(j) && i < column.rows; ++i) {
        std::copy_n(column[i], column.columns, column_[i] + first_[j]);
      }
    }
    levels_.resize(readings.levels.size());
    white_.resize(levels_.size());
    for (std::size_t s = 0; s < levels_.size(); ++s) {
      if (const int base = readings.base(s); base < 0) {
        take(readings.levels[s], white_[s], levels_[s]);
      } else {
        take_beside(readings.levels[base], levels_[base], readings.levels[s], levels_[s]);
      }
    }
  }

  // Weighs all sets, over levels of the noise and scales of the forces. Returns whether any of them
  // is possible.
  THIGMO_WIDEST(bool, weigh, const Options& options, options)
  template <int N>
  [[gnu::always_inline]] bool weigh_by(const Options& options) {
    const Row& moments = options.priors.moments;
    const std::size_t scales = moments.size();
    weight_.resize(static_cast<int>(levels_.size() * scales), padded());
    weight_rows_.clear();
    mass.assign(padded(), 0.0), total = 0.0, top = -INFINITY;
    Row remaining(padded());  // share of the prior's volume that readings leave, squared
    const bool folds = may_fold(options.critical);
    const bool bounded = folds || std::any_of(number_.begin(), number_.end(),
                                              [](const Number& n) { return n.side != 0.0; });
    for (int r = 0; r < weight_.rows; ++r) {
      const Products& products = levels_[r / scales];
      const ScaledPrior prior = scaled(moments[r % scales]);
      double* __restrict weight = weight_[r], * __restrict left = remaining.data();
      numbers([&]<int K>() __attribute__((always_inline)) {
        for (int s = 0; s < padded(); s += N) {
          const Eliminated<K, N> eliminated(normal<K, N>(products, prior, s));
          lanes<N>(weight + s) = 0.5 * eliminated.gain;
          lanes<N>(left + s) = eliminated.inverse_volume * prior.tighter;
        }
      });
      const double most = largest(weight, padded()) + products.constant + prior.constant;
      if (!(most > -INFINITY) || most < top - kNothing) continue;
      weight_rows_.push_back({r, prior, most}), top = std::max(top, most);
      const double shift = products.constant + prior.constant - most;
      for (int s = 0; s < padded(); s += N) {
        lanes<N>(weight + s) = lanes<N>(&density_[s]) * exponential(lanes<N>(weight + s) + shift) *
                               root(lanes<N>(left + s));
      }
      if (bounded) bound(options.critical, folds, products, prior, weight);
    }
    double peak = 0.0;
    std::erase_if(weight_rows_, [&](const WeightRow& way) { return way.share < top - kNothing; });
    for (auto& [r, prior, share] : weight_rows_) {
      const double* weight = weight_[r];
      share = std::exp(share - top);
      const double most = share * largest(weight, padded());
      for (int s = 0; s < sets_; ++s) mass[s] += share * weight[s];
      if (most <= peak) continue;
      peak = most, level = r / scales, scale_ = moments[r % scales];
      best_ = static_cast<int>(std::max_element(weight, weight + sets_) - weight);
    }
    total = sum_from(0.0, mass);
    priors_ = &options.priors;
    return total > 0.0;
  }

  // Of sets that hold a share of `least` or more: forces over levels and scales, and the
  // probability that each contact counts. Contacts of other sets are taken to count.
  THIGMO_WIDEST(void, solve, double least, least)
  template <int N>
  [[gnu::always_inline]] void solve_by(double least) {
    using Numbers = typename Lanes<N>::Type;
    const int contacts = count();
    for (Matrix* result : {&mean, &spread, &detected}) result->resize(contacts, padded());
    const int scales = static_cast<int>(priors_->moments.size());
    // `Single`: whether each contact has one number, and nothing else has any.
    const auto run = [&]<int K, bool Single>() __attribute__((always_inline)) {
      constexpr int kContacts = std::min<int>(K, kMostContacts);
      for (int s = 0; s < padded(); s += N) {
        const Numbers& whole = lanes<N>(&mass[s]);
        if (largest(&mass[s], N) < least * total) {
          for (int j = 0; j < contacts; ++j) lanes<N>(detected[j] + s) = 1.0 + Numbers{};
          continue;
        }
        Numbers first[kContacts]{}, second[kContacts]{}, times[kContacts]{}, likely[kContacts]{};
        for (const auto& [r, prior, share] : weight_rows_) {
          const Normal<K, N> normal = this->normal<K, N>(levels_[r / scales], prior, s);
          const Eliminated<K, N> eliminated(normal);
          Numbers force[K], variance[K];
          eliminated.solve(force, variance);
          const Numbers weight = share * lanes<N>(weight_[r] + s);
          if constexpr (Single) {
#pragma GCC unroll 3
            for (int j = 0; j < K; ++j) {
              first[j] += weight * force[j],
                  second[j] += weight * (force[j] * force[j] + variance[j]);
            }
            continue;
          }
          for (int j = 0, begin = 0; j < contacts; begin += load_columns[j++].size()) {
            const int beyond = begin + load_columns[j].size(), across = load_columns[j].across;
            Numbers ways[K]{}, moves[K]{}, length{}, standard{}, size, loose, moved_deviation;
            for (int k = begin; k < beyond; ++k) {
              if (k < begin + across) ways[k] = force[k], length += force[k] * force[k];
              for (int l = begin; l < beyond; ++l) {
                moves[k] += normal.lower[std::max(k, l)][std::min(k, l)] * force[l];
              }
              standard += moves[k] * force[k];
            }
            eliminated.variance(ways, loose), eliminated.variance(moves, moved_deviation);
            loose /= length > 1e-300 ? length : 1e-300 + Numbers{};
            moved_deviation /= standard > 1e-300 ? standard : 1e-300 + Numbers{};
            size = across == 1 ? force[begin] : root(length), standard = root(standard);
            first[j] += weight * size, second[j] += weight * (size * size + loose);
            times[j] += weight * standard,
                likely[j] += weight * (standard * standard + moved_deviation);
          }
        }
        const Numbers part = 1.0 / (whole > 1e-300 ? whole : 1e-300 + Numbers{});
#pragma GCC unroll 3
        for (int j = 0; j < kContacts; ++j) {
          if (!Single && j == contacts) break;
          const Numbers force_mean = first[j] * part,
                        loose = root(second[j] * part - force_mean * force_mean);
          Numbers moved, moved_deviation, unit;
          if (Single) {  // how far a force moves the readings is that times its size
            const Numbers moves = root(product<N>(levels_[level], j, j, s));
            moved = (force_mean > 0.0 ? force_mean : -force_mean) * moves,
            moved_deviation = loose * moves;
          } else {
            moved = times[j] * part, moved_deviation = root(likely[j] * part - moved * moved);
          }
          lanes<N>(detected[j] + s) =
              probability_detected(moved, moved_deviation, priors_->detected);
          for (int lane = 0; lane < N; ++lane)
            unit[lane] = load_columns[j].unit[cell_[j][s + lane]];
          lanes<N>(mean[j] + s) = force_mean * unit,
                             lanes<N>(spread[j] + s) = loose * (unit > 0.0 ? unit : -unit);
        }
      }
    };
    numbers([&]<int K>() __attribute__((always_inline)) {
      if constexpr (K <= kMostContacts) {
        if (contacts == K) return run.template operator()<K, true>();
      }
      run.template operator()<K, false>();
    });
  }

  // Probability of each model of the errors.
  Row level_shares() const {
    const std::size_t scales = priors_->moments.size();
    Row out(levels_.size());
    for (const WeightRow& way : weight_rows_) {
      const double* weight = weight_[way.row];
      out[way.row / scales] += way.share * std::accumulate(weight, weight + sets_, 0.0);
    }
    for (double& share : out) share /= total;
    return out;
  }

  // Probability that all contacts of a set are detected.
  double all_detected() const {
    double sum = 0.0;
    for (int s = 0; s < sets_; ++s) {
      double likely = mass[s];
      for (int j = 0; j < detected.rows; ++j) likely *= detected[j][s];
      sum += likely;
    }
    return sum / total;
  }

  // The likeliest set: its loads, the readings that these leave, and their
  // misfit by the model of the errors that suits it.
  struct Likeliest {
    std::vector<PlacedLoad> loads;
    Row left;
    double misfit;
  };
  Likeliest likeliest(const Frame& frame) const {
    const Products& products = levels_[level];
    Likeliest out{{}, frame.excess, products.square};
    numbers([&]<int K>() __attribute__((always_inline)) {
      const int lane = best_ % 4, s = best_ - lane;
      Four number[K], variance[K];
      Eliminated<K>(normal<K>(products, scaled(scale_), s)).solve(number, variance);
      for (int k = 0; k < K; ++k) {
        const auto [j, d] = number_origin_[k];
        const LoadColumns& p = load_columns[j];
        const int column = d * p.cells + cell_[j][best_];
        if (d == 0) out.loads.push_back({p.load, p.place[cell_[j][best_]]});
        out.loads.back().value[d] = number[k][lane] * p.unit[column];
        out.loads.back().spread[d] = std::sqrt(variance[k][lane]) * std::abs(p.unit[column]);
        for (int i = 0; i < frame.size(); ++i) {
          out.left[i] -= number[k][lane] * column_[i][first_[j] + column];
        }
        double moves = -2.0 * products.value[k][best_];
        for (int l = 0; l < K; ++l) {
          moves += number[l][lane] * product(products, std::max(k, l), std::min(k, l), s)[lane];
        }
        out.misfit += number[k][lane] * moves;
      }
    });
    return out;
  }

  // V^(-1) times the columns, at each level of the noise.
  THIGMO_WIDE std::vector<Matrix> precision_weighted(const Whitened& readings) const {
    std::vector<Matrix> weighted;
    weighted.reserve(levels_.size());
    for (std::size_t s = 0; s < levels_.size(); ++s) {
      const Whitener& whitener = readings.levels[s].whitener;
      const int base = readings.base(s);
      if (base < 0) {
        weighted.push_back(white_[s]);
        whitener.apply_transpose(weighted.back());
        continue;
      }
      weighted.push_back(weighted[base]);
      Row products(column_.columns);
      for (int k = readings.levels[base].whitener.shared(); k < whitener.shared(); ++k) {
        products_with(whitener.weighted_error(k), products.data());
        for (int i = 0; i < column_.rows; ++i) {
          const double share = whitener.taken(k) * whitener.weighted_error(k)[i];
          double* row = weighted.back()[i];
          for (int c = 0; c < column_.columns; ++c) row[c] -= share * products[c];
        }
      }
    }
    return weighted;
  }

  // Log density of the readings at the likeliest set, without a further column and beside each.
  struct Densest {
    double plain;
    Row beside;
  };
  // Bounds of the evidence from above, since evidence is a mean over sets: at the widest scale of
  // the forces, as if no prior volume were lost, at the noise that suits the likeliest set or at
  // less of it. `weighted`: of `precision_weighted`.
  THIGMO_WIDE Densest densest(const Whitened& readings, const std::vector<Matrix>& weighted,
                              const std::vector<Column>& columns, int count) const {
    const ScaledPrior widest =
        scaled(*std::max_element(priors_->moments.begin(), priors_->moments.end()));
    const double prior = std::log(*std::max_element(density_.begin(), density_.end()));
    Densest out{-INFINITY, Row(count, -INFINITY)};
    Matrix products;  // of a column with those of each set
    for (std::size_t s = 0; s < levels_.size(); ++s) {
      const Whitened::AtLevel& model = readings.levels[s];
      const Products& sets = levels_[s];
      if (model.level.factor > readings.levels[level].level.factor) continue;
      for (int e = -1; e < count; ++e) {
        Whitened::AtLevel::Beside beside{0.0, 0.0, 0.0};
        if (e >= 0) {
          beside = model.beside(columns[e]);
          lay_products(columns[e], beside.scale, weighted[s], products);
        }
        Four most = -INFINITY + Four{};
        numbers([&]<int K>() __attribute__((always_inline)) {
          for (int m = 0; m < sets_; m += 4) {
            Normal<K> normal = this->normal<K>(sets, widest, m);
            for (int k = 0; e >= 0 && k < K; ++k) {
              normal.projection[k] -= beside.projection * four(products[k] + m);
              for (int l = 0; l <= k; ++l) {
                normal.lower[k][l] -= four(products[k] + m) * four(products[l] + m);
              }
            }
            const Four gain = Eliminated<K>(normal).gain;
            most = gain > most ? gain : most;
          }
        });
        const double best = sets.constant + beside.gain + 0.5 * largest(most) + prior;
        double& bound = e < 0 ? out.plain : out.beside[e];
        bound = std::max(bound, best);
      }
    }
    return out;
  }

  // The same sets beside a further column, to be weighed. `weighted`: of `precision_weighted`.
  THIGMO_WIDE PlaceSets beside(const Whitened& readings, const std::vector<Matrix>& weighted,
                               const Column& column) const {
    PlaceSets out = *this;
    Matrix products;
    for (std::size_t s = 0; s < levels_.size(); ++s) {
      const Whitened::AtLevel::Beside beside = readings.levels[s].beside(column);
      Products& sets = out.levels_[s];
      lay_products(column, beside.scale, weighted[s], products);
      sets.constant += beside.gain, sets.square -= beside.projection * beside.projection;
      const int count = static_cast<int>(number_.size());
      for (int k = 0; k < count; ++k) {
        const double* product = products[k];
        for (int m = 0; m < padded(); ++m) sets.value[k][m] -= beside.projection * product[m];
        for (int l = 0; l <= k; ++l) {
          double* value = sets.value[gram(count, k, l)];
          for (int m = 0; m < padded(); ++m) value[m] -= product[m] * products[l][m];
        }
      }
    }
    return out;
  }

 private:
  // At one level of the noise: log density and square of the readings; of each set, products of its
  // numbers' columns with the readings and, lower half, with each other.
  struct Products {
    double constant, square;
    Matrix value;
  };
  // Prior precisions of the numbers at one scale of the forces, and what they add to a log weight.
  struct ScaledPrior {
    std::array<double, 2 * kMostNumbers> tight;
    double tighter = 1.0, constant = 0.0;
  };

  // A row of the weights, of one level and one scale; its share of the mass, a log while weighed.
  struct WeightRow {
    int row;
    ScaledPrior prior;
    double share;
  };

  int padded() const { return (sets_ + 7) / 8 * 8; }  // to whole vectors of eight
  static int gram(int count, int k, int l) { return count + k * (k + 1) / 2 + l; }
  template <int N = 4>
  const typename Lanes<N>::Type& product(const Products& products, int k, int l, int s) const {
    return lanes<N>(products.value[gram(static_cast<int>(number_.size()), k, l)] + s);
  }
  // Whether a load has the same columns as the one before it.
  bool twin(std::size_t j) const {
    if (j == 0) return false;
    const LoadColumns &previous = load_columns[j - 1], &current = load_columns[j];
    return *previous.load == *current.load && previous.window == current.window &&
           previous.cells == current.cells;
  }
  void list(std::size_t load, std::vector<int>& chosen) {
    if (load == load_columns.size()) {
      for (std::size_t j = 0; j < load; ++j) cell_[j].push_back(chosen[j]);
      return;
    }
    const LoadColumns& p = load_columns[load];
    for (chosen[load] = 0; chosen[load] < p.cells; ++chosen[load]) {
      if (load > 0 && p.load->is_contact()) {
        const LoadColumns& before = load_columns[load - 1];
        const double gap = 0.5 * std::min(p.width, before.width);
        if (p.place[chosen[load]] - before.place[chosen[load - 1]] < gap) continue;
      }
      list(load + 1, chosen);
    }
  }

  THIGMO_WIDE void take(const Whitened::AtLevel& model, Matrix& white, Products& out) {
    const int count = static_cast<int>(number_.size()), wide = column_.columns, n = column_.rows;
    out.constant = model.log_density, out.square = model.square;
    model.whitener(column_, white);
    out.value.resize(count + count * (count + 1) / 2, padded());
    Row projection(wide);
    for (int i = 0; i < n; ++i) {
      const double *row = white[i], reading = model.read[i];
      for (int c = 0; c < wide; ++c) projection[c] += reading * row[c];
    }
    blocks_.clear();
    for (int k = 0; k < count; ++k) {
      const auto [b, d] = number_origin_[k];
      const int *right = cell_[b].data(), cells = load_columns[b].cells,
                offset = first_[b] + d * cells;
      double* __restrict product = out.value[k];
      for (int s = 0; s < padded(); ++s) product[s] = projection[offset + right[s]];
      for (int l = 0; l <= k; ++l) {
        const auto [a, c] = number_origin_[l];
        const int *left = cell_[a].data(), rows = load_columns[a].cells,
                  beside = first_[a] + c * rows;
        product = out.value[gram(count, k, l)];
        if (a == b) {
          const double* squares = block(white, offset, cells, beside, 0);
          for (int s = 0; s < padded(); ++s) product[s] = squares[right[s]];
        } else {
          const double* products = block(white, offset, cells, beside, rows);
          for (int s = 0; s < padded(); ++s) product[s] = products[left[s] * cells + right[s]];
        }
      }
    }
  }

  // Products of a row of numbers, one for each reading, with all columns.
  [[gnu::always_inline]] void products_with(const double* row, double* out) const {
    std::fill_n(out, column_.columns, 0.0);
    for (int i = 0; i < column_.rows; ++i) {
      const double factor = row[i], *column = column_[i];
      for (int c = 0; c < column_.columns; ++c) out[c] += factor * column[c];
    }
  }

  // Takes a level that has further shared errors and shifts beside another, whose products change
  // by an outer product for each error.
  THIGMO_WIDE void take_beside(const Whitened::AtLevel& base, const Products& products,
                               const Whitened::AtLevel& model, Products& out) {
    const int count = static_cast<int>(number_.size()), stated = base.whitener.shared();
    const int errors = model.whitener.shared() - stated;
    out.constant = model.log_density, out.square = model.square;
    out.value.resize(count + count * (count + 1) / 2, padded());
    error_products_.resize(errors + 1, column_.columns);
    set_products_.resize(errors * count, padded());
    products_with(model.precision_weighted.data(), error_products_[errors]);
    for (int e = 0; e < errors; ++e) {
      products_with(model.whitener.weighted_error(stated + e), error_products_[e]);
      const double scale = std::sqrt(model.whitener.taken(stated + e));
      for (int c = 0; c < column_.columns; ++c) error_products_[e][c] *= scale;
    }
    for (int k = 0; k < count; ++k) {
      const auto [load, number] = number_origin_[k];
      const int *cell = cell_[load].data(),
                first = first_[load] + number * load_columns[load].cells;
      for (int e = 0; e <= errors; ++e) {
        const double* of_cell = error_products_[e] + first;
        double* __restrict cell_product = e < errors ? set_products_[e * count + k] : out.value[k];
        for (int s = 0; s < padded(); ++s) cell_product[s] = of_cell[cell[s]];
      }
      for (int l = 0; l <= k; ++l) {
        double* __restrict set_product = out.value[gram(count, k, l)];
        std::copy_n(products.value[gram(count, k, l)], padded(), set_product);
        for (int e = 0; e < errors; ++e) {
          const double *product_k = set_products_[e * count + k],
                       *product_l = set_products_[e * count + l];
          for (int s = 0; s < padded(); ++s) set_product[s] -= product_k[s] * product_l[s];
        }
      }
    }
  }

  // Products of whitened columns from `beside` on, one in each row, with those from `first` on; of
  // no rows, of those at the same cells. Contacts on the same cells share them.
  [[gnu::always_inline]] const double* block(const Matrix& white, int first, int cells, int beside,
                                             int rows) {
    const std::array key{first, beside, rows};
    for (const auto& [block_key, start] : blocks_) {
      if (block_key == key) return &both_[start];
    }
    const std::size_t start = blocks_.empty() ? 0 : ends_;
    ends_ = start + static_cast<std::size_t>(std::max(rows, 1)) * cells;
    if (both_.size() < ends_) both_.resize(ends_);
    blocks_.push_back({key, start});
    const int n = white.rows;
    if (rows == 0) std::fill_n(&both_[start], cells, 0.0);
    for (int i = 0; rows == 0 && i < n; ++i) {
      const double *left = white[i] + first, *right = white[i] + beside;
      double* __restrict product = &both_[start];
      for (int m = 0; m < cells; ++m) product[m] += left[m] * right[m];
    }
    for (int r = 0; r < rows; ++r) {
      double* __restrict row = &both_[start + static_cast<std::size_t>(r) * cells];
      int m = 0;
      for (; m + 12 <= cells; m += 12) {
        Four sum[3]{};
        for (int i = 0; i < n; ++i) {
          const double *left = white[i] + first + m, factor = white[i][beside + r];
          for (int part = 0; part < 3; ++part) sum[part] += factor * four(left + 4 * part);
        }
        for (int part = 0; part < 3; ++part) four(row + m + 4 * part) = sum[part];
      }
      for (; m < cells; ++m) {
        row[m] = 0.0;
        for (int i = 0; i < n; ++i) row[m] += white[i][first + m] * white[i][beside + r];
      }
    }
    return &both_[start];
  }

  // Products of a column, times its scale, with those of each set. `weighted`: V^(-1) times the
  // columns.
  [[gnu::always_inline]] void lay_products(const Column& column, double scale,
                                           const Matrix& weighted, Matrix& out) const {
    const int count = static_cast<int>(number_.size());
    out.resize(count, padded());
    Row sum(column_.columns);
    for (std::size_t i = 0; i < column.value.size(); ++i) {
      const double share = scale * column.value[i];
      const double* row = weighted[column.first + static_cast<int>(i)];
      for (int c = 0; c < weighted.columns; ++c) sum[c] += share * row[c];
    }
    for (int k = 0; k < count; ++k) {
      const auto [j, d] = number_origin_[k];
      const double* cell_sum = &sum[first_[j] + d * load_columns[j].cells];
      const int* cell = cell_[j].data();
      double* __restrict product = out[k];
      for (int s = 0; s < padded(); ++s) product[s] = cell_sum[cell[s]];
    }
  }

  ScaledPrior scaled(double scale) const {
    ScaledPrior out;
    for (std::size_t k = 0; k < number_.size(); ++k) {
      const double tight = number_[k].scaled ? 1.0 / (scale * scale) : 1.0;
      out.tight[k] = tight, out.tighter *= tight;
      out.constant -= 0.5 * tight * number_[k].mean * number_[k].mean;
    }
    return out;
  }

  // Calls `run` for as many numbers as a set has.
  template <class Run>
  [[gnu::always_inline]] void numbers(const Run& run) const {
    [&]<int... K>(std::integer_sequence<int, K...>) __attribute__((always_inline)) {
      const int count = static_cast<int>(number_.size());
      ((K + 1 == count ? run.template operator()<K + 1>() : void()), ...);
    }(std::make_integer_sequence<int, 8>{});
  }

  // Normal equations of N sets from `s` on.
  template <int K, int N = 4>
  [[gnu::always_inline]] Normal<K, N> normal(const Products& products,
                                             const ScaledPrior& scaled_prior, int s) const {
    Normal<K, N> out;
    for (int k = 0; k < K; ++k) {
      out.prior[k] = scaled_prior.tight[k] + typename Lanes<N>::Type{};
      out.projection[k] = lanes<N>(products.value[k] + s) + scaled_prior.tight[k] * number_[k].mean;
      for (int l = 0; l <= k; ++l) out.lower[k][l] = lanes<N>(products.value[gram(K, k, l)] + s);
    }
    return out;
  }

  // Whether touches may fold the base instead.
  bool may_fold(double critical) const {
    const auto touches = [](const LoadColumns& p) {
      return p.load->where == Load::Where::anywhere && !p.load->critical;
    };
    return critical < INFINITY && std::all_of(load_columns.begin(), load_columns.end(), touches);
  }
  // Leaves of each set's weight the share in which numbers are on their side, and the moment at the
  // base is below the critical one.
  THIGMO_WIDE void bound(double critical, bool folds, const Products& products,
                         const ScaledPrior& prior, double* weight) const {
    numbers([&]<int K>() __attribute__((always_inline)) {
      for (int s = 0; s < sets_; s += 4) {
        const int lanes = std::min(4, sets_ - s);
        if (*std::max_element(weight + s, weight + s + lanes) < kNearlyNothing) {
          std::fill_n(weight + s, lanes, 0.0);
          continue;
        }
        const Eliminated<K> eliminated(normal<K>(products, prior, s));
        Four number[K], variance[K], lever[K]{}, moment{}, loose{};
        eliminated.solve(number, variance);
        for (int k = 0; folds && k < K; ++k) {
          const auto [j, d] = number_origin_[k];
          const double* base = &load_columns[j].base[d * load_columns[j].cells];
          for (int lane = 0; lane < 4; ++lane) lever[k][lane] = base[cell_[j][s + lane]];
          moment += lever[k] * number[k];
        }
        if (folds) eliminated.variance(lever, loose);
        for (int lane = 0; lane < lanes; ++lane) {
          for (int k = 0; k < K; ++k) {
            if (number_[k].side == 0.0) continue;
            const double deviation = std::sqrt(2.0 * variance[k][lane]);
            weight[s + lane] *= std::erfc(-number_[k].side * number[k][lane] / deviation);
          }
          if (!folds || std::abs(moment[lane]) + 5.0 * std::sqrt(loose[lane]) < critical) continue;
          const double below = probability_within(moment[lane], loose[lane], critical);
          weight[s + lane] *= std::max(below, 1e-30);
        }
      }
    });
  }

  std::vector<Window> listed_;          // of the loads whose sets these are
  std::vector<std::vector<int>> cell_;  // of each load, in each set
  std::vector<std::array<int, 2>>
      number_origin_;  // of each number its load, and which of its own it is
  std::vector<Number> number_;
  std::vector<int> first_;  // column of each load
  Matrix column_, weight_;
  std::vector<Products> levels_;
  Scratch<std::vector<Matrix>> white_;  // whitened columns, at each level that has no base
  std::vector<WeightRow> weight_rows_;
  // Blocks of products of columns, by where they are taken: their first one.
  std::vector<std::pair<std::array<int, 3>, std::size_t>> blocks_;
  std::size_t ends_ = 0;
  Scratch<Row> both_;
  // Of each shared error beside a base: products with columns, and with those of each set.
  Scratch<Matrix> error_products_, set_products_;
  Row density_;
  const Priors* priors_ = nullptr;
  double scale_ = 0.0;  // of the forces, and index, of the likeliest set
  int best_ = 0, sets_ = 0;
};

// Shares the mass of a grid that is solved out among the contacts that are detected. All are taken
// for detected if `all` says so. Leaves out sets that hold a share of less than `nothing`.
inline Shares share_out(const PlaceSets& grid, bool all, double nothing) {
  constexpr double kUnlikely = 1e-3;
  const int count = grid.count();
  Shares out;
  struct Alone {
    double mass = 0.0, detected = 0.0, force = 0.0, square = 0.0;
  };
  std::array<std::vector<Alone>, kMostContacts> alone;  // of each contact in each of its cells
  for (int j = 0; j < count; ++j) {
    out.contacts.push_back(grid.cells(j));
    alone[j].resize(out.contacts[j].place.size());
  }
  const double least = nothing * grid.total;
  const double kept = sum_from(least, grid.mass);
  out.sets.reserve(grid.size());
  for (int s = 0; s < grid.size(); ++s) {
    if (grid.mass[s] < least) continue;
    const double whole = grid.mass[s] / kept;
    // Of each way in which some are detected, a bit each: its mass.
    std::array<double, 1 << kMostContacts> share{whole};
    std::array<double, kMostContacts> mean{}, square{};
    std::array<int, kMostContacts> cell{};
    int strongest = 0;
    double most = 0.0;
    for (int j = 0; j < count; ++j) {
      cell[j] = grid.cell(j, s), mean[j] = grid.mean[j][s];
      square[j] = mean[j] * mean[j] + grid.spread[j][s] * grid.spread[j][s];
      const double likely = all ? 1.0 : grid.detected[j][s];
      if (likely > most) most = likely, strongest = j;
      for (int way = 0; way < 1 << j; ++way) {
        share[way | 1 << j] = share[way] * likely, share[way] *= 1.0 - likely;
      }
    }
    for (unsigned way = 0; way < 1u << count; ++way) {
      const double mass = share[way];
      if (mass < kUnlikely * whole) continue;
      if ((way & (way - 1)) == 0) {  // one at most
        const int only = way ? std::countr_zero(way) : strongest;
        Alone& marginal = alone[only][cell[only]];
        marginal.mass += mass, marginal.force += mass * mean[only],
            marginal.square += mass * square[only];
        if (way) marginal.detected += mass;
        continue;
      }
      DetectedSet& set = out.sets.emplace_back(DetectedSet{mass, 1.0});
      for (int j = 0; j < count; ++j) {
        if (way >> j & 1) set.add(j, cell[j], out.contacts[j].place[cell[j]], mean[j], square[j]);
      }
    }
  }
  for (int j = 0; j < count; ++j) {
    for (std::size_t m = 0; m < alone[j].size(); ++m) {
      const auto& [mass, detected, force, square] = alone[j][m];
      if (mass == 0.0) continue;
      out.sets.emplace_back(DetectedSet{mass, detected / mass})
          .add(j, static_cast<int>(m), out.contacts[j].place[m], force / mass, square / mass);
    }
  }
  return out;
}

}  // namespace thigmo
