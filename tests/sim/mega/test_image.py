"""The real image on the simulated chip: its pins, its timing, its memory."""

from __future__ import annotations

import subprocess
from itertools import pairwise

import numpy as np
import pytest
from rig import open_rig

from thigmo.emulator.chip import CYCLES_PER_MS, SRAM_END
from thigmo.emulator.mega_build import firmware_elf
from thigmo.emulator.mega_sim import DRIVES, MOTOR_PWM, SimulatedMega
from thigmo.emulator.scene import Scene
from thigmo.link import protocol as wire
from thigmo.link.framing import encode

EVEN = [10, 11, 0, 5, 1, 2, 3, 4]
ODD = [10, 11, 0, 5, 6, 7, 8, 9]


def test_nothing_moves_from_reset_to_the_first_command() -> None:
    mega = SimulatedMega(2)
    for _ in range(1200):
        mega.step(1)
        assert mega.drive == (0, 0)
        assert mega.drive_enabled == (False, False)
        assert mega.braked
    assert mega.running
    start_ms = mega.chip.tick_origin / CYCLES_PER_MS
    assert 840 < start_ms < 840 + 300, "the boot loader's second, and the check of the whole image"


def test_sampling_instants_are_exact_whatever_else_happens() -> None:
    # Bytes both ways at the full rate, and the encoder at 3150 edges a second.
    mega = SimulatedMega(2, boot_loader=False)
    mega.set_encoder(0.0, 0.0)
    mega.run_to_tick()
    mega.step(50)
    mega.record_trace(True)
    place = 0.0
    for number in range(300):
        mega.set_encoder(place, place + 3.15)
        place += 3.15
        mega.write(encode(wire.Heartbeat(number + 1), 0, 1) * 2)
        mega.step(1)
    trace = mega.chip.take_trace()
    trace = trace[trace["tick"] < trace["tick"].max()]
    slots = trace[trace["channel"] < 16]
    slots = slots[slots["tick"] > slots["tick"][0]]
    wanted = [c for t in np.unique(slots["tick"]) for c in (ODD if t % 2 else EVEN)]
    assert slots["channel"].tolist() == wanted
    place_in_tick = (slots["sampled"] - mega.chip.tick_origin) % CYCLES_PER_MS
    assert np.array_equal(
        place_in_tick.reshape(-1, 8), np.tile(np.arange(8) * 1664 + 192, (len(slots) // 8, 1))
    )
    assert mega.chip.lost_triggers == 0
    assert mega.chip.line_overruns == 0


def test_interrupts_are_short() -> None:
    mega = SimulatedMega(2, boot_loader=False)
    mega.set_encoder(0.0, 0.0)
    mega.run_to_tick()
    mega.step(17)
    mega.chip.measure_again()
    for number in range(200):
        mega.set_encoder(number * 3.0, number * 3.0 + 3.0)
        mega.write(encode(wire.Heartbeat(number + 1), 0, 1))
        mega.step(1)
    used = {v: f for v in range(1, 57) if (f := mega.chip.interrupt(v)).count}
    assert set(used) == {5, 6, 17, 19, 25, 26}
    for vector, figures in used.items():
        assert figures.longest <= 320, f"vector {vector} takes more than 20 us"


def test_pwm_stops_before_the_direction_changes(full_length: Scene, stored_config: bytes) -> None:
    rig = open_rig(full_length, stored_config)
    rig.prepare()
    mega, chip = rig.board, rig.board.chip
    samples: list[tuple[int, bool]] = []
    run = chip.run

    def finely(cycle: int) -> bool:
        while chip.cycle < cycle:
            run(min(chip.cycle + 160, cycle))  # 10 us
            samples.append((mega.direction, chip.pwm(4).connected[0]))
        return True

    chip.run = finely  # type: ignore[method-assign]
    rig.robot.grow_to(52.0)
    rig.robot.retract_to(51.7)
    directions = [d for d, _ in samples]
    assert {1, -1} <= set(directions)
    for before, after in pairwise(samples):
        if before[0] != after[0]:
            assert not before[1], "the motor was driven when DIR changed"


def test_a_vented_valve_is_disconnected_not_at_duty_zero(
    full_length: Scene, stored_config: bytes
) -> None:
    rig = open_rig(full_length, stored_config)
    rig.prepare()
    rig.client.request(wire.SetPressure((800, 0), 0))
    rig.robot.wait(1.0)
    pwm = rig.board.chip.pwm(5)
    assert pwm.top == 1599
    assert pwm.period_cycles == 1600
    assert pwm.connected[:] == [True, False, False]
    assert rig.board.drive[0] > 300
    rig.robot.vent()
    assert rig.board.chip.pwm(5).connected[:] == [False, False, False]
    for port, bit in (*DRIVES, MOTOR_PWM):
        assert rig.board.chip.output(port, bit) is False


def test_the_emergency_stop_acts_within_two_ticks(full_length: Scene, stored_config: bytes) -> None:
    rig = open_rig(full_length, stored_config)
    rig.prepare()
    rig.client.request(wire.SetPressure((800, 0), 0))
    rig.robot.wait(1.0)
    assert rig.board.drive_enabled[0]
    rig.board.set_estop(True)
    for _ in range(12):  # debounced
        rig.board.step(1)
    assert rig.off
    rig.pass_ms(50)
    assert "estop" in rig.robot.status().faults


def test_the_restart_record_survives_boot_loader_and_start_up() -> None:
    listing = subprocess.run(
        ["avr-nm", "-S", str(firmware_elf())], capture_output=True, text=True, check=True
    ).stdout
    (record,) = (line.split() for line in listing.splitlines() if "restart_record" in line)
    start, size = int(record[0], 16) & 0xFFFF, int(record[1], 16)
    assert start > 0x20D, "the boot loader's variables"
    assert start + size <= SRAM_END + 1 - 400, "the boot loader's stack"


@pytest.mark.parametrize("counts", [3150.0, -3150.0])
def test_every_encoder_edge_is_counted_at_full_speed(
    full_length: Scene, stored_config: bytes, counts: float
) -> None:
    # Free turning with the motor off is a slip; what matters here is that the length is exact.
    rig = open_rig(full_length, stored_config)
    rig.robot.wait(0.2)
    start = rig.robot.status()
    assert start.length_cm is None
    mega = rig.board
    place = 0.5
    mega.set_encoder(place, place)
    before = encoder(mega)
    for _ in range(400):
        mega.set_encoder(place, place + counts / 1000)
        place += counts / 1000
        mega.step(1)
    assert encoder(mega) - before == int(np.floor(place))


def test_transitions_that_no_encoder_makes_are_counted_and_no_others(
    full_length: Scene, stored_config: bytes
) -> None:
    rig = open_rig(full_length, stored_config)
    mega = rig.board
    place = 0.0
    for step, errors in ((3.0, False), (400.0, True)):  # 3 kHz, and more than the interrupt takes
        for _ in range(20):
            mega.set_encoder(place, place + step)
            place += step
            mega.step(1)
        rig.client.poll(0.1)
        assert (rig.client.request(wire.GetStatus()).encoder_errors > 0) == errors


def encoder(mega: SimulatedMega) -> int:
    """The interrupt routine's count."""
    listing = subprocess.run(
        ["avr-nm", "-C", str(firmware_elf())], capture_output=True, text=True, check=True
    ).stdout
    (address,) = (
        int(line.split()[0], 16) & 0xFFFF
        for line in listing.splitlines()
        if line.endswith("Encoder::count_")
    )
    return int.from_bytes(mega.chip.read("ram", address, 2), "little", signed=True)
