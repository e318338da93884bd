// The two models that are cheaper than the large-deflection rod: a free body's arc, and the beam of
// small deflections with contacts and fold. rod.cpp decides where they are good enough.
#pragma once

#include <cmath>
#include <optional>
#include <vector>

#include "centreline.h"

namespace thigmo::mechanics {

// A touching obstacle: the force with which it pushes (1/cm^2), where on the skin (see Outline),
// and the part of it that touches (of a wall's straight part, how far from its first end).
struct Contact {
  int peg;
  double force, place;
  Part part = Part::kFirstEnd;
  double along = 0.0;
  // What friction remembers of the last equilibrium: the places on skin and wall, the body's
  // heading there (NaN for a new touch), and the share of the largest friction that acted, positive
  // towards larger places.
  double last_place = place, last_along = along, last_heading = NAN, rubbing = 0.0;
  double onward = 1.0;  // -1 where larger places lie towards a wall's first end
};

// Nodes of a free body of one natural curvature beside its rest shape's: exactly a circular arc, or
// one for each piece.
std::vector<Node> arc_nodes(double curvature, double length, int cells, const RestShape& rest);

struct Beam {
  std::vector<Node> nodes;
  std::vector<Contact> contacts;
  double fold_angle, base_moment;
  double error_bound;  // cm, of positions against the large-deflection rod
};

// A straight beam of natural curvature g among pegs; nothing if the contacts cannot be determined.
std::optional<Beam> bend_beam(double g, double length, double tube_radius, double critical,
                              const std::vector<Peg>& pegs, int cells);

}  // namespace thigmo::mechanics
