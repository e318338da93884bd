// Least misfit of readings by three columns for each of two contacts, with weights of zero or more.
//
// `search.h` calls this for bounds over boxes and for forces at given arcs. The 1-norm is a linear
// programme, solved by the simplex method with exact line searches; the 2-norm is a quadratic one,
// solved as a linear complementarity problem by Lemke's method (Cottle, Pang and Stone, The Linear
// Complementarity Problem, chapter 4). Both walk one tableau by the same exchange.
//
// What is returned as a bound is never the solver's word: it is the value of the dual at the
// multipliers that the solver ended with, and any multipliers give a valid bound.
#pragma once

#include <numeric>

#include "../shape.h"

namespace thigmo {

constexpr int kEach = 3, kColumns = 6;  // of one contact, of both
constexpr double kSmall = 1e-12;        // entries of a scaled tableau below this are zero
using Weights = std::array<double, kColumns>;

// Readings that take part, and what a weight of one adds to each. The weights of a contact add up
// to at most `limit`; none adds more than `most` to any reading.
struct Hull {
  double limit, most;
  Row reading{};
  std::array<Row, kColumns> column{};
};

struct SignedFit {
  double bound = 0.0;
  Weights weight{};
};

// Swap row variable p and column variable q of row = table (columns, 1).
inline void exchange(Matrix& table, int p, int q) {
  const double inverse = 1.0 / table[p][q];
  for (int k = 0; k < table.columns; ++k) table[p][k] *= -inverse;
  table[p][q] = inverse;
  for (int i = 0; i < table.rows; ++i) {
    const double factor = table[i][q];
    if (i == p || factor == 0.0) continue;
    table[i][q] = 0.0;
    for (int k = 0; k < table.columns; ++k) table[i][k] += factor * table[p][k];
  }
}

inline double product(const Row& a, const Row& b) {
  return std::inner_product(a.begin(), a.end(), b.begin(), 0.0);
}

// Sort by key, and find the place in `order` up to which the weights first add up to `need`; the
// end if they never do.
inline std::size_t crossing(std::vector<int>& order, const Row& key, const Row& weight,
                            double need) {
  std::sort(order.begin(), order.end(), [&](int a, int b) { return key[a] < key[b]; });
  std::size_t place = 0;
  while (place < order.size() && (need -= weight[order[place]]) > 0.0) ++place;
  return place;
}

// Factors that bring each column's largest entry to 1.
inline Weights column_scales(const Hull& of) {
  Weights scale;
  for (int r = 0; r < kColumns; ++r) {
    double largest = 0.0;
    for (const double entry : of.column[r]) largest = std::max(largest, std::abs(entry));
    scale[r] = largest > 0.0 ? 1.0 / largest : 1.0;
  }
  return scale;
}

// What multipliers of the residuals cost, by the limits.
inline double dual_penalty(const Hull& of, const Weights& scale, const Row& multiplier) {
  double total = 0.0;
  for (int first = 0; first < kColumns; first += kEach) {
    double worst = 0.0, each = 0.0;
    for (int r = first; r < first + kEach; ++r) {
      const double pull = std::max(product(of.column[r], multiplier), 0.0);
      worst = std::max(worst, pull), each += scale[r] * pull;
    }
    total += std::min(of.limit * worst, of.most * each);
  }
  return total;
}

// Weights of least sum |reading - weights x columns|, and a proven lower bound of that sum.
inline SignedFit fit_signed_l1(const Hull& of) {
  const int n = static_cast<int>(of.reading.size()), rows = n + 2;
  const Weights scale = column_scales(of);
  Matrix table(rows, kColumns + 1);
  Row side(rows), key(rows), amount(rows);
  // What stands in rows, then columns: residuals from 0, room up to limits, weights from n + 2.
  std::vector<int> name(rows + kColumns), order;
  std::iota(name.begin(), name.end(), 0);
  for (int i = 0; i < rows; ++i) {
    for (int r = 0; r < kColumns; ++r) {
      table[i][r] = scale[r] * (i < n ? -of.column[r][i] : r / kEach == i - n ? -1.0 : 0.0);
    }
    table[i][kColumns] = i < n ? of.reading[i] : of.limit;
    side[i] = table[i][kColumns] >= 0.0 ? 1.0 : -1.0;
  }
  Weights slope;
  for (int step = 0; step < 20 * rows; ++step) {
    // The column along which the sum falls fastest.
    int q = 0;
    double need = kSmall;
    for (int r = 0; r < kColumns; ++r) {
      slope[r] = 0.0;
      for (int i = 0; i < rows; ++i) {
        if (name[i] < n) slope[r] += side[i] * table[i][r];
      }
      // A residual that leaves 0 adds to the sum; a weight can only grow.
      const double fall = name[rows + r] < n ? std::abs(slope[r]) - 1.0 : -slope[r];
      if (fall > need) need = fall, q = r;
    }
    if (need == kSmall) break;
    const double way = slope[q] > 0.0 ? -1.0 : 1.0;
    order.clear();
    for (int i = 0; i < rows; ++i) {
      const double rate = way * table[i][q] * (name[i] < n ? side[i] : 1.0);
      if (rate >= -kSmall) continue;
      amount[i] = name[i] < n ? -2.0 * rate : INFINITY;
      key[i] = std::abs(table[i][kColumns]) / -rate;
      order.push_back(i);
    }
    const std::size_t last = crossing(order, key, amount, need);
    if (last == order.size()) break;
    for (std::size_t k = 0; k < last; ++k) side[order[k]] *= -1.0;
    const int p = order[last];
    exchange(table, p, q);
    side[p] = way;
    std::swap(name[p], name[rows + q]);
  }
  SignedFit fit;
  Row multiplier(n);  // of the residuals
  for (int r = 0; r < kColumns; ++r) {
    const int at = name[rows + r];
    if (at < n) multiplier[at] = std::clamp(-slope[r], -1.0, 1.0);
  }
  for (int i = 0; i < rows; ++i) {
    if (name[i] < n) {
      multiplier[name[i]] = side[i];
    } else if (name[i] >= rows) {
      const int r = name[i] - rows;
      fit.weight[r] = std::max(table[i][kColumns], 0.0) * scale[r];
    }
  }
  fit.bound = product(multiplier, of.reading) - dual_penalty(of, scale, multiplier);
  return fit;
}

constexpr int kConditions = kColumns + 2;

// Gradients and room up to the limits, against weights, multipliers, the covering variable.
inline Matrix complementarity(const Hull& of, const Weights& scale) {
  Matrix table(kConditions, kConditions + 2);
  for (int r = 0; r < kConditions; ++r) {
    table[r][kConditions] = 1.0;
    table[r][kConditions + 1] = r >= kColumns ? of.limit : 0.0;
  }
  for (int r = 0; r < kColumns; ++r) {
    const int room = kColumns + r / kEach;
    table[r][room] = scale[r], table[room][r] = -scale[r];
    table[r][kConditions + 1] = -scale[r] * product(of.column[r], of.reading);
    for (int k = 0; k < kColumns; ++k) {
      table[r][k] = scale[r] * scale[k] * product(of.column[r], of.column[k]);
    }
  }
  return table;
}

// Weights of least sum (reading - weights x columns)^2, and a proven lower bound of that sum.
inline SignedFit fit_signed_l2(const Hull& of) {
  constexpr int kCovering = kConditions, kLast = kConditions + 1, kSteps = 60;
  const Weights scale = column_scales(of);
  Matrix table = complementarity(of, scale);
  // In rows, then columns: weights and multipliers from 0, the covering variable, their partners.
  std::array<int, 2 * kConditions + 1> name;
  int p = 0;
  for (int r = 0; r <= 2 * kConditions; ++r) {
    name[r] = r < kConditions ? kCovering + 1 + r : r - kConditions;
    if (r < kConditions && table[r][kLast] < table[p][kLast]) p = r;
  }
  int q = kCovering;
  for (int step = 0; step < kSteps && (step > 0 || table[p][kLast] < 0.0); ++step) {
    exchange(table, p, q);
    const int left = name[p];
    std::swap(name[p], name[kConditions + q]);
    if (left == kCovering) break;
    const int partner = left > kCovering ? left - kCovering - 1 : left + kCovering + 1;
    const auto entering = std::find(name.begin() + kConditions, name.end(), partner);
    q = static_cast<int>(entering - name.begin()) - kConditions;
    double least = INFINITY;
    p = -1;
    for (int r = 0; r < kConditions; ++r) {
      if (table[r][q] >= -kSmall) continue;
      const double ratio = -table[r][kLast] / table[r][q];
      if (ratio < least || (ratio == least && name[r] == kCovering)) least = ratio, p = r;
    }
    if (p < 0) break;
  }
  SignedFit fit;
  for (int r = 0; r < kConditions; ++r) {
    if (name[r] < kColumns) {
      fit.weight[name[r]] = std::max(table[r][kLast], 0.0) * scale[name[r]];
    }
  }
  Row residual = of.reading;
  for (int r = 0; r < kColumns; ++r) {
    for (std::size_t i = 0; i < residual.size(); ++i) {
      residual[i] -= fit.weight[r] * of.column[r][i];
    }
  }
  fit.bound = 2.0 * product(residual, of.reading) - product(residual, residual) -
              2.0 * dual_penalty(of, scale, residual);
  return fit;
}

}  // namespace thigmo
