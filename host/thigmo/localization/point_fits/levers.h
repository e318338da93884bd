// Levers as polynomials of a contact's arc, and the readings that point fits explain by them.
//
// A normal force at arc a on a straight body bends a sensor from `low` to `high` by its lever: 0 up
// to `low`, (a - low)^2 / (2 span) inside the span and a - (low + high) / 2 beyond it. Between two
// neighbouring ends of spans every lever is therefore one quadratic.
#pragma once

#include <numeric>

#include "../shape.h"

namespace thigmo {

// Readings above the free ones in units of the largest, and the ends of their sensors.
struct Excess {
  Row value, low, high;
  int size() const { return static_cast<int>(value.size()); }
};

using Ranges = std::vector<std::pair<double, double>>;

// The global fit of one frame. `gap` is how far its proven lower bound lies below the objective;
// `optimum_set` holds, by contact, the ranges of its arc on which the minimum is attained.
struct PointFit {
  double objective, gap;
  Row arc, force;
  std::vector<Ranges> optimum_set;
};

constexpr double kTolerance = 1e-9;  // of the objective without contact: less counts as equal
constexpr double kInnerEnd = 1e-9;   // a cell is open at its near end, as the base has no lever
constexpr double kRounding = 1e-13;  // what is less, as a share of its terms, is zero

// c[0] + c[1] t + c[2] t^2 + ...
template <std::size_t Size>
struct Polynomial {
  std::array<double, Size> c{};

  double operator()(double t) const {
    double total = 0.0;
    for (std::size_t k = Size; k-- > 0;) total = total * t + c[k];
    return total;
  }
  Polynomial& add(double factor, const Polynomial& other) {
    for (std::size_t k = 0; k < Size; ++k) c[k] += factor * other.c[k];
    return *this;
  }
  Polynomial<Size - 1> derivative() const {
    Polynomial<Size - 1> out;
    for (std::size_t k = 1; k < Size; ++k) out.c[k - 1] = static_cast<double>(k) * c[k];
    return out;
  }
};
using Quadratic = Polynomial<3>;

template <std::size_t A, std::size_t B>
Polynomial<A + B - 1> operator*(const Polynomial<A>& a, const Polynomial<B>& b) {
  Polynomial<A + B - 1> out;
  for (std::size_t i = 0; i < A; ++i) {
    for (std::size_t j = 0; j < B; ++j) out.c[i + j] += a.c[i] * b.c[j];
  }
  return out;
}

// Both roots; NaN or infinite for one that is not there or not real.
inline std::array<double, 2> real_roots(const Quadratic& of) {
  const auto& [c0, c1, c2] = of.c;
  const double discriminant = c1 * c1 - 4.0 * c0 * c2;
  if (discriminant < 0.0) return {NAN, NAN};
  const double q = -0.5 * (c1 + std::copysign(std::sqrt(discriminant), c1));
  return {q / c2, c0 / q};
}

// Lever of a contact near `middle`, by its arc beyond `start` in units of `width`.
inline Quadratic lever_near(double middle, double low, double high, double start, double width) {
  if (middle >= high) return {start - 0.5 * (low + high), width};
  if (middle <= low) return {};
  const double reach = start - low, share = 0.5 / (high - low);
  return {reach * reach * share, 2.0 * reach * share * width, share * width * width};
}

inline double lever(double arc, double low, double high) {
  return lever_near(arc, low, high, arc, 0.0).c[0];
}

// Ends of spans and of the body, ascending: between two neighbours no lever changes its form.
inline Row cell_edges(const Excess& frame) {
  Row edges{0.0, 1.0};
  edges.insert(edges.end(), frame.low.begin(), frame.low.end());
  edges.insert(edges.end(), frame.high.begin(), frame.high.end());
  std::sort(edges.begin(), edges.end());
  edges.erase(std::unique(edges.begin(), edges.end()), edges.end());
  return edges;
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

}  // namespace thigmo
