"""What is around a robot beyond its link: its operator, and a simulated robot's room."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any, Protocol, runtime_checkable

from thigmo.config import RobotConfig
from thigmo.errors import DataError


class Dowel(Protocol):
    """A round obstacle in the room, cm: x along the straight robot from its base, y to its left."""

    @property
    def x(self) -> float:
        """Centre."""

    @property
    def y(self) -> float:
        """Centre."""

    @property
    def radius(self) -> float:
        """Radius."""


class Operator(Protocol):
    """The person beside the robot, who does what its board cannot."""

    def everted_length_cm(self) -> float:
        """Measure the everted length."""

    def set_body_pressure(self, pressure_psi: float) -> None:
        """Set the body's pressure regulator; return when it is set."""

    def warn(self, danger: str) -> None:
        """Hear, before the robot moves, of a danger that its board cannot take away."""

    def place_pegs(self, pegs: Sequence[Dowel]) -> None:
        """Clear the room and put these dowels into it; return when they stand."""


class Viewers(Protocol):
    """Viewers of a run, who may answer its questions to the operator."""

    def ask(self, question: str, unit: str = "") -> None:
        """Show a question, until an empty one takes it away.

        `unit` is that of the number that is asked for; empty if only a confirmation is.
        """

    def answer(self) -> str | None:
        """An answer, if one has come."""


@runtime_checkable
class Patient(Operator, Protocol):
    """An operator who takes time, during which the robot is still read.

    Attributes:
        meanwhile: lets seconds pass with the link alive, and raises RobotFaultError once a fault or
            a stop is latched; the robot that asks sets it. None while there is none.
    """

    meanwhile: Callable[[float], None] | None


@runtime_checkable
class Reachable(Operator, Protocol):
    """An operator who may sit at a viewer of the run.

    Attributes:
        viewers: those of the run that asks; None while there is none.
    """

    viewers: Viewers | None


@runtime_checkable
class Simulated(Protocol):
    """A connection that holds the robot itself, and its room.

    Attributes:
        operator: who stands beside it.
        config: the robot.toml that this robot's lab would have.
    """

    operator: Operator
    config: RobotConfig

    def interrogator(self) -> Any:
        """A source of its fibre's lines, as `thigmo.link.interrogator.Source` has it."""

    def overhead_pictures(self, sheet: Any, seed: int) -> Any:
        """Pictures of a camera above the room (`thigmo.camera.PictureSource`) for a `Sheet` on the
        table, and the camera's height (cm) as measured with a tape.
        """

    def truth(self) -> Any:
        """What the room knows: pegs, contacts and shapes."""


class NoOperator:
    """The operator of a program that named none: every question is a DataError.

    Dangers are Python's warnings.
    """

    def everted_length_cm(self) -> float:
        """Refused."""
        raise DataError("the everted length is unknown", "measure it, and call confirm_length")

    def set_body_pressure(self, pressure_psi: float) -> None:
        """Refused."""
        raise DataError(
            f"the body pressure must be set to {pressure_psi:g} psi by hand",
            "set the regulator, and call select_body_pressure",
        )

    def warn(self, danger: str) -> None:
        """Warn."""
        warnings.warn(danger, stacklevel=5)

    def place_pegs(self, pegs: Sequence[Dowel]) -> None:
        """Refused."""
        raise DataError("the room's dowels must be moved by hand", "name an operator to connect()")
