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
  const HypothesisKind* kind;
  double log_weight;         // log evidence plus log prior odds
  Row bent{};                // curvature of the free body, and by its likeliest loads
  Row shape{};               // the same, with what the model of the errors says bends the
                             // body
  double misfit = INFINITY;  // of the likeliest loads: squared whitened residual
  Level level{1.0, 0.0};     // likeliest model of the errors
  Row left{};                // (N,) readings less those of the likeliest loads
  // Probability of each mistake, and of a noise larger than stated.
  std::array<double, kMistakes + 1> mistakes{};
  Row level_shares{};               // probability of each model of the errors
  int numbers = 0;                  // how many numbers of its own it fits
  int bad = -1;                     // index of the bad reading
  double kink_arc = NAN;            // place of a kink
  std::vector<PlacedLoad> loads{};  // the likeliest
  Shares shares{};                  // places of its contacts, base to tip
  std::vector<Vector> forces{};  // in space: of its contacts, across the body, in the base's frame

  bool held() const {
    return std::any_of(loads.begin(), loads.end(),
                       [](const PlacedLoad& l) { return l.load->holds(); });
  }
  const PlacedLoad* on_end() const {
    for (const PlacedLoad& load_columns : loads) {
      if (load_columns.load->where == Load::Where::end) return &load_columns;
    }
    return nullptr;
  }
  // In a plane: force that pushes the end back and couple on it, each with its standard deviation.
  std::array<double, 4> end_load() const {
    const PlacedLoad* end = on_end();
    if (!end || !forces.empty()) return {NAN, NAN, NAN, NAN};
    return {end->value[1], end->spread[1], end->value[2], end->spread[2]};
  }
  // In a plane: where a force on the end's face bears, left of the centreline.
  double offset(double radius) const {
    const PlacedLoad* end = on_end();
    if (!end || end->load->holds() || !(end->value[1] > 0.0) || !forces.empty()) return NAN;
    return std::clamp(end->value[2] / end->value[1], -radius, radius);
  }
};

class Weighing {
 public:
  static constexpr double kMatters = -3.0;     // log share from which a rival has its own grid
  static constexpr double kNegligible = -4.6;  // the same of three that are detected, or left out
  static constexpr double kSeveralMatter = -1.5;   // the same of several contacts
  static constexpr double kHopelessLevel = -12.0;  // the same of a model of the errors
  static constexpr double kHopelessAtFirstShape =
      -40.0;  // the same at a first shape, as of none that is right
  // The same while a twist is found, which goes too far at first: to -94 in 800 frames.
  static constexpr double kHopelessWhileTwisting = -400.0;
  static constexpr int kTwistTurns = 5;
  static constexpr double kCoarse = 0.9;  // mass of a cell above which the grid tells nothing
  static constexpr double kNegligibleShare = 1e-4;
  static constexpr int kMostPasses = 18, kMostTurns = 24;

  Readings readings;
  std::vector<Hypothesis> hypotheses;
  double explained = 0.0;  // misfit of a free body that one contact takes away, if more than half

  Weighing(Readings&& given, const Input& in, const Options& options)
      : readings(std::move(given)),
        frame_(readings.frame),
        options_(options),
        priors_(options.priors),
        body_(body(in)),
        white_(whitened_as_stated()),
        contact_(readings.known ? priors_.contact : priors_.contact_unsure),
        mark_odds_(readings.log_bad),
        kinks_(frame_.size()) {
    hypotheses.reserve(2 * frame_.size() + 8);
    limit_ = misfit_at(priors_.misfit_deviate);
    for (int i = 0; i < frame_.size(); ++i) outliers_and_kinks_.push_back({i, {readings.bad[i]}});
    if (!body_->in_space()) add_kinks();
  }

  const Body& body() const { return *body_; }

  void run() {
    weigh_free_body();
    // Beyond this misfit the noise may be larger than stated.
    doubtful_ = readings.known ? misfit_at(priors_.noise_deviate) : INFINITY;
    const bool doubted = frame_.rows.size() > 1;
    std::size_t one_contact = weigh(kOne, contact_, body_->start, 0.0, kNoMark, doubted);
    if (doubted) {
      if (!looks_free()) {
        whiten_by(each_row(frame_.levels));
        drop_hopeless_levels(hypotheses[one_contact].shape);
      }
      one_contact = weigh_again(hypotheses[one_contact].shape);
    }
    const bool misfit = readings.known && hypotheses[one_contact].misfit > limit_;
    if (readings.known) explained = hypotheses[0].misfit - hypotheses[one_contact].misfit;
    if (explained < hypotheses[one_contact].misfit) explained = 0.0;
    if (hypotheses[one_contact].misfit > doubtful_) {
      doubtful_ = INFINITY;
      whiten_by(each_noise(frame_.levels));
      drop_hopeless_levels(hypotheses[one_contact].shape);
      one_contact = weigh_again(hypotheses[one_contact].shape);
    }
    drop_unlikely_levels();
    const Row bent = hypotheses[one_contact].shape;
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
    const double moment = std::abs(hypotheses[one_contact].bent[0] - body_->rest[0]);
    if (options_.critical < INFINITY &&
        (misfit || moment > priors_.near_fold * options_.critical)) {
      const double folded = contact_ + std::log(std::max(folded_share(), 1e-12));
      if (end != kNone) weigh(kEndFolded, folded + priors_.end, hypotheses[end].shape);
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
    bool poor = misfit || hypotheses[one_contact].level.row > 0;
    Row bent_by_two = bent;
    if (several(2)) {
      const std::size_t two_contacts = weigh(kTwo, contact_ + priors_.another, bent);
      if (two_contacts != kNone) {
        // Noise that is not known hides a misfit.
        poor |= !readings.known &&
                hypotheses[two_contacts].log_weight > hypotheses[one_contact].log_weight;
        bent_by_two = hypotheses[two_contacts].shape;
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
    if (options_.axis.rows > 0) return std::make_unique<SpaceBody>(readings, in, options_);
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
    for (const Hypothesis& hypothesis : hypotheses) top = std::max(top, hypothesis.log_weight);
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
      outliers_and_kinks_.push_back({first, column});
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
    Row rivals;
    for (std::size_t k = 1; k < hypotheses.size(); ++k) rivals.push_back(hypotheses[k].log_weight);
    return hypotheses[0].misfit < limit_ &&
           log_sum_exp(rivals) < hypotheses[0].log_weight + priors_.untouched;
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
    hypotheses.clear(), doubts_.clear();
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
    for (const Whitened::AtLevel& model : white_.levels) most.push_back(model.whitener.log_det);
    drop_levels(most, [&](const Level&) { return best() + kHopelessLevel; });
    PlaceSets& grid = place_sets_of(kOne);
    prepare(kOne, 0.0, grid);
    body_->begin(kOne, false);
    std::vector<PlacedLoad> loads;
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
      return top +
             (row.mirrored || row.bends.rows > 0 ? kHopelessAtFirstShape : priors_.dropped_row);
    });
  }

  // Leaves models of the errors that explain neither a free body nor one
  // contact out of what is weighed from here on. Those as stated stay.
  void drop_unlikely_levels() {
    Row log_weight(white_.levels.size(), -INFINITY);
    double top = -INFINITY;
    for (const Hypothesis& hypothesis : hypotheses) {
      for (std::size_t s = 0; s < hypothesis.level_shares.size(); ++s) {
        const double level_weight =
            hypothesis.log_weight + std::log(hypothesis.level_shares[s] + 1e-300);
        log_weight[s] = std::max(log_weight[s], level_weight), top = std::max(top, level_weight);
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
  void bend_by_mistake(const Whitened::AtLevel& model, const Row& left, Row& shape) const {
    const ErrorRow& row = frame_.rows[model.level.row];
    if (body_->in_space()) return;  // where readings, not loads, say how the body bends
    for (std::size_t k = 0; row.mirrored && k < shape.size(); ++k) shape[k] -= 2.0 * body_->rest[k];
    if (row.bends.rows == 0) return;
    Row excess = left;
    for (std::size_t i = 0; i < row.shift.size(); ++i) excess[i] += row.shift[i];
    const Row weighted = model.whitener.precision_weighted(model.whitener(excess));
    for (int j = 0; j < row.bends.rows; ++j) {
      const double size = Whitener::dot(row.columns[j], weighted.data(), weighted.size());
      for (std::size_t k = 0; k < shape.size(); ++k) shape[k] += size * row.bends[j][k];
    }
  }

  // A free body, and one with a bad reading or a kink.
  void weigh_free_body() {
    const Whitened::AtLevel& likeliest = white_.likeliest();
    Hypothesis plain{&kFree,      white_.log_density(), body_->rest,
                     body_->rest, likeliest.square,     likeliest.level};
    plain.left = frame_.excess, plain.level_shares = white_.shares();
    plain.mistakes = mistakes_by(plain.level_shares);
    hypotheses.push_back(plain);
    const Row with = white_.log_densities(outliers_and_kinks_);
    const int n = frame_.size();
    for (int i = 0; i < n; ++i) {
      const double weight = with[i] + mark_odds_[i];
      if (weight < plain.log_weight + priors_.hopeless) continue;
      hypotheses.push_back(plain);
      hypotheses.back().log_weight = weight, hypotheses.back().bad = i;
    }
    Row kink_weights;
    for (std::size_t e = n; e < outliers_and_kinks_.size(); ++e)
      kink_weights.push_back(with[e] + kink_odds_[e - n]);
    if (kink_weights.empty()) return;
    Hypothesis& kinked = hypotheses.emplace_back(plain);
    kinked.kind = &kHinge, kinked.log_weight = log_sum_exp(kink_weights), kinked.misfit = INFINITY;
    kinked.numbers = 1;
    kinked.kink_arc = kinks_[n + (std::max_element(kink_weights.begin(), kink_weights.end()) -
                                  kink_weights.begin())];
  }

  // Readings as a shape leaves them, less what is known beside the loads.
  struct Left {
    Frame frame;
    std::optional<Whitened> white;
  };
  const Whitened& left(const Whitened& white, Left& room) const {
    const Row known = body_->known();
    if (known.empty()) return white;
    room.frame = *white.frame;
    for (std::size_t i = 0; i < known.size(); ++i) room.frame.excess[i] -= known[i];
    return room.white.emplace(room.frame);
  }

  // An explanation beside a mark, on the grid and the shape that suit it without.
  struct Doubt {
    Hypothesis rough;
    const HypothesisKind* kind;
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
        weigh(*doubt.kind, doubt.weight, doubt.rough.shape, doubt.side, doubt.mark);
      } else {
        hypotheses.push_back(std::move(doubt.rough));
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
  const Whitened& lay(PlaceSets& grid, const Whitened& white, Left& room) const {
    for (LoadColumns& p : grid.load_columns) {
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
  static PlaceSets& place_sets_of(const HypothesisKind& kind) {
    thread_local std::map<const HypothesisKind*, PlaceSets> grids;
    return grids[&kind];
  }

  // Weighs an explanation from a shape on, beside a mark or none, and beside marks that may matter.
  // `side`: of the moment that folds the base. `rough`: only its shape, evidence and misfit are
  // needed, by cells of the first grid. Returns the index of the hypothesis, or `kNone` if it is of
  // no account.
  std::size_t weigh(const HypothesisKind& kind, double weight, Row shape, double side = 0.0,
                    int mark = kNoMark, bool rough = false) {
    Frame marked;
    std::optional<Whitened> marked_white;
    if (mark >= 0)
      marked = frame_, marked.share(outliers_and_kinks_[mark]), marked_white.emplace(marked);
    const Whitened& white = marked_white ? *marked_white : white_;
    const double odds = weight + (mark < 0 ? 0.0 : mark_odds_[mark]);
    const int bad = mark < frame_.size() ? mark : -1;
    PlaceSets& grid = place_sets_of(kind);
    prepare(kind, side, grid);
    const int count = grid.count();
    const bool asked = options_.contacts == count, all = asked && count > 1;
    const bool certain = &kind == &kOne || asked || options_.held_end == Options::Held::yes;
    const double matters = count == 1 ? -INFINITY : best() - odds + kSeveralMatter;
    const bool twists = kind.loads.back().twists;
    body_->begin(kind, std::any_of(kind.loads.begin(), kind.loads.end(), [](const Load& load) {
                   return load.where != Load::Where::anywhere || load.critical;
                 }));
    bool whole = true;
    Left room;
    double last = INFINITY, step = 1.0;
    std::vector<PlacedLoad> loads;
    for (int turn = 0, passes = 0; turn < kMostTurns; ++turn) {
      body_->take(shape, std::exchange(step, 1.0), loads);
      const Whitened& read = lay(grid, white, room);
      if (!grid.weigh(options_)) return kNone;
      const double log_evidence = evidence(grid, whole);
      // The first shape may be far from that of the loads.
      double hopeless = turn == 0 ? kHopelessAtFirstShape : priors_.hopeless;
      if (twists && turn < kTwistTurns) hopeless = turn == 0 ? -INFINITY : kHopelessWhileTwisting;
      const PlaceSets::Likeliest now = grid.likeliest(*read.frame);
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
        if (log_evidence + std::log(grid.all_detected()) < least) return kNone;
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
      if (rough || (&kind == &kOne && mark < 0 && now.misfit > doubtful_)) {
        hypotheses.push_back(
            {&kind, log_evidence + odds, bent, next, now.misfit, read.levels[grid.level].level});
        return hypotheses.size() - 1;
      }
      const double nothing =
          count == 1 ? 0.0 : kNegligibleShare * std::exp(std::min(matters - log_evidence, 3.0));
      const auto add = [&](PlaceSets& sets, double log_weight, int suspect) {
        sets.solve(nothing);
        const PlaceSets::Likeliest likeliest = sets.likeliest(*read.frame);
        Hypothesis& out = hypotheses.emplace_back(Hypothesis{
            &kind, log_weight, bent, next, likeliest.misfit, read.levels[sets.level].level});
        out.left = likeliest.left, out.level_shares = sets.level_shares();
        out.mistakes = mistakes_by(out.level_shares);
        out.loads = likeliest.loads, out.forces = body_->forces(out.loads);
        out.shares = share_out(sets, all, nothing);
        for (const LoadColumns& p : sets.load_columns) {
          out.numbers += p.size() + (p.load->where == Load::Where::anywhere);
        }
        if (suspect >= frame_.size())
          out.kind = &kOneAndHinge, out.kink_arc = kinks_[suspect], ++out.numbers;
        else
          out.bad = suspect;
      };
      add(grid, log_evidence + odds, mark);
      const std::size_t index = hypotheses.size() - 1;
      if (mark >= 0) return index;
      const double misfit = hypotheses[index].misfit;
      int marks = misfit > limit_ ? frame_.size() : 0;
      if (&kind == &kOne) marks = static_cast<int>(outliers_and_kinks_.size());
      if (marks == 0) return index;
      if (!whole) {  // beside another mark the contacts may lie anywhere
        for (LoadColumns& p : grid.load_columns) p.window = {0.0, 1.0};
        lay(grid, white, room);
        grid.weigh(options_);
      }
      const double matter = best() + kMatters;
      const std::vector<Matrix> weighted = grid.precision_weighted(read);
      const Row most = evidence_beside(grid, read, weighted, marks, evidence(grid, true), misfit);
      for (int e = 0; e < marks; ++e) {
        if (weight + most[e] + mark_odds_[e] < best() + priors_.hopeless) continue;
        PlaceSets beside = grid.beside(read, weighted, outliers_and_kinks_[e]);
        if (!beside.weigh(options_)) continue;
        add(beside, weight + mark_odds_[e] + evidence(beside, true), e);
        if (hypotheses.back().log_weight < matter) continue;
        doubts_.push_back({std::move(hypotheses.back()), &kind, weight, side, e});
        hypotheses.pop_back();
      }
      return index;
    }
    return kNone;
  }

  void prepare(const HypothesisKind& kind, double side, PlaceSets& grid) const {
    const int across = body_->in_space() ? 2 : 1;
    grid.load_columns.resize(kind.loads.size());
    for (std::size_t j = 0; j < kind.loads.size(); ++j) {
      const Load& load = kind.loads[j];
      LoadColumns& p = grid.load_columns[j];
      p.load = &load, p.cells = load.where == Load::Where::anywhere ? kind.cells : 1;
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
  double evidence(const PlaceSets& grid, bool whole) const {
    double volume = 0.0;
    int free = 0;
    for (const LoadColumns& p : grid.load_columns) {
      if (p.load->where == Load::Where::anywhere) volume += std::log(++free * p.width);
    }
    if (whole && free > 0) volume = -std::log(static_cast<double>(grid.size()));
    return grid.top + std::log(grid.total / static_cast<double>(priors_.moments.size())) + volume;
  }

  // Log evidence that a grid has beside each of the first marks, about, or at most where its sets
  // leave a misfit: sets that explain it may then differ from those beside the mark.
  Row evidence_beside(const PlaceSets& grid, const Whitened& read,
                      const std::vector<Matrix>& weighted, int marks, double log_evidence,
                      double misfit) const {
    PlaceSets::Densest densest = grid.densest(read, weighted, outliers_and_kinks_, marks);
    if (misfit > limit_) return densest.beside;
    for (double& log_density : densest.beside) log_density += log_evidence - densest.plain;
    return densest.beside;
  }

  // Lays finer windows around the mass where a cell holds more than `coarse` of it.
  static bool split(PlaceSets& grid, double coarse) {
    bool finer = false;
    for (std::size_t j = 0; j < grid.load_columns.size(); ++j) {
      LoadColumns& p = grid.load_columns[j];
      if (p.load->where != Load::Where::anywhere || p.width < 1e-6) continue;
      Row cell_mass(p.cells);
      for (int s = 0; s < grid.size(); ++s)
        cell_mass[grid.cell(static_cast<int>(j), s)] += grid.mass[s];
      if (*std::max_element(cell_mass.begin(), cell_mass.end()) < coarse * grid.total) continue;
      const Window part = support(cell_mass.data(), p.cells, p.window, kOutside * grid.total, 2);
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
  std::vector<Column> outliers_and_kinks_;
  Row mark_odds_, kinks_, kink_odds_;  // place of each; log odds of kinks of a free body
  std::vector<Doubt> doubts_;
  double limit_;     // misfit beyond which an explanation is poor
  double doubtful_;  // misfit of one contact beyond which the noise is larger than stated, perhaps
};

}  // namespace thigmo
