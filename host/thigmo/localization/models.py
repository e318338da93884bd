"""Mechanics that a scene may need: each is a set of columns and a shape for the same posterior.

Plain beam; levers of the bent body; base fold, free or at its critical moment; tip moment; a load
spread over a stretch. Contacts on the end of the body are in `tip.py`. `estimate` decides which
are called for and compares their evidence. Everything is in units of the length.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from thigmo.localization import prior
from thigmo.localization.frame import Frame
from thigmo.localization.influence import (
    STRAIGHT,
    Sensors,
    end_influence,
    influence,
    sensors_on,
    shape_table,
)
from thigmo.localization.pair_grid import limit_of_two
from thigmo.localization.posterior import one_contact
from thigmo.localization.prior import BaseMoment
from thigmo.localization.readings import Readings
from thigmo.localization.several import several, several_evidence

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

GRID = np.linspace(0.0, 1.0, 129)


@dataclass(frozen=True, slots=True)
class Setting:
    """What is assumed before the contacts: shape, nuisance columns, prior of the base moment.

    Attributes:
        name: what `result.model` says.
        columns: (N, Q) columns times their prior deviations.
        labels: (Q,) parameter name of each column, "" for one that is not reported.
        scales: (Q,) those prior deviations.
        sensors: N of them on the assumed shape.
        moment: prior of the contact's base moment.
    """

    name: str
    columns: Array
    labels: tuple[str, ...]
    scales: tuple[float, ...]
    sensors: Sensors
    moment: BaseMoment = prior.BASE_MOMENT

    def with_column(self, column: Array, scale: float, label: str, name: str) -> Setting:
        """One more linear unknown."""
        return replace(
            self,
            name=f"{self.name} + {name}",
            columns=np.column_stack([self.columns, scale * column]),
            labels=(*self.labels, label),
            scales=(*self.scales, scale),
        )

    def bent(self, table: Array, readings: Readings) -> Setting:
        """The same on another shape."""
        name = self.name.replace("plain beam", "bent-shape levers")
        return replace(self, name=name, sensors=sensors_on(table, readings.low, readings.high))

    def frame(self, readings: Readings) -> Frame:
        """Readings under these assumptions, as the compiled estimators take them."""
        return Frame(readings.y, readings.variance, readings.known, self.columns, self.sensors)


@dataclass(frozen=True, slots=True)
class End:
    """What a force on the end of the body adds to its normal part at the tip (`tip.py`).

    Attributes:
        tangential: force along the tangent at the tip, negative towards the base.
        couple: of it about the centreline, as tangential force times offset over radius.
        offset: where it bears, left of the centreline.
        radius: of the tube.
    """

    tangential: float
    couple: float
    offset: float
    radius: float


@dataclass(frozen=True, slots=True)
class MomentLimit:
    """The base moment over EI beyond which a body folds, known to `prior.CRITICAL_SPREAD`.

    Attributes:
        critical: that moment, times the length.
        free: curvature that counts towards it.
    """

    critical: float
    free: float

    def log_weight(self, moment: Array) -> Array:
        """Log weight of base moments in a body that is not folded."""
        beyond = np.maximum(np.abs(moment + self.free) - self.critical, 0.0)
        excess = beyond / (prior.CRITICAL_SPREAD * self.critical)
        return np.asarray(-0.5 * np.minimum(excess, 35.0) ** 2)


@dataclass(slots=True)
class Fit:
    """One model's posterior.

    Attributes:
        setting: the model.
        score: log evidence less the model's penalty.
        null: log evidence without contact under the same columns.
        arcs, forces: (C,).
        intervals: (C, 2).
        pieces: for each contact (M, 3) modes.
        nodes, logp: (M,) posterior of the last contact's arc.
        flagged: (N,) outliers.
        noise: of one reading.
        misfit: sum of squared residuals over variance.
        deviation: of the force of a single contact.
        bound: Cramer-Rao bound of its arc from the readings alone; NaN if not worked out.
        loose: whether the readings alone leave a place open.
        stretch: half width of a distributed contact.
        penalty: what `score` is less than the log evidence.
        node_forces: (M,) force over the nodes, of a single contact.
        end: what a contact on the end of the body adds.
    """

    setting: Setting
    score: float
    null: float
    arcs: Array
    forces: Array
    intervals: Array
    pieces: list[Array]
    nodes: Array
    logp: Array
    flagged: Flags
    noise: float
    misfit: float
    deviation: float = 0.0
    bound: float = math.nan
    loose: bool = False
    stretch: float = 0.0
    penalty: float = 0.0
    node_forces: Array | None = None
    end: End | None = None


def start(readings: Readings, offset: float, rich: bool) -> Setting:
    """The plain beam, with a common offset of deviation `offset` if that is not zero.

    With `rich` mechanics a body that actuation bends has the levers of that bend from the start.
    """
    n = len(readings.y)
    columns = np.full((n, 1), offset) if offset > 0.0 else np.empty((n, 0))
    labels = ("",) if offset > 0.0 else ()
    sensors = Sensors(readings.low, readings.high, STRAIGHT, np.empty((n, 4)))
    plain = Setting("plain beam", columns, labels, (offset,) if labels else (), sensors)
    if not rich or abs(readings.bend) < prior.BEND:
        return plain
    return plain.bent(shape_table(np.full(len(GRID), readings.bend)), readings)


def fit_one(readings: Readings, setting: Setting, penalty: float = 0.0) -> Fit:
    """Posterior of one contact."""
    found = one_contact(setting.frame(readings), setting.moment)
    return Fit(
        setting,
        found.evidence - penalty,
        found.null,
        np.array([found.arc]),
        np.array([found.force]),
        np.array([[found.low, found.high]]),
        [found.pieces],
        found.nodes.arcs,
        found.nodes.logp,
        found.flagged,
        found.noise,
        found.misfit,
        found.deviation,
        found.bound,
        penalty=penalty,
        node_forces=found.nodes.force,
    )


def fit_several(
    readings: Readings,
    setting: Setting,
    contacts: int,
    penalty: float = 0.0,
    stretch: float = 0.0,
) -> Fit:
    """Posterior of up to three contacts (or of one that is spread over a stretch)."""
    found = several(contacts, setting.frame(readings), setting.moment, stretch)
    nodes, arcs, intervals, pieces = found.nodes, found.arcs, found.intervals, found.pieces
    density = found.density[-1]
    if stretch > 0.0:
        # Nodes near an end stand for stretches that it cuts: report the middle of what is left.
        slope = np.where((nodes < stretch) | (nodes > 1.0 - stretch), 0.5, 1.0)
        density = density - np.log(slope)
        nodes, arcs = _middle(nodes, stretch), _middle(arcs, stretch)
        intervals = _middle(intervals, stretch)
        pieces[:, :, :2] = _middle(pieces[:, :, :2], stretch)
    return Fit(
        setting,
        found.evidence - penalty,
        np.nan,
        arcs,
        found.forces,
        intervals,
        [pieces[j, : found.modes[j]] for j in range(contacts)],
        nodes,
        density,
        found.flagged,
        found.noise,
        found.misfit,
        loose=found.loose > LOOSE_SHARE,
        stretch=stretch,
        penalty=penalty,
    )


def evidence_of(contacts: int, readings: Readings, setting: Setting) -> float:
    """Log evidence of two or three contacts, to a fraction of a nat."""
    return several_evidence(contacts, setting.frame(readings), setting.moment)


def two_at_most(readings: Readings, one: Fit) -> float:
    """What the log evidence of two contacts cannot pass; inf where only a look at them can tell."""
    setting = one.setting
    return limit_of_two(setting.frame(readings), setting.moment, one.misfit, one.flagged)


# Share of the posterior at places that only the ends of the body bound, from which a fit of
# several contacts is called ambiguous.
LOOSE_SHARE = 0.4


def _middle(arc: Array, stretch: float) -> Array:
    """Middle of the stretch around `arc`, cut at the ends of the body."""
    return np.asarray(0.5 * (np.maximum(arc - stretch, 0.0) + np.minimum(arc + stretch, 1.0)))


def unit_force(arc: float, sensors: Sensors, stretch: float = 0.0) -> Array:
    """(N,) readings for a unit force at an arc, or spread evenly over a stretch around it."""
    out = np.empty(len(sensors.low))
    if stretch <= 0.0:
        influence(arc, sensors, out)
        return out
    total: Array = np.zeros(len(out))
    half = min(stretch, arc, 1.0 - arc)
    near, far = arc - half, arc + half
    for part in range(4):
        influence(near + (far - near) * (part + 0.5) / 4, sensors, out)
        total += out / 4
    return total


def solve_columns(fit: Fit, readings: Readings) -> Array:
    """(Q,) posterior means of the nuisance columns' coefficients, in units of their deviation."""
    columns = fit.setting.columns
    if columns.shape[1] == 0:
        return np.zeros(0)
    residual = readings.y - contact_readings(fit, readings.low, readings.high)
    weight = precision(fit, readings)
    gram = np.eye(columns.shape[1]) + columns.T @ (weight[:, None] * columns)
    return np.asarray(np.linalg.solve(gram, columns.T @ (weight * residual)), dtype=np.float64)


def same_side(fit: Fit, readings: Readings) -> float:
    """Log of twice the probability that the last column has the sign of the contact's moment.

    What a prior that allows only that sign adds to the log evidence.
    """
    columns = fit.setting.columns
    weight = precision(fit, readings)
    gram = np.eye(columns.shape[1]) + columns.T @ (weight[:, None] * columns)
    deviation = float(np.sqrt(np.linalg.inv(gram)[-1, -1]))
    base = np.zeros(1)
    side = float(np.sign(contact_readings(fit, base, base)[0]))
    mean = float(solve_columns(fit, readings)[-1]) * side
    return math.log(max(math.erfc(-mean / deviation / math.sqrt(2.0)), 1e-30))


def precision(fit: Fit, readings: Readings) -> Array:
    """(N,) of the readings under a fit, its outliers widened."""
    if readings.known and not fit.flagged.any():
        return 1.0 / readings.variance
    level = 1.0 if readings.known else fit.noise**2 / readings.variance.mean()
    variance = readings.variance * level
    out: Array = 1.0 / np.where(fit.flagged, prior.OUTLIER_VARIANCE * variance, variance)
    return out


def contact_readings(fit: Fit, low: Array, high: Array) -> Array:
    """(N,) readings that a fit's contacts cause in sensors from `low` to `high`."""
    sensors = sensors_on(fit.setting.sensors.table, low, high)
    out: Array = np.zeros(len(low))
    for arc, force in zip(fit.arcs, fit.forces, strict=True):
        out += force * unit_force(float(arc), sensors, fit.stretch)
    if fit.end is not None:
        parts, _ = end_influence(sensors, fit.end.radius)
        out += fit.end.tangential * parts[1] + fit.end.couple * parts[2]
    return out


def contact_curvature(fit: Fit, readings: Readings) -> Array:
    """(G,) curvature over GRID that contacts and loads at the tip cause, without a base fold."""
    out = contact_readings(fit, GRID, GRID)
    for label, scale, value in zip(
        fit.setting.labels, fit.setting.scales, solve_columns(fit, readings), strict=True
    ):
        if label == "tip_moment":
            out += scale * value
    return out


def bent_shape(fit: Fit, readings: Readings) -> Array:
    """(G, 5) shape of the body under a fit: free curvature, contacts and loads at the tip."""
    return shape_table(readings.bend + contact_curvature(fit, readings))


def fold_column(readings: Readings, radius: float) -> Array:
    """(N,) average curvature for a base fold of one radian, spread over one body diameter."""
    end = 2.0 * radius
    low = np.maximum(readings.low, 0.0)
    span = readings.high - readings.low
    inside = np.clip(np.minimum(readings.high, end) - low, 0.0, None)
    point = readings.high <= readings.low
    share = np.where(point, readings.low < end, inside / np.where(point, 1.0, span))
    return np.asarray(share / end)
