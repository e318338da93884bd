"""From the board's sums of ADC counts to curvature.

The divider is 5 V - sensor - pin - R_d - ground, so a mean count m (of 1024) means a resistance
R_d (1024 - m) / m; curvature is the sensor's calibrated scale times the change of resistance since
its last zeroing (thesis, equation 2.4).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from thigmo import wiring
from thigmo.config import SIGN, RobotConfig, Side
from thigmo.reading_errors import shared_errors

Floats = NDArray[np.float64]


def mask_of(chosen: NDArray[np.bool_]) -> int:
    """A mask of sensors by input, from one truth value each."""
    return sum(1 << int(sensor) for sensor in np.flatnonzero(chosen))


def in_mask(mask: int) -> list[int]:
    """The sensors whose bits are set in a mask."""
    return [sensor for sensor in range(mask.bit_length()) if mask >> sensor & 1]


def resistance_ohm(mean_count: Floats, divider_ohm: float) -> Floats:
    """Sensor resistance (ohm) of mean ADC counts; NaN where the circuit is open."""
    with np.errstate(divide="ignore", invalid="ignore"):
        value: Floats = divider_ohm * (1024.0 - mean_count) / mean_count
    return np.where(mean_count > 0.75, value, np.nan)


@dataclass(frozen=True, slots=True)
class SensorTable:
    """robot.toml's sensors as arrays, by the board's input; absent ones are unhealthy."""

    center_cm: Floats
    span_cm: Floats
    scale_per_ohm: Floats
    noise: Floats  # one sigma of an averaged reading, all included, 1/cm
    white: Floats  # the part of it that is the sensor's own: noise and its zero
    shared: Floats  # (n, k) the rest: columns of one standard error, as `shared_errors` has them
    # side of the body whose muscle wrinkles it: 1 left, -1 right, 0 neither (or no sensor)
    lies: NDArray[np.int64]
    direction: NDArray[np.int64]  # of bends that it answers to; 0: both
    healthy: NDArray[np.bool_]  # mask of sensors to use at all
    radius_cm: float  # of the tube
    divider_ohm: float  # the divider's fixed resistor
    oversample: int  # conversions that a raw reading sums
    zero_sum: Floats  # raw readings at the last zeroing; NaN where there is none

    @classmethod
    def of(cls, config: RobotConfig, oversample: int = 16) -> SensorTable:
        """Lay out the configuration's sensors in the board's order, without zeros."""
        sensors = wiring.sensors(config)
        return cls(
            center_cm=np.array([s.center_cm if s else 0.0 for s in sensors]),
            span_cm=np.array([s.span_cm if s else 0.0 for s in sensors]),
            scale_per_ohm=np.array([s.scale_per_ohm if s else 0.0 for s in sensors]),
            noise=np.array([s.reading_se if s else 1.0 for s in sensors]),
            white=np.array([np.hypot(s.noise, s.zero_error) if s else 1.0 for s in sensors]),
            shared=shared_errors(sensors),
            lies=np.array(
                [int(SIGN[s.side]) if s and s.side and s.wrinkles else 0 for s in sensors]
            ),
            direction=np.array([s.valid_direction if s else 0 for s in sensors]),
            healthy=np.array([s is not None and s.healthy for s in sensors]),
            radius_cm=config.body.radius_cm,
            divider_ohm=config.board.divider_ohm,
            oversample=oversample,
            zero_sum=np.full(len(sensors), np.nan),
        )

    @property
    def covariance(self) -> Floats:
        """Of averaged readings, (n, n), 1/cm^2."""
        return np.diag(self.white**2) + self.shared @ self.shared.T

    def zeroed(self, sums: dict[int, float]) -> SensorTable:
        """The same with new zeros of some sensors."""
        zeros = self.zero_sum.copy()
        zeros[list(sums)] = list(sums.values())
        return replace(self, zero_sum=zeros)

    @property
    def zeros(self) -> Floats:
        """The zeros as `unzeroed` has them."""
        return self.unzeroed(self.zero_sum)

    def resistance(self, flex_sum: Floats) -> Floats:
        """Resistance (ohm) of each sensor from raw readings (..., n)."""
        # A conversion floors, so a count stands for the half above it.
        return resistance_ohm(flex_sum / self.oversample + 0.5, self.divider_ohm)

    def curvature(self, flex_sum: Floats) -> Floats:
        """Curvature (1/cm) since the zeroing from raw readings (..., n), positive to the left."""
        change = self.resistance(flex_sum) - self.resistance(self.zero_sum)
        return np.asarray(self.scale_per_ohm * change)

    def unzeroed(self, flex_sum: Floats) -> Floats:
        """Raw readings (..., n) in 1/cm from no resistance on: only differences mean something."""
        return np.asarray(self.scale_per_ohm * self.resistance(flex_sum))

    def usable(self, active: Side, masks: int) -> NDArray[np.bool_]:
        """Sensors to localize with while a muscle is inflated.

        The inactive side only (the active side wrinkles), healthy, answering to this bending
        direction, and set in `masks` (the board's everted & settled & zeroed bits).
        """
        sensor = np.arange(len(self.healthy))
        inactive = self.lies != SIGN[active]
        answers = np.isin(self.direction, (0, SIGN[active]))
        named = (masks >> sensor & 1).astype(np.bool_)
        return np.asarray(self.healthy & inactive & answers & named)
