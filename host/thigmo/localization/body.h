// What the kernel asks of a body, in a plane (plane.h) or in space (space.h).
#pragma once

#include "loads.h"

namespace thigmo {

// A body that takes one shape after another. Curvature is a row of numbers, those of each node or
// cell of the body; which they are is the body's own affair.
class Body {
 public:
  Row rest;            // curvature of the free body, under its weight
  Row start;           // the first that is tried of a touched body
  double turn = 0.0;   // of the free body (rad)
  int components = 1;  // numbers of the curvature in each node or cell

  Body() = default;
  Body(const Body&) = delete;
  Body& operator=(const Body&) = delete;
  virtual ~Body() = default;

  // Begins with the loads of another explanation. `bends`: whether it is never taken as straight.
  virtual void begin(const HypothesisKind&, bool bends) = 0;
  // Takes a shape, by a share of the step from the one before. `loads`: those that bent the body to
  // it, with their numbers; none at the first shape.
  virtual void take(const Row& curvature, double step, const std::vector<PlacedLoad>& loads) = 0;
  // Whether another curvature gives the shape it has.
  virtual bool keeps(const Row& curvature) const = 0;
  // Lays a load's cells on the shape, with their columns.
  virtual void place(LoadColumns& load) const = 0;
  // What the readings are known to have beside the loads, in this shape; empty: nothing.
  virtual Row known() const { return {}; }
  // Curvature that loads on this shape cause.
  virtual Row bent(const std::vector<PlacedLoad>& loads) const = 0;
  // That of the body that readings show which have so much left: the loads' own, or nearer to it.
  virtual Row shown(const Row& bent, const Row& left, int bad) const = 0;
  // The largest angle of a body with its base.
  virtual double turn_of(const Row& curvature) const = 0;
  // What an answer shows of a curvature: that above the free body's.
  virtual Row above(const Row& curvature) const = 0;
  // Forces of the contacts across the body, in the base's frame; none in a plane.
  virtual std::vector<Vector> forces(const std::vector<PlacedLoad>&) const { return {}; }
  // Whether its end may be twisted.
  virtual bool twists() const { return false; }
  // Whether a contact is weighed beside a held end.
  virtual bool in_space() const { return false; }
};

}  // namespace thigmo
