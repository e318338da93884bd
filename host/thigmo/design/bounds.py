"""What a sensor layout can resolve: Cramer-Rao bounds of contacts along a body.

They show where a contact can be detected, located and distinguished from a second one, and from
which force on. `thigmo design` plans robots with them. The bound is the standard deviation of the
best unbiased estimate, for small deflections: enough for planning.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from thigmo.errors import DataError
from thigmo.localization.validation import Array, check_layout, everted_length, positive, vector
from thigmo.mechanics.closed_forms import phi

# Signal over noise from which one contact is reported nine times in ten (`thigmo bench accuracy`).
DETECTABLE = 4.5
# Readings of a frame below which `localize` calls no contact localized: a contact has two numbers,
# its place and its force, and only a further reading checks them.
FEWEST_READINGS = 3
_SINGULAR = 1e-11  # pivot of an information matrix of unit diagonal
_STEP = 1e-6  # share of the length by which central differences step to either side


@dataclass(frozen=True, slots=True)
class Identifiability:
    """Bounds of one layout, in the caller's units.

    Attributes:
        arc: (A,) places of a single contact.
        moment: (M,) its moment at the base over EI, which is the curvature there. Contacts at
            different places compare better by this moment than by their force.
        bound: (M, A) standard deviation of the arc; infinite where the readings fix no place.
        signal: (M, A) signal over noise: root of the sum of squares of readings over their noise.
        separation: (S,) distances between two opposed contacts, the distal one at the tip.
        pair_bound: (M, S, 2) standard deviations of the proximal and the distal arc. The contacts'
            base moments are -0.8 and 1 times `moment`.
        length: length of the body.
    """

    arc: Array
    moment: Array
    bound: Array
    signal: Array
    separation: Array
    pair_bound: Array
    length: float

    @property
    def detected(self) -> npt.NDArray[np.bool_]:
        """(M, A) whether a contact there is reported in nine of ten cases."""
        return np.asarray(self.signal > DETECTABLE)


def arc_bounds(
    arcs: npt.ArrayLike,
    forces: npt.ArrayLike,
    position: npt.ArrayLike,
    span: npt.ArrayLike,
    noise: npt.ArrayLike,
    length: float,
    offset_error: float = 0.0,
) -> Array:
    """Cramer-Rao bounds of the arcs of contacts, if their forces are unknown as well.

    Args:
        arcs, forces: (k,) places of the contacts, and their forces over EI.
        position: (N,) sensor centres.
        span, noise: scalar or (N,), as in `localize`.
        length: length of the body.
        offset_error: standard deviation of an error that all readings share.

    Returns:
        (k,) standard deviations of the arcs; infinite where the readings fix no place.
    """
    x = vector(position, "position")
    width, sigma = (np.broadcast_to(vector(v, "span", x.size), x.shape) for v in (span, noise))
    place, force = np.atleast_1d(arcs)[:, None], np.atleast_1d(forces)[:, None]
    step = _STEP * length
    slope = (phi(place + step, x, width) - phi(place - step, x, width)) / (2.0 * step)
    rows = np.concatenate([phi(place, x, width), force * slope]) / sigma
    information = rows @ rows.T
    if offset_error > 0.0:
        shared = offset_error / sigma
        projection = rows @ shared
        information -= np.outer(projection, projection) / (1.0 + shared @ shared)
    scale = np.sqrt(np.diag(information))
    count = len(place)
    if not (scale > 1e-150).all():
        return np.full(count, np.inf)
    try:
        factor = np.linalg.cholesky(information / np.outer(scale, scale))
    except np.linalg.LinAlgError:
        return np.full(count, np.inf)
    if (np.diag(factor) ** 2 < _SINGULAR).any():
        return np.full(count, np.inf)
    inverse = np.linalg.inv(factor)
    return np.asarray(np.sqrt((inverse**2).sum(axis=0)) / scale)[count:]


def identifiability(
    position: npt.ArrayLike,
    *,
    length: float,
    noise: npt.ArrayLike,
    span: npt.ArrayLike = 0.0,
    offset_error: float = 0.0,
    separations: npt.ArrayLike | None = None,
) -> Identifiability:
    """Bounds of one contact and of two for a proposed layout.

    Args:
        position: (N,) sensor centres.
        length: length of the body.
        noise: standard deviation of a reading, scalar or (N,).
        span: length of each sensor, scalar or (N,).
        offset_error: standard deviation of an error that all readings share.
        separations: (S,) distances between two contacts; by default twelve, evenly spaced.

    Raises:
        DataError: for what `localize` refuses, and for a separation beyond the length.
    """
    total = everted_length(length)
    x = vector(position, "position")
    width = np.broadcast_to(vector(span, "span", x.size), x.shape)
    sigma = np.broadcast_to(vector(noise, "noise", x.size), x.shape)
    check_layout(x, width, total)
    if not (sigma > 0.0).all():
        raise DataError("noise is not above zero", "give the standard deviation of a reading")
    shared = positive(offset_error, "offset_error")
    if separations is None:
        gaps = np.linspace(1.0, 12.0, 12) / 13.0 * total
    else:
        gaps = np.atleast_1d(np.asarray(separations, dtype=np.float64))
    if not ((gaps >= 0.0) & (gaps <= total * (1.0 + 1e-9))).all():
        raise DataError("separations are not all within the length", "check the units")
    # From 0.002 to 0.023 1/cm for 53 cm. The bounds fall in proportion as the moment grows.
    moment = np.geomspace(0.1, 1.2, 6) / total
    places = np.linspace(0.0, total, 107)
    lever, near = np.maximum(places, 1e-9 * total), np.maximum(total - gaps, 1e-9 * total)
    signal_per_moment = np.sqrt(((phi(places[:, None], x, width) / sigma) ** 2).sum(axis=1)) / lever

    layout = x, width, sigma, total, shared
    bounds = [
        arc_bounds(arc, 1.0 / arm, *layout)[0] for arc, arm in zip(places, lever, strict=True)
    ]
    two = [arc_bounds([arc, total], [-0.8 / arc, 1.0 / total], *layout) for arc in near]
    return Identifiability(
        arc=places,
        moment=moment,
        bound=np.array(bounds) / moment[:, None],
        signal=moment[:, None] * signal_per_moment,
        separation=gaps,
        pair_bound=np.array(two) / moment[:, None, None],
        length=total,
    )
