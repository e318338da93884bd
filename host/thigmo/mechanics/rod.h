// The body followed through time among round pegs, by the least model that is good enough.
//
// A planar inextensible rod, EI = 1, natural curvature g, clamped at (0, 0) heading along x,
// carries a contact moment m(s): theta' = g + m, m' = -(t x n), with n constant between contacts.
// Contacts are unilateral. Their friction is Coulomb's, behind a small elastic slip (Dahl's element
// without its smooth corner): it follows how the skin has moved over the peg since the last
// equilibrium, the peg's rolling on the skin included. The base folds when the contact moment there
// reaches the critical one: the moment then stays, and the fold's angle is spread over one
// diameter.
//
// Why this form. Forces follow the rod's own skin, so, seen from the tip, everything that acts on
// the rod is known once each contact's force and place are: integrating from the tip down to the
// base is an explicit initial-value problem. What remains is a Newton iteration in two unknowns a
// contact for the two coordinates of its peg's centre, plus the fold's angle when the base folds.
// When that branch ends (snap-through, slip over the tip), `relax` walks downhill in energy from
// the last shape, and Newton polishes what it finds.
//
// Python's view of it is elastica.py. See docs/methods.md, bent bodies and buckling.
#pragma once

#include <array>
#include <optional>
#include <stdexcept>
#include <vector>

#include "centreline.h"
#include "small_models.h"

namespace thigmo::mechanics {

// Values that no body can have; Python sees a DataError.
struct BadInput : std::invalid_argument {
  using std::invalid_argument::invalid_argument;
};

enum class Model { kArc, kBeam, kElastica };
// How the rod's last equilibrium was found; kApproximate: to the accuracy of penalties only.
enum class Status { kConverged, kRelaxed, kApproximate };

// What a touching peg does, in the terms of Python's PegContact.
struct ContactReport {
  int peg;
  double arc;
  Kind kind;
  double normal, tangential, couple, x, y, force_x, force_y;
};

// A rod in a room, as `relax` needs it.
struct Room {
  double length, tube_radius, critical;
  double natural;  // curvature, the same all along
  std::vector<Peg> pegs;
  int cells;
};

// A minimum of energy to the accuracy of penalties: contact curvature of each cell, and the rest.
struct Relaxed {
  std::vector<double> bend;
  double fold_angle;
  std::vector<Contact> contacts;
  std::vector<Node> nodes;
};

// Walks downhill in energy from the contact curvature of each cell and a fold's angle.
Relaxed relax(const Room& room, std::vector<double> bend, double fold_angle);

// The state of the body at one arc while it is integrated.
struct Section {
  double x, y, heading;
  double moment;    // of contacts
  double n_x, n_y;  // force carried
  // Go `step` cm towards the base (negative: towards the tip) where the natural curvature turns the
  // body by `half` over the first half and by `full` over all of it.
  void advance(double step, double half, double full);
};

class Rod {
 public:
  // No model: the least whose error of position is within the tolerance (cm). Only the elastica
  // knows friction.
  Rod(double diameter, double critical, std::vector<Peg> pegs, double cell,
      std::optional<Model> model, double tolerance, double friction);

  // Follow the equilibrium to a new natural curvature and length.
  void step(double natural, double length);
  // Forget everything: the next step starts from the straight body.
  void reset();
  // Take a body without contact for the present one.
  void assume_free(double natural, double length);
  // Put other pegs into the room, beside the body as it lies. A body that is clear of them stays
  // where it is; one that is not, or was held by the old ones, bends up again from straight.
  void place(std::vector<Peg> pegs);
  // Take given contacts and a given fold: one integration, nothing is solved.
  void press(std::vector<Contact> contacts, double fold_angle, double natural, double length);

  Centreline centreline() const;
  const std::vector<Node>& nodes() const { return nodes_; }
  std::vector<ContactReport> contacts() const;  // base first
  int touching() const { return static_cast<int>(reactions_.contacts.size()); }
  double axial_push() const;  // of all pegs on the tip, towards the base
  double base_moment() const { return base_moment_; }
  double fold_angle() const { return reactions_.fold_angle; }
  double critical() const { return room_.critical; }
  void set_critical(double critical);
  double diameter() const { return 2.0 * room_.tube_radius; }
  double length() const { return room_.length; }
  double natural() const { return room_.natural; }
  Status status() const { return status_; }
  Model model() const { return model_; }
  double error_bound() const { return error_bound_; }
  const std::array<int, 3>& counts() const { return counts_; }  // steps by each model

 private:
  // A peg's force on the body, along and across it.
  struct Push {
    double tangential, normal;
  };
  // What room and base do to the rod: Newton's unknowns.
  struct Reactions {
    std::vector<Contact> contacts;
    int folding = 0;  // sign of the moment at which the base folds, 0 while it does not
    double fold_angle = 0.0;
  };

  bool try_arc(double natural, double length);
  bool lie_clear(double natural, double length);
  bool try_beam(double natural, double length, double tolerance);
  void take_elastica(double natural, double length);
  void follow(double natural, double length);
  void advance(double natural, double length, double travel);
  void remesh(double length);
  void solve(double travel);
  void forget_jacobian();
  bool find_reactions();
  bool newton(int& determinant_sign);
  Section shoot(const Reactions& reactions, std::vector<Pose>& frames,
                std::vector<Node>* nodes) const;
  void residual(const std::vector<double>& z, std::vector<double>& out) const;
  std::vector<double> packed() const;
  Reactions unpacked(const std::vector<double>& z) const;
  double weight(const std::vector<double>& z, int unknown) const;
  void set_free(std::vector<Node> nodes, double natural, double length);
  double travel(double natural, double length) const;
  int cells_for(double length) const;
  Skin skin(const Contact& contact) const;
  double rubbing(const Contact& contact) const;
  Push push(const Contact& contact) const;
  void remember_touches();

  double cell_;
  std::optional<Model> choice_;
  double tolerance_;
  double friction_;

  Room room_;  // length 0: not placed yet
  Reactions reactions_;
  std::vector<Node> nodes_;
  double base_moment_ = 0.0;
  Model model_ = Model::kArc;
  Status status_ = Status::kConverged;
  double error_bound_ = 0.0;
  std::array<int, 3> counts_{};

  // For the elastica's next step.
  bool elastica_current_ = false;  // the last equilibrium is the elastica's
  std::vector<double> bend_;       // contact curvature of each cell
  std::vector<double> jacobian_;   // of the last Newton step; empty: none
  int determinant_sign_ = 0;       // of its Jacobian; a change means a limit point was passed
  std::optional<Node> tip_;
};

}  // namespace thigmo::mechanics
