// Global 2-norm fit of one contact: the stationary points of its profile in every cell.
//
// For a fixed arc the best force leaves sum y^2 - B^2 / C with B the sum of reading x lever and C
// that of lever^2. Between ends of spans B is a quadratic and C a quartic of the arc, so the
// profile is stationary where 2 B' C - B C' = 0: a quartic, the fifth powers cancel. All its roots
// and the ends of the cell are tried.
#pragma once

#include "levers.h"

namespace thigmo {

// Write where a polynomial changes sign between `near` and 1, ascending; returns how many. It is
// monotonous between the sign changes of its derivative.
template <std::size_t Size>
int sign_changes(const Polynomial<Size>& of, double near, std::array<double, 4>& found) {
  constexpr int kHalvings = 60;
  const int turns = sign_changes(of.derivative(), near, found);
  int count = 0;
  for (int k = 0; k <= turns; ++k) {
    double a = near, b = k < turns ? found[k] : 1.0;
    near = b;
    const bool rising = of(b) > 0.0;
    if (rising == (of(a) > 0.0)) continue;
    for (int halving = 0; halving < kHalvings; ++halving) {
      const double t = 0.5 * (a + b);
      ((of(t) > 0.0) == rising ? b : a) = t;
    }
    // At most as many roots as turns were passed: none is overwritten unread.
    found[count++] = 0.5 * (a + b);
  }
  return count;
}
inline int sign_changes(const Polynomial<1>&, double, std::array<double, 4>&) { return 0; }

inline PointFit fit_one_l2(const Excess& frame) {
  double rest = 0.0, most = 0.0, arc = 1.0, force = 0.0;
  for (const double value : frame.value) rest += value * value;
  const Row edges = cell_edges(frame);
  for (std::size_t e = 0; e + 1 < edges.size(); ++e) {
    const double start = edges[e], width = edges[e + 1] - start, middle = start + 0.5 * width;
    Quadratic explained;
    Polynomial<5> square;
    for (int i = 0; i < frame.size(); ++i) {
      const Quadratic own = lever_near(middle, frame.low[i], frame.high[i], start, width);
      explained.add(frame.value[i], own);
      square.add(1.0, own * own);
    }
    const Polynomial<6> slope =
        (explained.derivative() * square).add(-0.5, explained * square.derivative());
    Polynomial<5> quartic;
    std::copy_n(slope.c.begin(), 5, quartic.c.begin());
    std::array<double, 4> roots;
    const auto consider = [&](double t) {
      const double top = explained(t), bottom = square(t);
      // Of places that only rounding tells apart, the first.
      if (bottom > 0.0 && top * top / bottom > most + kRounding * rest) {
        most = top * top / bottom, arc = start + t * width, force = top / bottom;
      }
    };
    consider(1.0);  // before the near end: a force next to the base is endless
    consider(kInnerEnd);
    std::for_each_n(roots.begin(), sign_changes(quartic, kInnerEnd, roots), consider);
  }
  return {std::max(rest - most, 0.0), 0.0, {arc}, {force}, {{{arc, arc}}}};
}

}  // namespace thigmo
