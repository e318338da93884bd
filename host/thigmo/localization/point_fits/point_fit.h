// Exact point fits: the global least misfit of one or two contacts, in the 1- or the 2-norm.
//
// A contact at arc a with force f over EI adds f times a sensor's lever to what it reads, on a body
// that is taken as straight. The objective is the sum of |residual| (1-norm, the thesis's equation
// 2.10) or of residual^2; a force may have either sign. Nothing starts from a guess.
//
// What is proven. Branch and bound, with bounds that any multipliers of the dual give, finds the
// minimum: global to 1e-9 of the objective without contact, unless the search is cut short, which
// `gap` states. Forces of two contacts are at most 20 times the largest reading. That limit is part
// of the problem: two opposed contacts that merge into a couple of endless force can fit better
// than any true pair. The 1-norm's optimum set is all of it for one contact, and by contact the
// connected range around the one found for two; the ends of ranges and the ends of spans in them
// attain the minimum. The 2-norm has points only.
#pragma once

#include "search.h"

namespace thigmo {

inline Answer point_fit(const Input& input, const Settings& settings) {
  Answer out;
  std::tie(out.problem, out.shows) = problem_of(input);
  if (out.problem != Problem::none) return out;
  Frame frame;
  double size = 0.0;
  for (std::size_t i = 0; i < input.curvature.size(); ++i) {
    if (std::isnan(input.curvature[i])) continue;
    const auto [low, high] = ends_of_sensor(input, i);
    frame.excess.push_back(input.curvature[i] - pick(input.free, i));
    frame.low.push_back(low);
    frame.high.push_back(high);
    size = std::max(size, std::abs(frame.excess.back()));
  }
  for (double& value : frame.excess) value /= size > 0.0 ? size : 1.0;
  Search(frame, settings.norm, settings.contacts == 2 ? 2 : 1).fit(out);
  const double unit = settings.norm == 1 ? size : size * size;
  out.objective *= unit, out.gap *= unit;
  for (FeltContact& contact : out.contacts) contact.force *= size * input.length;
  out.status = Status::ambiguous;
  out.number.fill(NAN);
  out.touched = NAN;
  out.log_odds = NAN;
  return out;
}

}  // namespace thigmo
