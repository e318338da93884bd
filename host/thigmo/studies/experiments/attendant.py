"""Whoever places the dowels and measures them: a person at a terminal, or the emulator's operator.

The person is `thigmo.cli.experiment_prompts.TerminalAttendant`; here is the protocol, and the
attendant of an emulated robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from thigmo.errors import DataError
from thigmo.mechanics import Peg
from thigmo.studies.experiments import thesis
from thigmo.studies.experiments.folder import Verdict

if TYPE_CHECKING:
    from thigmo.robot import Robot
    from thigmo.studies.experiments.plan import Planned

Place = tuple[float, float]

_CLEARANCE_CM = 0.01  # between skin and dowel that just touch


@dataclass(frozen=True)
class Known:
    """What an emulated room knows of the contacts, base first; empty on a real robot."""

    arcs_cm: tuple[float, ...] = ()
    forces: tuple[float, ...] = ()
    contact_x_cm: tuple[float, ...] = ()


class Attendant(Protocol):
    """Places dowels, measures them, and judges a trial."""

    def clear(self) -> None:
        """Take all dowels away; return when the robot lies free."""

    def push_aside(self, trial: Planned) -> None:
        """Push the robot aside with dowels as planned; return when they hold it."""

    def touch(self, trial: Planned) -> None:
        """Set a dowel that just touches the bent robot as planned; return when it stands."""

    def dowels(self, trial: Planned) -> list[Place]:
        """Centres of the dowels by camera, cm, base first."""

    def truth(self) -> Known:
        """What the room knows of the contacts."""

    def verdict(self, trial: Planned, summary: str) -> Verdict:
        """Whether to keep the trial that was just taken."""


@runtime_checkable
class _Hands(Protocol):
    def place_pegs(self, pegs: Sequence[Peg]) -> None: ...

    def push_aside(self, pushes: Sequence[tuple[float, float]], radius_cm: float) -> None: ...


class EmulatedAttendant:
    """Beside an emulated robot: does what is planned, measures without error, keeps every trial.

    Args:
        robot: connected to an emulator.

    Raises:
        DataError: the robot is real.
    """

    def __init__(self, robot: Robot) -> None:
        operator = robot.operator
        if robot.scenery() is None or not isinstance(operator, _Hands):
            raise DataError("this robot is not emulated", "a person must place its dowels")
        self._robot = robot
        self._hands: _Hands = operator

    def clear(self) -> None:
        """Let go, and clear the room."""
        self._hands.push_aside([], 0.0)
        self._hands.place_pegs([])

    def push_aside(self, trial: Planned) -> None:
        """Hold the body where the trial wants it."""
        self._hands.push_aside(
            list(zip(trial.arcs_cm, trial.pushes_cm, strict=True)), thesis.DOWEL_CM
        )

    def touch(self, trial: Planned) -> None:
        """Put a peg beside the body as it lies."""
        now = self._robot.scenery().now
        arc, heading, _, x, y = now.centreline.T
        at = trial.arcs_cm[0]
        radius = self._robot.config.body.radius_cm + thesis.DOWEL_CM + _CLEARANCE_CM
        sign = 1.0 if trial.side == "left" else -1.0
        normal = float(np.interp(at, arc, heading)) + sign * np.pi / 2
        self._hands.place_pegs(
            [
                Peg(
                    float(np.interp(at, arc, x) + radius * np.cos(normal)),
                    float(np.interp(at, arc, y) + radius * np.sin(normal)),
                    thesis.DOWEL_CM,
                )
            ]
        )

    def dowels(self, trial: Planned) -> list[Place]:
        """Where the room's dowels are."""
        return [(float(peg.x), float(peg.y)) for peg in self._robot.scenery().pegs]

    def truth(self) -> Known:
        """Contacts, as the emulator solved them."""
        touching = self._robot.scenery().now.contacts
        return Known(
            tuple(float(contact.arc) for contact in touching),
            tuple(float(contact.normal) for contact in touching),
            tuple(float(contact.x) for contact in touching),
        )

    def verdict(self, trial: Planned, summary: str) -> Verdict:
        """Keep it."""
        return "keep"
