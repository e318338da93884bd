"""A string of IMUs behind a bus, as the board's reader reports it: one turn for each span.

Each IMU integrates its heading from a gyro, with noise and a drift of its own. As it passes the
tip, it is turned round by half a turn. The reader encodes the turn between two IMUs as a divider
encodes a resistance, and an IMU that does not answer as an open circuit.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi, radians

import numpy as np
import numpy.typing as npt

from thigmo.config import IMU_CM, RAD_PER_OHM, SAME_IMU_CM, HeadingSensor
from thigmo.emulator.scene import Imu
from thigmo.sensors import imus_of

Floats = npt.NDArray[np.float64]

_LEAST_OHM, _MOST_OHM = 1_000.0, 100_000.0  # that the reader says; beyond would be a broken wire


class ImuString:
    """The IMUs of a robot, each read once a step; random by `rng`."""

    def __init__(
        self,
        parameters: Imu,
        sensors: Sequence[HeadingSensor],
        divider_ohm: float,
        step_s: float,
        rng: np.random.Generator,
    ) -> None:
        self._parameters, self._rng = parameters, rng
        self._step_s, self._divider_ohm = step_s, divider_ohm
        self._arcs, self._imus = imus_of(sensors)
        self._base = self._arcs < SAME_IMU_CM  # no IMU
        count = len(self._arcs)
        self._start_cm = np.array([sensor.ends_cm[0] for sensor in sensors])
        self._span_cm = np.array([sensor.span_cm for sensor in sensors])
        self._scale = np.array([sensor.scale for sensor in sensors])
        self._zero_ohm = np.array([sensor.raw_zero for sensor in sensors])
        self._drift_rad_s = radians(parameters.drift_deg_min) / 60 * rng.standard_normal(count)
        self._drift = np.zeros(count)  # rad
        self._seat = np.zeros(count)  # rad, of this eversion
        self._everted = np.zeros(count, dtype=np.bool_)
        self._zero_rad = np.array([sensor.zero_rad for sensor in sensors])
        # Heading by each IMU, rad. A chain of IMUs joined by spans begins at 0.
        self.headings = np.zeros(count)
        self.hung: set[int] = set()  # IMUs that do not answer, by number

    def counts(self, curvature: Floats, length_cm: float) -> Floats:
        """Advance one step; returns (n,) ideal counts for mean curvatures of everted spans."""
        parameters, rng = self._parameters, self._rng
        everted = np.clip((length_cm - self._arcs) / IMU_CM + 0.5, 0.0, 1.0)  # 0.5: in the tip
        emerged = (everted > 0.5) & ~self._everted
        self._everted = everted > 0.5
        if emerged.any():
            draws = rng.standard_normal(int(emerged.sum()))
            self._seat[emerged] = radians(parameters.seat_deg) * draws
        walk = radians(parameters.walk_deg_root_s) * self._step_s**0.5
        self._drift += self._drift_rad_s * self._step_s + walk * rng.standard_normal(len(everted))
        white = radians(parameters.noise_deg) * rng.standard_normal(len(everted))
        # In the tail an IMU looks back along the body.
        headings = self._drift + self._seat + white + pi * (1.0 - everted)
        headings[self._base] = 0.0
        first, last = headings[self._imus.T]
        turn_of_span = curvature * np.clip(length_cm - self._start_cm, 0.0, self._span_cm)
        turn = turn_of_span / self._scale + last - first
        self.headings = headings.copy()
        for (start, end), bend in sorted(
            zip(self._imus.tolist(), turn_of_span / self._scale + self._zero_rad, strict=True)
        ):
            self.headings[end] += self.headings[start] - headings[start] + bend
        ohm = np.clip(self._zero_ohm + turn / RAD_PER_OHM, _LEAST_OHM, _MOST_OHM)
        counts: Floats = 1024.0 * self._divider_ohm / (self._divider_ohm + ohm)
        counts[np.isin(self._imus, [*self.hung]).any(axis=1)] = 0.0
        return counts

    def imu_at(self, place_cm: float) -> int:
        """Number of the IMU at a place."""
        return int(np.argmin(np.abs(self._arcs - place_cm)))
