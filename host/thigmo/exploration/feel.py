"""One peak's readings to contacts along the body: what the live run and a replay share.

Averages of the ten peak readings of the inactive side's sensors that were everted, settled and
zeroed go to the localizer with the free curvature of the map at the lag-filtered pressure, as the
free response corrects it, and with what earlier sweeps rule out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thigmo.config import RobotConfig, Side
from thigmo.exploration.known import WIDEST_CM, cell_masses, expected
from thigmo.exploration.measuring import fold_moment
from thigmo.exploration.prior import PriorMap
from thigmo.exploration.reference import FreeResponse
from thigmo.exploration.workspace import Bend, centreline, excess_knots, skin_point
from thigmo.localization import Contact, LocalizeResult, localize
from thigmo.mechanics.buckling import fold_share
from thigmo.record import Shape
from thigmo.robot import Peak, SensorTable
from thigmo.robot.readings import Floats

_PLACED = ("localized", "ambiguous")
_GRID_CM = 0.25
_BENT = 0.02  # 1/cm, of the body that `warm_up` makes up


@dataclass(frozen=True, slots=True)
class Felt:
    """One contact that a stage felt.

    Attributes:
        side: inflated muscle.
        length_cm: everted length.
        bend: the body's shape at the measurement.
        contact: the localizer's.
        mass: posterior over the arc, on `arc_grid`.
        model: the localizer's.
        readings: number of sensors used.
    """

    side: Side
    length_cm: float
    bend: Bend
    contact: Contact
    mass: Floats
    model: str
    readings: int


@dataclass(frozen=True, slots=True)
class Feeling:
    """What one peak told.

    Attributes:
        result: the localizer's answer.
        felt: those of its contacts that have a place.
        shape: the body at the peak.
    """

    result: LocalizeResult
    felt: list[Felt]
    shape: Shape


def feel(
    peak: Peak,
    config: RobotConfig,
    zone: int,
    response: FreeResponse,
    nearest_arc: float = 0.0,
    prior: PriorMap | None = None,
) -> Feeling:
    """Localize the contacts behind a peak's readings.

    Args:
        peak: the averaged readings.
        config: robot.toml as used.
        zone: index of the body-pressure zone that held.
        response: what each sensor reads of an untouched robot.
        nearest_arc: no contact lies nearer to the base than this (`SweptSpace`), cm.
        prior: where obstacles are expected.

    Raises:
        DataError: no usable sensor.
    """
    table = SensorTable.of(config)
    use = table.usable(peak.side, peak.sensors) & np.isfinite(peak.curvature)
    muscle = config.actuators.side(peak.side)
    free, error = response.expected(peak.side, peak.free_curvature)
    result = localize(
        peak.curvature[use],
        table.center_cm[use],
        length=peak.length_cm,
        span=table.span_cm[use],
        free_curvature=free[use],
        noise=np.sqrt(table.noise**2 + error**2 + peak.added_noise**2)[use],
        offset_sigma=muscle.offset_se,
        critical_curvature=fold_moment(config, zone),
        tube_radius=config.body.radius_cm,
        width_limit=WIDEST_CM,
        within=(nearest_arc, peak.length_cm) if nearest_arc > 0 else None,
    )
    found = [c for c in result.contacts if c.status in _PLACED]
    if len(found) == 1 and result.bend[0, 1] * peak.free_curvature > 0:
        found = []  # what pulls the body further into its bend is no peg
    fold = result.parameters.get("fold_angle", 0.0)
    centers, spans = table.center_cm[use], table.span_cm[use]
    unfolded = (peak.curvature - free)[use] - fold * fold_share(
        centers, spans, config.body.diameter_cm
    )
    last = max((contact.arc for contact in found), default=0.0)
    bent = peak.free_curvature + _common((free - peak.free_curvature)[use])
    bend = Bend(peak.length_cm, bent, excess_knots(centers, unfolded, last), fold)
    if prior is not None and len(found) == 1:
        result = _expected(result, prior, bend, config.body.radius_cm)
        found = list(result.contacts)
    felt = [
        Felt(
            side=peak.side,
            length_cm=peak.length_cm,
            bend=bend,
            contact=contact,
            mass=_mass(result, contact, config.body.length_cm),
            model=result.model,
            readings=int(use.sum()),
        )
        for contact in found
    ]
    shape = Shape(peak.side, peak.pressure_psi, centreline(bend).poses(1.0))
    return Feeling(result, felt, shape)


def _common(departure: Floats) -> float:
    """The part of the sensors' learnt departures from the map (1/cm) that is the body's own bend.

    What all of them show is the map's error, or the lag's, and the body does bend so; a sensor's
    own part is its scale's error. Before learning, both are taken as equally large.
    """
    return float(departure.sum() / (len(departure) + 1))


def _expected(
    result: LocalizeResult, prior: PriorMap, bend: Bend, radius_cm: float
) -> LocalizeResult:
    """The one contact's posterior with a map's obstacles as its prior, through the body's shape."""
    arcs = arc_grid(bend.length_cm)
    curve = centreline(bend)
    # A peg in the way of a bend pushes against it.
    force = -bend.free_curvature
    points = np.array([skin_point(curve, float(arc), force, radius_cm)[:2] for arc in arcs])
    return expected(result, arcs, prior.boost(points, bend.length_cm))


def arc_grid(full_cm: float) -> Floats:
    """Arcs at which posteriors of different stages are compared, cm."""
    return np.linspace(0.0, full_cm, round(full_cm / _GRID_CM) + 1)


def _mass(result: LocalizeResult, contact: Contact, full_cm: float) -> Floats:
    """A contact's posterior on the grid: the localizer's own, or a normal one with its interval."""
    grid = arc_grid(full_cm)
    if len(result.contacts) == 1:
        mass = cell_masses(result, grid)
    else:
        low, high = contact.interval
        deviation = max((high - low) / 3.92, _GRID_CM)
        mass = np.exp(-0.5 * ((grid - contact.arc) / deviation) ** 2)
    if not mass.sum() > 0:
        mass = np.ones(len(grid))
    normalised: Floats = mass / mass.sum()
    return normalised


def warm_up(config: RobotConfig) -> None:
    """Compile everything that `feel` needs, before any output is energised."""
    table = SensorTable.of(config)
    length = config.body.length_cm
    every = (1 << len(table.center_cm)) - 1
    bends: tuple[tuple[Side, float], ...] = (("left", _BENT), ("right", -_BENT))
    for side, free in bends:
        # A bent robot held back at its tip, then also pushed at its middle: every model is weighed.
        one = free * (1 + table.center_cm / length) / 2
        two = one - 1.5 * free * np.maximum(0.4 - table.center_cm / length, 0.0)
        for curvature in (one, two):
            peak = Peak(side, 0.0, length, curvature, free, 0.0, every, 1)
            feel(peak, config, 0, FreeResponse(config))
