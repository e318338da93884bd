"""One round obstacle felt through an inflation: a joint fit of all frames, with the peg at rest.

A frame of a few readings cannot tell a force on the face of the end from one on the side farther
back: either bends the body alike. Over an inflation they part, for the peg stands still: where the
body first met it says how hard, and where along its skin, it must bear at every later pressure. So
the unknown is not an arc and a force a frame, but the peg's place in the room, two numbers for all
frames together. `localize_obstacle` weighs every place that the body reaches (`bodies`: rod, fold,
no friction), each as likely as its area of the room. What a lab states of its sensors' noise, and
of errors of their gains and places that stay the same through all frames, is integrated out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from thigmo.errors import DataError
from thigmo.localization import priors
from thigmo.localization.bodies import LENGTH, SHIFTS, Bodies, Inflation, Seen, bodies, seen
from thigmo.localization.readings import everted_length, positive, vector
from thigmo.localization.result import Contact, LocalizeResult, Status

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

# Between two places along the outline, and between two curvatures of touch, so many more; and so
# many more again between those that are no farther than this (in log likelihood) behind the best:
# with many readings one alone would hold most of the posterior.
_FINER = ((2, 8), (5, 2))
_CLOSE = 8.0
# Readings are trusted to no less than what these places resolve, 1/cm of a body of 53 cm.
_LEAST_NOISE = 1e-4
# Radius of a peg over that of the tube, where the caller gives none.
_PEG_RADIUS = 0.6
# Cells of the grid whose best place can only be this far behind (in log likelihood) are left out.
_HOPELESS = 12.0
# Nodes of an error that all readings share, in deviations.
_OFFSETS = np.linspace(-2.5, 2.5, 7)
_BINS = 106  # of the posterior over the arc
_TOGETHER = 512  # places that are weighed at once
# A sensor may be bad in all frames: one in twenty, with ten times the noise.
_BAD_ODDS, _BAD_VARIANCE = 0.05 / 0.95, 100.0


def localize_obstacle(
    curvature: npt.ArrayLike,
    position: npt.ArrayLike,
    *,
    length: float,
    free_curvature: npt.ArrayLike,
    noise: npt.ArrayLike,
    span: npt.ArrayLike = 0.0,
    gain_error: float = 0.0,
    place_error: float = 0.0,
    offset_error: float = 0.0,
    critical_curvature: float | None = None,
    tube_radius: float | None = None,
    peg_radius: float | None = None,
    width_limit: float | None = None,
) -> LocalizeResult:
    """Find the one round obstacle that a body bends into, from all frames of the inflation.

    Lengths in any one unit, curvature in its inverse, as in `localize`.

    Args:
        curvature: (T, N) readings, frames in the order of a rising pressure, also of those before
            the touch; NaN marks a missing one.
        position: (N,) sensor centres.
        length: everted length, the same in all frames.
        free_curvature: (T,) curvature that actuation alone would cause, of one sign.
        noise: standard deviation of a reading, scalar or (N,), independent between frames.
        span: scalar or (N,) sensor lengths.
        gain_error: relative standard deviation of the sensors' gains, each the same in all frames.
        place_error: standard deviation of the sensors' places, likewise.
        offset_error: of an error that all readings of all frames share.
        critical_curvature: as in `localize`; None for a base that does not fold.
        tube_radius: 1.75/53 of the length if not given.
        peg_radius: of the obstacle; 0.6 tube radii if not given.
        width_limit: as in `localize`.

    Returns:
        The contact in the last frame; the peg's centre in `parameters` (`peg_x`, `peg_y`: base at
        the origin, straight body along x).

    Raises:
        DataError: as `localize`; no frame; free curvatures of both signs or none.
    """
    frames = np.asarray(curvature, dtype=np.float64)
    if frames.ndim != 2 or len(frames) == 0:
        raise DataError(f"curvature has shape {frames.shape}", "give (T, N) readings")
    free = np.asarray(free_curvature, dtype=np.float64)
    if free.shape != (len(frames),) or not np.isfinite(free).all():
        raise DataError("free_curvature is not one finite number a frame", "give (T,)")
    turn = float(np.sign(free[-1]))
    if turn == 0.0 or (np.diff(free * turn) <= 0.0).any() or free[0] * turn < 0.0:
        raise DataError("the frames do not bend the body further each", "give a rising pressure")
    gain, place_error = positive(gain_error, "gain_error"), positive(place_error, "place_error")
    offset = positive(offset_error, "offset_error")
    total, count = everted_length(length), frames.shape[1]
    x = vector(position, "position")
    half = 0.5 * np.broadcast_to(vector(span, "span", count), count)
    sigma = np.broadcast_to(vector(noise, "noise", count), count)
    if x.size != count or not ((x >= 0.0) & (x <= total)).all() or not (half >= 0.0).all():
        raise DataError("a sensor is off the body", "check positions, spans and units")
    if np.isinf(frames).any() or not np.isfinite(frames[-1]).any():
        raise DataError("readings are infinite, or the last frame has none", "mark missing by NaN")
    scale = total / LENGTH
    radius = priors.TUBE_RADIUS * LENGTH if tube_radius is None else tube_radius / scale
    inflation = Inflation(
        tuple((free * turn * scale).tolist()),
        radius,
        _PEG_RADIUS * radius if peg_radius is None else peg_radius / scale,
        None if critical_curvature is None else critical_curvature * scale,
    )
    place = place_error / scale
    low, high = (tuple((ends / scale).tolist()) for ends in (x - half, x + half))
    shown = seen(inflation, low, high, place)
    offsets = _OFFSETS if offset > 0.0 else np.zeros(1)
    readings = _Readings(
        turn * frames * scale,
        np.maximum(sigma * scale, _LEAST_NOISE) ** 2,
        gain,
        _normal(SHIFTS if place > 0.0 else np.zeros(1)),
        offsets * offset * scale,
        _normal(offsets),
    )
    limit = priors.WIDTH_SHARE if width_limit is None else width_limit / total
    found = _weigh(bodies(inflation), shown, readings)
    odds = found.evidence - readings.untouched(np.array(inflation.free))
    return _answer(found, odds, inflation, scale, turn, limit, float(np.mean(sigma)))


def _normal(nodes: Array) -> Array:
    """Log weights, of sum one, of a normal density on nodes in deviations."""
    log = -0.5 * nodes**2
    return np.asarray(log - np.logaddexp.reduce(log))


@dataclass(frozen=True, slots=True)
class _Readings:
    """Readings of a body of `LENGTH`, and what is known of the sensors.

    Attributes:
        curvature: (T, N).
        variance: (N,) of a reading.
        gain: relative deviation of a gain.
        shift_weight: (D,) log weights of the nodes of a sensor's place.
        offset, offset_weight: (Q,) nodes of the error that all readings share, and log weights.
    """

    curvature: Array
    variance: Array
    gain: float
    shift_weight: Array
    offset: Array
    offset_weight: Array

    def likelihood(self, shown: Seen, at: Indices, share: Array) -> Array:
        """(K,) of places between the nodes of the table."""
        parts = np.array_split(np.arange(len(at)), max(1, len(at) // _TOGETHER))
        return np.concatenate([
            self._of(_between(shown.mean, at[part], share[part]), shown.blur[tuple(at[part].T)])
            for part in parts
        ])  # fmt: skip

    def _of(self, mean: Array, blur: Array) -> Array:
        """(K,) of K bodies: bad sensors, errors of gains, places, offset integrated out.

        Args:
            mean: (K, T, N, D) what the sensors would read, displaced by each of D shifts.
            blur: (K, N, D) its variance between a shift and the next.
        """
        there = np.isfinite(self.curvature)[:, :, None]
        readings = np.nan_to_num(self.curvature)[:, :, None]
        model = np.where(there, mean, 0.0)
        power = self.gain**2 * (model**2).sum(axis=1)
        count = there.sum(axis=0)
        totals = []
        for offset, weight in zip(self.offset, self.offset_weight, strict=True):
            residual = np.where(there, readings - mean - offset, 0.0)
            square, cross = (residual**2).sum(axis=1), (residual * model).sum(axis=1)
            parts = []
            for factor, log_odds in ((1.0, 0.0), (_BAD_VARIANCE, np.log(_BAD_ODDS))):
                s = self.variance[:, None] * factor + blur
                # A gain's error is common to the frames: a term of rank one.
                common = self.gain**2 / (s + power)
                log = -0.5 * (square - common * cross**2) / s - 0.5 * np.log1p(power / s)
                parts.append(log - 0.5 * count * np.log(s) + log_odds)
            each = np.logaddexp.reduce(np.logaddexp(*parts) + self.shift_weight, axis=-1)
            totals.append(each.sum(axis=-1) + weight)
        return np.asarray(np.logaddexp.reduce(totals, axis=0))

    def untouched(self, free: Array) -> float:
        """Log likelihood of a body that bends freely."""
        shape = (1, *self.curvature.shape, len(self.shift_weight))
        mean = np.broadcast_to(free[:, None, None], shape)
        return float(self._of(mean, np.zeros((1, *shape[2:])))[0])


@dataclass(frozen=True, slots=True)
class _Places:
    """Places that the readings leave, K of them.

    Attributes:
        mass: (K,) posterior, of sum one.
        arc: (K,) of the contact in the last frame.
        peg: (K, 2) centre.
        touch: (K,) free curvature of touch.
        evidence: log likelihood averaged over all places that the last frame touches.
    """

    mass: Array
    arc: Array
    peg: Array
    touch: Array
    evidence: float


def _weigh(table: Bodies, shown: Seen, readings: _Readings) -> _Places:
    """Weigh all nodes of the grid, then ever more finely those of its cells that can matter."""
    shape = table.arc.shape
    nodes = np.argwhere(np.ones(shape, dtype=np.bool_))
    coarse = readings.likelihood(shown, nodes, np.zeros((len(nodes), 2))).reshape(shape)
    # What a node can lie below the best of its cell: readings change all but linearly across it.
    middle = shown.mean[..., len(readings.shift_weight) // 2] / np.sqrt(readings.variance)
    best = np.full((shape[0] - 1, shape[1] - 1), -np.inf)
    for a in (0, 1):
        for g in (0, 1):
            best = np.maximum(best, coarse[a : shape[0] - 1 + a, g : shape[1] - 1 + g])
    for axis in (0, 1):
        rise = (np.diff(middle, axis=axis) ** 2).sum(axis=(2, 3)) / 8.0
        best += rise[:, :-1] if axis == 0 else rise[:-1]
    touched = np.isfinite(table.arc)
    cells = np.argwhere(best > coarse[touched].max() - _HOPELESS)
    at, share, part, log = cells, np.full(cells.shape, 0.5), np.ones(2), np.zeros(len(cells))
    for finer in _FINER:
        close = log > log.max() - _CLOSE
        steps = [(np.arange(number) + 0.5) / number - 0.5 for number in finer]
        step = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)
        at = np.repeat(at[close], len(step), axis=0)
        share = (share[close, None, :] + part * step).reshape(-1, 2)
        part = part / finer
        arc, weight = _between(table.arc, at, share), _between(table.weight, at, share)
        use = np.isfinite(arc) & (weight > 0.0)
        at, share = at[use], share[use]
        log = readings.likelihood(shown, at, share) + np.log(weight[use] * part.prod())
    top = float(log.max())
    mass = np.exp(log - top)
    evidence = top + math.log(mass.sum()) - math.log(table.weight[touched].sum())
    touch = np.broadcast_to(table.touch, shape)
    return _Places(
        mass / mass.sum(),
        arc[use],
        _between(table.peg, at, share),
        _between(touch, at, share),
        evidence,
    )


def _between(values: Array, at: Indices, share: Array) -> Array:
    """(K, ..) of a table (A, G, ..) at places between its nodes."""
    (a, g), shape = at.T, (-1, *(1,) * (values.ndim - 2))
    u, v = share[:, 0].reshape(shape), share[:, 1].reshape(shape)
    b, h = np.minimum(a + 1, len(values) - 1), np.minimum(g + 1, values.shape[1] - 1)
    near = (1.0 - v) * values[a, g] + v * values[a, h]
    far = (1.0 - v) * values[b, g] + v * values[b, h]
    return np.asarray((1.0 - u) * near + u * far)


def _answer(
    found: _Places,
    odds: float,
    inflation: Inflation,
    scale: float,
    turn: float,
    limit: float,
    noise: float,
) -> LocalizeResult:
    edges = np.linspace(0.0, 1.0, _BINS + 1)
    share, _ = np.histogram(found.arc / LENGTH, edges, weights=found.mass)
    order = np.argsort(-share, kind="stable")
    kept = np.sort(order[: int(np.searchsorted(np.cumsum(share[order]), priors.LEVEL)) + 1])
    near, far = float(edges[kept[0]]), float(edges[kept[-1] + 1])
    arc = float(np.interp(0.5, np.append(0.0, np.cumsum(share)), edges))
    name = f"one obstacle at rest over {len(inflation.free)} frames"
    log_odds = odds + priors.CONTACT
    probability = 1.0 / (1.0 + math.exp(min(-log_odds, 700.0)))
    if probability < 0.5:
        status: Status = "no contact" if probability < 2.0 * priors.EXCLUDED else "below detection"
        return LocalizeResult(
            status, (), name, "no obstacle is certain", noise, log_odds, {name: probability},
            length=LENGTH * scale,
        )  # fmt: skip
    sure = probability > 1.0 - priors.EXCLUDED and far - near <= limit
    status = "localized" if sure else "ambiguous"
    peg, touch = _typical(found, arc)
    body = inflation.last(peg, touch)
    # Where the body slips off that very peg, its nearest point.
    contact = body.contacts[-1] if body.contacts else None
    at = contact.arc if contact else arc * LENGTH
    end = None
    if contact and contact.kind != "side":
        x, y, heading = body.pose(LENGTH)
        across = (contact.y - y) * math.cos(heading) - (contact.x - x) * math.sin(heading)
        end = turn * across * scale
    felt = Contact(
        at * scale,
        turn * (contact.normal if contact else 0.0) / scale**2,
        (near * LENGTH * scale, far * LENGTH * scale),
        status,
        ((near * LENGTH * scale, far * LENGTH * scale),),
        probability=probability,
        end_offset=end,
    )
    return LocalizeResult(
        status,
        (felt,),
        name,
        "one place of the room explains all frames",
        noise,
        log_odds,
        {name: probability},
        parameters={
            "peg_x": float(peg[0]) * scale,
            "peg_y": turn * float(peg[1]) * scale,
            "fold_angle": turn * body.fold_angle,
        },
        length=LENGTH * scale,
        bent=(body.s * scale, turn * (body.curvature - inflation.free[-1]) / scale),
    )


def _typical(found: _Places, arc: float) -> tuple[Array, float]:
    """Mean peg, and curvature of touch, of the places whose contact is near an arc (of one)."""
    on_end = found.arc >= LENGTH * (1.0 - 1e-9)
    near = np.abs(found.arc / LENGTH - arc) < 1.5 / _BINS
    if (found.mass * near * on_end).sum() > 0.5 * (found.mass * near).sum():
        near = on_end
    else:
        near &= ~on_end
    mass = np.where(near, found.mass, 0.0)
    mass /= mass.sum()
    return np.asarray(mass @ found.peg), float(mass @ found.touch)
