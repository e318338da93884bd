"""What the fit takes: bins of the frames of one side's sweeps, and the errors of calibration.

Arrays only: `thigmo.field.sweeps` makes them of a robot's sweeps and its robot.toml; anyone's own
records can make them as well. Lengths in cm, bends in 1/cm; bends count positive towards the
inflated side.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]


class Stage(NamedTuple):
    """A body that mechanics can compute."""

    length: float  # everted, cm
    body_pressure: int  # its number, which decides the moment that folds the base


@dataclass(frozen=True)
class Readings:
    """n bins of all sweeps of one side, by m sensors. NaN: no reading."""

    curvature: Floats  # (n, m) mean over the bin, 1/cm
    noise: Floats  # (n, m) one sigma of its white noise, 1/cm
    bend: Floats  # (n,) of the free body, by the actuator's map, 1/cm
    rate: Floats  # (n,) of that bend, 1/(cm s)
    stage: Indices  # (n,) index into `stages`
    sweep: Indices  # (n,) number of its sweep, ascending from 0
    zeroing: Indices  # (n,) number of its zeroing, ascending from 0
    stages: tuple[Stage, ...]
    centers: Floats  # (m,) cm
    spans: Floats  # (m,) cm
    fold_moment: Floats  # (pressures,) contact moment over EI that folds the base, 1/cm
    radius: float  # of the tube, cm
    half_range: Floats | None = None  # (n,) half of the range of bends in a bin, 1/cm; None: none
    # (n,) by how much the bend of a pure delay is higher, 1/cm; of a first-order lag as much lower
    response: Floats | None = None
    standing: Floats | None = None  # (n,) share of each bin before what stood there gave way

    def ends_before(self, arc: float) -> int:
        """Number of the everted lengths (cm) at which the body ends before an arc."""
        return len({stage.length for stage in self.stages if stage.length < arc})

    def at_length(self, length: float) -> Readings:
        """The bins of the sweeps at an everted length."""
        kept = np.flatnonzero([stage.length == length for stage in self.stages])
        rows = np.isin(self.stage, kept)

        def renumbered(values: Indices) -> Indices:
            numbers: Indices = np.unique(values[rows], return_inverse=True)[1]
            return numbers

        return replace(
            self, curvature=self.curvature[rows], noise=self.noise[rows], bend=self.bend[rows],
            rate=self.rate[rows], stage=np.searchsorted(kept, self.stage[rows]),
            sweep=renumbered(self.sweep), zeroing=renumbered(self.zeroing),
            stages=tuple(self.stages[n] for n in kept), standing=None,
            half_range=None if self.half_range is None else self.half_range[rows],
            response=None if self.response is None else self.response[rows],
        )  # fmt: skip


@dataclass(frozen=True)
class Errors:
    """One sigma of each error of calibration; `stated` (sweeps.py) reads them off robot.toml.

    Gains and maps drift after a calibration; by how much is weighed: see `fit.SPREAD_STD`.
    """

    gain: Floats  # (m,) of a sensor's scale, relative
    place: Floats  # (m,) of a sensor's centre, cm
    zero: Floats  # (m,) of a sensor's constant while it bends (half its loop), 1/cm
    zero_zeroing: Floats  # (m,) by which that differs from zeroing to zeroing
    zero_sweep: Floats  # (m,) and from sweep to sweep
    map_by_pressure: Floats  # (pressures,) of the map's bend at each body pressure, relative
    map_offset: float  # 1/cm, at each body pressure
    fold: float  # of the moment that folds the base, relative
    base: float = 0.0  # stated compliance of the base, rad for each 1/cm of moment: cm
    base_error: float = 0.0  # cm
    # (m, k) columns of one standard error that sensors share in a sweep, 1/cm
    shared: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    map: float = 0.08  # of the map's bend at all body pressures alike, relative: muscles age
    # (m,) gain against a sensor's `bend_sign`, and its sigma; None: 1 and 0
    against: Floats | None = None
    against_error: Floats | None = None
    sweep: float = 0.01  # of the bend's scale from sweep to sweep, relative
    sweep_offset: float = 3e-4  # 1/cm, from sweep to sweep
    lag_s: float = 0.05  # of the delay from pressure to bend
    bend_bin: float = 3e-4  # 1/cm, of the bend in each bin: the body swings
