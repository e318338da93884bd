// The skeleton's chip in the emulator's hands, with the members that injected.cpp asks for.
//
// It plays the chip: raises the interrupts at their times, moves bytes at the line's rate, and
// reads the pins. Nothing here belongs into a binding.
#ifndef THIGMO_SKELETON_MPS2_INJECTED_SKELETON_H_
#define THIGMO_SKELETON_MPS2_INJECTED_SKELETON_H_

#include "../../micropython/thigmo_board/injected_flash.h"
#include "../skeleton_board.h"

namespace thigmo {

class InjectedBoard : public SkeletonBoard<InjectedFlash> {
 public:
  InjectedBoard(InjectedFlash& flash, uint16_t, uint8_t, protocol::ResetCause cause,
                const Latches& latches)
      : SkeletonBoard(flash, keep(latches), cause) {
    registers_.idle = true;
  }

  void set_time(uint32_t now_us, int32_t encoder) {
    registers_.micros = now_us;
    if (!placed_) encoder_ = encoder;
    placed_ = true;
    while (encoder_ != encoder) {
      encoder_ += encoder > encoder_ ? 1 : -1;
      const uint8_t phase = static_cast<uint8_t>(encoder_ & 3);  // 00, 01, 11, 10
      registers_.input[chip::kEncoderA] = phase == 1 || phase == 2;
      registers_.input[chip::kEncoderB] = phase >= 2;
      on_edge();
    }
    watch_enables();
    move_line();
  }
  void inputs(uint16_t supply_mv, uint16_t, bool estop, bool motor_power) {
    registers_.supply_mv = supply_mv;
    registers_.input[chip::kEstop] = estop;
    registers_.input[chip::kMotorPower] = motor_power;
  }
  void convert(uint32_t tick, const uint16_t* count, const Configuration&) {
    for (uint8_t slot = 0; slot < kAdcSlots; ++slot) {
      registers_.adc[adc_channel((tick & 1) != 0, slot)] = count[slot];
    }
    on_tick();
    for (uint8_t slot = 0; slot < kAdcSlots; ++slot) on_conversion();
  }
  void sent(const uint8_t* bytes, uint16_t count) {
    if (from_host_.size() == 0) arrival_us_ = later(arrival_us_) + kByteUs;
    for (uint16_t i = 0; i < count; ++i) from_host_.push(bytes[i]);
  }
  Ring<4096>& to_host() { return to_host_; }

  int16_t duty(uint8_t side) const { return registers_.duty[side]; }
  int16_t motor_duty() const {
    const int16_t duty = registers_.duty[chip::kMotor];
    if (duty <= 0) return 0;
    return pays_out() ? duty : static_cast<int16_t>(-duty);
  }
  bool pays_out() const { return registers_.output[chip::kDirection]; }
  // Of muscles, body, motor, brake: by the last edge of its pin.
  bool enabled(uint8_t output) const {
    const uint32_t hold_us = output < 2 ? 60000 : 30000;
    return moved_[output] && registers_.micros - moved_us_[output] < hold_us;
  }
  bool watchdog_bites() const {
    return registers_.micros - registers_.kicked_us > 1000ul * kWatchdogMs;
  }

 private:
  static constexpr uint32_t kByteUs = 40;  // 250 kbaud, 8N1

  static LatchRecord& keep(const Latches& latches) {
    static LatchRecord kept;
    kept.keep(latches);
    return kept;
  }
  uint32_t later(uint32_t time_us) const {
    return time_us > registers_.micros ? time_us : registers_.micros;
  }
  void watch_enables() {
    for (uint8_t i = 0; i < 4; ++i) {
      if (registers_.output[i] == level_[i]) continue;
      level_[i] = registers_.output[i];
      moved_[i] = true;
      moved_us_[i] = registers_.micros;
    }
  }
  void move_line() {
    while (from_host_.size() != 0 && arrival_us_ <= registers_.micros) {
      registers_.received = from_host_.pop();
      on_received();
      if (from_host_.size() != 0) arrival_us_ += kByteUs;
    }
    while (!registers_.idle && departure_us_ <= registers_.micros) {
      to_host_.push(registers_.sent);
      registers_.idle = true;
      on_idle();
      departure_us_ += kByteUs;
    }
    if (registers_.idle) departure_us_ = registers_.micros + kByteUs;
  }

  chip::Registers& registers_ = chip::registers();
  Ring<4096> from_host_, to_host_;
  uint32_t arrival_us_ = 0, departure_us_ = 0;
  uint32_t moved_us_[4] = {};
  bool moved_[4] = {}, level_[4] = {};
  bool placed_ = false;
  int32_t encoder_ = 0;
};

}  // namespace thigmo

#endif  // THIGMO_SKELETON_MPS2_INJECTED_SKELETON_H_
