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
LIKELY = 0.5  # probability from which a contact that the localizer lists goes on the map
# These belong to the trigger and to the base's reading, and so to bodies of all lengths. From a
# touch to the moment at which the base is held back by the trigger's threshold, a touched body
# bends on by this much: 0.005 1/cm over the slope of held-back over free curvature.
TRIGGER_LATE = 0.0042
# One sigma by which it differs between bodies of two lengths: a share of it, and at least.
BEND_SHARE, BEND_LEAST = 0.02, 2e-4
# From the touch on the base is held back by so much of what the free body bends on, with one sigma:
# 1.5 (1 - x / s) for the base's reading at x and a contact at s, that of a thin beam.
_SLOPE, _SLOPE_STD = 1.25, 0.25
_TILT = 0.09  # one sigma of the slope before it: errors of the map and of the base's gain
_SLIDES = 0.01  # 1/cm of held-back base from which the contact may slide, or the base fold
_ALIKE = 3.0  # frames that count as one: swings and hysteresis last longer than a frame
_STATED = 4.0  # weight of the stated noise, in such frames


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


def touch_mass(
    frames: Sequence[SweepFrame], side: Side, bends: Floats, noise_per_cm: float
) -> Floats:
    """Posterior of which of `bends` a side's first touch began at; flat if nothing was touched.

    Over the free curvature, what holds the base back is a line, which the errors of the free body
    and of the base's zero make, and a steeper one from the touch on. Both lines and the noise, of
    which one sigma is stated, are integrated out. Something was touched if two lines are likelier
    than one: to 95 %, or at all where the base was held back by the trigger's threshold.
    """
    flat = np.full(len(bends), 1 / len(bends))
    held = held_back(frames, side)
    if not len(held):
        return flat
    mine = [frame for frame in frames if frame.side == side]
    end = min([len(held) - 1, *np.flatnonzero(held > _SLIDES)[:1]]) + 1
    bend = np.abs([frame.free_curvature for frame in mine[:end]])
    beyond = np.concatenate([bends, bends + bends[-1], [bend.max()]])  # the last: no touch
    further = np.maximum(bend - beyond[:, None], 0.0)
    effect = np.stack([np.ones_like(further), np.broadcast_to(bend, further.shape), further], -1)
    excess = -SIGN[side] * np.array([frame.excess for frame in mine[:end]])
    left = excess - _SLOPE * further
    # In units of the noise.
    prior = np.diag([1.0, noise_per_cm / _TILT, noise_per_cm / _SLOPE_STD]) ** 2
    precision = effect.swapaxes(1, 2) @ effect / _ALIKE + prior
    vector = (left[:, None] @ effect)[:, 0] / _ALIKE
    fitted = np.linalg.solve(precision, vector[..., None])[..., 0]
    explained = np.sum(vector * fitted, axis=1)
    misfit = (np.sum(left**2, axis=1) / _ALIKE - explained) / noise_per_cm**2
    log = -0.5 * (_STATED + end / _ALIKE) * np.log(_STATED + misfit)
    log -= 0.5 * np.linalg.slogdet(precision)[1]
    log[fitted[:, 2] < -_SLOPE] = -np.inf  # no obstacle pulls
    mass = np.exp(log - log.max())
    reached = mass[:-1][beyond[:-1] < bend.max()]
    even = reached.mean() / (reached.mean() + mass[-1]) if reached.size else 0.0
    if not even >= (LIKELY if held.max() > TRIGGER_PER_CM else LEVEL):
        return flat
    inside = mass[: len(bends)] / mass[:-1].sum()
    return np.asarray(inside + (1 - inside.sum()) * flat)


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
