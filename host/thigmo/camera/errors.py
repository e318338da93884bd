"""What can go wrong between a lens and a number, each with the operator's next step.

Raised by every part of the camera; calibration catches them per picture, so that one bad picture
is named and left out instead of averaged in.
"""

from __future__ import annotations

from collections.abc import Iterable

from thigmo.errors import ThigmoError


class CameraError(ThigmoError):
    """Base of everything the camera reports."""


class PictureError(CameraError):
    """No picture can be had from the source."""


class SheetHiddenError(CameraError):
    """Too few of the workspace cards can be seen."""

    def __init__(self, hidden: Iterable[str], seen: int, other: str = "") -> None:
        self.hidden = tuple(hidden)
        super().__init__(
            f"only {seen} workspace card(s) are seen; hidden: {', '.join(self.hidden)}",
            f'the picture shows markers of {other}: write dictionary = "{other}" into the sheet '
            "file, and the cards' first_id"
            if other
            else "uncover the cards, avoid glare on them, and check that the picture holds all",
        )


class CameraMovedError(CameraError):
    """The cards are no longer where the calibration saw them."""

    def __init__(self, moved_px: float, moved_cm: float) -> None:
        self.moved_px = moved_px
        self.moved_cm = moved_cm
        super().__init__(
            f"the camera has moved: the cards stand {moved_px:.1f} px ({moved_cm:.2f} cm) "
            "from where it was calibrated",
            "fix the camera and run `thigmo camera locate` again",
        )


class MarkerMissingError(CameraError):
    """The tip marker is not seen."""

    def __init__(self, marker: int) -> None:
        self.marker = marker
        super().__init__(
            f"the tip marker (id {marker}) is not seen",
            "turn it face up and clear the view",
        )


class MarkerAstrayError(CameraError):
    """The tip marker does not sit at the body's end."""

    def __init__(self, marker: int, away_cm: float) -> None:
        self.marker = marker
        self.away_cm = away_cm
        super().__init__(
            f"the tip marker (id {marker}) lies {away_cm:.1f} cm from where the body ends",
            "stick it back on the tip, and clear the view of the body",
        )


class BodyNotSeenError(CameraError):
    """The robot's body cannot be told from what lies around it."""


class AxisDoubtfulError(CameraError):
    """An axis was found that may not be the body's, or not all of it."""


class TooCoarseError(CameraError):
    """The picture has too few pixels for what is looked for."""

    def __init__(self, what: str, px_per_cm: float, needed: float) -> None:
        self.px_per_cm = px_per_cm
        self.needed = needed
        super().__init__(
            f"the picture has {px_per_cm:.1f} px per cm, and {what} needs {needed:.1f}",
            f"take one {needed / px_per_cm:.1f} times as large, or bring the camera nearer",
        )


class PlaneFitError(CameraError):
    """Marker corners and sheet geometry do not agree."""
