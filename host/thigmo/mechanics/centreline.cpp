#include "centreline.h"

#include <algorithm>
#include <cmath>

namespace thigmo::mechanics {

double Fold::turn(double s) const {
  return angle == 0.0 ? 0.0 : angle * std::clamp(s, 0.0, width) / width;
}

Skin skin_at(double place, double length, double tube_radius, double peg_radius) {
  if (place <= length) {
    return {std::max(place, 0.0), -tube_radius, 0.0, -1.0, Kind::kRightSide};
  }
  double beyond = place - length;
  const double quarter = 0.5 * M_PI * peg_radius;
  if (beyond < quarter) {
    const double angle = beyond / peg_radius;
    return {length, -tube_radius, std::sin(angle), -std::cos(angle), Kind::kRightCorner};
  }
  beyond -= quarter;
  if (beyond <= 2.0 * tube_radius) {
    return {length, beyond - tube_radius, 1.0, 0.0, Kind::kFace};
  }
  beyond -= 2.0 * tube_radius;
  if (beyond < quarter) {
    const double angle = beyond / peg_radius;
    return {length, tube_radius, std::cos(angle), std::sin(angle), Kind::kLeftCorner};
  }
  return {std::max(length - (beyond - quarter), 0.0), tube_radius, 0.0, 1.0, Kind::kLeftSide};
}

double perimeter(double length, double tube_radius, double peg_radius) {
  return 2.0 * length + M_PI * peg_radius + 2.0 * tube_radius;
}

double Centreline::heading_in(int cell, double s) const {
  const Node& a = nodes[cell];
  const Node& b = nodes[cell + 1];
  const double width = b.s - a.s;
  if (width <= 0.0) return a.heading;
  // Hermite's polynomial; the fold's turn is linear and is added apart.
  const double from = a.heading - fold.turn(a.s);
  const double to = b.heading - fold.turn(b.s);
  const double u = (s - a.s) / width;
  const double v = 1.0 - u;
  return fold.turn(s) + from * (1.0 + 2.0 * u) * v * v + to * (1.0 + 2.0 * v) * u * u +
         width * u * v * (a.curvature * v - b.curvature * u);
}

Pose Centreline::pose(double s) const {
  const Node* after = std::upper_bound(nodes + 1, nodes + count - 1, s,
                                       [](double arc, const Node& node) { return arc < node.s; });
  const Node& near = after[-1];
  const int cell = static_cast<int>(&near - nodes);
  const double step = s - near.s;
  const double heading = heading_in(cell, s);
  const double middle = heading_in(cell, near.s + 0.5 * step);
  // Simpson's rule.
  const double x =
      near.x + step / 6.0 * (std::cos(near.heading) + 4.0 * std::cos(middle) + std::cos(heading));
  const double y =
      near.y + step / 6.0 * (std::sin(near.heading) + 4.0 * std::sin(middle) + std::sin(heading));
  return {x, y, heading};
}

double Centreline::mean(double center, double span) const {
  double low = std::max(center - 0.5 * span, 0.0);
  double high = std::min(center + 0.5 * span, length());
  if (span <= 0.0) {
    low = std::max(std::min(center - 5e-4, length() - 1e-3), 0.0);
    high = low + 1e-3;
  }
  if (high - low < 1e-9) return 0.0;
  return (pose(high).heading - pose(low).heading) / (high - low);
}

Gap Centreline::gap_to(const Peg& peg, double tube_radius) const {
  const double around = perimeter(length(), tube_radius, peg.radius);
  Gap best{1e30, 0.0};
  const auto consider = [&best](double distance, double place) {
    if (distance < best.distance) best = {distance, place};
  };
  double ahead_before = 0.0;
  for (int i = 0; i < count; ++i) {
    const double c = std::cos(nodes[i].heading);
    const double d = std::sin(nodes[i].heading);
    const double dx = peg.x - nodes[i].x;
    const double dy = peg.y - nodes[i].y;
    const double ahead = dx * c + dy * d;
    if (i > 0 && ahead_before >= 0.0 && ahead < 0.0) {
      // The foot of the perpendicular lies in this cell: Newton on (peg - r) . t = 0.
      const Node& a = nodes[i - 1];
      const Node& b = nodes[i];
      double s = a.s + (b.s - a.s) * ahead_before / (ahead_before - ahead);
      double left = 0.0;
      for (int k = 0; k < 4; ++k) {
        const Pose at = pose(s);
        const double ct = std::cos(at.heading);
        const double st = std::sin(at.heading);
        const double miss = (peg.x - at.x) * ct + (peg.y - at.y) * st;
        left = (peg.y - at.y) * ct - (peg.x - at.x) * st;
        double curvature = a.curvature + (b.curvature - a.curvature) * (s - a.s) / (b.s - a.s);
        if (s < fold.width) curvature += fold.angle / fold.width;
        s = std::clamp(s + miss / std::max(1.0 - curvature * left, 0.1), a.s, b.s);
        if (std::fabs(miss) < 1e-12) break;
      }
      consider(std::fabs(left) - tube_radius - peg.radius, left < 0.0 ? s : around - s);
    }
    if (i == count - 1 && ahead >= 0.0) {
      const double left = dy * c - dx * d;
      const double over = std::fabs(left) - tube_radius;
      if (over <= 0.0) {
        // Inside the end of the tube the nearer of face and side counts.
        consider(ahead - peg.radius, length() + 0.5 * M_PI * peg.radius + tube_radius + left);
      } else {
        const double place = length() + peg.radius * std::atan2(ahead, over);
        consider(std::hypot(ahead, over) - peg.radius, left > 0.0 ? around - place : place);
      }
    }
    ahead_before = ahead;
  }
  return best;
}

}  // namespace thigmo::mechanics
