// Walks downhill in energy when Newton's branch has ended: Gauss-Newton in the contact curvature of
// each cell and the fold's angle, with a step limit of a centimetre, so that no peg is jumped over.
// Penalties stand for the pegs; an augmented Lagrangian makes their forces exact.
#include <algorithm>
#include <cmath>

#include "linear.h"
#include "rod.h"

namespace thigmo::mechanics {
namespace {

constexpr double kStiff = 0.3;  // of a penalty, 1/cm^3

// When a walk ends. The first one must leave a saddle, as a straight body pushed head-on does,
// where steps are small before they grow. Later ones only follow the forces of the augmented
// Lagrangian.
struct End {
  int steps;
  double gain;    // of the energy, by the last step
  double travel;  // by that step as well, cm
};
constexpr End kFirst{120, 1e-14, 1e-6}, kLater{60, 1e-7, 1.0};

class Descent {
 public:
  Descent(const RodScene& scene, std::vector<double> bend, double fold_angle)
      : scene_(scene),
        h_(scene.length / scene.cells),
        folds_(std::isfinite(scene.critical)),
        turns_(scene.base_compliance > 0.0),
        unknown_(std::move(bend)),
        nodes_(scene.cells + 1) {
    for (int i = 0; i < static_cast<int>(scene.pegs.size()); ++i) {
      for (int part = 0; part < (scene.pegs[i].is_wall() ? kParts : 1); ++part) {
        stops_.push_back({i, static_cast<Part>(part)});
      }
    }
    hold_.assign(stops_.size(), 0.0);
    gaps_.resize(stops_.size());
    // Breaks the symmetry of a straight rod pushed head-on.
    for (int i = 0; i < scene_.cells; ++i) unknown_[i] += 1e-6 * (i + 1) / scene_.cells;
    if (folds_) unknown_.push_back(fold_angle);
    if (turns_) unknown_.push_back(scene_.base_compliance * unknown_[0]);
  }

  Relaxed run() {
    for (int outer = 0; outer < 8; ++outer) {
      walk(outer == 0 ? kFirst : kLater);
      double worst = 0.0;
      for (std::size_t j = 0; j < hold_.size(); ++j) {
        hold_[j] = pressing(j);
        const double gap = gaps_[j].distance + peg(j).compliance * hold_[j];
        worst = std::max(worst, hold_[j] > 0.0 ? std::fabs(gap) : -gap);
      }
      if (worst < 1e-6) break;
    }
    Relaxed relaxed{
        {unknown_.begin(), unknown_.begin() + scene_.cells}, fold_angle(unknown_), {}, nodes_};
    for (std::size_t j = 0; j < hold_.size(); ++j) {
      const Gap& gap = gaps_[j];
      // A wall's end and its straight part may both press where one passes into the other.
      const bool again = std::any_of(
          relaxed.contacts.begin(), relaxed.contacts.end(), [&](const Contact& contact) {
            return contact.peg == stops_[j].peg && std::fabs(contact.place - gap.place) < kApart;
          });
      if (hold_[j] > 1e-9 && !again) {
        relaxed.contacts.push_back({stops_[j].peg, hold_[j], gap.place, gap.part, gap.along});
      }
    }
    return relaxed;
  }

 private:
  // What can press by itself: a peg, or a part of a wall.
  struct Stop {
    int peg;
    Part part;
  };

  const Peg& peg(std::size_t stop) const { return scene_.pegs[stops_[stop].peg]; }

  // A peg that presses: how far each unknown moves the skin away from it.
  using Levers = std::vector<double>;

  double fold_angle(const std::vector<double>& unknown) const {
    return folds_ ? unknown[scene_.cells] : 0.0;
  }

  double base_turn(const std::vector<double>& unknown) const {
    return turns_ ? unknown.back() : 0.0;
  }

  // A peg's force; one that yields is softer by its compliance, and meets the body farther in.
  double pressing(std::size_t stop) const {
    return std::max(hold_[stop] - kStiff * gaps_[stop].distance, 0.0) / softening(stop);
  }

  double softening(std::size_t stop) const { return 1.0 + kStiff * peg(stop).compliance; }

  // Lays the body out, measures all gaps and returns the energy: bending, fold and penalties.
  double lay_out(const std::vector<double>& unknown) {
    const Fold fold{fold_angle(unknown), 2.0 * scene_.tube_radius};
    Section section = Section::at_origin(base_turn(unknown));
    double energy = turns_ ? 0.5 * section.heading * section.heading / scene_.base_compliance : 0.0;
    for (int i = 0; i <= scene_.cells; ++i) {
      const double s = i * h_;
      const double bend =
          0.5 * (unknown[std::max(i - 1, 0)] + unknown[std::min(i, scene_.cells - 1)]);
      nodes_[i] = {s, section.heading, scene_.natural + bend, section.x, section.y};
      if (i == scene_.cells) break;
      const auto turned = [&](double arc) {
        return scene_.natural * arc + fold.turn(arc) + scene_.rest.turn(arc);
      };
      section.moment = unknown[i];
      section.advance(-h_, turned(s) - turned(s + 0.5 * h_), turned(s) - turned(s + h_), none_);
      energy += 0.5 * h_ * unknown[i] * unknown[i];
    }
    if (folds_) energy += scene_.critical * (std::hypot(fold.angle, 1e-4) - 1e-4);
    const Centreline line{nodes_.data(), scene_.cells + 1, fold, scene_.rest};
    for (std::size_t j = 0; j < stops_.size(); ++j) {
      gaps_[j] = line.gap_to(peg(j), stops_[j].part, scene_.outline());
      energy += 0.5 * pressing(j) * pressing(j) * softening(j) / kStiff;
    }
    return energy;
  }

  Levers levers(std::size_t stop) const {
    const double width = 2.0 * scene_.tube_radius;
    const Skin on = scene_.outline().at(gaps_[stop].place, peg(stop).radius);
    const Pose pose =
        Centreline{nodes_.data(), scene_.cells + 1, {fold_angle(unknown_), width}, scene_.rest}
            .pose(on.arc);
    const double c = std::cos(pose.heading);
    const double d = std::sin(pose.heading);
    const double x = pose.x + on.ahead * c - on.offset * d;
    const double y = pose.y + on.ahead * d + on.offset * c;
    const double out_x = on.out_t * c - on.out_n * d;
    const double out_y = on.out_t * d + on.out_n * c;
    Levers levers(unknown_.size(), 0.0);
    for (int i = 0; i < scene_.cells && i * h_ < on.arc; ++i) {
      const double part = std::min(h_, on.arc - i * h_);
      const double u = 0.5 * part / h_;
      const double middle_x = nodes_[i].x + u * (nodes_[i + 1].x - nodes_[i].x);
      const double middle_y = nodes_[i].y + u * (nodes_[i + 1].y - nodes_[i].y);
      const double lever = out_x * (y - middle_y) - out_y * (x - middle_x);
      levers[i] = part * lever;
      if (folds_) {
        levers[scene_.cells] +=
            std::max(std::min(i * h_ + part, width) - i * h_, 0.0) / width * lever;
      }
    }
    if (turns_) levers.back() = out_x * y - out_y * x;
    return levers;
  }

  // Gauss-Newton with a line search and, where that fails, damping, at fixed `hold_`.
  void walk(const End& end) {
    const std::size_t n = unknown_.size();
    double energy = lay_out(unknown_);
    double damping = 0.0;
    std::vector<double> gradient(n), stiffness(n), step(n), next(n);
    for (int iteration = 0; iteration < end.steps; ++iteration) {
      for (int i = 0; i < scene_.cells; ++i) {
        gradient[i] = h_ * unknown_[i];
        stiffness[i] = h_ * (1.0 + damping);
      }
      if (folds_) {
        const double angle = unknown_[scene_.cells];
        const double root = std::hypot(angle, 1e-4);
        gradient[scene_.cells] = scene_.critical * angle / root;
        stiffness[scene_.cells] = scene_.critical / root * (1.0 + damping);
      }
      if (turns_) {
        gradient.back() = unknown_.back() / scene_.base_compliance;
        stiffness.back() = (1.0 + damping) / scene_.base_compliance;
      }
      std::vector<Levers> active;
      std::vector<std::size_t> pressed;
      for (std::size_t j = 0; j < stops_.size(); ++j) {
        const double force = pressing(j);
        if (force <= 0.0) continue;
        active.push_back(levers(j));
        pressed.push_back(j);
        for (std::size_t i = 0; i < n; ++i) gradient[i] -= force * active.back()[i];
      }
      // The Hessian is diagonal plus a penalty of rank one for each active peg.
      const std::size_t pegs = active.size();
      const auto over_stiffness = [&](const Levers& a, const std::vector<double>& b) {
        double sum = 0.0;
        for (std::size_t i = 0; i < n; ++i) sum += a[i] * b[i] / stiffness[i];
        return sum;
      };
      std::vector<double> small(pegs * pegs), rhs(pegs);
      for (std::size_t r = 0; r < pegs; ++r) {
        rhs[r] = over_stiffness(active[r], gradient);
        for (std::size_t c = 0; c < pegs; ++c) {
          small[r * pegs + c] = over_stiffness(active[r], active[c]);
        }
        small[r * pegs + r] += softening(pressed[r]) / kStiff;
      }
      if (solve_linear(small, rhs, static_cast<int>(pegs)) == 0)
        std::fill(rhs.begin(), rhs.end(), 0.0);
      double slope = 0.0;
      double travel = 0.0;
      for (std::size_t i = 0; i < n; ++i) {
        step[i] = gradient[i];
        for (std::size_t r = 0; r < pegs; ++r) step[i] -= active[r][i] * rhs[r];
        step[i] /= -stiffness[i];
        slope += step[i] * gradient[i];
        const bool cell = i < static_cast<std::size_t>(scene_.cells);
        travel += std::fabs(step[i]) *
                  (cell ? h_ * (scene_.length - static_cast<double>(i) * h_) : scene_.length);
      }
      if (travel < 1e-9 || slope >= 0.0) return;
      double scale = std::min(1.0, 1.0 / travel);
      bool lower = false;
      double energy_next = 0.0;
      for (int halving = 0; halving < 14 && !lower; ++halving) {
        for (std::size_t i = 0; i < n; ++i) next[i] = unknown_[i] + scale * step[i];
        energy_next = lay_out(next);
        lower = energy_next <= energy + 1e-4 * scale * slope;
        if (!lower) scale *= 0.5;
      }
      if (!lower) {
        energy = lay_out(unknown_);
        damping = std::max(4.0 * damping, 0.1);
        if (damping > 1e6) return;
        continue;
      }
      damping *= 0.3;
      unknown_.swap(next);
      const double gain = energy - energy_next;
      energy = energy_next;
      if (gain <= end.gain * std::fabs(energy) && scale * travel < end.travel) return;
    }
  }

  const RodScene& scene_;
  std::vector<Stop> stops_;
  double h_;
  bool folds_, turns_;  // whether the base folds, and turns
  std::vector<double>
      unknown_;  // contact curvature of each cell, the fold's angle, the base's turn
  std::vector<Tangent> none_;
  std::vector<Node> nodes_;
  std::vector<double> hold_;  // forces of the augmented Lagrangian
  std::vector<Gap> gaps_;
};

}  // namespace

Relaxed relax(const RodScene& scene, std::vector<double> bend, double fold_angle) {
  return Descent(scene, std::move(bend), fold_angle).run();
}

}  // namespace thigmo::mechanics
