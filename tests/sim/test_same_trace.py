"""One firmware, four machines: fed the same conversions, edges and bytes, they say the same bytes.

A session on the emulator (confirm, arm, grow, zero, sweep) is recorded at the virtual board's
edge: conversions by (tick, channel, count), encoder positions, bytes of the host. Replayed into a
virtual board, into the simulated Mega, whose image another compiler made for another processor,
and into MicroPython on this machine and on a Cortex-M3, it must bring the same telemetry, byte for
byte, and the same answers. A finer converter with another frame time is a second profile.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from thigmo.emulator import mega_build
from thigmo.emulator._board import VirtualBoard
from thigmo.emulator.mega_sim import ENCODER, SimulatedMega
from thigmo.emulator.micropython import MicroPythonBoard, Processor
from thigmo.emulator.micropython_build import missing
from thigmo.emulator.scene import Scene
from thigmo.emulator.transport import EmulatorTransport
from thigmo.link.client import Client
from thigmo.link.framing import Decoder
from thigmo.robot.robot import Robot

Trace = npt.NDArray[np.int64]
BOOT_MS = 840  # the boot loader's, on the virtual board


@pytest.fixture(scope="module")
def mega_simulator() -> None:
    if reason := mega_build.missing():
        pytest.skip(f"simulated Mega: {reason}")


@dataclass
class Step:
    """10 ms at the board's edge."""

    sent: bytes
    encoder: list[float]  # position in each millisecond


class Recorder:
    """A virtual board that keeps what it is sent."""

    def __init__(self, board: VirtualBoard) -> None:
        self.board = board
        self.steps: list[Step] = []
        self._sent = b""
        self._encoder = (0.0, 0.0)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.board, name)

    def write(self, data: bytes) -> None:
        self._sent += data
        self.board.write(data)

    def set_encoder(self, start: float, end: float) -> None:
        self._encoder = (start, end)
        self.board.set_encoder(start, end)

    def step(self, ticks: int) -> None:
        start, end = self._encoder
        if self.board.now_us >= BOOT_MS * 1000:
            moved = [start + (end - start) * (i + 0.5) / ticks for i in range(ticks)]
            self.steps.append(Step(self._sent, moved))
        self._sent = b""
        self.board.step(ticks)


MEGA = (10, 832)  # converter bits, frame time in us
FINE = (12, 320)  # two MCP3208


def session(scene: Scene, store: bytes, profile: tuple[int, int]) -> tuple[list[Step], Trace]:
    """A session's steps and conversions."""
    board = Recorder(VirtualBoard(5, store, *profile))
    board.record_trace(True)
    robot = Robot(Client(EmulatorTransport(scene, board, seed=5)))
    robot.wait(0.3)
    robot.set_parameter("drift_limit_e5", [5000])
    robot.set_parameter("zero_ms", [200])
    robot.confirm_length(51.5, settled=True)
    robot.select_body_pressure(2)
    robot.arm()
    robot.grow_to(53.0)
    robot.confirm_length(53.0, settled=True)
    robot.zero()
    robot.sweep({"left": 15.0, "right": 9.0}, period_s=3.0)
    robot.disarm()
    return board.steps, board.recorded_trace()


@pytest.fixture(scope="module")
def recorded(stored_config: bytes, full_length: Scene) -> tuple[list[Step], Trace]:
    return session(full_length, stored_config, MEGA)


def replay(board: VirtualBoard | MicroPythonBoard, steps: list[Step], trace: Trace) -> bytes:
    """What a board says to a recorded session."""
    board.feed_trace(trace)
    board.step(BOOT_MS)
    for step in steps:
        board.write(step.sent)
        for place in step.encoder:
            board.set_encoder(place, place)
            board.step(1)
    return board.read()


def replay_mega(mega: SimulatedMega, steps: list[Step], trace: Trace) -> bytes:
    mega.feed_trace(trace)
    before = steps[0].encoder[0]
    mega.set_encoder(before, before)
    mega.run_to_tick()
    for step in steps:
        mega.write(step.sent)
        for place in step.encoder:
            now = mega.chip.cycle  # edges well before the control step looks
            mega.chip.encoder(ENCODER, before, place, now, now + 4000)
            before = place
            mega.step(1)
    return mega.read()


def messages(stream: bytes) -> dict[str, list[bytes]]:
    """Payloads by kind of message, in order."""
    kinds: dict[str, list[bytes]] = {}
    for frame in Decoder().feed(stream):
        name = type(frame.message()).__name__
        kinds.setdefault(name, []).append(bytes(frame.payload))
    return kinds


def assert_same(said: bytes, reference: bytes) -> None:
    """Two boards said the same, but for what their own clocks measure."""
    board, virtual = messages(said), messages(reference)
    # By device time: a frame may be dropped for want of room on the line, or cut off at the end.
    board_rows, virtual_rows = (
        {p[:4]: p for p in trace["Telemetry"]} for trace in (board, virtual)
    )
    assert len(virtual_rows) > 1000
    assert len(virtual_rows.keys() ^ board_rows.keys()) <= 3
    assert all(
        virtual_rows[time] == board_rows[time] for time in virtual_rows.keys() & board_rows.keys()
    )
    # Not the status report: one of its bits says whether the line dropped telemetry.
    for name in ("Ack", "Event", "Snapshot", "SensorReport", "ParameterValue"):
        assert board.get(name, []) == virtual.get(name, []), name


def micropython(on: Processor, store: bytes, profile: tuple[int, int]) -> MicroPythonBoard:
    if reason := missing(on):
        pytest.skip(reason)
    return MicroPythonBoard(5, store, processor=on, adc_bits=profile[0], frame_us=profile[1])


def test_the_image_of_the_mega_says_the_same_byte_for_byte(
    mega_simulator: None, stored_config: bytes, recorded: tuple[list[Step], Trace]
) -> None:
    steps, trace = recorded
    said = replay_mega(SimulatedMega(5, stored_config), steps, trace)
    assert_same(said, replay(VirtualBoard(5, stored_config), steps, trace))


@pytest.mark.parametrize("on", ["unix", "cortex-m3"])
@pytest.mark.parametrize("profile", [MEGA, FINE], ids=["mega", "fine"])
def test_micropython_says_the_same_byte_for_byte(
    on: Processor, profile: tuple[int, int], stored_config: bytes, full_length: Scene
) -> None:
    board = micropython(on, stored_config, profile)
    steps, trace = session(full_length, stored_config, profile)
    reference = replay(VirtualBoard(5, stored_config, *profile), steps, trace)
    said = replay(board, steps, trace)
    assert_same(said, reference)
    # Their passes and lines are the virtual board's as well: nothing is dropped, nothing is later.
    assert messages(said)["Telemetry"] == messages(reference)["Telemetry"]


def test_the_simulated_mega_repeats_itself(
    mega_simulator: None, stored_config: bytes, recorded: tuple[list[Step], Trace]
) -> None:
    steps, trace = recorded
    first, again = (
        replay_mega(SimulatedMega(5, stored_config), steps[:150], trace) for _ in range(2)
    )
    assert len(first) > 5000
    assert first == again
