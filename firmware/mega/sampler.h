// The control tick (timer 1) and the analog frames that it starts.
//
// Timing, in cycles of the tick (TCNT1, 16 000 a millisecond); a conversion takes 13 ADC clocks of
// 128 cycles (data sheet 26.4, table 26-1):
//
//   14272   compare B starts a conversion of the bandgap by hardware: 13.5 ADC clocks, to 16000 = 0
//   0       slot 0 starts as the free-running successor, slot k at 1664 k, the last ends at 13312
//   13312   the ADC rests on the bandgap, which so has 60 us to settle before its conversion
//
// So no sampling instant depends on an interrupt: from hold to hold it is exactly 104 us, and 1 ms
// from tick to tick. Compare C interrupts in the middle of each conversion, at least 45 us from
// either end, to fetch the last result and choose the next input; the data sheet (26.5) allows a
// change of ADMUX there, at least one ADC clock after a start. A delayed interrupt hence shifts
// nothing as long as it is less than 45 us late.
//
// Who uses it: MegaBoard (board.h); the interrupt routines are defined here.
#ifndef THIGMO_MEGA_SAMPLER_H_
#define THIGMO_MEGA_SAMPLER_H_

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#include "../core/board.h"
#include "program_memory.h"
#include "restart.h"
#include "wake.h"

namespace thigmo {
namespace mega {

class Sampler {
 public:
  static constexpr uint16_t kTickCycles = 16000;

  // Starts the tick; tick 0 begins 120 us later.
  static void begin() {
    ADMUX = kReference | kBandgap;
    ADCSRA = kControl | _BV(ADSC);  // the first conversion takes 25 clocks: out of the way
    loop_until_bit_is_clear(ADCSRA, ADSC);
    ADCSRA = kControl | _BV(ADIF) | _BV(ADATE);
    ADCSRB = kByTimer;
    tick_ = 0xFFFFFFFF;
    step_ = kIdle;
    odd_ = true;  // tick 0 is even
    TCCR1A = 0;
    TCCR1B = _BV(WGM12);
    TCNT1 = kTrigger - 192;
    OCR1A = kTickCycles - 1;
    OCR1B = kTrigger;
    OCR1C = kChain;
    TIFR1 = _BV(OCF1A) | _BV(OCF1B) | _BV(OCF1C);
    TIMSK1 = _BV(OCIE1A) | _BV(OCIE1C);
    TCCR1B = _BV(WGM12) | _BV(CS10);
  }

  static bool started() {
    uint32_t tick;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { tick = tick_; }
    return tick != 0xFFFFFFFF;
  }

  static uint32_t micros() {
    uint32_t tick;
    uint16_t count;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
      tick = tick_;
      count = TCNT1;
      // The counter may have wrapped since interrupts were shut.
      if ((TIFR1 & _BV(OCF1A)) != 0 && count < kTickCycles / 2) ++tick;
    }
    return tick * 1000 + count / 16;
  }

  static bool take(AdcFrame* frame) {
    const uint8_t out = frame_out_;
    if (frame_in_ == out) return false;
    *frame = frames_[out % kRoom];
    frame_out_ = out + 1;
    if (frame_in_ != frame_out_) wake::ask();  // one a pass
    return true;
  }

  // Sum of 16 bandgap conversions, or 0 before there are as many.
  static uint16_t bandgap_sum() {
    uint16_t sum;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { sum = bandgap_sum_; }
    return sum;
  }
  static constexpr uint8_t kBandgapCount = 16;
  // The last single conversion, for the record that a reset leaves.
  static uint16_t bandgap() {
    uint16_t count;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { count = bandgap_; }
    return count;
  }

  // --- interrupt routines
  // --------------------------------------------------------------------------
  static inline void on_tick() {
    Restart::on_tick();
    tick_ = tick_ + 1;
    if (step_ != kFirst) {  // the chain was broken: start over before the next tick
      ADMUX = kReference | kBandgap;
      ADCSRB = kByTimer;
      TIFR1 = _BV(OCF1B);
      OCR1C = kChain;
      step_ = kIdle;
      odd_ = (static_cast<uint8_t>(tick_) & 1) != 0;
    }
  }

  static inline void on_slot() {
    const uint16_t result = ADC;
    // No conversion ended: do not invent a reading.
    if ((ADCSRA & _BV(ADIF)) == 0) whole_ = false;
    ADCSRA = kControl | _BV(ADIF) | _BV(ADATE);
    const uint8_t step = step_;
    if (step < kLast) {  // in slot 0..6, the most frequent case
      const Input* next = next_;
      ADMUX = pgm_read_byte(&next->mux);
      ADCSRB = pgm_read_byte(&next->control);
      next_ = next + 1;
      OCR1C += kConversion;
      if (step != kFirst) {
        *fill_++ = result;
      } else {
        take_bandgap(result);
      }
      step_ = step + 1;
    } else if (step == kLast) {  // in slot 7: nothing follows until compare B
      ADMUX = kReference | kBandgap;
      ADCSRB = kByTimer;
      OCR1C = kEnd;
      *fill_++ = result;
      step_ = kDone;
    } else if (step == kDone) {
      *fill_ = result;
      OCR1C = kChain;
      step_ = kIdle;
      // When the core is late, the newest frame is dropped.
      const uint8_t in = frame_in_;
      if (whole_ && static_cast<uint8_t>(in - frame_out_) < kAdcFrames) {
        frames_[in % kRoom].tick = tick_;
        frame_in_ = in + 1;
        wake::ask();
      }
    } else {  // in the bandgap's conversion: slot 0 follows it at once
      ADMUX = kReference | (kPressureChannel & 7);
      ADCSRB = _BV(MUX5);
      TIFR1 = _BV(OCF1B);
      OCR1C = kMiddle;
      whole_ = true;
      fill_ = frames_[frame_in_ % kRoom].count;
      odd_ = !odd_;
      next_ = odd_ ? kInputs.odd : kInputs.even;
      step_ = kFirst;
    }
  }

 private:
  static constexpr uint16_t kConversion = 13 * 128;
  static constexpr uint16_t kTrigger = kTickCycles - 1728;  // 13.5 ADC clocks before the tick
  static constexpr uint16_t kChain = kTrigger + 832;        // middle of the bandgap's conversion
  static constexpr uint16_t kMiddle = kConversion / 2;      // middle of slot 0
  static constexpr uint16_t kEnd = kAdcSlots * kConversion + 96;  // after the last slot
  static constexpr uint8_t kReference = _BV(REFS0);               // AVcc
  static constexpr uint8_t kBandgap = 0x1E;
  static constexpr uint8_t kControl = _BV(ADEN) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);  // 125 kHz
  static constexpr uint8_t kByTimer = _BV(ADTS2) | _BV(ADTS0);  // timer 1 compare B

  static inline void take_bandgap(uint16_t count) {
    bandgap_ = count;
    bandgap_running_ += count;
    if (++bandgap_counted_ == kBandgapCount) {
      bandgap_sum_ = bandgap_running_;
      bandgap_running_ = 0;
      bandgap_counted_ = 0;
    }
  }

  // Registers that choose the inputs of slots 1..7, on even and on odd ticks.
  struct Input {
    uint8_t mux;      // ADMUX
    uint8_t control;  // ADCSRB; free running
  };
  struct Inputs {
    Input even[kAdcSlots - 1];
    Input odd[kAdcSlots - 1];
  };
  static constexpr Input input(uint8_t channel) {
    return {static_cast<uint8_t>(kReference | (channel & 7)),
            static_cast<uint8_t>(channel >= 8 ? _BV(MUX5) : 0)};
  }
  static constexpr Inputs inputs() {
    Inputs table{};
    for (uint8_t slot = 1; slot < kAdcSlots; ++slot) {
      table.even[slot - 1] = input(adc_channel(false, slot));
      table.odd[slot - 1] = input(adc_channel(true, slot));
    }
    return table;
  }
  static const Inputs kInputs;

  static constexpr uint8_t kRoom = 8;  // kAdcFrames waiting and one being filled; a power of two
  static volatile uint32_t tick_;
  // Where in the chain the next compare C falls.
  static constexpr uint8_t kFirst = 0;  // in slot 0
  static constexpr uint8_t kLast = kFirst + kAdcSlots - 1;
  static constexpr uint8_t kDone = kLast + 1;  // after slot 7
  static constexpr uint8_t kIdle = kDone + 1;  // in the bandgap's conversion
  static volatile uint8_t step_;
  static bool odd_;           // the tick whose frame is being filled
  static bool whole_;         // every conversion of the running frame has ended
  static uint16_t* fill_;     // place of the next count
  static const Input* next_;  // in flash
  static AdcFrame frames_[kRoom];
  static volatile uint8_t frame_in_, frame_out_;
  static volatile uint16_t bandgap_, bandgap_sum_;
  static uint16_t bandgap_running_;
  static uint8_t bandgap_counted_;
};

const Sampler::Inputs Sampler::kInputs PROGMEM = Sampler::inputs();
volatile uint32_t Sampler::tick_;
volatile uint8_t Sampler::step_;
bool Sampler::odd_, Sampler::whole_;
uint16_t* Sampler::fill_;
const Sampler::Input* Sampler::next_;
AdcFrame Sampler::frames_[kRoom];
volatile uint8_t Sampler::frame_in_, Sampler::frame_out_;
volatile uint16_t Sampler::bandgap_, Sampler::bandgap_sum_;
uint16_t Sampler::bandgap_running_;
uint8_t Sampler::bandgap_counted_;

}  // namespace mega
}  // namespace thigmo

ISR(TIMER1_COMPA_vect, THIGMO_FAST) { thigmo::mega::Sampler::on_tick(); }
ISR(TIMER1_COMPC_vect, THIGMO_FAST) { thigmo::mega::Sampler::on_slot(); }

#endif  // THIGMO_MEGA_SAMPLER_H_
