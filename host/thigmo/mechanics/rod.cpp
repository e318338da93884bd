#include "rod.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "linear.h"

namespace thigmo::mechanics {
namespace {

constexpr double kTiny = 1e-9;      // cm, between nodes
constexpr double kGap = 1e-7;       // cm, an overlap that counts
constexpr double kResidual = 1e-9;  // cm
constexpr double kInfinite = std::numeric_limits<double>::infinity();
constexpr int kLeastCells = 8;

// Largest size among values; not a number if one of them is not.
double largest(const std::vector<double>& values) {
  double most = 0.0;
  for (const double value : values) {
    if (std::isnan(value)) return value;
    most = std::max(most, std::fabs(value));
  }
  return most;
}

// Linear interpolation at x of values at nodes first, first + step, ...; the ends go on.
double interpolated(const std::vector<double>& values, double first, double step, double x) {
  const double at = (x - first) / step;
  const double last = static_cast<double>(values.size() - 1);
  if (at <= 0.0) return values.front();
  if (at >= last) return values.back();
  const auto i = static_cast<std::size_t>(at);
  return values[i] + (at - static_cast<double>(i)) * (values[i + 1] - values[i]);
}

std::vector<double> refined(const std::vector<double>& values, std::size_t size) {
  if (values.size() == 1) return std::vector<double>(size, values[0]);
  std::vector<double> fine(size);
  const double step = 1.0 / static_cast<double>(values.size() - 1);
  for (std::size_t i = 0; i < size; ++i) {
    fine[i] =
        interpolated(values, 0.0, step, static_cast<double>(i) / static_cast<double>(size - 1));
  }
  return fine;
}

std::vector<double> scaled(std::vector<double> values, double factor) {
  for (double& value : values) value *= factor;
  return values;
}

std::vector<Peg> checked(std::vector<Peg> pegs) {
  for (const Peg& peg : pegs) {
    if (!(peg.radius > 1e-3 && std::isfinite(peg.x + peg.y + peg.radius))) {
      throw BadInput("a peg needs finite coordinates and a radius above 0.001 cm");
    }
  }
  return pegs;
}

double apart(const Node& a, const Node& b) { return std::hypot(a.x - b.x, a.y - b.y); }

}  // namespace

NaturalCurvature::NaturalCurvature(std::vector<double> values, double length)
    : values_(std::move(values)), turns_(values_.size(), 0.0), cell_(length) {
  if (values_.size() == 1) return;
  cell_ = length / static_cast<double>(values_.size() - 1);
  for (std::size_t i = 1; i < values_.size(); ++i) {
    turns_[i] = turns_[i - 1] + cell_ * (values_[i - 1] + values_[i]) / 2.0;
  }
}

double NaturalCurvature::at(double s) const {
  return values_.size() == 1 ? values_[0] : interpolated(values_, 0.0, cell_, s);
}

double NaturalCurvature::turn(double s) const {
  if (values_.size() == 1) return values_[0] * s;
  const int last = static_cast<int>(values_.size()) - 2;
  const int i = std::clamp(static_cast<int>(s / cell_), 0, last);
  const double u = s - i * cell_;
  return turns_[i] + u * (values_[i] + 0.5 * u * (values_[i + 1] - values_[i]) / cell_);
}

// Nystroem's three-stage fourth-order scheme for theta''. Positions and moment share its Simpson
// weights, so that moment balance holds to rounding.
void Section::advance(double step, double half, double full) {
  const auto shear = [this](double c, double d) { return c * n_y - d * n_x; };
  const double c1 = std::cos(heading);
  const double d1 = std::sin(heading);
  const double q1 = shear(c1, d1);
  const double middle = heading - half - 0.5 * step * moment - 0.125 * step * step * q1;
  const double c2 = std::cos(middle);
  const double d2 = std::sin(middle);
  const double q2 = shear(c2, d2);
  const double end = heading - full - step * moment - 0.5 * step * step * q2;
  const double c3 = std::cos(end);
  const double d3 = std::sin(end);
  const double q3 = shear(c3, d3);
  heading -= full + step * moment + step * step / 6.0 * (q1 + 2.0 * q2);
  const double w = step / 6.0;
  moment += w * (q1 + 4.0 * q2 + q3);
  x -= w * (c1 + 4.0 * c2 + c3);
  y -= w * (d1 + 4.0 * d2 + d3);
}

Rod::Rod(double diameter, double critical, std::vector<Peg> pegs, double cell,
         std::optional<Model> model, double tolerance)
    : cell_(cell),
      choice_(model),
      tolerance_(tolerance),
      room_{0.0, 0.5 * diameter, critical, {{0.0}, 0.0}, checked(std::move(pegs)), 0} {
  if (!(cell >= 0.01 && cell <= 10.0)) throw BadInput("cell_cm must lie between 0.01 and 10");
}

// The choice of the model.

void Rod::step(const std::vector<double>& natural, double length) {
  if (natural.empty() || !std::isfinite(largest(natural))) {
    throw BadInput("free curvature must be a finite number or a one-dimensional array");
  }
  if (!(std::isfinite(length) && length > 0.0)) throw BadInput("length must be positive");
  if (natural.size() > 1 || choice_ == Model::kElastica) {
    take_elastica(natural, length);
  } else if (choice_ == Model::kArc) {
    set_free(arc_nodes(natural[0], length, cells_for(length)), natural[0], length);
  } else if (choice_ == Model::kBeam) {
    try_beam(natural[0], length, kInfinite);
  } else if (!try_arc(natural[0], length) && !try_beam(natural[0], length, tolerance_)) {
    take_elastica(natural, length);
  }
  ++counts_[static_cast<int>(model_)];
}

// Takes the arc if the body was free, moves little and stays clear of every peg.
bool Rod::try_arc(double natural, double length) {
  if (touching() > 0) return false;
  if (!room_.pegs.empty()) {
    if (room_.length > 0.0 ? travel({natural}, length) > 1.0 : natural != 0.0) return false;
  }
  return lie_clear(natural, length);
}

bool Rod::lie_clear(double natural, double length) {
  std::vector<Node> nodes = arc_nodes(natural, length, cells_for(length));
  const Centreline line{nodes.data(), static_cast<int>(nodes.size()), {0.0, diameter()}};
  for (const Peg& peg : room_.pegs) {
    if (line.gap_to(peg, room_.tube_radius).distance <= 0.0) return false;
  }
  set_free(std::move(nodes), natural, length);
  return true;
}

void Rod::set_free(std::vector<Node> nodes, double natural, double length) {
  reactions_ = {};
  nodes_ = std::move(nodes);
  base_moment_ = error_bound_ = 0.0;
  model_ = Model::kArc;
  status_ = Status::kConverged;
  elastica_current_ = false;
  room_.length = length;
  room_.natural = {{natural}, length};
}

bool Rod::try_beam(double natural, double length, double tolerance) {
  std::optional<Beam> beam =
      bend_beam(natural, length, room_.tube_radius, room_.critical, room_.pegs, cells_for(length));
  if (!beam || beam->error_bound > tolerance) return false;
  set_free(std::move(beam->nodes), natural, length);
  reactions_.contacts = std::move(beam->contacts);
  reactions_.fold_angle = beam->fold_angle;
  base_moment_ = beam->base_moment;
  error_bound_ = beam->error_bound;
  model_ = Model::kBeam;
  return true;
}

void Rod::take_elastica(const std::vector<double>& natural, double length) {
  if (!elastica_current_) {
    const std::vector<double> before = room_.natural.values();
    const double length_before = room_.length;
    if (model_ == Model::kArc && length_before > 0.0) {
      assume_free(before[0], length_before);
    } else {
      reset();
      if (length_before > 0.0) follow(before, length_before);
    }
  }
  follow(natural, length);
  error_bound_ = status_ == Status::kApproximate ? 1e-3 : 1e-5;
}

void Rod::place(std::vector<Peg> pegs) {
  const std::vector<double> natural = room_.natural.values();
  const double length = room_.length;
  room_.pegs = checked(std::move(pegs));
  reset();
  if (length == 0.0 || (natural.size() == 1 && lie_clear(natural[0], length))) return;
  step({0.0}, length);
  step(natural, length);
}

void Rod::reset() {
  reactions_ = {};
  jacobian_.clear();
  determinant_sign_ = 0;
  tip_.reset();
  bend_.clear();
  room_.length = 0.0;
  room_.cells = 0;
  room_.natural = {{0.0}, 0.0};
  elastica_current_ = false;
  model_ = Model::kArc;
}

void Rod::assume_free(double natural, double length) {
  reset();
  advance({natural}, length, 0.0);
}

void Rod::set_critical(double critical) {
  room_.critical = critical;
  if (!std::isfinite(critical)) reactions_.folding = 0, reactions_.fold_angle = 0.0;
  jacobian_.clear();
  determinant_sign_ = 0;
}

// Following the elastica.

// How far the free tip may be expected to move.
double Rod::travel(const std::vector<double>& natural, double length) const {
  const std::size_t size = std::max(natural.size(), room_.natural.values().size());
  const std::vector<double> from = refined(room_.natural.values(), size);
  std::vector<double> change = refined(natural, size);
  for (std::size_t i = 0; i < size; ++i) change[i] -= from[i];
  const double longer = std::max(length, room_.length);
  return largest(change) * longer * longer / 2.0 + std::fabs(length - room_.length);
}

// The way is cut into pieces in which the free tip would travel at most 1 cm.
void Rod::follow(const std::vector<double>& natural, double length) {
  if (room_.length == 0.0) {
    // Start straight, except that a rod that no peg can touch starts where it is.
    const bool free = room_.pegs.empty() && loads_.empty() && largest(natural) * length < 50.0;
    advance(free ? natural : scaled(natural, 0.0), length, 0.0);
  }
  const std::size_t size = std::max(natural.size(), room_.natural.values().size());
  const std::vector<double> from = refined(room_.natural.values(), size);
  const std::vector<double> to = refined(natural, size);
  const double length_from = room_.length;
  const double way = travel(natural, length);
  const int pieces = std::max(1, static_cast<int>(std::ceil(way)));
  std::vector<double> now(size);
  for (int i = 1; i <= pieces; ++i) {
    const double u = static_cast<double>(i) / pieces;
    for (std::size_t k = 0; k < size; ++k) now[k] = from[k] + u * (to[k] - from[k]);
    advance(now, length_from + u * (length - length_from), way / pieces);
  }
}

void Rod::advance(const std::vector<double>& natural, double length, double travel) {
  if (length != room_.length) remesh(length);
  room_.natural = {natural, length};
  solve(travel);
}

int Rod::cells_for(double length) const {
  return std::max(kLeastCells, static_cast<int>(std::ceil(length / cell_ - 1e-9)));
}

void Rod::remesh(double length) {
  const int cells = cells_for(length);
  std::vector<double> bend(cells, 0.0);
  if (room_.cells > 0) {
    const double old = room_.length / room_.cells;
    for (int i = 0; i < cells; ++i) {
      const double s = (i + 0.5) * length / cells;
      if (s <= room_.length - 0.5 * old) bend[i] = interpolated(bend_, 0.5 * old, old, s);
    }
    // Growth happens at the tip: places counted from the far end of the left side move.
    const double change = length - room_.length;
    for (Contact& contact : reactions_.contacts) {
      const Kind kind = skin(contact).kind;
      if (kind == Kind::kLeftSide) {
        contact.place += 2.0 * change;
      } else if (kind != Kind::kRightSide) {
        contact.place += change;
      }
    }
    jacobian_.clear();
  }
  bend_ = std::move(bend);
  room_.length = length;
  room_.cells = cells;
}

bool Rod::load(const std::vector<Load>& loads, const std::vector<double>& natural, double length) {
  double heaviest = 0.0;
  for (const Load& load : loads) heaviest = std::max(heaviest, std::hypot(load.x, load.y));
  double step = 1.0;
  if (heaviest > 0.0) {
    step /= std::max(1.0, std::ceil(heaviest * length * length + largest(natural) * length));
  }
  const auto raise_to = [&](double share) {
    loads_ = loads;
    for (Load& load : loads_) {
      load = {load.arc, share * load.normal, share * load.tangential, share * load.x,
              share * load.y};
    }
    tip_.reset();
    advance(scaled(natural, share), length, 0.0);
    return !nodes_.empty();
  };
  raise_to(0.0);
  double done = 0.0;
  while (done < 1.0 - 1e-12) {
    const Rod before = *this;
    const double next = std::min(1.0, done + step);
    if (raise_to(next)) {
      done = next;
    } else {
      *this = before;
      step /= 2.0;
      if (step < 1e-4) return false;
    }
  }
  return true;
}

void Rod::press(std::vector<Contact> contacts, double fold_angle,
                const std::vector<double>& natural, double length) {
  reset();
  room_.length = length;
  room_.cells = cells_for(length);
  room_.natural = {natural, length};
  reactions_ = {std::move(contacts), 0, fold_angle, 0.0};
  std::vector<Pose> frames;
  base_moment_ = shoot(reactions_, frames, &nodes_).moment;
  model_ = Model::kElastica;
}

// One quasi-static step from the last state.
void Rod::solve(double travel) {
  const Reactions before = reactions_;
  const std::optional<Node> tip_before = tip_;
  bool found = find_reactions();
  // A solution much farther away than the tip may move is checked by relaxation.
  if (found && tip_before && apart(nodes_.back(), *tip_before) > 5.0 * travel + 0.3) found = false;
  status_ = Status::kConverged;
  if (!found && loads_.empty()) {
    status_ = Status::kRelaxed;
    Relaxed relaxed = relax(room_, bend_, before.fold_angle);
    Reactions near{std::move(relaxed.contacts), 0, 0.0, 0.0};
    if (std::fabs(relaxed.fold_angle) > 1e-3) {
      near.folding = relaxed.fold_angle > 0.0 ? 1 : -1;
      near.fold_angle = relaxed.fold_angle;
    }
    jacobian_.clear();
    determinant_sign_ = 0;
    reactions_ = near;
    found = find_reactions() && apart(nodes_.back(), relaxed.nodes.back()) <= 1.0;
    if (!found) {
      // The relaxed shape is an equilibrium to the accuracy of penalties.
      status_ = Status::kApproximate;
      jacobian_.clear();
      determinant_sign_ = 0;
      reactions_ = std::move(near);
      nodes_ = std::move(relaxed.nodes);
      base_moment_ = relaxed.bend[0];
      found = true;
    }
  }
  model_ = Model::kElastica;
  elastica_current_ = true;
  if (!found) {
    status_ = Status::kApproximate;
    reactions_ = before;
    jacobian_.clear();
    nodes_.clear();
    return;
  }
  tip_ = nodes_.back();
  // Contact curvature at the cells' middles, for the next relaxation.
  std::size_t k = 0;
  for (int i = 0; i < room_.cells; ++i) {
    const double s = (i + 0.5) * room_.length / room_.cells;
    while (k + 2 < nodes_.size() && nodes_[k + 1].s <= s) ++k;
    const double width = nodes_[k + 1].s - nodes_[k].s;
    const double u = width > 0.0 ? (s - nodes_[k].s) / width : 0.0;
    bend_[i] = nodes_[k].curvature + u * (nodes_[k + 1].curvature - nodes_[k].curvature) -
               room_.natural.at(s);
  }
}

// Newton inside; contacts and fold are switched outside until all inequalities hold.
bool Rod::find_reactions() {
  const int sign_before = determinant_sign_;
  bool same = sign_before != 0;  // the unknowns are those of the last step
  const auto switched = [&] {
    jacobian_.clear();
    same = false;
  };
  auto& contacts = reactions_.contacts;
  for (int round = 0; round < 30; ++round) {
    int sign = 0;
    if (!packed().empty()) {
      if (!newton(sign)) return false;
      if (same && sign != sign_before) return false;  // past a limit point: no longer stable
    }
    // Release a contact that pulls: the strongest pull first.
    const auto pulling =
        std::min_element(contacts.begin(), contacts.end(),
                         [](const Contact& a, const Contact& b) { return a.force < b.force; });
    if (pulling != contacts.end() && pulling->force < -1e-12) {
      contacts.erase(pulling);
      switched();
      continue;
    }
    if (reactions_.fold_angle * reactions_.folding < -1e-12) {
      reactions_.folding = 0;
      reactions_.fold_angle = 0.0;
      switched();
      continue;
    }
    std::vector<Pose> frames;
    base_moment_ = shoot(reactions_, frames, &nodes_).moment;
    if (reactions_.folding == 0 && std::fabs(base_moment_) > room_.critical * (1.0 + 1e-12)) {
      reactions_.folding = base_moment_ > 0.0 ? 1 : -1;
      switched();
      continue;
    }
    Gap deepest{0.0, 0.0};
    int overlapping = -1;
    for (int i = 0; i < static_cast<int>(room_.pegs.size()); ++i) {
      if (std::any_of(contacts.begin(), contacts.end(),
                      [i](const Contact& contact) { return contact.peg == i; })) {
        continue;
      }
      const Gap gap = centreline().gap_to(room_.pegs[i], room_.tube_radius);
      if (gap.distance < deepest.distance) {
        deepest = gap;
        overlapping = i;
      }
    }
    if (deepest.distance < -kGap) {
      if (deepest.distance < -1.0) return false;
      contacts.push_back({overlapping, 0.0, deepest.place});
      switched();
      continue;
    }
    determinant_sign_ = sign;
    return true;
  }
  return false;
}

// Solves for force and place of each contact, the fold's angle and the base's heading. A change of
// the determinant's sign between start and end means that a limit point was passed: no success.
//
// The Jacobian comes from differences, is kept from the last step, and follows by Broyden's update
// as long as that converges fast.
bool Rod::newton(int& sign) {
  std::vector<double> z = packed();
  const int n = static_cast<int>(z.size());
  const int of_contacts = 2 * touching();
  std::vector<double> res(n), trial(n), next(n), dz(n), lu(n * n);
  bool fresh = false;
  int first = 0;
  residual(z, res);
  double norm = largest(res);
  const auto ends = [&](bool reached) {
    reactions_ = unpacked(z);
    return reached && sign == first;
  };
  for (int iteration = 0; iteration < 40; ++iteration) {
    if (jacobian_.empty()) {
      jacobian_.resize(n * n);
      for (int i = 0; i < n; ++i) {
        const double step = (i < of_contacts ? 1e-5 : 1e-6) / weight(z, i);
        next = z;
        next[i] += step;
        residual(next, trial);
        for (int r = 0; r < n; ++r) jacobian_[r * n + i] = (trial[r] - res[r]) / step;
      }
      fresh = true;
    }
    lu = jacobian_;
    for (int r = 0; r < n; ++r) dz[r] = -res[r];
    sign = solve_linear(lu, dz, n);
    if (sign == 0 || !(largest(dz) < 1e200)) return false;
    if (first == 0) first = sign;
    // Limit the step: 2 cm of sliding, half a radian of fold.
    double shrink = 1.0;
    for (int i = 0; i < n; ++i) {
      if (i < of_contacts && i % 2 == 0) continue;
      const double limit = i < of_contacts ? 2.0 : 0.5;
      if (std::fabs(dz[i]) > limit) shrink = std::min(shrink, limit / std::fabs(dz[i]));
    }
    bool better = false;
    double norm_next = 0.0;
    for (int halving = 0; halving < 7; ++halving) {
      for (int i = 0; i < n; ++i) next[i] = z[i] + shrink * dz[i];
      for (int j = 0; j < touching(); ++j) {
        const double radius = room_.pegs[reactions_.contacts[j].peg].radius;
        const double end = perimeter(room_.length, room_.tube_radius, radius);
        next[2 * j + 1] = std::clamp(next[2 * j + 1], 1e-3, end - 1e-3);
      }
      residual(next, trial);
      norm_next = largest(trial);
      better = norm_next < (1.0 - 0.1 * shrink) * norm || norm_next < kResidual;
      if (better || !fresh) break;
      shrink *= 0.5;
    }
    if (!better) {
      if (fresh) return ends(norm < 1e-7);
      jacobian_.clear();
      continue;
    }
    // Broyden's rank-one update, in comparable units: forces weigh by their lever.
    double length2 = 0.0;
    std::vector<double> weighed(n);
    for (int i = 0; i < n; ++i) {
      const double w = weight(z, i);
      dz[i] = next[i] - z[i];
      weighed[i] = dz[i] * w * w;
      length2 += dz[i] * weighed[i];
    }
    if (length2 > 0.0) {
      for (int r = 0; r < n; ++r) {
        double miss = trial[r] - res[r];
        for (int c = 0; c < n; ++c) miss -= jacobian_[r * n + c] * dz[c];
        for (int c = 0; c < n; ++c) jacobian_[r * n + c] += miss * weighed[c] / length2;
      }
    }
    const bool slow = norm_next > 0.2 * norm;
    z.swap(next);
    res.swap(trial);
    norm = norm_next;
    if (norm < kResidual) return ends(true);
    if (slow) jacobian_.clear();
    fresh = false;
  }
  return ends(norm < 1e-7);
}

// Deflection that a change of an unknown makes, by size: a force works on its lever.
double Rod::weight(const std::vector<double>& z, int unknown) const {
  if (unknown >= 2 * touching() || unknown % 2 == 1) return 1.0;
  const int peg = reactions_.contacts[unknown / 2].peg;
  const double arc = std::max(skin({peg, 0.0, z[unknown + 1]}).arc, 1.0);
  return arc * arc * arc / 3.0;
}

Skin Rod::skin(const Contact& contact) const {
  return skin_at(contact.place, room_.length, room_.tube_radius, room_.pegs[contact.peg].radius);
}

std::vector<double> Rod::packed() const {
  std::vector<double> z;
  for (const Contact& contact : reactions_.contacts) {
    z.push_back(contact.force);
    z.push_back(contact.place);
  }
  if (reactions_.folding != 0) z.push_back(reactions_.fold_angle);
  if (has_dead_loads()) z.push_back(reactions_.base_heading);
  return z;
}

Rod::Reactions Rod::unpacked(const std::vector<double>& z) const {
  Reactions reactions = reactions_;
  auto next = z.begin();
  for (Contact& contact : reactions.contacts) {
    contact.force = *next++;
    contact.place = *next++;
  }
  reactions.fold_angle = reactions.folding != 0 ? *next++ : 0.0;
  reactions.base_heading = has_dead_loads() ? *next++ : 0.0;
  return reactions;
}

bool Rod::has_dead_loads() const {
  return std::any_of(loads_.begin(), loads_.end(),
                     [](const Load& load) { return load.x != 0.0 || load.y != 0.0; });
}

// Peg's centre minus the contact's locus (cm), then the equations of fold and dead loads scaled to
// cm.
void Rod::residual(const std::vector<double>& z, std::vector<double>& out) const {
  const Reactions reactions = unpacked(z);
  std::vector<Pose> frames;
  const Section base = shoot(reactions, frames, nullptr);
  const double cb = std::cos(base.heading);
  const double sb = std::sin(base.heading);
  std::size_t n = 0;
  for (std::size_t j = 0; j < frames.size(); ++j) {
    const Contact& contact = reactions.contacts[j];
    const Peg& peg = room_.pegs[contact.peg];
    const Skin on = skin(contact);
    const double along = peg.radius * on.out_t;
    const double aside = on.offset + peg.radius * on.out_n;
    const double c = std::cos(frames[j].heading);
    const double d = std::sin(frames[j].heading);
    const double dx = frames[j].x + along * c - aside * d - base.x;
    const double dy = frames[j].y + along * d + aside * c - base.y;
    out[n++] = peg.x - (cb * dx + sb * dy);
    out[n++] = peg.y - (cb * dy - sb * dx);
  }
  if (reactions.folding != 0) {
    out[n++] = (reactions.folding * base.moment - room_.critical) * room_.length * room_.length;
  }
  if (has_dead_loads()) out[n++] = (base.heading - reactions.base_heading) * room_.length;
}

// Integrates from the distal end to the base, on an even grid plus the places of the loads and the
// fold's end. `frames` receives each contact's section, in the frame of the distal end as the
// result; `nodes`, if wanted, the whole body in the frame of the base.
Section Rod::shoot(const Reactions& reactions, std::vector<Pose>& frames,
                   std::vector<Node>* nodes) const {
  struct Event {
    double arc;
    int contact, load;
  };
  std::vector<Event> events;  // the most distal first
  const auto insert = [&events](const Event& event) {
    const auto before = [](const Event& a, const Event& b) { return a.arc > b.arc; };
    events.insert(std::upper_bound(events.begin(), events.end(), event, before), event);
  };
  const int contacts = static_cast<int>(reactions.contacts.size());
  for (int j = 0; j < contacts; ++j) insert({skin(reactions.contacts[j]).arc, j, -1});
  for (int i = 0; i < static_cast<int>(loads_.size()); ++i) {
    insert({std::clamp(loads_[i].arc, 0.0, room_.length), -1, i});
  }
  frames.resize(contacts);
  if (nodes) nodes->clear();

  const Fold fold{reactions.fold_angle, diameter()};
  const double ca = std::cos(reactions.base_heading);
  const double sa = std::sin(reactions.base_heading);
  const double h = room_.length / room_.cells;
  double s = nodes ? room_.length : events.empty() ? 0.0 : events.front().arc;
  double turned = room_.natural.turn(s) + fold.turn(s);
  Section at{};
  int k = static_cast<int>(std::ceil(s / h - kTiny)) - 1;
  auto event = events.begin();
  while (true) {
    for (; event != events.end() && event->arc >= s - kTiny; ++event) {
      double tangential, normal;
      if (event->contact >= 0) {
        const Contact& contact = reactions.contacts[event->contact];
        const Skin on = skin(contact);
        frames[event->contact] = {at.x, at.y, at.heading};
        tangential = -contact.force * on.out_t;
        normal = -contact.force * on.out_n;
        if (!is_side(on.kind)) at.moment += -on.offset * tangential;
      } else {
        const Load& load = loads_[event->load];
        tangential = load.tangential;
        normal = load.normal;
        at.n_x += ca * load.x - sa * load.y;
        at.n_y += sa * load.x + ca * load.y;
      }
      const double c = std::cos(at.heading);
      const double d = std::sin(at.heading);
      at.n_x += tangential * c - normal * d;
      at.n_y += tangential * d + normal * c;
    }
    if (nodes) {
      nodes->push_back({s, at.heading, room_.natural.at(s) + at.moment, at.x, at.y});
    }
    if (s <= 0.0) break;
    double to = std::max(k * h, 0.0);
    bool on_grid = true;
    const auto stop_at = [&](double arc) {
      if (arc > to + kTiny) {
        to = arc;
        on_grid = false;
      }
    };
    if (event != events.end()) stop_at(event->arc);
    if (fold.angle != 0.0 && fold.width < s - kTiny) stop_at(fold.width);
    if (on_grid) --k;
    const double middle = 0.5 * (s + to);
    const double turned_middle = room_.natural.turn(middle) + fold.turn(middle);
    const double turned_end = room_.natural.turn(to) + fold.turn(to);
    at.advance(s - to, turned - turned_middle, turned - turned_end);
    turned = turned_end;
    s = to;
  }
  if (nodes) {
    std::reverse(nodes->begin(), nodes->end());
    const double c = std::cos(at.heading);
    const double d = std::sin(at.heading);
    for (Node& node : *nodes) {
      const double dx = node.x - at.x;
      const double dy = node.y - at.y;
      node.x = c * dx + d * dy;
      node.y = c * dy - d * dx;
      node.heading -= at.heading;
    }
  }
  return at;
}

// What is known.

Centreline Rod::centreline() const {
  return {nodes_.data(), static_cast<int>(nodes_.size()), {reactions_.fold_angle, diameter()}};
}

double Rod::axial_push() const {
  double total = 0.0;
  for (const Contact& contact : reactions_.contacts) total += contact.force * skin(contact).out_t;
  return total;
}

std::vector<ContactReport> Rod::contacts() const {
  std::vector<ContactReport> reports;
  for (const Contact& contact : reactions_.contacts) {
    const Skin on = skin(contact);
    const Pose pose = centreline().pose(on.arc);
    const double c = std::cos(pose.heading);
    const double d = std::sin(pose.heading);
    const double tangential = -contact.force * on.out_t;
    const double normal = -contact.force * on.out_n;
    reports.push_back({contact.peg, on.arc, on.kind, normal, tangential,
                       is_side(on.kind) ? 0.0 : -on.offset * tangential, pose.x - on.offset * d,
                       pose.y + on.offset * c, tangential * c - normal * d,
                       tangential * d + normal * c});
  }
  std::stable_sort(reports.begin(), reports.end(),
                   [](const auto& a, const auto& b) { return a.arc < b.arc; });
  return reports;
}

}  // namespace thigmo::mechanics
