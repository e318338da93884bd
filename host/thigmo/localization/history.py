"""One obstacle felt in many frames: joint and recursive fits over a sweep.

A peg does not move in the room, so the frames of a sweep share its place, while its force changes
from frame to frame. Each frame's force is integrated out, what is left is a likelihood over the
arc, and likelihoods multiply: the variance falls with the number of independent frames, and
ambiguities that differ between frames vanish. `ArcFilter` does it one frame at a time, for live
use; between frames the arc may slide a little along the body. The first frames may be from before
the touch, and the contact may be on the end of the body, where its place on the end's outline is
free in each frame.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled
from thigmo.errors import DataError
from thigmo.localization import prior
from thigmo.localization.frame import TOGETHER, Frame, Nodes, empty_levels, empty_tried
from thigmo.localization.influence import shape_table
from thigmo.localization.intervals import median, mixed
from thigmo.localization.models import GRID, Fit, Setting, fit_one
from thigmo.localization.models import start as plain_beam
from thigmo.localization.outlier_patterns import free_evidence
from thigmo.localization.outlier_search import search_pattern
from thigmo.localization.prior import BaseMoment
from thigmo.localization.readings import Readings, normalise
from thigmo.localization.result import Contact, LocalizeResult, Status
from thigmo.localization.tip import tip_contact

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

NODES = 531  # 0.1 cm of the 53 cm body


@compiled
def _fill(nodes: Nodes, frame: Frame, moment: BaseMoment) -> float:
    """Fill log likelihood and force over the nodes for one frame; returns it without contact."""
    tried = empty_tried(frame, TOGETHER)
    levels = empty_levels(frame, np.ones(1), np.zeros(1))
    search_pattern(nodes, frame, levels, moment, tried)
    return free_evidence(frame, levels.sigma, levels.log_prior, tried)


class ArcFilter:
    """Recursive posterior of one contact's arc over frames.

    Args:
        length: everted length, the same in all frames.
        slide_sigma: standard deviation of the arc's slide between frames.
        offset_sigma: standard deviation of an error that all readings of a frame share; it is
            taken as independent between frames.
        tube_radius: radius of the body; 1.75/53 of the length if not given.

    Attributes:
        arcs: (G,) grid, caller's unit.
        log_odds: log evidence ratio of a contact by now against none, over all frames.
        frames: how many were used.
    """

    def __init__(
        self,
        length: float,
        *,
        slide_sigma: float = 0.0,
        offset_sigma: float = 0.0,
        tube_radius: float | None = None,
    ) -> None:
        if not (np.isfinite(length) and length > 0.0):
            raise DataError(f"length {length!r} is no length", "give the everted length")
        if not (np.isfinite(slide_sigma) and slide_sigma >= 0.0):
            raise DataError(f"slide_sigma is {slide_sigma!r}", "give a length of zero or more")
        if tube_radius is not None and not (np.isfinite(tube_radius) and tube_radius > 0.0):
            raise DataError(f"tube_radius is {tube_radius!r}", "give a length above zero")
        self.length = float(length)
        self.frames = 0
        self.log_odds = 0.0
        self._offset = offset_sigma * self.length
        self._radius = prior.TUBE_RADIUS if tube_radius is None else tube_radius / self.length
        self._nodes = np.linspace(0.0, 1.0, NODES)
        # Log weights, over those of a body that nothing touches: of a contact at each place of the
        # side, of one on the end, and of one that is yet to come.
        self._side = np.full(NODES, -np.inf)
        self._end = -np.inf
        self._yet = 0.0
        self._last_end: Fit | None = None
        self._force = np.zeros(NODES)
        self._noise = 0.0
        self._blur = _blur_kernel(slide_sigma / self.length)

    @property
    def arcs(self) -> Array:
        """(G,) grid in the caller's unit."""
        return self._nodes * self.length

    def update(
        self,
        curvature: npt.ArrayLike,
        position: npt.ArrayLike,
        *,
        noise: npt.ArrayLike,
        span: npt.ArrayLike = 0.0,
        free_curvature: npt.ArrayLike = 0.0,
    ) -> LocalizeResult:
        """Add one frame and return what is known now.

        Args:
            curvature, position, span, free_curvature: as in `localize`.
            noise: standard deviation of a reading; it has to be known.

        Raises:
            DataError: as `localize`.
        """
        readings = normalise(curvature, position, self.length, span, free_curvature, noise)
        self.frames += 1
        # Touch may come in any frame; how many there will be is not known.
        hazard = 1.0 / (self.frames + 1)
        came = self._yet + math.log(hazard)
        self._yet += math.log(1.0 - hazard)
        side = np.logaddexp(self._slid(), came)
        end = float(np.logaddexp(self._end, came + math.log(prior.TIP_SHARE)))
        setting = plain_beam(readings, self._offset, rich=False)
        logp, force, null = self._likelihood(readings, setting)
        arc, strength = self._place(side + logp, force)
        turning = abs(readings.bend) * arc + abs(strength) * arc * arc / 2
        for _ in range(2):
            if turning <= prior.BEND:
                break
            setting = setting.bent(self._shape(readings, arc, strength), readings)
            logp, force, null = self._likelihood(readings, setting)
            arc, strength = self._place(side + logp, force)
        self._side = side + logp - null
        self._end = end + self._on_the_end(readings, setting, float(logp[-1])) - null
        top = float(self._side.max())
        mass = float(np.sum(_trapezoid(self._nodes) * np.exp(self._side - top)))
        self.log_odds = float(np.logaddexp(top + math.log(mass), self._end))
        self._force = force
        self._noise = float(np.sqrt(readings.variance.mean()))
        return self.result()

    def _slid(self) -> Array:
        """Log weights after a slide: convolved, mirrored at both ends of the body."""
        if len(self._blur) == 1 or self.frames == 1:
            return self._side
        reach = len(self._blur) // 2
        top = self._side.max()
        density = np.exp(self._side - top)
        padded = np.concatenate([density[reach:0:-1], density, density[-2 : -reach - 2 : -1]])
        blurred = np.convolve(padded, self._blur, "valid")
        return np.asarray(np.log(np.maximum(blurred, 1e-300)) + top)

    def _likelihood(self, readings: Readings, setting: Setting) -> tuple[Array, Array, float]:
        logp, force = np.empty(NODES), np.empty(NODES)
        nodes = Nodes(self._nodes, logp, force)
        null = _fill(nodes, setting.frame(readings), prior.BASE_MOMENT)
        return logp, force, null

    def _on_the_end(self, readings: Readings, setting: Setting, at_tip: float) -> float:
        """Log likelihood of a contact on the end; without a bend it is one at the tip."""
        self._last_end = None
        if abs(readings.bend) >= prior.CORNER_BEND:
            side = fit_one(readings, setting)
            self._last_end = tip_contact(readings, setting, side, self._radius)
        if self._last_end is None:
            return at_tip
        # The score's half (see `tip_contact`) stays: the side's forces have either sign each time.
        return self._last_end.score - math.log(prior.TIP_SHARE)

    def _place(self, belief: Array, force: Array) -> tuple[float, float]:
        arc, _, _, _ = mixed(self._nodes, belief.copy(), prior.LEVEL)
        return arc, float(np.interp(arc, self._nodes, force))

    def _shape(self, readings: Readings, arc: float, force: float) -> Array:
        lever = np.maximum(arc - GRID, 0.0)
        return shape_table(readings.bend + force * lever)

    def result(self) -> LocalizeResult:
        """What all frames together say; the force is the last frame's."""
        if self.frames == 0:
            return self._result("no contact", (), np.zeros(NODES))
        top = max(float(self._side.max()), self._end)
        logp = self._side - top
        last = self._nodes >= 1.0 - prior.CORNER_WIDTH - 1e-9
        # All but flat: denser at the tip itself, so that intervals close there.
        tilt = np.linspace(-0.05, 0.05, np.count_nonzero(last)) - math.log(prior.CORNER_WIDTH)
        logp[last] = np.logaddexp(logp[last], self._end - top + tilt)
        logp = np.maximum(logp, -700.0)
        arc, low, high, pieces = mixed(self._nodes, logp, prior.LEVEL)
        # Between side and end the median of all errs least on average.
        arc = median(self._nodes, logp)
        # The end is a place of its own, no second mode.
        modes = np.count_nonzero(pieces[:, 0] < 1.0 - 1.5 * prior.CORNER_WIDTH)
        status: Status
        if self.log_odds <= prior.HINT:
            status = "no contact"
        elif self.log_odds <= prior.contact_threshold(1, known=True):
            status = "below detection"
        elif modes <= 1 and high - low <= prior.WIDTH_SHARE:
            status = "localized"
        else:
            status = "ambiguous"
        scale = self.length
        force, offset = float(np.interp(arc, self._nodes, self._force)), None
        end = None if self._last_end is None else self._last_end.end
        if self._last_end is not None and end is not None and arc >= 1.0 - prior.CORNER_WIDTH:
            force, offset = float(self._last_end.forces[0]), end.offset * scale
        contact = Contact(
            arc * scale,
            force / scale**2,
            (low * scale, high * scale),
            status,
            tuple((float(p[0]) * scale, float(p[1]) * scale) for p in pieces),
            end_offset=offset,
        )
        felt = status in ("localized", "ambiguous")
        return self._result(status, (contact,) if felt else (), logp)

    def _result(self, status: Status, contacts: tuple[Contact, ...], logp: Array) -> LocalizeResult:
        scale = self.length
        return LocalizeResult(
            status,
            contacts,
            f"common obstacle over {self.frames} frames",
            "the frames share one place; their forces differ",
            self._noise / scale,
            self.log_odds,
            self.arcs,
            np.exp(logp) / scale,
        )


def localize_sweep(
    curvature: npt.ArrayLike,
    position: npt.ArrayLike,
    *,
    length: float,
    noise: npt.ArrayLike,
    span: npt.ArrayLike = 0.0,
    free_curvature: npt.ArrayLike = 0.0,
    slide_sigma: float = 0.0,
    offset_sigma: float = 0.0,
    tube_radius: float | None = None,
) -> LocalizeResult:
    """Joint fit of one obstacle over the frames of a sweep, of which some may be before the touch.

    Args:
        curvature: (T, N) readings.
        position: (N,).
        length: everted length.
        noise: standard deviation of a reading, scalar or (N,).
        span: scalar or (N,).
        free_curvature: scalar, or (T,) for one value a frame.
        slide_sigma: standard deviation of the arc's slide between frames; 0 for a common arc.
        offset_sigma, tube_radius: as in `localize`.

    Raises:
        DataError: as `localize`.
    """
    frames = np.asarray(curvature, dtype=np.float64)
    if frames.ndim != 2 or len(frames) == 0:
        raise DataError(f"curvature has shape {frames.shape}", "give (T, N) readings")
    free = np.asarray(free_curvature, dtype=np.float64)
    if free.ndim > 1 or (free.ndim == 1 and len(free) != len(frames)):
        raise DataError(f"free_curvature has shape {free.shape}", "give a scalar or (T,)")
    free = np.broadcast_to(free, len(frames))
    chain = ArcFilter(
        length, slide_sigma=slide_sigma, offset_sigma=offset_sigma, tube_radius=tube_radius
    )
    for row, level in zip(frames, free.tolist(), strict=True):
        if np.isnan(row).all():
            continue
        chain.update(row, position, noise=noise, span=span, free_curvature=level)
    return chain.result()


def _blur_kernel(sigma: float) -> Array:
    """Gaussian over grid steps, odd length, of sum one."""
    steps = sigma * (NODES - 1)
    reach = min(int(np.ceil(4.0 * steps)), NODES // 2 - 1)
    if reach < 1:
        return np.ones(1)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / steps) ** 2)
    return np.asarray(kernel / kernel.sum())


def _trapezoid(nodes: Array) -> Array:
    weight = np.zeros(len(nodes))
    weight[:-1] += 0.5 * np.diff(nodes)
    weight[1:] += 0.5 * np.diff(nodes)
    return weight
