// What a moving body's own sensors say of its length: the tip's fold bends each as it passes.
//
// A flex sensor rests before and behind the fold. While the fold passes, its reading swings out and
// back, and is furthest out when its centre is in the fold; how far it swings is not needed. An IMU
// looks back along the body while it is in the tail, and has turned half of that when it is in the
// fold itself. Where the encoder then is, along the motion and less the sensor's place, is its lag.
//
// Sensors are judged in pairs of one kind, in the order in which they pass, for one may be bad: two
// that agree by their mean, others by the one that accuses less. The encoder shows too little if a
// pair
//
// - lags by less than places and the confirmed length may be off, or
// - lags by less than the pair before it, beyond what places are in doubt: between the two the body
//   moved more than was counted.
//
// It shows too much if a pair lags by more than a tip lags that pressure barely moves. A swing that
// still grows there is late already, for its sensor has not reached the fold; one that begins
// before the fold can have reached the sensor is early.
//
// In retraction the tail is taut, so that a sensor that the fold was to meet and has not met is
// late as well. In growth a tip may stand still and leave the tail slack without an error of the
// encoder.
//
// While a reading still swings out the tip moves: the body then pulls at the tail.
//
// While the spool winds in, a sensor that lies wholly in the tail moves away from the fold. The
// fold meets it only if the tip runs outwards, past what is paid out: the line has snapped, or the
// tail has come off. Two flex sensors show that, since one may be bad.
//
// The last sensor that passed on the way out or in, and the length shown there, tell the host how
// far the tip may be from the length shown now, though no pair has accused the encoder.
#ifndef THIGMO_CORE_SENSING_FOLD_WATCH_H_
#define THIGMO_CORE_SENSING_FOLD_WATCH_H_

#include <stdint.h>

#include "flex.h"

namespace thigmo {

class FoldWatch {
 public:
  enum class Verdict : uint8_t { kNone, kEarly, kLate, kOutwards };

  // What a confirmed length is off by, and the way between two looks at a sensor.
  static constexpr int32_t kDoubtUm = 8000;
  // Between two pairs only the sensors' places are in doubt, and those looks.
  static constexpr int32_t kApartUm = 4000;
  static constexpr int32_t kSigmas = 3;  // of the stated error of a sensor's place
  // The tip may be 3 cm off; a share of that is for what passes until a late sensor is seen.
  static constexpr int32_t kLateUm = 20000;
  // A swing that grows by so much, more than noise, is of a tip that moved within the last looks.
  static constexpr int32_t kRiseE5 = 200;
  static constexpr uint8_t kMovesSteps = 30;
  static constexpr uint8_t kNone = 255;  // no sensor

  // The body grows, or is wound in, from here. Sensors that it passed by count only stay watched
  // until the fold has come, however often the spool stops. One that the fold has entered by a
  // quarter has no resting value: it shows no more than that the tip moves. Nor has, once the spool
  // turns, one that the fold was not seen to leave: behind a tip that stood still, it may be in
  // there yet. Nor has one that has come out lately, and still creeps to its rest as it is wound
  // in: `settled` are those that do not.
  void begin(int32_t length_um, bool grows, uint16_t enabled, uint16_t settled,
             const Configuration& c) {
    uint16_t restless = static_cast<uint16_t>(c.get(Param::kUnseenMask));
    if (!grows) restless = static_cast<uint16_t>(restless | ~settled);
    if (grows != grows_) {
      restless = static_cast<uint16_t>(restless | watched_);
      restart(length_um);
    }
    grows_ = grows;
    for (uint8_t i = 0; i < kSensors; ++i) {
      const uint16_t bit = static_cast<uint16_t>(1u << i);
      const int32_t lag = lag_um(length_um, i, c);
      if ((watched_ & bit) != 0 || lag >= -kDoubtUm) continue;
      watched_ = static_cast<uint16_t>(watched_ | bit);
      unread_ = static_cast<uint16_t>(unread_ | bit);
      const bool clear =
          (restless & bit) == 0 && lag < -kDoubtUm - (c.get(Param::kFlexSpanUm, i) >> 2);
      judged_ = static_cast<uint16_t>(clear ? judged_ | bit : judged_ & ~bit);
    }
    watched_ = static_cast<uint16_t>(watched_ & enabled);
    next_ = moves_ = 0;
  }

  // Forgets what earlier motion felt: when the spool turns the other way, and when a length is
  // confirmed or homed.
  void restart(int32_t length_um) {
    for (Pair& pair : pair_) pair = Pair{};
    watched_ = stowed_ = outwards_ = passed_ = unmet_ = 0;
    seen_sensor_ = kNone;
    seen_um_ = length_um;
  }

  // Looks at one sensor, in turn. Says what a pair that has passed the tip shows.
  Verdict step(const FlexReadings& flex, int32_t length_um, const Configuration& c,
               const Derived& d) {
    if (moves_ != 0) --moves_;
    const uint8_t i = next_;
    next_ = static_cast<uint8_t>(next_ + 1 == kSensors ? 0 : next_ + 1);
    const uint16_t bit = static_cast<uint16_t>(1u << i);
    const int32_t lag = lag_um(length_um, i, c);
    if (!grows_ && (watched_ & bit) == 0 && !is_imu(i, c)) watch_stowed(i, bit, lag, c, d);
    if (((watched_ | stowed_) & bit) == 0) return Verdict::kNone;
    const int32_t total = total_ohm_q4(count_q6(flex.latest(i), flex.log2()));
    const bool fresh = (unread_ & bit) != 0;
    unread_ = static_cast<uint16_t>(unread_ & ~bit);
    const bool imu = is_imu(i, c);
    if ((stowed_ & bit) != 0) return stowed_moves(i, bit, total, lag, fresh, c, d);
    const int32_t place_se_um = c.get(Param::kFlexCenterSeUm, i);
    const bool passed =
        imu ? turned(i, total, fresh) : swung(i, total, lag, out_of_place(lag, i, c), fresh, c, d);
    if (!passed) {
      const bool swings = !imu && top_e5_[i] >= c.get(Param::kFoldSwingE5);
      if (swings || !overdue(bit, lag, place_se_um)) return Verdict::kNone;
      unmet_ = static_cast<uint16_t>(unmet_ | bit);
      return pair_[imu].judge(lag, place_se_um);
    }
    // A reading that stays out after its top is no fold's that passes: it may stand in the sensor.
    if (!imu && lag - top_um_[i] > c.get(Param::kFlexSpanUm, i) / 2) {
      judged_ = static_cast<uint16_t>(judged_ & ~bit);
      return Verdict::kNone;
    }
    watched_ = static_cast<uint16_t>(watched_ & ~bit);
    passed_ = static_cast<uint16_t>(passed_ | bit);
    if (imu) top_um_[i] = lag;
    if ((judged_ & bit) == 0) return Verdict::kNone;
    const int32_t passed_um = top_um_[i];
    const int32_t center_um = c.get(Param::kFlexCenterUm, i);
    seen_sensor_ = i;
    seen_um_ = grows_ ? center_um + passed_um : center_um - passed_um;
    if ((unmet_ & bit) != 0) return Verdict::kNone;  // judged as late already
    return pair_[imu].judge(passed_um, place_se_um);
  }

  // Whether a sensor in the fold shows that the tip moves.
  bool moves() const { return moves_ != 0; }

  // The sensor that passed the tip last on this way, or kNone, and the length shown there: without
  // a sensor, where this way began or the length was confirmed.
  uint8_t seen_sensor() const { return seen_sensor_; }
  int32_t seen_um() const { return seen_um_; }

 private:
  static constexpr int32_t kHalfTurnQ4 = int32_t{31416} * 16;  // of an IMU: 10 kOhm a radian
  static constexpr int32_t kStraightQ4 = (12000 + static_cast<int32_t>(kDividerOhm)) * 16;

  // Lag that is late, of a sensor whose place is known to a standard error.
  static int32_t late_um(int32_t place_se_um) {
    return greater(kLateUm, kDoubtUm + kSigmas * place_se_um);
  }

  // The last two sensors of a kind, and the pair before them.
  struct Pair {
    static constexpr int32_t kNever = -1000000000;  // um: no pair has passed

    Verdict judge(int32_t lag, int32_t place_se_um) {
      waits = !waits;
      if (waits) {
        first_um = lag;
        first_se_um = place_se_um;
        return Verdict::kNone;
      }
      const int32_t places_um = kSigmas * greater(first_se_um, place_se_um);
      const int32_t most = greater(first_um, lag);
      const int32_t least = lesser(first_um, lag);
      const int32_t doubt_um = kDoubtUm + places_um;
      const bool agree = most - least < doubt_um;
      const int32_t mean = least + (most - least) / 2;
      const int32_t earliest = greater(-doubt_um, before_um - kApartUm - places_um);
      if ((agree ? mean : most) < earliest) return Verdict::kEarly;
      if ((agree ? mean : least) > late_um(lesser(first_se_um, place_se_um))) return Verdict::kLate;
      before_um = agree ? mean : least;
      return Verdict::kNone;
    }

    int32_t first_um = 0;  // lag of a pair's first sensor
    int32_t first_se_um = 0;
    int32_t before_um = kNever;  // lag of the pair before
    bool waits = false;          // a pair's first sensor for the second
  };

  static bool is_imu(uint8_t sensor, const Configuration& c) {
#if THIGMO_IMUS
    return c.get(Param::kImuTo, sensor) != 0;
#else
    static_cast<void>(sensor);
    static_cast<void>(c);
    return false;
#endif
  }

  int32_t lag_um(int32_t length_um, uint8_t sensor, const Configuration& c) const {
    const int32_t beyond = length_um - c.get(Param::kFlexCenterUm, sensor);
    return grows_ ? beyond : -beyond;
  }

  // How far from a sensor's centre the fold may bend it, whatever is in doubt.
  static int32_t reach_um(uint8_t sensor, const Configuration& c) {
    return c.get(Param::kFlexSpanUm, sensor) / 2 + c.get(Param::kFoldMarginUm) + kDoubtUm +
           kSigmas * c.get(Param::kFlexCenterSeUm, sensor);
  }

  // Whether a sensor that swings out here does so too early, before the fold can have reached its
  // near end, or too late.
  static bool out_of_place(int32_t lag, uint8_t sensor, const Configuration& c) {
    return lag > late_um(c.get(Param::kFlexCenterSeUm, sensor)) || lag < -reach_um(sensor, c);
  }

  // Whether the fold ought to have met a sensor on its way back, whatever is in doubt.
  bool overdue(uint16_t bit, int32_t lag, int32_t place_se_um) const {
    return !grows_ && (judged_ & ~unmet_ & bit) != 0 && lag > late_um(place_se_um) + kDoubtUm;
  }

  // Watches a sensor from when the spool has wound it wholly into the tail. One that the fold has
  // met on this way is in it half a span later: a span later, if the encoder shows twice its way.
  void watch_stowed(uint8_t i, uint16_t bit, int32_t lag, const Configuration& c,
                    const Derived& d) {
    if (lag <= 0 || (d.enabled_mask & bit) == 0) return;
    const uint16_t unseen = static_cast<uint16_t>(c.get(Param::kUnseenMask));
    if (((stowed_ | outwards_ | unseen) & bit) != 0) return;
    const int32_t out_um = (passed_ & bit) != 0 ? top_um_[i] + c.get(Param::kFlexSpanUm, i) +
                                                      c.get(Param::kFoldMarginUm)
                                                : reach_um(i, c);
    if (lag <= out_um) return;
    stowed_ = static_cast<uint16_t>(stowed_ | bit);
    unread_ = static_cast<uint16_t>(unread_ | bit);
  }

  // Looks at a flex sensor in the tail of a spool that winds in. An IMU there shows its turn
  // against the one before it, which changes as that one is wound in.
  Verdict stowed_moves(uint8_t i, uint16_t bit, int32_t total, int32_t lag, bool fresh,
                       const Configuration& c, const Derived& d) {
    if (!swung(i, total, lag, true, fresh, c, d)) return Verdict::kNone;
    stowed_ = static_cast<uint16_t>(stowed_ & ~bit);
    const bool second = outwards_ != 0;
    outwards_ = static_cast<uint16_t>(outwards_ | bit);
    return second ? Verdict::kOutwards : Verdict::kNone;
  }

  // Whether a flex sensor's reading has swung back by an eighth, or swings out where it must not;
  // top_um_ then is its lag.
  bool swung(uint8_t i, int32_t total, int32_t lag, bool misplaced, bool fresh,
             const Configuration& c, const Derived& d) {
    if (fresh) {
      rest_[i] = total;
      top_e5_[i] = 0;
      return false;
    }
    const int32_t swing = magnitude(curvature_e5(total, rest_[i], d.flex_gain_q16[i]));
    if (swing > top_e5_[i] + kRiseE5) {
      top_e5_[i] = saturated16(swing);
      top_um_[i] = lag;
      moves_ = kMovesSteps;
      return swing >= c.get(Param::kFoldSwingE5) && misplaced;
    }
    return top_e5_[i] >= c.get(Param::kFoldSwingE5) && swing <= top_e5_[i] - (top_e5_[i] >> 3);
  }

  // Whether an IMU has turned over in the fold: out of the tail it looks the way that the one
  // before it looks, and in the tail it did not; rest_ is 1 while the two look opposite ways. Wound
  // in it is the other way round.
  bool turned(uint8_t i, int32_t total, bool fresh) {
    const bool opposite = total - kStraightQ4 > kHalfTurnQ4 / 2;
    const bool was_opposite = rest_[i] != 0;
    rest_[i] = opposite ? 1 : 0;
    return !fresh && opposite != was_opposite && opposite != grows_;
  }

  Pair pair_[kImus != 0 ? 2 : 1];  // of flex sensors; of IMUs
  int32_t rest_[kSensors] = {};    // total resistance, at rest
  int32_t top_um_[kSensors] = {};  // lag when it swung out furthest
  int16_t top_e5_[kSensors] = {};
  uint16_t watched_ = 0;
  uint16_t judged_ = 0;    // with a resting value
  uint16_t unread_ = 0;    // no resting value yet
  uint16_t stowed_ = 0;    // watched in the tail, while the spool winds in
  uint16_t outwards_ = 0;  // that the fold met there
  uint16_t passed_ = 0;    // that it passed on this way
  uint16_t unmet_ = 0;     // that it was to meet on its way back
  uint8_t next_ = 0;
  uint8_t moves_ = 0;  // control steps for which the tip counts as moving
  uint8_t seen_sensor_ = kNone;
  int32_t seen_um_ = 0;
  bool grows_ = true;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_SENSING_FOLD_WATCH_H_
