// Which explanations of a frame are weighed, and how likely each is.
//
// Every frame weighs a free body, one contact, and each of them with one bad reading. What a scene
// calls for comes in order of cost: a contact on the end of a bent body, a folded base near its
// critical moment; and where one contact and good readings leave a misfit, a hinge, a contact that
// is spread out, two contacts, three. All evidences are densities of the same readings, so they
// compare directly; prior odds are those of priors.py.
#pragma once

#include <iterator>
#include <tuple>
#include <utility>

#include "loads.h"
#include "readings.h"

namespace thigmo {

struct Settings {
  double critical, critical_error;  // base moment that folds it, and its relative standard error
  double radius;                    // of the tube
  // Whether something holds the end, so that it bears any couple: surely, surely not, or perhaps.
  enum class Held { no, perhaps, yes } held_end;
  int contacts;  // how many there are known to be, or -1
  Window within;
  double width_limit;
  int norm;  // 1 or 2 for a point fit, 0 for the posterior
};

// Posterior of one contact's place: even cells, their mass, the force at each.
struct Marginal {
  Row place;
  double width;
  Row mass, force, spread;
};

enum class Load { none, hinge, contact, end, fold, spread, contact_hinge, two, three, end_fold };

struct Hypothesis {
  Load load;
  double log_weight;                 // log evidence plus log prior odds
  std::vector<Marginal> contacts{};  // base to tip
  int numbers = 0;                   // how many numbers of its own it fits
  double misfit = INFINITY;          // squared whitened residual
  double noise = 1.0;                // likeliest factor of the noise
  Nodes curvature{};                 // of the body
  int bad = -1;                      // index of the bad reading
  // Further numbers: fold's or hinge's angle, place of the hinge, half width of a spread contact;
  // force that pushes the end back, couple on it, where that bears left of the centreline.
  double angle = NAN, at = NAN, half_width = NAN, push = NAN, couple = NAN, offset = NAN;
};

class Weighing {
 public:
  static constexpr int kCells = 60;         // of a contact's first grid: 0.9 cm of the 53 cm body
  static constexpr double kMatters = -3.0;  // log share from which a rival has its own grid
  static constexpr int kPairCells = 30, kTripleCells = 16, kSecondCells = 24;

  Readings readings;
  std::vector<Hypothesis> found;

  Weighing(Readings&& given, const Priors& priors, const Settings& settings)
      : readings(std::move(given)),
        frame_(readings.frame),
        priors_(priors),
        settings_(settings),
        prior_{priors.moments, priors.least_lever, settings.critical, priors.straight,
               priors.shape_rests},
        bad_(frame_.size(), frame_.size()) {
    found.reserve(2 * frame_.size() + 8);
    for (int i = 0; i < frame_.size(); ++i) bad_[i][i] = readings.bad[i];
    double share = 0.0;
    for (const double moment : priors.moments) {
      share += std::erf(std::min(settings.critical / (std::numbers::sqrt2 * moment), 30.0));
    }
    unfolded_ = share / static_cast<double>(priors.moments.size());
    const double freedom = std::max(frame_.size() - 2, 1), part = 2.0 / (9.0 * freedom);
    // Chi-squared that a right explanation passes in few frames (Wilson and Hilferty).
    limit_ = freedom * std::pow(1.0 - part + priors.misfit_deviate * std::sqrt(part), 3);
  }

  void run() {
    free();
    Hypothesis one = weigh_one();
    const bool misfit = readings.known && one.misfit > limit_;
    if (misfit) {  // the noise may be larger than stated, too
      readings.frame.levels = {{1.0, std::log1p(-priors_.noise_odds)},
                               {priors_.noise_factor, std::log(priors_.noise_odds)}};
      found.clear();
      free();
      one = weigh_one();
    }
    double turn = readings.turn;
    turn = std::max(turn, turn_of(one.curvature));
    const bool held = settings_.held_end == Settings::Held::yes;
    if (frame_.size() > 1 && (turn > priors_.end_turn || held)) end(one.curvature, held);
    const double moment = std::abs(one.curvature[0] - frame_.rest[0]);
    if (settings_.critical < INFINITY &&
        (misfit || moment > priors_.near_fold * settings_.critical)) {
      fold(one.curvature);
    }
    const bool several = settings_.contacts != 0 && settings_.contacts != 1;
    bool poor = misfit;
    if (!readings.known && several && frame_.size() >= 5) {
      poor = gain_of_second(one) > priors_.second_gain;
    }
    // A moment that few contacts have may be a kink.
    const bool strong = moment > priors_.strong && settings_.critical == INFINITY;
    if (poor || strong) hinge(one.curvature, strong);
    if (poor) spread(one.curvature);
    if (poor && settings_.held_end == Settings::Held::perhaps) end(one.curvature, true);
    if (several && frame_.size() >= 2 && (poor || settings_.contacts > 1)) weigh_several();
  }

 private:
  double best() const {
    double top = -INFINITY;
    for (const Hypothesis& hypothesis : found) top = std::max(top, hypothesis.log_weight);
    return top;
  }

  void free() {
    Hypothesis plain{Load::none, log_density(frame_, frame_.shared)};
    std::tie(plain.misfit, plain.noise) = free_misfit(frame_);
    plain.curvature = frame_.rest;
    found.push_back(plain);
    const Row with = log_densities(frame_, bad_);
    for (int i = 0; i < frame_.size(); ++i) {
      const double weight = with[i] + readings.log_bad[i];
      if (weight > plain.log_weight + priors_.hopeless) {
        found.push_back(plain);
        found.back().log_weight = weight;
        found.back().bad = i;
      }
    }
  }

  // Shared columns of the frame and one more.
  Matrix with(const Matrix& columns, int row) const {
    Matrix more(1, frame_.size());
    std::copy(columns[row], columns[row] + frame_.size(), more[0]);
    return stacked(frame_.shared, more);
  }

  OneContact fit_one(const Matrix& shared, const Nodes& start, double half = 0.0) const {
    return one_contact(frame_, shared, prior_, {0.0, 1.0}, kCells, half, start);
  }

  // One contact, then one beside each rival that is worth weighing: on the same grid, and by
  // itself where that may change the answer. `bad` is the rival's index.
  std::vector<Hypothesis> contact_and(const Matrix& column, const Row& log_odds,
                                      const Nodes& start) const {
    const double weight = priors_.contact + std::log(unfolded_);
    const Rivals rivals{column, log_odds, best() - weight, priors_.hopeless};
    std::vector<RivalContact> beside;
    std::vector<Hypothesis> out;
    out.push_back(contact(Load::contact,
                          one_contact(frame_, frame_.shared, prior_, {0.0, 1.0}, kCells, 0.0, start,
                                      &rivals, &beside),
                          weight));
    const double matters = std::max(best(), out[0].log_weight) + kMatters;
    for (RivalContact& other : beside) {
      const double odds = weight + log_odds[other.index];
      if (other.contact.log_evidence + odds > matters) {
        other.contact = fit_one(with(column, other.index), out[0].curvature);
      }
      out.push_back(contact(Load::contact, std::move(other.contact), odds));
      out.back().bad = other.index;
    }
    return out;
  }

  Hypothesis contact(Load load, OneContact&& fit, double weight) const {
    Hypothesis out{load, fit.log_evidence + weight};
    out.contacts.push_back({std::move(fit.place), fit.width, std::move(fit.mass),
                            std::move(fit.force), std::move(fit.spread)});
    out.numbers = 2;
    out.misfit = fit.misfit;
    out.noise = fit.noise;
    out.curvature = fit.curvature;
    return out;
  }

  Hypothesis weigh_one() {
    std::vector<Hypothesis> contacts = contact_and(bad_, readings.log_bad, frame_.rest);
    std::move(contacts.begin(), contacts.end(), std::back_inserter(found));
    return found[found.size() - contacts.size()];
  }

  void add_end(const Matrix& shared, const Nodes& start, bool held, double weight, int bad) {
    const EndWrench fit = end_wrench(frame_, shared, prior_, settings_.radius, held, start);
    Hypothesis out{Load::end, fit.log_evidence + weight};
    const double cell = priors_.end_cell;
    out.contacts.push_back({{1.0 - 0.5 * cell}, cell, {1.0}, {fit.load[0]}, {fit.spread[0]}});
    out.numbers = 3;
    out.misfit = fit.misfit;
    out.noise = fit.noise;
    out.curvature = fit.curvature;
    out.bad = bad;
    out.push = fit.load[1];
    out.couple = fit.load[2];
    if (!held && fit.load[1] > 0.0) {
      out.offset = std::clamp(fit.load[2] / fit.load[1], -settings_.radius, settings_.radius);
    }
    found.push_back(std::move(out));
  }

  void end(const Nodes& start, bool held) {
    double weight = priors_.contact;
    const bool bends = readings.turn > priors_.end_turn;
    if (!held) weight += bends ? priors_.end : priors_.end_straight;
    if (held && settings_.held_end == Settings::Held::perhaps) weight += priors_.held;
    add_end(frame_.shared, start, held, weight, -1);
    if (found.back().misfit < limit_) return;
    const Nodes shape = found.back().curvature;
    for (int i = 0; i < frame_.size(); ++i) {
      add_end(with(bad_, i), shape, held, weight + readings.log_bad[i], i);
    }
  }

  // What a fold of one radian, spread over one diameter from the base, adds to each reading.
  Row fold_share() const {
    const double diameter = 2.0 * settings_.radius;
    Row share(frame_.size());
    for (int i = 0; i < frame_.size(); ++i) {
      const double span = frame_.high[i] - frame_.low[i];
      const double inside = std::min(frame_.high[i], diameter) - frame_.low[i];
      share[i] = span < kPoint ? frame_.low[i] < diameter : std::max(inside, 0.0) / span;
      share[i] /= diameter;
    }
    return share;
  }

  void fold(const Nodes& start) {
    const int n = frame_.size();
    const Row share = fold_share();
    if (found.back().load == Load::end) {  // the end of a bent body may bear the load as well
      Matrix column(1, n);
      for (int i = 0; i < n; ++i) column[0][i] = priors_.angle * share[i];
      const double weight = priors_.contact + priors_.end + std::log(1.0 - unfolded_ + 1e-12);
      add_end(with(column, 0), found.back().curvature, false, weight, -1);
      found.back().load = Load::end_fold;
      found.back().numbers = 4;
    }
    const double weight = priors_.contact + std::log(std::max(1.0 - unfolded_, 1e-12));
    for (int i = -1; i < n; ++i) {
      const FoldedContact fit =
          folded_contact(frame_, i < 0 ? frame_.shared : with(bad_, i), prior_, settings_.critical,
                         settings_.critical_error, share, priors_.angle, kCells, start);
      if (!(fit.log_evidence > -INFINITY)) return;
      Hypothesis out{Load::fold, fit.log_evidence + weight + (i < 0 ? 0.0 : readings.log_bad[i])};
      Row spread = fit.force;
      for (double& value : spread) value = settings_.critical_error * std::abs(value);
      out.contacts.push_back({fit.place, 1.0 / kCells, fit.mass, fit.force, spread});
      out.numbers = 3;
      out.misfit = fit.misfit;
      out.noise = fit.noise;
      out.noise = fit.noise;
      out.curvature = fit.curvature;
      out.bad = i;
      out.angle = fit.angle[fit.top];
      found.push_back(std::move(out));
      if (i < 0 && fit.misfit < limit_) return;
    }
  }

  void spread(const Nodes& start) {
    const double weight = priors_.contact + priors_.spread -
                          std::log(static_cast<double>(priors_.half_widths.size()));
    for (const double half : priors_.half_widths) {
      found.push_back(contact(Load::spread, fit_one(frame_.shared, start, half), weight));
      found.back().numbers = 3;
      found.back().half_width = half;
    }
  }

  // `folds`: the base may have folded, for a moment that folds most bodies acts there.
  void hinge(const Nodes& start, bool folds) {
    Row edges = frame_.low;
    edges.insert(edges.end(), frame_.high.begin(), frame_.high.end());
    std::sort(edges.begin(), edges.end());
    Row place, log_odds, values;
    const int n = frame_.size();
    for (std::size_t e = 1; e < edges.size(); ++e) {
      const double middle = 0.5 * (edges[e - 1] + edges[e]);
      if (edges[e] - edges[e - 1] < kPoint) continue;
      Row column(n);
      bool seen = false;
      for (int i = 0; i < n; ++i) {
        const bool covers = frame_.low[i] < middle && middle < frame_.high[i];
        column[i] = covers ? priors_.angle / (frame_.high[i] - frame_.low[i]) : 0.0;
        seen = seen || covers;
      }
      if (!seen) continue;
      values.insert(values.end(), column.begin(), column.end());
      place.push_back(middle);
      log_odds.push_back(priors_.hinge + std::log(edges[e] - edges[e - 1]));
    }
    if (place.empty()) return;
    Matrix columns(static_cast<int>(place.size()), n);
    columns.value = values;
    const Row alone = log_densities(frame_, columns);
    for (int h = 0; h < columns.rows; ++h) {
      Hypothesis free{Load::hinge, alone[h] + log_odds[h]};
      free.at = place[h];
      free.curvature = frame_.rest;
      free.numbers = 1;
      found.push_back(free);
      if (folds && place[h] < 4.0 * settings_.radius) log_odds[h] = priors_.base_fold;
    }
    std::vector<Hypothesis> contacts = contact_and(columns, log_odds, start);
    for (std::size_t k = 1; k < contacts.size(); ++k) {
      Hypothesis& kinked = found.emplace_back(std::move(contacts[k]));
      kinked.load = Load::contact_hinge;
      kinked.numbers = 3;
      kinked.at = place[std::exchange(kinked.bad, -1)];
    }
  }

  // Log likelihood that a second contact adds, the first staying where it is, at the level of noise
  // that suits each best.
  double gain_of_second(const Hypothesis& one) const {
    const int n = frame_.size();
    const Marginal& first = one.contacts[0];
    const auto top = std::max_element(first.mass.begin(), first.mass.end()) - first.mass.begin();
    Row place = middles({0.0, 1.0}, kSecondCells);
    place.push_back(first.place[top]);
    std::optional<Shape> shape;
    if (turn_of(one.curvature) >= priors_.straight) shape.emplace(one.curvature);
    const Levers levers = levers_at(frame_, shape, place, 0.0);
    Row left = frame_.excess;
    for (int i = 0; i < n; ++i) left[i] -= first.force[top] * levers.sensor[i][kSecondCells];
    const auto likelihood = [&](const Level& level) {
      const Whitener by(frame_, level, frame_.shared);
      const Row rest = by(left.data());
      return by.log_det - 0.5 * Whitener::dot(rest.data(), rest.data(), n);
    };
    const auto less = [&](const Level& a, const Level& b) { return likelihood(a) < likelihood(b); };
    const std::vector<Level>& levels = frame_.levels;
    const Whitener by(frame_, *std::max_element(levels.begin(), levels.end(), less), frame_.shared);
    const Row rest = by(left.data());
    Matrix white(n, kSecondCells + 1);
    by(levers.sensor, white);
    // Products of the first contact's column, last, and of what each other has beside it.
    Row own(n), beside(n);
    for (int i = 0; i < n; ++i) own[i] = white[i][kSecondCells];
    const double power = Whitener::dot(own.data(), own.data(), n);
    double most = 0.0;
    for (int m = 0; m < kSecondCells; ++m) {
      double both = 0.0;
      for (int i = 0; i < n; ++i) both += white[i][m] * own[i];
      for (int i = 0; i < n; ++i) beside[i] = white[i][m] - both / power * own[i];
      const double apart = Whitener::dot(beside.data(), beside.data(), n);
      const double told = Whitener::dot(beside.data(), rest.data(), n);
      if (apart > 1e-6 * power) most = std::max(most, told * told / apart);
    }
    const double square = Whitener::dot(rest.data(), rest.data(), n);
    return 0.5 * n * std::log(square / std::max(square - most, 1e-9 * square));
  }

  Hypothesis several_contacts_of(int count, int cells, int bad) const {
    const SeveralContacts fit = several_contacts(frame_, bad < 0 ? frame_.shared : with(bad_, bad),
                                                 prior_, count, cells, frame_.rest);
    double weight = priors_.contact + (count - 1) * priors_.another;
    if (bad >= 0) weight += readings.log_bad[bad];
    Hypothesis out{count == 2 ? Load::two : Load::three, fit.log_evidence + weight};
    for (std::size_t j = 0; j < fit.place.size(); ++j) {
      out.contacts.push_back({fit.place[j], fit.width[j], fit.mass[j], Row(cells, fit.force[j]),
                              Row(cells, fit.spread[j])});
    }
    out.numbers = 2 * count;
    out.misfit = fit.misfit;
    out.noise = fit.noise;
    out.curvature = fit.curvature;
    out.bad = bad;
    return out;
  }

  void weigh_several() {
    const Hypothesis two = several_contacts_of(2, kPairCells, -1);
    if (two.contacts.empty()) return;
    found.push_back(two);
    if (two.misfit > limit_) {
      // With one bad reading, of those that one contact would rather do without.
      std::vector<std::pair<double, int>> bad;
      for (const Hypothesis& other : found) {
        if (other.bad >= 0) bad.emplace_back(-other.log_weight, other.bad);
      }
      std::sort(bad.begin(), bad.end());
      std::vector<int> tried;
      for (const auto& [weight, i] : bad) {
        if (tried.size() == 3) break;
        if (std::find(tried.begin(), tried.end(), i) != tried.end()) continue;
        tried.push_back(i);
        found.push_back(several_contacts_of(2, kPairCells, i));
      }
    }
    const bool more = settings_.contacts < 0 && two.misfit > limit_ && frame_.size() >= 6;
    if (settings_.contacts == 3 || more) {
      const Hypothesis three = several_contacts_of(3, kTripleCells, -1);
      if (!three.contacts.empty()) found.push_back(three);
    }
  }

  const Frame& frame_;
  const Priors& priors_;
  const Settings& settings_;
  ForcePrior prior_;
  Matrix bad_;
  double unfolded_;  // prior share of contacts that leave the base as it is
  double limit_;     // misfit beyond which an explanation is poor
};

}  // namespace thigmo
