"""A side's readings against a prediction: a compiled extension (departures.h, departures.cpp)."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

class Bins:
    """n bins of m sensors, and the effects of one sigma of each of calibration's errors."""

    def __init__(
        self,
        *,
        curvature: Floats,
        deviation: Floats,
        bend: Floats,
        bend_bin: Floats,
        standing: Floats,
        in_bin: Floats,
        stage: NDArray[np.int64],
        on_bend: Floats,
        drifts: NDArray[np.bool_],
        shared: Floats,
        zeros: Floats,
        gain: Floats,
        place: Floats,
        against: Floats,
        against_error: Floats,
        model: float,
        step: float,
        rows: int,
    ) -> None:
        """Keep copies; `FieldFit` explains the arguments. `rows`: of the tables."""

    @property
    def common(self) -> int:
        """Number of the errors of all sensors; those of each sensor follow."""

    @property
    def count(self) -> int:
        """Number of all errors."""

    def bends(self, errors: Floats, spread: float) -> Floats:
        """(n,) bends of the free body as the errors have it, 1/cm."""

    def departures(
        self, mean: Floats, shift: Floats, errors: Floats, spread: float
    ) -> tuple[
        Floats,
        Floats,
        Floats,
        Floats,
        Floats,
        Floats,
        Floats,
        Floats,
        NDArray[np.int32],
        Floats,
        float,
        float,
    ]:
        """What `Departures` of fit.py holds, in its order, by tables and errors."""

def normal_equations(
    common: Floats, separate: Floats, weight: Floats, along: Floats, left: Floats
) -> tuple[Floats, Floats]:
    """Matrix (k, k) and right-hand side (k,) of departures `left` (n, m)."""
