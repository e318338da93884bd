"""An unknown noise scale as a sum over levels: coarse ones first, finer ones where the mass is."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled
from thigmo.localization.frame import Frame, Levels, Nodes, Tried, one_level
from thigmo.localization.marginal import evaluate_at
from thigmo.localization.prior import BaseMoment

Array = npt.NDArray[np.float64]

# Prior of an unknown noise deviation times the length: 0.032 for flex sensors after averaging,
# 1e-3..1e-2 for fibre gratings.
SIGMA_MEDIAN = 0.01
SIGMA_FACTOR = 6.0
# Levels are first searched this many times farther apart.
COARSER = 3.0


@compiled
def coarse_levels(frame: Frame) -> tuple[Array, Array]:
    """Levels of an unknown noise scale over its whole range, COARSER times too far apart.

    A known scale is one level.
    """
    if frame.known:
        return np.ones(1), np.zeros(1)
    y = frame.y
    variance = frame.variance
    most = 0.0
    for i in range(y.shape[0]):
        most = max(most, abs(y[i]) / np.sqrt(variance[i]))
    top = np.log(max(3.0 * most, 1e-7))
    bottom = np.log(max(1e-5 * most, 1e-9))
    return levels_between(bottom, top, COARSER * level_step(y.shape[0]))


@compiled
def all_levels(frame: Frame) -> tuple[Array, Array]:
    """As `coarse_levels`, at full resolution."""
    sigma, log_prior = coarse_levels(frame)
    if frame.known:
        return sigma, log_prior
    step = level_step(frame.y.shape[0])
    return levels_between(np.log(sigma[0]), np.log(sigma[-1]), step)


@compiled
def level_step(n: int) -> float:
    """Spacing of log noise levels that resolves what N readings can tell."""
    return min(0.35, 1.3 / math.sqrt(n))


@compiled
def levels_between(bottom: float, top: float, step: float) -> tuple[Array, Array]:
    """Noise levels and their log prior weights.

    Prior of sigma times length: log-normal, median SIGMA_MEDIAN, a factor SIGMA_FACTOR a
    deviation.
    """
    count = int((top - bottom) / step) + 2
    sigma = np.empty(count)
    log_prior = np.empty(count)
    scale = np.log(SIGMA_FACTOR)
    for s in range(count):
        x = bottom + s * step
        sigma[s] = np.exp(x)
        z = (x - np.log(SIGMA_MEDIAN)) / scale
        log_prior[s] = -0.5 * z * z + np.log(step / (scale * np.sqrt(2.0 * np.pi)))
    return sigma, log_prior


@compiled
def finer_levels(value: Array, sigma: Array, n: int) -> tuple[Array, Array]:
    """Levels at full resolution around those whose log weight `value` is within 9 of the best.

    A coarse grid of arcs overstates the noise of a narrow peak, so more room is left below.
    """
    best = value.max()
    first = value.shape[0] - 1
    last = 0
    for s in range(value.shape[0]):
        if value[s] > best - 9.0:
            first = min(first, s)
            last = max(last, s)
    step = level_step(n)
    bottom = np.log(sigma[first]) - 1.5 * COARSER * step
    top = np.log(sigma[last]) + 0.7 * COARSER * step
    return levels_between(bottom, top, step)


@compiled
def level_weights(
    arc: float, frame: Frame, levels: Levels, prior: BaseMoment, tried: Tried
) -> Array:
    """(S,) log likelihood at each level alone, of a contact at an arc."""
    out = np.empty(levels.sigma.shape[0])
    for s in range(out.shape[0]):
        out[s] = evaluate_at(arc, frame, one_level(levels, s), prior, tried, False)
    return out


@compiled
def levels_with_mass(
    nodes: Nodes, frame: Frame, levels: Levels, prior: BaseMoment, tried: Tried
) -> tuple[Array, Array]:
    """Fine noise levels around those that hold weight at some arc of the coarse grid."""
    value = np.full(levels.sigma.shape[0], -1e300)
    count = nodes.arcs.shape[0]
    top = nodes.logp[:count].max()
    for j in range(count):
        if nodes.logp[j] >= top - 30.0:
            part = level_weights(nodes.arcs[j], frame, levels, prior, tried)
            value = np.maximum(value, part)
    return finer_levels(value, levels.sigma, frame.y.shape[0])
