"""Posteriors of one contact put together, or cut by what else is known.

`estimate` mixes those of several models by their evidence, keeps to arcs between which the contact
is known to lie, and takes away forces under which the base would fold.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from thigmo.localization import prior
from thigmo.localization.intervals import median, mixed
from thigmo.localization.models import GRID, Fit, MomentLimit

Array = npt.NDArray[np.float64]


def mix(fits: list[Fit]) -> Fit:
    """Average several one-contact posteriors by their scores.

    Where they differ on whether the contact is on the side or on the end, the median of all
    decides, for it errs least on average; the best fit of that kind names the model.
    """
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
    kinds = {fit.end is None for fit in close}
    if len(kinds) > 1:
        arc = median(nodes, total)
        side = arc < 1.0 - prior.CORNER_WIDTH
        best = max((fit for fit in close if (fit.end is None) == side), key=lambda fit: fit.score)
    out = replace_fit(best, nodes, total)
    if (len(kinds) > 1 and out.end is None) or not low <= best.arcs[0] <= high:
        out.arcs = np.array([arc])
    out.intervals = np.array([[low, high]])
    out.pieces = [pieces]
    return out


# With less of the posterior than this in a range that is known to hold the contact, the readings
# and the models disagree about it: the place is then open within the range.
LEAST_MASS = 0.05


def restrict(fits: list[Fit], low: float, high: float) -> list[Fit]:
    """One-contact posteriors, given that the contact lies between two arcs."""
    out = []
    for fit in fits:
        ends = np.array([low - 1e-9, low, high, high + 1e-9])
        nodes = np.unique(np.concatenate([fit.nodes, ends]))
        logp = np.interp(nodes, fit.nodes, fit.logp, left=-700.0, right=-700.0)
        logp[(nodes < low) | (nodes > high)] = -700.0
        before = float(logp.max())
        arc, start, end, pieces = mixed(nodes, logp, prior.LEVEL)
        part = replace_fit(fit, nodes, logp)
        part.score += before - float(logp.max())
        part.arcs = np.array([arc]) if fit.end is None else fit.arcs
        # Few sensors see the difference, so what stays is the moment at the base.
        part.forces = fit.forces * fit.arcs / part.arcs
        part.intervals = np.array([[start, end]])
        part.pieces = [pieces]
        out.append(part)
    top = max(fit.score for fit in fits)
    held = sum(math.exp(fit.score - top) for fit in out)
    if held >= LEAST_MASS * sum(math.exp(fit.score - top) for fit in fits):
        return out
    best = max((fit for fit in fits if fit.end is None), key=lambda fit: fit.score)
    nodes = np.array([low, high])
    flat = replace_fit(best, nodes, np.full(2, -math.log(high - low)))
    flat.arcs = np.array([0.5 * (low + high)])
    flat.forces = best.forces * best.arcs / flat.arcs
    flat.intervals = nodes[None, :]
    flat.pieces = [np.array([[low, high, 1.0]])]
    return [flat]


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
        math.nan,
        fit.loose,
        fit.stretch,
        fit.penalty,
        None,
        fit.end,
    )


def not_beyond(fit: Fit, limit: MomentLimit) -> Fit:
    """A one-contact posterior without the forces that would fold the base."""
    if fit.node_forces is None:
        return fit
    levers = fit.nodes
    if len(fit.setting.sensors.table):
        heading, x, y = (
            np.interp(fit.nodes, GRID, fit.setting.sensors.table[:, c]) for c in range(3)
        )
        levers = np.cos(heading) * x + np.sin(heading) * y
    logp = np.maximum(fit.logp + limit.log_weight(fit.node_forces * levers), -700.0)
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
