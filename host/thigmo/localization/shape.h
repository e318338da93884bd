// The body's shape and the levers of forces on it, straight or bent.
//
// A unit force at arc a bends the body at s by its lever: the component, along the force, of the
// way from the point at s to the point at a. A normal force turns with the body, so its lever is
// the integral from s to a of cos(theta(u) - theta(a)); on a straight body that is a - s. A sensor
// reads the mean of the curvature over its span. Such means are differences of integrals of the
// shape, kept at nodes, so a sensor costs the same whatever its span. Arcs are fractions of the
// everted length, curvature is times the length.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "vector_lanes.h"

namespace thigmo {

using Vector = std::array<double, 3>;

constexpr int kNodes = 107;
constexpr double kPoint = 1e-9;  // a span shorter than this is a point sensor
using Nodes = std::array<double, kNodes>;

// N by M numbers, one row for each sensor.
struct Matrix {
  int rows = 0, columns = 0;
  Row value;
  Matrix() = default;
  Matrix(int n, int m) : rows(n), columns(m), value(static_cast<std::size_t>(n) * m) {}
  // Contents are undefined afterwards.
  void resize(int n, int m) {
    rows = n, columns = m;
    value.resize(static_cast<std::size_t>(n) * m);
  }
  double* operator[](int row) { return value.data() + static_cast<std::size_t>(row) * columns; }
  const double* operator[](int row) const {
    return value.data() + static_cast<std::size_t>(row) * columns;
  }
};

// A point of the body: the integrals up to there, and the cosine and sine of its heading.
struct Point {
  double arc, x, y, sum_x, sum_y, c, s;
  // The same point for a force along the body instead of across it.
  Point turned() const { return {arc, x, y, sum_x, sum_y, -s, c}; }
};

class Shape {
 public:
  // From the curvature at even nodes of a body of length one.
  explicit Shape(const Row& curvature) {
    const double half = 0.5 / (kNodes - 1);
    double heading = 0.0;
    c_[0] = 1.0, s_[0] = x_[0] = y_[0] = sum_x_[0] = sum_y_[0] = 0.0;
    for (int i = 1; i < kNodes; ++i) {
      heading += half * (curvature[i] + curvature[i - 1]);
      c_[i] = std::cos(heading), s_[i] = std::sin(heading);
      x_[i] = x_[i - 1] + half * (c_[i - 1] + c_[i]);
      y_[i] = y_[i - 1] + half * (s_[i - 1] + s_[i]);
      sum_x_[i] = sum_x_[i - 1] + half * (x_[i] + x_[i - 1]);
      sum_y_[i] = sum_y_[i - 1] + half * (y_[i] + y_[i - 1]);
    }
  }

  Point at(double arc) const {
    const double u = arc * (kNodes - 1);
    const int i = std::min(static_cast<int>(u), kNodes - 2);
    const double share = u - i;
    const auto between = [&](const Nodes& values) {
      return values[i] + (values[i + 1] - values[i]) * share;
    };
    return {arc,         between(x_), between(y_), between(sum_x_), between(sum_y_),
            between(c_), between(s_)};
  }

  // Raises `most` to the largest lever that each of M forces has along the body. `lever_at_base`:
  // their levers at the base.
  void raise_to_largest(int count, const double* __restrict arc, const double* __restrict c,
                        const double* __restrict s, const double* __restrict lever_at_base,
                        double* __restrict most) const {
    for (int k = 8; k < kNodes; k += 8) {
      for (int m = 0; m < count; ++m) {
        const double lever = std::abs(lever_at_base[m] - x_[k] * c[m] - y_[k] * s[m]);
        most[m] = k < arc[m] * (kNodes - 1) && lever > most[m] ? lever : most[m];
      }
    }
  }

  // Add the curvature that a force at `point` causes along the body.
  void add_moment(const Point& point, double force, Row& curvature) const {
    const double lever_at_base = point.x * point.c + point.y * point.s;
    const int end = std::min(static_cast<int>(std::ceil(point.arc * (kNodes - 1))), kNodes);
    for (int k = 0; k < end; ++k) {
      curvature[k] += force * (lever_at_base - x_[k] * point.c - y_[k] * point.s);
    }
  }

 private:
  Nodes c_, s_, x_, y_, sum_x_, sum_y_;
};

// Levers of unit forces at M places: the mean over each sensor, the largest, and that at the base.
struct Levers {
  Matrix sensor;  // (N, M)
  Row largest, base;
  Levers(int n, int m) : sensor(n, m), largest(m), base(m) {}
};

// Normal forces on a straight body.
inline void straight_levers(const Row& place, const Row& low, const Row& high, Levers& out) {
  const int count = static_cast<int>(place.size());
  out.largest = out.base = place;
  const double* arc = place.data();
  const auto beyond = [](double arc, double end) { return arc > end ? arc - end : 0.0; };
  for (int i = 0; i < out.sensor.rows; ++i) {
    double* row = out.sensor[i];
    const double near = low[i], far = high[i], span = far - near;
    if (span < kPoint) {
      for (int m = 0; m < count; ++m) row[m] = beyond(arc[m], near);
    } else {
      const double share = 0.5 / span;
      for (int m = 0; m < count; ++m) {
        const double a = beyond(arc[m], near), b = beyond(arc[m], far);
        row[m] = (a * a - b * b) * share;
      }
    }
  }
}

// Forces across a bent body, or along it.
inline void bent_levers(const Shape& shape, const Row& place, const Row& low, const Row& high,
                        Levers& out, bool along = false) {
  const int count = static_cast<int>(place.size());
  Matrix columns(5, count);
  double *arc = columns[0], *sum_x = columns[1], *sum_y = columns[2], *c = columns[3],
         *s = columns[4];
  for (int m = 0; m < count; ++m) {
    const Point point = along ? shape.at(place[m]).turned() : shape.at(place[m]);
    arc[m] = point.arc, sum_x[m] = point.sum_x, sum_y[m] = point.sum_y;
    c[m] = point.c, s[m] = point.s;
    out.base[m] = point.x * point.c + point.y * point.s;
    out.largest[m] = std::abs(out.base[m]);
  }
  const double* lever_at_base = out.base.data();
  shape.raise_to_largest(count, arc, c, s, lever_at_base, out.largest.data());
  for (int i = 0; i < out.sensor.rows; ++i) {
    const Point near = shape.at(low[i]), far = shape.at(high[i]);
    const double span = far.arc - near.arc;
    double* __restrict row = out.sensor[i];
    for (int m = 0; m < count; ++m) {
      const bool inside = arc[m] < far.arc;
      const double x = (inside ? sum_x[m] : far.sum_x) - near.sum_x;
      const double y = (inside ? sum_y[m] : far.sum_y) - near.sum_y;
      const double reach = (inside ? arc[m] : far.arc) - near.arc;
      const double mean = span < kPoint ? lever_at_base[m] - near.x * c[m] - near.y * s[m]
                                        : (lever_at_base[m] * reach - x * c[m] - y * s[m]) / span;
      row[m] = arc[m] > near.arc ? mean : 0.0;
    }
  }
}

}  // namespace thigmo
