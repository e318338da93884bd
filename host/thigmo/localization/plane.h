// A body that bends in a plane, as the kernel asks for it (body.h).
#pragma once

#include "body.h"

namespace thigmo {

class PlaneBody : public Body {
 public:
  PlaneBody(const Readings& readings, const Input& in, const Options& options)
      : frame_(readings.frame), options_(options), priors_(options.priors) {
    start = rest = rest_of(in.body, options.position, options.length);
    turn = readings.turn;
  }

  void begin(const HypothesisKind&, bool bends) override { straight_ = !bends; }

  void take(const Row& curvature, double, const std::vector<PlacedLoad>&) override {
    straight_ = straight_ && turn_of(curvature) < priors_.straight;
    if (straight_) {
      least_ = priors_.least_lever;
      return;
    }
    shape_ = Shape(curvature);
    least_ = priors_.least_lever * largest_lever(shape_.at(1.0));
  }

  bool keeps(const Row& curvature) const override {
    return straight_ && turn_of(curvature) < priors_.straight;
  }

  void place(LoadColumns& p) const override {
    const Load& load = *p.load;
    const int n = frame_.size(), cells = p.cells;
    Row now;  // what a straight body's columns hang on
    if (straight_ && load.where == Load::Where::anywhere && !load.critical) {
      now = {p.window.near, p.window.far, priors_.least_lever, priors_.swept};
      now.insert(now.end(), frame_.low.begin(), frame_.low.end());
      now.insert(now.end(), frame_.high.begin(), frame_.high.end());
      if (now == p.laid) return;
    }
    p.laid = std::move(now);
    p.column.resize(n, p.size() * cells);
    p.unit.resize(p.column.columns), p.base.assign(p.column.columns, 0.0);
    if (load.where == Load::Where::anywhere) {
      p.place = p.density = middles(p.window, cells);
      for (double& value : p.density) value = density(value);
    } else {
      p.place = {load.where == Load::Where::end ? 1.0 : 0.0};
    }
    if (load.kinks) {
      p.unit[0] = priors_.angle;
      for (int i = 0; i < n; ++i) p.column[i][0] = p.unit[0] * fold_of(frame_, i, options_.radius);
      return;
    }
    int number = 0;
    const auto fill = [&](const Levers& levers, const Row& unit) {
      for (int i = 0; i < n; ++i) {
        double* column = p.column[i] + number * cells;
        for (int m = 0; m < cells; ++m) column[m] = levers.sensor[i][m] * unit[m];
      }
      for (int m = 0; m < cells; ++m) {
        p.unit[number * cells + m] = unit[m], p.base[number * cells + m] = levers.base[m] * unit[m];
      }
      ++number;
    };
    Levers levers(n, cells);
    const auto lay = [&](bool along) {
      if (straight_)
        straight_levers(p.place, frame_.low, frame_.high, levers);
      else
        bent_levers(shape_, p.place, frame_.low, frame_.high, levers, along);
    };
    lay(false);
    Row force(cells);
    for (int m = 0; m < cells; ++m) {
      const double lever = std::max(std::abs(load.critical ? levers.base[m] : levers.largest[m]),
                                    std::max(least_, 1e-12));
      force[m] = load.critical ? std::copysign(options_.critical_error * options_.critical / lever,
                                               levers.base[m])
                               : 1.0 / lever;
    }
    if (load.across) fill(levers, force);
    if (load.along) lay(true), fill(levers, force);
    if (load.couples == Load::Couples::none) return;
    for (int m = 0; m < cells; ++m) {
      levers.base[m] = 1.0;
      for (int i = 0; i < n; ++i) {
        const double span = frame_.high[i] - frame_.low[i], before = p.place[m] - frame_.low[i];
        levers.sensor[i][m] = span < kPoint ? before > 0.0 : std::clamp(before / span, 0.0, 1.0);
      }
      force[m] = load.couples == Load::Couples::of_face ? options_.radius * force[m] : 1.0;
    }
    fill(levers, force);
  }

  Row bent(const std::vector<PlacedLoad>& loads) const override {
    static const Shape straight{Row(kNodes)};
    const Shape& shape = straight_ ? straight : shape_;
    Row out = rest;
    for (const PlacedLoad& placed : loads) {
      if (placed.load->kinks) continue;
      const Point point = shape.at(placed.arc);
      int number = 0;
      if (placed.load->across) shape.add_moment(point, placed.value[number++], out);
      if (placed.load->along) shape.add_moment(point.turned(), placed.value[number++], out);
      if (placed.load->couples == Load::Couples::none) continue;
      for (int k = 0; k < kNodes && k <= placed.arc * (kNodes - 1); ++k)
        out[k] += placed.value[number];
    }
    return out;
  }

  Row shown(const Row& bent, const Row&, int) const override { return bent; }

  double turn_of(const Row& curvature) const override {
    double heading = 0.0, most = 0.0;
    for (const double value : curvature) {
      heading += value;
      most = std::max(most, std::abs(heading));
    }
    return most / kNodes;
  }

  Row above(const Row& curvature) const override {
    Row out = curvature;
    for (int k = 0; k < kNodes; ++k) out[k] -= rest[k];
    return out;
  }

 private:
  // Of a contact's place. A bend of the whole body carries each point across an area that grows as
  // the square of its arc.
  double density(double arc) const { return 1.0 - priors_.swept + 3.0 * priors_.swept * arc * arc; }
  double largest_lever(const Point& point) const {
    const double lever = point.x * point.c + point.y * point.s;
    double most = std::abs(lever);
    shape_.raise_to_largest(1, &point.arc, &point.c, &point.s, &lever, &most);
    return most;
  }

  const Frame& frame_;
  const Options& options_;
  const Priors& priors_;
  double least_ = 0.0;
  bool straight_ = true;
  Shape shape_{Row(kNodes)};
};

}  // namespace thigmo
