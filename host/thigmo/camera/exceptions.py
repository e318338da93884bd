"""What can go wrong between a lens and a number, each with the operator's next step.

Raised by every part of the camera; calibration catches them per picture, so that one bad picture
is named and omitted instead of averaged in.
"""

from thigmo.errors import ThigmoError


class CameraError(ThigmoError):
    """Base of everything the camera reports."""


class PictureError(CameraError):
    """No picture can be had from the source."""


class SheetHiddenError(CameraError):
    """Too few of the workspace cards can be seen."""

    def __init__(self, hidden: tuple[str, ...], seen: int, other: str = "") -> None:
        super().__init__(
            f"only {seen} workspace card(s) are seen; hidden: {', '.join(hidden)}",
            f'the picture shows markers of {other}: write dictionary = "{other}" into the sheet '
            "file, and the cards' first_id"
            if other
            else "uncover the cards, avoid glare on them, and check that the picture holds all",
        )


class CameraMovedError(CameraError):
    """The cards are no longer where the calibration saw them."""


class MarkerMissingError(CameraError):
    """The tip marker is not seen."""


class MarkerAstrayError(CameraError):
    """The tip marker does not sit at the body's end."""


class BodyNotSeenError(CameraError):
    """The robot's body cannot be distinguished from what lies around it."""


class AxisDoubtfulError(CameraError):
    """An axis was found that may not be the body's, or not all of it."""


class TooCoarseError(CameraError):
    """The picture has too few pixels for what is looked for."""


class PlaneFitError(CameraError):
    """Marker corners and sheet geometry do not agree."""
