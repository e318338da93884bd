"""Young sensors while the robot stands still: their value at rest, and how well it is known.

A sensor that has just everted creeps back to its straight reading. Readings of the vented robot
show its creep long before it has died away (`mechanics.settling`), so that a measurement need not
wait: the young sensor counts, from the rest that is predicted for the moment of the measurement,
with the prediction's standard error added to its noise. Shared by the live robot and the replay.
"""

from __future__ import annotations

import numpy as np

from thigmo.link.inbox import TelemetryFrame
from thigmo.mechanics.settling import Settling
from thigmo.robot.curvature import Floats, SensorTable
from thigmo.robot.idle_pressure import VENTED_CPSI
from thigmo.robot.sweep import FRAME_SPACING_S
from thigmo.wiring import Wiring

_BIN_S = 0.25
_STILL_S = 1.5  # after a motion or a bend the body swings for so long
_FIRST_S = 0.5  # after eversion: the fold is still near
_FEWEST = 8  # bins, two seconds
# What calibration leaves open of the decay: its time (relative), and the amplitude of an eversion
# (1/cm; docs/methods.md: most sensors start within some 0.02 of their rest).
_TAU_SE = 0.15
_AMPLITUDE_SD = 0.03


class CreepWatch:
    """Follows telemetry through a run; a raw reading sums `oversample` conversions."""

    def __init__(self, wiring: Wiring, oversample: int) -> None:
        self._table = SensorTable.laid_out(wiring, oversample).board
        self._laws = {
            number: Settling(
                s.settle_tau_s, _TAU_SE * s.settle_tau_s, s.settle_amplitude, _AMPLITUDE_SD
            )
            for number, s in enumerate(wiring.sensors)
            if s
        }
        self._ends = self._table.center_cm + self._table.span_cm / 2
        self._everted_s = np.full(len(self._ends), np.nan)
        self._out = np.ones(len(self._ends), dtype=np.bool_)  # at the start: rested long ago
        self._moved_s = -np.inf
        self._slot = -1
        self._times: list[float] = []
        self._sums: list[tuple[int, ...]] = []

    def telemetry(self, frame: TelemetryFrame) -> None:
        """Take a frame; one in fifty milliseconds is decoded."""
        t_s = frame.device_s
        slot = int(t_s / FRAME_SPACING_S)
        if slot == self._slot:
            return
        self._slot = slot
        row = frame.message
        out = self._ends <= row.length_um / 1e4
        self._everted_s[out & ~self._out] = t_s
        self._out = out
        if row.motor != 0 or max(row.pressure_cpsi) > VENTED_CPSI:
            self._moved_s = t_s
        if t_s - self._moved_s > _STILL_S:
            self._times.append(t_s)
            self._sums.append(row.flex_sum)

    def rest(self, at_s: float, sensors: int) -> tuple[Floats, Floats]:
        """What young sensors of a mask would read of the straight robot, and its standard error.

        (10,) each, at a device time: scale times resistance, 1/cm, as `SensorTable` has them; NaN
        where nothing is known.
        """
        size = len(self._ends)
        value, sigma = np.full(size, np.nan), np.full(size, np.nan)
        times = np.asarray(self._times)
        for i in range(size):
            if i not in self._laws or not sensors >> i & 1 or np.isnan(self._everted_s[i]):
                continue
            age_s = times - self._everted_s[i]
            use = np.flatnonzero((age_s > _FIRST_S) & (times < at_s))
            bins = np.unique((age_s[use] / _BIN_S).astype(int), return_inverse=True)[1]
            if not use.size or bins[-1] + 1 < _FEWEST:
                continue
            sums: Floats = np.array([self._sums[k] for k in use], dtype=np.float64)
            raw = self._table.unzeroed(sums)[:, i]
            count = np.bincount(bins)
            level = float(raw[-1])
            level_at = np.bincount(bins, raw - level) / count
            bin_s = np.bincount(bins, age_s[use]) / count
            noise = float(self._table.noise[i])
            # A second pass lets this eversion's own amplitude carry the doubt about tau.
            law = self._laws[i]
            *_, eversion = law.observe(bin_s, level_at, noise)
            again = Settling(law.tau_s, law.tau_se_s, eversion.amplitude, law.amplitude_sd)
            settled, settled_sd, eversion = again.observe(bin_s, level_at, noise)
            excess, excess_sd = eversion.excess(at_s - self._everted_s[i])
            value[i] = level + settled + float(excess)
            sigma[i] = np.hypot(settled_sd, float(excess_sd))
        return value, sigma

    def curvature(self, flex_sum: Floats, at_s: float, sensors: int) -> tuple[Floats, Floats]:
        """Young sensors' curvature (10,) at a measurement, and its added noise; NaN if unknown."""
        value, sigma = self.rest(at_s, sensors)
        now = self._table.unzeroed(flex_sum)
        return now - value, sigma
