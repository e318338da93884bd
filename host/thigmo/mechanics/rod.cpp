// The choice of the model, and the rod followed from step to step.
#include "rod.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "linear.h"

namespace thigmo::mechanics {
namespace {

constexpr double kInfinite = std::numeric_limits<double>::infinity();
constexpr int kLeastCells = 8;
constexpr double kPieceCm = 1.0;  // the free tip's way in a piece of a step

// Linear interpolation at x of values at nodes first, first + step, ...; the ends go on.
double interpolated(const std::vector<double>& values, double first, double step, double x) {
  const double position = (x - first) / step;
  const double last = static_cast<double>(values.size() - 1);
  if (position <= 0.0) return values.front();
  if (position >= last) return values.back();
  const auto i = static_cast<std::size_t>(position);
  return values[i] + (position - static_cast<double>(i)) * (values[i + 1] - values[i]);
}

void check(double natural, double length) {
  if (!std::isfinite(natural)) throw BadInput("free curvature must be a finite number");
  if (!(std::isfinite(length) && length > 0.0)) throw BadInput("length must be positive");
}

std::vector<Peg> checked(std::vector<Peg> pegs) {
  for (const Peg& peg : pegs) {
    if (!(peg.radius > 1e-3 && std::isfinite(peg.x + peg.y + peg.radius + peg.to_x + peg.to_y))) {
      throw BadInput("an obstacle needs finite coordinates and a radius above 0.001 cm");
    }
    if (!(peg.compliance >= 0.0 && std::isfinite(peg.compliance))) {
      throw BadInput("an obstacle's compliance must be a finite number, 0 or more");
    }
  }
  return pegs;
}

double apart(const Node& a, const Node& b) { return std::hypot(a.x - b.x, a.y - b.y); }

}  // namespace

Rod::Rod(double diameter, double critical, std::vector<Peg> pegs, double cell,
         std::optional<Model> model, double tolerance, double friction, double base_compliance,
         double rounding, RestShape rest)
    : cell_(cell),
      choice_(model),
      tolerance_(tolerance),
      friction_(friction),
      scene_{0.0,      0.5 * diameter, critical, 0.0, checked(std::move(pegs)), 0, base_compliance,
             rounding, std::move(rest)} {
  if (!(cell >= 0.01 && cell <= 10.0)) throw BadInput("cell_cm must lie between 0.01 and 10");
  if (!(friction >= 0.0 && friction <= 2.0)) throw BadInput("friction must lie between 0 and 2");
  if (!(base_compliance >= 0.0 && std::isfinite(base_compliance))) {
    throw BadInput("the base's compliance must be a finite number, 0 or more");
  }
  if (!(rounding >= 0.0 && rounding <= 0.5 * diameter)) {
    throw BadInput("the tip's rounding must lie between 0 and the tube's radius");
  }
  double begin = 0.0;
  for (const RestShape::Piece& piece : scene_.rest.pieces()) {
    if (!(piece.until > begin && std::isfinite(piece.until + piece.curvature))) {
      throw BadInput("the rest curvature's pieces must be finite, and their ends must ascend");
    }
    begin = piece.until;
  }
  if (choice_ == Model::kBeam && !scene_.rest.straight()) {
    throw BadInput("the beam is of a body that is straight at rest");
  }
}

// The choice of the model.

void Rod::step(double natural, double length) {
  check(natural, length);
  if (choice_ == Model::kElastica) {
    take_elastica(natural, length);
  } else if (choice_ == Model::kArc) {
    set_free(arc_nodes(natural, length, cells_for(length), scene_.rest), natural, length);
  } else if (choice_ == Model::kBeam) {
    try_beam(natural, length, kInfinite);
  } else if (!try_arc(natural, length) &&
             (!beam_serves() || !try_beam(natural, length, tolerance_))) {
    take_elastica(natural, length);
  }
  ++counts_[static_cast<int>(model_)];
}

// Whether the beam knows all that is in the room: a body that is straight at rest, flat ends, round
// pegs, and nothing that gives.
bool Rod::beam_serves() const {
  return scene_.rest.straight() && friction_ == 0.0 && scene_.base_compliance == 0.0 &&
         scene_.rounding == 0.0 &&
         std::none_of(scene_.pegs.begin(), scene_.pegs.end(),
                      [](const Peg& peg) { return peg.is_wall() || peg.compliance > 0.0; });
}

// Takes the arc if the body was free, moves little and stays clear of every peg.
bool Rod::try_arc(double natural, double length) {
  if (touching() > 0) return false;
  if (!scene_.pegs.empty()) {
    if (scene_.length > 0.0 ? travel(natural, length) > kPieceCm : natural != 0.0) return false;
  }
  return lie_clear(natural, length);
}

bool Rod::lie_clear(double natural, double length) {
  std::vector<Node> nodes = arc_nodes(natural, length, cells_for(length), scene_.rest);
  const Centreline line{
      nodes.data(), static_cast<int>(nodes.size()), {0.0, diameter()}, scene_.rest};
  const Outline outline{length, scene_.tube_radius, scene_.rounding};
  for (const Peg& peg : scene_.pegs) {
    if (line.gap_to(peg, outline).distance <= 0.0) return false;
  }
  set_free(std::move(nodes), natural, length);
  return true;
}

void Rod::set_free(std::vector<Node> nodes, double natural, double length) {
  reactions_ = {};
  nodes_ = std::move(nodes);
  base_moment_ = error_bound_ = 0.0;
  model_ = Model::kArc;
  status_ = Convergence::kConverged;
  elastica_current_ = false;
  scene_.length = length;
  scene_.natural = natural;
}

bool Rod::try_beam(double natural, double length, double tolerance) {
  std::optional<Beam> beam = bend_beam(natural, length, scene_.tube_radius, scene_.critical,
                                       scene_.pegs, cells_for(length));
  if (!beam || beam->error_bound > tolerance) return false;
  set_free(std::move(beam->nodes), natural, length);
  reactions_.contacts = std::move(beam->contacts);
  reactions_.fold_angle = beam->fold_angle;
  base_moment_ = beam->base_moment;
  error_bound_ = beam->error_bound;
  model_ = Model::kBeam;
  return true;
}

void Rod::take_elastica(double natural, double length) {
  if (!elastica_current_) {
    const double before = scene_.natural;
    const double length_before = scene_.length;
    if (model_ == Model::kArc && length_before > 0.0) {
      assume_free(before, length_before);
    } else {
      reset();
      if (length_before > 0.0) follow(before, length_before);
    }
  }
  follow(natural, length);
  error_bound_ = status_ == Convergence::kApproximate ? 1e-3 : 1e-5;
}

void Rod::place(std::vector<Peg> pegs) {
  const double natural = scene_.natural, length = scene_.length;
  scene_.pegs = checked(std::move(pegs));
  reset();
  if (length == 0.0 || lie_clear(natural, length)) return;
  step(0.0, length);
  step(natural, length);
}

void Rod::reset() {
  reactions_ = {};
  forget_equations();
  tip_.reset();
  bend_.clear();
  scene_.length = scene_.natural = 0.0;
  scene_.cells = 0;
  elastica_current_ = false;
  model_ = Model::kArc;
}

void Rod::assume_free(double natural, double length) {
  reset();
  advance(natural, length, 0.0);
}

void Rod::set_critical(double critical) {
  scene_.critical = critical;
  if (!std::isfinite(critical)) {
    reactions_.folding = 0;
    reactions_.fold_angle = 0.0;
  }
  forget_equations();
}

void Rod::forget_equations() {
  jacobian_.clear();
  slope_.clear();
  determinant_sign_ = 0;
}

// Following the elastica.

// How far the free tip may be expected to move.
double Rod::travel(double natural, double length) const {
  const double longer = std::max(length, scene_.length);
  const double change = std::fabs(natural - scene_.natural);
  return change * longer * longer / 2.0 + std::fabs(length - scene_.length);
}

// The way is cut into pieces in which the free tip would travel at most a centimetre.
void Rod::follow(double natural, double length) {
  if (scene_.length == 0.0) {
    // Start without muscles, except that a rod that no peg can touch starts where it is.
    const bool free = scene_.pegs.empty() && std::fabs(natural) * length < 50.0;
    advance(free ? natural : 0.0, length, 0.0);
  }
  const double natural_before = scene_.natural, length_before = scene_.length;
  const double way = travel(natural, length);
  const int pieces = std::max(1, static_cast<int>(std::ceil(way / kPieceCm)));
  for (int i = 1; i <= pieces; ++i) {
    const double u = static_cast<double>(i) / pieces;
    advance(natural_before + u * (natural - natural_before),
            length_before + u * (length - length_before), way / pieces);
  }
}

void Rod::advance(double natural, double length, double travel) {
  if (length != scene_.length) {
    remesh(length);
  } else {
    predict(natural - scene_.natural);
  }
  scene_.natural = natural;
  solve(travel);
}

int Rod::cells_for(double length) const {
  return std::max(kLeastCells, static_cast<int>(std::ceil(length / cell_ - 1e-9)));
}

void Rod::remesh(double length) {
  const int cells = cells_for(length);
  std::vector<double> bend(cells, 0.0);
  if (scene_.cells > 0) {
    const double old = scene_.length / scene_.cells;
    for (int i = 0; i < cells; ++i) {
      const double s = (i + 0.5) * length / cells;
      if (s <= scene_.length - 0.5 * old) bend[i] = interpolated(bend_, 0.5 * old, old, s);
    }
    // Growth happens at the tip: places counted from the far end of the left side move.
    const double change = length - scene_.length;
    for (Contact& contact : reactions_.contacts) {
      const Kind kind = skin(contact).kind;
      if (kind == Kind::kLeftSide) {
        contact.place += 2.0 * change;
        contact.last_place += 2.0 * change;
      } else if (kind != Kind::kRightSide) {
        contact.place += change;
        contact.last_place += change;
      }
    }
    jacobian_.clear();
    slope_.clear();
  }
  bend_ = std::move(bend);
  scene_.length = length;
  scene_.cells = cells;
}

void Rod::press(std::vector<Contact> contacts, double fold_angle, double natural, double length) {
  check(natural, length);
  reset();
  scene_.length = length;
  scene_.cells = cells_for(length);
  scene_.natural = natural;
  reactions_ = {std::move(contacts), 0, fold_angle};
  shoot(reactions_);
  base_moment_ = shot_.base.moment;
  model_ = Model::kElastica;
}

// One quasi-static step from the last state.
void Rod::solve(double travel) {
  const double fold_before = reactions_.fold_angle;
  const std::optional<Node> tip_before = tip_;
  bool converged = find_reactions();
  // A solution much farther away than the tip may move is checked by relaxation.
  if (converged && tip_before && apart(nodes_.back(), *tip_before) > 5.0 * travel + 0.3)
    converged = false;
  status_ = Convergence::kConverged;
  if (!converged) {
    status_ = Convergence::kRelaxed;
    Relaxed relaxed = relax(scene_, bend_, fold_before);
    nodes_ = relaxed.nodes;
    Reactions near{std::move(relaxed.contacts), 0, 0.0};
    for (Contact& contact : near.contacts) contact.onward = way_along(contact);
    if (std::fabs(relaxed.fold_angle) > 1e-3) {
      near.folding = relaxed.fold_angle > 0.0 ? 1 : -1;
      near.fold_angle = relaxed.fold_angle;
    }
    forget_equations();
    reactions_ = near;
    converged = find_reactions() && apart(nodes_.back(), relaxed.nodes.back()) <= 1.0;
    if (!converged) {
      // The relaxed shape is an equilibrium to the accuracy of penalties.
      status_ = Convergence::kApproximate;
      forget_equations();
      reactions_ = std::move(near);
      nodes_ = std::move(relaxed.nodes);
      base_moment_ = relaxed.bend[0];
    }
  }
  model_ = Model::kElastica;
  elastica_current_ = true;
  remember_touches();
  tip_ = nodes_.back();
  // Contact curvature at the cells' middles, for the next relaxation.
  std::size_t k = 0;
  for (int i = 0; i < scene_.cells; ++i) {
    const double s = (i + 0.5) * scene_.length / scene_.cells;
    while (k + 2 < nodes_.size() && nodes_[k + 1].s <= s) ++k;
    const double width = nodes_[k + 1].s - nodes_[k].s;
    const double u = width > 0.0 ? (s - nodes_[k].s) / width : 0.0;
    bend_[i] =
        nodes_[k].curvature + u * (nodes_[k + 1].curvature - nodes_[k].curvature) - scene_.natural;
  }
}

// What is known.

Skin Rod::skin(const Contact& contact) const {
  return scene_.outline().at(contact.place, scene_.pegs[contact.peg].radius);
}

Centreline Rod::centreline() const {
  return {nodes_.data(),
          static_cast<int>(nodes_.size()),
          {reactions_.fold_angle, diameter()},
          scene_.rest};
}

double Rod::axial_push() const {
  double total = 0.0;
  for (const Contact& contact : reactions_.contacts) total -= push(contact).tangential;
  return total;
}

std::vector<ContactReport> Rod::contacts() const {
  std::vector<ContactReport> reports;
  for (const Contact& contact : reactions_.contacts) {
    const Skin on = skin(contact);
    const Pose pose = centreline().pose(on.arc);
    const double c = std::cos(pose.heading);
    const double d = std::sin(pose.heading);
    const Push pushed = push(contact);
    reports.push_back({contact.peg, on.arc + on.ahead, on.kind, pushed.normal, pushed.tangential,
                       on.ahead * pushed.normal - on.offset * pushed.tangential,
                       pose.x + on.ahead * c - on.offset * d, pose.y + on.ahead * d + on.offset * c,
                       pushed.tangential * c - pushed.normal * d,
                       pushed.tangential * d + pushed.normal * c});
  }
  std::stable_sort(reports.begin(), reports.end(),
                   [](const auto& a, const auto& b) { return a.arc < b.arc; });
  return reports;
}

}  // namespace thigmo::mechanics
