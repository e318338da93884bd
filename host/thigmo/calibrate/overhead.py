"""The camera of the guided steps: one located camera, one source of pictures."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from thigmo.camera import (
    AxisDoubtfulError,
    CameraModel,
    Detection,
    DetectionRequest,
    PictureSource,
    Sheet,
    detect,
    locate,
)
from thigmo.camera.centerline import Centerline
from thigmo.config import Body
from thigmo.robot import Robot

CAMERA_SCALE_SE = 0.002  # relative error of the camera's scale, common to all that it measures


@dataclass
class OverheadCamera:
    """The located camera above the robot, for the guided steps."""

    source: PictureSource  # gives pictures; live ones show the robot as it is now
    model: CameraModel  # the located camera
    sheet: Sheet  # the sheet of markers in use
    body: Body = field(default_factory=Body)  # the robot's body
    dowel_radius_cm: float | None = None  # radius of the obstacles; detection errs less with it

    @property
    def _request(self) -> DetectionRequest:
        return DetectionRequest(self.body.diameter_cm, full_cm=self.body.length_cm)

    def axis(self, *, free_bend: bool, length_cm: float | None = None) -> Centerline:
        """The body's axis. A pushed tip needs its marker, a free bend does not.

        Raises CameraError if the axis is in doubt.
        """
        request = replace(
            self._request, constant=free_bend, obstacles=False, length_cm=length_cm,
        )  # fmt: skip
        detection = detect(self.source.read(), self.model, self.sheet, request)
        doubtful = any(isinstance(problem, AxisDoubtfulError) for problem in detection.problems)
        if doubtful or detection.axis is None or (detection.tip is None and not free_bend):
            raise detection.problems[-1]
        return detection.axis

    def detection(self) -> Detection:
        """Detect tip, axis and obstacles. Raises CameraError if the robot is not found."""
        request = self._request
        if (radius := self.dowel_radius_cm) is not None:
            request = replace(request, obstacle_radius_cm=(0.8 * radius, 1.2 * radius))
        return detect(self.source.read(), self.model, self.sheet, request)


def painted_camera(robot: Robot, sheet: Sheet, body: Body, seed: int) -> OverheadCamera | None:
    """The located camera over an emulated robot; None for a robot that is not emulated."""
    if (painted := robot.overhead_pictures(sheet, seed)) is None:
        return None
    source, height_cm = painted
    measured = sheet.model_copy(update={"camera_height_cm": height_cm})
    return OverheadCamera(source, locate(source.read(), measured), measured, body)
