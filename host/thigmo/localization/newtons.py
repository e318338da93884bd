"""Loads in newtons, for a body whose bending stiffness EI is known.

Curvature readings determine loads over EI. A force is known through its moment, so its error
depends on that of the place: the interval of the force across the body covers all places that the
contact may have. A force along the body bends it only where the body is bent already. It is
therefore known far less well, and reported separately. All loads share the error of EI.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from thigmo.localization import priors
from thigmo.localization.validation import Array, Range

_TAIL = 0.5 * (1.0 - priors.LEVEL)
_NEGLIGIBLE = 1e-5  # share of the largest mass below which a cell is left out
_SIGMAS = 10.0  # within which all quantiles of a normal part lie


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number with its 95 % interval."""

    value: float
    interval: Range

    def __str__(self) -> str:
        return f"{self.value:.3g} ({self.interval[0]:.3g} to {self.interval[1]:.3g})"


@dataclass(frozen=True, slots=True)
class Newtons:
    """A contact's load.

    Attributes:
        across: force across the body in newtons, positive towards positive curvature.
        along: force along the body in newtons, positive towards the base, if the likeliest
            explanation is a load on the end; None for a contact on the side, because its friction
            is unknown.
        couple: couple on the end in newtons times the unit of length; None where `along` is.
    """

    across: Quantity
    along: Quantity | None
    couple: Quantity | None


def newtons(
    stiffness: tuple[float, float],
    mass: Array,
    force: Array,
    deviation: Array,
    end_load: tuple[float, ...],
    length: float,
) -> Newtons:
    """Converts a contact's load to newtons.

    Args:
        stiffness: EI, in newtons times the unit of length squared, and its relative standard error.
        mass: (M,) posterior mass of each cell in which the contact may lie.
        force: (M,) mean force in each cell over EI, for a body of length one.
        deviation: (M,) standard deviation of that force.
        end_load: force towards the base and couple, each followed by its standard deviation, over
            EI, for a body of length one; NaN if nothing loads the end.
        length: length of the body.
    """
    bending, error = stiffness
    unit = bending / length**2
    kept = mass > _NEGLIGIBLE * mass.max()
    mean, share = unit * force[kept], mass[kept] / mass[kept].sum()
    wide = np.maximum(np.hypot(unit * deviation[kept], error * mean), 1e-9 * np.abs(mean).max())
    low, middle, high = (_quantile(p, share, mean, wide) for p in (_TAIL, 0.5, 1.0 - _TAIL))
    push, push_wide, couple, couple_wide = end_load
    if np.isnan(push):
        return Newtons(Quantity(middle, (low, high)), None, None)

    def normal(value: float, deviation: float, unit: float) -> Quantity:
        reach = -float(ndtri(_TAIL)) * float(np.hypot(deviation, error * value)) * unit
        return Quantity(value * unit, (value * unit - reach, value * unit + reach))

    return Newtons(
        Quantity(middle, (low, high)),
        normal(push, push_wide, unit),
        normal(couple, couple_wide, unit * length),
    )


def _quantile(probability: float, share: Array, mean: Array, deviation: Array) -> float:
    """The number below which a mixture of normal parts (M,) has this probability."""
    low, high = (mean - _SIGMAS * deviation).min(), (mean + _SIGMAS * deviation).max()

    def excess(value: float) -> float:
        return float(share @ ndtr((value - mean) / deviation)) - probability

    return float(brentq(excess, low, high, xtol=1e-12 * (high - low), rtol=1e-12))
