// Global 1-norm fit of one contact, by enumeration of the pieces of its profile.
//
// For a fixed arc the best force is a weighted median of reading / lever, so the profile J(a), the
// misfit with the best force, is made of pieces: along one of them the median stays with one sensor
// and no residual changes sign. There J is a quotient of two quadratics, so its minimum and the
// arcs where it stays below a level are closed forms. A piece is found from an arc inside it. It
// ends where another residual vanishes together with the median's, or where the weights of the
// others pull the median away: roots of quadratics. That a piece holds its median is checked in its
// middle.
#pragma once

#include "levers.h"

namespace thigmo {

// J = top / bottom between two arcs, which are measured from the start of a cell.
struct Piece {
  double start, near, far;
  Quadratic top{}, bottom{};
  double lowest = 0.0, least = 0.0;  // where J is least, and how low it is

  double at(double t) const { return top(t) / bottom(t); }

  // Cut at the real roots of a quadratic that are next to an arc inside.
  void cut(const Quadratic& quadratic, double inside) {
    for (const double t : real_roots(quadratic)) {
      if (near < t && t <= inside) {
        near = t;
      } else if (inside < t && t < far) {
        far = t;
      }
    }
  }

  void find_lowest() {
    lowest = near, least = at(near);
    // The cubic term of the slope's numerator cancels.
    const Polynomial<4> slope = (top.derivative() * bottom).add(-1.0, top * bottom.derivative());
    const auto [first, second] = real_roots({slope.c[0], slope.c[1], slope.c[2]});
    for (const double t : {first, second, far}) {
      if (near < t && t <= far && at(t) < least) lowest = t, least = at(t);
    }
  }

  // Add the parts where J is at most `level` to ascending ranges.
  void add_low_parts(double level, Ranges& ranges) const {
    constexpr double kTouching = 2.0 * kInnerEnd;  // ranges no further apart are one
    const auto add = [&](double a, double b) {
      if (ranges.empty() || start + a > ranges.back().second + kTouching) {
        ranges.emplace_back(start + a, start + b);
      } else {
        ranges.back().second = std::max(start + b, ranges.back().second);
      }
    };
    std::array<double, 2> roots = real_roots(Quadratic(top).add(-level, bottom));
    for (double& t : roots) t = near < t && t < far ? t : far;
    double from = near;
    bool found = false;
    for (const double to : {std::min(roots[0], roots[1]), std::max(roots[0], roots[1]), far}) {
      if (to > from && at(0.5 * (from + to)) <= level) {
        add(from, to);
        found = true;
      }
      from = to;
    }
    if (!found) add(lowest, lowest);  // too narrow to tell
  }
};

class ProfileL1 {
 public:
  double rest = 0.0, best;    // least misfit without contact, and with one
  std::vector<Piece> pieces;  // ascending; those of cells that cannot hold the optimum are left out

  explicit ProfileL1(const Excess& frame) : weight_(frame.size()), key_(frame.size()) {
    for (const double value : frame.value) rest += std::abs(value);
    best = rest;
    const Row edges = cell_edges(frame);
    for (std::size_t e = edges.size() - 1; e > 0; --e) add_cell(frame, edges[e - 1], edges[e]);
    std::sort(pieces.begin(), pieces.end(),
              [](const Piece& a, const Piece& b) { return a.start + a.near < b.start + b.near; });
  }

  // Misfit up to which an arc counts as optimal.
  double level() const { return best + kTolerance * rest; }

  // The force that is best at an arc.
  double force(const Excess& frame, double arc) {
    value_ = frame.value;
    lever_.clear();
    for (int i = 0; i < frame.size(); ++i) {
      lever_.push_back({lever(arc, frame.low[i], frame.high[i])});
    }
    const int i = median(0.0);
    return lever_[i].c[0] > 0.0 ? value_[i] / lever_[i].c[0] : 0.0;
  }

 private:
  void add_cell(const Excess& frame, double start, double end) {
    const double middle = 0.5 * (start + end);
    value_.clear(), lever_.clear();
    beyond_ = 0.0;
    for (int i = 0; i < frame.size(); ++i) {
      if (frame.low[i] >= middle) {
        beyond_ += std::abs(frame.value[i]);
        continue;
      }
      value_.push_back(frame.value[i]);
      lever_.push_back(lever_near(middle, frame.low[i], frame.high[i], start, 1.0));
    }
    const double width = end - start;
    if (!lever_.empty() && beyond_ <= level()) add_pieces({start, kInnerEnd * width, width});
  }

  // Add all pieces between two arcs.
  void add_pieces(const Piece& between) {
    constexpr double kNarrow = 1e-13;  // narrower ones are left out; J is continuous
    if (between.far - between.near <= kNarrow) return;
    Piece piece = between;
    const bool found = describe(piece);
    if (!found) piece.near = piece.far = 0.5 * (between.near + between.far);
    add_pieces({between.start, between.near, piece.near});
    if (found) {
      piece.find_lowest();
      best = std::min(best, piece.least);
      pieces.push_back(piece);
    }
    add_pieces({between.start, piece.far, between.far});
  }

  // Narrow a piece to that around its middle; false if its median does not hold there.
  bool describe(Piece& piece) {
    double middle = 0.5 * (piece.near + piece.far);
    const int i = median(middle), count = static_cast<int>(lever_.size());
    const Quadratic own = lever_[i];
    const auto residual = [&](int j) {  // times `own`
      return Quadratic{}.add(value_[j], own).add(-value_[i], lever_[j]);
    };
    for (int j = 0; j < count; ++j) {
      if (j != i) piece.cut(residual(j), middle);
    }
    middle = 0.5 * (piece.near + piece.far);
    // The others pull at the force; the median's sensor, and ties with it, can hold it.
    Quadratic pull, hold = own;
    piece.top = Quadratic{}.add(beyond_, own);
    piece.bottom = own;
    for (int j = 0; j < count; ++j) {
      if (j == i) continue;
      const double a = value_[j] * own(middle), b = value_[i] * lever_[j](middle);
      if (std::abs(a - b) <= kRounding * (std::abs(a) + std::abs(b))) {
        hold.add(1.0, lever_[j]);
      } else {
        const double sign = a > b ? 1.0 : -1.0;
        pull.add(sign, lever_[j]);
        piece.top.add(sign, residual(j));
      }
    }
    bool held = true;
    for (const double way : {-1.0, 1.0}) {
      const Quadratic left = Quadratic(hold).add(way, pull);
      held = held && left(middle) >= -1e-9 * hold(middle);
      piece.cut(left, middle);
    }
    return held;
  }

  // The sensor whose residual vanishes for the best force at t.
  int median(double t) {
    const int count = static_cast<int>(lever_.size());
    double total = 0.0;
    order_.resize(count);
    for (int j = 0; j < count; ++j) {
      weight_[j] = lever_[j](t);
      key_[j] = weight_[j] > 0.0 ? value_[j] / weight_[j] : 0.0;
      order_[j] = j;
      total += weight_[j];
    }
    const std::size_t place = crossing(order_, key_, weight_, 0.5 * total);
    return order_[std::min(place, order_.size() - 1)];
  }

  double beyond_ = 0.0;  // misfit of the sensors that no contact in the cell reaches
  Row value_;            // readings of the others
  std::vector<Quadratic> lever_;
  Row weight_, key_;
  std::vector<int> order_;
};

inline PointFit fit_one_l1(const Excess& frame) {
  ProfileL1 profile(frame);
  const double level = profile.level();
  Ranges ranges;
  if (profile.rest <= level) ranges.emplace_back(0.0, 1.0);
  for (const Piece& piece : profile.pieces) {
    if (profile.rest > level && piece.least <= level) piece.add_low_parts(level, ranges);
  }
  const auto [near, far] = *std::max_element(
      ranges.begin(), ranges.end(),
      [](const auto& a, const auto& b) { return a.second - a.first < b.second - b.first; });
  const double arc = 0.5 * (near + far);
  return {profile.best, 0.0, {arc}, {profile.force(frame, arc)}, {ranges}};
}

}  // namespace thigmo
