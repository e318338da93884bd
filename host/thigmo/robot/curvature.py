"""From the board's sums of ADC counts, and a fibre's strains beside them, to curvature.

The divider is 5 V - sensor - pin - R_d - ground, so a mean count m (of 1024) means a resistance
R_d (1024 - m) / m; curvature is the sensor's calibrated scale times the change of resistance since
its last zeroing (thesis, equation 2.4).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from math import nan
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from thigmo.config import SIGN, Side
from thigmo.reading_errors import shared_errors
from thigmo.wiring import Wiring

Floats = NDArray[np.float64]


def mask_of(chosen: NDArray[np.bool_]) -> int:
    """A mask of sensors by input, from one truth value each."""
    return sum(1 << int(sensor) for sensor in np.flatnonzero(chosen))


def in_mask(mask: int) -> list[int]:
    """The sensors whose bits are set in a mask."""
    return [sensor for sensor in range(mask.bit_length()) if mask >> sensor & 1]


Number = TypeVar("Number", float, Floats)
_OPEN_COUNT = 0.75  # mean counts up to which the circuit is open


def _divider_ohm(mean_count: Number, divider_ohm: float) -> Number:
    """Resistance above a divider's fixed resistor, at mean ADC counts of 1024."""
    return divider_ohm * (1024.0 - mean_count) / mean_count


def resistance_ohm(mean_count: Floats, divider_ohm: float) -> Floats:
    """Sensor resistance (ohm) of mean ADC counts; NaN where the circuit is open."""
    with np.errstate(divide="ignore", invalid="ignore"):
        value = _divider_ohm(mean_count, divider_ohm)
    return np.where(mean_count > _OPEN_COUNT, value, np.nan)


@dataclass(frozen=True, slots=True)
class SensorTable:
    """robot.toml's sensors as arrays: by the board's input, and then a fibre's gratings.

    Inputs without a sensor, and gratings that read bends out of the plane, are unhealthy. A raw
    reading is a sum of conversions, or microstrain.
    """

    inputs: int  # of the board
    center_cm: Floats
    span_cm: Floats
    scale: Floats  # 1/cm per ohm, or per microstrain
    noise: Floats  # one sigma of an averaged reading, all included, 1/cm
    white: Floats  # the part of it that is the sensor's own: noise and its zero
    shared: Floats  # (n, k) the rest: columns of one standard error, as `shared_errors` has them
    # side of the body whose muscle wrinkles it: 1 left, -1 right, 0 neither (or no sensor)
    lies: NDArray[np.int64]
    bend_sign: NDArray[np.int64]  # of bends that it answers to; 0: both
    healthy: NDArray[np.bool_]  # mask of sensors to use at all
    radius_cm: float  # of the tube
    divider_ohm: float  # the divider's fixed resistor
    oversample: int  # conversions that a raw reading sums
    zero_sum: Floats  # raw readings at the last zeroing; NaN where there is none
    # time from the gratings' zeros to a reading for which their errors hold, s
    warm_s: float = np.inf
    strained_s: float = -np.inf  # device time at which the gratings were zeroed

    @classmethod
    def laid_out(cls, wiring: Wiring, oversample: int = 16) -> SensorTable:
        """Lay out the robot's sensors in the board's order, without zeros."""
        sensors, config = wiring.read_sensors, wiring.config
        return cls(
            inputs=len(sensors) - len(config.gratings),
            center_cm=np.array([s.center_cm if s else 0.0 for s in sensors]),
            span_cm=np.array([s.span_cm if s else 0.0 for s in sensors]),
            scale=np.array([s.raw_scale if s else 0.0 for s in sensors]),
            noise=np.array([s.reading_se if s else 1.0 for s in sensors]),
            white=np.array([np.hypot(s.noise, s.zero_error) if s else 1.0 for s in sensors]),
            shared=shared_errors(sensors),
            lies=np.array(
                [int(SIGN[s.side]) if s and s.side and s.wrinkles else 0 for s in sensors]
            ),
            bend_sign=np.array([s.bend_sign if s else 0 for s in sensors]),
            healthy=np.array([s is not None and s.usable for s in sensors]),
            radius_cm=config.body.radius_cm,
            divider_ohm=config.board.divider_ohm,
            oversample=oversample,
            zero_sum=np.full(len(sensors), np.nan),
            warm_s=min((grating.warm_s for grating in config.gratings), default=np.inf),
        )

    @property
    def board(self) -> SensorTable:
        """The same, of the board's inputs alone."""
        if self.inputs == len(self.healthy):
            return self
        arrays = (
            entry.name
            for entry in fields(self)
            if isinstance(getattr(self, entry.name), np.ndarray)
        )
        return replace(self, **{name: getattr(self, name)[: self.inputs] for name in arrays})

    @property
    def gratings(self) -> int:
        """The mask of the gratings that have a zero."""
        return mask_of(self.healthy & np.isfinite(self.zero_sum)) >> self.inputs << self.inputs

    def strained(self, t_s: float, strain_ue: Sequence[float]) -> SensorTable:
        """The same with the gratings' zeros of a device time; NaN for none."""
        zeros = dict(enumerate(strain_ue, self.inputs))
        return replace(self.zeroed(zeros), strained_s=t_s)

    def warmth(self, t_s: float) -> float:
        """By how much more than stated the temperature may have changed at a device time."""
        if self.inputs == len(self.healthy):
            return 1.0
        return max(1.0, (t_s - self.strained_s) / self.warm_s)

    def warmed(self, warmth: float) -> SensorTable:
        """The same with the temperature's error scaled by this factor."""
        shared = self.shared.copy()
        shared[self.inputs :] *= warmth
        return replace(self, shared=shared)

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
        """Resistance (ohm) on each input from raw readings (..., n); gratings keep their strain."""
        # A conversion floors, so a count stands for the half above it.
        counts = flex_sum[..., : self.inputs] / self.oversample + 0.5
        ohm = resistance_ohm(counts, self.divider_ohm)
        return np.concatenate([ohm, flex_sum[..., self.inputs :]], axis=-1)

    def curvature(self, flex_sum: Floats) -> Floats:
        """Curvature (1/cm) since the zeroing from raw readings (..., n), positive to the left."""
        change = self.resistance(flex_sum) - self.resistance(self.zero_sum)
        return np.asarray(self.scale * change)

    def board_decoder(self) -> Callable[[Sequence[int]], list[float]]:
        """`curvature` of the board's inputs, as a function that is quick for single readings."""
        scales, divider_ohm, oversample = self.scale.tolist(), self.divider_ohm, self.oversample
        zeros_ohm = self.resistance(self.zero_sum).tolist()[: self.inputs]

        def decode(flex_sum: Sequence[int]) -> list[float]:
            counts = [raw / oversample + 0.5 for raw in flex_sum]
            return [
                scale * (_divider_ohm(count, divider_ohm) - zero_ohm)
                if count > _OPEN_COUNT
                else nan
                for count, scale, zero_ohm in zip(counts, scales, zeros_ohm, strict=False)
            ]

        return decode

    def unzeroed(self, flex_sum: Floats) -> Floats:
        """Raw readings (..., n) in 1/cm from no resistance on: only differences mean something."""
        return np.asarray(self.scale * self.resistance(flex_sum))

    def answers(self, sign: float) -> NDArray[np.bool_]:
        """Sensors (n,) that answer to bends of a sign: 1 to the left, -1 to the right."""
        return np.isin(self.bend_sign, (0, sign))

    def usable(self, active: Side, masks: int) -> NDArray[np.bool_]:
        """Sensors to localize with while a muscle is inflated.

        The inactive side only (the active side wrinkles), healthy, answering to this bending
        direction, and set in `masks` (the board's everted & settled & zeroed bits).
        """
        inactive = self.lies != SIGN[active]
        named = np.array([masks >> n & 1 for n in range(len(self.healthy))], dtype=np.bool_)
        return np.asarray(self.healthy & inactive & self.answers(SIGN[active]) & named)

    def readable(self, active: Side, masks: int, curvature: Floats) -> NDArray[np.bool_]:
        """The usable ones that have a reading: in one frame (n,), or in every one of (m, n)."""
        read = np.isfinite(np.atleast_2d(curvature)).all(axis=0)
        return np.asarray(self.usable(active, masks) & read)
