// Small dense vectors and linear systems.
#pragma once

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

namespace thigmo::mechanics {

// Largest size among values; not a number if one of them is not.
inline double largest(const std::vector<double>& values) {
  double most = 0.0;
  for (const double value : values) {
    if (std::isnan(value)) return value;
    most = std::max(most, std::fabs(value));
  }
  return most;
}

// Solves a x = b in place by Gauss elimination with row pivoting, for the n by n row-major `a`; `b`
// becomes x. Returns the sign of the determinant, 0 for a singular matrix.
inline int solve_linear(std::vector<double>& a, std::vector<double>& b, int n) {
  int sign = 1;
  for (int i = 0; i < n; ++i) {
    int pivot = i;
    for (int r = i + 1; r < n; ++r) {
      if (std::fabs(a[r * n + i]) > std::fabs(a[pivot * n + i])) pivot = r;
    }
    if (std::fabs(a[pivot * n + i]) < 1e-300) return 0;
    if (pivot != i) {
      sign = -sign;
      for (int c = 0; c < n; ++c) std::swap(a[i * n + c], a[pivot * n + c]);
      std::swap(b[i], b[pivot]);
    }
    if (a[i * n + i] < 0.0) sign = -sign;
    for (int r = i + 1; r < n; ++r) {
      const double factor = a[r * n + i] / a[i * n + i];
      for (int c = i; c < n; ++c) a[r * n + c] -= factor * a[i * n + c];
      b[r] -= factor * b[i];
    }
  }
  for (int i = n - 1; i >= 0; --i) {
    for (int c = i + 1; c < n; ++c) b[i] -= a[i * n + c] * b[c];
    b[i] /= a[i * n + i];
  }
  return sign;
}

}  // namespace thigmo::mechanics
