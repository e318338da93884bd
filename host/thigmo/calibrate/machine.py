"""What the guided steps need of a robot and of the operator: `thigmo.Robot` and a pair of hands.

Narrow protocols, so that a stand-in will do in tests and so that the fits know nothing of robots.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from thigmo.config import RobotConfig

Array = NDArray[np.float64]


class ReadingLike(Protocol):
    """Averaged readings."""

    @property
    def t_s(self) -> float:
        """Device time."""

    @property
    def resistance(self) -> Array:
        """Of each sensor, ohm, left base first."""

    @property
    def left_psi(self) -> float:
        """Left muscle."""

    @property
    def right_psi(self) -> float:
        """Right muscle."""

    @property
    def length_cm(self) -> float:
        """By the encoder."""


class RecordingLike(Protocol):
    """Every frame of a while."""

    @property
    def t_s(self) -> Array:
        """Device times."""

    @property
    def resistance(self) -> Array:
        """(n, m) ohm."""

    @property
    def left_psi(self) -> Array:
        """(n,)."""

    @property
    def right_psi(self) -> Array:
        """(n,)."""


class StatusLike(Protocol):
    """The board's state, as far as it matters here."""

    @property
    def length_cm(self) -> float | None:
        """Everted length, if known."""

    @property
    def state(self) -> str:
        """Supervisor's state."""


class Machine(Protocol):
    """What calibration needs of a robot (`thigmo.Robot` has it)."""

    def configure(self, config: RobotConfig) -> bool:
        """Send constants to the board, verified."""

    def status(self) -> StatusLike:
        """The board's state."""

    def arm(self) -> None:
        """Allow outputs."""

    def confirm_length(self, length_cm: float, *, settled: bool = False) -> None:
        """Vouch for the everted length."""

    def select_zone(self, zone: int) -> None:
        """Tell which body pressure holds."""

    def grow_to(self, length_cm: float) -> float:
        """Pay out to a length, cm; returns the one reached."""

    def vent(self) -> None:
        """Empty both muscles."""

    def press(
        self, *, left_psi: float = 0.0, right_psi: float = 0.0, ramp_psi_s: float = 0.0
    ) -> None:
        """Hold a muscle pressure."""

    def zero(self) -> int:
        """Take zeros of the everted sensors."""

    def wait(self, seconds: float) -> None:
        """Let time pass."""

    def wait_settled(self) -> None:
        """Wait until every everted sensor has settled."""

    def read(self, seconds: float = 0.5) -> ReadingLike:
        """Averaged readings."""

    def record(self, seconds: float) -> RecordingLike:
        """Every frame of a while."""

    def parameter(self, name: str) -> list[int]:
        """A board's parameter, in its wire unit."""

    def set_parameter(self, name: str, values: list[int]) -> None:
        """Set a board's parameter."""

    def save(self) -> int:
        """Store the board's configuration."""


@runtime_checkable
class Hand(Protocol):
    """Whoever stands beside the robot."""

    def everted_length_cm(self) -> float:
        """Measure the everted length."""

    def set_body_pressure(self, pressure_psi: float) -> None:
        """Set the body's regulator."""

    def push_tip(self, y_cm: float | None) -> None:
        """Push the tip aside to about y and hold it there; None = let go."""
