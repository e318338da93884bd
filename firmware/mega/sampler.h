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
    wait();
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

  static const AdcFrame* take() {
    const uint8_t out = frame_out_;
    if (frame_in_ == out) return nullptr;
    fence();  // the frame is read after the index that says it is there
    frame_out_ = out + 1;
    if (frame_in_ != frame_out_) wake::ask();  // one a pass
    return &places_[out % kRoom].frame;
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
    // Ready for slot 0, unless the chain was broken: then it starts over before the next tick.
    if (chained() && static_cast<uint8_t>(low(next_) + kLoop) == end_) return;
    ADMUX = kReference | kBandgap;
    ADCSRB = kByTimer;
    TIFR1 = _BV(OCF1B);
    OCR1C = kChain;
    wait();
    odd_ = (static_cast<uint8_t>(tick_) & 1) != 0;
  }

  // The ends of the chain; in slots 0..7 the assembly below does it all.
  static void on_end() {
    if (!done_) {  // slot 7 is over: the frame is whole
      *fill_ = ADC;
      whole_ = whole_ & ADCSRA;
      ADCSRA = kControl | _BV(ADIF) | _BV(ADATE);
      OCR1C = kChain;
      done_ = true;
      const uint8_t in = frame_in_;
      Place& place = places_[in % kRoom];
      take_bandgap(place.bandgap);
      // When the core is late, the newest frame is dropped.
      if ((whole_ & _BV(ADIF)) != 0 && static_cast<uint8_t>(in - frame_out_) < kAdcFrames) {
        place.frame.tick = tick_;
        frame_in_ = in + 1;
        wake::ask();
      }
      return;
    }
    // In the bandgap's conversion: slot 0 follows it at once.
    ADMUX = kReference | (kPressureChannel & 7);
    ADCSRB = _BV(MUX5);
    ADCSRA = kControl | _BV(ADIF) | _BV(ADATE);
    TIFR1 = _BV(OCF1B);
    OCR1C = kMiddle;
    whole_ = _BV(ADIF);
    fill_ = &places_[frame_in_ % kRoom].bandgap;
    odd_ = !odd_;
    next_ = odd_ ? kInputs.odd : kInputs.even;
    end_ = static_cast<uint8_t>(low(next_) + kLoop);
    done_ = false;
    chain();
  }

  // What an interrupt in a slot sets: the input of the slot that follows, and when the next
  // interrupt comes.
  struct Input {
    uint8_t mux;           // ADMUX
    uint8_t control;       // ADCSRB; free running
    uint8_t compare_high;  // OCR1C
    uint8_t compare_low;
  };

  // What the assembly below shares.
  static constexpr uint8_t kControl = _BV(ADEN) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);  // 125 kHz
  // Bit of GPIOR0 that is set at the ends of the chain, where the assembly does not suffice.
  static constexpr uint8_t kEndBit = 1;
  static volatile uint8_t whole_;      // ADIF stays set while each conversion has ended in its time
  static uint16_t* volatile fill_;     // place of the next count
  static const Input* volatile next_;  // in flash
  static volatile uint8_t end_;        // low byte of next_ after slot 7

 private:
  // 13.5 ADC clocks before the tick; the flag rises a cycle after the match.
  static constexpr uint16_t kConversion = 13 * 128;
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

  // Inside the chain, or waiting for its begin.
  static bool chained() { return (GPIOR0 & _BV(kEndBit)) == 0; }
  static void chain() { GPIOR0 &= static_cast<uint8_t>(~_BV(kEndBit)); }
  static void wait() {
    GPIOR0 |= _BV(kEndBit);
    done_ = true;
  }
  static uint8_t low(const volatile Input* input) {
    return static_cast<uint8_t>(reinterpret_cast<uintptr_t>(input));
  }

  // By slot 0..7, on even and on odd ticks.
  struct Inputs {
    Input even[kAdcSlots];
    Input odd[kAdcSlots];
  };
  static constexpr uint8_t kLoop = sizeof(Inputs::even);
  static constexpr Input input(bool odd, uint8_t slot) {
    return slot < kAdcSlots ? entry(adc_channel(odd, slot), kMiddle + slot * kConversion)
                            : Input{kReference | kBandgap, kByTimer, kEnd >> 8, kEnd & 255};
  }
  static constexpr Input entry(uint8_t channel, uint16_t compare) {
    return {static_cast<uint8_t>(kReference | (channel & 7)),
            static_cast<uint8_t>(channel >= 8 ? _BV(MUX5) : 0), static_cast<uint8_t>(compare >> 8),
            static_cast<uint8_t>(compare)};
  }
  static constexpr Inputs inputs() {
    Inputs table{};
    for (uint8_t slot = 0; slot < kAdcSlots; ++slot) {
      table.even[slot] = input(false, static_cast<uint8_t>(slot + 1));
      table.odd[slot] = input(true, static_cast<uint8_t>(slot + 1));
    }
    return table;
  }
  static const Inputs kInputs;

  static constexpr uint8_t kRoom = 8;  // kAdcFrames waiting and one being filled; a power of two
  static volatile uint32_t tick_;
  static bool odd_;  // the tick whose frame is being filled
  // Conversions are stored in the order in which they come: the bandgap's, which the tick's follow.
  struct Place {
    uint16_t bandgap;
    AdcFrame frame;
  };
  static Place places_[kRoom];
  static bool done_;  // the chain's next end is its begin
  static volatile uint8_t frame_in_, frame_out_;
  static volatile uint16_t bandgap_, bandgap_sum_;
  static uint16_t bandgap_running_;
  static uint8_t bandgap_counted_;
};

const Sampler::Inputs Sampler::kInputs PROGMEM = Sampler::inputs();
volatile uint32_t Sampler::tick_;
volatile uint8_t Sampler::whole_;
uint16_t* volatile Sampler::fill_;
const Sampler::Input* volatile Sampler::next_;
bool Sampler::odd_;
Sampler::Place Sampler::places_[kRoom];
bool Sampler::done_;
volatile uint8_t Sampler::end_;
volatile uint8_t Sampler::frame_in_, Sampler::frame_out_;
volatile uint16_t Sampler::bandgap_, Sampler::bandgap_sum_;
uint16_t Sampler::bandgap_running_;
uint8_t Sampler::bandgap_counted_;

}  // namespace mega
}  // namespace thigmo

ISR(TIMER1_COMPA_vect, THIGMO_FAST) { thigmo::mega::Sampler::on_tick(); }

// Called from the assembly by its name.
extern "C" void thigmo_chain_end() __attribute__((used, externally_visible));
extern "C" void thigmo_chain_end() { thigmo::mega::Sampler::on_end(); }

// In slots 0..7: keep the last result, choose the next input. Eight of the ten interrupts of each
// millisecond take 83 cycles so, where a compiler's take 136: they touch no flags, so SREG need not
// be saved, and what changes from slot to slot comes from a table. The others save what a call may
// change.
ISR(TIMER1_COMPC_vect, ISR_NAKED) {
  __asm__ volatile(
      "push r24              \n\t"
      "push r30              \n\t"
      "push r31              \n\t"
      "sbic %[gpior0], %[bit] \n\t"
      "rjmp 4f               \n\t"
      "lds  r24, %[adcsra]   \n\t"
      "sbrs r24, %[adif]     \n\t"
      "rjmp 3f               \n\t"  // no conversion has ended
      "1: ldi r24, %[again]  \n\t"
      "sts  %[adcsra], r24   \n\t"
      "lds  r30, %[fill]     \n\t"  // *fill_++ = ADC
      "lds  r31, %[fill]+1   \n\t"
      "lds  r24, %[adc]      \n\t"
      "st   Z+, r24          \n\t"
      "lds  r24, %[adc]+1    \n\t"
      "st   Z+, r24          \n\t"
      "sts  %[fill]+1, r31   \n\t"
      "sts  %[fill], r30     \n\t"
      "lds  r30, %[next]     \n\t"  // ADMUX, ADCSRB, OCR1C = *next_++
      "lds  r31, %[next]+1   \n\t"
      "lpm  r24, Z+          \n\t"
      "sts  %[admux], r24    \n\t"
      "lpm  r24, Z+          \n\t"
      "sts  %[adcsrb], r24   \n\t"
      "lpm  r24, Z+          \n\t"
      "sts  %[ocr]+1, r24    \n\t"
      "lpm  r24, Z+          \n\t"
      "sts  %[ocr], r24      \n\t"
      "sts  %[next]+1, r31   \n\t"
      "sts  %[next], r30     \n\t"
      "lds  r24, %[end]      \n\t"
      "cpse r30, r24         \n\t"
      "rjmp 2f               \n\t"
      "sbi  %[gpior0], %[bit] \n\t"
      "2: pop r31            \n\t"
      "pop  r30              \n\t"
      "pop  r24              \n\t"
      "reti                  \n\t"
      "3: ldi r24, 0         \n\t"
      "sts  %[whole], r24    \n\t"
      "rjmp 1b               \n\t"
      "4: in r24, %[sreg]    \n\t"
      "push r24              \n\t"
      "push r0               \n\t"
      "push r1               \n\t"
      "push r18              \n\t"
      "push r19              \n\t"
      "push r20              \n\t"
      "push r21              \n\t"
      "push r22              \n\t"
      "push r23              \n\t"
      "push r25              \n\t"
      "push r26              \n\t"
      "push r27              \n\t"
      "clr  r1               \n\t"
      "call thigmo_chain_end \n\t"
      "pop  r27              \n\t"
      "pop  r26              \n\t"
      "pop  r25              \n\t"
      "pop  r23              \n\t"
      "pop  r22              \n\t"
      "pop  r21              \n\t"
      "pop  r20              \n\t"
      "pop  r19              \n\t"
      "pop  r18              \n\t"
      "pop  r1               \n\t"
      "pop  r0               \n\t"
      "pop  r24              \n\t"
      "out  %[sreg], r24     \n\t"
      "rjmp 2b               \n\t"
      :
      : [sreg] "I"(_SFR_IO_ADDR(SREG)), [gpior0] "I"(_SFR_IO_ADDR(GPIOR0)),
        [bit] "n"(thigmo::mega::Sampler::kEndBit), [adif] "I"(ADIF),
        [whole] "i"(&thigmo::mega::Sampler::whole_), [fill] "i"(&thigmo::mega::Sampler::fill_),
        [next] "i"(&thigmo::mega::Sampler::next_), [end] "i"(&thigmo::mega::Sampler::end_),
        [adcsra] "i"(_SFR_MEM_ADDR(ADCSRA)), [adcsrb] "i"(_SFR_MEM_ADDR(ADCSRB)),
        [admux] "i"(_SFR_MEM_ADDR(ADMUX)), [adc] "i"(_SFR_MEM_ADDR(ADCL)),
        [ocr] "i"(_SFR_MEM_ADDR(OCR1CL)),
        [again] "n"(thigmo::mega::Sampler::kControl | _BV(ADIF) | _BV(ADATE)));
}

#endif  // THIGMO_MEGA_SAMPLER_H_
