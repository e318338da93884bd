"""The overhead camera: printed sheet, lens and pose, tip, axis with curvature, round obstacles.

Used by calibration and by the `thigmo camera` commands, which load it when they need it: OpenCV is
heavy.
"""

from thigmo.camera.centerline import fit_centerline
from thigmo.camera.detection import Detection, DetectionRequest, detect, draw
from thigmo.camera.exceptions import (
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
from thigmo.camera.model import CameraModel, Lens, calibrate_lens
from thigmo.camera.pose import locate
from thigmo.camera.sheet import Sheet, print_sheet
from thigmo.camera.source import PictureSource, open_source

__all__ = [
    "AxisDoubtfulError",
    "BodyNotSeenError",
    "CameraError",
    "CameraModel",
    "CameraMovedError",
    "Detection",
    "DetectionRequest",
    "Lens",
    "MarkerAstrayError",
    "MarkerMissingError",
    "PictureError",
    "PictureSource",
    "PlaneFitError",
    "Sheet",
    "SheetHiddenError",
    "TooCoarseError",
    "calibrate_lens",
    "detect",
    "draw",
    "fit_centerline",
    "locate",
    "open_source",
    "print_sheet",
]
