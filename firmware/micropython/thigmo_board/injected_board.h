// A board whose hardware comes over a stream, in virtual time: the Board policy (core/board.h) of
// the unix port and of QEMU's Cortex-M3.
//
// What is virtual here is what the Pico has in silicon: the line's rate, the flash's cells, the
// pins. Store, journal, rings and the controller's life are the Pico's own code.
#ifndef THIGMO_MICROPYTHON_INJECTED_BOARD_H_
#define THIGMO_MICROPYTHON_INJECTED_BOARD_H_

#include <stdint.h>
#include <string.h>

#include "../../core/robot.h"
#include "../../core/sensing/narrowing.h"
#include "injected_flash.h"
#if THIGMO_IMUS
#include "../../core/sensing/imu_string.h"
#include "stream.h"
#endif

#if defined(__arm__)
#define THIGMO_INJECTED_KIND kCortexM3
#else
#define THIGMO_INJECTED_KIND kUnix
#endif

namespace thigmo {

#if THIGMO_IMUS
// An I2C bus whose chips are the host's. A transfer's outcome is known at once, and is told when
// the bus would have done with it.
class InjectedBus {
 public:
  static constexpr uint32_t kBitsMs = 400;  // fast mode

  void set_time(uint32_t now_us) { now_us_ = now_us; }

  void begin(const I2cTransfer& transfer) {
    uint8_t sent[8 + kI2cMost] = {'B'};
    memcpy(sent + 1, &now_us_, sizeof now_us_);
    sent[5] = transfer.address;
    sent[6] = transfer.read;
    sent[7] = transfer.count;
    memcpy(sent + 8, transfer.bytes, kI2cMost);
    stream_send(sent, sizeof sent);
    uint8_t got[1 + kI2cMost];
    stream_take(got, sizeof got);
    result_ = static_cast<I2cResult>(got[0]);
    memcpy(bytes_, got + 1, kI2cMost);
    ready_us_ = now_us_ + (9u * (1 + transfer.count) + 2) * 1000 / kBitsMs;
  }

  I2cResult poll(I2cTransfer* transfer) {
    if (static_cast<int32_t>(now_us_ - ready_us_) < 0) return I2cResult::kBusy;
    if (transfer->read) memcpy(transfer->bytes, bytes_, kI2cMost);
    return result_;
  }

  void free() {
    const uint8_t clocks = 'N';
    stream_send(&clocks, 1);
  }

 private:
  uint32_t now_us_ = 0, ready_us_ = 0;
  I2cResult result_ = I2cResult::kDone;
  uint8_t bytes_[kI2cMost];
};
#endif

class InjectedBoard {
 public:
  static constexpr protocol::BoardKind kKind = protocol::BoardKind::THIGMO_INJECTED_KIND;
  static constexpr uint32_t kByteUs = 40;  // 250 kbaud, 8N1
  static constexpr uint32_t kAirHoldUs = 60000;
  static constexpr uint32_t kMotorHoldUs = 30000;
  static constexpr uint32_t kNever = UINT32_MAX;

  InjectedBoard(InjectedFlash& flash, uint16_t frame_us, uint8_t adc_bits,
                protocol::ResetCause cause, const Latches& kept)
      : store_(flash), narrowing_(adc_bits), frame_us_(frame_us), cause_(cause), kept_(kept) {
    for (int16_t& duty : drive_) duty = -1;
    store_.begin();
  }

  // --- what the stream says --------------------------------------------------------------------
  // A pass of the main loop follows, at this time since the start; `from_host` has what was sent.
  void set_time(uint32_t now_us, int32_t encoder) {
    now_us_ = now_us;
    encoder_ = encoder;
    move_lines();
  }
  void inputs(uint16_t supply_mv, uint16_t encoder_errors, bool estop, bool motor_power) {
    motor_power_ = motor_power;
    supply_mv_ = supply_mv;
    encoder_errors_ = encoder_errors;
    estop_ = estop;
  }
  void convert(uint32_t tick, const uint16_t* count, const Configuration& c) {
    if (frames_ == kAdcFrames) return;
    AdcFrame* const frame = &frame_[(first_ + frames_++) % kAdcFrames];
    frame->tick = tick;
    memcpy(frame->count, count, sizeof frame->count);
#if THIGMO_IMUS
    frame->restarted = imus_.take_restarted(c);
    for (uint8_t slot = kMuscles; slot < kAdcSlots; ++slot) {
      const uint8_t input = adc_channel((tick & 1) != 0, slot);
      if (imus_.reads(input, c)) frame->count[slot] = imus_.count(input, now_us_, c);
    }
#else
    static_cast<void>(c);
#endif
    narrowing_.apply(frame);
  }
#if THIGMO_IMUS
  // What the bus does meanwhile.
  void poll_imus(const Configuration& c) {
    bus_.set_time(now_us_);
    imus_.pass(now_us_, c);
  }
#endif
  void sent(const uint8_t* bytes, uint16_t count) {
    if (from_host_.size() == 0) arrival_us_ = later(arrival_us_) + kByteUs;
    for (uint16_t i = 0; i < count; ++i) from_host_.push(bytes[i]);
  }
  Ring<4096>& to_host() { return to_host_; }

  int16_t duty(uint8_t side) const { return drive_[side]; }  // -1 = off
  int16_t motor_duty() const { return motor_; }
  bool pays_out() const { return pays_out_; }
  // Of muscles, body, motor, brake.
  bool enabled(uint8_t output) const {
    const uint32_t hold_us = output < 2 ? kAirHoldUs : kMotorHoldUs;
    return enabled_us_[output] != kNever && now_us_ - enabled_us_[output] < hold_us;
  }
  bool watchdog_bites() const { return now_us_ - kicked_us_ > 1000ul * kWatchdogMs; }

  // --- what the core does (core/board.h) -------------------------------------------------------
  uint32_t micros() { return now_us_; }
  uint16_t micros16() { return static_cast<uint16_t>(now_us_); }
  uint16_t frame_us() { return frame_us_; }
  const AdcFrame* take_frame() {
    if (frames_ == 0) return nullptr;
    const AdcFrame* const frame = &frame_[first_];
    first_ = static_cast<uint8_t>((first_ + 1) % kAdcFrames);
    --frames_;
    return frame;
  }
  void drive(uint8_t side, int16_t duty) { drive_[side] = duty; }
  void drive_off(uint8_t side) { drive_[side] = -1; }
  void motor(int16_t duty) {
    motor_ = duty;
    pays_out_ = duty > 0;
  }
  void brake() { motor_ = 0; }
  void enable(Enables wanted) {
    if (wanted.muscles) enabled_us_[0] = now_us_;
    if (wanted.body) enabled_us_[1] = now_us_;
    if (wanted.motor) enabled_us_[2] = now_us_;
    if (wanted.brake) enabled_us_[3] = now_us_;
  }
  int32_t encoder_count() { return encoder_; }
  uint16_t encoder_errors() { return encoder_errors_; }
  uint16_t supply_mv() { return supply_mv_; }
  bool estop() { return estop_; }
  bool motor_power() { return motor_power_; }

  uint8_t rx_waiting(const uint8_t** first) {
    *first = &rx_.front();
    return rx_.size() == 0 ? 0 : 1;
  }
  void rx_drop(uint8_t count) {
    for (; count != 0; --count) rx_.pop();
  }
  uint16_t rx_overruns() { return overruns_; }
  uint16_t tx_free() { return static_cast<uint16_t>(kTxRing - 1 - tx_.size()); }
  uint16_t tx_pending() { return tx_.size(); }
  void tx_write(const uint8_t* bytes, uint8_t count) {
    if (tx_.size() == 0) departure_us_ = later(departure_us_) + kByteUs;
    for (; count != 0; --count) tx_.push(*bytes++);
  }

  bool eeprom_ready() { return true; }
  uint8_t eeprom_read(uint16_t address) { return store_.read(address); }
  void eeprom_write(uint16_t address, uint8_t value) { store_.write(address, value); }
  void eeprom_commit() { store_.commit(); }

  protocol::ResetCause reset_cause() { return cause_; }
  Latches kept_latches() { return kept_; }
  void keep_latches(const Latches& latches) { kept_ = latches; }
  void task(uint8_t) {}
  void kick_watchdog() { kicked_us_ = now_us_; }

 private:
  uint32_t later(uint32_t time_us) const { return time_us > now_us_ ? time_us : now_us_; }

  void move_lines() {
    while (from_host_.size() != 0 && arrival_us_ <= now_us_) {
      const uint8_t byte = from_host_.pop();
      if (rx_.size() == kRxRing - 1) {
        ++overruns_;
      } else {
        rx_.push(byte);
      }
      if (from_host_.size() != 0) arrival_us_ += kByteUs;
    }
    while (tx_.size() != 0 && departure_us_ <= now_us_) {
      to_host_.push(tx_.pop());
      if (tx_.size() != 0) departure_us_ += kByteUs;
    }
  }

  FlashStore<InjectedFlash> store_;
#if THIGMO_IMUS
  InjectedBus bus_;
  ImuString<InjectedBus> imus_{bus_};
#endif
  Narrowing narrowing_;
  const uint16_t frame_us_;
  const protocol::ResetCause cause_;
  Latches kept_;
  uint32_t now_us_ = 0;
  uint32_t kicked_us_ = 0;
  uint32_t arrival_us_ = 0;    // when the first byte on the way to the board is whole
  uint32_t departure_us_ = 0;  // when the first byte on the way to the host is whole
  uint32_t enabled_us_[4] = {kNever, kNever, kNever, kNever};
  int32_t encoder_ = 0;
  uint16_t supply_mv_ = 5000;
  uint16_t encoder_errors_ = 0;
  uint16_t overruns_ = 0;
  int16_t drive_[kMuscles];
  int16_t motor_ = 0;
  bool pays_out_ = true;
  bool estop_ = true;
  bool motor_power_ = false;
  uint8_t first_ = 0, frames_ = 0;
  AdcFrame frame_[kAdcFrames];
  Ring<4096> from_host_, to_host_;
  Ring<kRxRing> rx_;
  Ring<kTxRing> tx_;
};

}  // namespace thigmo

#endif  // THIGMO_MICROPYTHON_INJECTED_BOARD_H_
