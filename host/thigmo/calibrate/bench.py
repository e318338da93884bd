"""A robot on the calibration bench: brings it to a state, reads it, and stores the readings.

`growth_rows`, `bend_rows`, `lean_rows`, `tip_rows` and `bow_rows` take the rows that the steps are
fitted to. Each plans its rows, skips those that the folder already holds, and stores each row at
once, so that a command that was stopped continues where it was.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol, TypeVar, cast

import numpy as np

from thigmo.calibrate.columns import Array, places_of
from thigmo.calibrate.drive import Drive
from thigmo.calibrate.overhead import OverheadCamera
from thigmo.calibrate.session import Session
from thigmo.calibrate.verdict import StepResult
from thigmo.camera.exceptions import CameraError, CameraMovedError
from thigmo.config import SAME_LENGTH_CM, SIDES, Muscle, RobotConfig
from thigmo.errors import DataError
from thigmo.link import protocol as wire
from thigmo.mechanics import push_tip
from thigmo.operator_prompts import Operator
from thigmo.robot import Reading, Robot, zero_when_steady
from thigmo.robot.state import Recording
from thigmo.wiring import Wiring

Row = dict[str, Any]
T = TypeVar("T")

STEADY_S = 2.5  # from a new set point to a bend at rest: lag, swing and margin
READ_S = 1.0
_TRIES = 3
_REPORT_EVERY = 10  # of the rows of a procedure, so that the messages between them are seen
_QUIET_S = 5.0  # after venting, and after readings that drift, before zeros are taken
_UNSEEN: Row = {"unseen": True}
_PUSHES = 3  # attempts at one place if the tip goes to the other side
# Moments of the pushes of the base step, over that which folds the base.
DEEPEST_LEAN, _LESSER_LEAN = 0.85, 0.45
_ASIDE_CM = 1.0  # a tip nearer to the straight robot is on neither side
# Slow, because an overshoot would switch the muscle to its other branch.
_RAMP_PSI_S = 1.0
_ENCODER_MARGIN = "speed_margin_duty"  # at its highest value the board does not check the encoder


@dataclass
class Plan:
    """How many rows each step takes, and how long it watches."""

    places: int = 10  # tip places of the flex step
    # pictures of the tip pushed far aside, for the stiffness step. By camera, one determines the
    # ratio to 0.15..0.35; with the flex step's ten places, these determine it to 0.05..0.1.
    pictures: int = 12
    leans: int = 8  # pushes of the base step
    straight: int = 3  # straight rows of the flex step
    trials: int = 3  # trials of free bends
    step_psi: float = 2.0  # step of the muscle pressure
    pushes: int = 5  # hard pushes of the buckling step
    rest_readings: int = 40  # readings of the noise step
    creep_s: float = 30.0  # time for which creep is watched after each eversion
    # Numbers of the body pressures whose maps are measured; None = all.
    body_pressures: tuple[int, ...] | None = None


def grow_to(
    robot: Robot,
    config: RobotConfig,
    length_cm: float,
    say: Callable[[str], None],
    at_stop: Callable[[float], None] | None = None,
    *,
    spacing_cm: float | None = None,
) -> None:
    """Grow to a length, stop by stop, with the body pressure of each length.

    `at_stop` is called with the length at each multiple of the spacing (None: the pitch) and at the
    end. Raises DataError if the robot is longer already: this never retracts.
    """
    grown_cm, body = robot.known_length_cm(), config.body
    if grown_cm > length_cm + SAME_LENGTH_CM:
        raise DataError(
            f"the robot is {grown_cm:.1f} cm long, {length_cm:.1f} cm are needed",
            "retract it with `thigmo retract`, then run this again",
        )
    stops = _stops_cm(spacing_cm or body.pitch_cm, length_cm)
    boundaries = {p.until_cm for p in body.pressures if p.until_cm < length_cm}
    robot.vent()
    for stop in sorted(stops | boundaries):
        if stop <= grown_cm + SAME_LENGTH_CM:
            continue
        robot.pressurize(body.pressure_number(min(grown_cm + SAME_LENGTH_CM, stop)))
        say(f"growing to {stop:.1f} cm")
        robot.grow_to(stop)
        grown_cm = stop
        if at_stop is not None and stop in stops:
            at_stop(stop)


def _stops_cm(spacing_cm: float, length_cm: float) -> set[float]:
    return {*np.arange(spacing_cm, length_cm, spacing_cm).tolist(), length_cm}


def zero(robot: Robot, say: Callable[[str], None]) -> None:
    """Zero the straight, vented robot once it is quiet; try again while its readings drift."""
    robot.wait(_QUIET_S)
    zero_when_steady(robot, pause_s=_QUIET_S, say=say)


class Hand(Operator, Protocol):
    """The person beside the robot, who can push its tip."""

    def push_tip(self, y_cm: float | None) -> None:
        """Push the tip aside to about y and hold it there; None = let go."""


@dataclass
class Bench:
    """A robot on the calibration bench."""

    robot: Robot  # connected
    camera: OverheadCamera
    session: Session  # the folder
    plan: Plan = field(default_factory=Plan)
    say: Callable[[str], None] = lambda text: None  # called with progress messages
    # latest resistances of the straight robot; an eversion shifts them, so each row stores those of
    # its own session
    rest_ohm: list[float] = field(default_factory=list)
    _configured: bool = False

    @property
    def hand(self) -> Hand:
        """The operator, who can push the tip, at a terminal and on the emulator."""
        return cast(Hand, self.robot.operator)

    @property
    def config(self) -> RobotConfig:
        """The constants measured so far."""
        return self.session.config

    @property
    def wiring(self) -> Wiring:
        """Where the robot's sensors hang, with the constants measured so far."""
        return Wiring.laid_out(self.config)

    def configure(self) -> None:
        """Give the robot the session's constants, once."""
        if not self._configured:
            self.robot.configure(self.config)
            self._configured = True

    def start(self) -> None:
        """Configure the robot, ask for its length, and arm it, as far as that is not done yet."""
        self.configure()
        self.robot.known_length_cm()
        if self.robot.status().state == "safe":
            self.robot.arm()

    def press(self, muscle: str, psi: float, ramp_psi_s: float = 0.0) -> None:
        """Bring one muscle, by its name, to a pressure."""
        self.robot.press(muscle, psi, ramp_psi_s=ramp_psi_s)

    def ohm(self, read: Reading | Recording) -> Array:
        """Resistances (..., m) of the robot's sensors, without unused inputs of the board."""
        resistance = np.asarray(read.resistance)
        inputs = self.wiring.inputs
        return resistance[..., [inputs[place] for place in places_of(self.config)]]

    def mean_ohm(self, record: Recording) -> Array:
        """Mean resistances (m,) of a recording; NaN for a sensor that was never read."""
        mean = np.ma.masked_invalid(self.ohm(record)).mean(axis=0)
        return np.asarray(mean.filled(np.nan))

    def set_body_pressure(self, body_pressure: int) -> None:
        """Set a body pressure, and say so to the board."""
        self.robot.pressurize(body_pressure)

    def bring_to(
        self,
        length_cm: float,
        at_stop: Callable[[float], None] | None = None,
        *,
        spacing_cm: float | None = None,
    ) -> None:
        """Grow to a length with `grow_to`."""
        grow_to(self.robot, self.config, length_cm, self.say, at_stop, spacing_cm=spacing_cm)

    def ready_to_bend(self, body_pressure: int | None = None) -> None:
        """Grow to full length, settle and zero the sensors, and set a body pressure.

        None keeps the body pressure of the full length.
        """
        self.bring_to(self.config.body.length_cm)
        self.set_body_pressure(len(self.config.body.pressures) - 1)
        self.robot.vent()
        self.say("waiting for the sensors to settle")
        self.robot.wait_settled()
        zero(self.robot, self.say)
        self.rest_ohm = self.ohm(self.robot.read(2.0)).tolist()
        if body_pressure is not None:
            self.set_body_pressure(body_pressure)

    def rows(
        self,
        procedure: str,
        planned: Mapping[str, T],
        take: Callable[[str, T], Row],
        prepare: Callable[[], None] | None = None,
    ) -> list[Row]:
        """Take the planned rows that the folder does not hold yet, or that the camera missed.

        `take` makes a row from its key and its plan; `prepare` (`ready_to_bend` if None) is called
        before the first. Returns all planned rows, in the order in which they were taken.
        """
        stored = self.session.rows(procedure)
        missing = [key for key in planned if stored.get(key, _UNSEEN).get("unseen")]
        count = len(planned) - len(missing)
        if count and missing:
            self.say(f"{procedure}: going on after {count} rows")
        if missing:
            (prepare or self.ready_to_bend)()
        for number, key in enumerate(missing, start=count + 1):
            if number in (count + 1, len(planned)) or number % _REPORT_EVERY == 0:
                self.say(f"{procedure} {number} of {len(planned)}: {key}")
            row = {"key": key, **take(key, planned[key])}
            self.session.add(procedure, row)
            if row.get("unseen"):
                self.say(f"{key} is omitted: the camera did not see it; run this step once more, "
                         "and only what it missed is taken")  # fmt: skip
        return [row for key, row in self.session.rows(procedure).items() if key in planned]

    def camera_reading(self, shot: Callable[[], Row], blank: Row) -> Row:
        """A camera reading, tried three times; `blank`, marked as unseen, if all fail.

        Raises CameraMovedError if the camera has moved, because later pictures would be wrong.
        """
        for attempt in range(_TRIES):
            if attempt:
                self.robot.wait(0.3)
            try:
                return shot()
            except CameraMovedError:
                raise
            except CameraError as error:
                self.say(f"camera: {error}")
        return {**blank, **_UNSEEN}

    def finish(self, step: str, result: StepResult) -> None:
        """Store a result, report its verdict, and send good constants to the board."""
        previous = self.config
        for line in self.session.keep(step, result):
            self.say(line)
        if self.config != previous:
            self.robot.vent()
            self.robot.configure(self.config)


def growth_rows(bench: Bench) -> list[Row]:
    """Grow to full length, and record counts, length and the sensors' creep at each stop.

    Stops are a pitch apart. Where these did not give a good encoder, lengths halfway between those
    that the folder holds are taken too. Raises DataError if the robot is too long for that.
    """
    spool, stored = bench.config.spool, bench.session.rows("growth")
    spacing_cm = bench.config.body.pitch_cm
    planned = _stops_cm(spacing_cm, bench.config.body.length_cm)
    while bench.session.failed("encoder") and all(_stop_key(cm) in stored for cm in planned):
        spacing_cm /= 2
        planned = _stops_cm(spacing_cm, bench.config.body.length_cm)

    def stop(length: float) -> None:
        for row in drive.rows():
            key = f"stop {length:g} body pressure {row['body_pressure']}"
            bench.session.add("drive", {"key": key, **row})
        key = _stop_key(length)
        if key in stored:
            return
        began = bench.robot.read(0.05).t_s
        records = [bench.robot.record(0.25) for _ in range(round(bench.plan.creep_s / 0.25))]
        reading = bench.robot.read(0.5)
        picture = bench.camera_reading(
            lambda: {"seen_cm": bench.camera.axis(free_bend=True).length_cm}, {"seen_cm": None}
        )
        bench.session.add("growth", {
            "key": key, "counts": reading.length_cm * spool.counts_per_cm * spool.payout_ratio,
            "encoder_cm": reading.length_cm, "speed_cm_s": spool.max_speed_cm_s,
            "t_s": [float(r.t_s.mean()) - began for r in records],
            "ohm": [bench.mean_ohm(r) for r in records], **picture,
        })  # fmt: skip

    # The board cannot judge an encoder whose counts per cm are not known yet.
    margin = bench.robot.parameter(_ENCODER_MARGIN)
    bench.robot.set_parameter(_ENCODER_MARGIN, [wire.PARAMETERS[_ENCODER_MARGIN].high])
    try:
        with Drive(bench.robot, bench.config) as drive:
            bench.bring_to(bench.config.body.length_cm, stop, spacing_cm=spacing_cm)
    finally:
        bench.robot.set_parameter(_ENCODER_MARGIN, list(margin))
    rows = bench.session.rows("growth")
    missing = sorted(cm for cm in planned if _stop_key(cm) not in rows)
    if missing and spacing_cm < bench.config.body.pitch_cm:
        raise DataError(
            f"the robot is longer than {missing[0]:g} cm, where more lengths are needed",
            "retract it with `thigmo retract`, then run this again",
        )
    return list(rows.values())


def _stop_key(length_cm: float) -> str:
    return f"stop {length_cm:g}"


def bend_set_points(bench: Bench, muscle: Muscle) -> list[tuple[str, float]]:
    """Branch and pressure (psi) of each set point, up and down."""
    top = muscle.max_pressure_psi
    up = [*np.arange(0.0, top, bench.plan.step_psi).tolist(), top]
    return [("inflate", p) for p in up] + [("deflate", p) for p in reversed(up[:-1])]


def bend_rows(bench: Bench, body_pressures: Iterable[int]) -> list[Row]:
    """Free bends of the plane's muscles at full length, for each body pressure."""
    config, length = bench.config, bench.config.body.length_cm

    def shot() -> Row:
        axis = bench.camera.axis(free_bend=True, length_cm=length)
        return {"k": axis.coefficients[2], "k_se": float(axis.covariance[2, 2] ** 0.5)}

    def take(key: str, set_point: Row) -> Row:
        reading, psi = _read_bend(bench, config.muscle(set_point["side"]), set_point["psi"])
        picture = bench.camera_reading(shot, {"k": None, "k_se": None})
        return {
            **set_point, "psi": psi, "ohm": bench.ohm(reading),
            "rest": bench.rest_ohm, "t_s": reading.t_s, **_strain(bench), **picture,
        }  # fmt: skip

    rows: list[Row] = []
    for body_pressure in body_pressures:
        body = config.body.pressures[body_pressure].pressure_psi
        planned = {
            f"body pressure {body_pressure} trial {trial} {muscle.name} {branch} {psi:g}": {
                "body_pressure": body_pressure, "body_psi": body, "trial": trial,
                "side": muscle.side,
                "branch": branch, "psi": psi,
            }
            for trial in range(bench.plan.trials)
            for muscle in map(config.muscle, config.sides)
            for branch, psi in bend_set_points(bench, muscle)
        }  # fmt: skip
        rows.extend(bench.rows("bends", planned, take, partial(bench.ready_to_bend, body_pressure)))
        bench.robot.vent()
    return rows


def last_bends(bench: Bench) -> list[Row]:
    """Free bends at the last body pressure, taken now unless all of them are stored."""
    last = len(bench.config.body.pressures) - 1
    bends = [row for row in bench.session.rows("bends").values() if row["body_pressure"] == last]
    muscles = [muscle for muscle in bench.config.muscles if muscle.side]
    if len(bends) < sum(len(bend_set_points(bench, muscle)) for muscle in muscles):
        return bend_rows(bench, [last])
    return bends


def _read_bend(bench: Bench, muscle: Muscle, psi: float) -> tuple[Reading, float]:
    """Readings with a muscle held at a set point, and its measured pressure."""
    if psi == 0.0:
        bench.robot.vent()
    else:
        bench.press(muscle.name, psi, _RAMP_PSI_S)
    bench.robot.wait(STEADY_S + bench.plan.step_psi / _RAMP_PSI_S)
    reading = bench.robot.read(READ_S)
    return reading, reading.pressure_psi[bench.config.muscle_number(muscle.name)]


def _strain(bench: Bench) -> Row:
    """The strains of the robot's fibre, if it has one that is read live."""
    if not (bench.config.gratings and bench.config.interrogator):
        return {}
    return {"strain": bench.robot.read_fibre(READ_S).strain_ue.tolist()}


def unseen_bend_rows(bench: Bench, body_pressures: Iterable[int], muscle: Muscle) -> list[Row]:
    """Free bends of a muscle out of the plane, which the camera does not see.

    Each row holds the changes of resistance of all inputs from the straight robot.
    """
    straight: list[Array] = []

    def prepare(body_pressure: int) -> None:
        bench.ready_to_bend(body_pressure)
        straight[:] = [bench.robot.read(2.0).resistance]

    def take(key: str, set_point: Row) -> Row:
        reading, psi = _read_bend(bench, muscle, set_point["psi"])
        return {
            **set_point,
            "psi": psi,
            "ohm": reading.resistance - straight[0],
            "t_s": reading.t_s,
        }

    rows: list[Row] = []
    for body_pressure in body_pressures:
        planned = {
            f"body pressure {body_pressure} trial {trial} {muscle.name} {branch} {psi:g}": {
                "body_pressure": body_pressure, "trial": trial, "muscle": muscle.name,
                "branch": branch, "psi": psi,
            }
            for trial in range(bench.plan.trials)
            for branch, psi in bend_set_points(bench, muscle)
        }  # fmt: skip
        rows.extend(bench.rows("unseen_bends", planned, take, partial(prepare, body_pressure)))
        bench.robot.vent()
    return rows


def tip_rows(bench: Bench) -> list[Row]:
    """Rows of the straight robot, and of the tip held at places on both sides."""
    plan, reach = bench.plan, _tip_reach_cm(bench)
    half = plan.places // 2
    distances_cm = [reach * (n + 1) / half for n in range(half)]
    # Out and back, with alternating sides, so that a loop or a shift does not look like a side.
    offsets_cm = [
        sign * y for y in (*distances_cm[::2], *reversed(distances_cm[1::2])) for sign in (1, -1)
    ]
    planned: dict[str, float | None] = {f"straight {n}": None for n in range(plan.straight)}
    planned |= {f"tip {n}": y for n, y in enumerate(offsets_cm)}

    def take(key: str, intended_y: float | None) -> Row:
        for _ in range(_PUSHES):
            bench.hand.push_tip(intended_y)
            bench.robot.wait(STEADY_S)
            reading = bench.robot.read(2 * READ_S)
            picture = _tip_picture(bench)
            y = picture["tip"][1]
            if intended_y is None or y is None or y * intended_y > 0 or abs(y) < _ASIDE_CM:
                break
            actual, side = SIDES if y > 0 else SIDES[::-1]
            bench.say(f"{key}: the tip stands {abs(y):.1f} cm to the {actual}: push it to the "
                      f"{side} (if it is there, the camera's +y is not the robot's left: correct "
                      "the cards' places in the sheet file)")  # fmt: skip
        return {
            "kind": key.split()[0], "asked": intended_y, "ohm": bench.ohm(reading),
            "rest": bench.rest_ohm, "t_s": reading.t_s, **picture,
        }  # fmt: skip

    rows = bench.rows("tips", planned, take)
    bench.hand.push_tip(None)
    return rows


def lean_rows(bench: Bench) -> list[Row]:
    """Pictures of the vented body with its tip pushed aside by two amounts, on alternating sides.

    No sensor is read, so none needs to settle.
    """
    body = bench.config.body
    offsets_cm = [
        sign * push_tip(share * body.push_curvature, body.length_cm).tip[1]
        for share in (_LESSER_LEAN, DEEPEST_LEAN)
        for sign in (1, -1)
    ]

    def prepare() -> None:
        bench.bring_to(body.length_cm)
        bench.set_body_pressure(len(body.pressures) - 1)
        bench.robot.vent()

    def take(key: str, y_cm: float) -> Row:
        bench.hand.push_tip(y_cm)
        bench.robot.wait(STEADY_S)
        return {"asked": y_cm, **_tip_picture(bench)}

    planned = {f"lean {n}": offsets_cm[n % len(offsets_cm)] for n in range(bench.plan.leans)}
    rows = bench.rows("leans", planned, take, prepare)
    bench.hand.push_tip(None)
    return rows


def bow_rows(bench: Bench) -> list[Row]:
    """Pictures of the body with its tip far aside, on alternating sides."""
    reach, half = _tip_reach_cm(bench), bench.plan.pictures // 2
    offsets_cm = [sign * y for y in np.linspace(0.6 * reach, reach, half) for sign in (1, -1)]

    def take(key: str, y_cm: float) -> Row:
        bench.hand.push_tip(y_cm)
        bench.robot.wait(STEADY_S)
        return _tip_picture(bench)

    rows = bench.rows("bows", {f"bow {n}": y for n, y in enumerate(offsets_cm)}, take)
    bench.hand.push_tip(None)
    return rows


def _tip_reach_cm(bench: Bench) -> float:
    body = bench.config.body  # just short of the fold
    return push_tip(0.85 * body.push_curvature, body.length_cm).tip[1]


def _tip_picture(bench: Bench) -> Row:
    """Tip and axis by camera; None if it does not see the robot."""

    def shot() -> Row:
        axis = bench.camera.axis(free_bend=False, length_cm=bench.config.body.length_cm)
        return {"tip": list(axis.tip_cm), "points": axis.points_cm}

    return bench.camera_reading(shot, {"tip": [None, None], "points": None})
