"""Flex sensors: strips whose resistance changes with the bend."""

from __future__ import annotations

from math import copysign
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
    # sheet states one direction only. A bench that bends both ways measures it.
    against_gain: NonNegative = 0.7
    against_gain_se: NonNegative = 0.3  # one sigma of it
    noise: Positive = 4.8e-4  # 1/cm, white, of an averaged reading; 6e-4 with `zero_se`

    @property
    def zero_error(self) -> float:
        """One sigma of its zero that no other sensor shares, 1/cm."""
        return self.zero_se

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
