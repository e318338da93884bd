"""One peak's readings to contacts on the map: what the live run and a replay share.

Averages of the ten peak readings of the inactive side's sensors that were everted, settled and
zeroed go to the localizer with the free curvature of the map at the lag-filtered pressure; what it
answers is placed through the bent shape.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thigmo.config import SIDES, RobotConfig
from thigmo.exploration.known import beyond
from thigmo.exploration.measuring import fold_moment
from thigmo.exploration.reference import FreeResponse
from thigmo.exploration.workspace import Bend, centreline, excess_knots, place_contact
from thigmo.localization import LocalizeResult, localize
from thigmo.mechanics.buckling import fold_share
from thigmo.record import MapContact, Shape
from thigmo.robot import Peak, SensorTable

_PLACED = ("localized", "ambiguous")


@dataclass(frozen=True, slots=True)
class Feeling:
    """What one peak told.

    Attributes:
        result: the localizer's answer.
        contacts: those with a place, in the workspace.
        shape: the body at the peak.
    """

    result: LocalizeResult
    contacts: list[MapContact]
    shape: Shape


def feel(
    peak: Peak, config: RobotConfig, zone: int, response: FreeResponse, nearest_arc: float = 0.0
) -> Feeling:
    """Localize the contacts behind a peak's readings and place them.

    Args:
        peak: the averaged readings.
        config: robot.toml as used.
        zone: index of the body-pressure zone that held.
        response: what each sensor reads of an untouched robot.
        nearest_arc: no contact lies nearer to the base than this (`SweptSpace`), cm.

    Raises:
        DataError: no usable sensor.
    """
    table = SensorTable.of(config)
    use = table.usable(peak.side, peak.sensors) & np.isfinite(peak.curvature)
    muscle = config.actuators.side(peak.side)
    expected, error = response.expected(peak.side, peak.free_curvature)
    result = localize(
        peak.curvature[use],
        table.center_cm[use],
        length=peak.length_cm,
        span=table.span_cm[use],
        free_curvature=expected[use],
        noise=np.hypot(table.noise, error)[use],
        offset_sigma=muscle.offset_se,
        critical_curvature=fold_moment(config, zone),
        tube_radius=config.body.radius_cm,
    )
    if nearest_arc > 0:
        result = beyond(result, nearest_arc, peak.length_cm)
    found = [c for c in result.contacts if c.status in _PLACED]
    if len(found) == 1 and found[0].force * peak.free_curvature > 0:
        found = []  # what pulls the body further into its bend is no peg
    fold = result.parameters.get("fold_angle", 0.0)
    centers, spans = table.center_cm[use], table.span_cm[use]
    unfolded = (peak.curvature - expected)[use] - fold * fold_share(
        centers, spans, config.body.diameter_cm
    )
    last = max((contact.arc for contact in found), default=0.0)
    bend = Bend(peak.length_cm, peak.free_curvature, excess_knots(centers, unfolded, last), fold)
    contacts = []
    for contact in found:
        placed = place_contact(
            bend,
            contact.arc,
            contact.force,
            contact.interval,
            radius_cm=config.body.radius_cm,
            curvature_se=muscle.offset_se,
        )
        contacts.append(
            MapContact(
                arc_cm=contact.arc,
                x_cm=placed.x_cm,
                y_cm=placed.y_cm,
                force_per_cm2=contact.force,
                interval_cm=(float(contact.interval[0]), float(contact.interval[1])),
                status=contact.status,
                everted_length_cm=peak.length_cm,
                side=peak.side,
                normal_rad=placed.normal_rad,
                covariance_cm2=placed.covariance_cm2,
                track=placed.track,
                model=result.model,
                readings=int(use.sum()),
            )
        )
    shape = Shape(peak.side, peak.pressure_psi, centreline(bend).poses(1.0))
    return Feeling(result, contacts, shape)


def warm_up(config: RobotConfig) -> None:
    """Compile everything that `feel` needs, before any output is energised."""
    size = len(SensorTable.of(config).center_cm)
    for side in SIDES:
        reading = np.full(size, 0.01 if side == "left" else -0.01)
        feel(
            Peak(side, 0.0, config.body.length_cm, reading, 0.0, 0.0, (1 << size) - 1, 1),
            config,
            0,
            FreeResponse(config),
        )
