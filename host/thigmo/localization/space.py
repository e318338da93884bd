"""Prepares a body in space for the compiled code: the readings' axes, stiffness and weight.

Components are in a frame that is carried along the body without twist: along the body, towards
angle 0, and towards a quarter turn from it (`space.h`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from thigmo.errors import DataError
from thigmo.localization.options import Body, Sensors
from thigmo.localization.validation import Array, positive, vector

_CELLS = 96  # into which the body is divided
_SMOOTH = 1e-4  # weight of smoothness between sensors against that of a reading


class Space(NamedTuple):
    """The compiled code's arguments for a body in space; all are empty for a body in a plane."""

    axis: Array  # (N, 3) unit vector about which each sensor measures the turn per length
    curvature_map: Array  # (2 cells, N) linear map from readings to both curvatures of each cell
    compliance: Array  # (3,) EI over the stiffness against twist and both bends
    weight: Array  # (3,) weight over EI of a body of length one


def in_space(body: Body, sensors: Sensors, position: Array, span: Array) -> Space:
    """The arguments for a body in space, if it has angles, axes or a weight; else empty ones.

    Raises:
        DataError: angles, axes, twist or weight are impossible.
    """
    twist = positive(body.twist, "twist")
    if sensors.angle is None and sensors.axis is None and body.weight is None:
        if twist > 0.0:
            raise DataError("twist is given without angles", "give angle, too")
        return Space(np.zeros((0, 3)), np.zeros((0, 0)), np.zeros(0), np.zeros(0))
    weight = vector(np.zeros(3) if body.weight is None else body.weight, "weight")
    if weight.size != 3 or not np.isfinite(weight).all():
        raise DataError(
            f"weight is {body.weight!r}", "give three numbers: along the base, and across it twice"
        )
    axis = _axes(sensors, position.size)
    return Space(
        axis, _curvature_map(position / body.length, span / body.length, axis),
        np.array([twist, 1.0, 1.0]), weight * body.length**3,
    )  # fmt: skip


def _axes(sensors: Sensors, count: int) -> Array:
    """(N, 3) unit vectors of the axes about which the sensors measure the turn per length."""
    if sensors.axis is None:
        angle = _numbers(0.0 if sensors.angle is None else sensors.angle, "angle")
        if angle.ndim > 1 or angle.size not in (1, count):
            raise DataError(f"angle has shape {angle.shape}", "give an angle for each sensor")
        if np.abs(angle).max() > 4.0 * np.pi:
            raise DataError(
                f"an angle is {np.abs(angle).max():g}", "it looks like degrees: give rad"
            )
        angle = np.broadcast_to(angle, count)
        return np.column_stack([np.zeros(count), -np.sin(angle), np.cos(angle)])
    if sensors.angle is not None:
        raise DataError("angle and axis are both given", "leave one of them out")
    axis = _numbers(sensors.axis, "axis")
    if axis.shape != (count, 3):
        raise DataError(f"axis has shape {axis.shape}", "give a unit vector for each sensor")
    if np.abs(np.linalg.norm(axis, axis=1) - 1.0).max() > 1e-3:
        raise DataError("an axis is no unit vector", "divide each by its length")
    return np.ascontiguousarray(axis)


def _numbers(values: npt.ArrayLike, name: str) -> Array:
    try:
        numbers = np.asarray(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise DataError(f"{name} is not numeric", "give numbers for each sensor") from error
    if not np.isfinite(numbers).all():
        raise DataError(f"{name} is not finite", "give numbers for each sensor")
    return numbers


def _curvature_map(position: Array, span: Array, axis: Array) -> Array:
    """(2 cells, N) map to curvatures about normal and binormal, by smoothed least squares."""
    low, high = (np.clip(position + side * span / 2.0, 0.0, 1.0) for side in (-1.0, 1.0))
    low, high = np.minimum(low, 1.0 - 0.5 / _CELLS), np.maximum(high, low + 0.5 / _CELLS)
    edges = np.linspace(0.0, 1.0, _CELLS + 1)
    inside = np.minimum(high[:, None], edges[1:]) - np.maximum(low[:, None], edges[:-1])
    share = np.maximum(inside, 0.0) / (high - low)[:, None]
    design = (share[:, :, None] * axis[:, None, 1:]).reshape(len(axis), -1)
    step = np.diff(np.eye(_CELLS), axis=0)
    smooth = np.kron(_SMOOTH * _CELLS * step.T @ step + 1e-9 * np.eye(_CELLS), np.eye(2))
    return np.linalg.solve(design.T @ design + smooth, design.T)
