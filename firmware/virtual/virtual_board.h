// The virtual board: hardware for the firmware core inside a Python process, in virtual time.
//
// It models what the Mega's parts do to bytes, counts and duties: conversions at their instants,
// a UART that takes 40 us a byte, rings of the Mega's size, an EEPROM that takes 3.4 ms a byte and
// can lose power in the middle of one, a boot loader's delay, a watchdog. The controller itself is
// firmware/core, the same code as on the Mega. Nothing here depends on wall time or chance beyond
// the seed.
#ifndef THIGMO_VIRTUAL_VIRTUAL_BOARD_H_
#define THIGMO_VIRTUAL_VIRTUAL_BOARD_H_

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <deque>
#include <memory>
#include <string>
#include <vector>

#include "../core/robot.h"
#include "../core/sensing/narrowing.h"
#include "analog.h"

namespace thigmo {

class VirtualBoard {
 public:
  static constexpr protocol::BoardKind kKind = protocol::BoardKind::kVirtual;
  static constexpr uint32_t kEepromSize = kEepromUsed > 4096 ? kEepromUsed : 4096;
  static constexpr uint64_t kByteUs = 40;  // 250 kbaud, 8N1
  static constexpr uint64_t kEepromWriteUs = 3400;
  static constexpr uint64_t kBootLoaderUs = 840000;
  static constexpr uint64_t kWatchdogUs = 1000ull * kWatchdogMs;
  static constexpr uint16_t kFrameUs = kAdcSlots * 104;  // of the Mega's converter
  // A charge pump's longest (docs/hardware): of the valves, of motor and brake.
  static constexpr uint64_t kAirHoldUs = 60000;
  static constexpr uint64_t kMotorHoldUs = 30000;

  VirtualBoard(uint64_t seed, const std::string& eeprom, uint8_t adc_bits = kAdcBits,
               uint16_t frame_us = kFrameUs)
      : seed_(seed),
        frame_us_(frame_us),
        pass_us_{250, 500, frame_us, 990},
        analog_(seed, adc_bits, frame_us),
        adc_bits_(adc_bits),
        narrowing_(adc_bits) {
    std::sort(pass_us_.begin(), pass_us_.end());
    eeprom_.fill(0xFF);
    std::memcpy(eeprom_.data(), eeprom.data(), std::min<size_t>(eeprom.size(), eeprom_.size()));
    reset(protocol::ResetCause::kPowerOn);
  }
  VirtualBoard(const VirtualBoard&) = delete;
  VirtualBoard& operator=(const VirtualBoard&) = delete;

  // --- what the emulator does ----------------------------------------------------------------

  // Advances virtual time by whole milliseconds; analog inputs and the encoder move linearly from
  // their start to their end over the step, and then stay.
  void step(uint32_t ticks) {
    const double tick_share = ticks > 0 ? 1.0 / ticks : 0.0;
    for (uint32_t i = 0; i < ticks; ++i) {
      const uint64_t tick_us = now_us_;
      for (const uint64_t pass_us : pass_us_) {
        now_us_ = tick_us + pass_us;
        share_ = (i + static_cast<double>(pass_us) * 1e-3) * tick_share;
        if (pass_us == frame_us_ && running_) convert(i * tick_share, tick_share);
        pass();
      }
      now_us_ = tick_us + 1000;
      move_lines();
      if (running_ && now_us_ - kicked_us_ > kWatchdogUs) reset(protocol::ResetCause::kWatchdog);
    }
    analog_.settle();
    encoder_start_ = encoder_end_;
    share_ = 0.0;
  }

  uint64_t now_us() const { return now_us_; }

  void write(const std::string& bytes) {
    if (to_board_.empty()) arrival_us_ = std::max(arrival_us_, now_us_) + kByteUs;
    to_board_.insert(to_board_.end(), bytes.begin(), bytes.end());
  }

  std::string read() {
    std::string bytes;
    bytes.swap(to_host_);
    return bytes;
  }

  Analog& analog() { return analog_; }
  const Analog& analog() const { return analog_; }
  void set_encoder(double start, double end) {
    encoder_start_ = start;
    encoder_end_ = end;
  }
  void set_supply_mv(uint16_t supply) { supply_mv_ = supply; }
  // Illegal transitions of the encoder that have happened since the start.
  void set_encoder_errors(uint16_t errors) { encoder_errors_ = errors; }
  void set_estop(bool pressed) { estop_ = pressed; }
  void set_motor_power(bool on) { motor_power_ = on; }

  // Restarts the chip: outputs off, rings empty, boot loader, then the firmware from its start.
  void reset(protocol::ResetCause cause) {
    cause_ = cause;
    if (cause == protocol::ResetCause::kPowerOn) kept_ = Latches{};
    robot_.reset();
    running_ = false;
    powered_ = true;
    hung_ = false;
    stalled_until_us_ = now_us_;
    start_us_ = now_us_ + kBootLoaderUs;
    kicked_us_ = now_us_;
    rx_.clear();
    tx_.clear();
    frames_.clear();
    overruns_ = 0;
    eeprom_ready_us_ = now_us_;
    outputs_off();
  }

  // The main loop stops: nothing runs until the watchdog has its say.
  void hang() { hung_ = true; }

  // The main loop stands still for a time and then goes on, as under a storm of interrupts.
  void stall(uint32_t ticks) { stalled_until_us_ = now_us_ + ticks * 1000ull; }

  // Power fails in the middle of the EEPROM byte after the next `bytes` ones; reset() restores it.
  void cut_power_after(uint32_t bytes) {
    cut_armed_ = true;
    cut_after_ = bytes;
  }

  const std::array<int, kMuscles>& drive() const { return drive_; }
  const std::array<bool, kMuscles>& drive_enabled() const { return drive_enabled_; }
  int motor() const { return motor_; }
  bool braked() const { return motor_ == 0; }
  int direction() const { return direction_; }
  // Whether an enable (0 muscles, 1 body, 2 motor, 3 brake) is held by the edges of its pin.
  bool enabled(uint8_t output) const {
    const uint64_t hold_us = output < 2 ? kAirHoldUs : kMotorHoldUs;
    return enabled_us_[output] != 0 && now_us_ < enabled_us_[output] + hold_us;
  }
  bool powered() const { return powered_; }
  bool running() const { return running_; }
  uint64_t boots() const { return boots_; }
  std::string eeprom() const { return std::string(eeprom_.begin(), eeprom_.end()); }

  // --- what the firmware core does (core/board.h) ----------------------------------------------

  uint32_t micros() { return static_cast<uint32_t>(now_us_ - start_us_); }
  uint16_t micros16() { return static_cast<uint16_t>(now_us_ - start_us_); }

  uint16_t frame_us() { return frame_us_; }
  const AdcFrame* take_frame() {
    if (frames_.empty()) return nullptr;
    taken_ = frames_.front();
    frames_.pop_front();
    return &taken_;
  }

  void drive(uint8_t muscle, int16_t duty) {
    drive_[muscle] = duty;
    drive_enabled_[muscle] = true;
  }
  void drive_off(uint8_t muscle) {
    drive_[muscle] = 0;
    drive_enabled_[muscle] = false;
  }
  void motor(int16_t duty) {
    motor_ = duty;
    if (duty != 0) direction_ = duty > 0 ? 1 : -1;
  }
  void brake() { motor_ = 0; }
  void enable(Enables wanted) {
    const bool kicked[] = {wanted.muscles, wanted.body, wanted.motor, wanted.brake};
    for (size_t i = 0; i < enabled_us_.size(); ++i) {
      if (kicked[i]) enabled_us_[i] = now_us_;
    }
  }

  int32_t encoder_count() { return static_cast<int32_t>(encoder_now() - encoder_at_start_); }
  uint16_t encoder_errors() { return encoder_errors_; }
  uint16_t supply_mv() { return supply_mv_; }
  bool estop() { return estop_; }
  bool motor_power() { return motor_power_; }

  uint8_t rx_waiting(const uint8_t** first) {
    if (rx_.empty()) return 0;
    *first = &rx_.front();
    return 1;
  }
  void rx_drop(uint8_t count) { rx_.erase(rx_.begin(), rx_.begin() + count); }
  uint16_t rx_overruns() { return overruns_; }
  uint16_t tx_free() { return static_cast<uint16_t>(kTxRing - 1 - tx_.size()); }
  uint16_t tx_pending() { return static_cast<uint16_t>(tx_.size()); }
  void tx_write(const uint8_t* bytes, uint8_t count) {
    if (tx_.empty()) departure_us_ = std::max(departure_us_, now_us_) + kByteUs;
    tx_.insert(tx_.end(), bytes, bytes + count);
  }

  bool eeprom_ready() { return now_us_ >= eeprom_ready_us_; }
  uint8_t eeprom_read(uint16_t address) { return eeprom_[address]; }
  void eeprom_commit() {}
  void eeprom_write(uint16_t address, uint8_t value) {
    eeprom_ready_us_ = now_us_ + kEepromWriteUs;
    if (cut_armed_ && cut_after_-- == 0) {
      // A byte whose write was cut may hold anything.
      eeprom_[address] = static_cast<uint8_t>(adc_noise_mix(seed_ ^ address ^ now_us_));
      cut_armed_ = false;
      powered_ = false;
      return;
    }
    eeprom_[address] = value;
  }

  protocol::ResetCause reset_cause() { return cause_; }
  Latches kept_latches() { return kept_; }
  void keep_latches(const Latches& latches) { kept_ = latches; }
  void kick_watchdog() { kicked_us_ = now_us_; }
  void task(uint8_t) {}

 private:
  void convert(double start, double duration) {
    if (frames_.size() >= kAdcFrames) return;
    frames_.push_back(
        analog_.frame(static_cast<uint32_t>((now_us_ - start_us_) / 1000), start, duration));
    narrowing_.apply(&frames_.back());
  }

  void pass() {
    move_lines();
    if (!powered_) {
      robot_.reset();
      running_ = false;
      outputs_off();
      return;
    }
    if (!running_) {
      // A tick begins where the boot loader ends, so that ticks stay whole milliseconds.
      if (now_us_ < start_us_ || now_us_ % 1000 != pass_us_[0]) return;
      start_us_ = now_us_ - pass_us_[0];
      running_ = true;
      ++boots_;
      kicked_us_ = now_us_;
      encoder_at_start_ = encoder_now();
      narrowing_ = Narrowing(adc_bits_);
      robot_ = std::make_unique<Robot<VirtualBoard>>(*this);
      robot_->begin();
    }
    if (!hung_ && now_us_ >= stalled_until_us_) robot_->loop();
  }

  // Bytes that have arrived or left by now.
  void move_lines() {
    while (!to_board_.empty() && arrival_us_ <= now_us_) {
      if (!running_) {
        // The boot loader swallows it.
      } else if (rx_.size() < kRxRing - 1) {
        rx_.push_back(to_board_.front());
      } else {
        ++overruns_;
      }
      to_board_.pop_front();
      if (!to_board_.empty()) arrival_us_ += kByteUs;
    }
    while (!tx_.empty() && departure_us_ <= now_us_) {
      to_host_.push_back(static_cast<char>(tx_.front()));
      tx_.pop_front();
      if (!tx_.empty()) departure_us_ += kByteUs;
    }
  }

  int64_t encoder_now() const {
    return static_cast<int64_t>(
        std::floor(encoder_start_ + (encoder_end_ - encoder_start_) * share_));
  }

  void outputs_off() {
    // Pull-downs hold PWM and current stage low while the chip floats its pins.
    drive_.fill(0);
    drive_enabled_.fill(false);
    motor_ = 0;
  }

  const uint64_t seed_;
  const uint16_t frame_us_;
  // Main-loop passes within a tick, one when its conversions are complete. The Mega makes more;
  // what the line carries is the same, but for a quarter of a millisecond.
  std::array<uint64_t, 4> pass_us_;
  Analog analog_;
  const uint8_t adc_bits_;
  Narrowing narrowing_;
  uint64_t now_us_ = 0;
  uint64_t start_us_ = 0;  // when the firmware began: its tick 0
  uint64_t kicked_us_ = 0;
  uint64_t stalled_until_us_ = 0;
  uint64_t eeprom_ready_us_ = 0;
  uint64_t arrival_us_ = 0;    // when the first byte on the way to the board is whole
  uint64_t departure_us_ = 0;  // when the first byte on the way to the host is whole
  uint64_t boots_ = 0;
  double share_ = 0.0;  // of the running step
  double encoder_start_ = 0.0;
  double encoder_end_ = 0.0;
  int64_t encoder_at_start_ = 0;
  uint16_t supply_mv_ = 5000;
  uint16_t overruns_ = 0;
  uint16_t encoder_errors_ = 0;
  uint32_t cut_after_ = 0;
  protocol::ResetCause cause_ = protocol::ResetCause::kPowerOn;
  bool estop_ = false;
  bool motor_power_ = false;
  Latches kept_;  // through resets, as RAM is
  bool running_ = false;
  bool powered_ = true;
  bool hung_ = false;
  bool cut_armed_ = false;
  std::array<uint8_t, kEepromSize> eeprom_{};
  std::deque<uint8_t> to_board_;
  std::deque<uint8_t> rx_;
  std::deque<uint8_t> tx_;
  std::deque<AdcFrame> frames_;
  AdcFrame taken_{};
  std::string to_host_;
  std::array<int, kMuscles> drive_{};
  std::array<bool, kMuscles> drive_enabled_{};
  int motor_ = 0;
  int direction_ = 1;
  std::array<uint64_t, 4> enabled_us_{};  // when each enable last toggled
  std::unique_ptr<Robot<VirtualBoard>> robot_;
};

}  // namespace thigmo

#endif  // THIGMO_VIRTUAL_VIRTUAL_BOARD_H_
