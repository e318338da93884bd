// A whole sweep of the free body into a room, and how its readings change with each of the room's
// and the body's numbers: what a fit of the room to recorded sweeps needs.
#include <algorithm>
#include <cmath>
#include <limits>

#include "rod.h"

namespace thigmo::mechanics {
namespace {

// How a sensor's mean curvature changes for each cm that it lies farther out. An end of its span
// that is cut to the body stays there.
double mean_by_place(const Centreline& line, double center, double span, double mean) {
  double low, high;
  line.cut(center, span, low, high);
  const double high_moves = span <= 0.0 || center + 0.5 * span < line.length() ? 1.0 : 0.0;
  const double low_moves = span <= 0.0 || center - 0.5 * span > 0.0 ? 1.0 : 0.0;
  return (line.curvature(high) * high_moves - line.curvature(low) * low_moves -
          mean * (high_moves - low_moves)) /
         (high - low);
}

}  // namespace

Sweep Rod::sweep(const std::vector<double>& naturals, double length,
                 const std::vector<double>& centers, const std::vector<double>& spans) {
  constexpr double kNothing = std::numeric_limits<double>::quiet_NaN();
  Sweep sweep;
  sweep.rows = static_cast<int>(naturals.size());
  sweep.sensors = static_cast<int>(centers.size());
  sweep.obstacles = static_cast<int>(scene_.pegs.size());
  const std::size_t cells = static_cast<std::size_t>(sweep.rows) * sweep.sensors;
  sweep.readings.resize(cells);
  sweep.by_place.resize(cells);
  sweep.by_parameter.resize(cells * sweep.parameters());
  sweep.contacts.assign(4 * naturals.size() * scene_.pegs.size(), kNothing);
  sweep.approximate.assign(naturals.size(), 0);
  reset();
  double reached = 0.0;  // up to this natural curvature the body has touched nothing
  bool free = arc_is_clear(0.0, length);
  for (int row = 0; row < sweep.rows; ++row) {
    const double natural = naturals[row];
    if (free || touching() == 0) {
      const double begin = free ? reached : scene_.natural;
      const double way = std::fabs(natural - begin) * length * length / 2.0;
      const int pieces = std::max(1, static_cast<int>(std::ceil(way)));
      free = true;
      for (int i = 1; i <= pieces && free; ++i) {
        const double next = begin + (natural - begin) * i / pieces;
        free = arc_is_clear(next, length);
        if (free) reached = next;
      }
      if (free) {
        read_free(sweep, row, natural, length, centers, spans);
        continue;
      }
      assume_free(reached, length);
    }
    follow(natural, length);
    read(sweep, row, centers, spans);
  }
  return sweep;
}

// A free body that is straight at rest is an arc: whether it is clear of every obstacle follows
// without laying it out.
bool Rod::arc_is_clear(double natural, double length) const {
  const Outline outline{length, scene_.tube_radius, scene_.rounding};
  const double side = outline.side();
  const double bend = std::max(std::fabs(natural), 1e-9);
  const double turn = bend * side;
  std::vector<Node> nodes;  // of the whole arc, where it is needed
  for (const Peg& peg : scene_.pegs) {
    if (peg.is_wall() || turn > M_PI || !scene_.rest.straight()) {
      if (nodes.empty()) nodes = arc_nodes(natural, length, cells_for(length), scene_.rest);
      const Centreline line{
          nodes.data(), static_cast<int>(nodes.size()), {0.0, diameter()}, scene_.rest};
      if (line.gap_to(peg, outline).distance <= 0.0) return false;
      continue;
    }
    // Mirrored so that the arc bends to the left, around (0, 1 / bend).
    const double y = natural < 0.0 ? -peg.y : peg.y;
    const double foot = std::atan2(peg.x, 1.0 / bend - y) / bend;
    if (foot >= 0.0 && foot <= side) {
      const double away = std::fabs(std::hypot(peg.x, 1.0 / bend - y) - 1.0 / bend);
      if (away <= scene_.tube_radius + peg.radius) return false;
    }
    const double half = std::sin(0.5 * turn);
    const double dx = peg.x - std::sin(turn) / bend;
    const double dy = y - 2.0 * half * half / bend;
    const double ahead = dx * std::cos(turn) + dy * std::sin(turn);
    if (ahead < 0.0) continue;
    const double over = std::fabs(dy * std::cos(turn) - dx * std::sin(turn)) -
                        (scene_.tube_radius - scene_.rounding);
    if (std::hypot(ahead, std::max(over, 0.0)) <= peg.radius + scene_.rounding) return false;
  }
  return true;
}

void Rod::read_free(Sweep& sweep, int row, double natural, double length,
                    const std::vector<double>& centers, const std::vector<double>& spans) const {
  const Node ends[] = {{0.0, 0.0, natural, 0.0, 0.0},
                       {length, natural * length + scene_.rest.turn(length), natural, 0.0, 0.0}};
  const Centreline line{ends, 2, {0.0, diameter()}, scene_.rest};
  for (int m = 0; m < sweep.sensors; ++m) {
    double low, high;
    if (!line.cut(centers[m], spans[m], low, high)) continue;
    const int place = row * sweep.sensors + m;
    const double rest = (scene_.rest.turn(high) - scene_.rest.turn(low)) / (high - low);
    sweep.readings[place] = natural + rest;
    sweep.by_place[place] = mean_by_place(line, centers[m], spans[m], sweep.readings[place]);
  }
}

void Rod::read(Sweep& sweep, int row, const std::vector<double>& centers,
               const std::vector<double>& spans) const {
  const Centreline line = centreline();
  const int parameters = sweep.parameters();
  const int directions = shot_.directions;
  const bool exact = status_ != Convergence::kApproximate;
  const std::vector<double> total = exact ? sensitivity() : std::vector<double>();
  sweep.approximate[row] = !exact;
  std::vector<double> turn_by(directions), by(parameters);
  const int fold = reactions_.folding != 0 ? static_cast<int>(residual_.size()) - 1 : -1;
  // Adds `sign` times the heading's derivatives at an arc.
  const auto add_heading_by = [&](double s, double sign) {
    const int cell = line.cell_of(s);
    const Node& a = nodes_[cell];
    const Node& b = nodes_[cell + 1];
    const double width = b.s - a.s;
    const double u = width > 0.0 ? (s - a.s) / width : 0.0;
    const double v = 1.0 - u;
    // The nodes' derivatives were noted from the tip to the base.
    const auto* lower = &shot_.above[(nodes_.size() - 1 - cell) * directions];
    const auto* upper = &shot_.below[(nodes_.size() - 2 - cell) * directions];
    const Fold unit{1.0, diameter()};
    // The fold's turn is linear between nodes up to its width, and so is what Hermite makes of it.
    for (int d = 0; d < directions; ++d) {
      const bool folds = d == fold;
      const double at_a = folds ? unit.turn(a.s) : 0.0;
      const double at_b = folds ? unit.turn(b.s) : 0.0;
      const double at_s = folds ? unit.turn(s) : 0.0;
      turn_by[d] += sign * (at_s + (lower[d].heading - at_a) * (1.0 + 2.0 * u) * v * v +
                            (upper[d].heading - at_b) * (1.0 + 2.0 * v) * u * u +
                            width * u * v * (lower[d].curvature * v - upper[d].curvature * u));
    }
  };
  for (int m = 0; m < sweep.sensors; ++m) {
    const int place = row * sweep.sensors + m;
    double low, high;
    if (!line.cut(centers[m], spans[m], low, high)) continue;
    const double width = high - low;
    const double mean = (line.pose(high).heading - line.pose(low).heading) / width;
    sweep.readings[place] = mean;
    sweep.by_place[place] = mean_by_place(line, centers[m], spans[m], mean);
    if (!exact || touching() == 0) continue;
    std::fill(turn_by.begin(), turn_by.end(), 0.0);
    add_heading_by(high, 1.0);
    add_heading_by(low, -1.0);
    double* out = &sweep.by_parameter[static_cast<std::size_t>(place) * parameters];
    for (int d = 0; d < directions; ++d) {
      for (int p = 0; p < parameters; ++p) out[p] += turn_by[d] * total[d * parameters + p] / width;
    }
  }
  for (const ContactReport& contact : contacts()) {
    double* out = &sweep.contacts[4 * (row * scene_.pegs.size() + contact.peg)];
    const double force = std::hypot(contact.normal, contact.tangential);
    if (out[3] > force) continue;  // of a wall's contacts the strongest
    out[0] = contact.arc;
    out[1] = contact.x;
    out[2] = contact.y;
    out[3] = force;
  }
}

}  // namespace thigmo::mechanics
