"""From arc length to the room: the robot's bent shape, and where on its skin a contact is.

The curvature along the body is the free curvature plus one ramp for each contact (METHODS: a
contact moment falls linearly to the contact), plus the fold at the base where there is one. Its
integral is the heading, the integral of the heading is the shape. A contact's uncertainty is its
interval along the body and the shape's own: a common error of the free curvature bends it all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thigmo.record import Pose

Floats = NDArray[np.float64]
_STEP_CM = 0.25


@dataclass(frozen=True, slots=True)
class Bend:
    """What bends the body.

    Attributes:
        length_cm: everted length.
        free_curvature: of the inflated muscle, 1/cm, signed.
        contacts: (arc in cm, force over EI in 1/cm^2) of each contact.
        fold_rad: angle of a fold at the base, signed; 0 without one.
    """

    length_cm: float
    free_curvature: float
    contacts: tuple[tuple[float, float], ...] = ()
    fold_rad: float = 0.0


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
    for place, force in bend.contacts:
        beyond = np.maximum(place - arc, 0.0)
        heading = heading + force * (place**2 - beyond**2) / 2
    step = np.diff(arc)
    # Mid-point headings: second order, and exact enough at a quarter of a centimetre.
    middle = (heading[1:] + heading[:-1]) / 2
    x = np.concatenate(([0.0], np.cumsum(step * np.cos(middle))))
    y = np.concatenate(([0.0], np.cumsum(step * np.sin(middle))))
    return Curve(arc, x, y, heading)


def skin_point(curve: Curve, arc_cm: float, force: float, radius_cm: float) -> Pose:
    """Point of the skin that a contact touches, and the direction from the centreline to it.

    A force that adds positive curvature pushes to the left, so it comes from the right side.
    """
    x, y, heading = curve.pose(arc_cm)
    normal = heading - np.copysign(np.pi / 2, force)
    return (
        x + radius_cm * float(np.cos(normal)),
        y + radius_cm * float(np.sin(normal)),
        float(normal),
    )


@dataclass(frozen=True, slots=True)
class PlacedContact:
    """A contact in the workspace: the skin point, its covariance, and its interval drawn out."""

    x_cm: float
    y_cm: float
    normal_rad: float
    covariance_cm2: tuple[tuple[float, float], tuple[float, float]]
    track: list[tuple[float, float]]


def place_contact(
    bend: Bend,
    index: int,
    interval_cm: Sequence[float],
    *,
    radius_cm: float,
    curvature_se: float,
) -> PlacedContact:
    """Put one of the bend's contacts into the room.

    Args:
        bend: the body's shape at the moment of measurement.
        index: which of its contacts.
        interval_cm: 95 % interval of that contact's arc.
        radius_cm: of the tube.
        curvature_se: standard error of the common curvature, 1/cm.
    """
    arc, force = bend.contacts[index]
    curve = centreline(bend)
    x, y, normal = skin_point(curve, arc, force, radius_cm)
    low, high = (float(np.clip(end, 0.0, bend.length_cm)) for end in interval_cm)
    track = [skin_point(curve, float(s), force, radius_cm)[:2] for s in np.linspace(low, high, 25)]
    # Along the body: 95 % of a normal error spans 3.92 standard deviations.
    heading = curve.pose(arc)[2]
    along = (high - low) / 3.92 * np.array([np.cos(heading), np.sin(heading)])
    bent = Bend(bend.length_cm, bend.free_curvature + curvature_se, bend.contacts, bend.fold_rad)
    moved = skin_point(centreline(bent), arc, force, radius_cm)
    across = np.array([moved[0] - x, moved[1] - y])
    covariance = np.outer(along, along) + np.outer(across, across)
    return PlacedContact(
        x,
        y,
        normal,
        (
            (float(covariance[0, 0]), float(covariance[0, 1])),
            (float(covariance[1, 0]), float(covariance[1, 1])),
        ),
        [(round(px, 4), round(py, 4)) for px, py in track],
    )
