// Fits frames from standard input, for test_point_fits_sanitized.py: how many readings, contacts
// and which norm; then curvature, position, span, free curvature of each. Prints the objective.
#include <cstdio>

#include "point_fits/point_fit.h"

int main() {
  int readings, contacts, norm;
  while (std::scanf("%d %d %d", &readings, &contacts, &norm) == 3) {
    thigmo::Input input{};
    for (thigmo::Row* column : {&input.curvature, &input.position, &input.span, &input.free}) {
      column->resize(readings);
      for (double& number : *column) {
        if (std::scanf("%lf", &number) != 1) return 2;
      }
    }
    input.gain = {0.0}, input.bad_odds = {1.0};
    input.length = 1.0, input.radius = 1e-6;
    thigmo::Settings settings{};
    settings.contacts = contacts, settings.norm = norm;
    const thigmo::Answer found = thigmo::point_fit(input, settings);
    if (found.problem != thigmo::Problem::none) return 1;
    std::printf("%.17g\n", found.objective);
  }
}
