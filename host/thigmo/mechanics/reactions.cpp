// One equilibrium of the rod: integration from tip to base with its derivatives, Newton for what
// obstacles and base do to it, and the active set around Newton.
#include <algorithm>
#include <cmath>

#include "linear.h"
#include "rod.h"

namespace thigmo::mechanics {
namespace {

constexpr double kTiny = 1e-9;      // cm, between nodes
constexpr double kGap = 1e-7;       // cm, an overlap that counts
constexpr double kResidual = 1e-9;  // cm
constexpr double kTurnCm = 10.0;    // of an equation of directions: cm for each radian
constexpr double kSlipCm = 0.1;     // slip up to which friction is elastic: the cloth's own give

// A vector in the frame of a heading, in the frame that the heading is given in.
struct Turned : Heading {
  explicit Turned(double heading) : Heading{std::cos(heading), std::sin(heading)} {}
  double x(double along, double aside) const { return along * c - aside * d; }
  double y(double along, double aside) const { return along * d + aside * c; }
};

}  // namespace

// Turns (c, d), a cosine and a sine, by a small angle: its series to rounding, several times as
// fast as the library's functions, in which a step of the integration would spend nearly all of its
// time.
Heading Heading::turned(double angle) const {
  if (!(std::fabs(angle) < 0.3)) {
    const double a = std::cos(angle);
    const double b = std::sin(angle);
    return {c * a - d * b, d * a + c * b};
  }
  const double u = angle * angle;
  const double b =
      angle * (1.0 - u * (1.0 / 6.0 -
                          u * (1.0 / 120.0 - u * (1.0 / 5040.0 -
                                                  u * (1.0 / 362880.0 - u * (1.0 / 39916800.0))))));
  const double a =
      1.0 -
      u * (0.5 - u * (1.0 / 24.0 -
                      u * (1.0 / 720.0 -
                           u * (1.0 / 40320.0 - u * (1.0 / 3628800.0 - u * (1.0 / 479001600.0))))));
  return {c * a - d * b, d * a + c * b};
}

// Nystroem's three-stage fourth-order scheme for theta''. Positions and moment share its Simpson
// weights, so that moment balance holds to rounding. Derivatives are those of the scheme itself.
void Section::advance(double step, double half, double full, std::vector<Tangent>& tangents) {
  const double h2 = step * step;
  const double w = step / 6.0;
  const auto [c1, d1] = toward;
  const double q1 = c1 * n_y - d1 * n_x;
  const auto [c2, d2] = toward.turned(-half - 0.5 * step * moment - 0.125 * h2 * q1);
  const double q2 = c2 * n_y - d2 * n_x;
  const auto [c3, d3] = toward.turned(-full - step * moment - 0.5 * h2 * q2);
  const double q3 = c3 * n_y - d3 * n_x;
  const double p1 = c1 * n_x + d1 * n_y;
  const double p2 = c2 * n_x + d2 * n_y;
  const double p3 = c3 * n_x + d3 * n_y;
  for (Tangent& t : tangents) {
    const double by_q1 = c1 * t.n_y - d1 * t.n_x - p1 * t.heading;
    const double by_middle = t.heading - t.half - 0.5 * step * t.moment - 0.125 * h2 * by_q1;
    const double by_q2 = c2 * t.n_y - d2 * t.n_x - p2 * by_middle;
    const double by_end = t.heading - t.full - step * t.moment - 0.5 * h2 * by_q2;
    const double by_q3 = c3 * t.n_y - d3 * t.n_x - p3 * by_end;
    t.x += w * (d1 * t.heading + 4.0 * d2 * by_middle + d3 * by_end);
    t.y -= w * (c1 * t.heading + 4.0 * c2 * by_middle + c3 * by_end);
    t.heading -= t.full + step * t.moment + h2 / 6.0 * (by_q1 + 2.0 * by_q2);
    t.moment += w * (by_q1 + 4.0 * by_q2 + by_q3);
  }
  const double turn = full + step * moment + h2 / 6.0 * (q1 + 2.0 * q2);
  heading -= turn;
  toward = toward.turned(-turn);
  moment += w * (q1 + 4.0 * q2 + q3);
  x -= w * (c1 + 4.0 * c2 + c3);
  y -= w * (d1 + 4.0 * d2 + d3);
}

// Newton inside; contacts, their parts and the fold are switched outside until all inequalities
// hold.
bool Rod::find_reactions() {
  const int sign_before = determinant_sign_;
  bool same = sign_before != 0;  // the unknowns are those of the last step
  auto& contacts = reactions_.contacts;
  for (int round = 0; round < 30; ++round) {
    int sign = 0;
    if (!packed().empty()) {
      if (!newton(sign)) return false;
      if (same && sign != sign_before) return false;  // past a limit point: no longer stable
    } else {
      linearise({});
    }
    same = false;  // unless nothing is switched, and this round is the last
    // Release a contact that pulls: the strongest pull first.
    const auto pulling =
        std::min_element(contacts.begin(), contacts.end(),
                         [](const Contact& a, const Contact& b) { return a.force < b.force; });
    if (pulling != contacts.end() && pulling->force < -1e-12) {
      contacts.erase(pulling);
      continue;
    }
    if (reactions_.fold_angle * reactions_.folding < -1e-12) {
      reactions_.folding = 0;
      reactions_.fold_angle = 0.0;
      continue;
    }
    base_moment_ = shot_.base.moment;
    if (reactions_.folding == 0 && std::fabs(base_moment_) > scene_.critical * (1.0 + 1e-12)) {
      reactions_.folding = base_moment_ > 0.0 ? 1 : -1;
      continue;
    }
    if (switch_parts()) continue;
    Gap deepest{0.0, 0.0};
    int overlapping = -1;
    for (int i = 0; i < static_cast<int>(scene_.pegs.size()); ++i) {
      const Peg& peg = scene_.pegs[i];
      const bool touched = std::any_of(contacts.begin(), contacts.end(),
                                       [i](const Contact& contact) { return contact.peg == i; });
      if (touched && !peg.is_wall()) continue;
      for (int part = 0; part < (peg.is_wall() ? kParts : 1); ++part) {
        const Gap gap = centreline().gap_to(peg, static_cast<Part>(part), scene_.outline());
        if (gap.distance < deepest.distance && !(touched && already_touched(i, gap.place))) {
          deepest = gap;
          overlapping = i;
        }
      }
    }
    if (deepest.distance < -kGap) {
      if (deepest.distance < -1.0) return false;
      contacts.push_back({overlapping, 0.0, deepest.place, deepest.part, deepest.along});
      contacts.back().onward = way_along(contacts.back());
      continue;
    }
    determinant_sign_ = sign;
    return true;
  }
  return false;
}

// Whether a contact with an obstacle is at this place of the skin: a wall may be touched at
// several.
bool Rod::already_touched(int peg, double place) const {
  return std::any_of(reactions_.contacts.begin(), reactions_.contacts.end(),
                     [peg, place](const Contact& contact) {
                       return contact.peg == peg && std::fabs(contact.place - place) < kApart;
                     });
}

// Lets a contact go on from a wall's straight part to one of its ends, and back.
bool Rod::switch_parts() {
  bool switched = false;
  for (std::size_t j = 0; j < reactions_.contacts.size(); ++j) {
    Contact& contact = reactions_.contacts[j];
    const Peg& wall = scene_.pegs[contact.peg];
    if (!wall.is_wall()) continue;
    const double extent = std::hypot(wall.to_x, wall.to_y);
    const Shot::Touch& touch = shot_.touches[j];
    // How much the wall's surface, where it touches, faces towards the wall's last end.
    const double facing = -(touch.out_x * wall.to_x + touch.out_y * wall.to_y) / extent;
    const Part part = contact.part;
    if (part == Part::kStraight) {
      if (contact.along < 0.0) contact.part = Part::kFirstEnd;
      if (contact.along > extent) contact.part = Part::kLastEnd;
    } else if (part == Part::kFirstEnd ? facing > kTiny : facing < -kTiny) {
      contact.part = Part::kStraight;
    }
    if (contact.part == part) continue;
    contact.along = std::clamp(part == Part::kLastEnd ? extent : contact.along, 0.0, extent);
    contact.last_along = contact.along;
    contact.onward = way_along(contact);
    switched = true;
  }
  return switched;
}

// Solves for force and place of each contact, and the fold's angle. A change of the determinant's
// sign between start and end means that a limit point was passed: no success.
bool Rod::newton(int& sign) {
  std::vector<double> z = packed();
  const int n = static_cast<int>(z.size());
  std::vector<double> limits;  // of a step: none for a force, 2 cm of sliding, 0.5 rad of fold
  for (const Contact& contact : reactions_.contacts) {
    limits.insert(limits.end(), {1e30, 2.0});
    if (contact.part == Part::kStraight) limits.push_back(2.0);
  }
  if (reactions_.folding != 0) limits.push_back(0.5);
  std::vector<double> next(n), dz(n), matrix(n * n);
  int first = 0;
  linearise(z);
  double norm = largest(residual_);
  for (int iteration = 0; iteration < 40; ++iteration) {
    for (int r = 0; r < n; ++r) {
      dz[r] = -residual_[r];
      for (int c = 0; c < n; ++c) matrix[r * n + c] = jacobian_[r * shot_.directions + c];
    }
    sign = solve_linear(matrix, dz, n);
    if (sign == 0 || !(largest(dz) < 1e200)) return false;
    if (first == 0) first = sign;
    if (norm < kResidual) break;
    double shrink = 1.0;
    for (int i = 0; i < n; ++i) {
      if (std::fabs(dz[i]) > limits[i]) shrink = std::min(shrink, limits[i] / std::fabs(dz[i]));
    }
    bool better = false;
    double norm_next = 0.0;
    for (int halving = 0; halving < 7 && !better; ++halving) {
      for (int i = 0; i < n; ++i) next[i] = z[i] + shrink * dz[i];
      int i = 1;
      for (const Contact& contact : reactions_.contacts) {
        const double end = scene_.outline().perimeter(scene_.pegs[contact.peg].radius);
        next[i] = std::clamp(next[i], 1e-3, end - 1e-3);
        i += contact.part == Part::kStraight ? 3 : 2;
      }
      linearise(next);
      norm_next = largest(residual_);
      better = norm_next < (1.0 - 0.1 * shrink) * norm || norm_next < kResidual;
      shrink *= 0.5;
    }
    if (!better) {
      linearise(z);
      break;
    }
    z.swap(next);
    norm = norm_next;
  }
  reactions_ = unpacked(z);
  return norm < 1e-7 && sign == first;
}

std::vector<double> Rod::packed() const {
  std::vector<double> z;
  for (const Contact& contact : reactions_.contacts) {
    z.push_back(contact.force);
    z.push_back(contact.place);
    if (contact.part == Part::kStraight) z.push_back(contact.along);
  }
  if (reactions_.folding != 0) z.push_back(reactions_.fold_angle);
  return z;
}

Rod::Reactions Rod::unpacked(const std::vector<double>& z) const {
  Reactions reactions = reactions_;
  auto next = z.begin();
  for (Contact& contact : reactions.contacts) {
    contact.force = *next++;
    contact.place = *next++;
    if (contact.part == Part::kStraight) contact.along = *next++;
  }
  reactions.fold_angle = reactions.folding != 0 ? *next++ : 0.0;
  return reactions;
}

// Moves the unknowns along with a change of the natural curvature, as the last equilibrium's
// derivatives and how they changed since the one before have it: a start from which Newton needs a
// step or two less.
void Rod::predict(double change) {
  std::vector<double> z = packed();
  const int n = static_cast<int>(z.size());
  const int directions = shot_.directions;
  const std::vector<double> slope_before = std::move(slope_);
  slope_.clear();
  if (n == 0 || static_cast<int>(residual_.size()) != n ||
      static_cast<int>(jacobian_.size()) != n * directions) {
    return;
  }
  std::vector<double> matrix(n * n), slope(n);
  for (int r = 0; r < n; ++r) {
    slope[r] = -jacobian_[r * directions + n];
    for (int c = 0; c < n; ++c) matrix[r * n + c] = jacobian_[r * directions + c];
  }
  if (solve_linear(matrix, slope, n) == 0) return;
  std::vector<double> dz(n);
  const bool curved = static_cast<int>(slope_before.size()) == n && last_change_ != 0.0;
  for (int r = 0; r < n; ++r) {
    const double bend = curved ? (slope[r] - slope_before[r]) / last_change_ : 0.0;
    dz[r] = change * (slope[r] + 0.5 * change * bend);
  }
  slope_ = std::move(slope);
  last_change_ = change;
  int i = 0;
  for (const Contact& contact : reactions_.contacts) {
    if (!(std::fabs(dz[i + 1]) < 0.5) || z[i] + dz[i] < 0.0) return;
    i += contact.part == Part::kStraight ? 3 : 2;
  }
  for (int r = 0; r < n; ++r) z[r] += dz[r];
  reactions_ = unpacked(z);
}

// Obstacle's place minus the contact's locus (cm), for a wall's straight part also that the skin
// runs along it, then the fold's equation scaled to cm; and the derivatives by all directions.
void Rod::linearise(const std::vector<double>& z) {
  const Reactions reactions = unpacked(z);
  shoot(reactions);
  const int n = static_cast<int>(z.size());
  const int directions = shot_.directions;
  residual_.assign(n, 0.0);
  jacobian_.assign(n * directions, 0.0);
  const Section& base = shot_.base;
  const double compliance = scene_.base_compliance;
  const double turn = compliance * base.moment - base.heading;
  const Turned world(turn);
  int row = 0;
  for (std::size_t j = 0; j < reactions.contacts.size(); ++j) {
    const Contact& contact = reactions.contacts[j];
    const Peg& peg = scene_.pegs[contact.peg];
    const bool straight = contact.part == Part::kStraight;
    const Pose& contact_pose = shot_.at[j];
    const Skin on = skin(contact);
    const Skin slope = scene_.outline().slope(contact.place, peg.radius);
    const Push pushed = push(contact);
    const double along = on.ahead + peg.radius * on.out_t + peg.compliance * pushed.tangential;
    const double aside = on.offset + peg.radius * on.out_n + peg.compliance * pushed.normal;
    const Turned local(contact_pose.heading);
    const Turned deformed(contact_pose.heading + turn);
    const double dx = contact_pose.x + local.x(along, aside) - base.x;
    const double dy = contact_pose.y + local.y(along, aside) - base.y;
    const double x = world.x(dx, dy);
    const double y = world.y(dx, dy);
    const double out_x = deformed.x(on.out_t, on.out_n);
    const double out_y = deformed.y(on.out_t, on.out_n);
    shot_.touches[j] = {x,
                        y,
                        out_x,
                        out_y,
                        deformed.x(pushed.tangential, pushed.normal),
                        deformed.y(pushed.tangential, pushed.normal)};
    const double extent = std::hypot(peg.to_x, peg.to_y);
    const double ux = straight ? peg.to_x / extent : 0.0;
    const double uy = straight ? peg.to_y / extent : 0.0;
    const double end = contact.part == Part::kLastEnd ? 1.0 : 0.0;
    residual_[row] = peg.x + end * peg.to_x + contact.along * ux - x;
    residual_[row + 1] = peg.y + end * peg.to_y + contact.along * uy - y;
    if (straight) residual_[row + 2] = kTurnCm * (out_x * ux + out_y * uy);
    for (int d = 0; d < directions; ++d) {
      const Tangent& frame = shot_.at_by[j * directions + d];
      const Tangent& foot = shot_.base_by[d];
      const double turned = compliance * foot.moment - foot.heading;
      const Push pushed = push_by(contact, static_cast<int>(j), row, d, directions);
      const bool moves = d == row + 1;
      const double by_along =
          moves * (slope.ahead + peg.radius * slope.out_t) + peg.compliance * pushed.tangential;
      const double by_aside =
          moves * (slope.offset + peg.radius * slope.out_n) + peg.compliance * pushed.normal;
      const double by_dx =
          frame.x + local.x(by_along, by_aside) - frame.heading * local.y(along, aside) - foot.x;
      const double by_dy =
          frame.y + local.y(by_along, by_aside) + frame.heading * local.x(along, aside) - foot.y;
      double* column = &jacobian_[row * directions + d];
      column[0] = -world.x(by_dx, by_dy) + turned * y;
      column[directions] = -world.y(by_dx, by_dy) - turned * x;
      if (!straight) continue;
      if (d == row + 2) {
        column[0] += ux;
        column[directions] += uy;
      }
      const double facing = turned + frame.heading;
      const double by_out_x = moves * deformed.x(slope.out_t, slope.out_n) - facing * out_y;
      const double by_out_y = moves * deformed.y(slope.out_t, slope.out_n) + facing * out_x;
      column[2 * directions] = kTurnCm * (by_out_x * ux + by_out_y * uy);
    }
    row += straight ? 3 : 2;
  }
  if (reactions.folding != 0) {
    const double scale = scene_.length * scene_.length;
    residual_[row] = (reactions.folding * base.moment - scene_.critical) * scale;
    for (int d = 0; d < directions; ++d) {
      jacobian_[row * directions + d] = reactions.folding * shot_.base_by[d].moment * scale;
    }
  }
}

// How the unknowns, and the shares of friction, follow each parameter of a Sweep: [direction]
// [parameter].
std::vector<double> Rod::sensitivity() const {
  const int n = static_cast<int>(residual_.size());
  const int directions = shot_.directions;
  const int obstacles = static_cast<int>(scene_.pegs.size());
  const int of_body = Sweep::kOfObstacle * obstacles;
  const int parameters = of_body + Sweep::kOfBody;
  std::vector<double> total(directions * parameters, 0.0);
  // The equations' own derivatives by the parameters.
  std::vector<double> changes(n * parameters, 0.0);
  const auto change = [&](int row, int parameter) -> double& {
    return changes[row * parameters + parameter];
  };
  const double base_moment = shot_.base.moment;
  int row = 0;
  for (std::size_t j = 0; j < reactions_.contacts.size(); ++j) {
    const Contact& contact = reactions_.contacts[j];
    const Peg& peg = scene_.pegs[contact.peg];
    const Shot::Touch& touch = shot_.touches[j];
    const int of_peg = Sweep::kOfObstacle * contact.peg;
    change(row, of_peg + Sweep::kX) = 1.0;
    change(row + 1, of_peg + Sweep::kY) = 1.0;
    change(row, of_peg + Sweep::kRadius) = -touch.out_x;
    change(row + 1, of_peg + Sweep::kRadius) = -touch.out_y;
    change(row, of_peg + Sweep::kCompliance) = -touch.push_x;
    change(row + 1, of_peg + Sweep::kCompliance) = -touch.push_y;
    change(row, of_body + Sweep::kBaseCompliance) = base_moment * touch.y;
    change(row + 1, of_body + Sweep::kBaseCompliance) = -base_moment * touch.x;
    if (contact.part == Part::kLastEnd) {
      change(row, of_peg + Sweep::kToX) = 1.0;
      change(row + 1, of_peg + Sweep::kToY) = 1.0;
    }
    if (contact.part == Part::kStraight) {
      const double extent = std::hypot(peg.to_x, peg.to_y);
      const double ux = peg.to_x / extent;
      const double uy = peg.to_y / extent;
      // The wall's direction turns by this for each cm that its last end moves.
      const double turns[2] = {-uy / extent, ux / extent};
      for (int k = 0; k < 2; ++k) {
        change(row, of_peg + Sweep::kToX + k) = -contact.along * turns[k] * uy;
        change(row + 1, of_peg + Sweep::kToX + k) = contact.along * turns[k] * ux;
        change(row + 2, of_peg + Sweep::kToX + k) =
            kTurnCm * turns[k] * (touch.out_y * ux - touch.out_x * uy);
      }
      change(row + 2, of_body + Sweep::kBaseCompliance) =
          kTurnCm * base_moment * (touch.out_x * uy - touch.out_y * ux);
      ++row;
    }
    row += 2;
    if (friction_ > 0.0) {
      const int share = n + 1 + static_cast<int>(j);
      total[share * parameters + of_body + Sweep::kFriction] = rubbing(contact);
    }
  }
  if (reactions_.folding != 0)
    change(row, of_body + Sweep::kCritical) = -scene_.length * scene_.length;
  std::vector<double> matrix(n * n), column(n);
  for (int p = 0; p < parameters; ++p) {
    bool moves = false;
    for (int r = 0; r < n; ++r) {
      column[r] = -change(r, p);
      for (int d = n + 1; d < directions; ++d) {
        column[r] -= jacobian_[r * directions + d] * total[d * parameters + p];
      }
      moves |= column[r] != 0.0;
      for (int c = 0; c < n; ++c) matrix[r * n + c] = jacobian_[r * directions + c];
    }
    if (!moves || solve_linear(matrix, column, n) == 0) continue;
    for (int r = 0; r < n; ++r) total[r * parameters + p] = column[r];
  }
  return total;
}

// Integrates from the tip to the base, on an even grid plus the places of the contacts and the ends
// of the fold and of the rest shape's pieces, each in the frame of the distal end; then lays the
// nodes into the room.
void Rod::shoot(const Reactions& reactions) {
  struct Event {
    Skin on;
    int contact, unknown;
  };
  std::vector<Event> events;
  int unknowns = 0;
  for (const Contact& contact : reactions.contacts) {
    events.push_back({skin(contact), static_cast<int>(events.size()), unknowns});
    unknowns += contact.part == Part::kStraight ? 3 : 2;
  }
  const int fold_direction = unknowns;
  unknowns += reactions.folding != 0;
  const int natural_direction = unknowns;
  const int contacts = static_cast<int>(events.size());
  const int directions = unknowns + 1 + (friction_ > 0.0 ? contacts : 0);
  std::sort(events.begin(), events.end(), [](const Event& a, const Event& b) {
    return a.on.arc != b.on.arc ? a.on.arc > b.on.arc : a.contact < b.contact;
  });
  const Fold fold{reactions.fold_angle, diameter()};
  const Fold unit{1.0, diameter()};
  const double outermost = events.empty() ? 0.0 : events.front().on.arc;

  nodes_.clear();
  shot_.directions = directions;
  shot_.at.resize(contacts);
  shot_.touches.resize(contacts);
  shot_.at_by.resize(contacts * directions);
  shot_.above.clear();
  shot_.below.clear();
  std::vector<Tangent>& tangents = shot_.base_by;
  tangents.clear();  // empty until the outermost contact: beyond, nothing bends the body
  Section section = Section::at_origin(0.0);
  const double h = scene_.length / scene_.cells;
  double s = scene_.length;
  const auto turn_at = [&](double arc) {
    return scene_.natural * arc + fold.turn(arc) + scene_.rest.turn(arc);
  };
  double turned = turn_at(s);
  int k = static_cast<int>(std::ceil(s / h - kTiny)) - 1;
  auto event = events.begin();

  // Derivatives of the body's own turn, from the outermost contact to here.
  const auto turn_by = [&](int direction, double arc) {
    if (direction == natural_direction) return arc;
    return direction == fold_direction ? unit.turn(arc) : 0.0;
  };
  const auto note = [&](std::vector<Shot::NodeTangent>& nodes) {
    for (int d = 0; d < directions; ++d) {
      const double natural = d == natural_direction ? 1.0 : 0.0;
      nodes.push_back(tangents.empty()
                          ? Shot::NodeTangent{turn_by(d, s) - turn_by(d, outermost), natural}
                          : Shot::NodeTangent{tangents[d].heading, natural + tangents[d].moment});
    }
  };
  while (true) {
    note(shot_.above);
    for (; event != events.end() && event->on.arc >= s - kTiny; ++event) {
      if (tangents.empty()) tangents.assign(directions, Tangent{});
      const Contact& contact = reactions.contacts[event->contact];
      const Skin& on = event->on;
      const Skin slope = scene_.outline().slope(contact.place, scene_.pegs[contact.peg].radius);
      const Push push = this->push(contact);
      const auto [c, d] = section.toward;
      const double force_x = push.tangential * c - push.normal * d;
      const double force_y = push.tangential * d + push.normal * c;
      const double couple = on.ahead * push.normal - on.offset * push.tangential;
      shot_.at[event->contact] = {section.x, section.y, section.heading};
      for (int i = 0; i < directions; ++i) {
        Tangent& t = tangents[i];
        const bool moves = i == event->unknown + 1;
        // Follow the contact's section along the body; what bends both sides alike cancels out.
        const double step = moves ? slope.arc : 0.0;
        t.x += step * c;
        t.y += step * d;
        t.heading += step * section.moment;
        t.moment -= step * (c * section.n_y - d * section.n_x);
        Tangent& frame = shot_.at_by[event->contact * directions + i];
        frame = t;
        frame.heading += step * (scene_.natural + scene_.rest.curvature(s) +
                                 (s < fold.width ? fold.angle / fold.width : 0.0));
        const Push pushed = push_by(contact, event->contact, event->unknown, i, directions);
        t.moment += on.ahead * pushed.normal - on.offset * pushed.tangential;
        if (moves) t.moment += slope.ahead * push.normal - slope.offset * push.tangential;
        t.n_x += pushed.tangential * c - pushed.normal * d - force_y * frame.heading;
        t.n_y += pushed.tangential * d + pushed.normal * c + force_x * frame.heading;
        // And back to where it was, now on its near side.
        t.x -= step * c;
        t.y -= step * d;
        t.heading -= step * (section.moment + couple);
        t.moment += step * (c * (section.n_y + force_y) - d * (section.n_x + force_x));
      }
      section.moment += couple;
      section.n_x += force_x;
      section.n_y += force_y;
    }
    note(shot_.below);
    nodes_.push_back({s, section.heading, scene_.natural + section.moment, section.x, section.y});
    if (s <= 0.0) break;
    double next_s = std::max(k * h, 0.0);
    bool on_grid = true;
    const auto stop_at = [&](double arc) {
      if (arc > next_s + kTiny) {
        next_s = arc;
        on_grid = false;
      }
    };
    if (event != events.end()) stop_at(event->on.arc);
    if (fold.angle != 0.0 && fold.width < s - kTiny) stop_at(fold.width);
    for (const RestShape::Piece& piece : scene_.rest.pieces()) {
      if (piece.until < s - kTiny) stop_at(piece.until);
    }
    if (on_grid) --k;
    const double middle = 0.5 * (s + next_s);
    const double turned_middle = turn_at(middle);
    const double turned_end = turn_at(next_s);
    if (!tangents.empty()) {
      for (int i = fold_direction; i <= natural_direction; ++i) {
        tangents[i].half = turn_by(i, s) - turn_by(i, middle);
        tangents[i].full = turn_by(i, s) - turn_by(i, next_s);
      }
    }
    section.advance(s - next_s, turned - turned_middle, turned - turned_end, tangents);
    turned = turned_end;
    s = next_s;
  }
  if (tangents.empty()) tangents.assign(directions, Tangent{});
  shot_.base = section;
  std::reverse(nodes_.begin(), nodes_.end());
  const double turn = scene_.base_compliance * section.moment - section.heading;
  const Turned world(turn);
  for (Node& node : nodes_) {
    const double dx = node.x - section.x;
    const double dy = node.y - section.y;
    node.x = world.x(dx, dy);
    node.y = world.y(dx, dy);
    node.heading += turn;
  }
}

// Friction.

// How far the skin has moved over the obstacle since the last equilibrium, towards larger places.
double Rod::slip(const Contact& contact) const {
  double slip = contact.place - contact.last_place;
  if (contact.part == Part::kStraight)
    slip -= contact.onward * (contact.along - contact.last_along);
  return slip;
}

// Whether larger places lie towards a wall's last end (1) or its first one (-1), where it touches.
double Rod::way_along(const Contact& contact) const {
  const Peg& wall = scene_.pegs[contact.peg];
  const Skin on = skin(contact);
  const Turned frame(centreline().pose(on.arc).heading);
  const double onward_x = -frame.y(on.out_t, on.out_n);
  const double onward_y = frame.x(on.out_t, on.out_n);
  return onward_x * wall.to_x + onward_y * wall.to_y < 0.0 ? -1.0 : 1.0;
}

// The share of the largest friction that acts on a contact, positive towards larger places.
double Rod::rubbing(const Contact& contact) const {
  return std::clamp(contact.rubbing + slip(contact) / kSlipCm, -1.0, 1.0);
}

Rod::Push Rod::push(const Contact& contact) const {
  const Skin on = skin(contact);
  const double share = friction_ * rubbing(contact);
  return {-contact.force * (on.out_t + share * on.out_n),
          -contact.force * (on.out_n - share * on.out_t)};
}

// The derivative of a contact's push by a direction; its own unknowns begin at `unknown`.
Rod::Push Rod::push_by(const Contact& contact, int index, int unknown, int direction,
                       int directions) const {
  const int shares = directions - (friction_ > 0.0 ? touching() : 0);
  const bool by_force = direction == unknown;
  const bool by_place = direction == unknown + 1;
  const bool by_along = contact.part == Part::kStraight && direction == unknown + 2;
  const bool by_share = friction_ > 0.0 && direction == shares + index;
  if (!(by_force || by_place || by_along || by_share)) return {0.0, 0.0};
  const Skin on = skin(contact);
  const double rubs = rubbing(contact);
  const double share = friction_ * rubs;
  if (by_force) return {-(on.out_t + share * on.out_n), -(on.out_n - share * on.out_t)};
  double share_by = by_share ? 1.0 : 0.0;
  if (std::fabs(rubs) < 1.0 && by_place) share_by = friction_ / kSlipCm;
  if (std::fabs(rubs) < 1.0 && by_along) share_by = -contact.onward * friction_ / kSlipCm;
  Push pushed{-contact.force * share_by * on.out_n, contact.force * share_by * on.out_t};
  if (by_place) {
    const Skin slope = scene_.outline().slope(contact.place, scene_.pegs[contact.peg].radius);
    pushed.tangential -= contact.force * (slope.out_t + share * slope.out_n);
    pushed.normal -= contact.force * (slope.out_n - share * slope.out_t);
  }
  return pushed;
}

// What this equilibrium leaves for the next. A body that turns by itself rolls over the peg.
void Rod::remember_touches() {
  for (std::size_t j = 0; j < reactions_.contacts.size(); ++j) {
    Contact& contact = reactions_.contacts[j];
    const Peg& peg = scene_.pegs[contact.peg];
    const double heading = centreline().pose(skin(contact).arc).heading;
    const double before = std::isnan(contact.last_heading) ? heading : contact.last_heading;
    const bool straight = contact.part == Part::kStraight;
    const double rolled = straight ? 0.0 : peg.radius * (heading - before);
    contact.rubbing = std::clamp(rubbing(contact) + rolled / kSlipCm, -1.0, 1.0);
    contact.last_place = contact.place;
    contact.last_along = contact.along;
    contact.last_heading = heading;
  }
}

}  // namespace thigmo::mechanics
