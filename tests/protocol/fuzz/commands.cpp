// The whole controller on a board of nothing, driven by what the fuzzer makes up: raw bytes, frames
// with a good check sequence and the right session and sequence (so that the handlers are reached),
// conversions, encoder jumps, resets of the line, and time.
//
// Beside what the sanitizers see, the outputs are judged after each step: duties in range, never
// driven in boot, safe or fault, never both valves of a sweep; what goes to the line are frames; a
// stop takes the outputs at once, and only a clear_stop of its nonce lets go.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <memory>

#include "../../../firmware/core/robot.h"

namespace {

using thigmo::AdcFrame;
using thigmo::Frame;
using thigmo::FrameDecoder;
namespace protocol = thigmo::protocol;

void require(bool condition) {
  if (!condition) std::abort();
}

class FuzzedBoard {
 public:
  static constexpr protocol::BoardKind kKind = protocol::BoardKind::kVirtual;

  FuzzedBoard() { std::memset(eeprom_, 0xFF, sizeof eeprom_); }

  uint32_t micros() { return tick * 1000 + 832; }
  uint16_t micros16() { return static_cast<uint16_t>(micros()); }
  uint16_t frame_us() { return 832; }
  const AdcFrame* take_frame() {
    if (!ready) return nullptr;
    ready = false;
    return &conversions;
  }
  void drive(uint8_t muscle, int16_t duty) {
    require(muscle < thigmo::kMuscles && duty >= 0 && duty <= thigmo::kDriveFull);
    duty_[muscle] = duty;
  }
  void drive_off(uint8_t muscle) {
    require(muscle < thigmo::kMuscles);
    duty_[muscle] = -1;
  }
  void motor(int16_t duty) {
    require(duty != 0 && duty >= -thigmo::kMotorFull && duty <= thigmo::kMotorFull);
    motor_ = duty;
  }
  void brake() { motor_ = 0; }
  void enable(thigmo::Enables wanted) { require(wanted.motor || !wanted.brake); }
  int32_t encoder_count() { return encoder; }
  uint16_t encoder_errors() { return 0; }
  uint16_t supply_mv() { return supply; }
  bool estop() { return pressed; }
  bool motor_power() { return false; }
  uint8_t rx_waiting(const uint8_t** first) {
    *first = rx_ + rx_out_;
    return static_cast<uint8_t>((rx_in_ < rx_out_ ? 0 : rx_in_) - rx_out_);
  }
  void rx_drop(uint8_t count) { rx_out_ = static_cast<uint8_t>(rx_out_ + count); }
  uint16_t rx_overruns() { return overruns; }
  uint16_t tx_free() { return 200; }
  uint16_t tx_pending() { return 0; }
  void tx_write(const uint8_t* bytes, uint8_t count) {
    require(count >= 2 && count <= protocol::kMaxWire && bytes[count - 1] == 0);
    uint8_t taken;
    require(out_.push(bytes, count, &taken) == FrameDecoder::Result::kFrame && taken == count);
    heard(out_.frame());
  }
  bool eeprom_ready() { return true; }
  uint8_t eeprom_read(uint16_t address) {
    require(address < thigmo::kEepromUsed);
    return eeprom_[address];
  }
  void eeprom_write(uint16_t address, uint8_t value) {
    require(address < thigmo::kEepromUsed);
    eeprom_[address] = value;
  }
  void eeprom_commit() {}
  protocol::ResetCause reset_cause() { return protocol::ResetCause::kPowerOn; }
  void task(uint8_t) {}
  void kick_watchdog() {}
  thigmo::Latches kept_latches() { return kept_; }
  void keep_latches(const thigmo::Latches& latches) { kept_ = latches; }

  void receive(uint8_t byte) { rx_[rx_in_++] = byte; }
  bool waits() const { return rx_out_ != rx_in_; }
  bool off() const { return duty_[0] < 0 && duty_[1] < 0 && motor_ == 0; }
  bool both_valves_drive() const { return duty_[0] > 0 && duty_[1] > 0; }

  uint32_t tick = 0;
  bool ready = false;
  AdcFrame conversions{};
  int32_t encoder = 0;
  uint16_t supply = 5000;
  uint16_t overruns = 0;
  bool pressed = false;
  uint16_t session = 0;

 private:
  void heard(const Frame& frame) {
    if (frame.id() != protocol::kHelloReply) return;
    protocol::HelloReply reply;
    require(protocol::HelloReply::decode(frame.payload(), frame.payload_size(), &reply));
    if (reply.session != 0) session = reply.session;
  }

  int16_t duty_[thigmo::kMuscles] = {-1, -1};
  int16_t motor_ = 0;
  uint8_t rx_[256] = {};
  uint8_t rx_in_ = 0, rx_out_ = 0;
  uint8_t eeprom_[thigmo::kEepromUsed];
  thigmo::Latches kept_;
  FrameDecoder out_;
};

class Input {
 public:
  Input(const uint8_t* data, size_t size) : at_(data), end_(data + size) {}
  bool empty() const { return at_ == end_; }
  uint8_t byte() { return empty() ? 0 : *at_++; }
  uint16_t word() { return static_cast<uint16_t>(byte() | byte() << 8); }

 private:
  const uint8_t* at_;
  const uint8_t* end_;
};

struct Rig {
  FuzzedBoard board;
  thigmo::Robot<FuzzedBoard> robot{board};
  uint16_t seq = 0;
  thigmo::StopLatch stop;  // as it was at the last look
  bool clearing = false;   // a clear_stop is under way
  uint32_t cleared = 0;    // of this nonce

  void judge() {
    const thigmo::State state = robot.controller().state();
    const bool may = state == thigmo::State::kReady || state == thigmo::State::kMoving;
    require(may || board.off());
    require(!board.both_valves_drive());
    const thigmo::StopLatch now = robot.controller().latches().stop;
    if (stop.latched && !now.latched) require(clearing && cleared == stop.nonce);
    if (now.latched) require(state == thigmo::State::kFault && board.off());
    const thigmo::Latches kept = board.kept_latches();
    require(kept.stop.latched == now.latched && kept.stop.nonce == now.nonce);
    require(kept.faults == robot.controller().faults());
    stop = now;
  }

  void stop_it(uint32_t nonce, uint16_t session, uint16_t sequence) {
    uint8_t payload[protocol::Stop::kSize];
    protocol::Stop{nonce}.encode(payload);
    while (board.waits()) pass();
    board.receive(0);
    send(protocol::kStop, session, sequence, payload, sizeof payload);
    require(stop.latched && stop.nonce == nonce && board.off());
  }

  void clear_it(uint32_t nonce) {
    uint8_t payload[protocol::ClearStop::kSize];
    protocol::ClearStop{nonce}.encode(payload);
    send(protocol::kClearStop, board.session, ++seq, payload, sizeof payload);
  }

  void pass() {
    robot.loop();
    judge();
  }

  void tick(uint16_t flex, uint16_t left, uint16_t right) {
    for (uint8_t slot = 0; slot < thigmo::kAdcSlots; ++slot)
      board.conversions.count[slot] = slot == 0 ? left : slot == 1 ? right : flex;
    board.conversions.tick = board.tick++;
    board.ready = true;
    pass();
  }

  void send(uint8_t id, uint16_t session, uint16_t sequence, const uint8_t* payload, uint8_t size) {
    Frame frame;
    frame.bytes[0] = id;
    protocol::detail::put16(frame.bytes + 1, sequence);
    protocol::detail::put16(frame.bytes + 3, session);
    std::memcpy(frame.bytes + protocol::kHeaderSize, payload, size);
    frame.size = static_cast<uint8_t>(protocol::kHeaderSize + size);
    uint8_t wire[protocol::kMaxWire];
    const uint8_t count = thigmo::encode(frame, wire);
    while (board.waits()) pass();
    for (uint8_t i = 0; i < count; ++i) board.receive(wire[i]);
    clearing = id == protocol::kClearStop && size == protocol::ClearStop::kSize;
    if (clearing) cleared = protocol::detail::get32(payload);
    do pass();
    while (board.waits());
    clearing = false;
  }

  void hello(uint32_t nonce) {
    uint8_t payload[protocol::Hello::kSize];
    protocol::Hello message{};
    message.protocol = protocol::kProtocol;
    message.schema_hash = protocol::kSchemaHash;
    message.host_nonce = nonce;
    message.encode(payload);
    seq = 0;
    send(protocol::kHello, 0, 0, payload, sizeof payload);
  }
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const auto rig = std::make_unique<Rig>();
  rig->robot.begin();
  // The boot counter is stored, the inputs are those of a robot at rest.
  for (int i = 0; i < 40; ++i) rig->tick(600, 102, 102);
  rig->hello(1);
  Input in(data, size);
  uint32_t nonce = 2;
  uint16_t flex = 600, pressure[2] = {102, 102};
  while (!in.empty()) {
    const uint8_t choice = in.byte();
    switch (choice >> 5) {
      case 0: {  // raw bytes
        for (uint8_t n = choice & 31; n != 0; --n) rig->board.receive(in.byte());
        rig->pass();
        break;
      }
      case 1:
      case 2: {  // a command with a good header; its payload cut or padded now and then
        uint8_t payload[protocol::kMaxPayload];
        const uint8_t id = static_cast<uint8_t>(choice & 63 & ~32);
        const uint8_t count = in.byte() % (protocol::kMaxPayload + 1);
        for (uint8_t i = 0; i < count; ++i) payload[i] = in.byte();
        rig->send(id, rig->board.session, ++rig->seq, payload, count);
        break;
      }
      case 3: {  // a repeat, a stale one, another session
        uint8_t payload[1] = {in.byte()};
        rig->send(in.byte(), static_cast<uint16_t>(rig->board.session + (choice & 3)),
                  static_cast<uint16_t>(rig->seq - (choice >> 2 & 3)), payload, choice >> 4 & 1);
        break;
      }
      case 4:  // time
        for (int n = (choice & 31) * 4 + 1; n != 0; --n) rig->tick(flex, pressure[0], pressure[1]);
        break;
      case 5:  // other readings
        flex = static_cast<uint16_t>(in.word() & 1023);
        pressure[choice & 1] = static_cast<uint16_t>(in.word() & 1023);
        break;
      case 6:
        rig->board.encoder += static_cast<int16_t>(in.word());
        rig->board.supply = (choice & 1) != 0 ? 5000 : in.word();
        rig->board.pressed = (choice & 2) != 0;
        rig->board.overruns = static_cast<uint16_t>(rig->board.overruns + (choice >> 2 & 1));
        break;
      default:
        if ((choice & 8) != 0) {
          rig->stop_it(choice & 3, in.word(), in.word());
          break;
        }
        if ((choice & 16) != 0) {
          rig->clear_it(choice & 3);
          break;
        }
        rig->hello((choice & 1) != 0 ? nonce++ : 1);
        break;
    }
  }
  return 0;
}
