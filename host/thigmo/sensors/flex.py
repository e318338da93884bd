"""Flex sensors: strips whose resistance changes with the bend."""

from __future__ import annotations

from math import copysign, hypot
from typing import Literal, Self

from thigmo.sensors.sensor import AnySensor
from thigmo.toml_model import NonNegative, NonZero, Positive


class FlexSensor(AnySensor):
    """One flex sensor: reading = scale_per_ohm * (R - R at the last zeroing)."""

    wrinkles = True
    kind: Literal["flex"] = "flex"  # a strip on the tube
    span_cm: NonNegative = 5.5  # length of the strip
    scale_per_ohm: NonZero = 3.5e-5  # 1/cm per ohm; sign included, so that left bends read positive
    scale_se: NonNegative = 0.15  # relative: resistances differ by 30 % from part to part
    zero_ohm: Positive = 12_000.0  # flat resistance, a start value: zeroing re-measures it
    zero_se: NonNegative = 3.6e-4  # 1/cm, what zeroing and averaging leave: its loop, slow drift
    bend_sign: Literal[-1, 0, 1] = 0  # of the bends that it answers to: 1 left, -1 right, 0 both
    # Response to bends against `bend_sign` over that to bends along it, and one sigma: a data
    # sheet states bends to one side only. A bench that bends both ways measures it.
    against_gain: NonNegative = 0.7
    against_gain_se: NonNegative = 0.3  # one sigma of it
    noise: Positive = 4.8e-4  # 1/cm, white, of an averaged reading; 6e-4 with `zero_se`

    @property
    def zero_error(self) -> float:
        """One sigma of its zero that no other sensor shares, 1/cm."""
        return self.zero_se

    @property
    def response_against(self) -> tuple[float, float]:
        """`against_gain` and its error; 1 and 0 for a sensor that answers to both signs alike."""
        return (self.against_gain, self.against_gain_se) if self.bend_sign else (1.0, 0.0)

    @property
    def raw_scale(self) -> float:
        """Curvature (1/cm) per ohm."""
        return self.scale_per_ohm

    @property
    def raw_zero(self) -> float:
        """Resistance (ohm) of the straight body."""
        return self.zero_ohm

    def uncalibrated(self) -> Self:
        """A copy that keeps the sign of its scale: steps before `flex` measure bends by it."""
        fresh = super().uncalibrated()
        fresh.scale_per_ohm = copysign(fresh.scale_per_ohm, self.scale_per_ohm)
        return fresh

    def rescale(self, factor: float) -> None:
        """Multiply the curvature of every reading by a factor."""
        self.scale_per_ohm *= factor

    def straightened(self, reading: float, rest_curvature: float) -> tuple[Self, float]:
        """The curvature that a reading since the zero means, with the sensor's errors there.

        A sensor answers weakly to bends against `bend_sign`. The whole bend decides, the one at
        rest included: a preformed body that is pushed straighter still bends to its old side.
        """
        weak_at_rest = self.bend_sign * rest_curvature < 0.0
        answer = reading + (self.against_gain * rest_curvature if weak_at_rest else rest_curvature)
        if self.bend_sign * answer >= 0.0:
            return self, answer - rest_curvature
        relative = self.against_gain_se / self.against_gain
        weak = self.model_copy(update={"scale_se": hypot(self.scale_se, relative)})
        return weak, answer / self.against_gain - rest_curvature

    def quieter(self, factor: float) -> Self:
        """A copy whose noise, and error of its zero, are a factor smaller."""
        smaller = {"noise": self.noise / factor, "zero_se": self.zero_se / factor}
        return self.model_copy(update=smaller)

    def count_curvature(self, divider_ohm: float, counts: int) -> float:
        """Curvature (1/cm) of one of a converter's counts, of the straight body."""
        total_ohm = divider_ohm + self.zero_ohm
        return abs(self.scale_per_ohm) * total_ohm**2 / (counts * divider_ohm)
