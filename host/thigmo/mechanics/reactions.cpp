// One equilibrium of the rod: integration from tip to base, Newton for what pegs and base do to it,
// and the active set around Newton.
#include <algorithm>
#include <cmath>

#include "linear.h"
#include "rod.h"

namespace thigmo::mechanics {
namespace {

constexpr double kTiny = 1e-9;      // cm, between nodes
constexpr double kGap = 1e-7;       // cm, an overlap that counts
constexpr double kResidual = 1e-9;  // cm

}  // namespace

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

std::vector<double> Rod::packed() const {
  std::vector<double> z;
  for (const Contact& contact : reactions_.contacts) {
    z.push_back(contact.force);
    z.push_back(contact.place);
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
  }
  reactions.fold_angle = reactions.folding != 0 ? *next++ : 0.0;
  return reactions;
}

// Peg's centre minus the contact's locus (cm), then the fold's equation scaled to cm.
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
}

// Integrates from the distal end to the base, on an even grid plus the places of the contacts and
// the fold's end. `frames` receives each contact's section, in the frame of the distal end as the
// result; `nodes`, if wanted, the whole body in the frame of the base.
Section Rod::shoot(const Reactions& reactions, std::vector<Pose>& frames,
                   std::vector<Node>* nodes) const {
  struct Event {
    Skin on;
    std::size_t contact;
  };
  std::vector<Event> events;
  for (const Contact& contact : reactions.contacts) {
    events.push_back({skin(contact), events.size()});
  }
  std::sort(events.begin(), events.end(), [](const Event& a, const Event& b) {
    return a.on.arc != b.on.arc ? a.on.arc > b.on.arc : a.contact < b.contact;
  });
  frames.resize(events.size());
  if (nodes) nodes->clear();

  const Fold fold{reactions.fold_angle, diameter()};
  const double h = room_.length / room_.cells;
  double s = nodes ? room_.length : events.empty() ? 0.0 : events.front().on.arc;
  double turned = room_.natural * s + fold.turn(s);
  Section at{};
  int k = static_cast<int>(std::ceil(s / h - kTiny)) - 1;
  auto event = events.begin();
  while (true) {
    for (; event != events.end() && event->on.arc >= s - kTiny; ++event) {
      const Push by = push(reactions.contacts[event->contact]);
      frames[event->contact] = {at.x, at.y, at.heading};
      at.moment += -event->on.offset * by.tangential;
      const double c = std::cos(at.heading);
      const double d = std::sin(at.heading);
      at.n_x += by.tangential * c - by.normal * d;
      at.n_y += by.tangential * d + by.normal * c;
    }
    if (nodes) {
      nodes->push_back({s, at.heading, room_.natural + at.moment, at.x, at.y});
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
    if (event != events.end()) stop_at(event->on.arc);
    if (fold.angle != 0.0 && fold.width < s - kTiny) stop_at(fold.width);
    if (on_grid) --k;
    const double middle = 0.5 * (s + to);
    const double turned_middle = room_.natural * middle + fold.turn(middle);
    const double turned_end = room_.natural * to + fold.turn(to);
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

}  // namespace thigmo::mechanics
