// The robot on a board: the main loop.
//
// A binding constructs one Robot<Board>, calls begin() once and loop() for ever. A pass takes what
// the line brought (at most one command), does the work of one tick if its conversions are
// complete, moves the configuration store on by a byte, and fills the line. Nothing here or below
// waits.
#ifndef THIGMO_CORE_ROBOT_H_
#define THIGMO_CORE_ROBOT_H_

#include <stdint.h>

#include "board.h"
#include "commands.h"
#include "config/store.h"
#include "controller.h"
#include "link/session.h"

namespace thigmo {

template <typename Board>
class Robot {
 public:
  explicit Robot(Board& board)
      : board_(board), controller_(board.frame_us()), commands_(controller_, session_, store_) {}
  Robot(const Robot&) = delete;
  Robot& operator=(const Robot&) = delete;

  // Reads the store (some 3 ms) and sets all outputs to their safe state.
  void begin() {
    write_outputs();
    const LoadResult loaded = store_.begin(board_, controller_.mutable_configuration());
    controller_.begin(loaded, board_.reset_cause(), board_.kept_latches());
  }

  // One pass of the main loop.
  void loop() {
    const uint16_t begun = board_.micros16();
    board_.task(static_cast<uint8_t>(Task::kReceive));
    receive();
    if (const AdcFrame* frame = board_.take_frame()) {
      tick(frame);
      board_.kick_watchdog();
    }
    board_.task(static_cast<uint8_t>(Task::kStore));
    store();
    board_.task(static_cast<uint8_t>(Task::kTransmit));
    transmit();
    // The watchdog ends what would not fit 16 bits.
    const uint16_t took = static_cast<uint16_t>(board_.micros16() - begun);
    uint16_t& longest = commands_.timing().loop_max_us;
    if (took > longest) longest = took;
  }

  const Controller& controller() const { return controller_; }

  // --- for a program on the same chip ------------------------------------------------------------
  // Called between two passes of the main loop. Such a program is a host that needs no line: its
  // commands meet the same checks, and its heart must beat.
  bool hosted() const { return session_.session() != 0; }  // by a host on the line
  // Takes the robot over, as another host's hello does: what moves is ended, and it is disarmed.
  void take() {
    session_.leave();
    commands_.hello(false);
    settle();
  }
  void beat() { controller_.beat(); }
  void execute(const Frame& command, Frame* reply) {
    commands_.execute(command, reply);
    settle();
  }
  void stop(uint32_t nonce) {
    commands_.stop(nonce);
    settle();
  }
  EventQueue& events() { return controller_.events(); }

 private:
  static constexpr int16_t kNever = INT16_MIN;  // no output has this value

  static constexpr uint8_t kReceiveBytes = 40;

  // Less than this left on the line counts as idle: at 250 kbaud it lasts 320 us.
  static constexpr uint16_t kLineIdle = 8;

  // One frame a pass at most, and no more bytes than arrive in a millisecond at 250 kbaud and some.
  void receive() {
    for (uint8_t left = kReceiveBytes; left != 0;) {
      const uint8_t* bytes;
      const uint8_t waiting = board_.rx_waiting(&bytes);
      if (waiting == 0) return;
      const uint8_t taken = session_.receive(bytes, lesser(waiting, left));
      board_.rx_drop(taken);
      if (session_.heard()) break;
      left = static_cast<uint8_t>(left - taken);
    }
    if (session_.heard() && session_.answer(board_.micros(), commands_)) settle();
  }

  // What a command has changed takes effect now, not at the next tick.
  void settle() {
    write_outputs();
    keep_latches();
  }

  void tick(const AdcFrame* frame) {
    const Inputs in = {frame,
                       board_.encoder_count(),
                       board_.encoder_errors(),
                       board_.supply_mv(),
                       board_.rx_overruns(),
                       board_.estop(),
                       board_.motor_power()};
    commands_.timing().rx_overruns = in.rx_overruns;
    board_.task(static_cast<uint8_t>(Task::kSense));
    controller_.sense(in);
    board_.task(static_cast<uint8_t>(Task::kControl));
    controller_.control();
    board_.task(static_cast<uint8_t>(Task::kDecide));
    controller_.decide();
    if (controller_.faults() != kept_faults_) keep_latches();
    if (controller_.configure_step()) session_.finish({protocol::Status::kOk, Reason::kNone, 0});
    refresh_one();
    write_outputs();
    board_.enable(controller_.enables());
    board_.task(static_cast<uint8_t>(Task::kTelemetry));
    if (controller_.telemetry_due()) {
      protocol::Telemetry telemetry;
      controller_.fill(&telemetry);
      session_.offer(telemetry);
    }
  }

  void keep_latches() {
    kept_faults_ = controller_.faults();
    board_.keep_latches(controller_.latches());
  }

  // Has one output written in this period although it has not changed, each in turn: what disturbs
  // an output's registers lasts for as many periods as there are outputs.
  void refresh_one() {
    refreshed_ = refreshed_ < kMuscles ? static_cast<uint8_t>(refreshed_ + 1) : uint8_t{0};
    (refreshed_ < kMuscles ? written_.drive[refreshed_] : written_.motor) = kNever;
  }

  // Hands the board the outputs that have changed or are due to be refreshed.
  void write_outputs() {
    const Outputs& out = controller_.outputs();
    for (uint8_t i = 0; i < kMuscles; ++i) {
      if (out.drive[i] == written_.drive[i]) continue;
      written_.drive[i] = out.drive[i];
      if (out.drive[i] < 0) {
        board_.drive_off(i);
      } else {
        board_.drive(i, out.drive[i]);
      }
    }
    if (out.motor == written_.motor) return;
    written_.motor = out.motor;
    if (out.motor == 0) {
      board_.brake();
    } else {
      board_.motor(out.motor);
    }
  }

  void store() {
    const ConfigStore::Step step = store_.step(board_, controller_.configuration());
    if (!named_ && store_.counted()) {
      named_ = true;
      // An odd multiplier keeps boot counts apart and makes neighbours look unlike.
      session_.begin({(store_.boot_count() + 1) * 2654435761u, Board::kKind, board_.reset_cause()});
    }
    if (step == ConfigStore::Step::kDone || step == ConfigStore::Step::kFailed) {
      const bool good = step == ConfigStore::Step::kDone;
      controller_.end_save(good, store_.slot(), store_.generation());
      session_.finish(good ? protocol::Ack{protocol::Status::kOk, Reason::kNone,
                                           static_cast<int32_t>(store_.generation())}
                           : protocol::Ack{protocol::Status::kRefused, Reason::kBadConfig, -1});
    }
  }

  // One frame a pass at most, to keep the pass short.
  void transmit() {
    if (board_.tx_free() < protocol::kMaxWire) return;
    const Frame* frame =
        session_.next(controller_.now(), board_.tx_pending() <= kLineIdle, controller_.events());
    if (frame == nullptr) return;
    uint8_t wire[protocol::kMaxWire];
    board_.tx_write(wire, encode(*frame, wire));
  }

  // Outputs that none equals.
  static Outputs nothing() {
    Outputs none;
    for (uint8_t i = 0; i < kMuscles; ++i) none.drive[i] = kNever;
    none.motor = kNever;
    return none;
  }

  Board& board_;
  Controller controller_;
  Session session_;
  ConfigStore store_;
  Commands commands_;
  Outputs written_ = nothing();
  uint8_t refreshed_ = 0;  // output that was written again last: a muscle's, or the motor
  uint16_t kept_faults_ = 0;
  bool named_ = false;
};

}  // namespace thigmo

#endif  // THIGMO_CORE_ROBOT_H_
