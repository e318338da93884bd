// The body followed through time among round pegs, by the least model that is good enough.
//
// A planar inextensible rod, EI = 1, natural curvature g beside that of its rest shape r(s),
// clamped at (0, 0) heading along x, carries a contact moment m(s): theta' = r + g + m, m' = -(t x
// n), with n constant between contacts. Contacts are unilateral. Their friction is Coulomb's,
// behind a small elastic slip (Dahl's element without its smooth corner): it follows how the skin
// has moved over the peg since the last equilibrium, the peg's rolling on the skin included. The
// base folds when the contact moment there reaches the critical one: the moment then stays, and the
// fold's angle is spread over one diameter. The base itself turns in proportion to that moment, and
// obstacles yield in proportion to the force on them.
//
// Why this form. Forces follow the rod's own skin, so, seen from the tip, everything that acts on
// the rod is known once each contact's force and place are: integrating from the tip down to the
// base is an explicit initial-value problem, and so are its derivatives by them. What remains is a
// Newton iteration in two unknowns a contact for the two coordinates of its peg's centre (a third
// for the place along a wall), plus the fold's angle when the base folds. The same derivatives say
// how readings change with where an obstacle stands (see Sweep). When that branch ends
// (snap-through, slip over the tip), `relax` walks downhill in energy from the last shape, and
// Newton polishes what it finds.
//
// Python's view of it is elastica.py. See docs/methods.md, bent bodies and buckling.
#pragma once

#include <array>
#include <cmath>
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
enum class Convergence { kConverged, kRelaxed, kApproximate };

// What a touching peg does, in the terms of Python's PegContact.
struct ContactReport {
  int peg;
  double arc;
  Kind kind;
  double normal, tangential, couple, x, y, force_x, force_y;
};

// A body, and the room that it lies in.
struct RodScene {
  double length, tube_radius, critical;
  double natural;  // curvature, the same all along
  std::vector<Peg> pegs;
  int cells;
  double base_compliance = 0.0;  // rad for each 1/cm of moment at the base, so cm
  double rounding = 0.0;         // radius of the end's corners, cm
  RestShape rest = {};

  Outline outline() const { return {length, tube_radius, rounding}; }
};

constexpr double kApart = 1.0;  // cm of skin, between two contacts with one wall

// A minimum of energy to the accuracy of penalties: contact curvature of each cell, and the rest.
struct Relaxed {
  std::vector<double> bend;
  double fold_angle;
  std::vector<Contact> contacts;
  std::vector<Node> nodes;
};

// Walks downhill in energy from the contact curvature of each cell and a fold's angle.
Relaxed relax(const RodScene& scene, std::vector<double> bend, double fold_angle);

// The derivative of a Section by one unknown, at a fixed arc.
struct Tangent {
  double x, y, heading, moment, n_x, n_y;
  double half,
      full;  // by which the natural turn changes over the coming step's first half, and all
};

// A direction: the cosine and the sine of its angle.
struct Heading {
  double c, d;
  Heading turned(double angle) const;
};

// The state of the body at one arc while it is integrated.
struct Section {
  double x, y, heading;
  Heading toward;   // the heading again
  double moment;    // of contacts
  double n_x, n_y;  // force carried
  // Go `step` cm towards the base (negative: towards the tip) where the natural curvature turns the
  // body by `half` over the first half and by `full` over all of it, and the derivatives with it.
  void advance(double step, double half, double full, std::vector<Tangent>& tangents);

  // A section that carries nothing yet.
  static Section at_origin(double heading) {
    return {0.0, 0.0, heading, {std::cos(heading), std::sin(heading)}, 0.0, 0.0, 0.0};
  }
};

// One integration: contacts' sections, the base, and the derivatives of all by each direction. The
// directions are the unknowns, the natural curvature and, with friction, each contact's share of
// it.
struct Shot {
  int directions = 0;
  Section base = Section::at_origin(0.0);
  std::vector<Tangent> base_by;
  std::vector<Pose> at;        // of contacts; `at_by` follows a contact that moves
  std::vector<Tangent> at_by;  // [contact][direction]
  // Of contacts, in the room: the obstacle's centre beside them, the direction to it, the force on
  // the body.
  struct Touch {
    double x, y, out_x, out_y, push_x, push_y;
  };
  std::vector<Touch> touches;
  // Derivatives of the nodes' heading and curvature, at fixed arcs: [node][direction]. They jump
  // where a contact acts: as seen from the base, and as seen from the tip.
  struct NodeTangent {
    double heading, curvature;
  };
  std::vector<NodeTangent> below, above;
};

// What sensors would read along a ladder of natural curvatures, and how that changes.
struct Sweep {
  // Columns of `by_parameter`: six of each obstacle, then those of the body.
  enum Column { kX, kY, kRadius, kToX, kToY, kCompliance, kOfObstacle };
  enum BodyColumn { kCritical, kBaseCompliance, kFriction, kOfBody };

  int rows = 0, sensors = 0, obstacles = 0;
  int parameters() const { return kOfObstacle * obstacles + kOfBody; }
  std::vector<double> readings;      // [row][sensor], 1/cm
  std::vector<double> by_place;      // [row][sensor], for each cm that the sensor lies farther out
  std::vector<double> by_parameter;  // [row][sensor][parameter]
  std::vector<double> contacts;      // [row][obstacle][arc, x, y, force], NaN if not touched
  std::vector<unsigned char> approximate;  // [row] whether its equilibrium is one of penalties only
};

class Rod {
 public:
  // No model: the least whose error of position is within the tolerance (cm). Only the elastica
  // knows friction.
  Rod(double diameter, double critical, std::vector<Peg> pegs, double cell,
      std::optional<Model> model, double tolerance, double friction, double base_compliance,
      double rounding, RestShape rest);

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

  // Bend the free body of a length through a ladder of natural curvatures, and read sensors at
  // each.
  Sweep sweep(const std::vector<double>& naturals, double length,
              const std::vector<double>& centers, const std::vector<double>& spans);

  Centreline centreline() const;
  const std::vector<Node>& nodes() const { return nodes_; }
  std::vector<ContactReport> contacts() const;  // base first
  int touching() const { return static_cast<int>(reactions_.contacts.size()); }
  double axial_push() const;  // of all pegs on the tip, towards the base
  double base_moment() const { return base_moment_; }
  double fold_angle() const { return reactions_.fold_angle; }
  double critical() const { return scene_.critical; }
  void set_critical(double critical);
  double diameter() const { return 2.0 * scene_.tube_radius; }
  double base_compliance() const { return scene_.base_compliance; }
  double rounding() const { return scene_.rounding; }
  const RestShape& rest() const { return scene_.rest; }
  Outline outline() const { return scene_.outline(); }
  double length() const { return scene_.length; }
  double natural() const { return scene_.natural; }
  Convergence status() const { return status_; }
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

  bool beam_serves() const;
  bool try_arc(double natural, double length);
  bool lie_clear(double natural, double length);
  bool try_beam(double natural, double length, double tolerance);
  void take_elastica(double natural, double length);
  void follow(double natural, double length);
  void advance(double natural, double length, double travel);
  void remesh(double length);
  void solve(double travel);
  void forget_equations();
  void predict(double change);
  bool find_reactions();
  bool already_touched(int peg, double place) const;
  bool switch_parts();
  bool newton(int& determinant_sign);
  void shoot(const Reactions& reactions);
  void linearise(const std::vector<double>& z);
  std::vector<double> sensitivity() const;
  std::vector<double> packed() const;
  Reactions unpacked(const std::vector<double>& z) const;
  void read(Sweep& sweep, int row, const std::vector<double>& centers,
            const std::vector<double>& spans) const;
  void read_free(Sweep& sweep, int row, double natural, double length,
                 const std::vector<double>& centers, const std::vector<double>& spans) const;
  bool arc_is_clear(double natural, double length) const;
  void set_free(std::vector<Node> nodes, double natural, double length);
  double travel(double natural, double length) const;
  int cells_for(double length) const;
  Skin skin(const Contact& contact) const;
  double slip(const Contact& contact) const;
  double rubbing(const Contact& contact) const;
  Push push(const Contact& contact) const;
  Push push_by(const Contact& contact, int index, int unknown, int direction, int directions) const;
  double way_along(const Contact& contact) const;
  void remember_touches();

  double cell_;
  std::optional<Model> choice_;
  double tolerance_;
  double friction_;

  RodScene scene_;  // length 0: not placed yet
  Reactions reactions_;
  std::vector<Node> nodes_;
  double base_moment_ = 0.0;
  Model model_ = Model::kArc;
  Convergence status_ = Convergence::kConverged;
  double error_bound_ = 0.0;
  std::array<int, 3> counts_{};

  // For the elastica's next step.
  bool elastica_current_ = false;  // the last equilibrium is the elastica's
  std::vector<double> bend_;       // contact curvature of each cell
  Shot shot_;                      // of the last integration
  std::vector<double> residual_;   // of the equations, cm
  std::vector<double> jacobian_;   // of them, [equation][direction]
  int determinant_sign_ = 0;       // by the unknowns; a change means a limit point was passed
  std::vector<double> slope_;      // of the unknowns over the natural curvature, as last predicted
  double last_change_ = 0.0;       // of the natural curvature since
  std::optional<Node> tip_;
};

}  // namespace thigmo::mechanics
