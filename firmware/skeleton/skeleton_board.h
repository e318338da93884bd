// A board to copy: the Board policy (core/board.h) over the few functions of chip.h.
//
// What a binding needs on any chip is here: frames of conversions, encoder, rings of the line,
// store, latches. Four interrupts call on_tick(), on_conversion(), on_edge(), on_received(); a
// fifth, or the main loop, on_idle(). On one core, what they share with the main loop is bytes and
// words that are written whole; a chip that cannot do that masks interrupts where it says so.
#ifndef THIGMO_SKELETON_BOARD_H_
#define THIGMO_SKELETON_BOARD_H_

#include <stdint.h>
#include <string.h>

#include "../core/robot.h"
#include "../core/sensing/narrowing.h"
#include "../micropython/thigmo_board/flash_store.h"
#include "chip.h"

namespace thigmo {

// Flash as flash_store.h asks for it: two sectors. A chip with an EEPROM of its own needs neither.
template <typename Flash>
class SkeletonBoard {
 public:
  // Numbers from 128 up are for boards that the schema does not list.
  static constexpr protocol::BoardKind kKind = static_cast<protocol::BoardKind>(128);

  // `kept` lies in RAM that no start-up code touches (a section `.noinit`).
  SkeletonBoard(Flash& flash, LatchRecord& kept, protocol::ResetCause cause)
      : store_(flash), kept_(kept), cause_(cause) {
    chip::set_up();
    store_.begin();
    if (cause == protocol::ResetCause::kPowerOn) kept_.keep(Latches{});
    encoder_state_ = encoder_pins();
    chip::kick();
  }

  // --- interrupts --------------------------------------------------------------------------------
  // Each millisecond: the first conversion of its frame begins.
  void on_tick() {
    slot_ = 0;
    chip::convert(channel());
  }

  // A conversion is complete: the next begins, or the frame is whole.
  void on_conversion() {
    frame_[in_ % kPlaces].count[slot_] = chip::conversion();
    if (++slot_ < kAdcSlots) return chip::convert(channel());
    frame_[in_ % kPlaces].tick = tick_++;
    // Full: the newest is dropped, and the core sees the gap.
    if (static_cast<uint8_t>(in_ - out_) <= kAdcFrames) in_ = static_cast<uint8_t>(in_ + 1);
  }

  // An edge of either encoder pin.
  void on_edge() {
    // By old state * 4 + new state; forwards runs 00, 01 (A), 11, 10 (B), 00. 2 = an edge was lost.
    static const int8_t kStep[16] = {0, 1, -1, 2, -1, 0, 2, 1, 1, 2, 0, -1, 2, -1, 1, 0};
    const uint8_t pins = encoder_pins();
    const int8_t step = kStep[encoder_state_ << 2 | pins];
    encoder_state_ = pins;
    if (step == 2) {
      encoder_errors_ = static_cast<uint16_t>(encoder_errors_ + 1);
    } else {
      encoder_count_ = encoder_count_ + step;
    }
  }

  void on_received() {
    if (static_cast<uint8_t>(rx_in_ - rx_out_) == kRxRing - 1) {
      overruns_ = static_cast<uint16_t>(overruns_ + 1);
      return;
    }
    rx_[rx_in_] = chip::received();
    rx_in_ = static_cast<uint8_t>(rx_in_ + 1);
  }

  // The line takes a byte.
  void on_idle() {
    if (tx_in_ == tx_out_) return;
    chip::send(tx_[tx_out_]);
    tx_out_ = static_cast<uint8_t>(tx_out_ + 1);
  }

  // --- what the core does (core/board.h) ---------------------------------------------------------
  uint32_t micros() { return chip::micros(); }
  uint16_t micros16() { return static_cast<uint16_t>(chip::micros()); }
  uint16_t frame_us() { return chip::kFrameUs; }
  const AdcFrame* take_frame() {
    if (held_) out_ = static_cast<uint8_t>(out_ + 1);
    held_ = in_ != out_;
    if (!held_) return nullptr;
    AdcFrame* const frame = &frame_[out_ % kPlaces];
    narrowing_.apply(frame);
    return frame;
  }

  void drive(uint8_t muscle, int16_t duty) {
    if (duty <= 0) return drive_off(muscle);
    chip::pwm(transducer(muscle), duty);
  }
  void drive_off(uint8_t muscle) { chip::low(transducer(muscle)); }
  // A driver of the MD10C family brakes while its PWM input is low. DIR only moves then.
  void motor(int16_t duty) {
    if (chip::level(chip::kDirection) != (duty > 0)) {
      brake();
      chip::write(chip::kDirection, duty > 0);
    }
    chip::pwm(chip::kMotor, static_cast<int16_t>(duty > 0 ? duty : -duty));
  }
  void brake() { chip::low(chip::kMotor); }
  void enable(Enables wanted) {
    toggle(chip::kMuscleAir, wanted.muscles);
    toggle(chip::kBodyAir, wanted.body);
    toggle(chip::kMotorEnable, wanted.motor);
    toggle(chip::kBrakeEnable, wanted.brake);
  }

  int32_t encoder_count() { return encoder_count_; }
  uint16_t encoder_errors() { return encoder_errors_; }
  uint16_t supply_mv() { return chip::supply_mv(); }
  bool estop() { return chip::read(chip::kEstop); }
  bool motor_power() { return chip::read(chip::kMotorPower); }

  uint8_t rx_waiting(const uint8_t** first) {
    *first = rx_ + rx_out_;
    const uint16_t in_a_row = static_cast<uint16_t>(kRxRing - rx_out_);
    const uint8_t waiting = static_cast<uint8_t>(rx_in_ - rx_out_);
    return waiting < in_a_row ? waiting : static_cast<uint8_t>(in_a_row);
  }
  void rx_drop(uint8_t count) { rx_out_ = static_cast<uint8_t>(rx_out_ + count); }
  uint16_t rx_overruns() { return overruns_; }
  uint16_t tx_free() { return static_cast<uint16_t>(kTxRing - 1 - tx_pending()); }
  uint16_t tx_pending() { return static_cast<uint8_t>(tx_in_ - tx_out_); }
  void tx_write(const uint8_t* bytes, uint8_t count) {
    for (; count != 0; --count) {
      tx_[tx_in_] = *bytes++;
      tx_in_ = static_cast<uint8_t>(tx_in_ + 1);
    }
    if (chip::idle()) on_idle();
  }

  // This flash is written while the outputs are off, and the program waits for it.
  bool eeprom_ready() { return true; }
  uint8_t eeprom_read(uint16_t address) { return store_.read(address); }
  void eeprom_write(uint16_t address, uint8_t value) { store_.write(address, value); }
  void eeprom_commit() { store_.commit(); }

  protocol::ResetCause reset_cause() { return cause_; }
  Latches kept_latches() { return kept_.kept(); }
  void keep_latches(const Latches& latches) { kept_.keep(latches); }
  void task(uint8_t) {}
  void kick_watchdog() { chip::kick(); }

 private:
  // Beside the frames that wait: the one that the core has, and the one that is being filled.
  static constexpr uint8_t kPlaces = 8;
  static_assert(kAdcFrames + 2 <= kPlaces, "or a frame that is read changes");
  static_assert(kRxRing == 256 && kTxRing == 256, "indices of a byte wrap by themselves");

  static chip::Pwm transducer(uint8_t muscle) {
    return muscle == 0 ? chip::kDriveLeft : chip::kDriveRight;
  }
  static void toggle(chip::Output pin, bool wanted) {
    if (wanted) chip::write(pin, !chip::level(pin));
  }
  static uint8_t encoder_pins() {
    return static_cast<uint8_t>(chip::read(chip::kEncoderA) | chip::read(chip::kEncoderB) << 1);
  }
  uint8_t channel() const { return adc_channel((tick_ & 1) != 0, slot_); }

  FlashStore<Flash> store_;
  Narrowing narrowing_{chip::kAdcBits};
  LatchRecord& kept_;
  const protocol::ResetCause cause_;
  uint32_t tick_ = 0;
  AdcFrame frame_[kPlaces];
  uint8_t slot_ = 0;
  volatile uint8_t in_ = 0, out_ = 0;  // frames, counted
  bool held_ = false;                  // the core has the oldest
  uint8_t encoder_state_ = 0;
  volatile int32_t encoder_count_ = 0;
  volatile uint16_t encoder_errors_ = 0;
  volatile uint16_t overruns_ = 0;
  uint8_t rx_[kRxRing], tx_[kTxRing];
  volatile uint8_t rx_in_ = 0, rx_out_ = 0, tx_in_ = 0, tx_out_ = 0;
};

}  // namespace thigmo

#endif  // THIGMO_SKELETON_BOARD_H_
