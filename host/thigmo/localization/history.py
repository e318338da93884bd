"""One obstacle felt in many frames: joint and recursive fits over a sweep.

A peg does not move in the room, so the frames of a sweep share its place, while its force changes
from frame to frame. Each frame's force is integrated out, what is left is a likelihood over the
arc, and likelihoods multiply: the variance falls with the number of independent frames, and
ambiguities that differ between frames vanish. `ArcFilter` does it one frame at a time, for live
use; between frames the arc may slide a little along the body.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled
from thigmo.errors import DataError
from thigmo.localization import prior
from thigmo.localization.frame import Frame, Nodes, empty_levels
from thigmo.localization.influence import STRAIGHT, shape_table
from thigmo.localization.intervals import mixed
from thigmo.localization.models import GRID
from thigmo.localization.models import start as plain_beam
from thigmo.localization.outlier_search import search_pattern
from thigmo.localization.prior import BaseMoment
from thigmo.localization.readings import Readings, normalise
from thigmo.localization.result import Contact, LocalizeResult, Status

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

NODES = 531  # 0.1 cm of the 53 cm body


@compiled
def _fill(nodes: Nodes, frame: Frame, moment: BaseMoment) -> float:
    """Fill log likelihood and force over the nodes for one frame; returns it without contact."""
    levels = empty_levels(frame, np.ones(1), np.zeros(1))
    null = search_pattern(nodes, frame, levels, moment, False)
    levels.flagged[:] = False
    search_pattern(nodes, frame, levels, moment, True)
    return null


class ArcFilter:
    """Recursive posterior of one contact's arc over frames.

    Args:
        length: everted length, the same in all frames.
        slide_sigma: standard deviation of the arc's slide between frames.
        offset_sigma: standard deviation of an error that all readings of a frame share; it is
            taken as independent between frames.

    Attributes:
        arcs: (G,) grid, caller's unit.
        log_odds: log evidence ratio of this contact against none, over all frames.
        frames: how many were used.
    """

    def __init__(
        self, length: float, *, slide_sigma: float = 0.0, offset_sigma: float = 0.0
    ) -> None:
        if not (np.isfinite(length) and length > 0.0):
            raise DataError(f"length {length!r} is no length", "give the everted length")
        if not (np.isfinite(slide_sigma) and slide_sigma >= 0.0):
            raise DataError(f"slide_sigma is {slide_sigma!r}", "give a length of zero or more")
        self.length = float(length)
        self.frames = 0
        self.log_odds = 0.0
        self._offset = offset_sigma * self.length
        self._nodes = np.linspace(0.0, 1.0, NODES)
        self._belief = np.zeros(NODES)
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
        if self.frames:
            self._predict()
        logp, force, null = self._likelihood(readings, STRAIGHT)
        arc, strength = self._place(self._belief + logp, force)
        turning = abs(readings.bend) * arc + abs(strength) * arc * arc / 2
        for _ in range(2):
            if turning <= prior.BEND:
                break
            table = self._shape(readings, arc, strength)
            logp, force, null = self._likelihood(readings, table)
            arc, strength = self._place(self._belief + logp, force)
        joint = self._belief + logp
        top = joint.max()
        weight = _trapezoid(self._nodes)
        evidence = float(top + np.log(np.sum(weight * np.exp(joint - top))))
        self.log_odds += evidence - null
        self._belief = joint - evidence
        self._force = force
        self._noise = float(np.sqrt(readings.variance.mean()))
        self.frames += 1
        return self.result()

    def _predict(self) -> None:
        """Let the arc slide: convolve the belief, mirrored at both ends of the body."""
        if len(self._blur) == 1:
            return
        reach = len(self._blur) // 2
        density = np.exp(self._belief)
        padded = np.concatenate([density[reach:0:-1], density, density[-2 : -reach - 2 : -1]])
        self._belief = np.log(np.maximum(np.convolve(padded, self._blur, "valid"), 1e-300))

    def _likelihood(self, readings: Readings, table: Array) -> tuple[Array, Array, float]:
        frame = plain_beam(readings, self._offset).bent(table, readings).frame(readings)
        logp, force = np.empty(NODES), np.empty(NODES)
        null = _fill(Nodes(self._nodes, logp, force), frame, prior.BASE_MOMENT)
        return logp, force, null

    def _place(self, belief: Array, force: Array) -> tuple[float, float]:
        arc, _, _, _ = mixed(self._nodes, belief.copy(), prior.LEVEL)
        return arc, float(np.interp(arc, self._nodes, force))

    def _shape(self, readings: Readings, arc: float, force: float) -> Array:
        lever = np.maximum(arc - GRID, 0.0)
        return shape_table(readings.bend + force * lever)

    def result(self) -> LocalizeResult:
        """What all frames together say; the force is the last frame's."""
        logp = self._belief.copy()
        arc, low, high, pieces = mixed(self._nodes, logp, prior.LEVEL)
        scale = self.length
        status: Status
        if self.frames == 0 or self.log_odds <= prior.HINT:
            status = "no contact"
        elif self.log_odds <= prior.contact_threshold(1, known=True):
            status = "below detection"
        elif len(pieces) == 1 and high - low <= prior.WIDTH_SHARE:
            status = "localized"
        else:
            status = "ambiguous"
        force = float(np.interp(arc, self._nodes, self._force)) / scale**2
        contact = Contact(
            arc * scale,
            force,
            (low * scale, high * scale),
            status,
            tuple((float(p[0]) * scale, float(p[1]) * scale) for p in pieces),
        )
        return LocalizeResult(
            status,
            (contact,) if status in ("localized", "ambiguous") else (),
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
) -> LocalizeResult:
    """Joint fit of one obstacle over the frames of a sweep.

    Args:
        curvature: (T, N) readings.
        position: (N,).
        length: everted length.
        noise: standard deviation of a reading, scalar or (N,).
        span: scalar or (N,).
        free_curvature: scalar, or (T,) for one value a frame.
        slide_sigma: standard deviation of the arc's slide between frames; 0 for a common arc.
        offset_sigma: as in `localize`.

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
    chain = ArcFilter(length, slide_sigma=slide_sigma, offset_sigma=offset_sigma)
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
