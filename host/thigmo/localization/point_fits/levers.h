// Levers of contacts on a straight body, and the readings that point fits explain by them.
//
// A normal force at arc a on a straight body bends a sensor from `low` to `high` by its lever: 0 up
// to `low`, (a - low)^2 / (2 span) inside the span and a - (low + high) / 2 beyond it. Between two
// neighbouring ends of spans every lever is therefore one quadratic.
#pragma once

#include <numeric>

#include "../shape.h"

namespace thigmo {

// Readings above the free ones in units of the largest, and the ends of their sensors.
struct Excess {
  Row value, low, high;
  int size() const { return static_cast<int>(value.size()); }
};

using Ranges = std::vector<std::pair<double, double>>;

// The global fit of one frame. `gap` is how far its proven lower bound lies below the objective;
// `optimum_set` holds, by contact, the ranges of its arc on which the minimum is attained.
struct PointFit {
  double objective, gap;
  Row arc, force;
  std::vector<Ranges> optimum_set;
};

constexpr double kTolerance = 1e-9;  // of the objective without contact: less counts as equal

// What a unit force at an arc adds to a sensor's reading.
inline double lever(double arc, double low, double high) {
  if (arc >= high) return arc - 0.5 * (low + high);
  return arc <= low ? 0.0 : (arc - low) * (arc - low) / (2.0 * (high - low));
}

// Ends of spans and of the body, ascending: between two neighbours no lever changes its form.
inline Row cell_edges(const Excess& frame) {
  Row edges{0.0, 1.0};
  edges.insert(edges.end(), frame.low.begin(), frame.low.end());
  edges.insert(edges.end(), frame.high.begin(), frame.high.end());
  std::sort(edges.begin(), edges.end());
  edges.erase(std::unique(edges.begin(), edges.end()), edges.end());
  return edges;
}

// Sort by key, and find the place in `order` up to which the weights first add up to `need`; the
// end if they never do.
inline std::size_t crossing(std::vector<int>& order, const Row& key, const Row& weight,
                            double need) {
  std::sort(order.begin(), order.end(), [&](int a, int b) { return key[a] < key[b]; });
  std::size_t place = 0;
  while (place < order.size() && (need -= weight[order[place]]) > 0.0) ++place;
  return place;
}

}  // namespace thigmo
