"""Localizes contacts from the readings at a sweep's peak, alike in a live run and its replay.

Averages of the ten peak readings of the inactive side's sensors that were everted, settled and
zeroed go to the localizer with the free curvature of the map at the lag-filtered pressure, as the
free response corrects it. What other sweeps and a given map say of the place is the room's to weigh
(`room.py`), so that nothing counts twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from thigmo.config import RobotConfig
from thigmo.contact_status import POINT_ESTIMATE
from thigmo.exploration.prior import boost
from thigmo.exploration.reference import FreeResponse
from thigmo.exploration.room import touch_point
from thigmo.exploration.sighting import (
    LIKELY,
    Sighting,
    arc_grid,
    bend_grid,
    contact_mass,
    median,
)
from thigmo.exploration.workspace import Bend, centreline, common_error, excess_knots, skin_point
from thigmo.field import fold_moment
from thigmo.localization import LocalizeResult, localize
from thigmo.localization.priors import WIDTH_SHARE
from thigmo.mechanics.closed_forms import fold_share
from thigmo.reading_errors import SETTLED
from thigmo.record import Obstacle, Shape
from thigmo.robot import Peak, SensorTable
from thigmo.robot.curvature import Floats
from thigmo.wiring import Wiring

# Least relative standard error of the critical moment, which goes with a pressure set by hand.
_LEAST_FOLD_ERROR = 0.1
_PLACED = ("localized", "ambiguous")


@dataclass(frozen=True, slots=True)
class PeakAnswer:
    """The answer at one peak, a sighting for each contact with a place, and the body's shape."""

    result: LocalizeResult
    sightings: list[Sighting]
    shape: Shape


def localize_peak(
    peak: Peak,
    config: RobotConfig,
    zone: int,
    response: FreeResponse,
    touch: Floats,
    prior: Sequence[Obstacle] = (),
    method: str = "posterior",
) -> PeakAnswer:
    """Localize the contacts behind a peak's readings, at a body-pressure zone.

    `touch` (145,) says where the sweep's first touch began; `prior` are obstacles that are
    expected; `method` is that of `localize`. Raises DataError if no sensor is usable.
    """
    table = SensorTable.of(Wiring.of(config)).warmed(peak.warmth)
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
        noise=np.hypot(table.white, peak.added_noise)[use],
        # The free response has the errors of map, offset and gains among its shared ones.
        offset_error=0.0,
        map_error=0.0,
        gain_error=0.0,
        shared_errors=np.hstack([free.shared_errors, table.shared[use]]),
        **SETTLED,
        critical_curvature=fold_moment(config, zone),
        critical_curvature_error=max(
            body.critical_curvature_se / body.critical_curvature, _LEAST_FOLD_ERROR
        ),
        tube_radius=body.radius_cm,
        stiffness=body.stiffness,
        held_end=False,
        width_limit=WIDTH_SHARE * body.length_cm,
        method=method,
    )
    marginals = result.marginals or (None,) * len(result.contacts)
    found = [
        (contact, marginal)
        for contact, marginal in zip(result.contacts, marginals, strict=False)
        if contact.status == POINT_ESTIMATE
        or (contact.status in _PLACED and contact.probability > LIKELY)
    ]
    if len(found) == 1 and result.bend[0, 1] * peak.free_curvature > 0:
        found = []  # what pulls the body further into its bend is no peg
    fold = result.parameters.get("fold_angle", 0.0)
    centers, spans = table.center_cm[use], table.span_cm[use]
    unfolded = peak.curvature[use] - free.mean - fold * fold_share(centers, spans, body.diameter_cm)
    last = max((contact.arc for contact, _ in found), default=0.0)
    added = np.diag(np.square(peak.added_noise[use]))
    bend = Bend(
        peak.length_cm,
        free.body_curvature,
        excess_knots(centers, unfolded, last),
        fold,
        common_error(last, centers, free.sensor_errors + added),
    )
    seen = fold_share(centers, spans, body.diameter_cm).any()
    if len(found) == 1 and "folded" in result.hypothesis and np.ptp(touch) > 0 and not seen:
        began = median(bend_grid(body.length_cm), touch)
        bend = replace(bend, fold_rad=_unseen_fold(bend, last, touch_point(last, began, peak.side)))
    curve, arcs = centreline(bend), arc_grid(body.length_cm)
    expected = None
    if prior:
        # A peg in the way of a bend pushes against it.
        skin = [
            skin_point(curve, float(arc), -bend.free_curvature, body.radius_cm)[:2] for arc in arcs
        ]
        expected = boost(prior, np.array(skin), bend.length_cm)
    sightings = [
        Sighting(
            peak.side, peak.length_cm, bend, contact, contact_mass(marginal, arcs), touch,
            result.hypothesis, int(use.sum()), alone=len(found) == 1, expected=expected,
        )
        for contact, marginal in found
    ]  # fmt: skip
    return PeakAnswer(result, sightings, Shape(peak.side, peak.pressure_psi, curve.poses(1.0)))


def _unseen_fold(bend: Bend, arc_cm: float, touched: tuple[float, float]) -> float:
    """Angle (rad) of a fold at the base that no sensor lies on.

    What the free body touched stands still, so the fold turns the measured shape back to it.
    """
    x, y, _ = centreline(bend).pose(arc_cm)
    angle = float(np.arctan2(touched[1], touched[0]) - np.arctan2(y, x))
    return angle if angle * bend.free_curvature < 0 else 0.0
