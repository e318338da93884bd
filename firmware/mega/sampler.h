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

  // Interrupt routine of compare A, where a tick begins.
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

  // The ends of the chain; in slots 1..6 the assembly below does it all.
  static void on_other_slot() {
    const uint16_t result = ADC;
    whole_ &= ADCSRA;
    ADCSRA = kControl | _BV(ADIF) | _BV(ADATE);
    switch (step_) {
      case kFirst:  // in slot 0
        select();
        OCR1C = kMiddle + kConversion;
        take_bandgap(result);
        step_ = kFirst + 1;
        break;
      case kLast:  // in slot 7: nothing follows until compare B
        ADMUX = kReference | kBandgap;
        ADCSRB = kByTimer;
        OCR1C = kEnd;
        *fill_++ = result;
        step_ = kDone;
        break;
      case kDone: {
        *fill_ = result;
        OCR1C = kChain;
        step_ = kIdle;
        // When the core is late, the newest frame is dropped.
        const uint8_t in = frame_in_;
        if ((whole_ & _BV(ADIF)) != 0 && static_cast<uint8_t>(in - frame_out_) < kAdcFrames) {
          frames_[in % kRoom].tick = tick_;
          frame_in_ = in + 1;
          wake::ask();
        }
        break;
      }
      default:  // in the bandgap's conversion: slot 0 follows it at once
        ADMUX = kReference | (kPressureChannel & 7);
        ADCSRB = _BV(MUX5);
        TIFR1 = _BV(OCF1B);
        OCR1C = kMiddle;
        whole_ = _BV(ADIF);
        fill_ = frames_[frame_in_ % kRoom].count;
        odd_ = !odd_;
        next_ = odd_ ? kInputs.odd : kInputs.even;
        step_ = kFirst;
        break;
    }
  }

  // Registers that choose an input.
  struct Input {
    uint8_t mux;      // ADMUX
    uint8_t control;  // ADCSRB; free running
  };

  // What the assembly below shares.
  static constexpr uint16_t kConversion = 13 * 128;
  static constexpr uint8_t kControl = _BV(ADEN) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);  // 125 kHz
  // Where in the chain the next compare C falls.
  static constexpr uint8_t kFirst = 0;  // in slot 0
  static constexpr uint8_t kLast = kFirst + kAdcSlots - 1;
  static constexpr uint8_t kDone = kLast + 1;  // after slot 7
  static constexpr uint8_t kIdle = kDone + 1;  // in the bandgap's conversion
  static volatile uint8_t step_;
  static volatile uint8_t whole_;      // ADIF stays set while each conversion has ended in its time
  static uint16_t* volatile fill_;     // place of the next count
  static const Input* volatile next_;  // in flash

 private:
  // 13.5 ADC clocks before the tick; the flag rises a cycle after the match.
  static constexpr uint16_t kTrigger = kTickCycles - 1728 - 1;
  static constexpr uint16_t kChain = kTrigger + 832;    // middle of the bandgap's conversion
  static constexpr uint16_t kMiddle = kConversion / 2;  // middle of slot 0
  static constexpr uint16_t kEnd = kAdcSlots * kConversion + 96;  // after the last slot
  static constexpr uint8_t kReference = _BV(REFS0);               // AVcc
  static constexpr uint8_t kBandgap = 0x1E;
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

  static inline void select() {
    const Input* next = next_;
    ADMUX = pgm_read_byte(&next->mux);
    ADCSRB = pgm_read_byte(&next->control);
    next_ = next + 1;
  }

  // Inputs of slots 1..7, on even and on odd ticks.
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
  static bool odd_;  // the tick whose frame is being filled
  static AdcFrame frames_[kRoom];
  static volatile uint8_t frame_in_, frame_out_;
  static volatile uint16_t bandgap_, bandgap_sum_;
  static uint16_t bandgap_running_;
  static uint8_t bandgap_counted_;
};

const Sampler::Inputs Sampler::kInputs PROGMEM = Sampler::inputs();
volatile uint32_t Sampler::tick_;
volatile uint8_t Sampler::step_;
volatile uint8_t Sampler::whole_;
uint16_t* volatile Sampler::fill_;
const Sampler::Input* volatile Sampler::next_;
bool Sampler::odd_;
AdcFrame Sampler::frames_[kRoom];
volatile uint8_t Sampler::frame_in_, Sampler::frame_out_;
volatile uint16_t Sampler::bandgap_, Sampler::bandgap_sum_;
uint16_t Sampler::bandgap_running_;
uint8_t Sampler::bandgap_counted_;

}  // namespace mega
}  // namespace thigmo

ISR(TIMER1_COMPA_vect, THIGMO_FAST) { thigmo::mega::Sampler::on_tick(); }

// Called from the assembly by its name.
extern "C" void thigmo_other_slot() __attribute__((used, externally_visible));
extern "C" void thigmo_other_slot() { thigmo::mega::Sampler::on_other_slot(); }

// In slots 1..6: keep the last result, choose the next input. Six of the ten interrupts of each
// millisecond take 98 cycles so, where a compiler's take 136; the others save what a call may
// change.
ISR(TIMER1_COMPC_vect, ISR_NAKED) {
  __asm__ volatile(
      "push r24              \n\t"
      "in   r24, %[sreg]     \n\t"
      "push r24              \n\t"
      "push r25              \n\t"
      "push r30              \n\t"
      "push r31              \n\t"
      "lds  r24, %[step]     \n\t"
      "dec  r24              \n\t"
      "cpi  r24, %[slots]    \n\t"
      "brsh 1f               \n\t"
      "subi r24, -2          \n\t"
      "sts  %[step], r24     \n\t"
      "lds  r24, %[adcsra]   \n\t"  // whole_ &= ADCSRA
      "lds  r25, %[whole]    \n\t"
      "and  r25, r24         \n\t"
      "sts  %[whole], r25    \n\t"
      "ldi  r24, %[again]    \n\t"
      "sts  %[adcsra], r24   \n\t"
      "lds  r30, %[fill]     \n\t"  // *fill_++ = ADC
      "lds  r31, %[fill]+1   \n\t"
      "lds  r24, %[adc]      \n\t"
      "lds  r25, %[adc]+1    \n\t"
      "st   Z+, r24          \n\t"
      "st   Z+, r25          \n\t"
      "sts  %[fill], r30     \n\t"
      "sts  %[fill]+1, r31   \n\t"
      "lds  r30, %[next]     \n\t"  // ADMUX, ADCSRB = *next_++
      "lds  r31, %[next]+1   \n\t"
      "lpm  r24, Z+          \n\t"
      "sts  %[admux], r24    \n\t"
      "lpm  r24, Z+          \n\t"
      "sts  %[adcsrb], r24   \n\t"
      "sts  %[next], r30     \n\t"
      "sts  %[next]+1, r31   \n\t"
      "lds  r24, %[ocr]      \n\t"  // OCR1C += kConversion
      "lds  r25, %[ocr]+1    \n\t"
      "subi r24, lo8(-%[conversion]) \n\t"
      "sbci r25, hi8(-%[conversion]) \n\t"
      "sts  %[ocr]+1, r25    \n\t"
      "sts  %[ocr], r24      \n\t"
      "0: pop r31            \n\t"
      "pop  r30              \n\t"
      "pop  r25              \n\t"
      "pop  r24              \n\t"
      "out  %[sreg], r24     \n\t"
      "pop  r24              \n\t"
      "reti                  \n\t"
      "1: push r0            \n\t"
      "push r1               \n\t"
      "push r18              \n\t"
      "push r19              \n\t"
      "push r20              \n\t"
      "push r21              \n\t"
      "push r22              \n\t"
      "push r23              \n\t"
      "push r26              \n\t"
      "push r27              \n\t"
      "clr  r1               \n\t"
      "call thigmo_other_slot \n\t"
      "pop  r27              \n\t"
      "pop  r26              \n\t"
      "pop  r23              \n\t"
      "pop  r22              \n\t"
      "pop  r21              \n\t"
      "pop  r20              \n\t"
      "pop  r19              \n\t"
      "pop  r18              \n\t"
      "pop  r1               \n\t"
      "pop  r0               \n\t"
      "rjmp 0b               \n\t"
      :
      : [sreg] "I"(_SFR_IO_ADDR(SREG)), [step] "i"(&thigmo::mega::Sampler::step_),
        [slots] "n"(thigmo::mega::Sampler::kLast - thigmo::mega::Sampler::kFirst - 1),
        [whole] "i"(&thigmo::mega::Sampler::whole_), [fill] "i"(&thigmo::mega::Sampler::fill_),
        [next] "i"(&thigmo::mega::Sampler::next_), [adcsra] "i"(_SFR_MEM_ADDR(ADCSRA)),
        [adcsrb] "i"(_SFR_MEM_ADDR(ADCSRB)), [admux] "i"(_SFR_MEM_ADDR(ADMUX)),
        [adc] "i"(_SFR_MEM_ADDR(ADCL)), [ocr] "i"(_SFR_MEM_ADDR(OCR1CL)),
        [again] "n"(thigmo::mega::Sampler::kControl | _BV(ADIF) | _BV(ADATE)),
        [conversion] "i"(thigmo::mega::Sampler::kConversion));
}

#endif  // THIGMO_MEGA_SAMPLER_H_
