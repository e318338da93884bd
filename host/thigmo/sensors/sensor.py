"""What all kinds of sensors have: an entry in robot.toml, a scale and a zero, and their errors.

Each kind is a class in a file of this package. The board reads `flex` and `heading` sensors as
resistances; an interrogator reads `fibre` sensors. Other modules do not ask for a kind's name: they
call these methods, which each kind answers in its own way. Its calibration (`calibrate/KIND.py`)
and its emulation (`emulator/`) build on it.
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
    is_shown: bool = True  # by the sensor's reading


class AnySensor(Placed):
    """A sensor of any kind: it measures the mean curvature over a span.

    Class attributes:
        wrinkles: whether pressure in the muscle at its side spoils its reading.
        on_board: whether the board reads it; otherwise an interrogator does.
        imu_inputs: how many of the board's inputs for IMUs one sensor needs.
        calibrated_by_file: whether bends in a file calibrate it where no muscle bends the body.
        fault_words: words that replace the schema's, which are about flex sensors, in messages.
    """

    wrinkles: ClassVar[bool]
    on_board: ClassVar[bool] = True
    imu_inputs: ClassVar[int] = 0
    calibrated_by_file: ClassVar[bool] = False
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
        """Multiply the curvature of every reading by a factor."""

    def straightened(self, reading: float, rest_curvature: float) -> tuple[Self, float]:
        """The curvature that a reading since the zero means, with the sensor's errors there.

        `rest_curvature` (1/cm) is that of the body as the sensor was zeroed.
        """
        return self, reading

    def quieter(self, factor: float) -> Self:
        """A copy whose noise, and error of its zero, are a factor smaller."""
        return self.model_copy(update={"noise": self.noise / factor})

    def count_curvature(self, divider_ohm: float, counts: int) -> float:
        """Curvature (1/cm) of one of a converter's counts behind a divider; 0 without a divider."""
        return 0.0

    @property
    def response_against(self) -> tuple[float, float]:
        """Response to bends against `bend_sign` over that along it, and one sigma of it."""
        return 1.0, 0.0

    @property
    def usable(self) -> bool:
        """Whether the robot uses its readings."""
        return self.healthy

    @property
    def zero_error(self) -> float:
        """One sigma of its zero that no other sensor shares, 1/cm."""
        return 0.0

    @property
    def gain_error(self) -> float:
        """One sigma of its scale, mounted in the body, relative."""
        return self.scale_se

    @property
    def reading_se(self) -> float:
        """One sigma of an averaged reading, 1/cm: noise, zero and shared errors."""
        return hypot(self.noise, self.zero_error)

    @classmethod
    def shared_errors(cls, sensors: Sequence[Self]) -> Floats:
        """(n, K) effects of K errors that n sensors of this kind share, one sigma each, 1/cm."""
        return np.zeros((len(sensors), 0))

    @property
    def passes_at(self) -> Passage:
        """The part that must not lie in the tip's fold; its reading swings as the tip passes."""
        return Passage(self.center_cm, self.span_cm, self.center_se_cm)

    def uncalibrated(self) -> Self:
        """A copy as before its calibration: at its place, with the kind's default constants."""
        return type(self)(**self.model_dump(include={"angle_deg", "kind", "center_cm", "span_cm"}))
