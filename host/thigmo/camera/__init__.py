"""The overhead camera: printed sheet, lens and pose, tip, axis with curvature, round obstacles.

Used by calibration and by the `thigmo camera` commands. Names load on first use: OpenCV is heavy.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from thigmo.camera.centerline import Centerline, fit_centerline
    from thigmo.camera.clicks import Clicks, click
    from thigmo.camera.errors import (
        AxisDoubtfulError,
        BodyNotSeenError,
        CameraError,
        CameraMovedError,
        MarkerAstrayError,
        MarkerMissingError,
        PictureError,
        PlaneFitError,
        SheetHiddenError,
        TooCoarseError,
    )
    from thigmo.camera.model import CameraModel, Lens, calibrate_lens, check_still
    from thigmo.camera.obstacles import Obstacle
    from thigmo.camera.pose import locate
    from thigmo.camera.sheet import Card, Sheet, print_sheet
    from thigmo.camera.sight import Seen, Sighting, TipSighting, draw, look, see_tip
    from thigmo.camera.source import Painted, PictureSource, open_source

_HOME = {
    "AxisDoubtfulError": "errors",
    "BodyNotSeenError": "errors",
    "CameraError": "errors",
    "CameraModel": "model",
    "CameraMovedError": "errors",
    "Card": "sheet",
    "Centerline": "centerline",
    "Clicks": "clicks",
    "Lens": "model",
    "MarkerAstrayError": "errors",
    "MarkerMissingError": "errors",
    "Obstacle": "obstacles",
    "Painted": "source",
    "PictureError": "errors",
    "PictureSource": "source",
    "PlaneFitError": "errors",
    "Seen": "sight",
    "Sheet": "sheet",
    "SheetHiddenError": "errors",
    "Sighting": "sight",
    "TipSighting": "sight",
    "TooCoarseError": "errors",
    "calibrate_lens": "model",
    "check_still": "model",
    "click": "clicks",
    "draw": "sight",
    "fit_centerline": "centerline",
    "locate": "pose",
    "look": "sight",
    "open_source": "source",
    "print_sheet": "sheet",
    "see_tip": "sight",
}

__all__ = [
    "AxisDoubtfulError",
    "BodyNotSeenError",
    "CameraError",
    "CameraModel",
    "CameraMovedError",
    "Card",
    "Centerline",
    "Clicks",
    "Lens",
    "MarkerAstrayError",
    "MarkerMissingError",
    "Obstacle",
    "Painted",
    "PictureError",
    "PictureSource",
    "PlaneFitError",
    "Seen",
    "Sheet",
    "SheetHiddenError",
    "Sighting",
    "TipSighting",
    "TooCoarseError",
    "calibrate_lens",
    "check_still",
    "click",
    "draw",
    "fit_centerline",
    "locate",
    "look",
    "open_source",
    "print_sheet",
    "see_tip",
]


def __getattr__(name: str) -> Any:
    """Import a public name from its home on first use."""
    if name in _HOME:
        value = getattr(import_module(f"thigmo.camera.{_HOME[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'thigmo.camera' has no attribute {name!r}")
