// Global fit of two contacts by branch and bound, in the 1- or the 2-norm.
//
// A box holds each contact between two arcs, with the sign of its force. A sensor whose span the
// box of a contact enters or leaves is left out. For every other one the lever is a line or a
// quadratic of the arc within the box, so the vector of levers runs within the hull of three Bezier
// points, and a contact contributes a combination of them with weights of one sign that add up to
// its force: the least misfit over such weights (`signed_fit.h`) is a lower bound. It is exact
// where no span holds a contact; elsewhere its error falls with the square of the box. Boxes are
// split at ends of spans first, then where the hull is loosest, at the arc that the weights stand
// for.
#pragma once

#include <queue>

#include "signed_fit.h"

namespace thigmo {

struct Box {
  std::array<double, 2> near, far;  // of the proximal and of the distal contact
  std::array<double, 2> sign{};     // of their forces
  double bound = 0.0;               // the objective is not less
};

// Where to split a box, and how much that tightens its hull; zero if nothing does.
struct Cut {
  int contact = 0;
  double arc = 0.0, looseness = 0.0;
};

struct Pair {
  std::array<double, 2> arc{}, force{};
  double objective = INFINITY, bound = INFINITY;
};

class PairSearch {
 public:
  PairSearch(const Excess& frame, int norm) : frame_(frame), norm_(norm) {
    for (const double value : frame.value) rest_ += misfit(value);
  }

  PointFit fit() const {
    // Every arc is as good.
    if (rest_ == 0.0) return {0.0, 0.0, {1.0, 1.0}, {0.0, 0.0}, {{{0.0, 1.0}}, {{0.0, 1.0}}}};
    const Pair best = search({{0.0, 0.0}, {1.0, 1.0}});
    PointFit out{best.objective, best.objective - best.bound, {}, {}, {}};
    const double level = best.objective + kTolerance * rest_;
    for (int c = 0; c < 2; ++c) {
      const double arc = best.arc[c];
      out.arc.push_back(arc);
      out.force.push_back(best.force[c]);
      out.optimum_set.push_back({norm_ == 1 ? range_around(c, arc, level) : std::pair(arc, arc)});
    }
    return out;
  }

 private:
  static constexpr double kLimit = 20.0;      // |force| over the largest reading
  static constexpr std::size_t kRoom = 8192;  // boxes; a search that needs more is cut short
  static constexpr double kThinnest = 1e-12;  // boxes no wider are not split
  static constexpr double kSharp = 1e-6;      // an optimum that does not reach this far is a point
  static constexpr double kSetWidth = 1e-7;   // the ends of an optimum's range are found to this

  double misfit(double residual) const {
    return norm_ == 1 ? std::abs(residual) : residual * residual;
  }

  // The best pair of contacts within places, or the first that is no worse than what is wanted.
  Pair search(const Box& places, double wanted = -1.0) const {
    const auto after = [](const Box& a, const Box& b) { return a.bound > b.bound; };
    std::priority_queue<Box, std::vector<Box>, decltype(after)> open(after);
    for (const double first : {1.0, -1.0}) {
      for (const double second : {1.0, -1.0}) open.push({places.near, places.far, {first, second}});
    }
    Pair best;
    double bar = wanted >= 0.0 ? wanted : INFINITY;  // boxes that cannot be below are given up
    while (!open.empty() && best.objective > wanted) {
      Box box = open.top();
      if (box.bound > bar || open.size() >= kRoom) {
        best.bound = std::min(best.bound, box.bound);
        break;
      }
      open.pop();
      Cut cut;
      const SignedFit hull = bound(box, cut);
      box.bound = std::max(box.bound, hull.bound);
      if (box.bound <= bar) {
        improve(aimed(box, hull.weight, cut), best);
        bar = std::min(bar, best.objective - kTolerance * rest_);
      }
      if (box.bound <= bar && cut.looseness > 0.0) {
        Box proximal = box, distal = box;
        proximal.far[cut.contact] = distal.near[cut.contact] = cut.arc;
        proximal.far[0] = std::min(proximal.far[0], proximal.far[1]);
        distal.near[1] = std::max(distal.near[0], distal.near[1]);
        open.push(proximal);
        open.push(distal);
      } else {
        best.bound = std::min(best.bound, box.bound);
      }
    }
    best.bound = std::min(best.bound, best.objective);
    return best;
  }

  // Lower bound over a box, exact if it is a point; and the end of a span deepest inside it.
  SignedFit bound(const Box& box, Cut& cut) const {
    Hull hull;
    hull.reading.reserve(frame_.size());
    for (Row& column : hull.column) column.reserve(frame_.size());
    double unreached = 0.0;
    for (int i = 0; i < frame_.size(); ++i) {
      const double low = frame_.low[i], high = frame_.high[i];
      bool mixed = false;
      for (int c = 0; c < 2; ++c) {
        for (const double end : {low, high}) {
          const double depth = std::min(end - box.near[c], box.far[c] - end);
          mixed = mixed || depth > 0.0;
          if (depth > cut.looseness) cut = {c, end, depth};
        }
      }
      if (mixed) continue;
      if (box.far[1] <= low) {
        unreached += misfit(frame_.value[i]);
        continue;
      }
      hull.reading.push_back(frame_.value[i]);
      for (int c = 0; c < 2; ++c) {
        const double near = box.near[c], far = box.far[c];
        const double first = lever(near, low, high), last = lever(far, low, high);
        const bool inside = low <= near && far <= high && low < high;
        const double middle =
            inside ? 0.5 * (near - low) * (far - low) / (high - low) : 0.5 * (first + last);
        hull.column[kEach * c].push_back(box.sign[c] * first);
        hull.column[kEach * c + 1].push_back(box.sign[c] * last);
        hull.column[kEach * c + 2].push_back(box.sign[c] * middle);
      }
    }
    SignedFit fit = norm_ == 1 ? fit_signed_l1(hull, kLimit) : fit_signed_l2(hull, kLimit);
    fit.bound += unreached;
    return fit;
  }

  // The point that weights of a box's hull stand for; and, if no span ends inside, where to split.
  static Box aimed(const Box& box, const Weights& weight, Cut& cut) {
    const bool ends_inside = cut.looseness > 0.0;
    Box point = box;
    for (int c = 0; c < 2; ++c) {
      const double* own = &weight[kEach * c];
      const double width = box.far[c] - box.near[c], force = own[0] + own[1] + own[2];
      const double share = force > 0.0 ? std::min((own[1] + 0.5 * own[2]) / force, 1.0) : 0.5;
      point.near[c] = point.far[c] = box.near[c] + share * width;
      const double loose = std::abs(own[1] - force * share * share) * width * width + 1e-30 * width;
      if (!ends_inside && width > kThinnest && loose > cut.looseness) {
        const double at = 0.1 <= share && share <= 0.9 ? share : 0.5;
        cut = {c, box.near[c] + at * width, loose};
      }
    }
    return point;
  }

  // Take a point with its best forces if it is better.
  void improve(const Box& point, Pair& best) const {
    Cut none;
    const Weights weight = bound(point, none).weight;
    Pair here{point.near, {}, 0.0};
    for (int c = 0; c < 2; ++c) {
      const double* own = &weight[kEach * c];
      // Rounding must not take a force past the limit.
      here.force[c] = point.sign[c] * std::min(own[0] + own[1] + own[2], kLimit);
    }
    for (int i = 0; i < frame_.size(); ++i) {
      double residual = frame_.value[i];
      for (int c = 0; c < 2; ++c) {
        residual -= here.force[c] * lever(here.arc[c], frame_.low[i], frame_.high[i]);
      }
      here.objective += misfit(residual);
    }
    if (here.objective >= best.objective) return;
    if (here.arc[0] > here.arc[1]) {
      std::swap(here.arc[0], here.arc[1]);
      std::swap(here.force[0], here.force[1]);
    }
    here.bound = best.bound;
    best = here;
  }

  // The connected range of a contact's arc around a place where a level is reached.
  std::pair<double, double> range_around(int contact, double place, double level) const {
    const Row edges = cell_edges(frame_);
    const auto reached = [&](double arc) {
      const Box held = contact == 0 ? Box{{arc, arc}, {arc, 1.0}} : Box{{0.0, arc}, {arc, arc}};
      return search(held, level).objective <= level;
    };
    std::array<double, 2> ends;
    for (const int side : {0, 1}) {
      const double way = side == 0 ? -1.0 : 1.0;
      Row steps{place + way * kSharp};
      std::copy_if(edges.begin(), edges.end(), std::back_inserter(steps),
                   [&](double edge) { return (edge - steps[0]) * way > 0.0; });
      std::sort(steps.begin(), steps.end(), [&](double a, double b) { return a * way < b * way; });
      double good = place, bad = place;
      for (const double arc : steps) {
        if (arc < 0.0 || arc > 1.0) continue;
        bad = arc;
        if (!reached(arc)) break;
        good = arc;
      }
      while (std::abs(bad - good) > kSetWidth) {
        const double middle = 0.5 * (good + bad);
        (reached(middle) ? good : bad) = middle;
      }
      ends[side] = good;
    }
    return {ends[0], ends[1]};
  }

  const Excess& frame_;
  int norm_;
  double rest_ = 0.0;
};

}  // namespace thigmo
