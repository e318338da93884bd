"""What a sensor layout can know: the Cramer-Rao bound of contacts along a body.

For a proposed layout: where, and from which force, a contact can be felt, found and told from a
second one. Used to plan robots (`thigmo design`). Small deflections: the bound is a planning
figure, and is one standard deviation of the best unbiased estimate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from thigmo.errors import DataError
from thigmo.localization.influence import STRAIGHT, Sensors, influence
from thigmo.localization.information import arc_bounds
from thigmo.localization.readings import normalise

Array = npt.NDArray[np.float64]

# Signal over noise from which one contact is reported nine times in ten (bench/calibration.py).
DETECTABLE = 4.5


@dataclass(frozen=True, slots=True)
class Identifiability:
    """Bounds of one layout, in the caller's units.

    Attributes:
        arc: (A,) places of one contact.
        moment: (M,) its moment at the base over EI (curvature there), which compares forces
            across places better than the force itself.
        bound: (M, A) standard deviation of the arc; infinite where the readings fix no place.
        signal: (M, A) root of the sum of squared readings over noise: how well it is felt.
        separation: (S,) distances between two opposed contacts, the distal one at the tip.
        pair_bound: (M, S, 2) bounds of the proximal and the distal contact. Their base moments
            are -0.8 and 1 times `moment`.
        length: of the body.
    """

    arc: Array
    moment: Array
    bound: Array
    signal: Array
    separation: Array
    pair_bound: Array
    length: float

    @property
    def detected(self) -> npt.NDArray[np.bool_]:
        """(M, A) whether a contact there is reported nine times in ten."""
        return np.asarray(self.signal > DETECTABLE)

    def table(self) -> list[dict[str, float | bool]]:
        """One row for each place and moment: what a figure or a CSV shows."""
        return [
            {
                "arc": float(arc),
                "moment": float(moment),
                "force": float(moment / arc) if arc > 0.0 else 0.0,
                "bound": float(self.bound[m, a]),
                "signal": float(self.signal[m, a]),
                "detected": bool(self.detected[m, a]),
            }
            for m, moment in enumerate(self.moment)
            for a, arc in enumerate(self.arc)
        ]

    def pair_table(self) -> list[dict[str, float]]:
        """One row for each separation and moment."""
        return [
            {
                "separation": float(gap),
                "moment": float(moment),
                "proximal_bound": float(self.pair_bound[m, s, 0]),
                "distal_bound": float(self.pair_bound[m, s, 1]),
            }
            for m, moment in enumerate(self.moment)
            for s, gap in enumerate(self.separation)
        ]


def identifiability(
    position: npt.ArrayLike,
    *,
    length: float,
    noise: npt.ArrayLike,
    span: npt.ArrayLike = 0.0,
    offset_sigma: float = 0.0,
    arcs: npt.ArrayLike | None = None,
    moments: npt.ArrayLike | None = None,
    separations: npt.ArrayLike | None = None,
) -> Identifiability:
    """Bounds for a proposed layout.

    Args:
        position: (N,) sensor centres.
        length: of the body.
        noise: standard deviation of a reading, scalar or (N,).
        span: scalar or (N,).
        offset_sigma: standard deviation of an error that all readings share.
        arcs: (A,) places to look at; 107 even ones if not given.
        moments: (M,) moments at the base over EI; six from 0.1 to 1.2 over the length if not
            given (0.002 to 0.023 1/cm for 53 cm).
        separations: (S,) of two contacts; twelve even ones if not given.

    Raises:
        DataError: as `localize`; an arc or separation that is not within the length.
    """
    count = np.asarray(position, dtype=np.float64).size
    readings = normalise(np.zeros(count), position, length, span, 0.0, noise)
    scale = readings.length
    places = np.linspace(0.0, 1.0, 107) if arcs is None else _within(arcs, scale, "arcs")
    gaps = (
        np.linspace(1.0, 12.0, 12) / 13.0
        if separations is None
        else _within(separations, scale, "separations")
    )
    strength = (
        np.geomspace(0.1, 1.2, 6)
        if moments is None
        else np.atleast_1d(np.asarray(moments, dtype=np.float64)) * scale
    )
    n = len(readings.y)
    weight = 1.0 / readings.variance
    columns = np.full((n, 1), offset_sigma * scale) if offset_sigma > 0.0 else np.empty((n, 0))
    sensors = Sensors(readings.low, readings.high, STRAIGHT, np.empty((n, 4)))
    bound = np.full((len(strength), len(places)), np.inf)
    signal = np.zeros_like(bound)
    pair = np.full((len(strength), len(gaps), 2), np.inf)
    phi = np.empty(n)
    for a, place in enumerate(places):
        lever = max(float(place), 1e-9)
        influence(float(place), sensors, phi)
        felt = float(np.sqrt(np.sum(weight * phi**2))) / lever
        for m, moment in enumerate(strength):
            signal[m, a] = abs(moment) * felt
            bound[m, a] = arc_bounds(
                np.array([place]),
                np.array([moment / lever]),
                sensors,
                weight,
                columns,
            )[0]
    for s, gap in enumerate(gaps):
        for m, moment in enumerate(strength):
            near = max(1.0 - float(gap), 1e-9)
            pair[m, s] = arc_bounds(
                np.array([near, 1.0]),
                np.array([-0.8 * moment / near, moment]),
                sensors,
                weight,
                columns,
            )
    return Identifiability(
        places * scale, strength / scale, bound * scale, signal, gaps * scale, pair * scale, scale
    )


def _within(values: npt.ArrayLike, length: float, name: str) -> Array:
    out = np.atleast_1d(np.asarray(values, dtype=np.float64)) / length
    if not (np.isfinite(out).all() and (out >= 0.0).all() and (out <= 1.0 + 1e-9).all()):
        raise DataError(f"{name} are not all within the length", "check the units")
    return out
