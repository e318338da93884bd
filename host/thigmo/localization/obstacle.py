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

from thigmo.compiled import compiled
from thigmo.errors import DataError
from thigmo.localization import prior
from thigmo.localization.bodies import LENGTH, SHIFTS, Bodies, Inflation, Seen, bodies, seen
from thigmo.localization.intervals import median, mixed
from thigmo.localization.readings import normalise
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
# Cells of the grid whose best place can only be this far behind (in log likelihood) are left out.
_HOPELESS = 12.0
# Nodes of an error that all readings share, in deviations.
_OFFSETS = np.linspace(-2.5, 2.5, 7)
_BINS = 106  # of the posterior over the arc


def localize_obstacle(
    curvature: npt.ArrayLike,
    position: npt.ArrayLike,
    *,
    length: float,
    free_curvature: npt.ArrayLike,
    noise: npt.ArrayLike,
    span: npt.ArrayLike = 0.0,
    gain_sigma: float = 0.0,
    place_sigma: float = 0.0,
    offset_sigma: float = 0.0,
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
        gain_sigma: relative standard deviation of the sensors' gains, each the same in all frames.
        place_sigma: standard deviation of the sensors' places, likewise.
        offset_sigma: of an error that all readings of all frames share.
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
    for name, value in (
        ("gain_sigma", gain_sigma), ("place_sigma", place_sigma), ("offset_sigma", offset_sigma),
    ):  # fmt: skip
        if not (math.isfinite(value) and value >= 0.0):
            raise DataError(f"{name} is {value!r}", f"give a finite {name} of zero or more")
    checked = normalise(np.zeros(frames.shape[1]), position, length, span, 0.0, noise)
    if np.isinf(frames).any() or not np.isfinite(frames[-1]).any():
        raise DataError("readings are infinite, or the last frame has none", "mark missing by NaN")
    scale = checked.length / LENGTH
    radius = prior.TUBE_RADIUS * LENGTH if tube_radius is None else tube_radius / scale
    inflation = Inflation(
        tuple((free * turn * scale).tolist()),
        radius,
        prior.PEG_RADIUS * radius if peg_radius is None else peg_radius / scale,
        None if critical_curvature is None else critical_curvature * scale,
    )
    place = place_sigma / scale
    low, high = (tuple((ends * LENGTH).tolist()) for ends in (checked.low, checked.high))
    shown = seen(inflation, low, high, place)
    readings = _Readings(
        turn * frames * scale,
        np.maximum(np.sqrt(checked.variance) / LENGTH, _LEAST_NOISE) ** 2,
        gain_sigma,
        *_normal(SHIFTS if place > 0.0 else np.zeros(1)),
        *_normal(_OFFSETS if offset_sigma > 0.0 else np.zeros(1)),
        offset_sigma * scale,
    )
    limit = prior.WIDTH_SHARE if width_limit is None else width_limit / checked.length
    found = _weigh(bodies(inflation), shown, readings)
    odds = found.evidence - readings.untouched(np.array(inflation.free))
    return _answer(
        found,
        odds,
        inflation,
        scale,
        turn,
        limit,
        float(np.mean(np.asarray(noise, dtype=np.float64))),
    )


def _normal(nodes: Array) -> tuple[Array, Array]:
    """Nodes in deviations, and log weights, of sum one, of a normal density on them."""
    log = -0.5 * nodes**2
    return nodes, np.asarray(log - np.logaddexp.reduce(log))


@compiled
def _likelihood(
    mean: Array,
    blur: Array,
    at: Indices,
    share: Array,
    curvature: Array,
    variance: Array,
    gain: float,
    shift_weight: Array,
    offsets: Array,
    offset_weight: Array,
    odds: float,
    kappa2: float,
    out: Array,
) -> None:
    """Log likelihood of K bodies: outliers and the errors of gains, places, offset integrated out.

    Args:
        mean, blur: as in `Seen`.
        at, share: (K, 2) node of the table, and how far it is to the next along both axes.
        curvature: (T, N) readings; NaN marks a missing one.
        variance: (N,) of a reading.
        gain: relative deviation of each sensor's gain.
        shift_weight: (D,) log weights of the shifts.
        offsets, offset_weight: (Q,) values of a shared error, and log weights.
        odds, kappa2: prior odds of a sensor being an outlier in all frames; its variance ratio.
        out: (K,) written.
    """
    frames, sensors, shifts = mean.shape[2], mean.shape[3], mean.shape[4]
    each = np.empty(shifts)
    totals = np.empty(offsets.shape[0])
    for p in range(at.shape[0]):
        a, g = at[p, 0], at[p, 1]
        u, v = share[p, 0], share[p, 1]
        b, h = min(a + 1, mean.shape[0] - 1), min(g + 1, mean.shape[1] - 1)
        for q in range(offsets.shape[0]):
            totals[q] = offset_weight[q]
            for i in range(sensors):
                for d in range(shifts):
                    square = 0.0
                    power = 0.0
                    cross = 0.0
                    count = 0
                    for t in range(frames):
                        y = curvature[t, i]
                        if np.isnan(y):
                            continue
                        near = (1.0 - v) * mean[a, g, t, i, d] + v * mean[a, h, t, i, d]
                        far = (1.0 - v) * mean[b, g, t, i, d] + v * mean[b, h, t, i, d]
                        k = (1.0 - u) * near + u * far
                        r = y - k - offsets[q]
                        square += r * r
                        power += k * k
                        cross += r * k
                        count += 1
                    total = 0.0
                    for outlier in range(2):
                        s = variance[i] * (kappa2 if outlier else 1.0) + blur[a, g, i, d]
                        # A gain's error is common to the frames: a term of rank one.
                        common = gain * gain / (s + gain * gain * power)
                        log = -0.5 * (square - common * cross * cross) / s
                        log -= 0.5 * np.log1p(gain * gain * power / s) + 0.5 * count * np.log(s)
                        if outlier:
                            log += np.log(odds)
                            top = max(total, log)
                            total = top + np.log(np.exp(total - top) + np.exp(log - top))
                        else:
                            total = log
                    each[d] = total + shift_weight[d]
                top = each.max()
                totals[q] += top + np.log(np.sum(np.exp(each - top)))
        top = totals.max()
        out[p] = top + np.log(np.sum(np.exp(totals - top)))


@dataclass(frozen=True, slots=True)
class _Readings:
    """Readings of a body of `LENGTH`, and what is known of the sensors.

    Attributes:
        curvature: (T, N).
        variance: (N,) of a reading.
        gain: relative deviation of a gain.
        shift, shift_weight: (D,) nodes of a sensor's place and their log weights.
        offset, offset_weight: (Q,) of the error that all readings share.
        offset_sigma: its deviation.
    """

    curvature: Array
    variance: Array
    gain: float
    shift: Array
    shift_weight: Array
    offset: Array
    offset_weight: Array
    offset_sigma: float

    def likelihood(self, shown: Seen, at: Indices, share: Array) -> Array:
        """(K,) of places between the nodes of the table."""
        out = np.empty(len(at))
        _likelihood(
            shown.mean,
            shown.blur,
            at,
            share,
            self.curvature,
            self.variance,
            self.gain,
            self.shift_weight,
            self.offset * self.offset_sigma,
            self.offset_weight,
            prior.OUTLIER_ODDS,
            prior.OUTLIER_VARIANCE,
            out,
        )
        return out

    def untouched(self, free: Array) -> float:
        """Log likelihood of a body that bends freely."""
        shape = (1, 1, *self.curvature.shape, len(self.shift))
        mean = np.ascontiguousarray(np.broadcast_to(free[:, None, None], shape))
        alone = Seen(mean, np.zeros((1, 1, *shape[3:])))
        return float(self.likelihood(alone, np.zeros((1, 2), np.int64), np.zeros((1, 2)))[0])


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
    middle = shown.mean[..., len(readings.shift) // 2] / np.sqrt(readings.variance)
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
    near = (1.0 - v) * values[a, g] + v * values[a, g + 1]
    far = (1.0 - v) * values[a + 1, g] + v * values[a + 1, g + 1]
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
    log = np.log(np.maximum(share * _BINS, 1e-290))
    # Flat in each bin.
    nodes = np.repeat(edges, 2)[1:-1] + np.tile([1e-9, -1e-9], _BINS)
    nodes[[0, -1]] = 0.0, 1.0
    density = np.repeat(log, 2)
    # Denser at the tip itself, so that intervals close there.
    density[-2:] += -0.05, 0.05
    _, near, far, pieces = mixed(nodes, density, prior.LEVEL)
    arc = median(nodes, density)
    status: Status = "no contact"
    if odds > prior.HINT:
        status = "below detection"
    if odds > prior.contact_threshold(1, known=True):
        # The end is a place of its own, no second mode.
        modes = np.count_nonzero(pieces[:, 0] < 1.0 - prior.CORNER_WIDTH)
        status = "localized" if modes <= 1 and far - near <= limit else "ambiguous"
    name = f"one obstacle at rest over {len(inflation.free)} frames"
    if status not in ("localized", "ambiguous"):
        return LocalizeResult(
            status, (), name, "no obstacle is certain", noise, odds,
            nodes * LENGTH * scale, np.exp(density) / (LENGTH * scale),
        )  # fmt: skip
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
        tuple((low * LENGTH * scale, high * LENGTH * scale) for low, high, _ in pieces.tolist()),
        0.0,
        end,
    )
    above = turn * (body.curvature - inflation.free[-1]) / scale
    return LocalizeResult(
        status,
        (felt,),
        name,
        "one place of the room explains all frames",
        noise,
        odds,
        nodes * LENGTH * scale,
        np.exp(density) / (LENGTH * scale),
        parameters={
            "peg_x": float(peg[0]) * scale,
            "peg_y": turn * float(peg[1]) * scale,
            "fold_angle": turn * body.fold_angle,
        },
        _bend=np.column_stack([body.s * scale, above]),
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
