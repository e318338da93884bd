// A body in space, as the kernel asks for it (body.h).
//
// The body carries a frame (tangent, normal, binormal) that turns about its tangent only where a
// couple twists it. Its curvature is a vector u in that frame, R' = R [u], and a reading the mean
// of h . u over a span. A force F at r(a) and a couple C, over EI, bend the body before a by
//     K R(s)' (C + (r(a) - r(s)) x F),    K = (EI / GJ, 1, 1),
// so with the integrals of R K and of r x R K up to any arc, the response of a reading to a load at
// any place is a difference of two of them: every reading is a line, every load a wrench. Weight is
// a known wrench.
#pragma once

#include <optional>

#include "body.h"

namespace thigmo {

inline Vector vector(const double* numbers) { return {numbers[0], numbers[1], numbers[2]}; }
inline double dot(const Vector& a, const Vector& b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
inline Vector cross(const Vector& a, const Vector& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
// a + x b
inline Vector plus(const Vector& a, double x, const Vector& b) {
  return {a[0] + x * b[0], a[1] + x * b[1], a[2] + x * b[2]};
}

// Three column vectors; those of a frame are tangent, normal and binormal.
using Columns3 = std::array<Vector, 3>;

inline Vector times(const Columns3& m, const Vector& v) {
  return plus(plus(plus({}, v[0], m[0]), v[1], m[1]), v[2], m[2]);
}
inline Columns3 times(const Columns3& m, const Columns3& n) {
  return {times(m, n[0]), times(m, n[1]), times(m, n[2])};
}

// Rotation by a vector of less than half a radian (Rodrigues, by Taylor's series, to 1e-10).
inline Columns3 rotation(const Vector& w) {
  const double t = dot(w, w);
  const double a = 1.0 - t / 6.0 * (1.0 - t / 20.0 * (1.0 - t / 42.0));
  const double b = 0.5 - t / 24.0 * (1.0 - t / 30.0 * (1.0 - t / 56.0));
  const double c = 1.0 - b * t;
  return {{{c + b * w[0] * w[0], b * w[0] * w[1] + a * w[2], b * w[0] * w[2] - a * w[1]},
           {b * w[0] * w[1] - a * w[2], c + b * w[1] * w[1], b * w[1] * w[2] + a * w[0]},
           {b * w[0] * w[2] + a * w[1], b * w[1] * w[2] - a * w[0], c + b * w[2] * w[2]}}};
}

// A section of the body, and the integrals up to there.
struct Section {
  double arc = 0.0;
  Columns3 frame{{{1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}, {0.0, 0.0, 1.0}}};
  Vector position{};  // its place
  Columns3 turns{};   // of the frame's columns, times K
  Columns3 levers{};  // of the place's cross products with them
  Vector places{};    // of the place
};

// The body's shape, from its curvature.
class SpaceShape {
 public:
  // `curvature`: three numbers of each cell, one after another.
  SpaceShape(const Row& curvature, const Vector& compliance) : compliance_(compliance) {
    const int cells = static_cast<int>(curvature.size()) / 3;
    u_.resize(cells), sections_.resize(cells + 1), middle_.resize(cells);
    for (int c = 0; c < cells; ++c) {
      std::copy_n(&curvature[3 * c], 3, u_[c].begin());
      beyond(sections_[c], u_[c], 1.0 / cells, sections_[c + 1], &middle_[c]);
      sections_[c + 1].arc = (c + 1.0) / cells;
    }
  }

  int cells() const { return static_cast<int>(u_.size()); }
  const Section& end() const { return sections_.back(); }

  Section at(double arc) const {
    const int cells = static_cast<int>(u_.size());
    const int c = std::min(static_cast<int>(arc * cells), cells - 1);
    Section out;
    beyond(sections_[c], u_[c], arc - sections_[c].arc, out, nullptr);
    out.arc = arc;
    return out;
  }

  // Largest lever of forces across the body at a section.
  double largest_lever(const Section& section) const {
    double most = 0.0;
    for (std::size_t c = 0; c < sections_.size() && sections_[c].arc < section.arc; c += 4) {
      most = std::max(most, std::abs(dot(section.frame[0],
                                         plus(section.position, -1.0, sections_[c].position))));
    }
    return most;
  }

  // Adds the curvature that a force and a couple at a section cause.
  void add(const Section& section, const Vector& force, const Vector& couple,
           Row& curvature) const {
    const double cells = static_cast<double>(u_.size());
    for (std::size_t c = 0; c < u_.size() && sections_[c].arc < section.arc; ++c) {
      const double before = std::min((section.arc - sections_[c].arc) * cells, 1.0);
      const Vector way = plus(section.position, -1.0, middle_[c].position), arm = cross(way, force);
      const Vector moment = plus(couple, 1.0, arm);
      for (int j = 0; j < 3; ++j) {
        curvature[3 * c + j] += before * compliance_[j] * dot(middle_[c].frame[j], moment);
      }
    }
  }

  // Curvature that a weight per length causes at a section.
  Vector by_weight(const Section& section, const Vector& weight) const {
    const Vector rest = plus(end().places, -1.0, section.places);  // of the body beyond
    const Vector moment = cross(plus(rest, section.arc - 1.0, section.position), weight);
    Vector out{};
    for (int j = 0; j < 3; ++j) out[j] = compliance_[j] * dot(section.frame[j], moment);
    return out;
  }
  const Section& section(std::size_t c) const { return sections_[c]; }
  const Vector& curvature(std::size_t c) const { return u_[c]; }

 private:
  struct Middle {
    Columns3 frame;
    Vector position;
  };
  void beyond(const Section& start, const Vector& u, double step, Section& out,
              Middle* middle) const {
    const double half = 0.5 * step;
    const Columns3 turn = rotation({u[0] * half, u[1] * half, u[2] * half});
    const Columns3 frame = times(start.frame, turn);
    const Vector centre = plus(start.position, half, frame[0]);
    out.frame = times(frame, turn);
    out.position = plus(start.position, step, frame[0]);
    for (int j = 0; j < 3; ++j) {
      const double share = step * compliance_[j];
      out.turns[j] = plus(start.turns[j], share, frame[j]);
      out.levers[j] = plus(start.levers[j], share, cross(centre, frame[j]));
    }
    out.places = plus(start.places, step, centre);
    if (middle) *middle = {frame, centre};
  }

  std::vector<Vector> u_;  // in each cell
  Vector compliance_;
  std::vector<Section> sections_;  // between the cells
  std::vector<Middle> middle_;     // of the cells
};

// The linear maps from wrenches to readings, on one shape.
class Lines {
 public:
  Lines(const SpaceShape& shape, const Frame& frame, const std::vector<Vector>& axes)
      : axes_(axes) {
    for (int i = 0; i < frame.size(); ++i) {
      // A point sensor is a short one.
      const double half = std::max(0.5 * (frame.high[i] - frame.low[i]), 1e-4);
      const double middle = std::clamp(0.5 * (frame.low[i] + frame.high[i]), half, 1.0 - half);
      if (i > 0 && frame.low[i] == frame.low[i - 1] && frame.high[i] == frame.high[i - 1]) {
        near_.push_back(near_.back()), far_.push_back(far_.back());
      } else {
        near_.push_back(shape.at(middle - half)), far_.push_back(shape.at(middle + half));
      }
      line_.push_back(between(i, far_[i]));
    }
  }

  // Derivatives of reading i by a force and by a couple at a section.
  std::pair<Vector, Vector> response(int i, const Section& section) const {
    if (section.arc <= near_[i].arc) return {};
    const Line line = section.arc < far_[i].arc ? between(i, section) : line_[i];
    return {plus(line.lever, 1.0, cross(line.turn, section.position)), line.turn};
  }

  // What weight adds to reading i: the mean over its span, by Simpson's rule.
  double by_weight(int i, const SpaceShape& shape, const Vector& weight) const {
    const Section middle = shape.at(0.5 * (near_[i].arc + far_[i].arc));
    const Vector ends =
        plus(shape.by_weight(near_[i], weight), 1.0, shape.by_weight(far_[i], weight));
    return dot(axes_[i], plus(ends, 4.0, shape.by_weight(middle, weight))) / 6.0;
  }

 private:
  struct Line {
    Vector turn, lever;
  };
  Line between(int i, const Section& end) const {
    const Section& start = near_[i];
    const Vector& h = axes_[i];
    const double share = 1.0 / (far_[i].arc - start.arc);
    Line out{};
    for (int j = 0; j < 3; ++j) {
      out.turn = plus(out.turn, share * h[j], plus(end.turns[j], -1.0, start.turns[j]));
      out.lever = plus(out.lever, share * h[j], plus(end.levers[j], -1.0, start.levers[j]));
    }
    return out;
  }

  const std::vector<Vector>& axes_;
  std::vector<Section> near_, far_;
  std::vector<Line> line_;
};

// Wrenches of a load's numbers at a section, forces first. Each is one prior standard deviation
// (`unit`), which causes a largest moment of one.
struct Wrenches {
  int count = 0;
  std::array<Vector, kMostNumbers> force{}, couple{};
  std::array<double, kMostNumbers> unit{};
};

class SpaceBody : public Body {
 public:
  // Takes what weight adds to the free body's readings out of the frame.
  SpaceBody(Readings& readings, const Input& in, const Options& options)
      : readings_(readings),
        options_(options),
        priors_(options.priors),
        compliance_(vector(options.compliance.data())),
        weight_(vector(options.weight.data())) {
    const Frame& frame = readings.frame;
    components = 3;
    for (const int i : readings.index) axes_.push_back(vector(options.axis[i]));
    // Curvature of the free body, and of the body by its readings; missing readings count as free.
    Row shown(in.curvature.size());
    for (std::size_t i = 0; i < shown.size(); ++i) shown[i] = pick(in.body, i) * options.length;
    unweighed_ = rest = curvature_of(shown);
    for (int i = 0; i < frame.size(); ++i) shown[readings.index[i]] += frame.excess[i];
    start = curvature_of(shown);
    if (weighs()) hang(readings);
    for (const Vector& h : axes_) measured_ |= twists() && h[0] != 0.0;
    turn = turn_of(unweighed_);
  }

  // A twist of the end that no sensor measures shows only by how the body bends elsewhere.
  void begin(const HypothesisKind& kind, bool) override {
    unseen_ = kind.loads.back().twists && !measured_;
    slope_.clear(), twist_ = 0.0;
  }

  void take(const Row& curvature, double step, const std::vector<PlacedLoad>& loads) override {
    shape_ = bent_to(curvature);
    lines_.emplace(*shape_, readings_.frame, axes_);
    least_ = std::max(priors_.least_lever * shape_->largest_lever(shape_->end()), 1e-6);
    known_.clear();
    for (int i = 0; weighs() && i < readings_.frame.size(); ++i) {
      known_.push_back(lines_->by_weight(i, *shape_, weight_) - hanging_[i]);
    }
    if (!unseen_ || loads.empty()) return;
    twist_ += step * (loads.back().value[kAboutEnd] - twist_);
    lay_twist_column(loads);
  }

  bool keeps(const Row&) const override { return false; }
  Row known() const override { return known_; }
  bool twists() const override { return compliance_[0] > 0.0; }
  bool in_space() const override { return true; }

  void place(LoadColumns& p) const override {
    p.place = p.load->where == Load::Where::anywhere ? middles(p.window, p.cells) : Row{1.0};
    p.density.clear(), p.base.clear(), p.laid.clear();
    p.column.resize(readings_.frame.size(), p.size() * p.cells);
    p.unit.resize(p.column.columns);
    for (int m = 0; m < p.cells; ++m) {
      const Section section = shape_->at(p.place[m]);
      const Wrenches wrench =
          wrenches(*p.load, section, std::max(shape_->largest_lever(section), least_));
      for (int k = 0; k < p.size(); ++k) p.unit[k * p.cells + m] = wrench.unit[k];
      for (int i = 0; i < p.column.rows; ++i) {
        const auto [force, couple] = lines_->response(i, section);
        for (int k = 0; k < p.size(); ++k) {
          double& response = p.column[i][k * p.cells + m] = dot(force, wrench.force[k]);
          if (k > 2) response += dot(couple, wrench.couple[k]);
        }
      }
    }
    if (!unseen_ || !p.load->twists) return;
    for (int i = 0; i < p.column.rows; ++i) {
      p.column[i][kAboutEnd] = slope_.empty() ? 0.0 : p.column[i][kAboutEnd] + slope_[i];
    }
  }

  Row bent(const std::vector<PlacedLoad>& loads) const override {
    Row out = base(*shape_);
    for (const PlacedLoad& placed : loads) {
      const Section section = shape_->at(placed.arc);
      const auto [force, couple] = wrench_of(placed, section);
      shape_->add(section, force, couple, out);
    }
    return out;
  }

  // Residuals bend the shape as well. It is then near the true one, whichever hypothesis is right.
  Row shown(const Row& bent, const Row& left, int bad) const override {
    Row out = bent;
    Row all(options_.curvature_map.columns);
    for (std::size_t i = 0; i < left.size(); ++i) {
      if (static_cast<int>(i) != bad) all[readings_.index[i]] = left[i];
    }
    const Row more = curvature_of(all);
    for (std::size_t k = 0; k < out.size(); ++k) out[k] += more[k];
    return out;
  }

  double turn_of(const Row& curvature) const override {
    const SpaceShape shape = bent_to(curvature);
    double least = 1.0;
    for (int c = 0; c <= shape.cells(); ++c) least = std::min(least, shape.section(c).frame[0][0]);
    return std::acos(std::clamp(least, -1.0, 1.0));
  }

  // About the normal and about the binormal in each cell.
  Row above(const Row& curvature) const override {
    Row out;
    for (std::size_t k = 0; k < curvature.size(); ++k) {
      if (k % 3 > 0) out.push_back(curvature[k] - rest[k]);
    }
    return out;
  }

  std::vector<Vector> forces(const std::vector<PlacedLoad>& loads) const override {
    std::vector<Vector> out;
    for (const PlacedLoad& placed : loads) {
      const Columns3& frame = shape_->at(placed.arc).frame;
      out.push_back(plus(plus({}, placed.value[0], frame[1]), placed.value[1], frame[2]));
    }
    return out;
  }

 private:
  static constexpr int kAboutEnd = 5;  // the number of a couple about the body
  bool weighs() const { return dot(weight_, weight_) > 0.0; }
  SpaceShape bent_to(const Row& curvature) const { return {curvature, compliance_}; }

  // Curvature of a body that these readings show.
  Row curvature_of(const Row& readings) const {
    const Matrix& map = options_.curvature_map;
    Row out(map.rows / 2 * 3);
    for (int r = 0; r < map.rows; ++r) {
      out[r / 2 * 3 + 1 + r % 2] = Whitener::dot(map[r], readings.data(), map.columns);
    }
    return out;
  }

  // The free body under its weight.
  void hang(Readings& readings) {
    Frame& frame = readings.frame;
    Row hanging = rest;
    for (int pass = 0; pass < 24; ++pass) {
      const Row next = base(bent_to(hanging));
      double change = 0.0;
      for (std::size_t k = 0; k < next.size(); ++k) {
        change = std::max(change, std::abs(next[k] - hanging[k]));
        hanging[k] = 0.5 * (next[k] + hanging[k]);
      }
      if (change < 1e-6) break;
    }
    const SpaceShape shape = bent_to(hanging);
    const Lines lines(shape, frame, axes_);
    for (int i = 0; i < frame.size(); ++i) {
      hanging_.push_back(lines.by_weight(i, shape, weight_));
      frame.excess[i] -= hanging_[i];
    }
    rest = base(shape);
    const double square = Whitener::dot(frame.excess.data(), frame.excess.data(), frame.size());
    const double scale = std::max(std::sqrt(square / frame.size()), priors_.trust);
    for (std::size_t s = 0; !readings.known && s < frame.levels.size(); ++s) {
      frame.levels[s].factor = priors_.noise_levels[s] * scale;  // without the weight
    }
  }

  // Curvature of the body under its weight alone, in a shape.
  Row base(const SpaceShape& shape) const {
    Row out = unweighed_;
    for (int c = 0; weighs() && c < shape.cells(); ++c) {
      const Vector added = shape.by_weight(shape.at((c + 0.5) / shape.cells()), weight_);
      for (int j = 0; j < 3; ++j) out[3 * c + j] += added[j];
    }
    return out;
  }

  Wrenches wrenches(const Load& load, const Section& section, double lever) const {
    Wrenches out;
    const double unit = 1.0 / lever,
                 couple = load.couples == Load::Couples::of_face ? options_.radius * unit : 1.0;
    const auto add = [&](const Vector& axis, double size, bool is_couple) {
      (is_couple ? out.couple : out.force)[out.count] = plus({}, size, axis);
      out.unit[out.count++] = size;
    };
    for (int j = 1; j < 3; ++j) add(section.frame[j], unit, false);
    if (load.along) add(section.frame[0], unit, false);
    if (load.couples == Load::Couples::none) return out;
    for (int j = 1; j < 3; ++j) add(section.frame[j], couple, true);
    if (load.twists) add(section.frame[0], couple, true);
    return out;
  }

  // Force and couple of a load at a section.
  std::pair<Vector, Vector> wrench_of(const PlacedLoad& load, const Section& section) const {
    const Wrenches unit = wrenches(*load.load, section, 1.0);
    Vector force{}, couple{};
    for (int k = 0; k < unit.count; ++k) {
      force = plus(force, load.value[k] / unit.unit[k], unit.force[k]);
      couple = plus(couple, load.value[k] / unit.unit[k], unit.couple[k]);
    }
    return {force, couple};
  }

  // The column of a couple that twists the end, whose twist turns the angles at which all other
  // loads bend the body: its derivative where the loads were last found (Gauss and Newton).
  void lay_twist_column(const std::vector<PlacedLoad>& loads) {
    constexpr double kStep = 1e-4;
    const int n = readings_.frame.size();
    Row u;
    for (int c = 0; c < shape_->cells(); ++c) {
      const Vector& cell = shape_->curvature(c);
      const double about = dot(shape_->section(c).frame[0], shape_->end().frame[0]);
      u.insert(u.end(), {cell[0] + kStep * about, cell[1], cell[2]});
    }
    const SpaceShape twisted = bent_to(u);
    const Lines lines(twisted, readings_.frame, axes_);
    slope_.assign(n, 0.0);
    known_.resize(n);
    for (const PlacedLoad& placed : loads) {
      const Section section = shape_->at(placed.arc), turned = twisted.at(placed.arc);
      const auto wrench = wrench_of(placed, section), turned_wrench = wrench_of(placed, turned);
      for (int i = 0; i < n; ++i) {
        const auto before = lines_->response(i, section), after = lines.response(i, turned);
        const double change = dot(after.first, turned_wrench.first) +
                              dot(after.second, turned_wrench.second) -
                              dot(before.first, wrench.first) - dot(before.second, wrench.second);
        slope_[i] += compliance_[0] * change / kStep;
      }
    }
    for (int i = 0; i < n; ++i) known_[i] -= slope_[i] * twist_;
  }

  const Readings& readings_;
  const Options& options_;
  const Priors& priors_;
  Vector compliance_, weight_;
  double least_ = 0.0;
  std::vector<Vector> axes_;
  Row unweighed_;
  Row hanging_;            // what weight adds to the readings of the free body
  bool measured_ = false;  // whether sensors measure a twist
  std::optional<SpaceShape> shape_;
  std::optional<Lines> lines_;
  Row known_;
  // A twist that no sensor measures: the couple of the present shape, and the derivative of each
  // reading by the couple (empty at the first shape).
  bool unseen_ = false;
  double twist_ = 0.0;
  Row slope_;
};

}  // namespace thigmo
