"""Frames together: one round obstacle at rest, felt by a body that bends into it.

A frame of a few readings cannot tell a force on the face of the end from one on the side farther
back: either bends the body alike. Over an inflation they part, for the peg stands still: where the
body first met it says how hard, and where along its skin, it must bear at every later curvature. So
the unknown is the peg's place in the room, two numbers for all frames together, and what the frames
share besides: errors of gains, zeros and places of the sensors, of the map, of the body's
stiffness. For each place of a grid (`bodies`) readings are linear in these, and in how far the peg
is from the place. So each frame adds to the normal equations of a linear model, one for each place,
and the evidence of a place is that of the linear models of loads.h in closed form, after any frame.
Frames before the touch are those of the free body at every place: they teach what the frames share.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import logsumexp, ndtr

from thigmo.errors import DataError
from thigmo.localization import priors
from thigmo.localization.bodies import LENGTH, BentBody, Bodies, bodies
from thigmo.localization.described import Body, Errors, Sensors
from thigmo.localization.readings import check_layout, everted_length, positive, vector
from thigmo.localization.result import Contact, LocalizeResult, OfBody

Array = npt.NDArray[np.float64]

# Readings are trusted to no less than what the places resolve, 1/cm of a body of 53 cm; nor is any
# error that they share known better than this share of its column.
_LEAST_NOISE = 1e-4
_LEAST_ERROR = 1e-6
# Radius of a peg over that of the tube, where the caller gives none.
_PEG_RADIUS = 0.6
# Relative standard errors of what a contact does to a body of this model: of all of it (friction,
# stiffness), and of what each sensor feels of it (stiffness along the body).
_LOAD_ERROR, _LOCAL_LOAD_ERROR = 0.1, 0.1
# A peg lies within its cell of the grid: normal, with this deviation in cells. Their sum is flat.
_WITHIN_CELL = 0.5
# Odds that a given sensor is bad through all frames, where the caller does not say. Many frames
# tell it more surely than one does, and so distrust costs less than in one frame.
_BAD_SENSOR = 0.02
# One sigma of a bad sensor's gain. Its zero is that of `priors.BAD_DEVIATION`.
_BAD_GAIN = 1.0
_BINS = 106  # of the posterior over the arc
_NEGLIGIBLE = 1e-6  # posterior of a place that changes no answer
_MOST_BEYOND = 1.05  # free curvature over the most that was announced
# Columns of a sensor's own errors (gain, zero, place, load), and of those that all share (offset,
# map, load, where the peg is in its cell: along the outline, and of the touch).
_OWN, _SHARED = 4, 5


class ContactFilter:
    """Posterior of the one obstacle that a body bends into, frame by frame (`Localizer.filter`).

    A frame costs milliseconds, an answer tens of them; the first filter of a body computes its
    tables, for a few seconds. Errors other than `noise` stay the same through all frames. The base
    folds at the body's critical moment; without one it does not fold.

    Args:
        body: the body, of the same length in all frames.
        sensors: where its sensors are.
        errors: of their readings; the noise must be known, and is independent between frames.
        most_curvature: free curvature that the inflation reaches; its sign tells the side.
        place_error: standard error of the sensors' places.
        bad_sensor_odds: prior odds that a given sensor is bad, scalar or (N,).
        peg_radius: of the obstacle; 0.6 tube radii if not given.

    Raises:
        DataError: as `Localizer`; `most_curvature` is zero, the noise unknown, or errors are shared
            in a way that frames do not know.
    """

    def __init__(
        self,
        body: Body,
        sensors: Sensors,
        errors: Errors,
        most_curvature: float,
        *,
        place_error: float = 0.0,
        bad_sensor_odds: npt.ArrayLike = _BAD_SENSOR,
        peg_radius: float | None = None,
    ) -> None:
        if errors.noise is None or errors.shared_errors is not None:
            raise DataError(
                "a filter takes a known noise and no shared_errors", "give noise, leave them out"
            )
        x = vector(sensors.position, "position")
        count, total = x.size, everted_length(body.length)
        half = 0.5 * np.broadcast_to(vector(sensors.span, "span", count), count)
        own = {
            name: np.zeros(count) + vector(value, name, count)
            for name, value in (
                ("noise", errors.noise), ("gain_error", errors.gain_error),
                ("zero_error", errors.zero_error), ("bad_sensor_odds", bad_sensor_odds),
            )
        }  # fmt: skip
        check_layout(x, 2.0 * half, total, bad_sensor_odds=own["bad_sensor_odds"])
        most = float(most_curvature)
        if not math.isfinite(most) or most == 0.0:
            raise DataError(f"most_curvature is {most:g}", "give the most that the body will bend")
        self._scale = scale = total / LENGTH
        self._way = math.copysign(1.0, most)
        radius = (
            priors.TUBE_RADIUS * LENGTH if body.tube_radius is None else body.tube_radius / scale
        )
        critical = body.critical_curvature
        self._body = BentBody(
            abs(most) * scale,
            radius,
            _PEG_RADIUS * radius if peg_radius is None else peg_radius / scale,
            None if critical is None or math.isinf(critical) else critical * scale,
            tuple(((x - half) / scale).tolist()),
            tuple(((x + half) / scale).tolist()),
            positive(place_error, "place_error") / scale,
        )
        self._table = bodies(self._body)
        self._noise = np.maximum(own["noise"] * scale, _LEAST_NOISE)
        good = np.ones((count, _OWN))
        good[:, 0] = own["gain_error"]
        good[:, 1] = own["zero_error"] * scale
        good[:, 3] = _LOCAL_LOAD_ERROR
        bad = good.copy()
        bad[:, 0] = _BAD_GAIN
        bad[:, 1] = priors.BAD_DEVIATION / LENGTH
        self._good, self._bad = _precision(good), _precision(bad)
        self._shared = _precision(np.array([
            positive(errors.offset_error, "offset_error") * scale,
            positive(errors.map_error, "map_error"),
            _LOAD_ERROR, _WITHIN_CELL, _WITHIN_CELL,
        ]))  # fmt: skip
        self._log_bad = np.log(np.maximum(own["bad_sensor_odds"], 1e-300) / 2.0)
        # Normal equations of each sensor at each place, and at none (the last).
        places = self._table.weight.size + 1
        size = _OWN + _SHARED
        self._information = np.zeros((places, count, size, size))
        self._told = np.zeros((places, count, size))
        self._power = np.zeros((places, count))
        # Of readings that tell nothing: squares, and twice the log of how wide they spread.
        self._erratic = np.zeros((count, 2))
        self._free = 0.0
        self._seen = 0  # readings
        self.frames = 0

    def update(self, curvature: npt.ArrayLike, free_curvature: npt.ArrayLike) -> None:
        """Take a frame, or several.

        Args:
            curvature: (N,) or (T, N) readings, also of frames before the touch; NaN marks a missing
                one.
            free_curvature: scalar or (T,) that actuation alone would cause, of the side announced.

        Raises:
            DataError: another number of readings or of frames, an infinite reading, or a free
                curvature that is not between zero and the most that was announced. No frame is
                taken then.
        """
        readings = np.atleast_2d(np.asarray(curvature, dtype=np.float64)) * self._way * self._scale
        bends = vector(free_curvature, "free_curvature") * self._way * self._scale
        if readings.shape != (bends.size, self._noise.size) or np.isinf(readings).any():
            raise DataError(
                f"frames have shape {readings.shape}, or infinite readings",
                "give one reading a sensor, NaN where one is missing, and one free_curvature each",
            )
        if not ((bends >= 0.0) & (bends <= _MOST_BEYOND * self._body.most)).all():
            raise DataError(
                "a free curvature is none that was announced",
                "give most_curvature with its sign, and frames of one side",
            )
        for frame, bend in zip(readings, bends, strict=True):
            self._take(frame, float(bend))

    def _take(self, readings: Array, free: float) -> None:
        def placed(values: Array) -> Array:
            """(A, G, ..) as (K, ..): at each place, and zero at none."""
            flat = values.reshape(-1, *values.shape[2:])
            return np.concatenate([flat, np.zeros((1, *flat.shape[1:]))])

        there = np.isfinite(readings)
        held, follows, _ = self._at(free)
        above = placed(held[..., 0, :])
        columns = np.ones((*above.shape, _OWN + _SHARED))
        columns[..., 0] = free + above
        columns[..., 2] = 0.5 * placed(held[..., 2, :] - held[..., 1, :])
        columns[..., 3] = columns[..., 6] = above
        columns[..., 5] = free * (1.0 + placed(follows))
        columns[..., 7:] = placed(_slopes(held[..., 0, :]))
        excess = np.where(there, readings, 0.0) - free
        design = columns[:, there] / self._noise[there, None]
        left = (excess - above)[:, there] / self._noise[there]
        self._information[:, there] += design[..., :, None] * design[..., None, :]
        self._told[:, there] += design * left[..., None]
        self._power[:, there] += left**2
        wide = np.hypot(priors.BAD_DEVIATION / LENGTH, free)
        spread = np.stack([(excess / wide) ** 2, 2.0 * np.log(wide / self._noise)], axis=1)
        self._erratic += np.where(there[:, None], spread, 0.0)
        self._free = free
        self._seen += int(there.sum())
        self.frames += 1

    def _at(self, free: float) -> tuple[Array, Array, Array]:
        """At a free curvature: (A, G, 3, N) readings above it, (A, G, N) their slope, (A, G) arcs.

        Zero, and no arc of a contact, where the peg is not yet touched.
        """
        table = self._table
        rest = (self._body.most - table.touch) / (table.held.shape[2] - 1)
        along = np.maximum(free - table.touch, 0.0) / rest
        cell = np.minimum(along.astype(np.int64), table.held.shape[2] - 2)
        share = along - cell
        g = np.arange(len(table.touch))
        near, far = table.held[:, g, cell], table.held[:, g, cell + 1]
        touched = (free > table.touch)[:, None]
        held = near + share[:, None, None] * (far - near)
        follows = np.where(touched, (far - near)[..., 0, :] / rest[:, None], 0.0)
        arc = table.arc[:, g, cell]
        arc = np.where(touched[:, 0], arc + share * (table.arc[:, g, cell + 1] - arc), np.nan)
        return held, follows, arc

    def _weigh(self) -> _Weighed:
        """Evidence of each place under each hypothesis of the sensors' health."""
        good = self._summed(self._good)
        bad = self._summed(self._bad)
        whole = [each.sum(axis=1) for each in good]
        sums = [whole]
        for n in range(len(self._noise)):
            without = [all_ - each[:, n] for all_, each in zip(whole, good, strict=True)]
            sums.append([rest + each[:, n] for rest, each in zip(without, bad, strict=True)])
            # Or its readings tell nothing at all.
            without[2] = without[2] - 0.5 * self._erratic[n].sum()
            without[3] = without[3] + self._erratic[n, 0]
            sums.append(without)
        information, told, log, square = (np.stack(each) for each in zip(*sums, strict=True))
        information = information + np.diag(self._shared)
        covariance = np.linalg.inv(information)
        solved = (covariance @ told[..., None])[..., 0]
        gain = (told * solved).sum(axis=-1)
        log = log + 0.5 * (gain + np.log(self._shared).sum() - np.linalg.slogdet(information)[1])
        log += np.concatenate([[0.0], np.repeat(self._log_bad, 2)])[:, None]
        # A place stands for those of its cell and the next, where readings are linear.
        deviation = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1)[..., -2:])
        mean = solved[..., -2:]
        inside = ndtr((1.0 - mean) / deviation) - ndtr((-1.0 - mean) / deviation)
        log += np.log(np.maximum(inside, 1e-300)).sum(axis=-1)
        return _Weighed(log, square - gain, solved, covariance)

    def _summed(self, precision: Array) -> tuple[Array, Array, Array, Array]:
        """Each sensor's own errors integrated out: normal equations of the shared ones.

        Returns:
            (K, N, 5, 5) information, (K, N, 5) products, (K, N) log evidence, and the squares left.
        """
        own = self._information[..., :_OWN, :_OWN] + precision[:, None] * np.eye(_OWN)
        cross = self._information[..., :_OWN, _OWN:]
        right = np.concatenate([cross, self._told[..., :_OWN, None]], axis=-1)
        solved = np.linalg.solve(own, right)
        gain = (self._told[..., :_OWN] * solved[..., -1]).sum(axis=-1)
        information = (
            self._information[..., _OWN:, _OWN:] - np.swapaxes(cross, -1, -2) @ (solved[..., :-1])
        )
        told = self._told[..., _OWN:] - (np.swapaxes(cross, -1, -2) @ solved[..., -1:])[..., 0]
        volume = np.log(precision).sum(axis=-1) - np.linalg.slogdet(own)[1]
        square = self._power - gain
        return information, told, 0.5 * (volume - square), square

    def result(self) -> LocalizeResult:
        """What all frames so far tell of the contact in the last one.

        Returns:
            The contact; the peg's centre in `parameters` (`peg_x`, `peg_y`: base at the origin,
            straight body along x); a sensor that is bad in all frames in `discarded`. `noise` is
            that which was told.

        Raises:
            DataError: no frame yet.
        """
        if self.frames == 0:
            raise DataError("there is no frame", "give at least one")
        weighed = self._weigh()
        # A model that leaves more than the noise is believed by so much less.
        worse = max(1.0, float(weighed.square.min()) / max(self._seen, 1))
        weight = self._table.weight.ravel()
        log = weighed.log / worse
        with np.errstate(divide="ignore"):
            log[:, :-1] += priors.CONTACT + np.log(weight / weight.sum())
        mass = np.exp(log - logsumexp(log))
        arc = self._at(self._free)[2].ravel()
        touching = np.append(np.isfinite(arc), False)
        probability = float(mass[:, touching].sum())
        result = self._explained(mass, probability, worse)
        if probability >= 0.5:
            self._add_contact(
                result, _Where(mass * touching, arc, weighed, self._table), probability
            )
        return result

    def _explained(self, mass: Array, probability: float, worse: float) -> LocalizeResult:
        """The answer but for its contact."""
        # Of each sensor: bad in one of two ways, with an obstacle or without.
        parts = np.stack([mass[:, -1], mass[:, :-1].sum(axis=1)], axis=1)
        bad = parts[1:].reshape(len(self._noise), 2, 2).sum(axis=1)
        kinds = ("free body", f"one obstacle at rest over {self.frames} frames")
        hypotheses = dict(zip(kinds, parts[0].tolist(), strict=True))
        for sensor, each in enumerate(bad.tolist()):
            hypotheses |= {
                f"{kind}, sensor {sensor} bad": share
                for kind, share in zip(kinds, each, strict=True)
            }
        worst = int(bad.sum(axis=1).argmax())
        discarded = (worst,) if bad[worst].sum() > parts[0].sum() else ()
        found = probability >= 0.5
        message = "one place of the room explains all frames" if found else "no obstacle is certain"
        if discarded:
            message += "; a sensor looks bad in all frames (see `discarded`)"
        if worse > 2.0:
            message += f"; what is left of the readings is {math.sqrt(worse):.1f} times their noise"
        hint = probability >= 2.0 * priors.EXCLUDED
        return LocalizeResult(
            "below detection" if hint else "no contact",
            (),
            max(hypotheses, key=hypotheses.__getitem__),
            message,
            float(self._noise.mean()) / self._scale,
            math.log(max(probability, 1e-300) / max(1.0 - probability, 1e-300)),
            hypotheses,
            discarded,
            length=LENGTH * self._scale,
        )

    def _add_contact(self, result: LocalizeResult, where: _Where, probability: float) -> None:
        scale, way = self._scale, self._way
        share = where.density()
        edges = np.linspace(0.0, 1.0, _BINS + 1)
        arcs = edges * result.length
        order = np.argsort(-share, kind="stable")
        kept = np.sort(order[: int(np.searchsorted(np.cumsum(share[order]), priors.LEVEL)) + 1])
        runs = np.split(kept, np.flatnonzero(np.diff(kept) > 1) + 1)
        pieces = tuple((float(arcs[run[0]]), float(arcs[run[-1] + 1])) for run in runs)
        interval = pieces[0][0], pieces[-1][1]
        sure = probability > 1.0 - priors.EXCLUDED and (
            interval[1] - interval[0] <= priors.WIDTH_SHARE * result.length
        )
        result.status = "localized" if sure else "ambiguous"
        arc = LENGTH * float(np.interp(0.5, np.append(0.0, np.cumsum(share)), edges))
        peg, touch = where.typical(arc)
        body = self._body.against(peg, touch, self._free)
        force = 0.0
        end: float | None = None
        # Where the body slips off that very peg, its nearest point.
        if body.contacts:
            contact = body.contacts[-1]
            arc, force = contact.arc, contact.normal
            if contact.kind != "side":
                x, y, heading = body.pose(LENGTH)
                across = (contact.y - y) * math.cos(heading) - (contact.x - x) * math.sin(heading)
                end = way * across * scale
        felt = Contact(
            arc * scale, way * force / scale**2, interval, result.status, pieces,
            probability=probability, end_offset=end,
        )  # fmt: skip
        result.contacts = (felt,)
        result.parameters = {
            "peg_x": float(peg[0]) * scale,
            "peg_y": way * float(peg[1]) * scale,
            "fold_angle": way * body.fold_angle,
        }
        bend = np.interp(LENGTH * edges, body.s, body.curvature - self._free)
        cells = np.full(share.size, force * LENGTH**2 * way), np.full(share.size, math.nan)
        result._body = OfBody([(edges, share, *cells)], way * LENGTH * bend)


def _precision(deviation: Array) -> Array:
    return 1.0 / np.maximum(deviation, _LEAST_ERROR) ** 2


def _slopes(values: Array) -> Array:
    """(A, G, .., 2) of a table (A, G, ..): by a cell along the outline, and of the touch."""
    along, onward = np.gradient(values, axis=(0, 1))
    return np.stack([along, onward], axis=-1)


class _Weighed(NamedTuple):
    """Of H hypotheses of the sensors' health and K places, the last of which is none."""

    log: Array  # (H, K) log evidence with the odds of health
    square: Array  # (H, K) squared deviates that are left
    mean: Array  # (H, K, 5) shared errors
    covariance: Array  # (H, K, 5, 5) of them


class _Where:
    """Places that the readings leave, J of them, each with a normal density in its cell.

    `mass` (H, K) of each hypothesis and place, `arc` (K,) of the contacts there.
    """

    def __init__(self, mass: Array, arc: Array, weighed: _Weighed, table: Bodies) -> None:
        self._table = table
        health, self._place = np.nonzero(mass > _NEGLIGIBLE * mass.max())
        slope = np.nan_to_num(self._at_places(_slopes(arc.reshape(table.weight.shape))))
        # Mean in cells, along the outline and of the touch.
        self._shift = weighed.mean[health, self._place, -2:]
        covariance = weighed.covariance[health, self._place][:, -2:, -2:]
        variance = np.einsum("ji,jik,jk->j", slope, covariance, slope)
        self._mass = mass[health, self._place] / mass[health, self._place].sum()
        self._arc = np.minimum(arc[self._place] + (slope * self._shift).sum(axis=1), LENGTH)
        self._deviation = np.sqrt(np.maximum(variance, 0.0))

    def _at_places(self, values: Array) -> Array:
        return values.reshape(-1, *values.shape[2:])[self._place]

    def density(self) -> Array:
        """Mass in even bins from the base to the end, of which no contact is beyond."""
        edges = np.linspace(0.0, LENGTH, _BINS + 1)
        edges[0], edges[-1] = -np.inf, np.inf
        below = ndtr((edges - self._arc[:, None]) / np.maximum(self._deviation, 1e-3)[:, None])
        share = self._mass @ np.diff(below, axis=1)
        return np.asarray(share / share.sum())

    def typical(self, arc: float) -> tuple[Array, float]:
        """Mean peg, and curvature of touch, of the places whose contact is near an arc."""
        on_end = self._arc >= LENGTH * (1.0 - 1e-9)
        near = np.abs(self._arc - arc) < 1.5 * LENGTH / _BINS + self._deviation
        if (self._mass * near * on_end).sum() > 0.5 * (self._mass * near).sum():
            near = on_end
        elif (near & ~on_end).any():
            near &= ~on_end
        mass = np.where(near, self._mass, 0.0)
        mass = mass / mass.sum()

        def mean(values: Array) -> Array:
            steps = self._at_places(_slopes(values)) * self._shift[:, None]
            return np.asarray(mass @ (self._at_places(values) + steps.sum(axis=-1)))

        touch = np.broadcast_to(self._table.touch, self._table.weight.shape)
        return mean(self._table.peg), float(mean(touch[..., None])[0])
