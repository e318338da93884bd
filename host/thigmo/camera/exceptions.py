"""Errors of the camera, each with the operator's next step.

Every part of the camera raises them. Calibration catches them for each picture, so that a bad
picture is named and omitted instead of averaged in.
"""

from thigmo.errors import ThigmoError


class CameraError(ThigmoError):
    """Base of all errors of the camera."""


class PictureError(CameraError):
    """The source gives no picture."""


class SheetHiddenError(CameraError):
    """Too few of the workspace cards can be seen."""

    def __init__(self, hidden: tuple[str, ...], count: int, dictionary_in_view: str = "") -> None:
        cure = "uncover the cards, avoid glare on them, and check that the picture holds all"
        if family := dictionary_in_view:
            cure = (
                f'the picture shows markers of {family}: write dictionary = "{family}" into the '
                "sheet file, and the cards' first_id"
            )
        super().__init__(
            f"only {count} workspace card(s) are seen; hidden: {', '.join(hidden)}", cure
        )


class CameraMovedError(CameraError):
    """The cards are no longer where the calibration saw them."""


class MarkerMissingError(CameraError):
    """The tip marker is not seen."""


class MarkerAstrayError(CameraError):
    """The tip marker is not at the end of the body."""


class BodyNotSeenError(CameraError):
    """The robot's body cannot be distinguished from its surroundings."""


class AxisDoubtfulError(CameraError):
    """An axis was found that may not be the body's, or not all of it."""


class TooCoarseError(CameraError):
    """The picture has too few pixels for markers or body."""


class PlaneFitError(CameraError):
    """Marker corners and sheet geometry do not agree."""
