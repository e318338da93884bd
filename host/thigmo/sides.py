"""Sides of the plane in which a robot moves, and angles around its body.

x runs along the straight robot from its base, y to its left. Angles around the body are in
degrees: 90 is +y (left), 270 is -y (right), 0 and 180 leave the plane.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from thigmo.toml_model import Model

Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")
SIGN: dict[Side, float] = {"left": 1.0, "right": -1.0}  # of curvature towards a side
_SIDES_AT: dict[float, Side] = {90.0: "left", 270.0: "right"}
DEGREES: dict[Side, float] = {side: degrees for degrees, side in _SIDES_AT.items()}

Angle = Annotated[float, Field(ge=0, lt=360, allow_inf_nan=False)]  # around the body, degrees


def side_at(angle_deg: float) -> Side | None:
    """The side of the plane at an angle; None out of it."""
    return _SIDES_AT.get(angle_deg)


def opposite(side: Side) -> Side:
    """The other side of the plane."""
    return "right" if side == "left" else "left"


class Placed(Model):
    """What lies at an angle around the body."""

    angle_deg: Angle = 90.0  # 90 is left, 270 right; 0 and 180 leave the plane

    @property
    def side(self) -> Side | None:
        """The side of the plane; None out of it."""
        return side_at(self.angle_deg)
