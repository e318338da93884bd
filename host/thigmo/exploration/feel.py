"""One peak's readings to contacts along the body: what the live run and a replay share.

Averages of the ten peak readings of the inactive side's sensors that were everted, settled and
zeroed go to the localizer with the free curvature of the map at the lag-filtered pressure, as the
free response corrects it, and with what earlier sweeps rule out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thigmo.config import RobotConfig, Side
from thigmo.exploration.known import WIDEST_CM, cell_masses, expected
from thigmo.exploration.measuring import fold_moment
from thigmo.exploration.prior import boost
from thigmo.exploration.reference import FreeResponse
from thigmo.exploration.workspace import Bend, centreline, excess_knots, skin_point
from thigmo.localization import Contact, LocalizeResult, localize
from thigmo.mechanics.closed_forms import fold_share
from thigmo.record import Obstacle, Shape
from thigmo.robot import Peak, SensorTable
from thigmo.robot.readings import Floats

# Least relative standard error of the critical moment, which goes with a pressure set by hand.
_LEAST_FOLD_ERROR = 0.1
_PLACED = ("localized", "ambiguous")
_GRID_CM = 0.25
LIKELY = 0.5  # probability from which a contact that the localizer lists goes on the map


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
) -> Feeling:
    """Localize the contacts behind a peak's readings, at a body-pressure zone.

    No contact lies nearer to the base than `nearest_arc` (cm); `prior` are obstacles that are
    expected. Raises DataError if no sensor is usable.
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
    )
    found = [c for c in result.contacts if c.status in _PLACED and c.probability > LIKELY]
    if len(found) == 1 and result.bend[0, 1] * peak.free_curvature > 0:
        found = []  # what pulls the body further into its bend is no peg
    fold = result.parameters.get("fold_angle", 0.0)
    centers, spans = table.center_cm[use], table.span_cm[use]
    unfolded = peak.curvature[use] - free.mean - fold * fold_share(centers, spans, body.diameter_cm)
    last = max((contact.arc for contact in found), default=0.0)
    bend = Bend(peak.length_cm, free.body_curvature, excess_knots(centers, unfolded, last), fold)
    curve, arcs = centreline(bend), arc_grid(body.length_cm)
    masses = [_mass(result, contact, arcs) for contact in found]
    if prior and len(found) == 1:
        # A peg in the way of a bend pushes against it.
        skin = [
            skin_point(curve, float(arc), -bend.free_curvature, body.radius_cm)[:2] for arc in arcs
        ]
        likelier = boost(prior, np.array(skin), bend.length_cm)
        found[0], masses[0] = expected(found[0], result.bend, arcs, masses[0], likelier)
        result = replace(result, status=found[0].status, contacts=tuple(found))
    felt = [
        Felt(peak.side, peak.length_cm, bend, contact, mass, result.hypothesis, int(use.sum()))
        for contact, mass in zip(found, masses, strict=True)
    ]
    return Feeling(result, felt, Shape(peak.side, peak.pressure_psi, curve.poses(1.0)))


def arc_grid(full_cm: float) -> Floats:
    """Arcs at which posteriors of different stages are compared, cm."""
    return np.linspace(0.0, full_cm, round(full_cm / _GRID_CM) + 1)


def _mass(result: LocalizeResult, contact: Contact, arcs: Floats) -> Floats:
    """A contact's posterior on the grid: the localizer's own, or a normal one with its interval."""
    if len(result.contacts) == 1:
        mass = cell_masses(result, arcs)
    else:
        low, high = contact.interval
        deviation = max((high - low) / 3.92, _GRID_CM)
        mass = np.exp(-0.5 * ((arcs - contact.arc) / deviation) ** 2)
    if not mass.sum() > 0:
        mass = np.ones(len(arcs))
    normalised: Floats = mass / mass.sum()
    return normalised
