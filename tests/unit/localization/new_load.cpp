// A load that the table does not have: a couple anywhere on a straight body in a plane. Prints its
// log evidence and the likeliest place, and the log evidence of a contact, for readings of a
// couple.
#include <cstdio>

#include "plane.h"

using namespace thigmo;

int main() {
  const Load couple{.where = Load::Where::anywhere, .couples = Load::Couples::any};
  Options options{};
  Priors& priors = options.priors;
  priors.moments = {0.15, 0.6, 2.4}, priors.least_lever = 0.02, priors.straight = 0.25;
  priors.detected = 3.0;
  options.critical = INFINITY, options.critical_error = 0.1;
  options.length = 1.0, options.radius = 0.03;
  Readings readings;
  Frame& frame = readings.frame;
  for (int i = 0; i < 10; ++i) {  // a couple of 0.2 at 0.6 of the body
    frame.low.push_back(0.1 * i), frame.high.push_back(0.1 * i + 0.05);
    frame.excess.push_back(i < 6 ? 0.2 : 0.0);
    frame.noise.push_back(0.01), frame.gain.push_back(0.0);
  }
  frame.shared = Matrix(0, 10), frame.levels = {{1.0, 0.0}};
  readings.turn = 0.0;
  PlaneBody body(readings, {{}, {}, {0.0}}, options);
  const Whitened white(frame);
  for (const Load& load : {couple, kTouch}) {
    const HypothesisKind alone{"a load of its own", {load}, 60};
    PlaceSets grid;
    LoadColumns& columns =
        grid.load_columns.emplace_back(LoadColumns{&alone.loads[0], alone.cells, {{}}});
    columns.width = 1.0 / alone.cells;
    body.begin(alone, false), body.take(body.start, 1.0, {}), body.place(columns);
    grid.list(), grid.take(white);
    if (!grid.weigh(options)) return 1;
    const double scales = static_cast<double>(priors.moments.size() * alone.cells);
    const PlaceSets::Likeliest likeliest = grid.likeliest(frame);
    std::printf("%g %g %g\n", grid.top + std::log(grid.total / scales) - white.log_density(),
                likeliest.loads[0].arc, likeliest.loads[0].value[0]);
  }
}
