// What the kernel asks of a body, in a plane (plane.h) or in space (space.h).
#pragma once

#include "loads.h"

namespace thigmo {

// A body that takes one shape after another. Its curvature is a row of numbers, `components` for
// each node or cell; only the body itself knows which.
class Body {
 public:
  Row rest;            // curvature of the free body, under its weight
  Row start;           // curvature at which a touched body's iteration starts
  double turn = 0.0;   // of the free body (rad)
  int components = 1;  // numbers of the curvature in each node or cell

  Body() = default;
  Body(const Body&) = delete;
  Body& operator=(const Body&) = delete;
  virtual ~Body() = default;

  // Starts on the loads of another hypothesis. `bends`: whether the body may not be taken as
  // straight, however little it bends.
  virtual void begin(const HypothesisKind&, bool bends) = 0;
  // Takes a shape. `step`: the fraction of the last change of shape that was applied. `loads`: the
  // placed loads that bend the body to this shape; none at the first shape.
  virtual void take(const Row& curvature, double step, const std::vector<PlacedLoad>& loads) = 0;
  // Whether a curvature gives the present shape again, so that the iteration has ended.
  virtual bool keeps(const Row& curvature) const = 0;
  // Lays a load's cells on the shape, with their columns.
  virtual void place(LoadColumns& load) const = 0;
  // Known part of the readings that no load causes, in this shape; empty if there is none.
  virtual Row known() const { return {}; }
  // Curvature that loads on this shape cause.
  virtual Row bent(const std::vector<PlacedLoad>& loads) const = 0;
  // Curvature of the next shape, from that of the loads and from the residuals `left` of the
  // readings, without the bad one.
  virtual Row shown(const Row& bent, const Row& left, int bad) const = 0;
  // The largest angle of a body with its base.
  virtual double turn_of(const Row& curvature) const = 0;
  // Curvature above that of the free body, as an answer reports it.
  virtual Row above(const Row& curvature) const = 0;
  // Forces of the contacts across the body, in the base's frame; none in a plane.
  virtual std::vector<Vector> forces(const std::vector<PlacedLoad>&) const { return {}; }
  // Whether a couple may twist the end.
  virtual bool twists() const { return false; }
  // Whether a contact is weighed beside a held end.
  virtual bool in_space() const { return false; }
};

}  // namespace thigmo
