"""Gratings of a fibre: the strain of its cores, which an interrogator reads."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, hypot
from typing import ClassVar, Literal, Self

import numpy as np

from thigmo.sensors.sensor import AnySensor, Floats
from thigmo.toml_model import Finite, NonNegative, NonZero, Positive


class FibreSensor(AnySensor):
    """The bend towards one angle at a grating of a multi-core fibre, by the strain of its cores.

    A grating has two such sensors, at different angles. An interrogator reads them; the board
    does not. The defaults are of an outer core 37 um off the axis, which a curvature of 0.01 1/cm
    strains by 37 microstrain.
    """

    wrinkles = False
    on_board = False
    calibrated_by_file = True
    kind: Literal["fibre"]  # a grating's reading at one angle
    span_cm: NonNegative = 0.5  # length of the grating
    scale_per_ue: NonZero = 2.7e-4  # 1/cm per microstrain; sign included
    scale_se: NonNegative = 0.05  # one sigma of it, relative
    zero_ue: Finite = 0.0  # of the straight body
    noise: Positive = 2.7e-4  # 1/cm, white, of an averaged reading: a microstrain
    # What temperature adds to all gratings alike, 1/cm. A kelvin strains a core by 11 microstrain
    # [a typical grating at 1550 nm]; reading each core by itself leaves a tenth of that [assumed].
    temperature_se: NonNegative = 3e-4
    twist_se_rad: NonNegative = 0.05  # by which the fibre lies turned about its axis

    bend_sign: ClassVar[int] = 0
    warm_s: ClassVar[float] = 20.0  # from zeros to a reading, for which `temperature_se` holds

    @property
    def gain_error(self) -> float:
        """One sigma of its scale, relative: of calibration, and of a twist of the fibre."""
        return hypot(self.scale_se, 1 - cos(self.twist_se_rad))

    @property
    def reading_se(self) -> float:
        """One sigma of an averaged reading, 1/cm: noise and temperature."""
        return hypot(self.noise, self.temperature_se)

    def rescale(self, factor: float) -> None:
        """Multiply the curvature of every reading by a factor."""
        self.scale_per_ue *= factor

    @property
    def raw_scale(self) -> float:
        """Curvature (1/cm) per microstrain."""
        return self.scale_per_ue

    @property
    def raw_zero(self) -> float:
        """Strain of the straight body, microstrain."""
        return self.zero_ue

    @property
    def usable(self) -> bool:
        """Whether it measures bends in the plane. The others only show the fibre's twist."""
        return self.healthy and self.side is not None

    @classmethod
    def shared_errors(cls, sensors: Sequence[Self]) -> Floats:
        """(n, 1) effect of temperature, the same in all gratings of a fibre; (n, 0) if none."""
        warm = np.array([[sensor.temperature_se] for sensor in sensors]).reshape(-1, 1)
        return warm if warm.any() else warm[:, :0]
