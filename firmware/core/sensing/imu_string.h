// A string of IMUs on one I2C bus, behind a multiplexer: polled, and turned into readings.
//
// The IMUs are CEVA's BNO085 (data sheet 1000-3927, SH-2 reference 1000-3625, SHTP 1000-3535), the
// multiplexer is a TCA9548A (data sheet SCPS207). Each BNO085 fuses gyro and accelerometer itself
// (game rotation vector); a reading is the difference of two headings about the chips' own normal.
// A binding of a board with IMUs owns the string, calls pass() in each pass of its main loop, and
// takes count() as the conversion of an input that is a span between two IMUs. Which IMUs those are
// comes from the configuration (imu_from, imu_to).
//
// A turn of one IMU takes three transfers: select its channel, read the selection back (a wrong
// channel would be another IMU with the same address), read one report. The parts of a turn run
// while the main loop does other work; 12 IMUs are read every 12 ms. A report that does not come
// for kSilentUs, for whatever reason, makes both spans of its IMU read as an open circuit, which
// the core treats as it does any broken wire.
#ifndef THIGMO_CORE_SENSING_IMU_STRING_H_
#define THIGMO_CORE_SENSING_IMU_STRING_H_

#include <stdint.h>
#include <string.h>

#include "../config/configuration.h"
#include "../control/fixed_point.h"

namespace thigmo {

constexpr uint8_t kI2cMost = 21;  // bytes of a transfer

// One transfer on the bus, from START to STOP: a write, or a read if `read`.
struct I2cTransfer {
  uint8_t address = 0;
  bool read = false;
  uint8_t count = 0;
  uint8_t bytes[kI2cMost] = {};
};

enum class I2cResult : uint8_t { kDone, kBusy, kRefused, kStuck };

// What the string asks of the bus. Never defined: a binding has a class with these members, all of
// which return at once.
class I2cBusPolicy {
 public:
  void begin(const I2cTransfer& transfer);
  // kRefused: an address or byte was not acknowledged. kStuck: SDA is low where it must be high.
  I2cResult poll(I2cTransfer* transfer);
  // Ends what runs; then up to nine clocks until SDA is high, and a STOP (I2C specification
  // UM10204, section 3.1.16).
  void free();
};

template <typename Bus>
class ImuString {
 public:
  static constexpr uint8_t kMost = 16;  // two addresses on each of a multiplexer's eight channels
  static constexpr uint32_t kBusHz = 400000;
  static constexpr uint8_t kReportBytes = 21;  // header, time base, report
  // Bits of one IMU's turn, START and STOP of each transfer included.
  static constexpr uint32_t kTurnBits = 9 * (2 + 2 + 1 + kReportBytes) + 3 * 2;
  static constexpr uint32_t kTurnUs = kTurnBits * 1000000u / kBusHz;
  static_assert(kTurnUs < 1000, "an IMU's turn fits a tick");
  static constexpr uint32_t kReportUs = 20000;  // asked of each IMU
  static constexpr uint32_t kSilentUs = 50000;
  static constexpr uint32_t kAskAgainUs = 300000;  // for reports, if none come
  // A transfer that takes longer hangs: its clock is held low.
  static constexpr uint32_t kTransferUs = 3000;

  explicit ImuString(Bus& bus) : bus_(bus) {}

  // Goes on with the IMU whose turn it is.
  void pass(uint32_t now_us, const Configuration& c) {
    if (step_ == Step::kIdle) {
      adopt(c);
      if (count_ == 0) return;
      which_ = 0;
      select(now_us);
      return;
    }
    I2cResult result = bus_.poll(&transfer_);
    if (result == I2cResult::kBusy) {
      if (now_us - begun_us_ < kTransferUs) return;
      result = I2cResult::kStuck;
    }
    if (result == I2cResult::kStuck) bus_.free();
    if (result != I2cResult::kDone || !proceed(now_us)) next(now_us);
  }

  // Whether a span is between IMUs.
  static bool reads(uint8_t input, const Configuration& c) {
    return c.get(protocol::Param::kImuTo, input) != 0;
  }

  // The turn over a span, as a count of 16 bits of the divider that the core expects: 12 kOhm for
  // none, 1 Ohm more for each 0.1 mrad, an open circuit where an IMU of it is silent.
  uint16_t count(uint8_t input, uint32_t now_us, const Configuration& c) const {
    const int32_t from = c.get(protocol::Param::kImuFrom, input);
    const Imu* const last = find(c.get(protocol::Param::kImuTo, input));
    const Imu* const first = from == 0 ? nullptr : find(from);
    if (!fresh(last, now_us) || (from != 0 && !fresh(first, now_us))) return 0;
    // An IMU in the tail looks back along the body: half a turn, which must not change its sign.
    const int32_t turn =
        wrapped(last->heading - (first == nullptr ? 0 : first->heading), -kWholeTurn / 4);
    const int32_t ohm_q4 = limited<int32_t>(kStraightQ4 + turn, kLeastQ4, kMostQ4);
    constexpr uint64_t kTop = static_cast<uint64_t>(kDividerQ4) << 16;
    return static_cast<uint16_t>(kTop / static_cast<uint32_t>(kDividerQ4 + ohm_q4));
  }

  // Inputs whose zero means nothing since the last call: an IMU of theirs began again, with another
  // heading, or is another one.
  uint16_t take_restarted(const Configuration& c) {
    uint16_t mask = 0;
    for (uint8_t i = 0; i < kImus; ++i) {
      const bool lost = began_again(c.get(protocol::Param::kImuFrom, i)) ||
                        began_again(c.get(protocol::Param::kImuTo, i));
      if (lost) mask = static_cast<uint16_t>(mask | 1u << i);
    }
    for (Imu& imu : imu_) imu.began_again = false;
    return mask;
  }

 private:
  enum class Step : uint8_t { kIdle, kSelect, kVerify, kRead, kAsk };

  // Headings are in 1/16 of 0.1 mrad, so that a turn is in the 1/16 ohm of the core.
  static constexpr int32_t kWholeTurn = 1005310;
  static constexpr int32_t kDividerQ4 = 22000 * 16;
  static constexpr int32_t kStraightQ4 = 12000 * 16;
  static constexpr int32_t kLeastQ4 = 1000 * 16, kMostQ4 = 100000 * 16;
  // Not one bit of all four numbers changed in so many reports (0.2 s), while a neighbour has
  // turned by 50 mrad: the chip's fusion hangs. At rest a chip may repeat itself.
  static constexpr uint8_t kStuckReports = 10;
  static constexpr int32_t kStuckTurn = 500 * 16;

  static constexpr uint8_t kMultiplexer = 0x70;
  // SHTP: header of length, channel and sequence; then the payload.
  static constexpr uint8_t kHeader = 4;
  static constexpr uint8_t kExecutable = 1, kControl = 2, kInput = 3;  // channels
  static constexpr uint8_t kResetComplete = 1;
  static constexpr uint8_t kSetFeature = 0xFD, kTimeBase = 0xFB, kGameRotation = 0x08;

  struct Imu {
    uint16_t code = 0;
    int16_t part[4] = {};    // of the last report's quaternion: i, j, k, real
    int32_t heading = 0;     // 0..kWholeTurn
    int32_t neighbour = 0;   // its heading when `part` last changed
    uint32_t report_us = 0;  // when the last report came
    uint32_t asked_us = 0;
    uint8_t sequence = 0;  // of the last report
    uint8_t repeated = 0;  // reports with the same numbers
    bool heard = false;    // a report came since the IMU or the board began
    bool asked = false;
    bool began_again = false;
  };

  // A difference of headings, in the whole turn that begins at `least`.
  static int32_t wrapped(int32_t turn, int32_t least) {
    if (turn >= least + kWholeTurn) return turn - kWholeTurn;
    return turn < least ? turn + kWholeTurn : turn;
  }

  static bool fresh(const Imu* imu, uint32_t now_us) {
    return imu != nullptr && imu->heard && now_us - imu->report_us < kSilentUs;
  }

  const Imu* find(int32_t code) const {
    for (uint8_t i = 0; i < count_; ++i) {
      if (imu_[i].code == code) return &imu_[i];
    }
    return nullptr;
  }

  bool began_again(int32_t code) const {
    const Imu* const imu = code == 0 ? nullptr : find(code);
    return imu != nullptr && imu->began_again;
  }

  // Lists the IMUs of the configuration. One that was not on the list begins without a heading.
  void adopt(const Configuration& c) {
    Imu listed[kMost];
    uint8_t count = 0;
    for (uint8_t i = 0; i < 2 * kImus; ++i) {
      const int32_t code = c.get(i % 2 == 0 ? protocol::Param::kImuFrom : protocol::Param::kImuTo,
                                 static_cast<uint8_t>(i / 2));
      bool known = code == 0;
      for (uint8_t j = 0; j < count; ++j) known = known || listed[j].code == code;
      if (known || count == kMost) continue;
      const Imu* const old = find(code);
      if (old != nullptr) {
        listed[count] = *old;
      } else {
        listed[count].code = static_cast<uint16_t>(code);
        listed[count].began_again = true;
      }
      ++count;
    }
    memcpy(imu_, listed, sizeof imu_);
    count_ = count;
  }

  void start(Step step, uint8_t address, bool read, uint8_t count, uint32_t now_us) {
    step_ = step;
    transfer_.address = address;
    transfer_.read = read;
    transfer_.count = count;
    begun_us_ = now_us;
    bus_.begin(transfer_);
  }

  uint8_t selection() const { return static_cast<uint8_t>(1u << (imu_[which_].code >> 7)); }
  uint8_t address() const { return imu_[which_].code & 127; }

  void select(uint32_t now_us) {
    transfer_.bytes[0] = selection();
    start(Step::kSelect, kMultiplexer, false, 1, now_us);
  }

  void next(uint32_t now_us) {
    if (++which_ >= count_) {
      step_ = Step::kIdle;  // the next pass begins a round
    } else {
      select(now_us);
    }
  }

  // A transfer is done; whether another one of the same IMU follows.
  bool proceed(uint32_t now_us) {
    Imu& imu = imu_[which_];
    switch (step_) {
      case Step::kSelect:
        start(Step::kVerify, kMultiplexer, true, 1, now_us);
        return true;
      case Step::kVerify:
        if (transfer_.bytes[0] != selection()) return false;
        start(Step::kRead, address(), true, kReportBytes, now_us);
        return true;
      case Step::kRead:
        take(&imu, now_us);
        if (fresh(&imu, now_us) || (imu.asked && now_us - imu.asked_us < kAskAgainUs)) return false;
        ask(&imu, now_us);
        return true;
      default:
        return false;
    }
  }

  // Asks for reports. An IMU that sends them already goes on as before.
  void ask(Imu* imu, uint32_t now_us) {
    imu->asked = true;
    imu->asked_us = now_us;
    uint8_t* const out = transfer_.bytes;
    memset(out, 0, sizeof transfer_.bytes);
    out[0] = kI2cMost;
    out[2] = kControl;
    out[4] = kSetFeature;
    out[5] = kGameRotation;
    for (uint8_t i = 0; i < 4; ++i) out[9 + i] = static_cast<uint8_t>(kReportUs >> 8 * i);
    start(Step::kAsk, address(), false, kI2cMost, now_us);
  }

  // Takes a report, if that is what was read. Longer messages come in pieces, and are passed over.
  void take(Imu* imu, uint32_t now_us) {
    const uint8_t* const in = transfer_.bytes;
    const uint16_t length = static_cast<uint16_t>(in[0] | (in[1] & 127) << 8);
    const bool continued = (in[1] & 128) != 0;
    if (continued || length <= kHeader) return;
    if (in[2] == kExecutable && in[4] == kResetComplete) {
      imu->began_again = true;
      imu->heard = imu->asked = false;
    }
    if (in[2] != kInput || length < kReportBytes || in[4] != kTimeBase || in[9] != kGameRotation) {
      return;
    }
    const uint8_t sequence = in[10];
    if (imu->heard && sequence == imu->sequence) return;
    int16_t part[4];
    int32_t square = 0;
    for (uint8_t i = 0; i < 4; ++i) {
      part[i] = static_cast<int16_t>(in[13 + 2 * i] | in[14 + 2 * i] << 8);
      if (part[i] > 16384 || part[i] < -16384) return;
      square += part[i] * part[i] / 4;
    }
    // A rotation has the length 1; there is no check sequence.
    if (magnitude(square - (1 << 26)) > (1 << 21)) return;
    const int32_t beside = imu_[which_ == 0 ? count_ - 1 : which_ - 1].heading;
    const bool same = imu->heard && memcmp(part, imu->part, sizeof part) == 0;
    if (!same) {
      imu->neighbour = beside;
      imu->repeated = 0;
    } else if (imu->repeated < kStuckReports) {
      ++imu->repeated;
    } else if (magnitude(wrapped(beside - imu->neighbour, -kWholeTurn / 2)) > kStuckTurn) {
      return;
    }
    memcpy(imu->part, part, sizeof part);
    imu->heading = twice_angle(part[2], part[3]);
    // The next one must not take a neighbour that was silent so far for one that has turned.
    if (!imu->heard) imu_[which_ + 1 == count_ ? 0 : which_ + 1].neighbour = imu->heading;
    imu->sequence = sequence;
    imu->report_us = now_us;
    imu->heard = true;
  }

  // Twice the angle of (real, k), the turn about the chip's normal, in 0..kWholeTurn: CORDIC.
  static int32_t twice_angle(int32_t k, int32_t real) {
    // atan(2^-n), twice, in 1/16 of 0.1 mrad; times 16 for the rounding.
    static constexpr int32_t kStep[] = {4021239, 2373876, 1254291, 636698, 319584, 159948,
                                        79993,   39999,   20000,   10000,  5000,   2500,
                                        1250,    625,     312,     156};
    int32_t angle = 0;
    if (real < 0) {  // the same rotation
      real = -real;
      k = -k;
    }
    int32_t x = real * 4096, y = k * 4096;
    for (uint8_t n = 0; n < 16; ++n) {
      const int32_t dx = x >> n, dy = y >> n;
      const bool up = y < 0;
      x += up ? -dy : dy;
      y += up ? dx : -dx;
      angle += up ? -kStep[n] : kStep[n];
    }
    const int32_t turn = (angle + 8) >> 4;
    return turn < 0 ? turn + kWholeTurn : turn;
  }

  Bus& bus_;
  Imu imu_[kMost];
  uint8_t count_ = 0;
  uint8_t which_ = 0;
  Step step_ = Step::kIdle;
  I2cTransfer transfer_;
  uint32_t begun_us_ = 0;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_SENSING_IMU_STRING_H_
