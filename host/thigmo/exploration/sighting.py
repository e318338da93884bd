"""What one sweep shows of the room: where its first touch began, what it felt, what it passed.

A free body bends alike at every length, so the bend at which a touch begins is as good a clue to an
obstacle as its place along the body. Both stay whole posteriors on their way to `room.py`.
Lengths in cm; bends are free curvatures without their sign, in 1/cm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thigmo.config import SIGN, Side
from thigmo.exploration.measuring import held_back
from thigmo.exploration.workspace import Bend
from thigmo.localization import Contact, priors
from thigmo.localization.result import Marginal
from thigmo.robot import TRIGGER_PER_CM, Peak, SweepFrame
from thigmo.robot.curvature import Floats

_GRID_CM = 0.25
LEVEL = 0.95  # of the set that an interval spans, and of what is called sure
# These belong to the trigger and to the base's reading, and so to bodies of all lengths. From a
# touch to the moment at which the base is held back by the trigger's threshold, a touched body
# bends on by this much: 0.005 1/cm over the slope of held-back over free curvature.
TRIGGER_LATE = 0.0042
# One sigma of where a touch began. Over 344 pairs of emulated stages that touched one peg, the two
# differ by 1.7e-4 in half of them and by 5e-4 in one of ten.
_TOUCH_STD = 2.5e-4
# One sigma by which it differs between bodies of two lengths: a share of it, and at least.
BEND_SHARE, BEND_LEAST = 0.02, 2e-4
# The line through these readings of a held base (1/cm) crosses the trigger's threshold.
_LINE_LOW, _LINE_HIGH = 0.0025, 0.0085


@dataclass(frozen=True, slots=True)
class Sighting:
    """One contact that a sweep felt, and the bend of the body in which it did."""

    side: Side  # the inflated muscle
    length_cm: float
    bend: Bend
    contact: Contact  # the localizer's
    mass: Floats  # (n,) its posterior over `arc_grid`, of sum one
    touch: Floats  # (145,) posterior over `bend_grid` of where the sweep's first touch began
    hypothesis: str
    readings: int  # number of sensors used
    alone: bool = True  # the sweep felt no other
    # (n,) density of a given map's obstacles over `arc_grid`, relative to a new one; None: no map
    expected: Floats | None = None

    @property
    def probability(self) -> float:
        """Probability that this contact exists."""
        return self.contact.probability


@dataclass(frozen=True, slots=True)
class Passed:
    """What a sweep passed untouched: up to its touch, or else to its top."""

    side: Side
    length_cm: float
    free: Floats  # (145,) probability that it passed each of `bend_grid` untouched


def arc_grid(full_cm: float) -> Floats:
    """Arcs at which posteriors of different stages are compared, cm."""
    return np.linspace(0.0, full_cm, round(full_cm / _GRID_CM) + 1)


def bend_grid(full_cm: float) -> Floats:
    """(145,) bends at which touches are compared: those that turn the tip by 1.5 to 111 degrees."""
    return np.linspace(5e-4, 0.0365, 145) * (53.0 / full_cm)


def contact_mass(marginal: Marginal | None, arcs: Floats) -> Floats:
    """A contact's likelihood on the grid, of sum one; flat for a point estimate."""
    if marginal is None:
        return np.full(len(arcs), 1 / len(arcs))
    # The prior is taken out, for several sightings share it; the end has one of its own.
    place = 0.5 * (marginal.edges[1:] + marginal.edges[:-1]) / marginal.edges[-1]
    prior = np.where(place < 1.0 - priors.END_CELL, priors.place_density(place), 1.0)
    step = arcs[1] - arcs[0]
    edges = np.concatenate((arcs - 0.5 * step, [arcs[-1] + 0.5 * step]))
    below = np.concatenate(([0.0], np.cumsum(marginal.mass / prior)))
    mass = np.diff(np.interp(edges, marginal.edges, below))
    if not mass.sum() > 0:
        mass = np.ones(len(arcs))
    normalised: Floats = mass / mass.sum()
    return normalised


def touch_mass(frames: Sequence[SweepFrame], side: Side, bends: Floats) -> Floats:
    """Posterior of which of `bends` a side's first touch began at.

    Flat without a trigger, and where it began beyond them all.
    """
    triggered = _triggered_at(frames, side)
    if triggered is None or triggered - TRIGGER_LATE > bends[-1]:
        return np.full(len(bends), 1 / len(bends))
    began = max(triggered - TRIGGER_LATE, float(bends[0]))
    mass = np.exp(-0.5 * ((bends - began) / _TOUCH_STD) ** 2)
    normalised: Floats = mass / mass.sum()
    return normalised


def _triggered_at(frames: Sequence[SweepFrame], side: Side) -> float | None:
    """Bend at which a side's base was held back by the trigger's threshold.

    Frames are a twentieth of a second apart, in which the bend moves by more than its error; the
    line through those around the threshold is finer.
    """
    held = held_back(frames, side)
    over = np.flatnonzero(held > TRIGGER_PER_CM)
    if not over.size:
        return None
    mine = [frame for frame in frames if frame.side == side]
    bend = np.abs([frame.free_curvature for frame in mine])
    against = -SIGN[side]
    first = last = int(over[0])
    while first > 0 and held[first - 1] > _LINE_LOW:
        first -= 1
    while last + 1 < len(mine) and held[last + 1] < _LINE_HIGH and bend[last + 1] > bend[last]:
        last += 1
    excess = against * np.array([frame.excess for frame in mine[first : last + 1]])
    if last - first < 2 or not np.ptp(excess) > 0:
        return float(bend[over[0]])
    slope, intercept = np.polyfit(excess, bend[first : last + 1], 1)
    return float(np.clip(slope * TRIGGER_PER_CM + intercept, bend[first], bend[last]))


def passed_before(touch: Floats, bends: Floats, peak: Peak) -> Passed:
    """What a sweep passed until its touch, of which the posterior over `bends` is known."""
    # What another sweep touched no clearly earlier, this one may have touched.
    free = 1 - np.cumsum(touch)
    clearly = bends * (1 + 2 * BEND_SHARE) + 2 * BEND_LEAST
    return Passed(peak.side, peak.length_cm, np.clip(np.interp(clearly, bends, free), 0.0, 1.0))


def passed_freely(bends: Floats, peak: Peak) -> Passed:
    """What a sweep passed that felt nothing up to its peak."""
    # Of what it touched just before, the trigger does not know.
    top = abs(peak.free_curvature) - TRIGGER_LATE
    return Passed(peak.side, peak.length_cm, np.where(top >= bends, 1.0, 0.0))


def median(arcs: Floats, mass: Floats) -> float:
    """Arc with half of the mass on either side: it errs least on average."""
    half = 0.5 * float(mass.sum())
    return float(np.interp(half, np.cumsum(mass) - 0.5 * mass, arcs))


def shortest(arcs: Floats, mass: Floats) -> tuple[float, float]:
    """Hull of the highest-density set that holds 95 % of the mass; all of it where it is flat."""
    falling = np.sort(mass)[::-1]
    least = falling[min(int(np.searchsorted(np.cumsum(falling), LEVEL)), len(mass) - 1)]
    inside = arcs[mass >= least * (1 - 1e-9)]
    half = 0.5 * (arcs[1] - arcs[0])  # a node stands for the cell around it
    return max(float(inside[0] - half), float(arcs[0])), min(
        float(inside[-1] + half), float(arcs[-1])
    )
