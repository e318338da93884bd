"""Converts headings along the body, as IMUs measure them, to the curvatures that `localize` takes.

The difference of two neighbouring headings over their distance is the mean curvature between them.
The error of each heading enters two differences, with opposite signs, so readings share it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from thigmo.errors import DataError

Floats = npt.NDArray[np.float64]


class CurvatureRows(NamedTuple):
    """Arguments of `localize`: N = M - 1 readings from M headings."""

    curvature: Floats  # (N,), or (F, N) for F frames, in 1/unit of length
    position: Floats  # (N,) middles of the spans
    span: Floats  # (N,) distances from one heading to the next
    shared_errors: Floats  # (N, M) effect of one standard error of each heading


def from_headings(
    heading: npt.ArrayLike, arc: npt.ArrayLike, error: npt.ArrayLike
) -> CurvatureRows:
    """Readings of curvature from headings along the body.

    Args:
        heading: (M,) or (F, M) headings in the plane, rad; jumps by a full turn are removed.
        arc: (M,) ascending arcs at which they are measured. For a base that cannot turn, add an arc
            of 0 with a heading and an error of 0.
        error: standard errors of the headings, rad, scalar or (M,), independent of each other.

    Raises:
        DataError: the arcs do not ascend, or there is not one heading for each arc.
    """
    places, turned = np.asarray(arc, dtype=np.float64), np.asarray(heading, dtype=np.float64)
    if places.ndim != 1 or places.size < 2 or not (np.diff(places) > 0).all():
        raise DataError("the arcs of headings do not ascend", "sort them from the base to the tip")
    if turned.shape[-1] != places.size:
        raise DataError(
            f"{turned.shape[-1]} headings at {places.size} arcs", "give a heading for each arc"
        )
    span = np.diff(places)
    sigma = np.broadcast_to(np.asarray(error, dtype=np.float64), places.shape)
    difference = np.diff(np.eye(places.size), axis=0) / span[:, None]
    return CurvatureRows(
        np.diff(np.unwrap(turned), axis=-1) / span,
        (places[1:] + places[:-1]) / 2,
        span,
        difference * sigma,
    )
