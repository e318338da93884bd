// y'' = g + sum_j f_j (a_j - s)+ with x = s (thesis (2.5) to (2.9)), contacts at the pegs' x.
// Linear, so contacts are a small complementarity problem, solved by an active set.
#include "small_models.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "linear.h"

namespace thigmo::mechanics {
namespace {

// Feedback of foreshortening on contact arcs and forces; held by tests over random scenes.
constexpr double kSafety = 2.0;

// Deflection at s of a unit force at a (1/cm^2 -> cm).
double lift(double s, double a) {
  return s <= a ? s * s * (3.0 * a - s) / 6.0 : a * a * (3.0 * s - a) / 6.0;
}

// Deflection at s of a unit fold angle spread over [0, fold].
double fold_lift(double s, double fold) { return s < fold ? 0.5 * s * s / fold : s - 0.5 * fold; }

// A peg beside the beam: where it would touch, on which side (1: from the right, 0: out of reach),
// and the deflection at which it does.
struct Stop {
  double arc, side, level;
  bool active;
  double force;  // signed: positive bends left
};

// An even grid, and a node at the end of each piece of the rest shape.
std::vector<Node> chained_arcs(double curvature, double length, int cells, const RestShape& rest) {
  std::vector<Node> nodes{{0.0, 0.0, curvature, 0.0, 0.0}};
  const auto go_to = [&](double s) {
    const Node last = nodes.back();
    const double way = s - last.s;
    if (way < 1e-9) return;
    const double half = 0.5 * (curvature + rest.curvature(s)) * way;
    const double chord =
        std::fabs(half) < 1e-4 ? way * (1.0 - half * half / 6.0) : way * std::sin(half) / half;
    nodes.push_back({s, last.heading + 2.0 * half, curvature,
                     last.x + chord * std::cos(last.heading + half),
                     last.y + chord * std::sin(last.heading + half)});
  };
  auto piece = rest.pieces().begin();
  for (int i = 1; i <= cells; ++i) {
    const double s = length * i / cells;
    for (; piece != rest.pieces().end() && piece->until < s; ++piece) go_to(piece->until);
    go_to(s);
  }
  return nodes;
}

}  // namespace

std::vector<Node> arc_nodes(double curvature, double length, int cells, const RestShape& rest) {
  if (!rest.straight()) return chained_arcs(curvature, length, cells, rest);
  std::vector<Node> nodes(cells + 1);
  for (int i = 0; i <= cells; ++i) {
    const double s = length * i / cells;
    const double turn = curvature * s;
    if (std::fabs(turn) < 1e-4) {
      nodes[i] = {s, turn, curvature, s * (1.0 - turn * turn / 6.0),
                  0.5 * s * turn * (1.0 - turn * turn / 12.0)};
    } else {
      nodes[i] = {s, turn, curvature, std::sin(turn) / curvature,
                  (1.0 - std::cos(turn)) / curvature};
    }
  }
  return nodes;
}

std::optional<Beam> bend_beam(double g, double length, double tube_radius, double critical,
                              const std::vector<Peg>& pegs, int cells) {
  const double fold = 2.0 * tube_radius;
  // In the straight body's way: which side the peg is on, or whether the end's face meets it, is a
  // matter of history that this model does not know.
  bool astray = false;
  std::vector<Stop> stops;
  for (const Peg& peg : pegs) {
    if (peg.x <= 0.0 || peg.x >= length + peg.radius) {
      stops.push_back({0.0, 0.0, 0.0, false, 0.0});
      continue;
    }
    const double past = std::max(peg.x - length, 0.0);
    const double reach = std::sqrt(peg.radius * peg.radius - past * past);
    const double side = peg.y < 0.0 ? 1.0 : -1.0;
    astray |= std::fabs(peg.y) < tube_radius + peg.radius;
    stops.push_back(
        {std::min(peg.x, length), side, peg.y + side * (tube_radius + reach), false, 0.0});
  }
  double fold_angle = 0.0;
  double folding = 0.0;  // sign of the moment at which the base folds, 0 while it does not
  double moment = 0.0;
  bool solved = false;
  for (std::size_t round = 0; round < 4 * stops.size() + 8 && !solved; ++round) {
    std::vector<Stop*> active;
    for (Stop& stop : stops) {
      stop.force = 0.0;
      if (stop.active) active.push_back(&stop);
    }
    const int contacts = static_cast<int>(active.size());
    const int size = contacts + (folding != 0.0);
    std::vector<double> a(size * size, 0.0);
    std::vector<double> b(size);
    for (int r = 0; r < contacts; ++r) {
      const double arc = active[r]->arc;
      for (int c = 0; c < contacts; ++c) a[r * size + c] = lift(arc, active[c]->arc);
      b[r] = active[r]->level - 0.5 * g * arc * arc;
      if (folding != 0.0) {
        a[r * size + contacts] = fold_lift(arc, fold);
        a[contacts * size + r] = arc;
      }
    }
    if (folding != 0.0) b[contacts] = folding * critical;
    if (size > 0 && solve_linear(a, b, size) == 0) return std::nullopt;
    fold_angle = folding != 0.0 ? b[contacts] : 0.0;
    Stop* pulling = nullptr;
    moment = 0.0;
    for (int r = 0; r < contacts; ++r) {
      active[r]->force = b[r];
      moment += b[r] * active[r]->arc;
      const double worst = pulling ? pulling->side * pulling->force : -1e-13;
      if (active[r]->side * b[r] < worst) pulling = active[r];
    }
    if (pulling) {
      pulling->active = false;
      continue;
    }
    if (folding != 0.0 && fold_angle * folding < -1e-12) {
      folding = 0.0;
      continue;
    }
    if (folding == 0.0 && std::fabs(moment) > critical * (1.0 + 1e-12)) {
      folding = moment > 0.0 ? 1.0 : -1.0;
      continue;
    }
    double deepest = -1e-9;
    Stop* overlapping = nullptr;
    for (Stop& stop : stops) {
      if (stop.side == 0.0 || stop.active) continue;
      double y = 0.5 * g * stop.arc * stop.arc + fold_angle * fold_lift(stop.arc, fold);
      for (const Stop* other : active) y += other->force * lift(stop.arc, other->arc);
      const double gap = stop.side * (y - stop.level);
      if (gap < deepest) {
        deepest = gap;
        overlapping = &stop;
      }
    }
    if (overlapping) {
      overlapping->active = true;
    } else {
      solved = true;
    }
  }
  if (!solved) return std::nullopt;

  Beam beam{std::vector<Node>(cells + 1), {}, fold_angle, moment, 0.0};
  for (std::size_t j = 0; j < stops.size(); ++j) {
    const auto& [arc, side, level, active, force] = stops[j];
    if (!active) continue;
    const double around = Outline{length, tube_radius, 0.0}.perimeter(pegs[j].radius);
    beam.contacts.push_back(
        {static_cast<int>(j), std::fabs(force), force >= 0.0 ? arc : around - arc});
  }
  const Fold turned{fold_angle, fold};
  // Foreshortening, the integral of half the slope squared, is what the model leaves out.
  double shortening = 0.0;
  const double h = length / cells;
  for (int i = 0; i <= cells; ++i) {
    const double s = i * h;
    Node node{s, g * s + turned.turn(s), g, s, 0.5 * g * s * s + fold_angle * fold_lift(s, fold)};
    for (const Stop& stop : stops) {
      if (!stop.active) continue;
      const double lever = std::max(stop.arc - s, 0.0);
      node.curvature += stop.force * lever;
      node.heading += stop.force * 0.5 * (stop.arc * stop.arc - lever * lever);
      node.y += stop.force * lift(s, stop.arc);
    }
    beam.nodes[i] = node;
    if (i > 0) {
      const double before = beam.nodes[i - 1].heading;
      shortening += 0.25 * h * (node.heading * node.heading + before * before);
    }
  }
  beam.error_bound = astray ? std::numeric_limits<double>::infinity() : kSafety * shortening;
  return beam;
}

}  // namespace thigmo::mechanics
