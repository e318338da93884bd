// Loads on a body in space, weighed as those in a plane are.
//
// The body carries a frame (tangent, normal, binormal) that turns about its tangent only where a
// couple twists it. Its curvature is a vector u in that frame, R' = R [u], and a reading the mean
// of h . u over a span. A force F at r(a) and a couple C, over EI, bend the body before a by
//     K R(s)' (C + (r(a) - r(s)) x F),    K = (EI / GJ, 1, 1),
// so with the integrals of R K and of r x R K up to any arc, the response of a reading to a load at
// any place is a difference of two of them: every reading is a line, every load a wrench. Given
// places and shape, readings are linear in the loads, and evidence, noise and bad readings are
// those of loads.h. Weight is a known wrench.
#pragma once

#include "hypotheses.h"

namespace thigmo {

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

// Three columns: of a frame tangent, normal and binormal.
using Columns3 = std::array<Vector, 3>;

inline Vector times(const Columns3& m, const Vector& v) {
  return plus(plus(plus({}, v[0], m[0]), v[1], m[1]), v[2], m[2]);
}
inline Columns3 times(const Columns3& m, const Columns3& n) {
  return {times(m, n[0]), times(m, n[1]), times(m, n[2])};
}

// By a rotation vector of less than half a radian (Rodrigues, by Taylor's series: 1e-10).
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
  Vector at{};        // its place
  Columns3 turns{};   // of the frame's columns, times K
  Columns3 levers{};  // of the place's cross products with them
  Vector places{};    // of the place
};

using Curvature = std::vector<Vector>;  // in each cell of the body

// The body's shape, from its curvature.
class SpaceShape {
 public:
  SpaceShape(Curvature u, const Vector& compliance) : u_(std::move(u)), compliance_(compliance) {
    const int cells = static_cast<int>(u_.size());
    sections_.resize(cells + 1);
    middle_.resize(cells);
    for (int c = 0; c < cells; ++c) {
      beyond(sections_[c], u_[c], 1.0 / cells, sections_[c + 1], &middle_[c]);
      sections_[c + 1].arc = (c + 1.0) / cells;
    }
  }

  const Curvature& curvature() const { return u_; }
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
  double largest_lever(const Section& of) const {
    double most = 0.0;
    for (std::size_t c = 0; c < sections_.size() && sections_[c].arc < of.arc; c += 4) {
      most = std::max(most, std::abs(dot(of.frame[0], plus(of.at, -1.0, sections_[c].at))));
    }
    return most;
  }

  // Adds the curvature that a force and a couple at a section cause.
  void add(const Section& of, const Vector& force, const Vector& couple, Curvature& to) const {
    const double cells = static_cast<double>(u_.size());
    for (std::size_t c = 0; c < u_.size() && sections_[c].arc < of.arc; ++c) {
      const double before = std::min((of.arc - sections_[c].arc) * cells, 1.0);
      const Vector way = plus(of.at, -1.0, middle_[c].at), arm = cross(way, force);
      const Vector moment = plus(couple, 1.0, arm);
      for (int j = 0; j < 3; ++j) {
        to[c][j] += before * compliance_[j] * dot(middle_[c].frame[j], moment);
      }
    }
  }

  // Curvature that a weight per length causes at a section.
  Vector by_weight(const Section& of, const Vector& weight) const {
    const Vector rest = plus(end().places, -1.0, of.places);  // of the body beyond
    const Vector moment = cross(plus(rest, of.arc - 1.0, of.at), weight);
    Vector out{};
    for (int j = 0; j < 3; ++j) out[j] = compliance_[j] * dot(of.frame[j], moment);
    return out;
  }
  const Section& section(std::size_t c) const { return sections_[c]; }

 private:
  struct Middle {
    Columns3 frame;
    Vector at;
  };
  void beyond(const Section& from, const Vector& u, double step, Section& out,
              Middle* middle) const {
    const double half = 0.5 * step;
    const Columns3 turn = rotation({u[0] * half, u[1] * half, u[2] * half});
    const Columns3 frame = times(from.frame, turn);
    const Vector centre = plus(from.at, half, frame[0]);
    out.frame = times(frame, turn);
    out.at = plus(from.at, step, frame[0]);
    for (int j = 0; j < 3; ++j) {
      const double share = step * compliance_[j];
      out.turns[j] = plus(from.turns[j], share, frame[j]);
      out.levers[j] = plus(from.levers[j], share, cross(centre, frame[j]));
    }
    out.places = plus(from.places, step, centre);
    if (middle) *middle = {frame, centre};
  }

  Curvature u_;
  Vector compliance_;
  std::vector<Section> sections_;  // between the cells
  std::vector<Middle> middle_;     // of the cells
};

// Directions of the readings on a shape: what turns unit wrenches into readings.
class Lines {
 public:
  Lines(const SpaceShape& shape, const Frame& frame, const std::vector<Vector>& direction)
      : direction_(direction) {
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

  // Of reading i, to a force and to a couple at a section.
  std::pair<Vector, Vector> response(int i, const Section& of) const {
    if (of.arc <= near_[i].arc) return {};
    const Line line = of.arc < far_[i].arc ? between(i, of) : line_[i];
    return {plus(line.lever, 1.0, cross(line.turn, of.at)), line.turn};
  }

  // What weight adds to reading i: the mean over its span, by Simpson's rule.
  double by_weight(int i, const SpaceShape& shape, const Vector& weight) const {
    const Section middle = shape.at(0.5 * (near_[i].arc + far_[i].arc));
    const Vector ends =
        plus(shape.by_weight(near_[i], weight), 1.0, shape.by_weight(far_[i], weight));
    return dot(direction_[i], plus(ends, 4.0, shape.by_weight(middle, weight))) / 6.0;
  }

 private:
  struct Line {
    Vector turn, lever;
  };
  Line between(int i, const Section& to) const {
    const Section& from = near_[i];
    const Vector& h = direction_[i];
    const double share = 1.0 / (far_[i].arc - from.arc);
    Line out{};
    for (int j = 0; j < 3; ++j) {
      out.turn = plus(out.turn, share * h[j], plus(to.turns[j], -1.0, from.turns[j]));
      out.lever = plus(out.lever, share * h[j], plus(to.levers[j], -1.0, from.levers[j]));
    }
    return out;
  }

  const std::vector<Vector>& direction_;
  std::vector<Section> near_, far_;
  std::vector<Line> line_;
};

// A load: whether it may lie anywhere on the body, or on its end only; whether it bears a force
// along the body, and couples there, of any size or at most those of a force on the face, and
// whether one may twist the end.
struct SpaceLoad {
  bool anywhere, along, couples, held, twisted;
};
constexpr SpaceLoad kTouch{true, false, false, false, false};
constexpr SpaceLoad kFace{false, true, true, false, false};
constexpr SpaceLoad kGrip{false, true, true, true, false};
constexpr SpaceLoad kTwist{false, true, true, true, true};

// What is weighed of several loads together, base to tip.
struct SpaceExplanation {
  Load name;
  std::vector<SpaceLoad> loads;
  int cells;  // of the first grid of each that may lie anywhere
};

// Unit wrenches of loads at a section: one prior standard deviation each, for a largest moment of
// one; forces across the body first.
struct Wrenches {
  int count = 0;
  double unit = 0.0;  // of a force
  std::array<Vector, 6> force{}, couple{};
};

// Sets of places, one of each load's cells, and the columns of all cells.
class SpaceGrid {
 public:
  struct Placed {
    const SpaceLoad* load;
    Window window;
    int cells, size;  // numbers of a load
    double width;
    Row place;
    std::vector<Section> section;
    std::vector<Wrenches> wrench;
    Matrix column;     // (N, size * cells)
    Matrix white;      // the same, whitened at one level of the noise
    Row told, square;  // products with the readings; (size, size, cells) with each other
  };
  std::vector<Placed> placed;
  Row mass;                   // of each set
  Matrix mean, spread, felt;  // (loads, sets) size of the force across the body
  double top = -INFINITY, total = 0.0;
  int best = 0;           // index of the likeliest set
  std::size_t level = 0;  // of the noise that suits it
  double scale = 0.0;     // of the forces that suits it

  // As `share_out` asks for them.
  int size() const { return static_cast<int>(mass.size()); }
  int cell(int load, int set) const { return cell_[load][set]; }
  int count() const { return static_cast<int>(placed.size()); }
  // A load on the end is drawn as one on the last cell.
  Row places(int load) const {
    const Placed& p = placed[load];
    return p.load->anywhere ? p.place : Row{1.0 - 0.5 * p.width};
  }
  Row width;  // of the cells of each load

  void list() {
    width.clear();
    for (const Placed& p : placed) width.push_back(p.width);
    for (auto& each : cell_) each.clear();
    std::array<int, kMostContacts> at{};
    list(0, at);
    mass.assign(cell_[0].size(), 0.0);
    peak_of_.assign(mass.size(), -INFINITY), scale_of_ = mass;
    top = -INFINITY, total = 0.0;
  }

  // Takes columns and readings at one level of the noise.
  THIGMO_WIDE void take(const Whitener& by, const Row& read) {
    for (Placed& p : placed) {
      by(p.column, p.white);
      const int wide = p.white.columns, cells = wide / p.size;
      p.told.assign(wide, 0.0), p.square.assign(static_cast<std::size_t>(wide) * p.size, 0.0);
      for (int i = 0; i < p.white.rows; ++i) {
        const double *row = p.white[i], own = read[i];
        for (int c = 0; c < wide; ++c) p.told[c] += row[c] * own;
        for (int d = 0; d < p.size; ++d) {
          for (int c = 0; c <= d; ++c) {
            const double *one = row + d * cells, *two = row + c * cells;
            double* __restrict to = &p.square[(d * p.size + c) * cells];
            for (int m = 0; m < cells; ++m) to[m] += one[m] * two[m];
          }
        }
      }
    }
    for (int b = 1; b < count(); ++b) {
      for (int a = 0; a < b; ++a) {
        const Matrix &one = placed[a].white, &two = placed[b].white;
        Matrix& to = both_[pair(a, b)];
        to.resize(one.columns, two.columns);
        std::fill(to.value.begin(), to.value.end(), 0.0);
        for (int i = 0; i < one.rows; ++i) {
          const double *left = one[i], *right = two[i];
          for (int c = 0; c < one.columns; ++c) {
            double* __restrict row = to[c];
            for (int d = 0; d < two.columns; ++d) row[d] += left[c] * right[d];
          }
        }
      }
    }
  }

  // Adds the weights of all sets at that level, over scales of the forces.
  THIGMO_WIDE void weigh(double constant, std::size_t at_level, const Row& scales) {
    const std::size_t sets = mass.size();
    weight_.resize(sets * scales.size());
    numbers([&]<int K>() __attribute__((always_inline)) {
      Row wider;
      for (const double at : scales) wider.push_back(std::pow(at, K));
      for (std::size_t s = 0; s < sets; s += 4) {
        Normal<K> normal;
        gather(static_cast<int>(s), normal);
        for (std::size_t m = 0; m < scales.size(); ++m) {
          for (Four& tight : normal.prior) tight = 1.0 / (scales[m] * scales[m]) + Four{};
          const Eliminated<K> found(normal);
          Four mean[K], variance[K];
          if (pushed()) found.solve(mean, variance);
          for (std::size_t lane = 0; lane < std::min<std::size_t>(4, sets - s); ++lane) {
            double odds = wider[m] * std::sqrt(found.volume[lane]);
            for (int j = 0, from = 0; pushed() && j < count(); from += placed[j++].size) {
              if (!placed[j].load->along || placed[j].load->held) continue;
              const double deviation = std::sqrt(2.0 * variance[from + 2][lane]);
              odds /= std::max(std::erfc(mean[from + 2][lane] / deviation), 1e-300);
            }
            weight_[m * sets + s + lane] = constant + 0.5 * found.gain[lane] - std::log(odds);
          }
        }
      }
    });
    const auto most = std::max_element(weight_.begin(), weight_.end());
    if (*most > top) {
      const double shrink = std::exp(top - *most);
      for (double& value : mass) value *= shrink;
      total *= shrink, top = *most;
      const auto at = static_cast<std::size_t>(most - weight_.begin());
      best = static_cast<int>(at % sets), level = at_level, scale = scales[at / sets];
    }
    for (std::size_t m = 0; m < scales.size(); ++m) {
      const double* own = &weight_[m * sets];
      for (std::size_t s = 0; s < sets; ++s) {
        const double share = own[s] < top - kNothing ? 0.0 : std::exp(own[s] - top);
        mass[s] += share, total += share;
        if (own[s] > peak_of_[s]) peak_of_[s] = own[s], scale_of_[s] = scales[m];
      }
    }
  }

  // Forces of all sets at the level that was taken last, and whether they move the readings by
  // `least` standard errors.
  THIGMO_WIDE void solve(double least) {
    for (Matrix* each : {&mean, &spread, &felt}) *each = Matrix(count(), size());
    numbers([&]<int K>() __attribute__((always_inline)) {
      for (int s = 0; s < size(); s += 4) {
        const int sets = std::min(4, size() - s);
        Normal<K> normal;
        gather(s, normal);
        for (int lane = 0; lane < 4; ++lane) {
          const double of = scale_of_[s + std::min(lane, sets - 1)];
          for (Four& tight : normal.prior) tight[lane] = 1.0 / (of * of);
        }
        const Eliminated<K> found(normal);
        Four force[K], variance[K];
        found.solve(force, variance);
        for (int j = 0, from = 0; j < count(); from += placed[j++].size) {
          Four across[K]{}, moves[K]{}, length{}, moved{}, loose, told;
          const int beyond = from + placed[j].size;
          for (int k = from; k < beyond; ++k) {
            if (k < from + 2) across[k] = force[k], length += force[k] * force[k];
            for (int l = from; l < beyond; ++l) {
              moves[k] += normal.lower[std::max(k, l)][std::min(k, l)] * force[l];
            }
            moved += moves[k] * force[k];
          }
          found.variance(across, loose), found.variance(moves, told);
          for (int lane = 0; lane < sets; ++lane) {
            const double size = std::sqrt(std::max(length[lane], 1e-300));
            const double standard = std::sqrt(std::max(moved[lane], 1e-300));
            const double unit = placed[j].wrench[cell_[j][s + lane]].unit;
            mean[j][s + lane] = size * unit;
            spread[j][s + lane] = std::sqrt(loose[lane]) / size * unit;
            felt[j][s + lane] = probability_felt(standard, std::sqrt(told[lane]) / standard, least);
          }
        }
      }
    });
  }

  // Loads of the likeliest set, in units of their deviations at a scale of one, at the level that
  // was taken last.
  Row likeliest() const {
    Row out;
    numbers([&]<int K>() __attribute__((always_inline)) {
      Normal<K> normal;
      gather(best, normal);
      for (Four& tight : normal.prior) tight = 1.0 / (scale * scale) + Four{};
      Four mean[K], variance[K];
      Eliminated<K>(normal).solve(mean, variance);
      for (const Four& each : mean) out.push_back(each[0]);
    });
    return out;
  }

  // Probability that all loads of a set are felt.
  double all_felt() const {
    double sum = 0.0;
    for (int s = 0; s < size(); ++s) {
      double likely = mass[s];
      for (int j = 0; j < count(); ++j) likely *= felt[j][s];
      sum += likely;
    }
    return sum / total;
  }

 private:
  static int pair(int a, int b) { return a + b - 1; }  // (0, 1), (0, 2), (1, 2)

  void list(int load, std::array<int, kMostContacts>& at) {
    if (load == count() || load == static_cast<int>(kMostContacts)) {
      for (int j = 0; j < count(); ++j) cell_[j].push_back(at[j]);
      return;
    }
    const Placed& p = placed[load];
    for (at[load] = 0; at[load] < p.cells; ++at[load]) {
      if (load > 0) {
        const Placed& before = placed[load - 1];
        const double gap = 0.5 * std::min(p.width, before.width);
        if (p.place[at[load]] - before.place[at[load - 1]] < gap) continue;
      }
      list(load + 1, at);
    }
  }

  // Calls `run` for as many numbers as a set has.
  template <class Run>
  [[gnu::always_inline]] void numbers(const Run& run) const {
    int sum = 0;
    for (const Placed& p : placed) sum += p.size;
    switch (sum) {
      case 2:
        return run.template operator()<2>();
      case 4:
        return run.template operator()<4>();
      case 5:
        return run.template operator()<5>();
      case 6:
        return run.template operator()<6>();
      default:
        return run.template operator()<7>();
    }
  }

  // A face is pushed, never pulled.
  bool pushed() const { return placed.back().load->along && !placed.back().load->held; }

  // Normal equations of four sets from `first` on, without their prior.
  template <int K>
  [[gnu::always_inline]] void gather(int first, Normal<K>& out) const {
    for (int lane = 0; lane < 4; ++lane) {
      const int s = std::min(first + lane, size() - 1);
      for (int b = 0, k = 0; b < count(); k += placed[b++].size) {
        const Placed& p = placed[b];
        const int column = cell_[b][s], cells = static_cast<int>(p.section.size());
        for (int a = 0, l = 0; a < b; l += placed[a++].size) {
          const Matrix& both = both_[pair(a, b)];
          for (int c = 0; c < placed[a].size; ++c) {
            const double* row = both[c * (both.rows / placed[a].size) + cell_[a][s]] + column;
            for (int d = 0; d < p.size; ++d) out.lower[k + d][l + c][lane] = row[d * cells];
          }
        }
        for (int d = 0; d < p.size; ++d) {
          out.told[k + d][lane] = p.told[d * cells + column];
          for (int c = 0; c <= d; ++c) {
            out.lower[k + d][k + c][lane] = p.square[(d * p.size + c) * cells + column];
          }
        }
      }
    }
  }

  std::array<std::vector<int>, kMostContacts> cell_;  // of each set
  std::array<Matrix, 3> both_;                        // products of the columns of two loads
  Row weight_, peak_of_, scale_of_;
};

class InSpace : public Explanations {
 public:
  InSpace(Readings&& given, const Input& in, const Priors& priors, const Settings& settings)
      : Explanations(std::move(given), priors, settings), space_(*settings.space) {
    for (const int i : readings.index) direction_.push_back(space_.direction[i]);
    rest_ = curvature_of([&](int i) { return pick(in.body, i) * in.length; });
    // The body that the readings show: with what is missing as if it were free.
    Row shown(in.curvature.size());
    for (std::size_t i = 0; i < shown.size(); ++i) shown[i] = pick(in.body, i) * in.length;
    for (int i = 0; i < frame_.size(); ++i) shown[readings.index[i]] += frame_.excess[i];
    start_ = curvature_of([&](int i) { return shown[i]; });
    if (weighs()) {
      Curvature hanging = rest_;
      for (int pass = 0; pass < kMostTurns; ++pass) {
        const SpaceShape shape = bent_to(hanging);
        Curvature next = base(shape);
        const double change = apart(next, hanging);
        for (std::size_t c = 0; c < next.size(); ++c) {
          for (int j = 0; j < 3; ++j) next[c][j] = 0.5 * (next[c][j] + hanging[c][j]);
        }
        hanging = std::move(next);
        if (change < 1e-6) break;
      }
      const SpaceShape shape = bent_to(hanging);
      const Lines lines(shape, frame_, direction_);
      hanging_.resize(frame_.size());
      for (int i = 0; i < frame_.size(); ++i) {
        hanging_[i] = lines.by_weight(i, shape, space_.weight);
        readings.frame.excess[i] -= hanging_[i];
      }
      rest_weighed_ = base(shape);
      const Row& excess = frame_.excess;
      const double square = Whitener::dot(excess.data(), excess.data(), frame_.size());
      const double scale = std::max(std::sqrt(square / frame_.size()), priors.trust);
      for (std::size_t s = 0; !readings.known && s < frame_.levels.size(); ++s) {
        readings.frame.levels[s].factor = priors.noise_levels[s] * scale;  // without the weight
      }
      whiten();
    } else {
      rest_weighed_ = rest_;
    }
    for (const Vector& h : direction_) twists_ |= space_.compliance[0] > 0.0 && h[0] != 0.0;
    readings.turn = turn_of(bent_to(rest_));
  }

  // Curvature in each cell above that of the free body: about the normal, about the binormal.
  Row bend(const Hypothesis& by) const {
    Row out;
    for (std::size_t c = 0; c < by.bent.size(); ++c) {
      for (int j = 1; j < 3; ++j) out.push_back(by.bent[c][j] - rest_weighed_[c][j]);
    }
    return out;
  }

  void run() {
    free();
    const double doubtful = readings.known ? misfit_at(priors_.noise_deviate) : INFINITY;
    std::size_t one = add({Load::contact, {kTouch}, kCells}, contact_, bent_to(start_), -1);
    const bool misfit = readings.known && found[one].misfit > limit_;
    if (readings.known) explained = found[0].misfit - found[one].misfit;
    if (explained < found[one].misfit) explained = 0.0;
    if (found[one].misfit > doubtful) {
      const SpaceShape bent = bent_to(found[one].bent);
      readings.frame.levels = {{1.0, std::log1p(-priors_.noise_odds)},
                               {priors_.noise_factor, std::log(priors_.noise_odds)}};
      whiten();
      found.clear();
      free();
      one = add({Load::contact, {kTouch}, kCells}, contact_, bent, -1);
    }
    doubt_of(found[one], {Load::contact, {kTouch}, kCells}, contact_);
    const SpaceShape bent = bent_to(found[one].bent);
    const double turn = turn_of(bent);
    const bool bends = readings.turn > priors_.end_turn;
    const auto odds = [](double given, double usual) { return std::isnan(given) ? usual : given; };
    const bool grip = settings_.held_end != Settings::Held::no;
    const bool face = settings_.log_end > -INFINITY || std::isnan(settings_.log_end);
    if (frame_.size() > 1 && face && std::max(readings.turn, turn) > priors_.end_turn &&
        settings_.held_end != Settings::Held::yes) {
      add({Load::end, {kFace}, 1},
          contact_ + odds(settings_.log_end, bends ? priors_.end : priors_.end_straight), bent, -1);
    }
    const auto several = [&](int count) {
      if (settings_.contacts >= 0) return frame_.size() >= 2 && settings_.contacts >= count;
      return frame_.size() >= count;
    };
    bool poor = misfit;
    SpaceShape bent_by_two = bent;
    if (several(2)) {
      const std::size_t two =
          add({Load::two, {kTouch, kTouch}, kPairCells}, contact_ + priors_.another, bent, -1);
      if (two < found.size()) {
        poor |= !readings.known && found[two].log_weight > found[one].log_weight;
        bent_by_two = bent_to(found[two].bent);
        doubt_of(found[two], {Load::two, {kTouch, kTouch}, kPairCells}, contact_ + priors_.another);
      }
    }
    if (grip && frame_.size() > 1 && (poor || turn > priors_.straight)) {
      double weight = contact_;
      if (settings_.held_end == Settings::Held::perhaps) {
        weight += odds(settings_.log_held, bends ? priors_.held : priors_.held_straight);
      }
      // Held, with a twist or without, and alone or beside a contact.
      const bool twists = space_.compliance[0] > 0.0;
      if (twists) weight -= std::log(2.0);
      for (const SpaceLoad& load : {kTwist, kGrip}) {
        if (load.twisted && !twists) continue;
        const std::size_t held = add({Load::end, {load}, 1}, weight, bent, -1);
        if (held < found.size()) doubt_of(found[held], {Load::end, {load}, 1}, weight);
        if (several(2) && !load.twisted) {
          add({Load::contact_end, {kTouch, load}, kPairCells}, weight + priors_.another,
              bent_by_two, -1);
        }
      }
    }
    if (several(3)) {
      add({Load::three, {kTouch, kTouch, kTouch}, kTripleCells}, contact_ + 2.0 * priors_.another,
          bent_by_two, -1);
    }
    weigh_doubts();
  }

 private:
  bool weighs() const { return dot(space_.weight, space_.weight) > 0.0; }

  // Curvature of a body that the readings `of` show.
  template <class Of>
  Curvature curvature_of(const Of& of) const {
    const Matrix& map = space_.curvature_map;
    Curvature out(map.rows / 2, Vector{});
    for (int r = 0; r < map.rows; ++r) {
      double sum = 0.0;
      for (int i = 0; i < map.columns; ++i) sum += map[r][i] * of(i);
      out[r / 2][1 + r % 2] = sum;
    }
    return out;
  }

  static double apart(const Curvature& a, const Curvature& b) {
    double most = 0.0;
    for (std::size_t c = 0; c < a.size(); ++c) {
      const Vector between = plus(a[c], -1.0, b[c]);
      most = std::max(most, dot(between, between));
    }
    return std::sqrt(most);
  }

  SpaceShape bent_to(Curvature u) const { return {std::move(u), space_.compliance}; }

  // The largest angle of the body with its base.
  double turn_of(const SpaceShape& shape) const {
    double least = 1.0;
    for (std::size_t c = 0; c <= shape.curvature().size(); ++c)
      least = std::min(least, shape.section(c).frame[0][0]);
    return std::acos(std::clamp(least, -1.0, 1.0));
  }

  // Curvature of the body under its weight alone, in a shape.
  Curvature base(const SpaceShape& shape) const {
    Curvature out = rest_;
    if (!weighs()) return out;
    const double cells = static_cast<double>(out.size());
    for (std::size_t c = 0; c < out.size(); ++c) {
      out[c] =
          plus(out[c], 1.0,
               shape.by_weight(shape.at((static_cast<double>(c) + 0.5) / cells), space_.weight));
    }
    return out;
  }

  // What weight adds to the readings in a shape, beyond what it adds to those of the free body.
  Row known(const SpaceShape& shape, const Lines& lines) const {
    Row out;
    if (!weighs()) return out;
    for (int i = 0; i < frame_.size(); ++i) {
      out.push_back(lines.by_weight(i, shape, space_.weight) - hanging_[i]);
    }
    return out;
  }

  Wrenches wrenches(const SpaceLoad& load, const Section& at, double lever) const {
    Wrenches out;
    out.unit = 1.0 / lever;
    const auto add = [&](const Vector& force, double f, const Vector& couple, double c) {
      out.force[out.count] = plus({}, f, force);
      out.couple[out.count++] = plus({}, c, couple);
    };
    for (int j = 1; j < 3; ++j) add(at.frame[j], out.unit, {}, 0.0);
    if (load.along) add(at.frame[0], out.unit, {}, 0.0);
    const double couple = load.held ? 1.0 : settings_.radius * out.unit;
    for (int j = 1; load.couples && j < 3; ++j) add({}, 0.0, at.frame[j], couple);
    if (load.couples && load.twisted) add({}, 0.0, at.frame[0], couple);
    return out;
  }

  // Lays the cells of a load in its window, on a shape.
  void place(SpaceGrid::Placed& p, const SpaceShape& shape, const Lines& lines) const {
    p.place = p.load->anywhere ? middles(p.window, p.cells) : Row{1.0};
    Row lever;
    p.section.clear(), p.wrench.clear();
    for (const double arc : p.place) {
      p.section.push_back(shape.at(arc));
      lever.push_back(shape.largest_lever(p.section.back()));
    }
    const double least = std::max(priors_.least_lever * shape.largest_lever(shape.end()), 1e-6);
    for (std::size_t m = 0; m < lever.size(); ++m) {
      p.wrench.push_back(wrenches(*p.load, p.section[m], std::max(lever[m], least)));
    }
    p.size = p.wrench[0].count;
    fill(lines, p.section, p.wrench, p.column);
  }

  // Columns of loads at sections: (N, numbers * places). Couples come after forces.
  void fill(const Lines& lines, const std::vector<Section>& section,
            const std::vector<Wrenches>& wrench, Matrix& out) const {
    const int places = static_cast<int>(section.size()), size = wrench[0].count;
    out.resize(frame_.size(), places * size);
    for (int i = 0; i < frame_.size(); ++i) {
      double* row = out[i];
      for (int m = 0; m < places; ++m) {
        const auto [force, couple] = lines.response(i, section[m]);
        for (int k = 0; k < size; ++k) {
          row[k * places + m] = dot(force, wrench[m].force[k]);
          if (k > 2) row[k * places + m] += dot(couple, wrench[m].couple[k]);
        }
      }
    }
  }

  // Weighs an explanation; the index of the hypothesis, or that beyond the last if no set of places
  // is possible.
  std::size_t add(const SpaceExplanation& of, double weight, SpaceShape shape, int bad) {
    const Whitened white = with(bad_, bad);
    const int count = static_cast<int>(of.loads.size());
    const bool all = settings_.contacts == count;
    const bool beside =
        of.name != Load::contact && !all && settings_.held_end != Settings::Held::yes;
    SpaceGrid grid;
    for (const SpaceLoad& load : of.loads) {
      const int cells = load.anywhere ? of.cells : 1;
      grid.placed.push_back({&load, {0.0, 1.0}, cells, 0, 0.0, {}, {}, {}, {}, {}, {}, {}});
    }
    const double odds = bad < 0 ? weight : weight + readings.log_bad[bad];
    const double matters = best() - odds + (count == 1 ? -INFINITY : kSeveralMatter);
    const double least = count < 3 || all ? -INFINITY : best() - odds + kNegligible;
    SeveralContacts fit;
    fit.contacts.resize(count);
    bool whole = true;
    int moves = 0;
    double last = INFINITY;
    // What twists the end shows only by how the body bends elsewhere.
    const bool unseen = of.loads.back().twisted && !twists_;
    std::vector<Loaded> before;
    double twist = 0.0;  // of the end, in the shape
    for (int turn = 0; turn < kMostTurns; ++turn) {
      const Lines lines(shape, frame_, direction_);
      double log_volume = 0.0;
      int free = 0;
      for (SpaceGrid::Placed& p : grid.placed) {
        p.width = p.load->anywhere ? (p.window.far - p.window.near) / p.cells : priors_.end_cell;
        if (p.load->anywhere) log_volume += std::log(++free * p.width);
        place(p, shape, lines);
      }
      grid.list();
      if (whole && free > 0) log_volume = -std::log(static_cast<double>(grid.size()));
      fit.known = known(shape, lines);
      if (unseen) add_twist(grid, shape, lines, before, twist, fit.known);
      const auto take = [&](const Whitened::At& at) {
        const Row read = left(at, fit.known);
        grid.take(at.by, read);
        return Whitener::dot(read.data(), read.data(), frame_.size());
      };
      for (std::size_t s = 0; s < white.levels.size(); ++s) {
        const double square = take(white.levels[s]);
        grid.weigh(white.levels[s].by.log_det - 0.5 * square, s, priors_.moments);
      }
      const double scales = static_cast<double>(priors_.moments.size());
      fit.log_evidence = grid.top + std::log(grid.total / scales) + log_volume;
      const Whitened::At& at = white.levels[grid.level];
      if (white.levels.size() > 1) take(at);
      // The first shape is that which the readings show, whatever explains them; the next is that
      // of the loads.
      double hopeless = turn == 0 ? kFarFromIt : priors_.hopeless;
      if (unseen && turn < kTwistTurns) hopeless = turn == 0 ? -INFINITY : kTwistFarFromIt;
      if (beside && fit.log_evidence + odds < best() + hopeless) return found.size();
      if (turn == 0 && least > -INFINITY) {
        grid.solve(prior_.felt);
        if (fit.log_evidence + std::log(grid.all_felt()) < least) return found.size();
      }
      Hypothesis out = hypothesis(of.name, fit, weight, 0, bad);
      Curvature bent = rest(grid, at, shape, out);
      if (unseen) before = likeliest_of(grid);
      const double change = apart(bent, shape.curvature());
      const bool rests = change < prior_.rests || ++moves >= (unseen ? 2 : 1) * kMostPasses;
      for (std::size_t c = 0; change >= 0.8 * last && c < bent.size(); ++c) {  // half a step
        const Vector& before = shape.curvature()[c];
        bent[c] = plus(before, 0.5, plus(bent[c], -1.0, before));
      }
      if (unseen) {
        const double found_now = before.back().number.back();
        twist += (change >= 0.8 * last ? 0.5 : 1.0) * (found_now - twist);
      }
      last = change;
      bool finer = false;
      for (int j = 0; rests && j < count; ++j) {
        SpaceGrid::Placed& p = grid.placed[j];
        if (!p.load->anywhere) continue;
        Row each(p.cells);
        for (int s = 0; s < grid.size(); ++s) each[grid.cell(j, s)] += grid.mass[s] / grid.total;
        const double coarse = all || fit.log_evidence > matters ? kResolved : kCoarse;
        if (*std::max_element(each.begin(), each.end()) < coarse || p.width < 1e-6) continue;
        const Window part = support(each.data(), p.cells, p.window, 10.0 * kOutside, 2);
        if (part.far - part.near >= 0.75 * (p.window.far - p.window.near)) continue;
        p.window = part;
        finer = true, whole = false;
      }
      if (finer || !(rests || turn + 1 == kMostTurns)) {
        shape = bent_to(std::move(bent));
        continue;
      }
      grid.solve(prior_.felt);
      const double nothing = kNothingOfAll * std::exp(std::min(matters - fit.log_evidence, 3.0));
      SeveralContacts shares;
      shares.contacts.resize(count);
      share_out(grid, all, count == 1 ? 0.0 : nothing, shares);
      out.contacts = std::move(shares.contacts), out.sets = std::move(shares.sets);
      for (const SpaceGrid::Placed& p : grid.placed) {
        out.numbers += p.size + p.load->anywhere;
        out.held |= p.load->held;
      }
      found.push_back(std::move(out));
      return found.size() - 1;
    }
    return found.size();
  }

  // Readings, less what is known in a shape, whitened.
  Row left(const Whitened::At& at, const Row& known) const {
    if (known.empty()) return at.read;
    Row excess = frame_.excess;
    for (std::size_t i = 0; i < excess.size(); ++i) excess[i] -= known[i];
    return at.by(excess);
  }

  // The likeliest set of a grid: misfit, forces, and what they bend. Returns the body's curvature
  // by these and by the readings: what the loads leave of a reading bends the body all the same, so
  // the shape is near the true one whatever explains it.
  Curvature rest(const SpaceGrid& of, const Whitened::At& at, const SpaceShape& shape,
                 Hypothesis& out) const {
    const Row load = of.likeliest();
    const int n = frame_.size();
    const Row read = left(at, out.known);
    Row white = read, left = frame_.excess;
    for (std::size_t i = 0; i < out.known.size(); ++i) left[i] -= out.known[i];
    out.loads = Matrix(static_cast<int>(load.size()), n);
    out.bent = base(shape);
    int number = 0;
    for (int j = 0; j < of.count(); ++j) {
      const SpaceGrid::Placed& p = of.placed[j];
      const int cell = of.cell(j, of.best), cells = static_cast<int>(p.section.size());
      const Wrenches& wrench = p.wrench[cell];
      Vector force{}, couple{};
      for (int k = 0; k < p.size; ++k, ++number) {
        force = plus(force, load[number], wrench.force[k]);
        couple = plus(couple, load[number], wrench.couple[k]);
        if (k == 1) out.forces.push_back(force);
        for (int i = 0; i < n; ++i) {
          white[i] -= load[number] * p.white[i][k * cells + cell];
          left[i] -= load[number] * p.column[i][k * cells + cell];
          out.loads[number][i] = of.scale * p.column[i][k * cells + cell];
        }
      }
      shape.add(p.section[cell], force, couple, out.bent);
    }
    out.noise = at.factor, out.misfit = Whitener::dot(white.data(), white.data(), n);
    Curvature all = out.bent;
    const Matrix& map = space_.curvature_map;
    if (out.bad >= 0) left[out.bad] = 0.0;
    for (int r = 0; r < map.rows; ++r) {
      double sum = 0.0;
      for (int i = 0; i < n; ++i) sum += map[r][readings.index[i]] * left[i];
      all[r / 2][1 + r % 2] += sum;
    }
    return all;
  }

  // A load of the likeliest set: its arc, and its numbers.
  struct Loaded {
    double arc;
    Row number;
  };
  static std::vector<Loaded> likeliest_of(const SpaceGrid& grid) {
    const Row load = grid.likeliest();
    std::vector<Loaded> out;
    auto from = load.begin();
    for (int j = 0; j < grid.count(); ++j) {
      const SpaceGrid::Placed& p = grid.placed[j];
      out.push_back({p.place[grid.cell(j, grid.best)], Row(from, from + p.size)});
      from += p.size;
    }
    return out;
  }

  // Readings under loads in a shape.
  Row readings_of(const SpaceGrid& grid, const std::vector<Loaded>& loads, const SpaceShape& shape,
                  const Lines& lines) const {
    Row out(frame_.size());
    Matrix column;
    for (std::size_t j = 0; j < loads.size(); ++j) {
      const Section at = shape.at(loads[j].arc);
      const SpaceGrid::Placed& p = grid.placed[j];
      const auto near = std::min_element(p.place.begin(), p.place.end(), [&](double a, double b) {
        return std::abs(a - at.arc) < std::abs(b - at.arc);
      });
      const double unit = p.wrench[static_cast<std::size_t>(near - p.place.begin())].unit;
      fill(lines, {at}, {wrenches(*p.load, at, 1.0 / unit)}, column);
      for (int i = 0; i < frame_.size(); ++i) {
        for (int k = 0; k < p.size; ++k) out[i] += loads[j].number[k] * column[i][k];
      }
    }
    return out;
  }

  // The column of a couple that twists the end, whose twist turns the directions in which all other
  // loads bend the body: its derivative where the loads were last found (Gauss and Newton).
  // `bent`: number of that couple that bent the shape.
  void add_twist(SpaceGrid& grid, const SpaceShape& shape, const Lines& lines,
                 const std::vector<Loaded>& before, double bent, Row& known) const {
    constexpr double kStep = 1e-4;
    SpaceGrid::Placed& end = grid.placed.back();
    const int n = frame_.size();
    if (before.empty()) {
      for (int i = 0; i < n; ++i) end.column[i][end.size - 1] = 0.0;
      return;
    }
    Curvature u = shape.curvature();
    for (std::size_t c = 0; c < u.size(); ++c) {
      u[c][0] += kStep * dot(shape.section(c).frame[0], shape.end().frame[0]);
    }
    const SpaceShape twisted = bent_to(std::move(u));
    const Row one = readings_of(grid, before, shape, lines);
    const Row two = readings_of(grid, before, twisted, Lines(twisted, frame_, direction_));
    if (known.empty()) known.resize(n);
    for (int i = 0; i < n; ++i) {
      const double slope = space_.compliance[0] * (two[i] - one[i]) / kStep;
      end.column[i][end.size - 1] += slope;
      known[i] -= slope * bent;
    }
  }

  void doubt_of(const Hypothesis& of, const SpaceExplanation& how, double weight) {
    doubt(of, weight - contact_,
          [this, how, weight, start = of.bent](int i) { add(how, weight, bent_to(start), i); });
  }

  static constexpr double kCoarse = 0.9;  // mass of a cell above which the grid tells nothing
  static constexpr double kNothingOfAll = 1e-4;
  static constexpr int kTwistTurns = 5;        // in which an unseen twist is found
  static constexpr double kFarFromIt = -40.0;  // log odds at the first shape, as none that is right
  // The same while a twist is found, which goes too far at first: to -94 in 800 frames.
  static constexpr double kTwistFarFromIt = -400.0;

  const Space& space_;
  std::vector<Vector> direction_;
  Curvature rest_, start_, rest_weighed_;
  bool twists_ = false;  // and sensors measure it
  Row hanging_;          // what weight adds to the readings of the free body
};

}  // namespace thigmo
