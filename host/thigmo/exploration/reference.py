"""What each sensor reads when nothing touches: learnt from the sweeps that felt nothing.

A bent robot's reading is the free curvature plus a contact's small share, so one per cent of error
in a sensor's scale or in the actuator map looks like a force, and so does the sensor's own
hysteresis. All of these are the same at every stage, and sweeps without contact show them. Each
sensor's free reading is modelled as g + c + s g: a constant c (hysteresis keeps to one side
while the pressure rises) and a share s of g (scale and map). Both start at zero with the standard
errors that calibration states; each free sweep sharpens them (Bayesian linear regression). The
thesis compared with the map alone.
"""

from __future__ import annotations

import numpy as np

from thigmo.config import SIDES, RobotConfig, Side
from thigmo.robot import SensorTable, SweepResult
from thigmo.robot.readings import Floats

_LEAST_PSI = 2.5  # below, the regulator is near its live zero and the body still swings
_BINS = 10
# Bins of one sweep share its zero and its hysteresis: together they count as so many readings.
_INDEPENDENT = 3.0


def scale_errors(config: RobotConfig) -> Floats:
    """Relative standard error of each sensor's scale, (10,); 0 where there is no sensor."""
    made = np.zeros(SensorTable.of(config).healthy.size)
    for first, name in zip((0, made.size // 2), SIDES, strict=True):
        for index, sensor in enumerate(config.sensors.column(name), start=first):
            made[index] = sensor.scale_se
    return made


class FreeResponse:
    """Departure of each sensor's free reading from the map, per side, with its standard error.

    Args:
        config: scales, maps, and what calibration says of their errors.
    """

    def __init__(self, config: RobotConfig) -> None:
        self._table = SensorTable.of(config)
        size = len(self._table.center_cm)
        scale_se = scale_errors(config)
        # Normal equations of (constant, share of g) for each side and sensor.
        self._matrix = np.zeros((len(SIDES), size, 2, 2))
        self._vector = np.zeros((len(SIDES), size, 2))
        for row, name in enumerate(SIDES):
            map_se = max(zone.scale_se for zone in config.actuators.side(name).maps)
            self._matrix[row, :, 0, 0] = 1 / self._table.noise**2
            self._matrix[row, :, 1, 1] = 1 / np.maximum(scale_se**2 + map_se**2, 1e-6)

    def learn(self, sweep: SweepResult, side: Side, below: float = np.inf) -> None:
        """Take the rising half of a sweep's side, as far as nothing was touched.

        Args:
            sweep: any.
            side: of it.
            below: nothing was touched up to this free curvature (1/cm, unsigned).
        """
        mine = np.array([f.side == side for f in sweep.frames], dtype=np.bool_)
        if not mine.any():
            return
        pressure = np.array([f.pressure_psi for f in sweep.frames])[mine]
        free = np.array([f.free_curvature for f in sweep.frames])[mine]
        readings = sweep.curvature[mine]
        rising = (np.arange(len(free)) <= pressure.argmax()) & (pressure >= _LEAST_PSI)
        rising &= np.abs(free) <= below
        row = SIDES.index(side)
        for part in np.array_split(np.flatnonzero(rising), _BINS):
            if not part.size:
                continue
            g = float(free[part].mean())
            departure = readings[part].mean(axis=0) - g
            use = self._table.usable(side, sweep.sensors) & np.isfinite(departure)
            weight = _INDEPENDENT / _BINS / self._table.noise**2
            regressors = np.array([1.0, g])
            for sensor in np.flatnonzero(use):
                self._matrix[row, sensor] += weight[sensor] * np.outer(regressors, regressors)
                self._vector[row, sensor] += weight[sensor] * departure[sensor] * regressors

    def expected(self, side: Side, free_curvature: float) -> tuple[Floats, Floats]:
        """Reading of every sensor of an untouched robot, and its standard error; 1/cm, (10,)."""
        row = SIDES.index(side)
        regressors = np.array([1.0, free_curvature])
        covariance = np.linalg.inv(self._matrix[row])
        estimate = np.einsum("sij,sj->si", covariance, self._vector[row]) @ regressors
        variance = np.einsum("i,sij,j->s", regressors, covariance, regressors)
        return free_curvature + estimate, np.sqrt(variance)
