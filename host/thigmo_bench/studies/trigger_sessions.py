"""Sessions for the trigger's study: swept once with the plant, replayed for every setting.

The trigger's settings do not change the sensors' signals, so the plant runs once for each session,
and its conversions are stored by tick. The firmware then gets the same conversions on a virtual
board for each setting, with the same host commands at the same milliseconds. The host is a script,
because the full client waits for answers. The simulated Mega can be driven in the same way
(tests/sim/mega/test_trigger_on_the_image.py).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from thigmo.config import SIDES, RobotConfig
from thigmo.emulator._board import VirtualBoard
from thigmo.emulator.board import CHANNELS, FLEX_RIGHT, PRESSURE, EmulatedBoard, Floats
from thigmo.emulator.lockstep import Lockstep
from thigmo.emulator.plant import STEP_MS
from thigmo.emulator.scene import Scene
from thigmo.emulator.transport import EmulatorTransport
from thigmo.link import protocol as wire
from thigmo.link.client import Client
from thigmo.link.framing import Decoder, encode
from thigmo.link.heartbeat import HeartbeatSource
from thigmo.robot.robot import Robot
from thigmo.robot.sweep import rising_period_s

Script = Sequence[tuple[int, wire.Message]]
"""Commands with the milliseconds at which they are sent, from 100 on, in order of time."""

_RISE_MS = 4050  # vented then: a quarter of the shortest period and half of its peak's readings
_HELLO_MS = 50
_BEGIN_MS = 8000  # of the first sweep: by then the sensors are zeroed
_HALF_MS = 5500  # one side's rise, vent and rest
_REPLAY_MS = 50  # between exchanges of a replay; commands are sent at multiples of it
_BASES = (0, FLEX_RIGHT)
_LOOKED_AT = (*_BASES, PRESSURE, PRESSURE + 1)
OTHERS = np.full((CHANNELS, 2), 600.0)
"""Ideal counts for the channels that are not replayed: healthy sensors."""


class Setting(NamedTuple):
    """The board's parameters `trigger_filter_log2`, `trigger_debounce_ms` and `trigger_e5`."""

    filter_log2: int
    debounce_ms: int
    threshold_e5: int


class Half(NamedTuple):
    """One side's part of a sweep: the muscle's output, and when it starts."""

    side: int
    start_ms: int
    # when a contact begins (steps), or the base contact curvature passes the default threshold
    # (pegs); NaN without one
    touch_ms: float = np.nan

    @property
    def vent_ms(self) -> int:
        """Time of the vent, ms."""
        return self.start_ms + _RISE_MS


@dataclass(frozen=True, slots=True)
class Session:
    """A recorded session."""

    # seed, eeprom: of the board
    seed: int
    eeprom: bytes
    script: Script  # of the host, with the setting omitted
    halves: tuple[Half, ...]  # of the sweeps, in order of time; times by the firmware's clock
    # rows of (tick, channel, count) of the channels that the trigger looks at
    conversions: npt.NDArray[np.int64]
    end_ms: int  # how long it takes


class TouchedBoard(VirtualBoard):
    """A virtual board whose base sensors can be bent at once, whatever the plant does."""

    def __init__(self, seed: int, eeprom: bytes, robot: RobotConfig) -> None:
        super().__init__(seed, eeprom)
        self.touch = [0.0, 0.0]  # 1/cm, added to what the two base sensors read
        self._divider = robot.board.divider_ohm
        self._scale = [robot.column(side)[0].raw_scale for side in SIDES]

    def set_analog(self, counts: Floats) -> None:
        """Ideal counts as the plant says, and the touch on top."""
        counts = counts.copy()
        for channel, touch, scale in zip(_BASES, self.touch, self._scale, strict=True):
            if touch:
                ohm = self._divider * (1024.0 / counts[channel] - 1.0) + touch / scale
                counts[channel] = 1024.0 * self._divider / (self._divider + ohm)
        super().set_analog(counts)


def _start(board: VirtualBoard) -> None:
    """Run a board that was just made until its firmware has begun; 1 ms of its time is over."""
    while not board.running:
        board.step(1)


@cache
def _stored(robot_json: str) -> bytes:
    """The EEPROM of a board that was configured for a robot."""
    robot = RobotConfig.model_validate_json(robot_json)
    scene = Scene.load("default").model_copy(update={"robot": robot, "pegs": []})
    board = VirtualBoard(0)
    Robot(Client(EmulatorTransport(scene, board, seed=0))).configure(robot)
    return board.eeprom


def converse(
    board: EmulatedBoard,
    script: Script,
    end_ms: int,
    advance: Callable[[int], None],
    step_ms: int = STEP_MS,
) -> Floats:
    """Send a script to a board that has just started, with heartbeats and acknowledged events.

    `advance` runs the board by `step_ms` after each exchange; its argument is the time (ms) since
    the first. Returns the times of the contacts that the board reports, ms by its own clock.

    Raises:
        RuntimeError: a command was refused, or the sensors were not zeroed, so that the session is
            useless.
    """
    decoder, waiting, heartbeat = Decoder(), deque(script), None
    sent: list[wire.Message] = []
    events: list[wire.Event] = []

    def send(message: wire.Message) -> None:
        assert heartbeat is not None
        sent.append(message)
        board.write(encode(message, len(sent), heartbeat.session))

    for now_ms in range(0, end_ms, step_ms):
        for frame in decoder.feed(board.read()):
            message = frame.message()
            if isinstance(message, wire.HelloReply):
                heartbeat = HeartbeatSource(message.session)
            elif isinstance(message, wire.Ack) and message.status is wire.Status.REFUSED:
                raise RuntimeError(f"{sent[frame.seq - 1]} was refused: {message.reason.key}")
            elif isinstance(message, wire.Event):
                if not events or events[-1].number != message.number:
                    events.append(message)
                send(wire.AckEvent(message.number))
        if now_ms == _HELLO_MS:
            board.write(encode(wire.Hello(wire.PROTOCOL, wire.SCHEMA_HASH, 1), 0, 0))
        if heartbeat is not None:
            while waiting and waiting[0][0] <= now_ms:
                send(waiting.popleft()[1])
            board.write(heartbeat.beat(now_ms / 1000) or b"")
        advance(now_ms)
    if not any(event.code is wire.EventCode.ZEROED for event in events):
        raise RuntimeError("the sensors were not zeroed")
    return np.array([e.t_us / 1e3 for e in events if e.code is wire.EventCode.CONTACT])


def _script_of(robot: RobotConfig, length_cm: float, halves: Sequence[Half]) -> Script:
    """Make ready, zero the sensors, and sweep as the default protocol does: up, and vent."""
    body_pressure = robot.body.pressure_number(length_cm)
    period_ms = round(rising_period_s(robot, body_pressure) * 1e3)
    # With the keep-out around the tip's fold.
    reach = length_cm - wire.PARAMETERS["fold_margin_um"].defaults[0] * 1e-4
    everted = sum(
        1 << s * FLEX_RIGHT + n
        for s, side in enumerate(SIDES)
        for n, sensor in enumerate(robot.column(side))
        if sensor.center_cm + sensor.span_cm / 2 <= reach
    )
    says: list[tuple[int, wire.Message]] = [
        (50, wire.SetParameter(wire.PARAMETERS["telemetry_ms"].index, 0)),
        # Only the trigger is studied, so noise must not prevent the zero.
        (100, wire.SetParameter(wire.PARAMETERS["drift_limit_e5"].index, 10_000)),
        (300, wire.ApplyParameters()),
        (400, wire.ConfirmLength(round(length_cm * 1e4), 1)),
        (400, wire.SelectZone(body_pressure)),
        (450, wire.Arm()),
        (1000, wire.ZeroSensors(everted)),
    ]
    for half in halves:
        top = round(robot.muscle(SIDES[half.side]).max_pressure_psi * 100)
        muscles = (top, 0) if half.side == 0 else (0, top)
        says.append((half.start_ms, wire.Sweep(muscles, period_ms, 1, 0)))
        says.append((half.vent_ms, wire.Vent()))
    return says


def halves_of(sides: Sequence[int], touches: Sequence[float] = ()) -> tuple[Half, ...]:
    """Sweeps of these sides one after another; `touches`: ms after each one's start."""
    starts = [_BEGIN_MS + n * _HALF_MS for n in range(len(sides))]
    return tuple(map(Half, sides, starts, np.add(starts, touches or np.nan).tolist()))


def record(
    scene: Scene, seed: int, halves: Sequence[Half], *, step: float = 0.0, threshold: float
) -> Session:
    """Sweep with the plant, at the scene's `start_length_cm`.

    A `step` of contact curvature (1/cm) holds the base back from each half's `touch_ms` until its
    vent. Without one the room's pegs do, and `touch_ms` becomes the first moment at which they
    pass the threshold (1/cm).
    """
    eeprom = _stored(scene.believed(seed).model_dump_json(by_alias=True))
    board = TouchedBoard(seed, eeprom, scene.robot)
    lockstep = Lockstep(scene, board, seed=seed)
    board.set_encoder(*lockstep.plant.encoder)  # a jump from 0 later would be a slip
    _start(board)
    board.record_trace(True)
    script = _script_of(scene.robot, scene.start_length_cm, halves)
    end_ms = halves[-1].start_ms + _HALF_MS
    excess = np.zeros(end_ms // STEP_MS + 1)  # contact curvature at the base of the inactive side

    def advance(now_ms: int) -> None:
        inactive, bend = FLEX_RIGHT, 1  # sign of the free curvature
        board.touch = [0.0, 0.0]
        for half in halves:
            if half.start_ms <= now_ms < half.vent_ms:
                inactive, bend = _BASES[1 - half.side], 1 - 2 * half.side
                if step and now_ms >= half.touch_ms:
                    board.touch[1 - half.side] = -bend * step  # a contact takes from the bend
        lockstep.advance()
        plant = lockstep.plant
        base = plant.sensor_curvature[inactive]
        excess[now_ms // STEP_MS + 1] = bend * (plant.free_curvature - base)

    converse(board, script, end_ms, advance)
    # By the firmware's clock, which had run for 1 ms when the host began.
    timed = tuple(
        Half(
            h.side, h.start_ms + 1, (h.touch_ms if step else _crossing_ms(h, excess, threshold)) + 1
        )
        for h in halves
    )
    trace = board.recorded_trace()
    return Session(seed, eeprom, script, timed, trace[np.isin(trace[:, 1], _LOOKED_AT)], end_ms)


def _crossing_ms(half: Half, excess: Floats, threshold: float) -> float:
    """When the true contact curvature of a half first passes the threshold (ms), or NaN."""
    first, last = half.start_ms // STEP_MS, half.vent_ms // STEP_MS
    detected = np.flatnonzero(excess[first : last + 1] >= threshold)
    if not len(detected) or detected[0] == 0:
        return np.nan
    index = first + int(detected[0])
    part = (threshold - excess[index - 1]) / (excess[index] - excess[index - 1])
    return float(index - 1 + part) * STEP_MS


def with_setting(script: Script, setting: Setting) -> Script:
    """The script of a session with the trigger's parameters set first."""
    first = [
        (150 + 50 * n, wire.SetParameter(wire.PARAMETERS[f"trigger_{name}"].index, value))
        for n, (name, value) in enumerate(
            zip(("filter_log2", "debounce_ms", "e5"), setting, strict=True)
        )
    ]
    return sorted([*script, *first], key=lambda entry: entry[0])


def replay(session: Session, setting: Setting) -> Floats:
    """The contacts that the firmware reports with a setting: ms by its own clock."""
    board = VirtualBoard(session.seed, session.eeprom)
    board.feed_trace(session.conversions)
    board.set_analog(OTHERS)
    _start(board)
    script = with_setting(session.script, setting)
    return converse(
        board, script, session.end_ms, lambda now_ms: board.step(_REPLAY_MS), _REPLAY_MS
    )


def _inside(half: Half, times: Floats) -> Floats:
    """Contacts reported before the vent; a host ignores the swing after it."""
    return times[(times >= half.start_ms) & (times < half.vent_ms)]


def false_alarms(session: Session, times: Floats) -> int:
    """Sides swept with a contact reported, in a session in which nothing touches."""
    return sum(len(_inside(half, times)) > 0 for half in session.halves)


def latencies(session: Session, times: Floats) -> Floats:
    """From each touch to its report, ms: one value a half with a touch.

    Infinite when it was not reported before the vent; negative when the trigger, which fires once
    a half, fired before.
    """
    touched = [half for half in session.halves if not np.isnan(half.touch_ms)]
    return np.array([min(_inside(half, times), default=np.inf) - half.touch_ms for half in touched])
