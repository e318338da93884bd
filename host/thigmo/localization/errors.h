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

// What the white noise may be: a factor of that stated, and its log odds.
struct Level {
  double factor, log_odds;
};

// One frame, normalised by the length.
struct Frame {
  Row excess;     // (N,) readings above the free ones
  Row low, high;  // (N,) ends of the sensors on the body
  Row noise;      // (N,) standard deviation of white noise, or its share where that is unknown
  Row gain;       // (N,) standard deviation of a reading's gain error
  Matrix shared;  // (K, N) effect of each shared error of one standard deviation
  std::vector<Level> levels;  // of the noise; their odds sum to one
  Nodes rest;                 // curvature of the free body
  bool straight;              // whether that is zero
  int size() const { return static_cast<int>(excess.size()); }
};

// Shared columns of a frame with more of them below.
inline Matrix stacked(const Matrix& shared, const Matrix& more) {
  if (more.rows == 0) return shared;
  Matrix both(shared.rows + more.rows, more.columns);
  std::copy(shared.value.begin(), shared.value.end(), both.value.begin());
  std::copy(more.value.begin(), more.value.end(), both.value.begin() + shared.value.size());
  return both;
}

class Whitener {
 public:
  double log_det;  // of V^(-1/2), of N standard normal densities, and of the noise's odds

  Whitener(const Frame& frame, const Level& level, const Matrix& shared)
      : log_det(level.log_odds - 0.5 * frame.size() * std::log(2.0 * std::numbers::pi)),
        inverse_(frame.size()),
        column_(shared),
        factor_(shared.rows) {
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
    for (int k = 0; k < shared.rows; ++k) {
      double* own = column_[k];
      for (int i = 0; i < n; ++i) own[i] *= inverse_[i];
      for (int j = 0; j < k; ++j) take(column_[j], factor_[j], own);
      const double square = dot(own, own, n);
      if (square > 0.0) {
        factor_[k] = (1.0 - 1.0 / std::sqrt(1.0 + square)) / square;
        log_det -= 0.5 * std::log1p(square);
      }
    }
  }

  Row operator()(const double* values) const {
    const int n = static_cast<int>(inverse_.size());
    Row out(n);
    for (int i = 0; i < n; ++i) out[i] = values[i] * inverse_[i];
    for (int k = 0; k < column_.rows; ++k) take(column_[k], factor_[k], out.data());
    return out;
  }

  // One column, where independent errors leave it zero outside of a few readings only those.
  struct Column {
    int from, count;
    Row value;  // (count,)
  };
  Column column(const double* values) const {
    const int n = static_cast<int>(inverse_.size());
    if (column_.rows > 0) return {0, n, (*this)(values)};
    int from = 0, to = n;
    while (from < n && values[from] == 0.0) ++from;
    while (to > from && values[to - 1] == 0.0) --to;
    Column out{from, to - from, Row(values + from, values + to)};
    for (int i = 0; i < out.count; ++i) out.value[i] *= inverse_[from + i];
    return out;
  }

  // Each of the M columns of `values`.
  void operator()(const Matrix& values, Matrix& out) const {
    const int n = values.rows, count = values.columns;
    for (int i = 0; i < n; ++i) {
      const double* from = values[i];
      double* to = out[i];
      for (int m = 0; m < count; ++m) to[m] = from[m] * inverse_[i];
    }
    Row share(count);
    for (int k = 0; k < column_.rows; ++k) {
      std::fill(share.begin(), share.end(), 0.0);
      for (int i = 0; i < n; ++i) {
        const double* row = out[i];
        for (int m = 0; m < count; ++m) share[m] += column_[k][i] * row[m];
      }
      for (int i = 0; i < n; ++i) {
        const double step = factor_[k] * column_[k][i];
        double* row = out[i];
        for (int m = 0; m < count; ++m) row[m] -= step * share[m];
      }
    }
  }

  static double dot(const double* a, const double* b, int n) {
    double sum = 0.0;
    for (int i = 0; i < n; ++i) sum += a[i] * b[i];
    return sum;
  }

 private:
  static void take(const double* column, double factor, double* of, int n) {
    const double step = factor * dot(column, of, n);
    for (int i = 0; i < n; ++i) of[i] -= step * column[i];
  }
  void take(const double* column, double factor, double* of) const {
    take(column, factor, of, static_cast<int>(inverse_.size()));
  }

  Row inverse_;
  Matrix column_;
  Row factor_;
};

// Log of the sum of exponentials, which may be far apart.
inline double log_sum_exp(const Row& values) {
  const double top = *std::max_element(values.begin(), values.end());
  if (!(top > -INFINITY)) return -INFINITY;
  double sum = 0.0;
  for (const double value : values) sum += std::exp(value - top);
  return top + std::log(sum);
}

// Log density of the readings of a free body whose errors have these shared columns.
inline double log_density(const Frame& frame, const Matrix& shared) {
  Row each;
  for (const Level& level : frame.levels) {
    const Whitener white(frame, level, shared);
    const Row read = white(frame.excess.data());
    each.push_back(white.log_det - 0.5 * Whitener::dot(read.data(), read.data(), frame.size()));
  }
  return log_sum_exp(each);
}

// The same, with each column of `extra` (E, N), in units of its deviation, added by itself.
inline Row log_densities(const Frame& frame, const Matrix& extra) {
  const int n = frame.size();
  std::vector<Row> each(extra.rows);
  for (const Level& level : frame.levels) {
    const Whitener white(frame, level, frame.shared);
    const Row read = white(frame.excess.data());
    const double plain = white.log_det - 0.5 * Whitener::dot(read.data(), read.data(), n);
    for (int e = 0; e < extra.rows; ++e) {
      const auto [from, count, column] = white.column(extra[e]);
      const double c = 1.0 + Whitener::dot(column.data(), column.data(), count);
      const double told = Whitener::dot(column.data(), read.data() + from, count);
      each[e].push_back(plain + 0.5 * told * told / c - 0.5 * std::log(c));
    }
  }
  Row out;
  for (const Row& values : each) out.push_back(log_sum_exp(values));
  return out;
}

// Squared whitened residual of a free body at the likeliest factor of the noise, and that factor.
inline std::pair<double, double> free_misfit(const Frame& frame) {
  double best = -INFINITY, misfit = 0.0, factor = 1.0;
  for (const Level& level : frame.levels) {
    const Whitener white(frame, level, frame.shared);
    const Row read = white(frame.excess.data());
    const double square = Whitener::dot(read.data(), read.data(), frame.size());
    if (white.log_det - 0.5 * square > best) {
      best = white.log_det - 0.5 * square;
      misfit = square, factor = level.factor;
    }
  }
  return {misfit, factor};
}

}  // namespace thigmo
