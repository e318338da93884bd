"""Sessions for the trigger's study: swept once with the plant, replayed for every setting.

What the trigger's settings are does not change what the sensors see, so the plant runs once a
session and its conversions are kept by tick; the firmware then meets the same conversions on a
virtual board once for each setting, with the same host at the same milliseconds. The simulated Mega
can be fed the same way (tests/sim/mega/test_trigger_on_the_image.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from thigmo.config import SIDES, RobotConfig
from thigmo.emulator._board import VirtualBoard
from thigmo.emulator.board import CHANNELS, FLEX_RIGHT, PRESSURE, Floats
from thigmo.emulator.lockstep import Lockstep
from thigmo.emulator.plant import STEP_MS
from thigmo.emulator.scene import Scene
from thigmo.emulator.transport import EmulatorTransport
from thigmo.link import protocol as wire
from thigmo.link.client import Client
from thigmo.robot.robot import Robot
from thigmo.robot.sweep import rising_period_s
from thigmo.studies.scripted_host import Script, ScriptedHost

BEGIN_MS = 8000  # of the first sweep: by then the sensors are zeroed
HALF_MS = 5500  # one side's rise, vent and rest
RISE_MS = 4050  # vented then: a quarter of the shortest period and half of its peak's readings
_REPLAY_MS = 50  # between exchanges of a replay: what is said, is said at multiples of it
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
    """One side's part of a sweep: the side (0 left), when it starts and is vented, in ms."""

    side: int
    start_ms: int
    vent_ms: int
    # when a contact begins (steps), or the base contact curvature passes the default threshold
    # (pegs); NaN without one
    touch_ms: float = np.nan


@dataclass(frozen=True, slots=True)
class Session:
    """A recorded session."""

    # seed, eeprom: of the board
    seed: int
    eeprom: bytes
    script: Script  # of the host, with the setting left out
    halves: tuple[Half, ...]  # of the sweeps, in order of time; times by the firmware's clock
    # rows of (tick, channel, count) of the channels that the trigger looks at
    conversions: npt.NDArray[np.int64]
    end_ms: int  # how long it takes


class TouchedBoard(VirtualBoard):
    """A virtual board whose base sensors can be bent at once, in the middle of what the plant does.

    Attributes:
        touch: curvature added to what the left and the right base sensor read, 1/cm.
    """

    def __init__(self, seed: int, eeprom: bytes, robot: RobotConfig) -> None:
        super().__init__(seed, eeprom)
        self.touch = [0.0, 0.0]
        self._divider = robot.sensors.divider_ohm
        self._scale = [robot.sensors.column(side)[0].scale_per_ohm for side in SIDES]

    def set_analog(self, counts: Floats) -> None:
        """Ideal counts as the plant says, and the touch on top."""
        if any(self.touch):
            counts = counts.copy()
            for side, channel in enumerate(_BASES):
                ohm = self._divider * (1024.0 / counts[channel] - 1.0)
                ohm += self.touch[side] / self._scale[side]
                counts[channel] = 1024.0 * self._divider / (self._divider + ohm)
        super().set_analog(counts)


def start(board: VirtualBoard) -> None:
    """Run a board that was just made until its firmware has begun; 1 ms of its time is over."""
    while not board.running:
        board.step(1)


@cache
def stored(robot_json: str) -> bytes:
    """The EEPROM of a board that was configured for a robot."""
    robot = RobotConfig.model_validate_json(robot_json)
    scene = Scene.load("default").model_copy(update={"robot": robot, "pegs": []})
    board = VirtualBoard(0)
    transport = EmulatorTransport(scene, board, seed=0)
    Robot(Client(transport)).configure(robot)
    return board.eeprom


def script_of(robot: RobotConfig, length_cm: float, halves: Sequence[Half]) -> Script:
    """Make ready, zero the sensors, and sweep as the default protocol does: up, and vent."""
    zone = robot.body.zone_at(length_cm)
    period_ms = round(rising_period_s(robot, zone) * 1e3)
    says: list[tuple[int, wire.Message]] = [
        (50, wire.SetParameter(wire.PARAMETERS["telemetry_ms"].index, 0)),
        # The study is of the trigger: noise must not keep the zero from being taken.
        (100, wire.SetParameter(wire.PARAMETERS["drift_limit_e5"].index, 10_000)),
        (300, wire.ApplyParameters()),
        (400, wire.ConfirmLength(round(length_cm * 1e4), 1)),
        (400, wire.SelectZone(zone)),
        (450, wire.Arm()),
        (1000, wire.ZeroSensors(_everted(robot, length_cm))),
    ]
    for half in halves:
        top = round(robot.actuators.side(SIDES[half.side]).max_pressure_psi * 100)
        sides = (top, 0) if half.side == 0 else (0, top)
        says += [
            (half.start_ms, wire.Sweep(*sides, period_ms, 1, 0)),
            (half.vent_ms, wire.Vent()),
        ]
    return says


def _everted(robot: RobotConfig, length_cm: float) -> int:
    """Mask of the sensors that are out, with the keep-out around the tip's fold."""
    margin = wire.PARAMETERS["fold_margin_um"].defaults[0] * 1e-4
    mask = 0
    for s, side in enumerate(SIDES):
        for n, sensor in enumerate(robot.sensors.column(side)):
            if sensor.center_cm + sensor.span_cm / 2 + margin <= length_cm:
                mask |= 1 << s * FLEX_RIGHT + n
    return mask


def halves_of(sides: Sequence[int], touches: Sequence[float] | None = None) -> tuple[Half, ...]:
    """Sweeps of these sides one after another; `touches`: ms after each one's start."""
    halves = []
    for n, side in enumerate(sides):
        at = BEGIN_MS + n * HALF_MS
        touch = np.nan if touches is None else at + touches[n]
        halves.append(Half(side, at, at + RISE_MS, touch))
    return tuple(halves)


def record(
    scene: Scene, seed: int, halves: Sequence[Half], *, step: float = 0.0, threshold: float
) -> Session:
    """Sweep with the plant.

    Args:
        scene: robot, room and noise; sweeps are at its `start_length_cm`.
        seed: of all noise.
        halves: of the sweeps.
        step: contact curvature (1/cm) that holds the base back from each half's `touch_ms` until
            its vent; 0: what the room's pegs do, and `touch_ms` becomes the first moment at which
            they pass the threshold.
        threshold: 1/cm.
    """
    eeprom = stored(scene.believed(seed).model_dump_json())
    board = TouchedBoard(seed, eeprom, scene.robot)
    start(board)
    board.record_trace(True)
    lockstep = Lockstep(scene, board, seed=seed)
    script = script_of(scene.robot, scene.start_length_cm, halves)
    host = ScriptedHost(board, script)
    end_ms = halves[-1].start_ms + HALF_MS
    excess = np.zeros(end_ms // STEP_MS + 1)
    while host.t_ms < end_ms:
        now, host_side = host.t_ms, 1
        board.touch = [0.0, 0.0]
        for half in halves:
            if half.start_ms <= now < half.vent_ms:
                host_side = 1 if half.side == 0 else -1  # sign of the free curvature
                if step and now >= half.touch_ms:
                    # The side that is not inflated counts; a contact takes curvature from the bend.
                    board.touch[1 - half.side] = -host_side * step
        host.exchange()
        lockstep.advance()
        plant = lockstep.plant
        base = plant.sensor_curvature[_BASES[1] if host_side > 0 else _BASES[0]]
        excess[host.t_ms // STEP_MS] = host_side * (plant.free_curvature - base)
    if not step:
        halves = [_passed(half, excess, threshold) for half in halves]
    # By the firmware's clock, 1 ms of which was over when the host began.
    timed = tuple(Half(h.side, h.start_ms + 1, h.vent_ms + 1, h.touch_ms + 1) for h in halves)
    trace = board.recorded_trace()
    return Session(seed, eeprom, script, timed, trace[np.isin(trace[:, 1], _LOOKED_AT)], end_ms)


def _passed(half: Half, excess: Floats, threshold: float) -> Half:
    """The half with the moment at which the true contact curvature first passes the threshold."""
    first, last = half.start_ms // STEP_MS, half.vent_ms // STEP_MS
    over = np.flatnonzero(excess[first : last + 1] >= threshold)
    if not len(over) or over[0] == 0:
        return half._replace(touch_ms=np.nan)
    after = first + int(over[0])
    part = (threshold - excess[after - 1]) / (excess[after] - excess[after - 1])
    return half._replace(touch_ms=(after - 1 + part) * STEP_MS)


def with_setting(script: Script, setting: Setting) -> Script:
    """The script of a session with the trigger's parameters set first."""
    names = ("trigger_filter_log2", "trigger_debounce_ms", "trigger_e5")
    first = [
        (150 + 50 * n, wire.SetParameter(wire.PARAMETERS[name].index, value))
        for n, (name, value) in enumerate(zip(names, setting, strict=True))
    ]
    return sorted([*script, *first], key=lambda said: said[0])


def replay(session: Session, setting: Setting) -> Floats:
    """The contacts that the firmware reports with a setting: ms by its own clock."""
    board = VirtualBoard(session.seed, session.eeprom)
    board.feed_trace(session.conversions)
    board.set_analog(OTHERS)
    start(board)
    host = ScriptedHost(board, with_setting(session.script, setting), _REPLAY_MS)
    while host.t_ms < session.end_ms:
        host.exchange()
        board.step(_REPLAY_MS)
    return contacts(host)


def contacts(host: ScriptedHost) -> Floats:
    """Times of the contacts reported since the sensors were zeroed, ms by the board's clock.

    Raises:
        RuntimeError: they were not zeroed; the session is worth nothing.
    """
    if not any(event.code is wire.EventCode.ZEROED for event in host.events):
        raise RuntimeError("the sensors were not zeroed")
    times = [e.t_us / 1e3 for e in host.events if e.code is wire.EventCode.CONTACT]
    return np.array(times)


def false_alarms(session: Session, times: Floats) -> int:
    """Sides swept with a contact reported before the vent, in a session in which nothing touches.

    What the swing after a vent reports does not count: no host takes it for a contact of the sweep.
    """
    return sum(bool(np.any((times >= h.start_ms) & (times < h.vent_ms))) for h in session.halves)


def latencies(session: Session, times: Floats) -> Floats:
    """From each touch to its report, ms: one value a half with a touch.

    Infinite when it was not reported before the vent; negative when the trigger, which fires once
    a half, fired before.
    """
    found = []
    for half in (half for half in session.halves if not np.isnan(half.touch_ms)):
        inside = times[(times >= half.start_ms) & (times < half.vent_ms)]
        found.append(inside[0] - half.touch_ms if len(inside) else np.inf)
    return np.array(found)
