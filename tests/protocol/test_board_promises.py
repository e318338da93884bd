"""What firmware/README.md has a board promise beside its protocol: time, outputs, watchdog, store.

The cases look at the board's pins, so they run on the simulated boards; on a real port they are
skipped, and the table in firmware/README.md says how a person with a meter sees the same.
"""

from __future__ import annotations

import numpy as np
import pytest
from desk import Desk

from thigmo.emulator.board import EmulatedBoard
from thigmo.link import protocol as wire

LEVEL, DUTY, TEST_MS = 336, 150, 500
# After the last kick. The Mega's watchdog counts 2^15 periods of an oscillator of 128 kHz, 256 ms,
# that is up to a tenth slow.
RESET_MS = (120, 285)
ENABLE_MS = 70  # in which the charge pump of an enable is empty, once its pin stands still
TICKS_LATE = 4
FLEX, PRESSURE = 10, 2  # channels of the usual board


def outputs_off(board: EmulatedBoard) -> bool:
    """Both transducers at exactly 0 mA, and no duty on the motor."""
    return board.drive_enabled == (False, False) and board.drive == (0, 0) and board.motor == 0


def drive_a_valve(desk: Desk) -> EmulatedBoard:
    """The desk's board, whose first transducer carries current for half a second."""
    board = desk.simulated()
    host = desk.ready()
    host.get(wire.TestOutput(wire.Output.TRANSDUCER, 0, LEVEL, TEST_MS))
    board.step(20)
    assert board.drive[0] == LEVEL
    return board


def ms_until_off(board: EmulatedBoard, most: int) -> int:
    """Milliseconds until the outputs are off."""
    for ms in range(most):
        if outputs_off(board):
            return ms
        board.step(1)
    return most


def test_frames_are_complete_at_one_time_of_every_tick(desk: Desk) -> None:
    host = desk.calm()
    host.get(wire.SetParameter(wire.PARAMETERS["telemetry_ms"].index, 5))
    host.get(wire.ApplyParameters())
    stamps = [
        message.t_us
        for frame in host.listen(1.0)
        if isinstance(message := frame.message(), wire.Telemetry)
    ]
    assert len(stamps) > 150
    assert len({stamp % 1000 for stamp in stamps}) == 1
    late = np.diff(stamps).max() / 1000 - 5
    assert late <= TICKS_LATE


def test_counts_are_in_1024_of_the_reference(desk: Desk) -> None:
    board = desk.simulated()
    host = desk.calm()
    counts = np.full((16, 2), 300.0)
    counts[FLEX : FLEX + PRESSURE] = 102.4
    board.set_analog(counts)
    try:
        host.listen(0.3)
        oversampled = 1 << wire.PARAMETERS["oversample_log2"].defaults[0]
        for sensor in range(FLEX):
            assert host.get(wire.GetSensor(sensor)).flex_sum == pytest.approx(
                300 * oversampled, abs=oversampled
            )
    finally:
        counts[:FLEX] = 660.0
        board.set_analog(counts)
        host.listen(0.3)


def test_nothing_is_driven_before_a_host_arms_the_board(desk: Desk) -> None:
    board = desk.simulated()
    desk.calm()
    board.reset(wire.ResetCause.EXTERNAL)
    desk.host.drop_pending()
    for _ in range(1500):
        board.step(1)
        assert outputs_off(board)
        assert board.air == (False, False)
        assert board.motor_enables == (False, False)
    desk.host.hello()


@pytest.mark.parametrize("muscle", [0, 1])
def test_a_transducer_carries_what_is_asked_and_then_exactly_nothing(
    desk: Desk, muscle: int
) -> None:
    board = desk.simulated()
    host = desk.ready()
    host.get(wire.TestOutput(wire.Output.TRANSDUCER, muscle, LEVEL, 100))
    board.step(20)
    assert board.drive[muscle] == LEVEL
    assert board.drive_enabled == (muscle == 0, muscle == 1)
    board.step(120)
    assert outputs_off(board)


@pytest.mark.parametrize("duty", [DUTY, -DUTY])
def test_the_motor_carries_its_duty_and_then_brakes(desk: Desk, duty: int) -> None:
    board = desk.simulated()
    host = desk.ready()
    host.get(wire.TestOutput(wire.Output.MOTOR, 0, duty, 100))
    board.step(50)
    assert board.motor == duty
    board.step(120)
    assert outputs_off(board)
    assert board.braked


def test_a_hung_program_is_reset_in_time_with_its_outputs_off(desk: Desk) -> None:
    board = drive_a_valve(desk)
    board.hang()
    assert ms_until_off(board, 2 * RESET_MS[1]) in range(RESET_MS[0] - 20, RESET_MS[1] + 2)
    for _ in range(2000):
        board.step(1)
        assert outputs_off(board)
    desk.host.drop_pending()
    assert desk.host.hello().reset_cause is wire.ResetCause.WATCHDOG


def test_a_hung_program_releases_the_air_at_once(desk: Desk) -> None:
    board = drive_a_valve(desk)
    assert board.air[0]
    board.hang()
    board.step(ENABLE_MS)
    assert board.air == (False, False)
    assert board.motor_enables == (False, False)
    board.step(2000)
    desk.host.drop_pending()
    desk.host.hello()


def test_enables_follow_the_program(desk: Desk) -> None:
    board = desk.simulated()
    host = desk.calm()
    assert board.air == (False, False)
    host = desk.ready()
    board.step(ENABLE_MS)
    assert board.air[0]
    host.get(wire.Disarm())
    board.step(ENABLE_MS)
    assert board.air == (False, False)


@pytest.mark.parametrize("cause", [wire.ResetCause.EXTERNAL, wire.ResetCause.BROWN_OUT])
def test_a_reset_turns_the_outputs_off_and_keeps_a_stop(desk: Desk, cause: wire.ResetCause) -> None:
    board = drive_a_valve(desk)
    desk.host.stop(0x5AFE)
    desk.host.beating = False  # what comes in while a boot loader waits keeps it waiting
    board.reset(cause)
    desk.host.drop_pending()
    desk.wait_for_boot()
    assert outputs_off(board)
    desk.host.hello()
    report = desk.host.get(wire.GetStatus())
    assert report.faults & wire.Fault.STOPPED.mask
    assert report.stop_nonce == 0x5AFE
    desk.host.get(wire.ClearStop(0x5AFE))


def test_a_watchdog_reset_keeps_a_stop(desk: Desk) -> None:
    board = desk.simulated()
    desk.ready().stop(0x5AFE)
    board.hang()
    board.step(2500)
    desk.host.drop_pending()
    desk.host.hello()
    assert desk.host.get(wire.GetStatus()).stop_nonce == 0x5AFE
    desk.host.get(wire.ClearStop(0x5AFE))


@pytest.mark.parametrize("written", [0, 1, 7, 100, 400])
def test_a_power_cut_while_saving_keeps_one_configuration_whole(desk: Desk, written: int) -> None:
    board = desk.simulated()
    host = desk.calm()
    settle = wire.PARAMETERS["settle_ms"].index
    vent = wire.PARAMETERS["vent_cpsi"].index

    def store(settle_ms: int, vent_cpsi: int) -> None:
        for index, value in ((settle, settle_ms), (vent, vent_cpsi)):
            desk.host.get(wire.SetParameter(index, value))
        desk.host.get(wire.ApplyParameters())

    store(11_000, 41)
    host.save()
    store(12_000, 42)
    board.cut_power_after(written)
    host.seq += 1
    host.send(wire.SaveConfig())
    board.step(8000)
    board.reset(wire.ResetCause.POWER_ON)
    desk.host.drop_pending()
    desk.wait_for_boot()
    desk.host.hello()
    held = tuple(desk.host.get(wire.GetParameter(index)).value for index in (settle, vent))
    assert held in {(11_000, 41), (12_000, 42)}
