// What is known of the readings' errors, and whitening by it.
//
// The errors of a frame have the covariance V = D + U'U: an independent part of each reading (white
// noise, gain) and columns that readings share (offset, scale of the map, whatever a caller adds).
// A load with a normal prior is such a column too, so the evidence of a load without a place is the
// density of the readings under a larger V. `Whitener` applies V^(-1/2) column by column: a reading
// costs a few products, and no matrix is factored.
#pragma once

#include <numbers>

#include "shape.h"

namespace thigmo {

// What may be wrong with the readings beyond the errors that were stated.
enum class Mistake { none, slight, sign, twice, far, not_given, fold, correlated };
constexpr int kMistakes = 8;

// A row of the table of mistakes (input.h): what it does to the readings.
struct ErrorRow {
  Mistake mistake = Mistake::none;
  double log_odds = 0.0;
  Row shift{};               // (N,) added to the excess; empty: nothing
  Matrix columns{};          // (K, N) shared errors, of one standard deviation
  Matrix bends{};            // (J, nodes) curvature of the body by the first J of them
  double correlation = 0.0;  // of the white noise of neighbouring readings, AR(1)
  bool mirrored = false;     // the free body bends to the other side
};

// A model of the errors: a factor of the stated noise, and a row of the frame's
// table of mistakes.
struct Level {
  double factor, log_odds;
  int row = 0;
};

// An effect of one standard deviation that is zero but on a few neighbouring readings.
struct Column {
  int first;
  Row value;
};

// One frame, normalised by the length.
struct Frame {
  Row excess;                 // (N,) readings above the free ones
  Row low, high;              // (N,) ends of the sensors on the body
  Row noise;                  // (N,) standard deviation of white noise, or its share where that
                              // is unknown
  Row gain;                   // (N,) standard deviation of a reading's gain error
  Matrix shared;              // (K, N) effect of each shared error of one standard deviation
  std::vector<Level> levels;  // models of the errors; their odds sum to one
  std::vector<ErrorRow> rows = {{}};  // that levels refer to; the first is what was stated
  std::vector<int> rank;              // (N,) place in the order of positions; not in space
  int size() const { return static_cast<int>(excess.size()); }
  // Readings above the free ones, by a model of the errors.
  Row excess_by(const Level& level) const {
    Row out = excess;
    const Row& shift = rows[level.row].shift;
    for (std::size_t i = 0; i < shift.size(); ++i) out[i] += shift[i];
    return out;
  }
  // All shared errors of a model.
  Matrix shared_by(const Level& level) const {
    const Matrix& more = rows[level.row].columns;
    if (more.rows == 0) return shared;
    Matrix out(shared.rows + more.rows, size());
    std::copy(shared.value.begin(), shared.value.begin() + shared.rows * size(), out.value.begin());
    std::copy(more.value.begin(), more.value.end(), out[shared.rows]);
    return out;
  }
  void share(const Column& error) {
    shared.value.resize(shared.value.size() + excess.size());
    std::copy(error.value.begin(), error.value.end(), shared[shared.rows++] + error.first);
  }
};

class Whitener {
 public:
  double log_det;  // of V^(-1/2), of N standard normal densities, and of the noise's odds

  Whitener(const Frame& frame, const Level& level)
      : log_det(level.log_odds - 0.5 * frame.size() * std::log(2.0 * std::numbers::pi)),
        inverse_(frame.size()),
        column_(frame.shared_by(level)),
        weighted_(column_.rows, frame.size()),
        factor_(column_.rows),
        taken_(column_.rows) {
    const int n = frame.size();
    double product = 1.0;
    for (int i = 0; i < n; ++i) {
      const double noise = level.factor * frame.noise[i], gain = frame.gain[i];
      inverse_[i] = 1.0 / std::sqrt(noise * noise + gain * gain);
      product *= inverse_[i];
      if (!(product < 1e200 && product > 1e-200) || i == n - 1) {
        log_det += std::log(product);
        product = 1.0;
      }
    }
    correlate(frame, frame.rows[level.row].correlation);
    for (int k = 0; k < column_.rows; ++k) {
      double* column = column_[k];
      whiten(column, 1, k);
      const double square = dot(column, column, n);
      taken_[k] = 1.0 / (1.0 + square);
      if (square > 0.0) {
        factor_[k] = (1.0 - std::sqrt(taken_[k])) / square;
        log_det -= 0.5 * std::log1p(square);
      }
      std::copy(column, column + n, weighted_[k]);
      apply_transpose(weighted_[k], 1, k);
    }
  }

  Row operator()(const Row& values) const {
    Row out = values;
    whiten(out.data(), 1, column_.rows);
    return out;
  }
  // Each of the M columns of `values`.
  void operator()(const Matrix& values, Matrix& out) const {
    out = values;
    whiten(out.value.data(), out.columns, column_.rows);
  }
  // The transpose of whitening: from V^(-1/2) x to V^(-1) x.
  void apply_transpose(Matrix& white) const {
    apply_transpose(white.value.data(), white.columns, column_.rows);
  }
  Row precision_weighted(Row white) const {
    apply_transpose(white.data(), 1, column_.rows);
    return white;
  }

  // Squared length of a whitened column.
  double square(const Column& shared_column) const {
    double sum = 0.0, before = 0.0;
    for (std::size_t i = 0; i < shared_column.value.size(); ++i) {
      const std::size_t reading = shared_column.first + i;
      const double value = shared_column.value[i] * inverse_[reading];
      const double white =
          lag_.empty() ? value : innovation_[reading] * (value - lag_[reading] * before);
      sum += white * white, before = value;
    }
    if (const std::size_t next = shared_column.first + shared_column.value.size();
        next < lag_.size()) {
      const double white = innovation_[next] * lag_[next] * before;
      sum += white * white;
    }
    for (int k = 0; k < weighted_.rows; ++k) {
      const double share = dot(shared_column.value.data(), weighted_[k] + shared_column.first,
                               shared_column.value.size());
      sum -= taken_[k] * share * share;
    }
    return std::max(sum, 0.0);
  }

  // Shared errors: how many there are; of the k-th, V^(-1) of those before it times its column; and
  // the factor of its outer product, which V^(-1) with it has less than without it.
  int shared() const { return column_.rows; }
  const double* weighted_error(int k) const { return weighted_[k]; }
  double taken(int k) const { return taken_[k]; }

  static double dot(const double* a, const double* b, std::size_t n) {
    double sum = 0.0;
    for (std::size_t i = 0; i < n; ++i) sum += a[i] * b[i];
    return sum;
  }

 private:
  // Takes white noise for a process of the first order along the body: a
  // reading's noise less its share of the neighbour's before it is white again.
  void correlate(const Frame& frame, double correlation) {
    if (correlation == 0.0) return;
    lag_.assign(frame.size(), 0.0), innovation_.assign(frame.size(), 1.0);
    for (int i = 1; i < frame.size(); ++i) {
      lag_[i] = std::pow(correlation, frame.rank[i] - frame.rank[i - 1]);
      innovation_[i] = 1.0 / std::sqrt(1.0 - lag_[i] * lag_[i]);
      log_det += std::log(innovation_[i]);
    }
  }
  // Take from each of the M columns of N by M values what the neighbour before
  // explains; and the transpose of that.
  void take_lags(double* values, int columns) const {
    for (int i = static_cast<int>(lag_.size()) - 1; i > 0; --i) {
      double *row = values + i * columns, *row_before = row - columns;
      for (int m = 0; m < columns; ++m)
        row[m] = innovation_[i] * (row[m] - lag_[i] * row_before[m]);
    }
  }
  void take_lags_transposed(double* values, int columns) const {
    for (int i = 0; i < static_cast<int>(lag_.size()); ++i) {
      double *row = values + i * columns, *row_before = row - columns;
      for (int m = 0; m < columns; ++m) {
        row[m] *= innovation_[i];
        if (i > 0) row_before[m] -= lag_[i] * row[m];
      }
    }
  }
  void scale(double* values, int columns) const {
    for (const double inverse : inverse_) {
      for (int m = 0; m < columns; ++m) *values++ *= inverse;
    }
  }
  // Take a share of a shared column out of each of the M columns of N by M values.
  void take(int k, double* values, int columns) const {
    const int n = static_cast<int>(inverse_.size());
    const double* column = column_[k];
    Row share(columns);
    for (int i = 0; i < n; ++i) {
      for (int m = 0; m < columns; ++m) share[m] += column[i] * values[i * columns + m];
    }
    for (int i = 0; i < n; ++i) {
      const double step = factor_[k] * column[i];
      for (int m = 0; m < columns; ++m) values[i * columns + m] -= step * share[m];
    }
  }
  // By the first `count` shared columns.
  void whiten(double* values, int columns, int count) const {
    scale(values, columns);
    take_lags(values, columns);
    for (int k = 0; k < count; ++k) take(k, values, columns);
  }
  void apply_transpose(double* values, int columns, int count) const {
    for (int k = count; k-- > 0;) take(k, values, columns);
    take_lags_transposed(values, columns);
    scale(values, columns);
  }

  Row inverse_;
  Row lag_, innovation_;  // of correlated noise; else empty
  Matrix column_;         // shared columns, each whitened by those before it
  Matrix weighted_;       // the same times V^(-1/2) of those before it
  Row factor_, taken_;
};

// Log of the sum of exponentials, which may be far apart.
inline double log_sum_exp(const Row& terms) {
  const double top = *std::max_element(terms.begin(), terms.end());
  if (terms.size() == 1 || !(top > -INFINITY)) return top;
  double sum = 0.0;
  for (const double value : terms) sum += std::exp(value - top);
  return top + std::log(sum);
}

// A frame whitened at each level of its noise.
struct Whitened {
  struct AtLevel {
    Level level;
    Whitener whitener;
    Row read, precision_weighted;  // V^(-1/2) and V^(-1) times the readings
    double square, log_density;    // of the readings, were the body free

    // What one more shared error c changes: V^(-1) loses an outer product. `scale`:
    // 1/sqrt(1 + c'V^(-1)c), by which products with c are multiplied; `projection`: that of the
    // readings, scaled; `gain`: what is added to their log density.
    struct Beside {
      double scale, projection, gain;
    };
    Beside beside(const Column& column) const {
      const double c = 1.0 + whitener.square(column), scale = 1.0 / std::sqrt(c);
      const double projection =
          scale * Whitener::dot(column.value.data(), precision_weighted.data() + column.first,
                                column.value.size());
      return {scale, projection, 0.5 * (projection * projection - std::log(c))};
    }
  };
  const Frame* frame;
  std::vector<AtLevel> levels;

  explicit Whitened(const Frame& whitened_frame) : frame(&whitened_frame) {
    levels.reserve(whitened_frame.levels.size());
    for (const Level& level : whitened_frame.levels) {
      AtLevel& whitened =
          levels.emplace_back(AtLevel{level, {whitened_frame, level}, {}, {}, 0.0, 0.0});
      whitened.read = whitened.whitener(whitened_frame.excess_by(level));
      whitened.precision_weighted = whitened.whitener.precision_weighted(whitened.read);
      whitened.square =
          Whitener::dot(whitened.read.data(), whitened.read.data(), whitened_frame.size());
      whitened.log_density = whitened.whitener.log_det - 0.5 * whitened.square;
    }
  }

  // A level that has the same noise and only errors as stated, beside which this one has further
  // shared errors and shifts; or -1.
  int base(std::size_t level) const {
    const Level& model = levels[level].level;
    if (model.row == 0 || frame->rows[model.row].correlation != frame->rows[0].correlation)
      return -1;
    for (int other = 0; other < static_cast<int>(level); ++other) {
      const Level& stated = levels[other].level;
      if (stated.row == 0 && stated.factor == model.factor) return other;
    }
    return -1;
  }

  // The level that suits a free body best.
  const AtLevel& likeliest() const {
    return *std::max_element(levels.begin(), levels.end(), [](const AtLevel& a, const AtLevel& b) {
      return a.log_density < b.log_density;
    });
  }

  // Log density of the readings of a free body.
  double log_density() const {
    Row densities;
    for (const AtLevel& whitened : levels) densities.push_back(whitened.log_density);
    return log_sum_exp(densities);
  }

  // Probability of each level of a free body.
  Row shares() const {
    Row out;
    const double all = log_density();
    for (const AtLevel& whitened : levels) out.push_back(std::exp(whitened.log_density - all));
    return out;
  }

  // The same log density, with each of the columns added by itself.
  Row log_densities(const std::vector<Column>& columns) const {
    Row out, densities(levels.size());
    for (const Column& column : columns) {
      std::transform(levels.begin(), levels.end(), densities.begin(), [&](const AtLevel& whitened) {
        return whitened.log_density + whitened.beside(column).gain;
      });
      out.push_back(log_sum_exp(densities));
    }
    return out;
  }
};

}  // namespace thigmo
