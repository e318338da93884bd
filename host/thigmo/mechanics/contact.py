"""Pegs and what they do to the body: the records that all mechanics models exchange.

A contact point is on the skin, not on the centreline: tube radius and peg radius separate the two.
Three kinds of contact: on the side (force along the normal of the centreline at the closest point),
on a corner of the flat end (oblique force that bears a tube radius off the centreline), and on the
face of the end.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal["side", "corner", "face"]


@dataclass(frozen=True, slots=True)
class Peg:
    """A round obstacle: centre and radius in cm."""

    x: float
    y: float
    radius: float


@dataclass(frozen=True, slots=True)
class PegContact:
    """One touching peg."""

    peg: int  # index into the pegs given
    arc: float  # arc length of the closest centreline point (cm); the everted length at the end
    kind: Kind  # where on the tube
    # force along the body's left normal at `arc` (1/cm^2, EI = 1): positive adds positive curvature
    # (the peg is on the right)
    normal: float
    # force along the body's tangent at `arc` (1/cm^2), negative pushes towards the base; 0 on the
    # side
    tangential: float
    # moment (1/cm, counter-clockwise positive) of the force about the centreline at `arc`: its
    # lever is the tube radius at a corner
    couple: float
    # x, y: contact point on the skin (cm)
    x: float
    y: float
    # force_x, force_y: force on the body in the workspace (1/cm^2)
    force_x: float
    force_y: float
