"""What a kind of sensor is: its entry in robot.toml, how it reads, and what it may be off by.

A kind is a class in a file of this package. `flex` and `heading` hang on the board, which reads
each as a resistance; `fibre` is read by an interrogator. Nothing outside asks for a kind's name:
what a kind does differently it answers itself. Its calibration (`calibrate/KIND.py`) and its
emulation (`emulator/`) build on it.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from math import hypot
from typing import ClassVar, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from thigmo.sides import Placed
from thigmo.toml_model import Finite, NonNegative, Positive

Floats = npt.NDArray[np.float64]


class Passage(NamedTuple):
    """Where a sensor passes the tip's fold as it everts, cm."""

    center_cm: float
    span_cm: float
    center_se_cm: float
    seen: bool = True  # whether the sensor's reading shows that the tip passes there


class AnySensor(Placed):
    """What every kind has: the mean curvature over a span, and its errors.

    Class attributes:
        wrinkles: whether a muscle at its side spoils it.
        imu_inputs: inputs for IMUs that its board needs.
        fault_words: what to say of it where the schema speaks of a flex sensor.
    """

    wrinkles: ClassVar[bool]
    imu_inputs: ClassVar[int] = 0
    fault_words: ClassVar[Mapping[str, str]] = {}
    kind: str  # flex, heading or fibre
    center_cm: Positive  # of its span, from the base
    # One sigma of its place. Default: a ruler along the tube, read to a millimetre.
    center_se_cm: NonNegative = 0.1
    span_cm: NonNegative  # over which it averages the curvature
    scale_se: NonNegative  # one sigma of its scale, relative
    # One sigma by which its scale has drifted since then, relative; `check` on later days shows it.
    drift_se: NonNegative = 0.04
    noise: Positive  # 1/cm, white, of an averaged reading
    settle_tau_s: Positive = 8.0  # decay after eversion
    settle_amplitude: Finite = 0.0  # 1/cm at eversion
    healthy: bool = True  # false: dead, never used

    @property
    @abstractmethod
    def raw_scale(self) -> float:
        """Curvature (1/cm) for each unit of a raw reading: an ohm, or a microstrain."""

    @property
    @abstractmethod
    def raw_zero(self) -> float:
        """The raw reading of the straight body."""

    def reading(self, raw: float) -> float:
        """Curvature (1/cm) at a raw reading."""
        return self.raw_scale * (raw - self.raw_zero)

    @abstractmethod
    def rescale(self, factor: float) -> None:
        """Let it stand for so much more curvature."""

    @property
    def usable(self) -> bool:
        """Whether its readings are to be used at all."""
        return self.healthy

    @property
    def zero_error(self) -> float:
        """One sigma of its zero, 1/cm, of its own."""
        return 0.0

    @property
    def gain_error(self) -> float:
        """One sigma of its scale as it lies in the body, relative."""
        return self.scale_se

    @property
    def reading_se(self) -> float:
        """One sigma of an averaged reading, 1/cm: noise, its zero, and what it shares."""
        return hypot(self.noise, self.zero_error)

    @classmethod
    def shared_errors(cls, sensors: Sequence[Self]) -> Floats:
        """(n, K) what n sensors of this kind share, at one standard error a column, 1/cm."""
        return np.zeros((len(sensors), 0))

    @property
    def passes_at(self) -> Passage:
        """The part of it that must not lie in the tip's fold, and that swings as the tip passes."""
        return Passage(self.center_cm, self.span_cm, self.center_se_cm)

    def uncalibrated(self) -> Self:
        """It before its calibration: at its place, with the kind's default constants."""
        return type(self)(
            **self.model_dump(include={"direction_deg", "kind", "center_cm", "span_cm"})
        )
