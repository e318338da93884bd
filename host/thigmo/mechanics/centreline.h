// A bent body as a table of nodes: where its points lie, what sensors average, where pegs touch.
//
// EI = 1: forces in 1/cm^2, moments in 1/cm; lengths in cm. The table is what the solvers (rod.h)
// produce; Python holds it as an array of five columns.
#pragma once

#include <vector>

namespace thigmo::mechanics {

struct Pose {
  double x, y, heading;
};

// A round obstacle.
struct Peg {
  double x, y, radius;
};

// The base's fold: its angle (rad), spread evenly over [0, width].
struct Fold {
  double angle, width;
  double turn(double s) const;
};

// One row. `curvature` leaves out the fold; `heading` contains it.
struct Node {
  double s, heading, curvature, x, y;
};
static_assert(sizeof(Node) == 5 * sizeof(double), "Python reads the table as (n, 5) doubles");

enum class Kind { kRightSide, kRightCorner, kFace, kLeftCorner, kLeftSide };

// A place on the skin: its arc, its offset along the left normal, and the outward normal there as
// (tangential, normal) components.
struct Skin {
  double arc, offset, out_t, out_n;
  Kind kind;
};

// The place with one coordinate around the skin, in cm travelled by the centre of a touching peg:
// from the base up the right side (place = arc), round the right corner of the flat end (peg radius
// times angle), across the face, round the left corner, and down the left side. It is continuous,
// so a peg that slides from the side over the corner onto the face is no special case in Newton.
Skin skin_at(double place, double length, double tube_radius, double peg_radius);

// The whole way around, and so the place of the left side's base.
double perimeter(double length, double tube_radius, double peg_radius);

struct Gap {
  double distance, place;  // negative distance: overlap
};

// A view; the nodes belong to somebody else.
struct Centreline {
  const Node* nodes;
  int count;
  Fold fold;

  double length() const { return nodes[count - 1].s; }
  Pose pose(double s) const;
  // Mean curvature over a span, exactly: the turn over the length. A span of 0 gives the value at
  // the centre. What lies beyond the body is cut off; a span wholly beyond it gives 0.
  double mean(double center, double span) const;
  // Distance from the flat-ended tube to a peg, and the closest place on the skin.
  Gap gap_to(const Peg& peg, double tube_radius) const;

 private:
  double heading_in(int cell, double s) const;
};

}  // namespace thigmo::mechanics
