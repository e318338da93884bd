"""Posteriors over the arc, given what else is known: that a contact lies beyond a certain arc, or
that several stages felt the same peg.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thigmo.localization import LocalizeResult
from thigmo.localization.result import Status
from thigmo.robot.readings import Floats

_NODES = 201
_LEVEL = 0.95
WIDEST_CM = 10.0  # an interval wider than this is no place: the localizer's own limit
# With less of the posterior than this beyond the arc, its slope there says nothing: the readings
# and the model disagree about what is known, and the place is open within it.
_LEAST_MASS = 0.05
_FLAT = 0.01  # a prior that varies by less says nothing


def beyond(result: LocalizeResult, nearest_arc: float, length_cm: float) -> LocalizeResult:
    """Condition a single contact's posterior on its arc being at least `nearest_arc`.

    Args:
        result: of `localize`, with one contact; others are returned as they are.
        nearest_arc: in cm; at most the length.
        length_cm: everted length.
    """
    if len(result.contacts) != 1 or result.contacts[0].interval[0] >= nearest_arc:
        return result
    arcs = np.linspace(nearest_arc, length_cm, _NODES)
    density = np.interp(arcs, result.arcs, result.density)
    step = (length_cm - nearest_arc) / (_NODES - 1)
    if density.sum() * step < _LEAST_MASS:
        density = np.ones(_NODES)
    message = f"beyond {nearest_arc:.1f} cm, for sweeps felt nothing before"
    return _conditioned(result, arcs, density, message)


def expected(result: LocalizeResult, arcs: Floats, boost: Floats) -> LocalizeResult:
    """Multiply a single contact's posterior with a prior over its arc.

    Args:
        result: of `localize`, with one contact; others are returned as they are.
        arcs: (n,) evenly spaced, cm.
        boost: (n,) prior density there, of any scale.
    """
    if len(result.contacts) != 1 or float(np.ptp(boost)) < _FLAT * float(boost.max()):
        return result
    density = np.interp(arcs, result.arcs, result.density, left=0.0, right=0.0) * boost
    if not density.sum() > 0:
        return result
    return _conditioned(result, arcs, density, "with what the map given shows")


def _conditioned(
    result: LocalizeResult, arcs: Floats, density: Floats, message: str
) -> LocalizeResult:
    """A result whose one contact has another posterior, on evenly spaced arcs."""
    contact = result.contacts[0]
    density = density / density.sum()
    arc = float(density @ arcs)
    low, high = shortest(arcs, density)
    # Few sensors see the difference, so what stays is the moment at the body's base.
    force = contact.force * contact.arc / arc
    status: Status = "localized" if high - low <= WIDEST_CM else "ambiguous"
    placed = replace(
        contact, arc=arc, force=force, interval=(low, high), intervals=((low, high),), status=status
    )
    return replace(
        result,
        status=status,
        contacts=(placed,),
        message=f"{result.message}; {message}",
        arcs=arcs,
        density=density / (arcs[1] - arcs[0]),
    )


def shortest(arcs: Floats, mass: Floats) -> tuple[float, float]:
    """Hull of the highest-density set that holds 95 % of the mass; all of it where it is flat."""
    falling = np.sort(mass)[::-1]
    least = falling[min(int(np.searchsorted(np.cumsum(falling), _LEVEL)), len(mass) - 1)]
    inside = arcs[mass >= least * (1 - 1e-9)]
    return float(inside[0]), float(inside[-1])


# A peg stands still, and the body slides along it by so much between stages (one sigma, cm).
_SLIDE_CM = 0.7
_FLOOR = 1e-3  # share of a posterior that stays open, for a stage that was wrong altogether


def fused(grid: Floats, masses: list[Floats]) -> Floats:
    """Posterior over the arc from the posteriors of several stages that felt the same peg.

    Args:
        grid: arcs, evenly spaced, cm.
        masses: on the grid, each with the sum 1.
    """
    step = grid[1] - grid[0]
    reach = np.arange(-3 * _SLIDE_CM, 3 * _SLIDE_CM + step / 2, step)
    kernel = np.exp(-0.5 * (reach / _SLIDE_CM) ** 2)
    kernel /= kernel.sum()
    product = np.ones(len(grid))
    for mass in masses:
        blurred = np.convolve(mass, kernel, mode="same")
        product *= blurred / blurred.sum() * (1 - _FLOOR) + _FLOOR / len(grid)
    result: Floats = product / product.sum()
    return result
