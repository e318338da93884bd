// Which explanations of a frame are weighed, and how likely each is.
//
// Every frame weighs a free body, one contact, each of them with one bad reading, two contacts, and
// three, whose grid is laid finer unless the evidence on it leaves them negligible. What a scene
// calls for comes in order of cost: a contact on the end of a bent body, a folded base near its
// critical moment, and a hinge where one contact leaves a misfit. What then still leaves a misfit
// is weighed with one bad reading, of those that may bring it within reach of the best. All
// evidences are densities of the same readings, so they compare directly; prior odds are those of
// priors.py.
#pragma once

#include <functional>
#include <optional>
#include <utility>

#include "loads.h"
#include "readings.h"

namespace thigmo {

// A body in space: its readings' directions, and what bends it beside contacts.
struct Space {
  std::vector<Vector> direction;  // (N,) axis of the turn that each measures
  Matrix curvature_map;           // (2 cells, N) the body's bends in each cell, from readings
  Vector compliance;              // EI over the stiffness against each component of a moment
  Vector weight;                  // of a body of length one, over EI
};

struct Settings {
  double critical, critical_error;  // base moment that folds it, and its relative standard error
  bool folds_perhaps;               // at a moment that is not known
  double radius;                    // of the tube
  // Whether something holds the end, so that it bears any couple: surely, surely not, or perhaps.
  enum class Held { no, perhaps, yes } held_end;
  // Log prior odds, against a contact on the side, of one on the end and of a held end; NaN: usual.
  double log_end, log_held;
  int contacts;  // how many there are known to be, or -1
  Window within;
  double width_limit;
  double number_level;  // probability of the number, below which nothing is localized
  std::optional<Space> space;
};

enum class Load {
  none,
  hinge,
  contact,
  end,
  fold,
  contact_hinge,
  two,
  three,
  end_fold,
  contact_end
};

struct Hypothesis : Fit {
  Load load;
  double log_weight;                 // log evidence plus log prior odds
  std::vector<Marginal> contacts{};  // base to tip
  std::vector<FeltSet> sets{};       // of more than one that is felt
  int numbers = 0;                   // how many numbers of its own it fits
  int bad = -1;                      // index of the bad reading
  bool held = false;                 // whether something holds the end
  // Further numbers: fold's or hinge's angle, place of the hinge; force that pushes the end back,
  // couple on it, where that bears left of the centreline.
  double angle = NAN, at = NAN, push = NAN, couple = NAN, offset = NAN;
  double push_spread = NAN, couple_spread = NAN;  // standard deviations
  std::vector<Vector> forces{};  // in space: of its contacts, across the body, in the base's frame
};

// What is common to bodies in a plane and in space: noise, bad readings, and the free body.
class Explanations {
 public:
  static constexpr int kCells = 60;         // of a contact's first grid: 0.9 cm of the 53 cm body
  static constexpr double kMatters = -3.0;  // log share from which a rival has its own grid
  static constexpr int kPairCells = 24, kTripleCells = 12;
  static constexpr double kNegligible = -4.6;      // the same of three that are felt, or left out
  static constexpr double kSeveralMatter = -1.5;   // the same of several contacts
  static constexpr std::size_t kMostSuspects = 5;  // bad readings weighed beside one explanation

  Readings readings;
  std::vector<Hypothesis> found;
  double explained = 0.0;  // misfit of a free body that one contact takes away, if more than half

  Explanations(Readings&& given, const Priors& priors, const Settings& settings)
      : readings(std::move(given)),
        frame_(readings.frame),
        priors_(priors),
        settings_(settings),
        prior_{priors.moments,     priors.least_lever, settings.critical, priors.straight,
               priors.shape_rests, priors.felt,        priors.swept},
        white_(frame_, frame_.shared),
        contact_(readings.known ? priors.contact : priors.contact_unsure),
        bad_(readings.bad) {
    found.reserve(2 * frame_.size() + 8);
    limit_ = misfit_at(priors.misfit_deviate);
  }

 protected:
  // Chi-squared that one contact which is right passes as seldom as a standard normal number passes
  // `deviate` (Wilson and Hilferty, PNAS 17 (1931)).
  double misfit_at(double deviate) const {
    const double freedom = std::max(frame_.size() - 2, 1), part = 2.0 / (9.0 * freedom);
    return freedom * std::pow(1.0 - part + deviate * std::sqrt(part), 3);
  }

  // An explanation that leaves a misfit, and how to weigh it beside a bad reading.
  struct Doubt {
    double log_weight;
    double log_odds;  // prior odds against one contact
    Frame left;       // of the readings, without what the loads' prior means explain
    Matrix loads;     // that were fitted
    std::function<void(int)> weigh;
  };

  double best() const {
    double top = -INFINITY;
    for (const Hypothesis& hypothesis : found) top = std::max(top, hypothesis.log_weight);
    return top;
  }

  // Bad readings that may bring an explanation within reach of the best, the likeliest first: by
  // what they add where its loads change in proportion only, or added to what was weighed already.
  std::vector<int> suspects(const Doubt& doubt) const {
    const Whitened white(doubt.left, stacked(frame_.shared, doubt.loads));
    Row weight = white.log_densities(bad_);
    const double plain = doubt.log_weight - white.log_density();
    for (int i = 0; i < frame_.size(); ++i) weight[i] += plain + readings.log_bad[i];
    for (const Hypothesis& other : found) {
      if (other.bad < 0) continue;
      weight[other.bad] = std::max(weight[other.bad], other.log_weight + doubt.log_odds);
    }
    const double least = best() + priors_.hopeless;
    std::vector<int> out;
    for (int i = 0; i < frame_.size(); ++i) {
      if (weight[i] > least) out.push_back(i);
    }
    std::sort(out.begin(), out.end(), [&](int a, int b) { return weight[a] > weight[b]; });
    out.resize(std::min(out.size(), kMostSuspects));
    return out;
  }

  void doubt(const Hypothesis& of, double log_odds, std::function<void(int)> weigh) {
    if (of.misfit < limit_) return;
    doubts_.push_back({of.log_weight, log_odds, frame_, of.loads, std::move(weigh)});
    for (std::size_t i = 0; i < of.known.size(); ++i) doubts_.back().left.excess[i] -= of.known[i];
  }

  void free() {
    const Whitened::At& likeliest = white_.likeliest();
    Hypothesis plain{{}, Load::none, white_.log_density()};
    plain.misfit = likeliest.square, plain.noise = likeliest.factor;
    plain.curvature = frame_.rest;
    found.push_back(plain);
    const Row with = white_.log_densities(bad_);
    for (int i = 0; i < frame_.size(); ++i) {
      const double weight = with[i] + readings.log_bad[i];
      if (weight > plain.log_weight + priors_.hopeless) {
        found.push_back(plain);
        found.back().log_weight = weight;
        found.back().bad = i;
      }
    }
  }

  // The frame whitened with one more shared column; without one for index -1.
  Whitened with(const Columns& columns, int index) const {
    if (index < 0) return white_;
    Matrix more(1, frame_.size());
    const Columns::Column column = columns[index];
    std::copy_n(column.value, column.count, more[0] + column.from);
    return Whitened(frame_, stacked(frame_.shared, more));
  }

  Hypothesis hypothesis(Load load, const Fit& fit, double weight, int numbers, int bad) const {
    const double odds = bad < 0 ? weight : weight + readings.log_bad[bad];
    return {fit, load, fit.log_evidence + odds, {}, {}, numbers, bad};
  }

  Hypothesis contact(Load load, OneContact fit, double weight, int numbers, int bad) const {
    Hypothesis out = hypothesis(load, fit, weight, numbers, bad);
    out.contacts.push_back(std::move(fit));
    return out;
  }

  void weigh_doubts() {
    for (const Doubt& doubt : doubts_) {
      for (const int i : suspects(doubt)) doubt.weigh(i);
    }
  }

  // After a change of the frame.
  void whiten() { white_ = Whitened(frame_, frame_.shared); }

  const Frame& frame_;
  const Priors& priors_;
  const Settings& settings_;
  ForcePrior prior_;
  Whitened white_;
  double contact_;  // log prior odds of one
  Columns bad_;
  std::vector<Doubt> doubts_;
  double limit_;  // misfit beyond which an explanation is poor
};

class InPlane : public Explanations {
 public:
  InPlane(Readings&& given, const Priors& priors, const Settings& settings)
      : Explanations(std::move(given), priors, settings) {
    double share = 0.0;
    for (const double moment : priors.moments) {
      share += std::erf(std::min(settings.critical / (std::numbers::sqrt2 * moment), 30.0));
    }
    unfolded_ = share / static_cast<double>(priors.moments.size());
  }

  // Curvature at the nodes above that of the free body.
  Row bend(const Hypothesis& by) const {
    Row out(by.curvature.begin(), by.curvature.end());
    for (int k = 0; k < kNodes; ++k) out[k] -= frame_.rest[k];
    return out;
  }

  void run() {
    free();
    // Beyond this misfit the noise may be larger than stated.
    const double doubtful = readings.known ? misfit_at(priors_.noise_deviate) : INFINITY;
    std::size_t one = weigh_one(bad_, readings.log_bad, frame_.rest, doubtful);
    const bool misfit = readings.known && found[one].misfit > limit_;
    if (readings.known) explained = found[0].misfit - found[one].misfit;
    if (explained < found[one].misfit) explained = 0.0;
    if (found[one].misfit > doubtful) {
      const Nodes bent = found[one].curvature;
      readings.frame.levels = {{1.0, std::log1p(-priors_.noise_odds)},
                               {priors_.noise_factor, std::log(priors_.noise_odds)}};
      whiten();
      found.clear();
      free();
      one = weigh_one(bad_, readings.log_bad, bent, INFINITY);
    }
    const Nodes bent = found[one].curvature;
    const bool held = settings_.held_end == Settings::Held::yes;
    const bool turned = std::max(readings.turn, turn_of(bent)) > priors_.end_turn;
    const bool face = settings_.log_end > -INFINITY || std::isnan(settings_.log_end);
    if (frame_.size() > 1 && ((turned && face) || held)) end(bent, held);
    const double moment = std::abs(bent[0] - frame_.rest[0]);
    if (settings_.critical < INFINITY &&
        (misfit || moment > priors_.near_fold * settings_.critical)) {
      fold(bent);
    }
    const auto several = [&](int count) {
      if (settings_.contacts >= 0) return frame_.size() >= 2 && settings_.contacts >= count;
      return frame_.size() >= count;
    };
    bool poor = misfit;
    Nodes bent_by_two = bent;
    if (several(2) && add_several(2, kPairCells, frame_.rest, -1)) {
      // Noise that is not known hides a misfit.
      poor |= !readings.known && found.back().log_weight > found[one].log_weight;
      bent_by_two = found.back().curvature;
    }
    hinge(bent, true);
    // What bends a straight body so far may hold its end.
    const bool held_perhaps =
        poor || (turn_of(bent) > priors_.straight && readings.turn <= priors_.end_turn);
    if (held_perhaps && settings_.held_end == Settings::Held::perhaps) end(bent, true);
    if (several(3)) add_several(3, kTripleCells, bent_by_two, -1);
    weigh_doubts();
  }

 private:
  // One contact, then one beside each rival that is worth weighing: on the same grid, and by
  // itself where that may change the answer. `bad` is the rival's index. Returns the index of the
  // contact alone; rivals are weighed if it leaves no more than the misfit `doubtful`.
  std::size_t weigh_one(const Columns& column, const Row& log_odds, const Nodes& start,
                        double doubtful) {
    const double weight = contact_ + std::log(unfolded_);
    const Rivals rivals{column, log_odds, best() - weight, priors_.hopeless, doubtful};
    ContactsBeside beside;
    OneContact alone = one_contact(white_, prior_, kCells, start, &rivals, &beside);
    const std::size_t first = found.size();
    found.push_back(contact(Load::contact, std::move(alone), weight, 2, -1));
    const double matters = best() + kMatters;
    for (auto& [index, other] : beside) {
      const double odds = weight + log_odds[index];
      if (other.log_evidence + odds > matters) {
        other = one_contact(with(column, index), prior_, kCells, found[first].curvature);
      }
      found.push_back(contact(Load::contact, std::move(other), odds, 2, -1));
      found.back().bad = index;
    }
    return first;
  }

  void add_end(const Whitened& white, const Nodes& start, bool held, double weight, int bad) {
    const EndWrench fit = end_wrench(white, prior_, settings_.radius, held, start);
    Hypothesis out = hypothesis(Load::end, fit, weight, 3, bad);
    const double cell = priors_.end_cell;
    out.contacts.push_back(
        {{1.0 - 0.5 * cell}, cell, {1.0}, {fit.load[0]}, {fit.spread[0]}, {fit.felt}});
    out.held = held;
    out.push = fit.load[1];
    out.couple = fit.load[2];
    out.push_spread = fit.spread[1], out.couple_spread = fit.spread[2];
    if (!held && fit.load[1] > 0.0) {
      out.offset = std::clamp(fit.load[2] / fit.load[1], -settings_.radius, settings_.radius);
    }
    found.push_back(std::move(out));
  }

  void end(const Nodes& start, bool held) {
    double weight = contact_;
    const bool bends = readings.turn > priors_.end_turn;
    const auto odds = [](double given, double usual) { return std::isnan(given) ? usual : given; };
    if (!held) weight += odds(settings_.log_end, bends ? priors_.end : priors_.end_straight);
    if (held && settings_.held_end == Settings::Held::perhaps) {
      weight += odds(settings_.log_held, bends ? priors_.held : priors_.held_straight);
    }
    add_end(white_, start, held, weight, -1);
    const Hypothesis& plain = found.back();
    doubt(plain, weight - contact_, [this, shape = plain.curvature, held, weight](int i) {
      add_end(with(bad_, i), shape, held, weight, i);
    });
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
    Row share = fold_share();
    for (double& value : share) value *= priors_.angle;
    if (found.back().load == Load::end) {  // the end of a bent body may bear the load as well
      Columns column;
      column.add(0, share);
      const double weight = contact_ + priors_.end + std::log(1.0 - unfolded_ + 1e-12);
      add_end(with(column, 0), found.back().curvature, false, weight, -1);
      found.back().load = Load::end_fold;
      found.back().numbers = 4;
    }
    if (!add_fold(share, start, -1)) return;
    doubt(found.back(), std::log(std::max(1.0 - unfolded_, 1e-12)),
          [this, share, start](int i) { add_fold(share, start, i); });
  }

  // Returns whether any place is possible.
  bool add_fold(const Row& share, const Nodes& start, int bad) {
    const double error = settings_.critical_error;
    FoldedContact fit = folded_contact(with(bad_, bad), prior_, error, share, kCells, start);
    if (!(fit.log_evidence > -INFINITY)) return false;
    const double weight = contact_ + std::log(std::max(1.0 - unfolded_, 1e-12));
    found.push_back(contact(Load::fold, fit, weight, 3, bad));
    found.back().angle = priors_.angle * fit.angle[fit.top];
    return true;
  }

  // Kinks anywhere, or only near the base.
  void hinge(const Nodes& start, bool anywhere) {
    Row edges = frame_.low;
    edges.insert(edges.end(), frame_.high.begin(), frame_.high.end());
    std::sort(edges.begin(), edges.end());
    Row place, log_odds;
    Columns columns;
    for (std::size_t e = 1; e < edges.size(); ++e) {
      const double middle = 0.5 * (edges[e - 1] + edges[e]);
      const bool near = middle < 4.0 * settings_.radius;
      if (edges[e] - edges[e - 1] < kPoint || (!anywhere && !near)) continue;
      Row column;
      int first = 0, covered = 0;
      for (int i = 0; i < frame_.size(); ++i) {
        if (!(frame_.low[i] < middle && middle < frame_.high[i])) continue;
        if (column.empty()) first = i;
        column.resize(i - first + 1, 0.0);
        column.back() = priors_.angle / (frame_.high[i] - frame_.low[i]);
        ++covered;
      }
      if (covered == 0) continue;
      columns.add(first, column);
      place.push_back(middle);
      log_odds.push_back(priors_.hinge + std::log(edges[e] - edges[e - 1]));
    }
    const Row alone = white_.log_densities(columns);
    for (int h = 0; h < columns.size(); ++h) {
      Hypothesis& free = found.emplace_back(Hypothesis{{}, Load::hinge, alone[h] + log_odds[h]});
      free.at = place[h];
      free.curvature = frame_.rest;
      free.numbers = 1;
      if (settings_.folds_perhaps && place[h] < 4.0 * settings_.radius) {
        log_odds[h] += priors_.base_fold - priors_.hinge - std::log(4.0 * settings_.radius);
      }
    }
    if (place.empty()) return;
    const double one = contact_ + std::log(unfolded_), least = best() + priors_.hopeless;
    for (std::size_t k = 0, known = found.size(); k < known; ++k) {
      // A kink under one sensor alone looks like a bad reading there, whose body is near.
      if (found[k].load != Load::contact || found[k].bad < 0 || found[k].log_weight < least)
        continue;
      for (int h = 0; h < columns.size(); ++h) {
        if (columns[h].from != found[k].bad || columns[h].count != 1) continue;
        OneContact fit = one_contact(with(columns, h), prior_, kCells, Nodes(found[k].curvature));
        found.push_back(contact(Load::contact_hinge, std::move(fit), one + log_odds[h], 3, -1));
        found.back().at = place[h];
        log_odds[h] = -INFINITY;
      }
    }
    const auto first = static_cast<std::ptrdiff_t>(weigh_one(columns, log_odds, start, INFINITY));
    for (auto kinked = found.erase(found.begin() + first); kinked != found.end(); ++kinked) {
      kinked->load = Load::contact_hinge;
      kinked->numbers = 3;
      kinked->at = place[std::exchange(kinked->bad, -1)];
    }
  }

  // Returns whether any set of places is possible.
  bool add_several(int count, int cells, const Nodes& start, int bad) {
    const double weight = contact_ + (count - 1) * priors_.another;
    const double odds = bad < 0 ? weight : weight + readings.log_bad[bad];
    const bool all = settings_.contacts == count;
    const double top = best() - odds, least = count == 2 || all ? -INFINITY : top + kNegligible;
    SeveralContacts fit = several_contacts(with(bad_, bad), prior_, count, cells, start, all,
                                           top + kSeveralMatter, least);
    if (!(fit.log_evidence > -INFINITY)) return false;
    Hypothesis& out = found.emplace_back(
        hypothesis(count == 2 ? Load::two : Load::three, fit, weight, 2 * count, bad));
    out.contacts = std::move(fit.contacts), out.sets = std::move(fit.sets);
    if (count == 2 && bad < 0) {
      doubt(out, priors_.another, [this, start](int i) { add_several(2, kPairCells, start, i); });
    }
    return true;
  }

  double unfolded_ = 1.0;  // prior share of contacts that leave the base as it is
};

}  // namespace thigmo
