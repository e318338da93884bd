#include "centreline.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace thigmo::mechanics {

double Fold::turn(double s) const {
  return angle == 0.0 ? 0.0 : angle * std::clamp(s, 0.0, width) / width;
}

Skin Outline::at(double place, double peg_radius) const {
  if (place <= side()) {
    return {std::max(place, 0.0), 0.0, -tube_radius, 0.0, -1.0, Kind::kRightSide};
  }
  double beyond = place - side();
  const double corner = peg_radius + rounding;
  const double quarter = 0.5 * M_PI * corner;
  const double half_face = tube_radius - rounding;
  if (beyond < quarter) {
    const double t = std::sin(beyond / corner);
    const double n = -std::cos(beyond / corner);
    return {side(), rounding * t, rounding * n - half_face, t, n, Kind::kRightCorner};
  }
  beyond -= quarter;
  if (beyond <= 2.0 * half_face) {
    return {side(), rounding, beyond - half_face, 1.0, 0.0, Kind::kFace};
  }
  beyond -= 2.0 * half_face;
  if (beyond < quarter) {
    const double t = std::cos(beyond / corner);
    const double n = std::sin(beyond / corner);
    return {side(), rounding * t, rounding * n + half_face, t, n, Kind::kLeftCorner};
  }
  return {std::max(side() - (beyond - quarter), 0.0), 0.0, tube_radius, 0.0, 1.0, Kind::kLeftSide};
}

Skin Outline::slope(double place, double peg_radius) const {
  const Skin on = at(place, peg_radius);
  switch (on.kind) {
    case Kind::kRightSide:
      return {1.0, 0.0, 0.0, 0.0, 0.0, on.kind};
    case Kind::kFace:
      return {0.0, 0.0, 1.0, 0.0, 0.0, on.kind};
    case Kind::kLeftSide:
      return {-1.0, 0.0, 0.0, 0.0, 0.0, on.kind};
    default: {
      // The outward normal turns to the left as the place moves on.
      const double turn = 1.0 / (peg_radius + rounding);
      const double t = -on.out_n * turn;
      const double n = on.out_t * turn;
      return {0.0, rounding * t, rounding * n, t, n, on.kind};
    }
  }
}

double Outline::perimeter(double peg_radius) const {
  return 2.0 * side() + M_PI * (peg_radius + rounding) + 2.0 * (tube_radius - rounding);
}

double Centreline::heading_in(int cell, double s) const {
  const Node& a = nodes[cell];
  const Node& b = nodes[cell + 1];
  const double width = b.s - a.s;
  if (width <= 0.0) return a.heading;
  // Hermite's polynomial; the turns of fold and rest shape are added apart, for they have kinks.
  const double heading_a = a.heading - imposed_turn(a.s);
  const double heading_b = b.heading - imposed_turn(b.s);
  const double u = (s - a.s) / width;
  const double v = 1.0 - u;
  return imposed_turn(s) + heading_a * (1.0 + 2.0 * u) * v * v +
         heading_b * (1.0 + 2.0 * v) * u * u + width * u * v * (a.curvature * v - b.curvature * u);
}

int Centreline::cell_of(double s) const {
  const Node* after = std::upper_bound(nodes + 1, nodes + count - 1, s,
                                       [](double arc, const Node& node) { return arc < node.s; });
  return static_cast<int>(after - nodes) - 1;
}

Pose Centreline::pose(double s) const {
  const int cell = cell_of(s);
  const Node& near = nodes[cell];
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

double Centreline::curvature(double s) const {
  const int cell = cell_of(s);
  const Node& a = nodes[cell];
  const Node& b = nodes[cell + 1];
  const double u = b.s > a.s ? (s - a.s) / (b.s - a.s) : 0.0;
  const double folded = s < fold.width && fold.angle != 0.0 ? fold.angle / fold.width : 0.0;
  return a.curvature + u * (b.curvature - a.curvature) + folded + rest.curvature(s);
}

bool Centreline::cut(double center, double span, double& low, double& high) const {
  low = std::max(center - 0.5 * span, 0.0);
  high = std::min(center + 0.5 * span, length());
  if (span <= 0.0) {
    low = std::max(std::min(center - 5e-4, length() - 1e-3), 0.0);
    high = low + 1e-3;
  }
  return high - low >= 1e-9;
}

double Centreline::mean(double center, double span) const {
  double low, high;
  if (!cut(center, span, low, high)) return 0.0;
  return (pose(high).heading - pose(low).heading) / (high - low);
}

Gap Centreline::gap_to(const Peg& peg, const Outline& outline) const {
  Gap best = gap_to(peg, Part::kFirstEnd, outline);
  for (int part = 1; part < (peg.is_wall() ? kParts : 1); ++part) {
    const Gap gap = gap_to(peg, static_cast<Part>(part), outline);
    if (gap.distance < best.distance) best = gap;
  }
  return best;
}

Gap Centreline::gap_to(const Peg& peg, Part part, const Outline& outline) const {
  if (part == Part::kStraight) return gap_to_straight(peg, outline);
  if (part == Part::kFirstEnd) return gap_to_round(peg.x, peg.y, peg.radius, outline);
  Gap gap = gap_to_round(peg.x + peg.to_x, peg.y + peg.to_y, peg.radius, outline);
  gap.part = part;
  gap.along = std::hypot(peg.to_x, peg.to_y);
  return gap;
}

Gap Centreline::gap_to_round(double x, double y, double radius, const Outline& outline) const {
  const double around = outline.perimeter(radius);
  const double side = outline.side();
  Gap best{1e30, 0.0};
  const auto consider = [&best](double distance, double place) {
    if (distance < best.distance) best = {distance, place};
  };
  // How far the obstacle's centre lies ahead of a section, and to its left.
  const auto seen_from = [&](const Pose& node) {
    const double c = std::cos(node.heading);
    const double d = std::sin(node.heading);
    return std::make_pair((x - node.x) * c + (y - node.y) * d, (y - node.y) * c - (x - node.x) * d);
  };
  double ahead_before = 0.0;
  for (int i = 0; i < count; ++i) {
    const bool end = nodes[i].s >= side - 1e-9;
    const Pose here =
        end && nodes[i].s > side ? pose(side) : Pose{nodes[i].x, nodes[i].y, nodes[i].heading};
    const auto [ahead, left_of] = seen_from(here);
    if (i > 0 && ahead_before >= 0.0 && ahead < 0.0) {
      // The foot of the perpendicular lies in this cell: Newton on (peg - r) . t = 0.
      const Node& a = nodes[i - 1];
      const double last = std::min(nodes[i].s, side);
      double s = a.s + (last - a.s) * ahead_before / (ahead_before - ahead);
      double left = 0.0;
      for (int k = 0; k < 4; ++k) {
        const auto [miss, beside] = seen_from(pose(s));
        left = beside;
        s = std::clamp(s + miss / std::max(1.0 - curvature(s) * left, 0.1), a.s, last);
        if (std::fabs(miss) < 1e-12) break;
      }
      consider(std::fabs(left) - outline.tube_radius - radius, left < 0.0 ? s : around - s);
    }
    if (end) {
      if (ahead >= 0.0) {
        const double corner = radius + outline.rounding;
        const double half_face = outline.tube_radius - outline.rounding;
        const double over = std::fabs(left_of) - half_face;
        if (over <= 0.0) {
          // Inside the end of the tube the nearer of face and side counts.
          consider(ahead - corner, side + 0.5 * M_PI * corner + half_face + left_of);
        } else {
          const double place = side + corner * std::atan2(ahead, over);
          consider(std::hypot(ahead, over) - corner, left_of > 0.0 ? around - place : place);
        }
      }
      break;
    }
    ahead_before = ahead;
  }
  return best;
}

// The straight part touches a side where the body runs along it, and the end at a corner.
Gap Centreline::gap_to_straight(const Peg& wall, const Outline& outline) const {
  const double extent = std::hypot(wall.to_x, wall.to_y);
  const double ux = wall.to_x / extent;
  const double uy = wall.to_y / extent;
  const double around = outline.perimeter(wall.radius);
  const double side = outline.side();
  Gap best{1e30, 0.0};
  // Distance from the wall's line, to the left of its direction.
  const auto beside = [&](double x, double y) { return ux * (y - wall.y) - uy * (x - wall.x); };
  // `x`, `y`: a point of the body; `hand`: the side of the line where that part of the body lies,
  // however far the point is beyond it; `reach`: of the tube around it.
  const auto consider = [&](double x, double y, double hand, double reach, double place) {
    const double along = (x - wall.x) * ux + (y - wall.y) * uy;
    const double away = hand * beside(x, y) - reach - wall.radius;
    if (along >= 0.0 && along <= extent && away < best.distance) {
      best = {away, place, Part::kStraight, along};
    }
  };
  const auto side_of = [&](const Pose& node) { return beside(node.x, node.y) < 0.0 ? -1.0 : 1.0; };
  const auto across = [&](double heading) {
    return std::sin(heading) * ux - std::cos(heading) * uy;
  };
  for (int i = 0; i + 1 < count && nodes[i].s < side; ++i) {
    double low = nodes[i].s;
    double high = std::min(nodes[i + 1].s, side);
    if (across(nodes[i].heading) * across(pose(high).heading) > 0.0) continue;
    double s = low;
    for (int k = 0; k < 40 && high - low > 1e-10; ++k) {  // bisection: safe, and rarely needed
      s = 0.5 * (low + high);
      (across(pose(s).heading) * across(nodes[i].heading) > 0.0 ? low : high) = s;
    }
    const Pose section = pose(s);
    const double hand = side_of(section);
    const double left = -hand * (std::cos(section.heading) * ux + std::sin(section.heading) * uy);
    consider(section.x, section.y, hand, outline.tube_radius, left > 0.0 ? around - s : s);
  }
  const Pose end = pose(side);
  const double c = std::cos(end.heading);
  const double d = std::sin(end.heading);
  const double corner = wall.radius + outline.rounding;
  const double half_face = outline.tube_radius - outline.rounding;
  // The end may have passed the line by a step's way; a radius behind it the body has not.
  const double hand = side_of(pose(std::max(side - outline.tube_radius, 0.0)));
  for (const double corner_of : {-1.0, 1.0}) {  // the right one, and the left one
    const double x = end.x - corner_of * half_face * d;
    const double y = end.y + corner_of * half_face * c;
    const double out_t = -hand * (ux * d - uy * c);
    const double out_n = -corner_of * hand * (ux * c + uy * d);
    if (out_t < 0.0 || out_n < 0.0) continue;
    const double place = side + corner * std::atan2(out_t, out_n);
    consider(x, y, hand, outline.rounding, corner_of > 0.0 ? around - place : place);
  }
  return best;
}

}  // namespace thigmo::mechanics
