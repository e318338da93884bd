// Which explanations of a frame are weighed, and how likely each is.
//
// Every frame weighs a free body, one contact, each of them with one bad
// reading or kink, two contacts, and three, whose grid is laid finer unless the
// evidence on it leaves them negligible. What a scene calls for comes in order
// of cost: a contact on the end of a bent body, a folded base near its critical
// moment, and a held end. What leaves a misfit is weighed with one bad reading,
// of those that may bring it within reach of the best. All evidences are
// densities of the same readings, so they compare directly; prior odds are
// those of priors.py. Mistakes in the readings' stated errors (the rows of
// input.h) are weighed for every explanation alike, unless the readings as
// stated are those of a free body. One loop settles the shape and splits the
// grid, whatever the loads, in a plane and in space.
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <utility>

#include "plane.h"
#include "space.h"

namespace thigmo {

struct Hypothesis {
  const Explanation* of;
  double log_weight;         // log evidence plus log prior odds
  Row bent{};                // curvature of the free body, and by its likeliest loads
  Row shape{};               // the same, with what the model of the errors says bends the
                             // body
  double misfit = INFINITY;  // of the likeliest loads: squared whitened residual
  Level level{1.0, 0.0};     // likeliest model of the errors
  Row left{};                // (N,) readings less those of the likeliest loads
  // Probability of each mistake, and of a noise larger than stated.
  std::array<double, kMistakes + 1> mistakes{};
  Row level_shares{};            // probability of each model of the errors
  int numbers = 0;               // how many numbers of its own it fits
  int bad = -1;                  // index of the bad reading
  double at = NAN;               // place of a kink
  std::vector<Loaded> loads{};   // the likeliest
  Shares shares{};               // places of its contacts, base to tip
  std::vector<Vector> forces{};  // in space: of its contacts, across the body, in the base's frame

  bool held() const {
    return std::any_of(loads.begin(), loads.end(), [](const Loaded& l) { return l.load->holds(); });
  }
  const Loaded* on_end() const {
    for (const Loaded& each : loads) {
      if (each.load->where == Load::Where::end) return &each;
    }
    return nullptr;
  }
  // In a plane: force that pushes the end back and couple on it, each with its standard deviation.
  std::array<double, 4> end_load() const {
    const Loaded* end = on_end();
    if (!end || !forces.empty()) return {NAN, NAN, NAN, NAN};
    return {end->value[1], end->spread[1], end->value[2], end->spread[2]};
  }
  // In a plane: where a force on the end's face bears, left of the centreline.
  double offset(double radius) const {
    const Loaded* end = on_end();
    if (!end || end->load->holds() || !(end->value[1] > 0.0) || !forces.empty()) return NAN;
    return std::clamp(end->value[2] / end->value[1], -radius, radius);
  }
};

class Explanations {
 public:
  static constexpr double kMatters = -3.0;         // log share from which a rival has its own grid
  static constexpr double kNegligible = -4.6;      // the same of three that are felt, or left out
  static constexpr double kSeveralMatter = -1.5;   // the same of several contacts
  static constexpr double kHopelessLevel = -12.0;  // the same of a model of the errors
  static constexpr double kFarFromIt =
      -40.0;  // the same at a first shape, as of none that is right
  // The same while a twist is found, which goes too far at first: to -94 in 800 frames.
  static constexpr double kTwistFarFromIt = -400.0;
  static constexpr int kTwistTurns = 5;
  static constexpr double kCoarse = 0.9;  // mass of a cell above which the grid tells nothing
  static constexpr double kNothingOfAll = 1e-4;
  static constexpr int kMostPasses = 18, kMostTurns = 24;

  Readings readings;
  std::vector<Hypothesis> found;
  double explained = 0.0;  // misfit of a free body that one contact takes away, if more than half

  Explanations(Readings&& given, const Input& in, const Options& options)
      : readings(std::move(given)),
        frame_(readings.frame),
        options_(options),
        priors_(options.priors),
        body_(body(in)),
        white_(whitened_as_stated()),
        contact_(readings.known ? priors_.contact : priors_.contact_unsure),
        mark_odds_(readings.log_bad),
        kinks_(frame_.size()) {
    found.reserve(2 * frame_.size() + 8);
    limit_ = misfit_at(priors_.misfit_deviate);
    for (int i = 0; i < frame_.size(); ++i) marks_.push_back({i, {readings.bad[i]}});
    if (!body_->in_space()) add_kinks();
  }

  const Body& body() const { return *body_; }

  void run() {
    weigh_free_body();
    // Beyond this misfit the noise may be larger than stated.
    doubtful_ = readings.known ? misfit_at(priors_.noise_deviate) : INFINITY;
    const bool doubted = frame_.rows.size() > 1;
    std::size_t one = weigh(kOne, contact_, body_->start, 0.0, kNoMark, doubted);
    if (doubted) {
      if (!looks_free()) {
        whiten_by(each_row(frame_.levels));
        drop_hopeless_levels(found[one].shape);
      }
      one = weigh_again(found[one].shape);
    }
    const bool misfit = readings.known && found[one].misfit > limit_;
    if (readings.known) explained = found[0].misfit - found[one].misfit;
    if (explained < found[one].misfit) explained = 0.0;
    if (found[one].misfit > doubtful_) {
      doubtful_ = INFINITY;
      whiten_by(each_noise(frame_.levels));
      drop_hopeless_levels(found[one].shape);
      one = weigh_again(found[one].shape);
    }
    drop_unlikely_levels();
    const Row bent = found[one].shape;
    const double turn = body_->turn_of(bent);
    const bool bends = body_->turn > priors_.end_turn, two_or_more = frame_.size() > 1;
    const auto odds = [](double given, double usual) {
      return std::isnan(given) ? usual : std::log(given);
    };
    const double face = odds(options_.end_odds, bends ? priors_.end : priors_.end_straight);
    const bool held = options_.held_end == Options::Held::yes;
    std::size_t end = kNone;
    if (two_or_more && !held && face > -INFINITY &&
        std::max(body_->turn, turn) > priors_.end_turn) {
      end = weigh(kEnd, contact_ + face, bent);
    }
    const double moment = std::abs(found[one].bent[0] - body_->rest[0]);
    if (options_.critical < INFINITY &&
        (misfit || moment > priors_.near_fold * options_.critical)) {
      const double folded = contact_ + std::log(std::max(folded_share(), 1e-12));
      if (end != kNone) weigh(kEndFolded, folded + priors_.end, found[end].shape);
      for (const double side : {-1.0, 1.0}) weigh(kOneFolded, folded - std::log(2.0), bent, side);
    }
    const auto several = [&](int count) {
      if (options_.contacts >= 0) return two_or_more && options_.contacts >= count;
      return frame_.size() >= count;
    };
    if (options_.couple_odds > 0.0 && frame_.size() > 2) {
      weigh(kOneWithCouple, contact_ + std::log(options_.couple_odds), bent);
    }
    // A mistake that alone explains the readings hides a held end, which
    // explains the same.
    bool poor = misfit || found[one].level.row > 0;
    Row bent_by_two = bent;
    if (several(2)) {
      const std::size_t two = weigh(kTwo, contact_ + priors_.another, bent);
      if (two != kNone) {
        // Noise that is not known hides a misfit.
        poor |= !readings.known && found[two].log_weight > found[one].log_weight;
        bent_by_two = found[two].shape;
      }
    }
    // What bends a straight body so far may hold its end.
    const bool perhaps = options_.held_end == Options::Held::perhaps;
    if (two_or_more && (held || (perhaps && (poor || (turn > priors_.straight && !bends))))) {
      double weight = contact_;
      if (perhaps) weight += odds(options_.held_odds, bends ? priors_.held : priors_.held_straight);
      if (body_->twists()) weight -= std::log(2.0);
      if (body_->twists()) weigh(kHeldTwisted, weight, bent);
      weigh(kHeld, weight, bent);
      if (several(2) && body_->in_space())
        weigh(kOneAndHeld, weight + priors_.another, bent_by_two);
    }
    if (several(3)) weigh(kThree, contact_ + 2.0 * priors_.another, bent_by_two);
    weigh_doubts();
  }

 private:
  static constexpr std::size_t kNone = -1;
  static constexpr int kNoMark = -1;

  std::unique_ptr<Body> body(const Input& in) {
    if (options_.direction.rows > 0) return std::make_unique<SpaceBody>(readings, in, options_);
    return std::make_unique<PlaneBody>(readings, in, options_);
  }

  // Chi-squared that one contact which is right passes as seldom as a standard normal number passes
  // `deviate` (Wilson and Hilferty, PNAS 17 (1931)).
  double misfit_at(double deviate) const {
    const double freedom = std::max(frame_.size() - 2, 1), part = 2.0 / (9.0 * freedom);
    return freedom * std::pow(1.0 - part + deviate * std::sqrt(part), 3);
  }

  double best() const {
    double top = -INFINITY;
    for (const Hypothesis& hypothesis : found) top = std::max(top, hypothesis.log_weight);
    return top;
  }

  // Prior share of contacts that fold the base.
  double folded_share() const {
    double share = 0.0;
    for (const double moment : priors_.moments) {
      share += std::erfc(std::min(options_.critical / (std::numbers::sqrt2 * moment), 30.0));
    }
    return share / static_cast<double>(priors_.moments.size());
  }

  // Kinks between the ends of sensors, where they see one.
  void add_kinks() {
    Row edges = frame_.low;
    edges.insert(edges.end(), frame_.high.begin(), frame_.high.end());
    std::sort(edges.begin(), edges.end());
    for (std::size_t e = 1; e < edges.size(); ++e) {
      const double middle = 0.5 * (edges[e - 1] + edges[e]), width = edges[e] - edges[e - 1];
      if (width < kPoint) continue;
      Row column;
      int first = 0;
      for (int i = 0; i < frame_.size(); ++i) {
        if (!(frame_.low[i] < middle && middle < frame_.high[i])) continue;
        if (column.empty()) first = i;
        column.resize(i - first + 1, 0.0);
        column.back() = priors_.angle / (frame_.high[i] - frame_.low[i]);
      }
      if (column.empty()) continue;
      marks_.push_back({first, column});
      kinks_.push_back(middle);
      // Where the caller does not say at which moment the base folds, it is likelier there.
      const double near = 4.0 * options_.radius;
      const bool fold = options_.folds_perhaps && middle < near;
      mark_odds_.push_back(std::log(width) +
                           (fold ? priors_.base_fold - std::log(near) : priors_.hinge));
      kink_odds_.push_back(std::log(width) + priors_.hinge);
    }
  }

  // Whitens by the errors as stated, beside which the table of mistakes is
  // kept.
  Whitened whitened_as_stated() {
    readings.frame.rows = mistakes(readings, options_, body_->in_space() ? Row{} : body_->rest);
    return Whitened(frame_);
  }

  // Whether the readings, as stated, are those of a free body: then no mistake
  // is in doubt.
  bool looks_free() const {
    Row others;
    for (std::size_t k = 1; k < found.size(); ++k) others.push_back(found[k].log_weight);
    return found[0].misfit < limit_ &&
           log_sum_exp(others) < found[0].log_weight + priors_.untouched;
  }

  // Levels, each with every mistake; each with a noise larger than stated.
  std::vector<Level> each_row(const std::vector<Level>& levels) const {
    std::vector<Level> out;
    for (int row = 0; row < static_cast<int>(frame_.rows.size()); ++row) {
      for (const Level& level : levels) {
        out.push_back({level.factor, level.log_odds + frame_.rows[row].log_odds, row});
      }
    }
    return out;
  }
  std::vector<Level> each_noise(const std::vector<Level>& levels) const {
    // What is larger than the largest counts as that.
    Row factors{1.0}, odds{1.0};
    for (std::size_t k = 0; k < priors_.noise_factors.size(); ++k) {
      if (priors_.noise_factors[k] <= options_.largest_noise) {
        factors.push_back(priors_.noise_factors[k]), odds.push_back(0.0);
      }
      if (factors.size() > 1)
        odds.back() += priors_.noise_odds[k], odds[0] -= priors_.noise_odds[k];
    }
    std::vector<Level> out;
    for (std::size_t k = 0; k < factors.size(); ++k) {
      for (const Level& level : levels) {
        out.push_back({factors[k] * level.factor, level.log_odds + std::log(odds[k]), level.row});
      }
    }
    return out;
  }

  // Takes other models of the errors.
  void whiten_by(std::vector<Level> levels) {
    readings.frame.levels = std::move(levels);
    white_ = Whitened(frame_);
  }

  // Weighs the free body and one contact by these. Returns the index of one
  // contact.
  std::size_t weigh_again(Row shape) {
    found.clear(), doubts_.clear();
    weigh_free_body();
    return weigh(kOne, contact_, std::move(shape));
  }

  static bool stated(const Level& level, bool known) {
    return level.row == 0 && (level.factor == 1.0 || !known);
  }

  // Leaves out the models of the errors, beside those as stated, whose log
  // weight is less than the least of each.
  template <class Least>
  void drop_levels(const Row& log_weight, const Least& least) {
    std::size_t kept = 0;
    for (std::size_t s = 0; s < white_.levels.size(); ++s) {
      const Level& level = frame_.levels[s];
      if (!stated(level, readings.known) && log_weight[s] < least(level)) continue;
      if (kept < s) {
        readings.frame.levels[kept] = readings.frame.levels[s];
        white_.levels[kept] = std::move(white_.levels[s]);
      }
      ++kept;
    }
    readings.frame.levels.resize(kept, {1.0, 0.0});
    white_.levels.erase(white_.levels.begin() + static_cast<std::ptrdiff_t>(kept),
                        white_.levels.end());
  }

  // Leaves out models of the errors that are hopeless even if they leave no
  // misfit, or for a free body and, on this shape, for one contact. The shape
  // is far from that of a model that bends the free body otherwise.
  void drop_hopeless_levels(const Row& shape) {
    Row most;
    for (const Whitened::At& at : white_.levels) most.push_back(at.by.log_det);
    drop_levels(most, [&](const Level&) { return best() + kHopelessLevel; });
    Grid& grid = grid_of(kOne);
    prepare(kOne, 0.0, grid);
    body_->begin(kOne, false);
    std::vector<Loaded> loads;
    body_->take(shape, 1.0, loads);
    Left room;
    lay(grid, white_, room);
    if (!grid.weigh(options_)) return;
    Row log_weight;
    const Row shares = grid.level_shares();
    const double contact = contact_ + evidence(grid, true);
    for (std::size_t s = 0; s < shares.size(); ++s) {
      const double touched = contact + std::log(std::max(shares[s], 1e-300));
      log_weight.push_back(std::max(white_.levels[s].log_density, touched));
    }
    const double top = *std::max_element(log_weight.begin(), log_weight.end());
    drop_levels(log_weight, [&](const Level& level) {
      const ErrorRow& row = frame_.rows[level.row];
      return top + (row.mirrored || row.bends.rows > 0 ? kFarFromIt : priors_.dropped_row);
    });
  }

  // Leaves models of the errors that explain neither a free body nor one
  // contact out of what is weighed from here on. Those as stated stay.
  void drop_unlikely_levels() {
    Row log_weight(white_.levels.size(), -INFINITY);
    double top = -INFINITY;
    for (const Hypothesis& hypothesis : found) {
      for (std::size_t s = 0; s < hypothesis.level_shares.size(); ++s) {
        const double own = hypothesis.log_weight + std::log(hypothesis.level_shares[s] + 1e-300);
        log_weight[s] = std::max(log_weight[s], own), top = std::max(top, own);
      }
    }
    drop_levels(log_weight, [&](const Level&) { return top + priors_.dropped_row; });
  }

  // Probability of each mistake, and of a noise larger than stated, by that of
  // each level.
  std::array<double, kMistakes + 1> mistakes_by(const Row& shares) const {
    std::array<double, kMistakes + 1> out{};
    for (std::size_t s = 0; s < shares.size(); ++s) {
      const Level& level = frame_.levels[s];
      out[static_cast<int>(frame_.rows[level.row].mistake)] += shares[s];
      if (readings.known && level.factor > 1.0) out[kMistakes] += shares[s];
    }
    return out;
  }

  // Bends a shape by what the likeliest model of the errors says of the free
  // body: that it bends to the other side, or by a curvature that the caller
  // did not give.
  void bend_by_mistake(const Whitened::At& at, const Row& left, Row& shape) const {
    const ErrorRow& row = frame_.rows[at.level.row];
    if (body_->in_space()) return;  // where readings, not loads, say how the body bends
    for (std::size_t k = 0; row.mirrored && k < shape.size(); ++k) shape[k] -= 2.0 * body_->rest[k];
    if (row.bends.rows == 0) return;
    Row excess = left;
    for (std::size_t i = 0; i < row.shift.size(); ++i) excess[i] += row.shift[i];
    const Row weighted = at.by.raised(at.by(excess));
    for (int j = 0; j < row.bends.rows; ++j) {
      const double size = Whitener::dot(row.columns[j], weighted.data(), weighted.size());
      for (std::size_t k = 0; k < shape.size(); ++k) shape[k] += size * row.bends[j][k];
    }
  }

  // A free body, and one with a bad reading or a kink.
  void weigh_free_body() {
    const Whitened::At& likeliest = white_.likeliest();
    Hypothesis plain{&kFree,      white_.log_density(), body_->rest,
                     body_->rest, likeliest.square,     likeliest.level};
    plain.left = frame_.excess, plain.level_shares = white_.shares();
    plain.mistakes = mistakes_by(plain.level_shares);
    found.push_back(plain);
    const Row with = white_.log_densities(marks_);
    const int n = frame_.size();
    for (int i = 0; i < n; ++i) {
      const double weight = with[i] + mark_odds_[i];
      if (weight < plain.log_weight + priors_.hopeless) continue;
      found.push_back(plain);
      found.back().log_weight = weight, found.back().bad = i;
    }
    Row each;
    for (std::size_t e = n; e < marks_.size(); ++e) each.push_back(with[e] + kink_odds_[e - n]);
    if (each.empty()) return;
    Hypothesis& kinked = found.emplace_back(plain);
    kinked.of = &kHinge, kinked.log_weight = log_sum_exp(each), kinked.misfit = INFINITY;
    kinked.numbers = 1;
    kinked.at = kinks_[n + (std::max_element(each.begin(), each.end()) - each.begin())];
  }

  // Readings as a shape leaves them, less what is known beside the loads.
  struct Left {
    Frame frame;
    std::optional<Whitened> white;
  };
  const Whitened& left(const Whitened& white, Left& of) const {
    const Row known = body_->known();
    if (known.empty()) return white;
    of.frame = *white.frame;
    for (std::size_t i = 0; i < known.size(); ++i) of.frame.excess[i] -= known[i];
    return of.white.emplace(of.frame);
  }

  // An explanation beside a mark, on the grid and the shape that suit it without.
  struct Doubt {
    Hypothesis rough;
    const Explanation* of;
    double weight, side;
    int mark;
  };
  // Gives the likeliest a grid and a shape of their own.
  void weigh_doubts() {
    std::sort(doubts_.begin(), doubts_.end(), [](const Doubt& a, const Doubt& b) {
      return a.rough.log_weight > b.rough.log_weight;
    });
    for (Doubt& doubt : doubts_) {
      if (doubt.rough.log_weight > best() + kMatters) {
        weigh(*doubt.of, doubt.weight, doubt.rough.shape, doubt.side, doubt.mark);
      } else {
        found.push_back(std::move(doubt.rough));
      }
    }
  }

  // Largest difference of two curvatures in a node or cell, the same however the body is turned.
  double apart(const Row& a, const Row& b) const {
    double most = 0.0;
    for (std::size_t k = 0; k < a.size(); k += body_->components) {
      double square = 0.0;
      for (int j = 0; j < body_->components; ++j) {
        square += (a[k + j] - b[k + j]) * (a[k + j] - b[k + j]);
      }
      most = std::max(most, square);
    }
    return std::sqrt(most);
  }

  // Half a step where steps do not shrink.
  static double stride(double change, double& last) {
    return change < 0.8 * std::exchange(last, change) ? 1.0 : 0.5;
  }
  static void towards(const Row& next, double step, Row& shape) {
    for (std::size_t k = 0; k < next.size(); ++k) shape[k] += step * (next[k] - shape[k]);
  }

  // Lays the grid on the body's shape; returns the readings as that leaves them.
  const Whitened& lay(Grid& grid, const Whitened& white, Left& room) const {
    for (Placed& p : grid.placed) {
      const bool anywhere = p.load->where == Load::Where::anywhere;
      p.width = anywhere ? (p.window.far - p.window.near) / p.cells : priors_.end_cell;
      body_->place(p);
    }
    grid.list();
    const Whitened& read = left(white, room);
    grid.take(read);
    return read;
  }

  // An explanation's grid, whose memory the next frame needs.
  static Grid& grid_of(const Explanation& of) {
    thread_local std::map<const Explanation*, Grid> grids;
    return grids[&of];
  }

  // Weighs an explanation from a shape on, beside a mark or none, and beside marks that may matter.
  // `side`: of the moment that folds the base. `rough`: only its shape, evidence and misfit are
  // needed, by cells of the first grid. Returns the index of the hypothesis, or `kNone` if it is of
  // no account.
  std::size_t weigh(const Explanation& of, double weight, Row shape, double side = 0.0,
                    int mark = kNoMark, bool rough = false) {
    Frame marked;
    std::optional<Whitened> own;
    if (mark >= 0) marked = frame_, marked.share(marks_[mark]), own.emplace(marked);
    const Whitened& white = own ? *own : white_;
    const double odds = weight + (mark < 0 ? 0.0 : mark_odds_[mark]);
    const int bad = mark < frame_.size() ? mark : -1;
    Grid& grid = grid_of(of);
    prepare(of, side, grid);
    const int count = grid.count();
    const bool asked = options_.contacts == count, all = asked && count > 1;
    const bool certain = &of == &kOne || asked || options_.held_end == Options::Held::yes;
    const double matters = count == 1 ? -INFINITY : best() - odds + kSeveralMatter;
    const bool twists = of.loads.back().twists;
    body_->begin(of, std::any_of(of.loads.begin(), of.loads.end(), [](const Load& load) {
                   return load.where != Load::Where::anywhere || load.critical;
                 }));
    bool whole = true;
    Left room;
    double last = INFINITY, step = 1.0;
    std::vector<Loaded> loads;
    for (int turn = 0, passes = 0; turn < kMostTurns; ++turn) {
      body_->take(shape, std::exchange(step, 1.0), loads);
      const Whitened& read = lay(grid, white, room);
      if (!grid.weigh(options_)) return kNone;
      const double log_evidence = evidence(grid, whole);
      // The first shape may be far from that of the loads.
      double hopeless = turn == 0 ? kFarFromIt : priors_.hopeless;
      if (twists && turn < kTwistTurns) hopeless = turn == 0 ? -INFINITY : kTwistFarFromIt;
      const Grid::Likeliest now = grid.likeliest(*read.frame);
      if (!certain && log_evidence + odds < best() + hopeless) {
        if (mark >= 0 || now.misfit < limit_) return kNone;
        const Row most = evidence_beside(grid, read, grid.precision_weighted(read), frame_.size(),
                                         log_evidence, now.misfit);
        double top = -INFINITY;
        for (int i = 0; i < frame_.size(); ++i) top = std::max(top, most[i] + mark_odds_[i]);
        if (odds + top < best() + priors_.hopeless) return kNone;
      }
      if (turn == 0 && count > 2 && !all && now.misfit < limit_) {
        const double least = best() - odds + kNegligible;
        if (log_evidence < least) return kNone;
        grid.solve(0.0);
        if (log_evidence + std::log(grid.all_felt()) < least) return kNone;
      }
      Row bent = body_->bent(now.loads);
      loads = now.loads;
      Row next = body_->shown(bent, now.left, bad);
      bend_by_mistake(read.levels[grid.level], now.left, next);
      const double change = apart(next, shape);
      const bool rests = change < priors_.shape_rests || body_->keeps(next);
      const bool last_turn = turn + 1 == kMostTurns;
      if (!rests && !last_turn && ++passes < kMostPasses) {
        step = stride(change, last);
        towards(next, step, shape);
        continue;
      }
      const double coarse = all || log_evidence > matters ? kResolved : kCoarse;
      if (!last_turn && !rough && split(grid, coarse)) {
        whole = false, shape = next;
        continue;
      }
      // One contact with such a misfit is weighed again, with larger noises.
      if (rough || (&of == &kOne && mark < 0 && now.misfit > doubtful_)) {
        found.push_back(
            {&of, log_evidence + odds, bent, next, now.misfit, read.levels[grid.level].level});
        return found.size() - 1;
      }
      const double nothing =
          count == 1 ? 0.0 : kNothingOfAll * std::exp(std::min(matters - log_evidence, 3.0));
      const auto add = [&](Grid& from, double log_weight, int by) {
        from.solve(nothing);
        const Grid::Likeliest likeliest = from.likeliest(*read.frame);
        Hypothesis& out = found.emplace_back(Hypothesis{
            &of, log_weight, bent, next, likeliest.misfit, read.levels[from.level].level});
        out.left = likeliest.left, out.level_shares = from.level_shares();
        out.mistakes = mistakes_by(out.level_shares);
        out.loads = likeliest.loads, out.forces = body_->forces(out.loads);
        out.shares = share_out(from, all, nothing);
        for (const Placed& p : from.placed) {
          out.numbers += p.size() + (p.load->where == Load::Where::anywhere);
        }
        if (by >= frame_.size())
          out.of = &kOneAndHinge, out.at = kinks_[by], ++out.numbers;
        else
          out.bad = by;
      };
      add(grid, log_evidence + odds, mark);
      const std::size_t index = found.size() - 1;
      if (mark >= 0) return index;
      const double misfit = found[index].misfit;
      int marks = misfit > limit_ ? frame_.size() : 0;
      if (&of == &kOne) marks = static_cast<int>(marks_.size());
      if (marks == 0) return index;
      if (!whole) {  // beside another mark the contacts may lie anywhere
        for (Placed& p : grid.placed) p.window = {0.0, 1.0};
        lay(grid, white, room);
        grid.weigh(options_);
      }
      const double matter = best() + kMatters;
      const std::vector<Matrix> weighted = grid.precision_weighted(read);
      const Row most = evidence_beside(grid, read, weighted, marks, evidence(grid, true), misfit);
      for (int e = 0; e < marks; ++e) {
        if (weight + most[e] + mark_odds_[e] < best() + priors_.hopeless) continue;
        Grid beside = grid.beside(read, weighted, marks_[e]);
        if (!beside.weigh(options_)) continue;
        add(beside, weight + mark_odds_[e] + evidence(beside, true), e);
        if (found.back().log_weight < matter) continue;
        doubts_.push_back({std::move(found.back()), &of, weight, side, e});
        found.pop_back();
      }
      return index;
    }
    return kNone;
  }

  void prepare(const Explanation& of, double side, Grid& grid) const {
    const int across = body_->in_space() ? 2 : 1;
    grid.placed.resize(of.loads.size());
    for (std::size_t j = 0; j < of.loads.size(); ++j) {
      const Load& load = of.loads[j];
      Placed& p = grid.placed[j];
      p.load = &load, p.cells = load.where == Load::Where::anywhere ? of.cells : 1;
      p.window = {0.0, 1.0};
      p.across = load.across ? across : 0;
      const double mean = load.critical ? side / options_.critical_error : 0.0;
      p.number.assign(p.across, {!load.critical, mean, 0.0});
      if (load.along) p.number.push_back({true, 0.0, load.pushes ? 1.0 : 0.0});
      if (load.couples != Load::Couples::none) p.number.resize(p.number.size() + across);
      if (load.twists) p.number.resize(p.number.size() + 1);
      if (load.kinks) p.number.push_back({false, 0.0, side});
    }
  }

  // Log evidence of the sets of a grid that is weighed. On the whole body those listed are all
  // there are: their prior sums to one.
  double evidence(const Grid& grid, bool whole) const {
    double volume = 0.0;
    int free = 0;
    for (const Placed& p : grid.placed) {
      if (p.load->where == Load::Where::anywhere) volume += std::log(++free * p.width);
    }
    if (whole && free > 0) volume = -std::log(static_cast<double>(grid.size()));
    return grid.top + std::log(grid.total / static_cast<double>(priors_.moments.size())) + volume;
  }

  // Log evidence that a grid has beside each of the first marks, about, or at most where its sets
  // leave a misfit: sets that explain it may then differ from those beside the mark.
  Row evidence_beside(const Grid& grid, const Whitened& read, const std::vector<Matrix>& weighted,
                      int marks, double log_evidence, double misfit) const {
    Grid::Densest densest = grid.densest(read, weighted, marks_, marks);
    if (misfit > limit_) return densest.beside;
    for (double& log_density : densest.beside) log_density += log_evidence - densest.plain;
    return densest.beside;
  }

  // Lays finer windows around the mass where a cell holds more than `coarse` of it.
  static bool split(Grid& grid, double coarse) {
    bool finer = false;
    for (std::size_t j = 0; j < grid.placed.size(); ++j) {
      Placed& p = grid.placed[j];
      if (p.load->where != Load::Where::anywhere || p.width < 1e-6) continue;
      Row each(p.cells);
      for (int s = 0; s < grid.size(); ++s) each[grid.cell(static_cast<int>(j), s)] += grid.mass[s];
      if (*std::max_element(each.begin(), each.end()) < coarse * grid.total) continue;
      const Window part = support(each.data(), p.cells, p.window, kOutside * grid.total, 2);
      if (part.far - part.near >= 0.75 * (p.window.far - p.window.near)) continue;
      p.window = part, finer = true;
    }
    return finer;
  }

  const Frame& frame_;
  const Options& options_;
  const Priors& priors_;
  std::unique_ptr<Body> body_;
  Whitened white_;
  double contact_;  // log prior odds of one
  // Bad readings, then kinks: columns that readings share, log odds of each beside loads.
  std::vector<Column> marks_;
  Row mark_odds_, kinks_, kink_odds_;  // place of each; log odds of kinks of a free body
  std::vector<Doubt> doubts_;
  double limit_;     // misfit beyond which an explanation is poor
  double doubtful_;  // misfit of one contact beyond which the noise is larger than stated, perhaps
};

}  // namespace thigmo
