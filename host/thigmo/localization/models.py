"""Mechanics that a scene may need: each is a set of columns and a shape for the same posterior.

Plain beam; levers of the bent body; base fold, free or at its critical moment; tip moment; contact
on the tip's corner with an oblique force; a load spread over a stretch. `estimate` decides which
are called for and compares their evidence. Everything is in units of the length.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from thigmo.localization import prior
from thigmo.localization.influence import (
    STRAIGHT,
    influence,
    sensor_edges,
    shape_table,
)
from thigmo.localization.posterior import mixed, one_contact
from thigmo.localization.readings import Readings
from thigmo.localization.several import PASSES, several

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
        table: (G, 5) shape, no rows for a straight body.
        edges: (N, 4) of the sensors on it.
        moment, spread, log_weight: (K,) prior mixture of the contact's base moment.
    """

    name: str
    columns: Array
    labels: tuple[str, ...]
    scales: tuple[float, ...]
    table: Array
    edges: Array
    moment: Array = field(default_factory=lambda: prior.MOMENT)
    spread: Array = field(default_factory=lambda: prior.SPREAD)
    log_weight: Array = field(default_factory=lambda: prior.LOG_WEIGHT)

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
        edges = sensor_edges(table, readings.low, readings.high)
        return replace(self, name=name, table=table, edges=edges)


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
        loose: whether the readings alone leave a place open.
        stretch: half width of a distributed contact.
        penalty: what `score` is less than the log evidence.
        node_forces: (M,) force over the nodes, of a single contact.
        parameters: further ones, normalised.
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
    loose: bool = False
    stretch: float = 0.0
    penalty: float = 0.0
    node_forces: Array | None = None
    parameters: dict[str, float] = field(default_factory=dict)


def start(readings: Readings, offset: float) -> Setting:
    """The plain beam, with a common offset of deviation `offset` if that is not zero."""
    n = len(readings.y)
    columns = np.full((n, 1), offset) if offset > 0.0 else np.empty((n, 0))
    labels = ("",) if offset > 0.0 else ()
    return Setting(
        "plain beam", columns, labels, (offset,) if labels else (), STRAIGHT, np.empty((n, 4))
    )


def fit_one(readings: Readings, setting: Setting, penalty: float = 0.0) -> Fit:
    """Posterior of one contact."""
    (
        null,
        evidence,
        arc,
        force,
        deviation,
        low,
        high,
        noise,
        misfit,
        pieces,
        nodes,
        logp,
        node_forces,
        flagged,
    ) = one_contact(
        readings.y,
        readings.low,
        readings.high,
        readings.variance,
        readings.known,
        setting.columns,
        setting.table,
        setting.edges,
        setting.moment,
        setting.spread,
        setting.log_weight,
        prior.OUTLIER_ODDS,
        prior.OUTLIER_VARIANCE,
        prior.LEVEL,
    )
    return Fit(
        setting,
        evidence - penalty,
        null,
        np.array([arc]),
        np.array([force]),
        np.array([[low, high]]),
        [pieces],
        nodes,
        logp,
        flagged,
        noise,
        misfit,
        deviation,
        penalty=penalty,
        node_forces=node_forces,
    )


def fit_several(
    readings: Readings,
    setting: Setting,
    contacts: int,
    penalty: float = 0.0,
    stretch: float = 0.0,
    passes: int = PASSES,
) -> Fit:
    """Posterior of up to three contacts (or of one that is spread over a stretch).

    Few `passes` over the grid give the evidence within a fraction of a nat, and rough places.
    """
    (
        evidence,
        arcs,
        forces,
        intervals,
        pieces,
        found,
        nodes,
        density,
        flagged,
        noise,
        loose,
        misfit,
    ) = several(
        contacts,
        readings.y,
        readings.low,
        readings.high,
        readings.variance,
        readings.known,
        setting.columns,
        setting.table,
        setting.edges,
        setting.spread,
        setting.log_weight,
        prior.OUTLIER_ODDS,
        prior.OUTLIER_VARIANCE,
        prior.LEVEL,
        np.zeros(len(readings.y), dtype=np.bool_),
        stretch,
        passes,
    )
    if stretch > 0.0:
        # Nodes near an end stand for stretches that it cuts: report the middle of what is left.
        slope = np.where((nodes < stretch) | (nodes > 1.0 - stretch), 0.5, 1.0)
        density[-1] -= np.log(slope)
        nodes, arcs = _middle(nodes, stretch), _middle(arcs, stretch)
        intervals = _middle(intervals, stretch)
        pieces[:, :, :2] = _middle(pieces[:, :, :2], stretch)
    return Fit(
        setting,
        evidence - penalty,
        np.nan,
        arcs,
        forces,
        intervals,
        [pieces[j, : found[j]] for j in range(contacts)],
        nodes,
        density[-1],
        flagged,
        noise,
        misfit,
        loose=loose > LOOSE_SHARE,
        stretch=stretch,
        penalty=penalty,
    )


# Share of the posterior at places that only the ends of the body bound, from which a fit of
# several contacts is called ambiguous.
LOOSE_SHARE = 0.5


def _middle(arc: Array, stretch: float) -> Array:
    """Middle of the stretch around `arc`, cut at the ends of the body."""
    return np.asarray(0.5 * (np.maximum(arc - stretch, 0.0) + np.minimum(arc + stretch, 1.0)))


def unit_force(arc: float, setting: Setting, readings: Readings, stretch: float = 0.0) -> Array:
    """(N,) readings for a unit force at an arc."""
    return _lever(arc, readings.low, readings.high, setting.table, setting.edges, stretch)


def _lever(
    arc: float, low: Array, high: Array, table: Array, edges: Array, stretch: float
) -> Array:
    out = np.empty(len(low))
    if stretch <= 0.0:
        influence(arc, low, high, table, edges, out)
        return out
    total: Array = np.zeros(len(low))
    half = min(stretch, arc, 1.0 - arc)
    near, far = arc - half, arc + half
    for part in range(8):
        influence(near + (far - near) * (part + 0.5) / 8, low, high, table, edges, out)
        total += out / 8
    return total


def solve_columns(fit: Fit, readings: Readings) -> Array:
    """(Q,) posterior means of the nuisance columns' coefficients, in units of their deviation."""
    columns = fit.setting.columns
    if columns.shape[1] == 0:
        return np.zeros(0)
    residual = readings.y.copy()
    for arc, force in zip(fit.arcs, fit.forces, strict=True):
        residual -= force * unit_force(float(arc), fit.setting, readings, fit.stretch)
    weight = precision(fit, readings)
    gram = np.eye(columns.shape[1]) + columns.T @ (weight[:, None] * columns)
    return np.asarray(np.linalg.solve(gram, columns.T @ (weight * residual)), dtype=np.float64)


def same_side(fit: Fit, readings: Readings) -> float:
    """Log of twice the probability that the last column has the sign of the force.

    What a prior that allows only that sign adds to the log evidence.
    """
    columns = fit.setting.columns
    weight = precision(fit, readings)
    gram = np.eye(columns.shape[1]) + columns.T @ (weight[:, None] * columns)
    deviation = float(np.sqrt(np.linalg.inv(gram)[-1, -1]))
    mean = float(solve_columns(fit, readings)[-1]) * float(np.sign(fit.forces[0]))
    return math.log(max(math.erfc(-mean / deviation / math.sqrt(2.0)), 1e-30))


def precision(fit: Fit, readings: Readings) -> Array:
    """(N,) of the readings under a fit, its outliers widened."""
    level = 1.0 if readings.known else fit.noise**2 / readings.variance.mean()
    variance = readings.variance * level
    out: Array = 1.0 / np.where(fit.flagged, prior.OUTLIER_VARIANCE * variance, variance)
    return out


def bent_shape(fit: Fit, readings: Readings) -> Array:
    """(G, 5) shape of the body under a fit: free curvature, contacts and loads at the tip."""
    table = fit.setting.table
    edges = sensor_edges(table, GRID, GRID)
    curvature = np.full(len(GRID), readings.bend)
    for arc, force in zip(fit.arcs, fit.forces, strict=True):
        curvature += force * _lever(float(arc), GRID, GRID, table, edges, fit.stretch)
    coefficients = solve_columns(fit, readings)
    for label, scale, value in zip(
        fit.setting.labels, fit.setting.scales, coefficients, strict=True
    ):
        if label == "tip_moment":
            curvature += scale * value
        elif label == "tangential_force":
            side = float(np.sign(fit.forces[-1]))
            curvature += scale * value * tangential_column(table, GRID, GRID, side)
    return shape_table(curvature)


def fold_column(readings: Readings, radius: float) -> Array:
    """(N,) average curvature for a base fold of one radian, spread over one body diameter."""
    end = 2.0 * radius
    low = np.maximum(readings.low, 0.0)
    span = readings.high - readings.low
    inside = np.clip(np.minimum(readings.high, end) - low, 0.0, None)
    point = readings.high <= readings.low
    share = np.where(point, readings.low < end, inside / np.where(point, 1.0, span))
    return np.asarray(share / end)


def tangential_column(
    table: Array, low: Array, high: Array, side: float, radius: float = prior.TUBE_RADIUS
) -> Array:
    """(N,) readings for a unit force along the tip's tangent, bearing on its corner.

    Lever: integral of sin(theta(L) - theta(u)) from s to the tip, and the tube's radius, on the
    side opposite to the normal force's direction `side`.
    """
    if len(table) == 0:
        return np.full(len(low), radius * side)
    edges = sensor_edges(table, low, high)
    heading, x, y = table[-1, 0], table[-1, 1], table[-1, 2]
    lever = (x - edges[:, 0]) * np.sin(heading) - (y - edges[:, 1]) * np.cos(heading)
    return np.asarray(lever + radius * side)


def mix(fits: list[Fit]) -> Fit:
    """Average several one-contact posteriors by their scores; the best one names the model."""
    best = max(fits, key=lambda fit: fit.score)
    close = [fit for fit in fits if fit.score > best.score - 4.0]
    if len(close) == 1:
        return best
    nodes = np.unique(np.concatenate([fit.nodes for fit in close]))
    total = np.full(len(nodes), -np.inf)
    for fit in close:
        part = np.interp(nodes, fit.nodes, fit.logp, left=-np.inf, right=-np.inf)
        total = np.logaddexp(total, part + fit.score - best.score)
    total = np.maximum(total, -700.0)
    arc, low, high, pieces = mixed(nodes, total, prior.LEVEL)
    out = replace_fit(best, nodes, total)
    # The best model's own place, unless the others move the mass away from it.
    if not low <= best.arcs[0] <= high:
        out.arcs = np.array([arc])
    out.intervals = np.array([[low, high]])
    out.pieces = [pieces]
    return out


def replace_fit(fit: Fit, nodes: Array, logp: Array) -> Fit:
    """A copy of a fit with another density."""
    return Fit(
        fit.setting,
        fit.score,
        fit.null,
        fit.arcs,
        fit.forces,
        fit.intervals,
        fit.pieces,
        nodes,
        logp,
        fit.flagged,
        fit.noise,
        fit.misfit,
        fit.deviation,
        fit.loose,
        fit.stretch,
        fit.penalty,
        None,
        dict(fit.parameters),
    )


def not_beyond(fit: Fit, critical: float, free: float) -> Fit:
    """A one-contact posterior without the forces that would fold the base.

    Args:
        fit: posterior of a body that is not folded.
        critical: moment over EI at the base at which it folds, times the length.
        free: curvature that counts towards it.
    """
    if fit.node_forces is None:
        return fit
    moment = np.abs(fit.node_forces * fit.nodes + free)
    excess = np.maximum(moment - critical, 0.0) / (prior.CRITICAL_SPREAD * critical)
    logp = np.maximum(fit.logp - 0.5 * np.minimum(excess, 35.0) ** 2, -700.0)
    top = logp.max()
    width = np.diff(fit.nodes)
    mass = np.sum(width * 0.5 * (np.exp(logp[1:] - top) + np.exp(logp[:-1] - top)))
    arc, low, high, pieces = mixed(fit.nodes, logp, prior.LEVEL)
    out = replace_fit(fit, fit.nodes, logp)
    out.score += float(np.log(mass) + top)
    out.arcs = np.array([arc])
    out.forces = np.array([np.interp(arc, fit.nodes, fit.node_forces)])
    out.intervals = np.array([[low, high]])
    out.pieces = [pieces]
    out.node_forces = fit.node_forces
    return out


def at_corner(
    readings: Readings, setting: Setting, fit: Fit, radius: float, penalty: float
) -> Fit | None:
    """An oblique force at the tip's corner; None if its normal part is on the other side."""
    side = float(np.sign(fit.forces[0])) or 1.0
    column = tangential_column(setting.table, readings.low, readings.high, side, radius)
    # The force's direction is anything: its tangential part is of the size of the normal one.
    deviation = prior.TANGENTIAL * abs(float(fit.forces[0]))
    oblique = setting.with_column(
        column, deviation, "tangential_force", "oblique force on the tip's corner"
    )
    out = fit_one(readings, oblique, penalty)
    # The arc is known here: the likelihood at the tip is the evidence.
    at_tip = float(out.logp[-1])
    out.score += at_tip - prior.CORNER_PENALTY
    out.arcs = np.array([1.0])
    out.nodes = np.array([1.0 - prior.CORNER_WIDTH, 1.0])
    # All but flat: denser at the tip itself, so that intervals close there.
    out.logp = -np.log(prior.CORNER_WIDTH) + np.array([-0.05, 0.05])
    out.intervals = np.array([[1.0 - prior.CORNER_WIDTH, 1.0]])
    out.pieces = [np.array([[1.0 - prior.CORNER_WIDTH, 1.0, 1.0]])]
    tip = unit_force(1.0, oblique, readings)
    design = np.column_stack([tip, oblique.columns])
    weight = precision(out, readings)
    ridge = np.eye(design.shape[1])
    ridge[0, 0] = 1e-6
    normal = ridge + design.T @ (weight[:, None] * design)
    solution = np.asarray(
        np.linalg.solve(normal, design.T @ (weight * readings.y)), dtype=np.float64
    )
    out.forces = solution[:1]
    out.misfit = float(np.sum(weight * (readings.y - design @ solution) ** 2))
    along = float(solution[-1]) * deviation
    out.node_forces = np.full(2, solution[0])
    out.parameters["tangential_force"] = along
    # Its line passes beside the centreline: a moment at the tip.
    out.parameters["tip_moment"] = along * radius * side
    # A peg can only push the tip back; what pulls is attached to it, which is rare.
    if along > 0.0:
        out.score -= prior.PULL_PENALTY
    return out if solution[0] * side > 0.0 else None
