"""Posteriors over the arc, given what else is known: what a map shows, or that several stages felt
the same peg.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from thigmo.localization import Contact, LocalizeResult
from thigmo.robot.readings import Floats

_LEVEL = 0.95
WIDEST_CM = 10.0  # an interval wider than this is no place: the localizer's own limit
_FLAT = 0.01  # a prior that varies by less says nothing
_SAME_CM = 1.0  # a contact on the end that moves by more is on the side


def cell_masses(result: LocalizeResult, grid: Floats) -> Floats:
    """Posterior mass in the cell around each node of an evenly spaced grid."""
    step = grid[1] - grid[0]
    edges = np.concatenate((grid - 0.5 * step, [grid[-1] + 0.5 * step]))
    below = np.concatenate(([0.0], np.cumsum(result.probability)))
    return np.diff(np.interp(edges, result.edges, below))


def median(arcs: Floats, mass: Floats) -> float:
    """Arc with half of the mass on either side: it errs least on average."""
    half = 0.5 * float(mass.sum())
    return float(np.interp(half, np.cumsum(mass) - 0.5 * mass, arcs))


def expected(
    contact: Contact, bend: Floats, arcs: Floats, mass: Floats, boost: Floats
) -> tuple[Contact, Floats]:
    """A single contact and its posterior, multiplied with a prior over its arc.

    It causes `bend` (K, 2), curvature over arc. The posterior `mass` (n,), of sum one, and the
    prior's density `boost` (n,), of any scale, lie on `arcs` (n,), evenly spaced.
    """
    product = mass * boost
    if float(np.ptp(boost)) < _FLAT * float(boost.max()) or not product.sum() > 0:
        return contact, mass
    product = product / product.sum()
    arc = median(arcs, product)
    low, high = shortest(arcs, product)
    # Few sensors see the difference, so what stays is the moment at the body's base.
    force, offset = contact.force * contact.arc / arc, contact.end_offset
    if offset is not None and arc < contact.arc - _SAME_CM:
        force, offset = float(bend[0, 1]) / arc, None
    certain = contact.status == "localized" or contact.probability > _LEVEL
    placed = replace(
        contact,
        arc=arc,
        force=force,
        interval=(low, high),
        intervals=((low, high),),
        status="localized" if certain and high - low <= WIDEST_CM else "ambiguous",
        end_offset=offset,
    )
    return placed, product


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
    """Posterior over evenly spaced arcs (cm) of stages that felt the same peg, each of sum 1."""
    step = grid[1] - grid[0]
    reach = np.arange(-3 * _SLIDE_CM, 3 * _SLIDE_CM + step / 2, step)
    kernel = np.exp(-0.5 * (reach / _SLIDE_CM) ** 2)
    kernel /= kernel.sum()
    product = np.zeros(len(grid))
    for mass in masses:
        blurred = np.convolve(mass, kernel, mode="same")
        product += np.log(blurred / blurred.sum() * (1 - _FLOOR) + _FLOOR / len(grid))
    # Errors of map and scales are the same at every stage: n of them count as the root of n.
    product = np.exp((product - product.max()) / np.sqrt(len(masses)))
    result: Floats = product / product.sum()
    return result
