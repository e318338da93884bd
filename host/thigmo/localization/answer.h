// From weighed hypotheses to an answer: a mixture over them, intervals, one rule for statuses.
//
// Two claims are kept apart. The number of contacts counts those that move the readings by enough
// (`detected`), over all hypotheses. Each contact that is listed has the set of places where, in
// every hypothesis and whatever its number, the contact nearest to its best point lies. A contact
// is localized if that set is no wider than the limit, and the contact is there with the level's
// probability.
#pragma once

#include <tuple>

#include "hypotheses.h"

namespace thigmo {

struct DetectedContact {
  double arc, force, low, high, deviation, offset = NAN;
  bool localized;
  std::vector<std::pair<double, double>> pieces;
  double probability = 1.0;      // that a contact lies nearer to it than to the others
  Vector vector{NAN, NAN, NAN};  // in space: the force, in the base's frame
  Row edges{}, mass{};           // cells of the body, and the share of each
  Row force_at{}, spread{};      // mean force there, and its standard deviation
};

enum class ContactStatus { no_contact, below_detection, ambiguous, localized };

struct Answer {
  ContactStatus status = ContactStatus::no_contact;
  InputProblem problem = InputProblem::none;
  double shows = 0.0;  // a number that shows the problem
  std::vector<DetectedContact> contacts;
  std::array<double, 4> number{};  // probability of each number of detected contacts
  double touched = 0.0;            // of any contact
  std::vector<Hypothesis> hypotheses;
  Row probability;  // of each
  int best = 0;     // the likeliest of the chosen number
  // Curvature above that of the free body by the best hypothesis: at the nodes in a plane; in space
  // one number for each of the body's two directions.
  Row bend;
  int discarded = -1;
  bool end_open = false;     // only the end, which something may hold, leaves a place open
  bool number_open = false;  // only another number of contacts leaves a place open
  double noise = 0.0, log_odds = 0.0;
  double log_evidence = 0.0;  // of the readings, in the caller's unit
  // Probability of each mistake, and of a noise larger than stated.
  std::array<double, kMistakes + 1> mistakes{};
  double kinked = 0.0;  // probability of a hinge or a fold
  // How well the best hypothesis fits: residuals in the caller's order; their chi-squared; its
  // degrees of freedom; and the lag-one correlation of neighbouring residuals, in standard errors
  // (NaN in space).
  Row residual;
  double misfit = NAN, correlation = NAN;
  int freedom = 0;
  double radius = 0.0;  // of the tube, over the length
};

// Moments of a force over a part of the posterior: the part's mass, and the mass times the mean of
// the force and of its square.
struct Moments {
  double mass = 0.0, force = 0.0, square = 0.0;
  void add(double share, const Moments& moments) {
    mass += share * moments.mass, force += share * moments.force, square += share * moments.square;
  }
};

// Where a contact lies, over all hypotheses. The edges of their grids cut the body into cells.
class Mixture {
 public:
  Row edges, mass, force, spread;  // of each cell its mass; force there, and standard deviation

  // The mass in each cell of one grid, by hypotheses of this number of contacts.
  struct Part {
    const Cells* cells;
    std::size_t number;
    std::vector<Moments> moments;
  };
  Mixture(const std::vector<Part>& parts, Window within) {
    edges.reserve(parts.empty() ? 2 : parts[0].moments.size() + 3);
    edges.push_back(within.near);
    for (const auto& [cells, number, moments] : parts) {
      const auto earlier = static_cast<std::ptrdiff_t>(edges.size());
      for (const double place : cells->place) add_edge(place - 0.5 * cells->width, within);
      add_edge(cells->place.back() + 0.5 * cells->width, within);
      std::inplace_merge(edges.begin(), edges.begin() + earlier, edges.end());
    }
    edges.push_back(within.far);
    edges.erase(
        std::unique(edges.begin(), edges.end(), [](double a, double b) { return b - a < 1e-9; }),
        edges.end());
    edges.back() = within.far;
    const std::size_t count = edges.size() - 1;
    std::vector<Moments> all(count);
    for (const auto& [cells, number, moments] : parts) {
      Row& by_number = by_number_[number];
      by_number.resize(count);
      const double near = cells->place.front() - 0.5 * cells->width, per = 1.0 / cells->width;
      for (std::size_t c = 0; c < count; ++c) {
        const double cell = (0.5 * (edges[c] + edges[c + 1]) - near) * per;
        if (cell < 0.0 || cell >= static_cast<double>(moments.size())) continue;
        const double share = (edges[c + 1] - edges[c]) * per;
        const Moments& there = moments[static_cast<std::size_t>(cell)];
        all[c].add(share, there);
        by_number[c] += share * there.mass;
      }
    }
    double total = 0.0;
    for (const Moments& moments : all) total += moments.mass;
    mass = force = spread = Row(count);
    for (std::size_t c = 0; c < count; ++c) {
      const auto& [weight, first, second] = all[c];
      // Where the posterior has no mass within the window, every place in it is equally likely.
      mass[c] =
          total > 0.0 ? weight / total : (edges[c + 1] - edges[c]) / (within.far - within.near);
      if (weight == 0.0) continue;
      force[c] = first / weight;
      spread[c] = std::sqrt(std::max(second / weight - force[c] * force[c], 0.0));
    }
  }

  double quantile(double share) const {
    double below = 0.0;
    for (std::size_t c = 0; c < mass.size(); ++c) {
      if (below + mass[c] >= share && mass[c] > 0.0) {
        return edges[c] + (edges[c + 1] - edges[c]) * (share - below) / mass[c];
      }
      below += mass[c];
    }
    return edges.back();
  }

  std::size_t cell(double arc) const {
    const auto after = std::upper_bound(edges.begin() + 1, edges.end() - 1, arc);
    return static_cast<std::size_t>(after - edges.begin()) - 1;
  }

  // Intervals of the highest-density set that holds a share of the mass, ascending: all cells at
  // least as dense as the one that completes the share (Hyndman, Am. Stat. 50 (1996)).
  std::vector<std::pair<double, double>> densest(double share) const {
    return densest_by(mass, {mass}, share);
  }

  // The same, so that it also holds the share of the mass of each number of contacts that is
  // likelier than `excluded`; these weigh equally in it. Two contacts near each other load a body
  // nearly as one between them does, and one is likelier beforehand: the densest places of all
  // would be that one's, and neither of the two.
  std::vector<std::pair<double, double>> densest_by_number(double share, double excluded) const {
    std::vector<Row> masses{mass};
    Row weight(mass.size());
    double all = 0.0;
    for (const Row& by_number : by_number_) all += sum(by_number);
    for (const Row& by_number : by_number_) {
      const double total = sum(by_number);
      if (total <= excluded * all) continue;
      masses.push_back(by_number);
      for (std::size_t c = 0; c < weight.size(); ++c) weight[c] += by_number[c] / total;
    }
    return masses.size() > 2 ? densest_by(weight, masses, share) : densest(share);
  }

  // Median within the interval of the highest-density set that holds most mass.
  double median_of_piece(double share) const {
    double most = 0.0, middle = 0.5;
    for (const auto& [near, far] : densest(share)) {
      const double held = below(far) - below(near);
      if (held > most) most = held, middle = 0.5 * (below(near) + below(far));
    }
    return quantile(middle);
  }

  // Root mean square difference of the force from `value`, over the places in these intervals.
  double departure(double value, const std::vector<std::pair<double, double>>& pieces) const {
    double total = 0.0, square = 0.0;
    for (const auto& [near, far] : pieces) {
      for (std::size_t c = cell(near); c + 1 < edges.size() && edges[c] < far; ++c) {
        const double off = force[c] - value;
        total += mass[c], square += mass[c] * (off * off + spread[c] * spread[c]);
      }
    }
    return std::sqrt(square / total);
  }

 private:
  static double sum(const Row& row) { return std::accumulate(row.begin(), row.end(), 0.0); }

  // The cells that are densest by `weight`, until they hold the share of each of these masses.
  // Where another grid's edge cuts a cell in two, the densities of its halves differ by rounding
  // only.
  std::vector<std::pair<double, double>> densest_by(const Row& weight,
                                                    const std::vector<Row>& masses,
                                                    double share) const {
    Row density = weight;
    const std::size_t count = density.size();
    for (std::size_t c = 0; c < count; ++c) density[c] /= edges[c + 1] - edges[c];
    std::vector<std::size_t> order(count);
    std::iota(order.begin(), order.end(), std::size_t{0});
    std::sort(order.begin(), order.end(),
              [&](std::size_t a, std::size_t b) { return density[a] > density[b]; });
    double least = INFINITY;
    for (const Row& part : masses) {
      const double enough = share * (1.0 - 1e-12) * sum(part);
      double held = 0.0, last = INFINITY;
      for (std::size_t k = 0; k < count && held < enough; ++k) {
        held += part[order[k]], last = (1.0 - 1e-9) * density[order[k]];
      }
      least = std::min(least, last);
    }
    std::vector<std::pair<double, double>> pieces;
    for (std::size_t c = 0; c < count; ++c) {
      if (density[c] < least) continue;
      if (!pieces.empty() && pieces.back().second == edges[c]) {
        pieces.back().second = edges[c + 1];
      } else {
        pieces.emplace_back(edges[c], edges[c + 1]);
      }
    }
    return pieces;
  }

  // Mass below an edge.
  double below(double edge) const {
    double sum = 0.0;
    for (std::size_t c = 0; c < mass.size() && edges[c] < edge; ++c) sum += mass[c];
    return sum;
  }
  void add_edge(double edge, Window within) {
    if (edge > within.near && edge < within.far) edges.push_back(edge);
  }

  std::array<Row, kMostContacts + 1> by_number_;  // mass by hypotheses of each number, not scaled
};

// The posterior over hypotheses: how many contacts there are, and where they lie.
class Posterior {
 public:
  // `asked`: the number of contacts if the caller knows it, else -1.
  Posterior(const std::vector<Hypothesis>& hypotheses, const Row& probability, int asked)
      : hypotheses_(hypotheses), probability_(probability), asked_(asked) {
    for (std::size_t k = 0; k < hypotheses.size(); ++k) {
      const Hypothesis& h = hypotheses[k];
      if (h.shares.contacts.empty()) detected[0] += probability[k];
      for (const DetectedSet& set : h.shares.sets) {
        listed[set.count] += probability[k] * set.mass;
        detected[set.count] += probability[k] * set.mass * set.detected;
        detected[0] += probability[k] * set.mass * (1.0 - set.detected);
      }
      if (counts(h)) most_ = std::max(most_, probability[k]);
    }
    for (std::array<double, 4>* shares : {&detected, &listed}) {  // what is unlikely was left out
      const double sum = std::accumulate(shares->begin(), shares->end(), 0.0);
      for (double& share : *shares) share /= std::max(sum, 1e-300);
    }
  }

  // Probability of each number of contacts: of those that are detected, and of those that an answer
  // lists, which is at least one.
  std::array<double, 4> detected{}, listed{};

  // Places of one contact of each set: `choose` returns its index in the set, or -1 for none.
  template <class Choose>
  Mixture mixture(Window within, const Choose& choose) const {
    constexpr double kNegligible = 1e-3;  // share of a hypothesis that changes no interval
    std::vector<Mixture::Part> parts;
    for (std::size_t k = 0; k < hypotheses_.size(); ++k) {
      const Hypothesis& h = hypotheses_[k];
      if (!counts(h) || probability_[k] <= kNegligible * most_) continue;
      const auto& [contacts, sets] = h.shares;
      std::array<std::size_t, kMostContacts> part;  // of each contact
      for (std::size_t j = 0; j < contacts.size(); ++j) {
        if (parts.empty() || parts.back().number != contacts.size() ||
            contacts[j] != *parts.back().cells) {
          parts.push_back(
              {&contacts[j], contacts.size(), std::vector<Moments>(contacts[j].place.size())});
        }
        part[j] = parts.size() - 1;
      }
      for (const DetectedSet& set : sets) {
        const int i = choose(set);
        if (i < 0) continue;
        parts[part[set.contact[i]]].moments[set.cell[i]].add(probability_[k] * set.mass,
                                                             {1.0, set.force[i], set.square[i]});
      }
    }
    return Mixture(parts, within);
  }

  // For each arc, the probability that some contact lies nearer to it than to the other arcs.
  Row present(const Row& arcs) const {
    Row out(arcs.size());
    for (std::size_t k = 0; k < hypotheses_.size(); ++k) {
      for (const DetectedSet& set : hypotheses_[k].shares.sets) {
        std::array<bool, kMostContacts> present_at{};
        for (int i = 0; i < set.count; ++i)
          present_at[nearest(arcs.data(), arcs.size(), set.arc[i])] = true;
        for (std::size_t j = 0; j < arcs.size(); ++j) {
          out[j] += present_at[j] * probability_[k] * set.mass;
        }
      }
    }
    return out;
  }

  // Index of the nearest of `count` arcs.
  static int nearest(const double* arcs, std::size_t count, double arc) {
    int out = 0;
    for (int j = 1; j < static_cast<int>(count); ++j) {
      if (std::abs(arcs[j] - arc) < std::abs(arcs[out] - arc)) out = j;
    }
    return out;
  }

 private:
  bool counts(const Hypothesis& h) const {
    const int size = static_cast<int>(h.shares.contacts.size());
    return asked_ > 0 ? size == asked_ : size > 0;
  }

  const std::vector<Hypothesis>& hypotheses_;
  const Row& probability_;
  int asked_;
  double most_ = 0.0;
};

// Compares the readings with a hypothesis: its loads, its mistake, and the likeliest size of every
// shared error are subtracted, so that only each reading's own noise should remain.
inline void check(const Readings& readings, const Hypothesis& hypothesis, const Options& options,
                  Answer& out) {
  Frame frame = readings.frame;
  frame.excess = hypothesis.left;
  const int bad = hypothesis.bad, n = frame.size();
  if (bad >= 0) frame.share({bad, {readings.bad[bad]}});
  const Whitener whitener(frame, hypothesis.level);
  Row rest = frame.excess_by(hypothesis.level);
  const Row white = whitener(rest), weighted = whitener.precision_weighted(white);
  out.misfit = Whitener::dot(white.data(), white.data(), n);
  out.freedom = n - hypothesis.numbers - (bad >= 0);
  if (bad >= 0) {  // the error of a bad reading stays in its residual
    --frame.shared.rows;
    frame.shared.value.resize(static_cast<std::size_t>(frame.shared.rows) * n);
  }
  const Matrix shared = frame.shared_by(hypothesis.level);
  for (int k = 0; k < shared.rows; ++k) {
    const double size = Whitener::dot(shared[k], weighted.data(), n);
    for (int i = 0; i < n; ++i) rest[i] -= size * shared[k][i];
  }
  out.residual.assign(options.position.size(), NAN);
  double square = 0.0, product = 0.0, before = 0.0;
  for (int i = 0; i < n; ++i) {
    out.residual[readings.index[i]] = rest[i] / options.length;
    if (i == bad) continue;
    const double white_residual = rest[i] / frame.noise[i];
    square += white_residual * white_residual, product += white_residual * before,
        before = white_residual;
  }
  if (options.axis.rows == 0 && square > 0.0) out.correlation = product / square * std::sqrt(n);
}

inline void conclude(Weighing& weighing, const Options& options, Answer& out) {
  const Priors& priors = options.priors;
  constexpr double kNearEnd = 0.95;  // from here on a contact and a hold of the end are one place
  weighing.run();
  const Readings& readings = weighing.readings;
  out.hypotheses = std::move(weighing.hypotheses);
  double top = -INFINITY, total = 0.0, none = 0.0;
  for (const Hypothesis& h : out.hypotheses) top = std::max(top, h.log_weight);
  for (const Hypothesis& h : out.hypotheses) {
    out.probability.push_back(std::exp(h.log_weight - top));
    total += out.probability.back();
  }
  for (std::size_t k = 0; k < out.hypotheses.size(); ++k) {
    out.probability[k] /= total;
    const Hypothesis& h = out.hypotheses[k];
    (h.shares.contacts.empty() ? none : out.touched) += out.probability[k];
    for (std::size_t m = 0; m < out.mistakes.size(); ++m) {
      out.mistakes[m] += out.probability[k] * h.mistakes[m];
    }
    const bool kinks = std::any_of(h.loads.begin(), h.loads.end(),
                                   [](const PlacedLoad& l) { return l.load->kinks; });
    if (kinks || !std::isnan(h.kink_arc)) out.kinked += out.probability[k];
  }
  out.log_evidence = top + std::log(total) + readings.frame.size() * std::log(options.length);
  out.log_odds = std::log(std::max(out.touched, 1e-300) / std::max(none, 1e-300));
  const Posterior posterior(out.hypotheses, out.probability, options.contacts);
  out.number = posterior.detected;
  out.radius = options.radius;
  std::size_t count = 1;
  for (std::size_t k = 2; k < 4; ++k) {
    if (posterior.listed[k] > posterior.listed[count]) count = k;
  }
  // A contact is listed if it is likelier than not, or if the readings are five standard errors
  // from those of a free body without bad readings.
  if (out.touched < 0.5 && weighing.explained < priors.five_sigma) count = 0;
  if (options.contacts >= 0) count = static_cast<std::size_t>(options.contacts);
  double most = -1.0;
  for (std::size_t k = 0; k < out.hypotheses.size(); ++k) {
    if (out.hypotheses[k].shares.contacts.size() == count && out.probability[k] > most) {
      most = out.probability[k];
      out.best = static_cast<int>(k);
    }
  }
  const Hypothesis& best = out.hypotheses[out.best];
  out.bend = weighing.body().above(best.bent);
  out.noise = best.level.factor * readings.noise;
  if (best.bad >= 0) out.discarded = readings.index[best.bad];
  check(readings, best, options, out);
  if (best.shares.contacts.size() != count) count = best.shares.contacts.size();
  // A hypothesis with as many unknowns as good readings fits anything, so it localizes nothing.
  double all = 0.0, open = 0.0, held = 0.0;
  for (std::size_t k = 0; k < out.hypotheses.size(); ++k) {
    const Hypothesis& h = out.hypotheses[k];
    if (h.shares.contacts.size() != count) continue;
    all += out.probability[k];
    if (h.held()) held += out.probability[k];
    if (h.numbers >= readings.frame.size() - (h.bad >= 0)) open += out.probability[k];
  }
  // A hand that holds the end explains the same readings as a contact beside the end.
  const bool perhaps = options.held_end == Options::Held::perhaps &&
                       std::min(held, all - held) > priors.held_excluded * all;
  const bool asked = options.contacts > 0;
  const bool sure = out.touched > 1.0 - priors.excluded && open <= priors.excluded * all &&
                    (asked || out.number[count] >= options.number_level);
  const Window within = count == 1 ? options.within : Window{0.0, 1.0};
  Row medians(count);
  for (std::size_t j = 0; j < count; ++j) {
    const auto ordinal = [&](const DetectedSet& set) {
      return set.count == static_cast<int>(count) ? static_cast<int>(j) : -1;
    };
    medians[j] = posterior.mixture(within, ordinal).quantile(0.5);
  }
  const Row present = count > 0 ? posterior.present(medians) : Row{};
  for (std::size_t j = 0; j < count; ++j) {
    const auto nearest_to = [&](double arc) {
      return posterior.mixture(within, [&](const DetectedSet& set) {
        return Posterior::nearest(set.arc.data(), set.count, arc);
      });
    };
    DetectedContact contact;
    contact.arc = medians[j];
    contact.probability = present[j];
    Mixture mixture = nearest_to(contact.arc);
    // The median of all mass can lie where there is hardly any: a less likely place far away, such
    // as the end, draws it there.
    if (count == 1 && mixture.densest(priors.level).size() > 1) {
      contact.arc = mixture.median_of_piece(priors.level);
      mixture = nearest_to(contact.arc);
    }
    contact.pieces = mixture.densest_by_number(priors.level, priors.excluded);
    contact.low = contact.pieces.front().first;
    contact.high = contact.pieces.back().second;
    contact.force = mixture.force[mixture.cell(contact.arc)];
    const bool there = sure && (asked || contact.probability > 1.0 - priors.excluded);
    const bool placed = there && contact.high - contact.low <= options.width_limit;
    contact.localized = placed && (!perhaps || contact.arc >= kNearEnd);
    out.end_open |= placed && !contact.localized;
    if (there && !placed) {
      const auto of_all = mixture.densest(priors.level);
      out.number_open |= of_all.back().second - of_all.front().first <= options.width_limit;
    }
    if (contact.arc >= 1.0 - priors.end_cell) {  // on the end: where, says its likeliest load
      double heaviest = 0.0;
      for (std::size_t k = 0; k < out.hypotheses.size(); ++k) {
        const Hypothesis& h = out.hypotheses[k];
        if (h.on_end() && h.shares.contacts.size() == 1 && out.probability[k] > heaviest) {
          heaviest = out.probability[k];
          contact.offset = h.offset(options.radius);
          contact.arc = 1.0;
          contact.force = h.shares.sets[0].force[0];
        }
      }
    }
    contact.deviation = mixture.departure(contact.force, contact.pieces);
    if (j < best.forces.size()) {
      const double size = std::sqrt(std::max(dot(best.forces[j], best.forces[j]), 1e-300));
      contact.vector = plus({}, contact.force / size, best.forces[j]);
    }
    contact.edges = std::move(mixture.edges), contact.mass = std::move(mixture.mass);
    contact.force_at = std::move(mixture.force), contact.spread = std::move(mixture.spread);
    out.contacts.push_back(std::move(contact));
  }
  if (count == 0 || (asked && out.touched < 0.5)) {
    // A contact that moves no reading can never be excluded, so its probability is no hint.
    const bool hint = 1.0 - out.number[0] > 2.0 * priors.excluded || count > 0 ||
                      (!readings.known && readings.frame.size() == 1);
    out.status = hint ? ContactStatus::below_detection : ContactStatus::no_contact;
  } else {
    const bool all_localized = std::all_of(out.contacts.begin(), out.contacts.end(),
                                           [](const DetectedContact& c) { return c.localized; });
    out.status = all_localized ? ContactStatus::localized : ContactStatus::ambiguous;
  }
  // Indices of bad readings, in the caller's order.
  for (Hypothesis& h : out.hypotheses) {
    if (h.bad >= 0) h.bad = readings.index[h.bad];
  }
}

inline Answer answer(const Input& input, const Options& options) {
  Answer out;
  std::tie(out.problem, out.shows) = input_problem(input, options);
  if (out.problem != InputProblem::none) return out;
  Weighing weighing(normalised(input, options), input, options);
  conclude(weighing, options, out);
  return out;
}

}  // namespace thigmo
