// A bent body as a table of nodes: where its points lie, what sensors average, where pegs touch.
//
// EI = 1: forces in 1/cm^2, moments in 1/cm; lengths in cm. The table is what the solvers (rod.h)
// produce; Python holds it as an array of five columns.
#pragma once

#include <algorithm>
#include <utility>
#include <vector>

namespace thigmo::mechanics {

struct Pose {
  double x, y, heading;
};

// An obstacle that stands in the plane: a round peg, or a straight wall with round ends. The wall's
// surface lies one radius from the line between its two ends' centres.
struct Peg {
  double x, y, radius;
  double to_x = 0.0, to_y = 0.0;  // from the first end's centre to the last one's; a peg: 0
  double compliance = 0.0;        // cm it yields for each 1/cm^2 of force on it, so cm^3

  bool is_wall() const { return to_x != 0.0 || to_y != 0.0; }
};

// The part of an obstacle that touches: a peg is its own first end.
enum class Part { kFirstEnd, kLastEnd, kStraight };
constexpr int kParts = 3;  // of a wall

// The base's fold: its angle (rad), spread evenly over [0, width].
struct Fold {
  double angle, width;
  double turn(double s) const;
};

// The shape of a body that nothing bends: pieces of one curvature each, base first, and straight
// beyond the last. A body without pieces is straight.
class RestShape {
 public:
  struct Piece {
    double until, curvature;  // from where the piece before ends, cm and 1/cm
  };

  RestShape() = default;
  explicit RestShape(std::vector<Piece> pieces) : pieces_(std::move(pieces)) {}

  bool straight() const { return pieces_.empty(); }
  const std::vector<Piece>& pieces() const { return pieces_; }
  // Angle between the body at an arc and at its base.
  double turn(double s) const {
    double begin = 0.0, turn = 0.0;
    for (const Piece& piece : pieces_) {
      if (s <= begin) break;
      turn += piece.curvature * (std::min(s, piece.until) - begin);
      begin = piece.until;
    }
    return turn;
  }
  // That of the piece around an arc; where two meet, of the one nearer to the base.
  double curvature(double s) const {
    for (const Piece& piece : pieces_) {
      if (s <= piece.until) return piece.curvature;
    }
    return 0.0;
  }

 private:
  std::vector<Piece> pieces_;
};

// One row. `curvature` leaves out the fold and the rest shape; `heading` contains both.
struct Node {
  double s, heading, curvature, x, y;
};
static_assert(sizeof(Node) == 5 * sizeof(double), "Python reads the table as (n, 5) doubles");

enum class Kind { kRightSide, kRightCorner, kFace, kLeftCorner, kLeftSide };

// A place on the skin: the section that carries it, the contact's offsets from that section's
// centre along the tangent and the left normal, and the outward normal there as (tangential,
// normal).
struct Skin {
  double arc, ahead, offset, out_t, out_n;
  Kind kind;
};

// The tube's outline around an everted length: two sides, and an end with round corners. A rounding
// of the tube's radius makes the end a half circle, 0 makes it flat.
struct Outline {
  double length, tube_radius, rounding;

  // Where the sides end and the corners begin: the section that carries all of the end.
  double side() const { return length - rounding; }
  // The place with one coordinate around the skin, in cm travelled by the centre of a touching peg:
  // from the base up the right side (place = arc), round the right corner (peg radius and rounding
  // times angle), across the face, round the left corner, and down the left side. It is continuous,
  // so a peg that slides from the side over the corner onto the face is no special case in Newton.
  Skin at(double place, double peg_radius) const;
  // Derivatives of `at` by the place; the kind does not matter.
  Skin slope(double place, double peg_radius) const;
  // The whole way around, and so the place of the left side's base.
  double perimeter(double peg_radius) const;
};

struct Gap {
  double distance, place;  // negative distance: overlap
  Part part = Part::kFirstEnd;
  double along = 0.0;  // of a wall's straight part, cm from its first end
};

// A view; the nodes belong to somebody else.
struct Centreline {
  const Node* nodes;
  int count;
  Fold fold;
  const RestShape& rest;

  double length() const { return nodes[count - 1].s; }
  Pose pose(double s) const;
  // Mean curvature over a span, exactly: the turn over the length. A span of 0 gives the value at
  // the centre. What lies beyond the body is cut off; a span wholly beyond it gives 0.
  double mean(double center, double span) const;
  // Ends of the part of a span that is cut to the body; nothing if none of it is left.
  bool cut(double center, double span, double& low, double& high) const;
  // Distance from the tube to an obstacle, or to a part of it, and the closest place on the skin.
  Gap gap_to(const Peg& peg, const Outline& outline) const;
  Gap gap_to(const Peg& peg, Part part, const Outline& outline) const;
  // The cell (number of its lower node) that holds an arc.
  int cell_of(double s) const;
  // Curvature with the fold and the rest shape, otherwise linear between nodes.
  double curvature(double s) const;

 private:
  double imposed_turn(double s) const { return fold.turn(s) + rest.turn(s); }
  double heading_in(int cell, double s) const;
  Gap gap_to_round(double x, double y, double radius, const Outline& outline) const;
  Gap gap_to_straight(const Peg& wall, const Outline& outline) const;
};

}  // namespace thigmo::mechanics
