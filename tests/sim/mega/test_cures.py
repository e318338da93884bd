"""What libsimavr 1.6 gets wrong on the ATmega2560, each cure shown on a small program."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from thigmo.emulator.chip import CHANNELS, CYCLES_PER_MS, Cause, Chip

Programs = Callable[[str], Chip]
OUT = 0x1000


def words(chip: Chip, count: int) -> list[int]:
    return np.frombuffer(chip.read("ram", OUT, 2 * count), "<u2").tolist()


# --- analog inputs --------------------------------------------------------------------------------
ALL_CHANNELS = """
static uint16_t convert(uint8_t channel) {
  ADMUX = _BV(REFS0) | (channel & 7);
  ADCSRB = channel & 8 ? _BV(MUX5) : 0;
  ADCSRA |= _BV(ADSC);
  while (ADCSRA & _BV(ADSC)) {}
  return ADC;
}
int main(void) {
  ADCSRA = _BV(ADEN) | 7;
  for (uint8_t i = 0; i < 16; i++) OUT16[i] = convert(i);
  ADMUX = _BV(REFS0) | 30;
  ADCSRB = 0;
  ADCSRA |= _BV(ADSC);
  while (ADCSRA & _BV(ADSC)) {}
  OUT16[16] = ADC;
  for (;;) {}
}
"""


def test_all_sixteen_analog_channels_and_the_bandgap(program: Programs) -> None:
    chip = program(ALL_CHANNELS)
    ideal = 17.5 + 60.0 * np.arange(CHANNELS)
    chip.analog(ideal, ideal, 0, 1)
    chip.run_ms(3)
    assert words(chip, 17) == [*np.floor(ideal).astype(int).tolist(), 1100 * 1024 // 5000]


def test_conversion_takes_thirteen_adc_clocks_and_samples_inside(program: Programs) -> None:
    chip = program(ALL_CHANNELS)
    chip.record_trace(True)
    chip.run_ms(3)
    trace = chip.take_trace()
    assert trace["channel"].tolist() == [*range(16), 30]
    gaps = np.diff(trace["sampled"])[1:]  # the first conversion takes 25 clocks
    assert np.all(gaps % 128 == 0), "conversions start on the ADC's clock"
    assert np.all(gaps == 14 * 128)  # 13 clocks and the wait for the next edge


def test_analog_input_moves_linearly_inside_an_exchange(program: Programs) -> None:
    chip = program(ALL_CHANNELS)
    chip.record_trace(True)
    chip.analog(np.zeros(CHANNELS), np.full(CHANNELS, 900.0), 0, 3 * CYCLES_PER_MS)
    chip.run_ms(3)
    trace = chip.take_trace()[:CHANNELS]
    expected = np.floor(900.0 * trace["sampled"] / (3 * CYCLES_PER_MS))
    assert trace["count"].tolist() == expected.tolist()


def test_timer_one_triggers_conversions_at_exact_instants(program: Programs) -> None:
    chip = program("""
        ISR(ADC_vect) { TIFR1 = _BV(OCF1B); OUT16[0]++; }
        ISR(TIMER0_OVF_vect) { _delay_us(7); }
        int main(void) {
          TCCR0B = 1; TIMSK0 = _BV(TOIE0);  /* another interrupt that delays this one */
          ADMUX = _BV(REFS0);
          ADCSRA = _BV(ADEN) | 7;
          ADCSRA |= _BV(ADSC);
          while (ADCSRA & _BV(ADSC)) {}
          OCR1A = 3999; OCR1B = 100;
          ADCSRB = _BV(ADTS2) | _BV(ADTS0);
          ADCSRA |= _BV(ADIF) | _BV(ADATE) | _BV(ADIE);
          TCCR1B = _BV(WGM12) | _BV(CS10);
          sei();
          for (;;) {}
        }
    """)
    chip.run_ms(1)
    chip.record_trace(True)
    chip.run_ms(10)
    assert set(np.diff(chip.take_trace()["sampled"]).tolist()) == {4000}
    assert chip.lost_triggers == 0


def test_a_trigger_is_lost_while_its_flag_stands(program: Programs) -> None:
    chip = program("""
        int main(void) {
          ADMUX = _BV(REFS0);
          OCR1A = 3999; OCR1B = 100;
          ADCSRB = _BV(ADTS2) | _BV(ADTS0);
          ADCSRA = _BV(ADEN) | _BV(ADATE) | 7;
          TCCR1B = _BV(WGM12) | _BV(CS10);
          for (;;) {}
        }
    """)
    chip.record_trace(True)
    chip.run_ms(5)
    assert len(chip.take_trace()) == 1
    assert chip.lost_triggers >= 15


# --- serial port ----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("setup", "cycles"),
    [
        ("UBRR0 = 7; UCSR0A = _BV(U2X0);", 640),  # 250 kbaud, rate before U2X
        ("UCSR0A = _BV(U2X0); UBRR0 = 3;", 320),  # 500 kbaud
        ("UBRR0 = 16; UCSR0A = _BV(U2X0);", 1360),  # 115200 as it really is
        ("UCSR0A = 0; UBRR0 = 0;", 160),  # 1 Mbaud
    ],
)
def test_a_byte_takes_ten_bits_whatever_the_order_of_setting(
    program: Programs, setup: str, cycles: int
) -> None:
    chip = program(f"""
        int main(void) {{
          {setup}
          UCSR0B = _BV(TXEN0);
          for (uint8_t i = 0;; i++) {{ while (!(UCSR0A & _BV(UDRE0))) {{}} UDR0 = i; }}
        }}
    """)
    chip.run_ms(3)
    data, at = chip.take()
    assert data == bytes(i % 256 for i in range(len(data)))
    assert len(data) > 20
    assert set(np.diff(at).tolist()) == {cycles}, "back to back: the transmitter is double-buffered"
    assert chip.line_byte_cycles == cycles


SLOW_READER = """
int main(void) {
  UCSR0A = _BV(U2X0); UBRR0 = 7; UCSR0B = _BV(RXEN0) | _BV(TXEN0);
  _delay_ms(1);
  uint8_t n = 0;
  while (UCSR0A & _BV(RXC0)) {
    OUT[16 + n] = UCSR0A;
    OUT[n++] = UDR0;
    if (n == 16) break;
  }
  OUT[32] = n;
  for (;;) {}
}
"""


@pytest.mark.parametrize(
    ("sent", "kept", "lost"),
    [(b"abc", b"abc", 0), (b"abcdefg", b"abg", 4)],  # the shift register keeps the newest
)
def test_receiver_holds_three_bytes_and_counts_what_it_loses(
    program: Programs, sent: bytes, kept: bytes, lost: int
) -> None:
    chip = program(SLOW_READER)
    chip.run_ms(0.1)
    chip.send(sent)
    chip.run_ms(3)
    assert chip.read("ram", OUT, 3) == kept
    assert chip.read("ram", OUT + 32, 1) == b"\3"
    assert bool(chip.read("ram", OUT + 16, 1)[0] & 0x08) == (lost > 0), "DOR tells the program"
    assert chip.line_overruns == lost


ECHO = """
ISR(USART0_RX_vect) { UDR0 = UDR0; }
int main(void) {
  UCSR0A = _BV(U2X0); UBRR0 = 7; UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
  set_sleep_mode(SLEEP_MODE_IDLE);
  sei();
  for (;;) sleep_mode();
}
"""


def test_bytes_arrive_at_the_wire_rate(program: Programs) -> None:
    chip = program(ECHO)
    chip.run_ms(1)
    chip.line_baud(250_000)
    chip.send(bytes(range(100)))
    chip.run_ms(6)
    data, at = chip.take()
    assert data == bytes(range(100))
    assert np.all(np.abs(np.diff(at).astype(int) - 640) <= 8)


def test_a_host_at_another_rate_is_heard_as_noise(program: Programs) -> None:
    chip = program(ECHO)
    chip.run_ms(1)
    chip.line_baud(115_200)
    chip.send(b"hello, robot")
    chip.run_ms(5)
    data, _ = chip.take()
    assert data
    assert data != b"hello, robot"


@pytest.mark.parametrize(("baud", "clean"), [(245_100, True), (255_000, True), (231_000, False)])
def test_two_percent_of_rate_error_pass_and_eight_do_not(
    program: Programs, baud: int, clean: bool
) -> None:
    sent = bytes(range(0, 250, 7))
    chip = program(ECHO)
    chip.run_ms(1)
    chip.line_baud(baud)
    chip.send(sent)
    chip.run_ms(5)
    assert (chip.take()[0] == sent) is clean


# --- processor ------------------------------------------------------------------------------------
def test_accepting_an_interrupt_takes_five_cycles(program: Programs) -> None:
    chip = program("""
        ISR(TIMER1_COMPA_vect, ISR_NAKED) { __asm__("reti"); }
        int main(void) {
          OCR1A = 999; TCCR1B = _BV(WGM12) | _BV(CS10); TIMSK1 = _BV(OCIE1A);
          sei();
          for (;;) {}
        }
    """)
    chip.run_ms(5)
    figures = chip.interrupt(17)
    assert figures.count >= 75
    assert (figures.shortest, figures.longest) == (5 + 3 + 5, 5 + 3 + 5)  # accept, jmp, reti


def test_instructions_take_the_cycles_of_the_data_sheet(program: Programs) -> None:
    cases = [
        ("nop", 1), ("push r0\\n pop r0", 4), ("lds r0, 0x1000", 2), ("sts 0x1000, r1", 2),
        ("rcall 1f\\n rjmp 2f\\n 1: ret\\n 2:", 4 + 5 + 2),
        ("call 1f\\n rjmp 2f\\n 1: ret\\n 2:", 5 + 5 + 2),
        ("mul r0, r1\\n clr r1", 3), ("adiw r24, 0", 2), ("lpm r0, Z", 3), ("elpm r0, Z", 3),
        ("in r0, 0x3f", 1), ("ld r0, X", 2), ("rjmp .+0", 2), ("brne .+0", 2), ("sbis 0x00, 7", 1),
    ]  # fmt: skip
    body = "\n".join(
        f'GPIOR0 = 1; __asm__ volatile("clz\\n {text}" ::: "r0", "r24", "r25", "memory");'
        "GPIOR0 = 0;"
        for text, _ in cases
    )
    chip = program(f"int main(void) {{ DDRA = 0x80; {body} for (;;) {{}} }}")
    chip.record_marks(True)
    chip.run_ms(1)
    marks = chip.take_marks()
    starts = marks["cycle"][marks["value"] == 1]
    stops = marks["cycle"][marks["value"] == 0]
    overhead = {(int(b - a) - 1) - n for a, b, (_, n) in zip(starts, stops, cases, strict=True)}
    # Loading the mark's constant and writing it is the same few cycles everywhere.
    assert len(overhead) == 1, list(zip(cases, (stops - starts).tolist(), strict=True))


def test_sleep_costs_no_time_and_is_counted(program: Programs) -> None:
    chip = program(ECHO)
    chip.run_ms(1)
    chip.measure_again()
    chip.run_ms(1000)
    assert chip.asleep_cycles > 0.999 * 1000 * CYCLES_PER_MS


# --- timers ---------------------------------------------------------------------------------------
def test_phase_correct_pwm_is_read_from_the_registers(program: Programs) -> None:
    chip = program("""
        int main(void) {
          DDRH = _BV(3);
          ICR4 = 400; OCR4A = 123;
          TCCR4A = _BV(COM4A1) | _BV(WGM41); TCCR4B = _BV(WGM43) | _BV(CS40);
          for (;;) {}
        }
    """)
    chip.run_ms(1)
    pwm = chip.pwm(4)
    assert (pwm.compare[0], pwm.top, pwm.period_cycles) == (123, 400, 800)  # 20 kHz
    assert pwm.connected[:] == [True, False, False]


def test_true_zero_is_a_disconnected_output_and_a_low_pin(program: Programs) -> None:
    chip = program("""
        int main(void) {
          DDRL = _BV(3) | _BV(4);
          ICR5 = 1599; OCR5A = 800; OCR5B = 0;
          TCCR5A = _BV(COM5A1) | _BV(WGM51); TCCR5B = _BV(WGM53) | _BV(WGM52) | _BV(CS50);
          for (;;) {}
        }
    """)
    chip.run_ms(1)
    pwm = chip.pwm(5)
    assert pwm.connected[:] == [True, False, False]
    assert (pwm.compare[0], pwm.top, pwm.period_cycles) == (800, 1599, 1600)
    assert chip.output("L", 4) is False


def test_a_sixteen_bit_timer_counts_every_cycle(program: Programs) -> None:
    chip = program("""
        int main(void) {
          TCCR1B = _BV(CS10);
          for (uint8_t i = 0; i < 8; i++) { OUT16[i] = TCNT1; GPIOR0 = i; }
          for (;;) {}
        }
    """)
    chip.record_marks(True)
    chip.run_ms(1)
    marks, counts = chip.take_marks(), words(chip, 8)
    assert np.array_equal(np.diff(counts), np.diff(marks["cycle"].astype(int)))


def test_an_interrupt_between_the_two_bytes_of_a_timer_register_corrupts_it(
    program: Programs,
) -> None:
    # The chip's TEMP register is shared: the firmware must not be able to hide such a bug here.
    chip = program("""
        ISR(TIMER3_OVF_vect) { OCR1C = 0x1234; }
        int main(void) {
          TCCR3B = _BV(WGM33) | _BV(WGM32) | _BV(CS30); TCCR3A = _BV(WGM31); ICR3 = 37;
          TIMSK3 = _BV(TOIE3);
          sei();
          for (uint16_t i = 0; i < 2000; i++) { OCR1B = 0xABCD; if (OCR1B != 0xABCD) OUT[0] = 1; }
          for (;;) {}
        }
    """)
    chip.write("ram", OUT, b"\0")
    chip.run_ms(20)
    assert chip.read("ram", OUT, 1) == b"\1"


# --- EEPROM ---------------------------------------------------------------------------------------
WRITE_EEPROM = """
int main(void) {
  for (uint8_t i = 0; i < 4; i++) {
    GPIOR0 = 1;
    eeprom_write_byte((uint8_t*)(100 + i), 0xC0 + i);
    eeprom_busy_wait();
    GPIOR0 = 0;
  }
  for (;;) {}
}
"""


def test_an_eeprom_byte_takes_its_time(program: Programs) -> None:
    chip = program(WRITE_EEPROM)
    chip.record_marks(True)
    chip.run_ms(20)
    marks = chip.take_marks()
    took = marks["cycle"][1::2] - marks["cycle"][::2]
    assert np.all(np.abs(took.astype(int) - 3.4 * CYCLES_PER_MS) < 60)
    assert chip.eeprom[100:104] == bytes([0xC0, 0xC1, 0xC2, 0xC3])


def test_power_cut_in_a_write_tears_that_byte_and_keeps_the_others(program: Programs) -> None:
    chip = program(WRITE_EEPROM)
    chip.eeprom = bytes(4096)
    chip.cut_power_in_write(2)
    chip.run_ms(20)
    assert chip.power_is_cut
    assert chip.eeprom[100:102] == bytes([0xC0, 0xC1])
    assert chip.eeprom[102] not in (0, 0xC2)
    assert chip.eeprom[103] == 0
    chip.reset(Cause.POWER_ON)
    chip.cut_power_in_write(None)
    chip.run_ms(20)
    assert chip.eeprom[100:104] == bytes([0xC0, 0xC1, 0xC2, 0xC3])


def test_a_late_write_enable_is_refused(program: Programs) -> None:
    chip = program("""
        int main(void) {
          EEAR = 7; EEDR = 0x55;
          EECR |= _BV(EEMPE);
          _delay_us(1);
          EECR |= _BV(EEPE);
          for (;;) {}
        }
    """)
    chip.run_ms(10)
    assert chip.eeprom[7] == 0xFF
    assert chip.eeprom_writes == 0


# --- pins, resets, time ---------------------------------------------------------------------------
ENCODER = """
static volatile int32_t count;
static volatile uint8_t last;
static const int8_t kStep[16] = {0, 1, -1, 0, -1, 0, 0, 1, 1, 0, 0, -1, 0, -1, 1, 0};
ISR(INT4_vect) {
  uint8_t now = (PINE >> 4) & 3;
  count += kStep[last << 2 | now];
  last = now;
}
ISR(INT5_vect, ISR_ALIASOF(INT4_vect));
int main(void) {
  last = (PINE >> 4) & 3;
  EICRB = _BV(ISC40) | _BV(ISC50); EIMSK = _BV(INT4) | _BV(INT5);
  sei();
  for (;;) { cli(); int32_t n = count; sei(); *(volatile int32_t*)OUT = n; }
}
"""


def test_encoder_edges_are_scheduled_exactly(program: Programs) -> None:
    chip = program(ENCODER)
    chip.drive_pin("E", 4, False)
    chip.drive_pin("E", 5, False)
    chip.run_ms(1)
    position = 0.0
    for target in (20.0, 41.5, 0.2, -63.7, 7.1):  # up to 105 edges in 5 ms: 21 kHz
        start = chip.cycle
        chip.encoder(("E", 4, 5), position, target, start, start + 5 * CYCLES_PER_MS)
        chip.run_ms(5.1)
        position = target
        got = int.from_bytes(chip.read("ram", OUT, 4), "little", signed=True)
        assert got == np.floor(target)


def test_input_levels_survive_a_reset(program: Programs) -> None:
    chip = program("int main(void) { OUT[0] = PINE; OUT[1] = PINA; for (;;) {} }")
    chip.drive_pin("E", 5, True)
    chip.drive_pin("A", 0, True)
    for cause in (Cause.EXTERNAL, Cause.POWER_ON):
        chip.reset(cause)
        chip.write("ram", OUT, b"\0\0")
        chip.run_ms(1)
        assert chip.read("ram", OUT, 2) == bytes([0x20, 0x01])


def test_a_driven_input_wins_over_the_pull_up(program: Programs) -> None:
    chip = program("int main(void) { PORTA = 3; for (;;) OUT[0] = PINA & 3; }")
    chip.drive_pin("A", 0, False)
    chip.run_ms(1)
    assert chip.read("ram", OUT, 1) == b"\x02"
    chip.drive_pin("A", 0, True)
    chip.run_ms(1)
    assert chip.read("ram", OUT, 1) == b"\x03"


def test_watchdog_restarts_a_hung_program(program: Programs) -> None:
    chip = program("""
        int main(void) {
          OUT[0] = MCUSR; MCUSR = 0; OUT[1]++;
          wdt_enable(WDTO_120MS);
          sei();
          for (;;) wdt_reset();
        }
    """)
    chip.write("ram", OUT, b"\0\0")
    chip.run_ms(500)
    assert chip.read("ram", OUT, 2) == bytes([Cause.POWER_ON, 1])
    chip.hang()
    before = chip.cycle
    while chip.resets(Cause.WATCHDOG) == 0:
        chip.run_ms(1)
    assert (chip.cycle - before) / CYCLES_PER_MS == pytest.approx(128, abs=2)
    chip.run_ms(1)
    assert chip.read("ram", OUT, 2) == bytes([Cause.WATCHDOG, 2])


def test_brown_out_holds_the_chip_until_the_supply_recovers(program: Programs) -> None:
    chip = program("int main(void) { OUT[0] = MCUSR; MCUSR = 0; DDRA = 1; PORTA = 1; for (;;) {} }")
    chip.run_ms(1)
    assert chip.output("A", 0) is True
    chip.supply_mv(2400)
    chip.run_ms(50)
    assert chip.output("A", 0) is None
    chip.supply_mv(5000)
    chip.run_ms(1)
    assert chip.read("ram", OUT, 1) == bytes([Cause.BROWN_OUT])
    assert chip.output("A", 0) is True


@pytest.mark.parametrize("step", [160, 16_000, 12_345])
def test_however_the_time_is_cut_the_run_is_the_same(program: Programs, step: int) -> None:
    def run(cut: int) -> tuple[bytes, list[int], int]:
        chip = program(ECHO)
        chip.run(16_000)
        chip.send(bytes(range(64)))
        while chip.cycle < 100_000:
            chip.run(min(chip.cycle + cut, 100_000))
        data, at = chip.take()
        return data, at.tolist(), chip.interrupt(25).count

    assert run(step) == run(100_000)


def test_noise_is_the_virtual_boards(program: Programs) -> None:
    chip = program(ALL_CHANNELS)
    ideal = np.full(CHANNELS, 500.5)
    sigma = np.where(np.arange(CHANNELS) < 8, 3.0, 0.0)
    chip.analog(ideal, ideal, 0, 1)
    chip.noise(11, sigma)
    chip.record_trace(True)
    chip.run_ms(3)
    counts = chip.take_trace()["count"][:CHANNELS]
    assert len(set(counts[:8].tolist())) > 1
    assert np.all(np.abs(counts[:8].astype(int) - 500) < 19)
    assert counts[8:].tolist() == [500] * 8


def test_a_fed_trace_replaces_the_inputs(program: Programs) -> None:
    chip = program("""
        ISR(TIMER1_COMPA_vect) { ADCSRA |= _BV(ADSC); }
        int main(void) {
          ADMUX = _BV(REFS0) | 2; ADCSRA = _BV(ADEN) | 6;
          OCR1A = 15999; TCCR1B = _BV(WGM12) | _BV(CS10); TIMSK1 = _BV(OCIE1A);
          sei();
          for (;;) {}
        }
    """)
    table = np.full((8, CHANNELS), 0xFFFF, dtype=np.uint16)
    table[:, 2] = 100 + np.arange(8)
    chip.feed_trace(table)
    chip.record_trace(True)
    chip.run_ms(12)
    trace = chip.take_trace()
    fed = trace["tick"] < 8
    assert trace["count"][fed].tolist() == (100 + trace["tick"][fed]).tolist()
    assert set(trace["count"][~fed].tolist()) == {0}
