"""Headings along the body, as IMUs measure them, as curvature that `localize` takes.

Two neighbours' difference over their distance is the mean curvature between them. Each one's error
is in two differences, with opposite signs: an error that readings share.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from thigmo.errors import DataError

Floats = npt.NDArray[np.float64]


class CurvatureRows(NamedTuple):
    """Arguments of `localize`: N readings of M headings, N = M - 1."""

    curvature: Floats  # (N,) in 1/unit of length; (F, N) of frames
    position: Floats  # (N,) middles of the spans
    span: Floats  # (N,) from one heading to the next
    shared_errors: Floats  # (N, M) what each heading's standard error adds


def from_headings(
    heading: npt.ArrayLike, arc: npt.ArrayLike, error: npt.ArrayLike
) -> CurvatureRows:
    """Readings of curvature from headings along the body.

    Args:
        heading: (M,) or (F, M), rad, in the plane; full turns are taken out.
        arc: (M,) where they are measured, ascending; of a base that cannot turn, an arc of 0 with a
            heading and an error of 0.
        error: their standard errors, rad, scalar or (M,), independent of each other.

    Raises:
        DataError: arcs that do not ascend, or other numbers of headings.
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
