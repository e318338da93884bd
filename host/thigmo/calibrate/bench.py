"""A robot on the calibration bench: how to bring it to a state, read it, and keep what was read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar, cast

import numpy as np

from thigmo.calibrate.columns import Array, places_of
from thigmo.calibrate.eyes import Eyes
from thigmo.calibrate.session import Session
from thigmo.calibrate.verdict import StepResult
from thigmo.camera.errors import CameraError, CameraMovedError
from thigmo.config import SIDES, RobotConfig, Side
from thigmo.errors import CommandRefusedError, DataError
from thigmo.robot import Reading, Robot
from thigmo.robot.state import Recording
from thigmo.room import Operator

Row = dict[str, Any]
T = TypeVar("T")

STEADY_S = 2.5  # from a new set point to a bend at rest: lag, swing, and a good margin
READ_S = 1.0
SAME_CM = 0.2
_TRIES = 3
_QUIET_S = 5.0  # after venting, before zeros are taken
_UNSEEN: Row = {"unseen": True}


@dataclass
class Plan:
    """How much of everything."""

    places: int = 10  # tip places of the flex step
    # more of the pushed tip for the stiffness step, all far aside. One at full reach tells the
    # ratio to 0.15..0.35, by the camera. The flex step's ten places count for four of those, twelve
    # more for eight: 0.05..0.1, where 0.15 is the worst that is good.
    pictures: int = 12
    straight: int = 3  # straight rows of the flex step
    trials: int = 3  # of the bends
    step_psi: float = 2.0  # of the muscle pressure
    pushes: int = 5  # hard pushes of the buckling step
    rest_readings: int = 40  # of the noise step
    creep_s: float = 30.0  # watched after each eversion
    zones: tuple[int, ...] | None = None  # body pressures whose maps are measured; None = all


class Hand(Operator, Protocol):
    """Whoever stands beside the robot, and can push its tip."""

    def push_tip(self, y_cm: float | None) -> None:
        """Push the tip aside to about y and hold it there; None = let go."""


@dataclass
class Bench:
    """A robot on the calibration bench."""

    robot: Robot  # connected
    eyes: Eyes
    session: Session  # the folder
    plan: Plan = field(default_factory=Plan)
    say: Callable[[str], None] = lambda text: None  # told what happens
    # resistances of the straight robot, taken last (an eversion shifts them, so rows keep the one
    # of their own session)
    rest: list[float] = field(default_factory=list)
    _configured: bool = False

    @property
    def hand(self) -> Hand:
        """The operator: at a terminal as on the emulator one who can push the tip."""
        return cast(Hand, self.robot.operator)

    @property
    def config(self) -> RobotConfig:
        """Constants so far."""
        return self.session.config

    def configure(self) -> None:
        """Give the robot the session's constants, once."""
        if not self._configured:
            self.robot.configure(self.config)
            self._configured = True

    def start(self) -> None:
        """Configure, learn the length, arm; what is done already is left as it is."""
        self.configure()
        self.length_cm()
        if self.robot.status().state == "safe":
            self.robot.arm()

    def length_cm(self) -> float:
        """Everted length; the operator is asked where the board does not know it."""
        known = self.robot.status().length_cm
        if known is None:
            known = self.hand.everted_length_cm()
            self.robot.confirm_length(known)
        return known

    def press(self, side: Side, psi: float, ramp_psi_s: float = 0.0) -> None:
        """Bring one muscle to a pressure."""
        self.robot.press(**{f"{side}_psi": psi, "ramp_psi_s": ramp_psi_s})

    def ohm(self, read: Reading | Recording) -> Array:
        """Resistances (..., m) of the robot's sensors: the board has inputs that it may not use."""
        every = np.asarray(read.resistance)
        a_side = every.shape[-1] // len(SIDES)
        used = places_of(self.config)
        return every[..., [SIDES.index(side) * a_side + index for side, index in used]]

    def mean_ohm(self, record: Recording) -> Array:
        """Mean resistances (m,) of a recording; NaN for a sensor that was never read."""
        mean = np.ma.masked_invalid(self.ohm(record)).mean(axis=0)
        return np.asarray(mean.filled(np.nan))

    def set_zone(self, zone: int) -> None:
        """Body pressure of a zone, and the board told."""
        self.hand.set_body_pressure(self.config.body.zones[zone].pressure_psi)
        self.robot.select_zone(zone)

    def bring_to(self, length_cm: float, at_stop: Callable[[float], None] | None = None) -> None:
        """Grow, pitch by pitch and with the body pressure of each zone; never retracts."""
        now = self.length_cm()
        if now > length_cm + SAME_CM:
            raise DataError(
                f"the robot is {now:.1f} cm long, {length_cm:.1f} cm are needed",
                "retract it with `thigmo retract`, then run this again",
            )
        pitch, body = self.config.sensors.pitch_cm, self.config.body
        stops = {*np.arange(pitch, length_cm, pitch).tolist(), length_cm}
        boundaries = {z.until_cm for z in body.zones if z.until_cm < length_cm}
        self.robot.vent()
        for stop in sorted(stops | boundaries):
            if stop <= now + SAME_CM:
                continue
            self.set_zone(body.zone_at(min(now + SAME_CM, stop)))
            self.say(f"growing to {stop:.1f} cm")
            self.robot.grow_to(stop)
            now = stop
            if at_stop is not None and stop in stops:
                at_stop(stop)

    def ready_to_bend(self, zone: int | None = None) -> None:
        """Full length, sensors settled and zeroed; then a zone's body pressure (None: its own)."""
        self.bring_to(self.config.body.length_cm)
        self.set_zone(len(self.config.body.zones) - 1)
        self.robot.vent()
        self.say("waiting for the sensors to settle")
        self.robot.wait_settled()
        for attempt in range(_TRIES):
            self.robot.wait(_QUIET_S)
            try:
                self.robot.zero()
                break
            except CommandRefusedError as error:
                if error.reason != "drifting" or attempt + 1 == _TRIES:
                    raise
                self.say("readings still drift; waiting")
        self.rest = self.ohm(self.robot.read(2.0)).tolist()
        if zone is not None:
            self.set_zone(zone)

    def rows(
        self,
        procedure: str,
        planned: Mapping[str, T],
        take: Callable[[str, T], Row],
        prepare: Callable[[], None] | None = None,
    ) -> list[Row]:
        """Take the planned rows that the folder does not hold yet, or that the camera missed.

        `take` makes a row from its key and what is planned for it; `prepare` (`ready_to_bend` if
        None) comes before the first. Returns all planned rows, in the order in which they were
        taken.
        """
        held = self.session.rows(procedure)
        missing = [key for key in planned if held.get(key, _UNSEEN).get("unseen")]
        done = len(planned) - len(missing)
        if done and missing:
            self.say(f"{procedure}: going on after {done} rows")
        if missing:
            (prepare or self.ready_to_bend)()
        for number, key in enumerate(missing, start=done + 1):
            self.say(f"{procedure} {number} of {len(planned)}: {key}")
            row = {"key": key, **take(key, planned[key])}
            self.session.add(procedure, row)
            if row.get("unseen"):
                self.say(f"{key} is left out: the camera did not see it; run this step once more, "
                         "and only what it missed is taken")  # fmt: skip
        return [row for key, row in self.session.rows(procedure).items() if key in planned]

    def seen(self, shot: Callable[[], Row], blank: Row) -> Row:
        """A camera reading, tried three times; where the robot cannot be seen, `blank` as unseen.

        A moved camera ends the step: pictures taken from now on would be wrong.
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
        """Store a result, say its verdict, and send good constants to the board."""
        before = self.config
        for line in self.session.keep(step, result):
            self.say(line)
        if self.config != before:
            self.robot.vent()
            self.robot.configure(self.config)
