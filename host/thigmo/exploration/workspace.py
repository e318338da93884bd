"""From arc length to the room: the robot's bent shape, and where on its skin a contact is.

The curvature along the body is the free curvature plus what the sensors read above it, which falls
to nothing at the last contact, plus the fold at the base where there is one. Its integral is the
heading, the integral of the heading is the shape. So the shape follows the readings, whatever the
contact's mechanics. A contact's uncertainty is its interval along the body and the shape's own: a
common error of the free curvature bends it all, and between two sensors the bend is interpolated.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thigmo.mechanics import heading_along, traced
from thigmo.record import Pose

Floats = NDArray[np.float64]
_STEP_CM = 0.25
_ONE_PLACE_CM = 1.0  # sensors so near each other read one bend: their difference is noise
# One sigma of the skin across the body, over the length: between two sensors, and at the fold, the
# bend is interpolated. Over random rooms of the large-deflection plant 0.1 to 0.6 of 53 cm remain.
_SHAPE_SHARE = 0.5 / 53


@dataclass(frozen=True, slots=True)
class Bend:
    """What bends the body."""

    length_cm: float  # everted length
    free_curvature: float  # of the inflated muscle, 1/cm, signed
    # (arc in cm, curvature above the free one in 1/cm), base first, linear in between and zero
    # beyond the last
    excess: tuple[tuple[float, float], ...] = ()
    fold_rad: float = 0.0  # angle of a fold at the base, signed; 0 without one
    # standard error of a common curvature that puts the contact as far off as the shape's own, 1/cm
    curvature_se: float = 0.0


@dataclass(frozen=True, slots=True)
class Curve:
    """A sampled centreline: arc, x, y in cm and heading in rad, each of shape (n,)."""

    arc: Floats
    x: Floats
    y: Floats
    heading: Floats

    def pose(self, arc_cm: float) -> Pose:
        """Point and heading at an arc length, clipped to the body."""
        return (
            float(np.interp(arc_cm, self.arc, self.x)),
            float(np.interp(arc_cm, self.arc, self.y)),
            float(np.interp(arc_cm, self.arc, self.heading)),
        )

    def poses(self, spacing_cm: float = 0.5) -> list[Pose]:
        """The curve for the record, evenly spaced, tip included."""
        count = max(2, round(float(self.arc[-1]) / spacing_cm) + 1)
        rounded = (self.pose(float(s)) for s in np.linspace(0.0, float(self.arc[-1]), count))
        return [(round(x, 4), round(y, 4), round(h, 5)) for x, y, h in rounded]


def centreline(bend: Bend) -> Curve:
    """Integrate the body's curvature to its shape, base at the origin, heading along x."""
    count = max(2, int(np.ceil(bend.length_cm / _STEP_CM)) + 1)
    arc = np.linspace(0.0, bend.length_cm, count)
    heading = bend.fold_rad + bend.free_curvature * arc
    step = np.diff(arc)
    if bend.excess:
        knots = np.array(bend.excess)
        above = np.interp(arc, knots[:, 0], knots[:, 1], right=0.0)
        heading = heading + heading_along(above, step)
    return Curve(arc, *traced(heading, step), heading)


def _at_base(x: Floats, y: Floats, end: tuple[float, float]) -> float:
    """Curvature at the base, on the line through the first place with sensors and the next.

    Sensors at `x`, base first, read `y`; without a next place the line goes through `end`.
    """
    first = x < x[0] + _ONE_PLACE_CM
    after_x, after_y = end if first.all() else (x[~first][0], y[~first][0])
    mean_x, mean_y = x[first].mean(), y[first].mean()
    return float(mean_y + (mean_y - after_y) * mean_x / (after_x - mean_x))


def measured_bend(length_cm: float, centers: Floats, curvature: Floats) -> Bend:
    """The bent body by the readings (N,) in 1/cm of sensors at `centers` (N,) in cm, in any order.

    It is linear between their centres, and constant beyond the last.
    """
    along = np.argsort(centers)
    centers, curvature = centers[along], curvature[along]
    end = length_cm, float(curvature[-1])
    at_base = _at_base(centers, curvature, end)
    inner = zip(centers.tolist(), curvature.tolist(), strict=True)
    return Bend(length_cm, 0.0, ((0.0, at_base), *inner, end))


def common_error(arc_cm: float, centers: Floats, covariance: Floats) -> float:
    """Standard error of the mean curvature that displaces a point as the sensors' errors do, 1/cm.

    Args:
        arc_cm: arc of the point.
        centers: (N,) of the sensors, cm, in any order.
        covariance: (N, N) of their curvatures, 1/cm^2.
    """
    along = np.argsort(centers)
    arc = np.arange(0.0, arc_cm, _STEP_CM)
    lever = arc_cm - arc
    units = np.eye(len(centers))[:, along]
    share = np.array([np.interp(arc, centers[along], unit) @ lever for unit in units])
    share /= max(lever.sum(), _STEP_CM)
    return float(np.sqrt(share @ covariance @ share))


def ramp_knots(contacts: Iterable[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """The excess curvature that contacts cause on a straight beam: a ramp to each of them.

    A contact is an arc in cm and a force over EI in 1/cm^2.
    """
    known = sorted(contacts)
    places = [0.0, *(arc for arc, _ in known)]
    return tuple(
        (place, sum(force * max(arc - place, 0.0) for arc, force in known)) for place in places
    )


def skin_point(
    curve: Curve, arc_cm: float, force: float, radius_cm: float, end_offset_cm: float | None = None
) -> Pose:
    """Point of the skin that a contact touches, and the direction from the centreline to it.

    A force that adds positive curvature pushes towards +y, so it comes from the other side. A
    contact on the end bears `end_offset_cm` to the +y side of the centreline.
    """
    x, y, heading = curve.pose(arc_cm)
    across = -np.copysign(radius_cm, force) if end_offset_cm is None else end_offset_cm
    normal = heading + np.copysign(np.pi / 2, across)
    return (x - across * float(np.sin(heading)), y + across * float(np.cos(heading)), float(normal))


class PlacedContact(NamedTuple):
    """A contact in the workspace: the skin point, its covariance, and its interval drawn out."""

    x_cm: float
    y_cm: float
    normal_rad: float
    covariance_cm2: tuple[tuple[float, float], tuple[float, float]]
    track: list[tuple[float, float]]


def place_contact(
    bend: Bend,
    arc: float,
    force: float,
    interval_cm: Sequence[float],
    *,
    radius_cm: float,
    end_offset_cm: float | None = None,
) -> PlacedContact:
    """Put one of the bend's contacts into the room.

    Its arc has a 95 % interval; the sign of its force over EI says from which side it comes. A
    contact on the end of the body bears `end_offset_cm` to the +y side of the centreline.
    """
    curve = centreline(bend)
    x, y, normal = skin_point(curve, arc, force, radius_cm, end_offset_cm)
    low, high = (float(np.clip(end, 0.0, bend.length_cm)) for end in interval_cm)
    # What bears on the end may be on either side of its corner, and anywhere across its face.
    side = force if end_offset_cm is None else -bend.free_curvature
    track = [skin_point(curve, float(s), side, radius_cm)[:2] for s in np.linspace(low, high, 25)]
    if end_offset_cm is not None:
        end, across_face = bend.length_cm, np.copysign(radius_cm, -side) * np.linspace(1.0, -1.0, 9)
        track += [
            skin_point(curve, end, side, radius_cm, float(offset_cm))[:2]
            for offset_cm in across_face
        ]
    # Along the body: 95 % of a normal error spans 3.92 standard deviations.
    heading = curve.pose(arc)[2]
    along = (high - low) / 3.92 * np.array([np.cos(heading), np.sin(heading)])
    bent = replace(bend, free_curvature=bend.free_curvature + bend.curvature_se)
    moved = skin_point(centreline(bent), arc, force, radius_cm, end_offset_cm)
    across = np.array([moved[0] - x, moved[1] - y])
    # On the end it bears anywhere across the face, which readings hardly tell.
    face = 0.0 if end_offset_cm is None else radius_cm / np.sqrt(3.0)
    out = np.hypot(_SHAPE_SHARE * bend.length_cm, face) * np.array([np.cos(normal), np.sin(normal)])
    covariance = np.outer(along, along) + np.outer(across, across) + np.outer(out, out)
    (xx, xy), (yx, yy) = covariance.tolist()
    drawn = [(round(px, 4), round(py, 4)) for px, py in track]
    return PlacedContact(x, y, normal, ((xx, xy), (yx, yy)), drawn)


def place_stalled_tip(
    bend: Bend, arc: float, interval_cm: tuple[float, float], radius_cm: float, unread_cm: float
) -> PlacedContact:
    """Put what stopped a tip into the room: at an arc within its interval, in front of the tip.

    It is anywhere in the interval along the body, and anywhere across the tip's face. `unread_cm`:
    one sigma by which the tip is elsewhere, either way, since no sensor reads the body's bends.
    """
    curve, (low, high) = centreline(bend), interval_cm
    x, y, heading = curve.pose(arc)
    along = np.hypot((high - low) / np.sqrt(12.0), unread_cm)
    # A common curvature displaces the tip across the body by half of its square.
    across = np.hypot(2 * radius_cm / np.sqrt(12.0), bend.curvature_se * arc**2 / 2)
    across = np.hypot(across, unread_cm)
    axes = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    (xx, xy), (yx, yy) = ((axes * [along**2, across**2]) @ axes.T).tolist()
    track = [curve.pose(float(end))[:2] for end in (low, high)]
    drawn = [(round(px, 4), round(py, 4)) for px, py in track]
    return PlacedContact(x, y, heading, ((xx, xy), (yx, yy)), drawn)
