"""What each sensor reads when nothing touches: learnt from what the sweeps show before a touch.

A bent robot's reading is the free curvature plus a contact's small share, so one per cent of error
in a sensor's scale or in the actuator map looks like a force, and so does the sensor's own
hysteresis. All of these are the same at every stage, and untouched frames show them. A free reading
is modelled as

    y_i = g + c_i + o + (s + e_i) g,

with a constant c_i of each sensor (its zero; hysteresis keeps to one side while the pressure
rises), the map's offset o and scale s at a body pressure, and each sensor's own gain e_i. All start
at zero with the standard errors that calibration states, widened by what a robot may have changed
since, and each untouched frame sharpens them (Bayesian linear regression). How well sweeps repeat
is learnt as well, from what the model leaves of them; and so is how far a robot has drifted from
its calibration, from how well that explains them. What is still unknown goes to the localizer as
errors that readings share. The thesis compared with the map alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thigmo.config import SIDES, RobotConfig, Side
from thigmo.robot import SensorTable, SweepResult
from thigmo.robot.curvature import Floats
from thigmo.wiring import Wiring

Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]

_LEAST_PSI = 2.5  # below, the regulator is near its live zero
# At a half sweep's start the body swings, and reads up to 2e-3 1/cm less than the map. Where a
# touch leaves low pressures only, that would look like a map too weak by 7 %.
_SWINGS_S = 0.7
_BINS = 10
# Bins of one sweep share its zero and its hysteresis: together they count as this many readings.
_INDEPENDENT = 3.0
# Weight of the stated noise, in readings, against the noise that sweeps show.
_STATED = 12.0
_ZONE_DRIFT = 0.01  # the map drifts almost alike in all zones
# Multiples of the drift of map and gains that are weighed by their evidence, alike beforehand.
_DRIFTS = (0.25, 0.5, 1.0, 2.0)
_LEAST_OFFSET = 8e-4  # 1/cm: no curve through ten pressures is the muscle's own


class FreeReading(NamedTuple):
    """What N sensors would read if nothing touched."""

    mean: Floats  # (N,) 1/cm
    body_curvature: float  # of the free body itself, 1/cm
    shared_errors: Floats  # (N, K) what is unknown of `mean`: columns of one standard deviation
    sensor_errors: Floats  # (N, N) covariance of what the sensors themselves add, 1/cm^2


def scale_errors(config: RobotConfig) -> Floats:
    """Relative standard error of each sensor's scale, (10,); 0 where there is no sensor."""
    return np.array(
        [sensor.gain_error if sensor else 0.0 for sensor in Wiring.of(config).read_sensors]
    )


def gain_errors(config: RobotConfig, drift: float = 1.0) -> Floats:
    """The same, with what a sensor may have changed by since calibration: `drift` times usual.

    1 where there is no sensor: its covariance must have an inverse.
    """
    drifts = np.array(
        [sensor.drift_se if sensor else 1.0 for sensor in Wiring.of(config).read_sensors]
    )
    return np.hypot(scale_errors(config), drift * drifts)


class FreeResponse:
    """Posterior of the constants, the gains and the map's scales, for each inflated side."""

    def __init__(self, config: RobotConfig) -> None:
        self._config = config
        self._table = SensorTable.of(Wiring.of(config))
        self._count = len(self._table.noise)
        zones = len(config.body.zones)
        # Normal equations of (c, e, s, o) for each side.
        size = 2 * (self._count + zones)
        self._scale = 2 * self._count
        self._offset = self._scale + zones
        # Inverse covariance, of each drift.
        self._prior = np.zeros((len(_DRIFTS), len(SIDES), size, size))
        self._matrix = np.zeros((len(SIDES), size, size))
        self._vector = np.zeros((len(SIDES), size))
        self._squared = 0.0  # of the departures, over the stated noise's
        self._readings = 0.0
        self._rows = [SIDES.index(side) for side in config.sides]
        for drift, prior in zip(_DRIFTS, self._prior, strict=True):
            gain = gain_errors(config, drift)
            for row, side in zip(self._rows, config.sides, strict=True):
                muscle = config.muscle(side)
                scale = [np.hypot(each.scale_se, _ZONE_DRIFT) for each in muscle.maps]
                offset = [max(muscle.offset_se, _LEAST_OFFSET)] * zones
                deviation = np.concatenate([self._table.noise, gain, scale, offset])
                covariance = np.diag(deviation**2)
                covariance[: self._count, : self._count] = self._table.covariance
                covariance[self._scale : self._offset, self._scale : self._offset] += (
                    drift * muscle.drift_se
                ) ** 2
                prior[row] = np.linalg.inv(covariance)

    def learn(self, sweep: SweepResult, side: Side, zone: int, below: float = np.inf) -> None:
        """Take the rising half of a sweep's side, as far as nothing was touched.

        That is, up to a free curvature (1/cm, unsigned).
        """
        frames, readings = sweep.half(side)
        if not frames:
            return
        pressure, free, t_s = np.array(
            [(f.pressure_psi, f.free_curvature, f.t_s) for f in frames]
        ).T
        rising = (np.arange(len(free)) <= pressure.argmax()) & (pressure >= _LEAST_PSI)
        rising &= t_s >= t_s[0] + _SWINGS_S
        rising &= np.abs(free) <= below
        row, muscle = SIDES.index(side), self._config.muscle(side)
        warmth = max((peak.warmth for peak in sweep.peaks if peak.side == side), default=1.0)
        errors = self._table.warmed(warmth).covariance
        for part in np.array_split(np.flatnonzero(rising), _BINS):
            if not part.size:
                continue
            g = float(free[part].mean())
            departure = readings[part].mean(axis=0) - g
            use = np.flatnonzero(self._table.usable(side, sweep.sensors) & np.isfinite(departure))
            effect = self._effect(use, zone, g, np.full(use.size, g))
            # What this sweep differs by from others is in all of its readings.
            own = muscle.sweep_offset_se**2 + (muscle.sweep_se * g) ** 2
            weight = _INDEPENDENT / _BINS * np.linalg.inv(errors[np.ix_(use, use)] + own)
            self._matrix[row] += effect.T @ weight @ effect
            self._vector[row] += effect.T @ weight @ departure[use]
            self._squared += float(departure[use] @ weight @ departure[use])
            self._readings += _INDEPENDENT / _BINS * use.size

    def _posterior(self, side: int) -> tuple[Floats, Floats]:
        """Mean (size,) and covariance of a side's unknowns, mixed over the drifts."""
        logs, means, covariances = [], [], []
        own = self._rows.index(side)
        for prior in self._prior[:, self._rows]:
            matrix, vector = self._matrix[self._rows], self._vector[self._rows]
            explained = np.sum(vector * np.linalg.solve(prior + matrix, vector[..., None])[..., 0])
            # Variance of what sweeps scatter by, over the stated noise's.
            left, readings = _STATED + self._squared - explained, _STATED + self._readings
            scatter = float(left / readings)
            precision = prior + matrix / scatter
            mean = np.linalg.solve(precision, vector[..., None])[..., 0] / scatter
            gain = np.sum(mean * vector) / scatter - (_STATED + self._squared) / scatter
            volume = np.linalg.slogdet(prior)[1] - np.linalg.slogdet(precision)[1]
            logs.append(0.5 * (gain + volume.sum() - readings * np.log(scatter)))
            means.append(mean[own])
            covariances.append(np.linalg.inv(precision[own]))
        weight = np.exp(np.array(logs) - max(logs))
        weight /= weight.sum()
        mean = weight @ np.array(means)
        apart = np.array(means) - mean
        spread = np.einsum("d,di,dj->ij", weight, apart, apart)
        return mean, np.einsum("d,dij->ij", weight, np.array(covariances)) + spread

    def _effect(self, sensors: Indices, zone: int, free: float | Floats, reading: Floats) -> Floats:
        """(n, size) what each unknown adds to n readings of sensors."""
        effect = np.zeros((sensors.size, self._matrix.shape[1]))
        rows = np.arange(sensors.size)
        effect[rows, sensors] = 1.0
        effect[rows, self._count + sensors] = reading
        effect[:, self._scale + zone] = free
        effect[:, self._offset + zone] = 1.0
        return effect

    def expected(
        self, side: Side, zone: int, free_curvature: float, curvature: Floats, use: Mask
    ) -> FreeReading:
        """What the sensors in `use` (10,) would read untouched, and the uncertainty of that.

        The free curvature (1/cm) is the map's; of what they read now, `curvature` (10,), a gain's
        error is a share.
        """
        mean, covariance = self._posterior(SIDES.index(side))
        muscle = self._config.muscle(side)
        covariance[self._scale + zone, self._scale + zone] += muscle.sweep_se**2
        covariance[self._offset + zone, self._offset + zone] += muscle.sweep_offset_se**2
        sensors = np.flatnonzero(use)
        effect = self._effect(sensors, zone, free_curvature, curvature[sensors])
        variance, axes = np.linalg.eigh(effect @ covariance @ effect.T)
        own = effect[:, : self._scale]
        return FreeReading(
            free_curvature + effect @ mean,
            free_curvature * (1.0 + float(mean[self._scale + zone]))
            + float(mean[self._offset + zone]),
            axes * np.sqrt(np.maximum(variance, 0.0)),
            own @ covariance[: self._scale, : self._scale] @ own.T,
        )
