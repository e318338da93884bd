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

namespace thigmo {

using Row = std::vector<double>;

constexpr int kNodes = 107;
constexpr double kPoint = 1e-9;  // a span shorter than this is a point sensor
using Nodes = std::array<double, kNodes>;

// N by M numbers, one row for each sensor.
struct Matrix {
  int rows = 0, columns = 0;
  Row value;
  Matrix() = default;
  Matrix(int n, int m) : rows(n), columns(m), value(static_cast<std::size_t>(n) * m) {}
  double* operator[](int row) { return value.data() + static_cast<std::size_t>(row) * columns; }
  const double* operator[](int row) const {
    return value.data() + static_cast<std::size_t>(row) * columns;
  }
};

struct Point {
  double heading, x, y;
};

class Shape {
 public:
  // From the curvature at even nodes of a body of length one.
  explicit Shape(const Nodes& curvature) {
    const double half = 0.5 / (kNodes - 1);
    heading_[0] = x_[0] = y_[0] = sum_x_[0] = sum_y_[0] = 0.0;
    double c = 1.0, s = 0.0;
    for (int i = 1; i < kNodes; ++i) {
      heading_[i] = heading_[i - 1] + half * (curvature[i] + curvature[i - 1]);
      const double c_next = std::cos(heading_[i]), s_next = std::sin(heading_[i]);
      x_[i] = x_[i - 1] + half * (c + c_next);
      y_[i] = y_[i - 1] + half * (s + s_next);
      sum_x_[i] = sum_x_[i - 1] + half * (x_[i] + x_[i - 1]);
      sum_y_[i] = sum_y_[i - 1] + half * (y_[i] + y_[i - 1]);
      c = c_next, s = s_next;
    }
  }

  Point at(double arc) const {
    return {between(heading_, arc), between(x_, arc), between(y_, arc)};
  }

  // Mean over a span of the lever of a unit force at `arc`, turned by `turn` from the normal.
  double lever(const Point& point, double c, double s, double arc, double low, double high) const {
    if (arc <= low) return 0.0;
    const double own = point.x * c + point.y * s;
    if (high - low < kPoint) return own - between(x_, low) * c - between(y_, low) * s;
    const double end = std::min(high, arc);
    const double sum_x = between(sum_x_, end) - between(sum_x_, low);
    const double sum_y = between(sum_y_, end) - between(sum_y_, low);
    return (own * (end - low) - sum_x * c - sum_y * s) / (high - low);
  }

  // Largest lever between the base and `arc`.
  double largest(const Point& point, double c, double s, double arc) const {
    const double own = point.x * c + point.y * s;
    double most = std::abs(own);
    for (int k = 8; k < arc * (kNodes - 1); k += 8) {
      most = std::max(most, std::abs(own - x_[k] * c - y_[k] * s));
    }
    return most;
  }

  // Add the curvature that a force causes along the body.
  void add_moment(double arc, double force, double turn, Nodes& curvature) const {
    const Point point = at(arc);
    const double c = std::cos(point.heading + turn), s = std::sin(point.heading + turn);
    const double own = point.x * c + point.y * s;
    for (int k = 0; k < kNodes && k < arc * (kNodes - 1); ++k) {
      curvature[k] += force * (own - x_[k] * c - y_[k] * s);
    }
  }

 private:
  static double between(const Nodes& values, double arc) {
    const double u = arc * (kNodes - 1);
    const int i = std::min(static_cast<int>(u), kNodes - 2);
    return values[i] + (values[i + 1] - values[i]) * (u - i);
  }

  Nodes heading_, x_, y_, sum_x_, sum_y_;
};

// What unit forces at M places do: mean lever over each sensor, largest lever and that at the base.
struct Levers {
  Matrix sensor;  // (N, M)
  Row largest, base;
  Levers(int n, int m) : sensor(n, m), largest(m), base(m) {}
};

// Normal forces on a straight body.
inline void straight_levers(const Row& place, const Row& low, const Row& high, Levers& out) {
  const int count = static_cast<int>(place.size());
  out.largest = out.base = place;
  for (int i = 0; i < out.sensor.rows; ++i) {
    double* row = out.sensor[i];
    const double near = low[i], far = high[i], span = far - near;
    if (span < kPoint) {
      for (int m = 0; m < count; ++m) row[m] = std::max(place[m] - near, 0.0);
    } else {
      const double share = 0.5 / span;
      for (int m = 0; m < count; ++m) {
        const double a = std::max(place[m] - near, 0.0), b = std::max(place[m] - far, 0.0);
        row[m] = (a * a - b * b) * share;
      }
    }
  }
}

// Forces turned by `turn` from the normal of a bent body.
inline void bent_levers(const Shape& shape, const Row& place, const Row& low, const Row& high,
                        double turn, Levers& out) {
  for (int m = 0; m < static_cast<int>(place.size()); ++m) {
    const Point point = shape.at(place[m]);
    const double c = std::cos(point.heading + turn), s = std::sin(point.heading + turn);
    out.base[m] = point.x * c + point.y * s;
    out.largest[m] = shape.largest(point, c, s, place[m]);
    for (int i = 0; i < out.sensor.rows; ++i) {
      out.sensor[i][m] = shape.lever(point, c, s, place[m], low[i], high[i]);
    }
  }
}

}  // namespace thigmo
