// Global fit of one or two contacts by branch and bound, in the 1- or the 2-norm.
//
// One contact is two of which the proximal is held at the base, where it bends nothing. A box holds
// each contact between two arcs, with the sign of its force. A sensor whose span the box of a
// contact enters or leaves is left out. For every other one the lever is a line or a quadratic of
// the arc within the box, so the vector of levers runs within the hull of three Bezier points, and
// a contact contributes a combination of them with weights of one sign that add up to its force:
// the least misfit over such weights (`signed_fit.h`) is a lower bound. It is exact where no span
// holds a contact; elsewhere its error falls with the square of the box. Boxes are split at ends of
// spans first, then where the hull is loosest, at the arc that the weights stand for.
#pragma once

#include <queue>

#include "../answer.h"
#include "signed_fit.h"

namespace thigmo {

using Ranges = std::vector<std::pair<double, double>>;

// What a unit force at an arc of a straight body adds to a sensor's reading.
inline double lever(double arc, double low, double high) {
  if (arc >= high) return arc - 0.5 * (low + high);
  return arc <= low ? 0.0 : (arc - low) * (arc - low) / (2.0 * (high - low));
}

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

class Search {
 public:
  // Of a frame, the excess and the ends of sensors; the largest excess is one.
  Search(const Frame& frame, int norm, int contacts)
      : frame_(frame), edges_{0.0, 1.0}, norm_(norm), first_(2 - contacts) {
    for (const double value : frame.excess) rest_ += misfit(value);
    edges_.insert(edges_.end(), frame.low.begin(), frame.low.end());
    edges_.insert(edges_.end(), frame.high.begin(), frame.high.end());
    std::sort(edges_.begin(), edges_.end());
    edges_.erase(std::unique(edges_.begin(), edges_.end()), edges_.end());
  }

  // The fit, with forces over the largest excess. `gap` is how far its proven lower bound lies
  // below the objective; the pieces of a contact are the arcs at which the minimum is attained.
  void fit(Answer& out) const {
    const Box body{{0.0, 0.0}, {first_ == 0 ? 1.0 : 0.0, 1.0}};
    // Where nothing is felt, every arc is as good.
    Pair best{{1.0, 1.0}, {0.0, 0.0}, 0.0, 0.0};
    if (rest_ > 0.0) best = search(body);
    out.objective = best.objective, out.gap = best.objective - best.bound;
    const double level = best.objective + kTolerance * rest_;
    for (int c = first_; c < 2; ++c) {
      Ranges set{{best.arc[c], best.arc[c]}};
      if (rest_ == 0.0) {
        set = {{0.0, 1.0}};
      } else if (norm_ == 1 && first_ == 0) {
        set = {range_around(body, c, best.arc[c], level)};
      } else if (norm_ == 1) {
        set.clear();
        add_ranges(body, level, set);
        const auto [near, far] = *std::max_element(
            set.begin(), set.end(),
            [](const auto& a, const auto& b) { return a.second - a.first < b.second - b.first; });
        best = search(held(body, c, 0.5 * (near + far)));
      }
      out.contacts.push_back(
          {best.arc[c], best.force[c], set.front().first, set.back().second, 0.0, NAN, false, set});
    }
  }

 private:
  static constexpr double kTolerance = 1e-9;  // of the misfit without contact: less is equal
  static constexpr double kLimit = 20.0;      // |force| over the largest reading, of two contacts
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
      if (first < 0.0 && places.far[0] == 0.0) break;  // at the base either sign does nothing
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
    // The best force of one contact adds no more to a reading than that and all others are.
    Hull hull = first_ == 0 ? Hull{kLimit, 1e300} : Hull{1e15, frame_.size() + 1.0};
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
        unreached += misfit(frame_.excess[i]);
        continue;
      }
      hull.reading.push_back(frame_.excess[i]);
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
    SignedFit fit = norm_ == 1 ? fit_signed_l1(hull) : fit_signed_l2(hull);
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
      here.force[c] = point.sign[c] * (own[0] + own[1] + own[2]);
      // Rounding must not take it past the limit.
      if (first_ == 0) here.force[c] = std::clamp(here.force[c], -kLimit, kLimit);
    }
    for (int i = 0; i < frame_.size(); ++i) {
      double residual = frame_.excess[i];
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

  static Box held(Box places, int contact, double arc) {
    places.near[contact] = places.far[contact] = arc;
    places.far[0] = std::min(places.far[0], arc);
    places.near[1] = std::max(places.near[1], arc);
    return places;
  }

  // Ascending ranges of the distal contact's arc within places where a level is reached.
  void add_ranges(const Box& places, double level, Ranges& out) const {
    const Pair found = search(places, level);
    if (found.objective > level) return;
    const auto range = range_around(places, 1, found.arc[1], level);
    Box rest = places;
    rest.far[1] = range.first - kSharp;
    if (rest.far[1] > rest.near[1]) add_ranges(rest, level, out);
    out.push_back(range);
    rest = places;
    rest.near[1] = range.second + kSharp;
    if (rest.far[1] > rest.near[1]) add_ranges(rest, level, out);
  }

  // The connected range of a contact's arc around one where a level is reached.
  std::pair<double, double> range_around(const Box& places, int contact, double arc,
                                         double level) const {
    const auto reached = [&](double at) {
      return search(held(places, contact, at), level).objective <= level;
    };
    std::array<double, 2> ends;
    for (const int side : {0, 1}) {
      const double way = side == 0 ? -1.0 : 1.0;
      Row steps{arc + way * kSharp};
      std::copy_if(edges_.begin(), edges_.end(), std::back_inserter(steps),
                   [&](double edge) { return (edge - steps[0]) * way > 0.0; });
      if (side == 0) std::reverse(steps.begin() + 1, steps.end());
      double good = arc, bad = arc;
      for (const double step : steps) {
        bad = std::clamp(step, places.near[contact], places.far[contact]);
        if (!reached(bad)) break;
        good = bad;
      }
      while (std::abs(bad - good) > kSetWidth) {
        const double middle = 0.5 * (good + bad);
        (reached(middle) ? good : bad) = middle;
      }
      ends[side] = good;
    }
    return {ends[0], ends[1]};
  }

  const Frame& frame_;
  Row edges_;         // ends of spans and of the body, ascending
  int norm_, first_;  // `first_`: 0 if the proximal contact is not held at the base
  double rest_ = 0.0;
};

}  // namespace thigmo
