"""Creep of a flex sensor after its eversion: fitted, subtracted, and carried as noise.

A tight bend leaves a sensor reading `rest + amplitude * exp(-t / tau)` (thesis: steady after 30 s,
so tau is 6 to 10 s; docs/methods.md). Calibration measures tau and the mean amplitude. In use, the
amplitude of each eversion is estimated while the robot stands still after growing, so readings
can be used long before the 30 s are over.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from thigmo.errors import DataError

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Settling:
    """One sensor's decay law."""

    tau_s: float  # decay time
    tau_se_s: float = 0.0  # standard error of the decay time
    amplitude: float = 0.0  # mean at eversion, 1/cm
    amplitude_sd: float = 0.0  # standard deviation between eversions, 1/cm

    def excess(self, t_s: npt.ArrayLike) -> tuple[Floats, Floats]:
        """Expected creep that remains, and its standard deviation, in 1/cm.

        `t_s` is the time since eversion; the results have its shape.
        """
        t = np.asarray(t_s, dtype=np.float64)
        decay = np.exp(-t / self.tau_s)
        by_tau = self.amplitude * decay * t / self.tau_s**2 * self.tau_se_s
        return self.amplitude * decay, np.hypot(self.amplitude_sd * decay, by_tau)

    def usable_after_s(self, noise: float) -> float:
        """Time since eversion at which `observe` knows the settled value to `noise`; at most 60 s.

        It is given a reading of that noise (1/cm) every 0.25 s, from 1 s after eversion on.
        """
        for end in np.arange(2.0, 60.0, 0.5):
            t = np.arange(1.0, end, 0.25)
            if np.sqrt(self._covariance(t, noise)[0, 0]) < noise:
                return float(end)
        return 60.0

    def observe(
        self, t_s: npt.ArrayLike, reading: npt.ArrayLike, noise: float
    ) -> tuple[float, float, Settling]:
        """Settled value and its standard deviation (1/cm), and the decay law of this eversion.

        The robot must stand still. `t_s` holds times since eversion, `reading` curvatures in 1/cm,
        (n,) each; `noise` is the standard deviation of one reading. Raises DataError for fewer than
        three readings.
        """
        t, y = np.asarray(t_s, dtype=np.float64), np.asarray(reading, dtype=np.float64)
        if t.ndim != 1 or t.shape != y.shape or len(t) < 3:
            raise DataError("settling needs three or more readings", "watch the sensor for longer")
        full, prior = self._design(t, noise)
        target = np.concatenate([y / noise, prior @ np.array([0.0, self.amplitude, 0.0])])
        covariance = self._covariance(t, noise)
        best = covariance @ (full.T @ target)
        tau = float(np.clip(self.tau_s + best[2], 0.3 * self.tau_s, 3 * self.tau_s))
        error, amplitude_sd, tau_se = np.sqrt(np.diag(covariance)).tolist()
        fitted = Settling(tau, tau_se, float(best[1]), amplitude_sd)
        return float(best[0]), error, fitted

    def _design(self, t: Floats, noise: float) -> tuple[Floats, Floats]:
        """Rows for the unknowns rest, amplitude, tau's error; the last two with priors."""
        decay = np.exp(-t / self.tau_s)
        slope = self.amplitude * decay * t / self.tau_s**2
        rows = np.column_stack([np.ones_like(t), decay, slope]) / noise
        prior = np.diag([0.0, 1 / max(self.amplitude_sd, 1e-9), 1 / max(self.tau_se_s, 1e-9)])
        return np.vstack([rows, prior]), prior

    def _covariance(self, t: Floats, noise: float) -> Floats:
        """Covariance (3, 3) of rest, amplitude and tau's error after watching at times t."""
        full, _ = self._design(t, noise)
        return np.asarray(np.linalg.inv(full.T @ full))
