// The Board policy (core/board.h) on a Raspberry Pi Pico: RP2040, two MCP3208, pins by pins.py.
//
// The controller has core 1 for itself: main loop, conversions and encoder run there, code and
// constants in RAM (Makefile), so that neither Python, its garbage collection nor a write to flash
// on core 0 stops them. Core 0 writes the store to flash when the controller asks for it.
#ifndef THIGMO_MICROPYTHON_PICO_BOARD_H_
#define THIGMO_MICROPYTHON_PICO_BOARD_H_

#include <stdint.h>
#include <string.h>

#include <initializer_list>

#include "../../core/robot.h"
#include "../../core/sensing/narrowing.h"
#include "controller.h"
#include "flash_store.h"
#include "hardware/address_mapped.h"
#include "hardware/flash.h"
#include "hardware/structs/adc.h"
#include "hardware/structs/iobank0.h"
#include "hardware/structs/padsbank0.h"
#include "hardware/structs/pwm.h"
#include "hardware/structs/sio.h"
#include "hardware/structs/spi.h"
#include "hardware/structs/timer.h"
#include "hardware/structs/uart.h"
#include "hardware/structs/watchdog.h"
#include "hardware/sync.h"
#include "mpconfigboard.h"

namespace thigmo {

// Registers of one pin. All outputs are driven low by SIO unless a peripheral has them.
inline uint32_t bit(int8_t pin) { return 1u << pin; }
inline bool high(int8_t pin) { return (sio_hw->gpio_in & bit(pin)) != 0; }
inline void give(int8_t pin, uint32_t function) { io_bank0_hw->io[pin].ctrl = function; }

// Two sectors below Python's file system.
class PicoFlash {
 public:
  static constexpr uint32_t kAt = THIGMO_STORE_AT;  // from the start of the flash

  // Past the cache: what was just written is read.
  const uint8_t* data() const {
    return reinterpret_cast<const uint8_t*>(XIP_NOCACHE_NOALLOC_BASE + kAt);
  }
  void erase(uint8_t sector) {
    const uint32_t state = save_and_disable_interrupts();
    flash_range_erase(kAt + sector * kFlashSector, kFlashSector);
    restore_interrupts(state);
  }
  void program(uint32_t address, const uint8_t* page) {
    const uint32_t state = save_and_disable_interrupts();
    flash_range_program(kAt + address, page, kFlashPage);
    restore_interrupts(state);
  }
};

class PicoBoard {
 public:
  static constexpr protocol::BoardKind kKind = protocol::BoardKind::kPico;
  static constexpr uint8_t kAdcBitsHere = 12;
  static constexpr uint16_t kSlotUs = 40;
  static constexpr uint8_t kAlarm = 1;  // 2 and 3 are MicroPython's and the SDK's

  PicoBoard(const int8_t* pins, PicoFlash& flash, LatchRecord& kept, protocol::ResetCause cause)
      : store_(flash), narrowing_(kAdcBitsHere), kept_(kept), cause_(cause) {
    memcpy(pin_, pins, sizeof pin_);
    spi_ = pin_[THIGMO_ADC_SCK] / 8 % 2 == 0 ? spi0_hw : spi1_hw;
    uart_ = (pin_[THIGMO_LINK_TX] + 4) / 8 % 2 == 0 ? uart0_hw : uart1_hw;
    store_.begin();
  }

  // --- on core 1, before the main loop -----------------------------------------------------------
  void begin() {
    state_ = encoder_pins();
    origin_us_ = timer_hw->timerawl;
    next_us_ = origin_us_;
    aim();
  }

  // --- interrupts of core 1 ----------------------------------------------------------------------
  // Slot n of a tick begins n * 40 us into it; its count is taken as the next one begins.
  void on_slot() {
    timer_hw->intr = 1u << kAlarm;
    if (slot_ != 0) take_count();
    if (slot_ == kAdcSlots) {
      slot_ = 0;
      ++tick_;
      next_us_ += 1000 - kAdcSlots * kSlotUs;
    } else {
      convert();
      ++slot_;
      next_us_ += kSlotUs;
    }
    aim();
  }

  void on_edge() {
    // Raw events of both pins: writing them clears them.
    for (const int8_t pin : {pin_[THIGMO_ENCODER_A], pin_[THIGMO_ENCODER_B]}) {
      io_bank0_hw->intr[pin / 8] = 0xCu << (pin % 8 * 4);
    }
    static constexpr int8_t kIllegal = 2;
    // By old state * 4 + new state; forwards runs 00, 01 (A), 11, 10 (B), 00.
    static const int8_t kStep[16] = {0, 1,        -1, kIllegal, -1,       0,  kIllegal, 1,
                                     1, kIllegal, 0,  -1,       kIllegal, -1, 1,        0};
    const uint8_t now = encoder_pins();
    const int8_t step = kStep[state_ << 2 | now];
    state_ = now;
    if (step == kIllegal) {
      illegal_ = static_cast<uint16_t>(illegal_ + 1);
    } else {
      count_ = count_ + step;
    }
  }

  // --- on core 1, between passes of the main loop ------------------------------------------------
  void pump() {
    while ((uart_->fr & UART_UARTFR_RXFE_BITS) == 0) {
      const uint32_t heard = uart_->dr;
      if ((heard & UART_UARTDR_OE_BITS) != 0) ++overruns_;
      if ((heard & (UART_UARTDR_BE_BITS | UART_UARTDR_FE_BITS)) != 0) continue;
      if (static_cast<uint16_t>(rx_in_ - rx_out_) == kRxRing) {
        ++overruns_;
      } else {
        rx_[rx_in_++ % kRxRing] = static_cast<uint8_t>(heard);
      }
    }
    while (tx_in_ != tx_out_ && (uart_->fr & UART_UARTFR_TXFF_BITS) == 0) {
      uart_->dr = tx_[tx_out_++ % kTxRing];
    }
    measure_supply();
  }

  // All enables low, where a charge pump gets nothing; no converter selected.
  void release() {
    sio_hw->gpio_set = bit(pin_[THIGMO_ADC_SELECT_FLEX]) | bit(pin_[THIGMO_ADC_SELECT_OTHER]);
    for (const int8_t name :
         {THIGMO_MUSCLE_AIR, THIGMO_BODY_AIR, THIGMO_MOTOR_ENABLE, THIGMO_BRAKE_ENABLE}) {
      sio_hw->gpio_clr = bit(pin_[name]);
    }
  }

  // --- on core 0 ---------------------------------------------------------------------------------
  bool saving() const { return saving_; }
  void save_if_asked() {
    if (!saving_) return;
    __dmb();
    store_.commit();
    __dmb();
    saving_ = false;
  }

  // --- what the core does (core/board.h) ---------------------------------------------------------
  uint32_t micros() { return timer_hw->timerawl - origin_us_; }
  uint16_t micros16() { return static_cast<uint16_t>(micros()); }
  uint16_t frame_us() { return kAdcSlots * kSlotUs; }
  const AdcFrame* take_frame() {
    if (held_) frames_out_ = static_cast<uint8_t>(frames_out_ + 1);
    held_ = frames_in_ != frames_out_;
    if (!held_) return nullptr;
    __compiler_memory_barrier();
    AdcFrame* const frame = &frame_[frames_out_ % kAdcFrames];
    narrowing_.apply(frame);
    return frame;
  }

  void drive(uint8_t side, int16_t duty) {
    const int8_t pin = pin_[side == 0 ? THIGMO_DRIVE_LEFT : THIGMO_DRIVE_RIGHT];
    if (duty <= 0) return drive_off(side);
    set_duty(pin, static_cast<uint16_t>(duty));
    give(pin, kPwm);
  }
  void drive_off(uint8_t side) {
    const int8_t pin = pin_[side == 0 ? THIGMO_DRIVE_LEFT : THIGMO_DRIVE_RIGHT];
    give(pin, kSio);  // low
    set_duty(pin, 0);
  }
  // A driver of the MD10C family brakes while its PWM input is low. DIR only moves then.
  void motor(int16_t duty) {
    if (duty == 0) return brake();
    const int8_t direction = pin_[THIGMO_MOTOR_DIRECTION];
    if (((sio_hw->gpio_out & bit(direction)) != 0) != (duty > 0)) {
      brake();
      (duty > 0 ? sio_hw->gpio_set : sio_hw->gpio_clr) = bit(direction);
    }
    set_duty(pin_[THIGMO_MOTOR_PWM], static_cast<uint16_t>(duty > 0 ? duty : -duty));
    give(pin_[THIGMO_MOTOR_PWM], kPwm);
  }
  void brake() {
    give(pin_[THIGMO_MOTOR_PWM], kSio);
    set_duty(pin_[THIGMO_MOTOR_PWM], 0);
  }
  void enable(Enables wanted) {
    sio_hw->gpio_togl = (wanted.muscles ? bit(pin_[THIGMO_MUSCLE_AIR]) : 0) |
                        (wanted.body ? bit(pin_[THIGMO_BODY_AIR]) : 0) |
                        (wanted.motor ? bit(pin_[THIGMO_MOTOR_ENABLE]) : 0) |
                        (wanted.brake ? bit(pin_[THIGMO_BRAKE_ENABLE]) : 0);
  }

  int32_t encoder_count() { return count_; }
  uint16_t encoder_errors() { return illegal_; }
  uint16_t supply_mv() { return supply_mv_; }
  bool estop() { return high(pin_[THIGMO_ESTOP]); }
  bool motor_power() { return high(pin_[THIGMO_MOTOR_POWER]); }

  uint8_t rx_waiting(const uint8_t** first) {
    const uint16_t from = rx_out_ % kRxRing;
    *first = &rx_[from];
    const uint16_t waiting = static_cast<uint16_t>(rx_in_ - rx_out_);
    const uint16_t in_a_row = static_cast<uint16_t>(kRxRing - from);
    const uint16_t count = waiting < in_a_row ? waiting : in_a_row;
    return static_cast<uint8_t>(count < 255 ? count : 255);
  }
  void rx_drop(uint8_t count) { rx_out_ = static_cast<uint16_t>(rx_out_ + count); }
  uint16_t rx_overruns() { return overruns_; }
  uint16_t tx_free() { return static_cast<uint16_t>(kTxRing - tx_pending()); }
  uint16_t tx_pending() { return static_cast<uint16_t>(tx_in_ - tx_out_); }
  void tx_write(const uint8_t* bytes, uint8_t count) {
    for (; count != 0; --count) tx_[tx_in_++ % kTxRing] = *bytes++;
  }

  bool eeprom_ready() { return !saving_; }
  uint8_t eeprom_read(uint16_t address) { return store_.read(address); }
  void eeprom_write(uint16_t address, uint8_t value) { store_.write(address, value); }
  void eeprom_commit() {
    __dmb();
    saving_ = true;
  }

  protocol::ResetCause reset_cause() { return cause_; }
  Latches kept_latches() { return kept_.kept(); }
  void keep_latches(const Latches& latches) { kept_.keep(latches); }
  void task(uint8_t) {}
  // The counter falls by two a microsecond (erratum RP2040-E1).
  void kick_watchdog() { watchdog_hw->load = 2000u * kWatchdogMs; }

 private:
  static constexpr uint32_t kPwm = IO_BANK0_GPIO0_CTRL_FUNCSEL_VALUE_PWM_A_0;
  static constexpr uint32_t kSio = IO_BANK0_GPIO0_CTRL_FUNCSEL_VALUE_SIO_0;
  static constexpr uint32_t kSupplyUs = 100000;

  static void set_duty(int8_t pin, uint16_t duty) {
    volatile uint32_t& compare = pwm_hw->slice[pin / 2 % 8].cc;
    const uint32_t shift = pin % 2 * 16u;
    compare = (compare & ~(0xFFFFu << shift)) | static_cast<uint32_t>(duty) << shift;
  }

  uint8_t encoder_pins() const {
    const uint32_t all = sio_hw->gpio_in;
    return static_cast<uint8_t>((all >> pin_[THIGMO_ENCODER_A] & 1) |
                                (all >> pin_[THIGMO_ENCODER_B] & 1) << 1);
  }

  // The alarm for next_us_, or for as soon as can be if that has passed.
  void aim() {
    timer_hw->alarm[kAlarm] = next_us_;
    if (static_cast<int32_t>(timer_hw->timerawl - next_us_) >= 0) {
      timer_hw->alarm[kAlarm] = timer_hw->timerawl + 2;
    }
  }

  // Starts a conversion: three bytes of 24 us. Channels 0 to 7 of the core's are on the first
  // converter, 8 to 11 on the second.
  void convert() {
    const uint8_t channel = adc_channel((tick_ & 1) != 0, slot_);
    select_ = bit(pin_[channel < 8 ? THIGMO_ADC_SELECT_FLEX : THIGMO_ADC_SELECT_OTHER]);
    const uint8_t input = channel % 8;
    while ((spi_->sr & SPI_SSPSR_RNE_BITS) != 0) (void)spi_->dr;
    sio_hw->gpio_clr = select_;
    spi_->dr = 6u | input >> 2;  // start, single-ended, D2
    spi_->dr = (input & 3u) << 6;
    spi_->dr = 0;
  }

  void take_count() {
    uint32_t byte[3] = {0, 0, 0};
    for (uint32_t& word : byte) {
      if ((spi_->sr & SPI_SSPSR_RNE_BITS) != 0) word = spi_->dr;
    }
    sio_hw->gpio_set = select_;
    const bool full = static_cast<uint8_t>(frames_in_ - frames_out_) == kAdcFrames;
    if (full) return;  // the newest is dropped
    AdcFrame* const frame = &frame_[frames_in_ % kAdcFrames];
    frame->count[slot_ - 1] = static_cast<uint16_t>((byte[1] & 15) << 8 | byte[2]);
    if (slot_ != kAdcSlots) return;
    frame->tick = tick_;
    __compiler_memory_barrier();
    frames_in_ = static_cast<uint8_t>(frames_in_ + 1);
  }

  // Half of the rail against the chip's 3.3 V, by its own converter.
  void measure_supply() {
    const uint32_t now_us = timer_hw->timerawl;
    if (measuring_) {
      if ((adc_hw->cs & ADC_CS_READY_BITS) == 0) return;
      measuring_ = false;
      supply_mv_ = static_cast<uint16_t>(adc_hw->result * 6600u / 4095u);
    } else if (now_us - supply_us_ >= kSupplyUs) {
      supply_us_ = now_us;
      const uint32_t input = static_cast<uint32_t>(pin_[THIGMO_SUPPLY] - 26);
      adc_hw->cs = ADC_CS_EN_BITS | input << ADC_CS_AINSEL_LSB | ADC_CS_START_ONCE_BITS;
      measuring_ = true;
    }
  }

  int8_t pin_[THIGMO_PINS];
  spi_hw_t* spi_;
  uart_hw_t* uart_;
  FlashStore<PicoFlash> store_;
  Narrowing narrowing_;
  LatchRecord& kept_;
  const protocol::ResetCause cause_;
  volatile bool saving_ = false;

  uint32_t origin_us_ = 0, next_us_ = 0;
  uint32_t tick_ = 0;
  uint32_t select_ = 0;
  uint8_t slot_ = 0;
  AdcFrame frame_[kAdcFrames];
  volatile uint8_t frames_in_ = 0, frames_out_ = 0;
  bool held_ = false;

  uint8_t state_ = 0;
  volatile int32_t count_ = 0;
  volatile uint16_t illegal_ = 0;

  uint32_t supply_us_ = 0;
  bool measuring_ = false;
  uint16_t supply_mv_ = 5000;

  uint16_t overruns_ = 0;
  uint8_t rx_[kRxRing], tx_[kTxRing];
  uint16_t rx_in_ = 0, rx_out_ = 0, tx_in_ = 0, tx_out_ = 0;
};

}  // namespace thigmo

#endif  // THIGMO_MICROPYTHON_PICO_BOARD_H_
