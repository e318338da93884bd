"""One peak's readings to contacts along the body: what the live run and a replay share.

Averages of the ten peak readings of the inactive side's sensors that were everted, settled and
zeroed go to the localizer with the free curvature of the map at the lag-filtered pressure, as the
free response corrects it, and with what earlier sweeps rule out. Its posterior over the arc is then
multiplied with what else is known: what a map shows, or that several stages felt the same peg.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thigmo.config import RobotConfig, Side
from thigmo.display import POINT_ESTIMATE
from thigmo.errors import DataError
from thigmo.exploration.measuring import fold_moment
from thigmo.exploration.prior import boost
from thigmo.exploration.reference import FreeResponse
from thigmo.exploration.workspace import Bend, centreline, excess_knots, skin_point
from thigmo.localization import METHODS, Contact, LocalizeResult, localize
from thigmo.mechanics.closed_forms import fold_share
from thigmo.record import Obstacle, Shape
from thigmo.robot import Peak, SensorTable
from thigmo.robot.readings import Floats

# Least relative standard error of the critical moment, which goes with a pressure set by hand.
_LEAST_FOLD_ERROR = 0.1
_PLACED = ("localized", "ambiguous")
_GRID_CM = 0.25
LIKELY = 0.5  # probability from which a contact that the localizer lists goes on the map
_LEVEL = 0.95
WIDEST_CM = 10.0  # an interval wider than this is no place: the localizer's own limit
_FLAT = 0.01  # a prior that varies by less says nothing
_SAME_CM = 1.0  # a contact on the end that moves by more is on the side
# A peg stands still, and the body slides along it by so much between stages (one sigma, cm).
_SLIDE_CM = 0.7
_FLOOR = 1e-3  # share of a posterior that stays open, for a stage that was wrong altogether


@dataclass(frozen=True, slots=True)
class Felt:
    """One contact that a stage felt: the localizer's, in a body that bends so."""

    side: Side
    length_cm: float
    bend: Bend
    contact: Contact
    mass: Floats  # posterior over the arc, on `arc_grid`
    hypothesis: str
    readings: int  # number of sensors used


@dataclass(frozen=True, slots=True)
class Feeling:
    """What one peak told: the answer, those of its contacts that have a place, and the body."""

    result: LocalizeResult
    felt: list[Felt]
    shape: Shape


def feel(
    peak: Peak,
    config: RobotConfig,
    zone: int,
    response: FreeResponse,
    nearest_arc: float = 0.0,
    prior: Sequence[Obstacle] = (),
    method: str = "posterior",
) -> Feeling:
    """Localize the contacts behind a peak's readings, at a body-pressure zone.

    No contact lies nearer to the base than `nearest_arc` (cm); `prior` are obstacles that are
    expected; `method` is that of `localize`. Raises DataError if no sensor is usable.
    """
    table = SensorTable.of(config)
    use = table.usable(peak.side, peak.sensors) & np.isfinite(peak.curvature)
    body = config.body
    free = response.expected(peak.side, zone, peak.free_curvature, peak.curvature, use)
    result = localize(
        peak.curvature[use],
        table.center_cm[use],
        length=peak.length_cm,
        span=table.span_cm[use],
        free_curvature=free.mean,
        body_curvature=free.body_curvature,
        noise=np.hypot(table.noise, peak.added_noise)[use],
        shared_errors=free.shared_errors,
        critical_curvature=fold_moment(config, zone),
        critical_curvature_error=max(
            body.critical_curvature_se / body.critical_curvature, _LEAST_FOLD_ERROR
        ),
        tube_radius=body.radius_cm,
        width_limit=WIDEST_CM,
        within=(nearest_arc, peak.length_cm) if nearest_arc > 0 else None,
        method=method,
    )
    found = [
        c
        for c in result.contacts
        if c.status == POINT_ESTIMATE or (c.status in _PLACED and c.probability > LIKELY)
    ]
    if len(found) == 1 and result.bend[0, 1] * peak.free_curvature > 0:
        found = []  # what pulls the body further into its bend is no peg
    fold = result.parameters.get("fold_angle", 0.0)
    centers, spans = table.center_cm[use], table.span_cm[use]
    unfolded = peak.curvature[use] - free.mean - fold * fold_share(centers, spans, body.diameter_cm)
    last = max((contact.arc for contact in found), default=0.0)
    bend = Bend(peak.length_cm, free.body_curvature, excess_knots(centers, unfolded, last), fold)
    curve, arcs = centreline(bend), arc_grid(body.length_cm)
    masses = [_mass(result, contact, arcs) for contact in found]
    if prior and len(found) == 1 and found[0].status != POINT_ESTIMATE:
        # A peg in the way of a bend pushes against it.
        skin = [
            skin_point(curve, float(arc), -bend.free_curvature, body.radius_cm)[:2] for arc in arcs
        ]
        likelier = boost(prior, np.array(skin), bend.length_cm)
        found[0], masses[0] = _expected(found[0], result.bend, arcs, masses[0], likelier)
        result = replace(result, status=found[0].status, contacts=tuple(found))
    felt = [
        Felt(peak.side, peak.length_cm, bend, contact, mass, result.hypothesis, int(use.sum()))
        for contact, mass in zip(found, masses, strict=True)
    ]
    return Feeling(result, felt, Shape(peak.side, peak.pressure_psi, curve.poses(1.0)))


def check_method(method: str) -> None:
    """Raises DataError if the localizer has no such method."""
    if method not in METHODS:
        raise DataError(f"unknown method {method!r}", f"use one of {', '.join(METHODS)}")


def arc_grid(full_cm: float) -> Floats:
    """Arcs at which posteriors of different stages are compared, cm."""
    return np.linspace(0.0, full_cm, round(full_cm / _GRID_CM) + 1)


def _mass(result: LocalizeResult, contact: Contact, arcs: Floats) -> Floats:
    """A contact's posterior on the grid: the localizer's own, or a normal one with its interval."""
    if result.status == POINT_ESTIMATE:
        mass = np.ones(len(arcs))
    elif len(result.contacts) == 1:
        mass = _cell_masses(result, arcs)
    else:
        low, high = contact.interval
        deviation = max((high - low) / 3.92, _GRID_CM)
        mass = np.exp(-0.5 * ((arcs - contact.arc) / deviation) ** 2)
    if not mass.sum() > 0:
        mass = np.ones(len(arcs))
    normalised: Floats = mass / mass.sum()
    return normalised


def _cell_masses(result: LocalizeResult, grid: Floats) -> Floats:
    """Posterior mass in the cell around each node of an evenly spaced grid."""
    step = grid[1] - grid[0]
    edges = np.concatenate((grid - 0.5 * step, [grid[-1] + 0.5 * step]))
    below = np.concatenate(([0.0], np.cumsum(result.probability)))
    return np.diff(np.interp(edges, result.edges, below))


def median(arcs: Floats, mass: Floats) -> float:
    """Arc with half of the mass on either side: it errs least on average."""
    half = 0.5 * float(mass.sum())
    return float(np.interp(half, np.cumsum(mass) - 0.5 * mass, arcs))


def _expected(
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
