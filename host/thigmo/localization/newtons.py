"""Loads in newtons, for a body whose bending stiffness EI is known.

Readings of curvature tell loads over EI. A force is known through its moment, so its error follows
that of the place: the interval across the body mixes all places that the contact may have. A force
along the body bends it only as far as the body is bent already, so it is known far worse, and is
reported apart. The error of EI is the same in all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from thigmo.localization import priors
from thigmo.localization.validation import Array, Range

_TAIL = 0.5 * (1.0 - priors.LEVEL)
_NEGLIGIBLE = 1e-5  # mass of a cell that moves no end of an interval
_NODES = 256  # of the distribution


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
        along: force along the body in newtons, positive towards the base, of a load on the end by
            the likeliest explanation; None of a contact on the side, whose friction is unknown.
        couple: on the end, in newtons times the unit of length; None as `along`.
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
    """A contact's load.

    Args:
        stiffness: EI, in newtons times the unit of length squared, and its relative standard error.
        mass: (M,) of cells in which the contact may lie.
        force: (M,) mean force there over EI, of a body of length one.
        deviation: (M,) its standard deviation.
        end_load: force towards the base and couple, each followed by its standard deviation; NaN if
            nothing loads the end.
        length: of the body.
    """
    bending, error = stiffness
    unit = bending / length**2
    kept = mass > _NEGLIGIBLE * mass.max()
    mean, share = unit * force[kept], mass[kept] / mass[kept].sum()
    wide = np.maximum(np.hypot(unit * deviation[kept], error * mean), 1e-9 * np.abs(mean).max())
    value = np.linspace((mean - 6.0 * wide).min(), (mean + 6.0 * wide).max(), _NODES)
    below = share @ ndtr((value - mean[:, None]) / np.maximum(wide, 1e-300)[:, None])
    low, middle, high = np.interp((_TAIL, 0.5, 1.0 - _TAIL), below, value).tolist()
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
