"""What the compiled estimators are given: one frame of readings, noise levels, nodes over the arc.

Tuples of arrays, so that a kernel takes four arguments and not twenty. numba unpacks them when it
compiles; only the crossing from Python costs, some microseconds.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled
from thigmo.localization.influence import Sensors

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


class Frame(NamedTuple):
    """One frame of N readings under one model, in units of the length.

    Attributes:
        y: (N,) readings above the free curvature.
        variance: (N,) noise variance, or its shape when the scale is not known.
        known: whether `variance` is the variance itself.
        columns: (N, Q) nuisance columns times their prior deviations.
        sensors: where they are on which shape.
    """

    y: Array
    variance: Array
    known: bool
    columns: Array
    sensors: Sensors


class Levels(NamedTuple):
    """S noise levels, and the readings at each with the nuisance columns integrated out.

    Attributes:
        sigma: (S,) noise over the frame's `variance`.
        log_prior: (S,) log weight of each.
        flagged: (N,) readings taken for outliers.
        W: (S, N) precision of each reading.
        white: (S, N, Q) columns, whitened by their posterior factor.
        fit: (S, Q) whitened best nuisances without a contact.
        const: (S,) log marginal likelihood without a contact.
    """

    sigma: Array
    log_prior: Array
    flagged: Flags
    W: Array
    white: Array
    fit: Array
    const: Array


class Nodes(NamedTuple):
    """Places along the body, with what one contact there explains.

    Attributes:
        arcs: (M,) ascending.
        logp: (M or more,) log marginal likelihood.
        force: (M or more,) posterior mean of the force.
    """

    arcs: Array
    logp: Array
    force: Array


class Work(NamedTuple):
    """Room for one evaluation.

    Attributes:
        phi: (N,) readings for a unit force.
        t: (Q,) its products with the whitened columns.
        flips: (N + 1,) relative weights of outlier patterns: that of each reading changed, the
            present one last.
    """

    phi: Array
    t: Array
    flips: Array


class Tried(NamedTuple):
    """Up to TOGETHER places at which a force is weighed in one go, and what comes out.

    Attributes:
        arc: (M,) places.
        lever: (M,) moment at the base for a unit force.
        phi: (N, M) readings for a unit force.
        logp: (M,) log marginal likelihood.
        force, variance: (M,) posterior mean and variance of the force.
        flips: (N + 1,) of the first place alone: relative weights of outlier patterns, that of each
            reading changed, the present one last.
        t: (Q, M) room for products of phi with the whitened columns.
        room: (ROWS, M) for sums.
    """

    arc: Array
    lever: Array
    phi: Array
    logp: Array
    force: Array
    variance: Array
    flips: Array
    t: Array
    room: Array


TOGETHER = 64
ROWS = 11


@compiled
def empty_tried(frame: Frame, count: int) -> Tried:
    """Room for `count` places at once."""
    n, q = frame.columns.shape
    m = count
    return Tried(
        np.empty(m),
        np.empty(m),
        np.empty((n, m)),
        np.empty(m),
        np.empty(m),
        np.empty(m),
        np.empty(n + 1),
        np.empty((q, m)),
        np.empty((ROWS, m)),
    )


@compiled
def empty_levels(frame: Frame, sigma: Array, log_prior: Array) -> Levels:
    """Levels to be filled by `prepare_levels`; no reading is flagged."""
    n, q = frame.columns.shape
    levels = sigma.shape[0]
    return Levels(
        sigma,
        log_prior,
        np.zeros(n, dtype=np.bool_),
        np.empty((levels, n)),
        np.empty((levels, n, q)),
        np.empty((levels, q)),
        np.empty(levels),
    )


@compiled
def one_level(levels: Levels, s: int) -> Levels:
    """A single one of the levels."""
    return Levels(
        levels.sigma[s : s + 1],
        levels.log_prior[s : s + 1],
        levels.flagged,
        levels.W[s : s + 1],
        levels.white[s : s + 1],
        levels.fit[s : s + 1],
        levels.const[s : s + 1],
    )


@compiled
def empty_work(frame: Frame) -> Work:
    """Room for evaluations of a frame."""
    n, q = frame.columns.shape
    return Work(np.empty(n), np.empty(q), np.empty(n + 1))
