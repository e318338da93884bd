"""The camera of the guided steps: one located camera, one source of pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import count

import numpy as np
from numpy.typing import NDArray

from thigmo.camera import (
    AxisDoubtfulError,
    CameraModel,
    Detection,
    PictureSource,
    Sheet,
    Wanted,
    detect,
)
from thigmo.camera import render as painter
from thigmo.camera.centerline import Centerline
from thigmo.camera.sheet import card_decals, tip_decal
from thigmo.config import Body
from thigmo.robot import Robot


@dataclass
class OverheadCamera:
    """The located camera above the robot, for the guided steps."""

    source: PictureSource  # gives pictures; live ones show the robot as it is now
    model: CameraModel  # the located camera
    sheet: Sheet  # the sheet of markers in use
    body: Body = field(default_factory=Body)  # the robot's body
    dowel_radius_cm: float | None = None  # radius of the obstacles; detection errs less with it

    @property
    def _wanted(self) -> Wanted:
        return Wanted(self.body.diameter_cm, full_cm=self.body.length_cm)

    def axis(self, *, free_bend: bool, length_cm: float | None = None) -> Centerline:
        """The body's axis. A pushed tip needs its marker, a free bend does not.

        Raises CameraError if the axis is in doubt.
        """
        wanted = replace(
            self._wanted, constant=free_bend, obstacles=False, length_cm=length_cm,
        )  # fmt: skip
        detection = detect(self.source.read(), self.model, self.sheet, wanted)
        doubtful = any(isinstance(problem, AxisDoubtfulError) for problem in detection.problems)
        if doubtful or detection.axis is None or (detection.tip is None and not free_bend):
            raise detection.problems[-1]
        return detection.axis

    def everything(self) -> Detection:
        """Detect tip, axis and obstacles. Raises CameraError if the robot is not found."""
        wanted = self._wanted
        if (radius := self.dowel_radius_cm) is not None:
            wanted = replace(wanted, obstacle_radius_cm=(0.8 * radius, 1.2 * radius))
        return detect(self.source.read(), self.model, self.sheet, wanted)


def emulated_source(
    robot: Robot,
    sheet: Sheet,
    *,
    seed: int = 0,
    spoil: Callable[[CameraModel], CameraModel] | None = None,
) -> tuple[PictureSource, float]:
    """A camera above an emulated robot, and its height (cm) as measured with a tape.

    `seed` determines its place, lens and room; `spoil` changes it before every picture, for tests.
    """
    rng = np.random.default_rng([seed, 0xCA3E4A])
    of = (robot.known_config or robot.config).body
    camera = painter.overhead_camera(rng, of.length_cm)
    room = painter.random_look(rng, of.length_cm)
    measured = float(camera.eye_cm[2] + rng.normal(0, 0.5))
    table_seed = int(rng.integers(1 << 31))
    numbers = count(1)

    def paint() -> NDArray[np.uint8]:
        truth = robot.scenery()
        x, y = truth.centreline[:, 3:].T
        patches, body = card_decals(sheet), None
        if truth.length_cm > 2.0:
            body = painter.BodyShape(x, y, of.radius_cm)
            patches.append(tip_decal(sheet, x, y, of.diameter_cm))
        pegs = [painter.PegShape(float(p.x), float(p.y), float(p.radius)) for p in truth.pegs]
        # The room stays the same, the noise changes from picture to picture.
        return painter.render(
            camera if spoil is None else spoil(camera), painter.View(body, pegs, patches), room,
            np.random.default_rng(table_seed), np.random.default_rng([table_seed, next(numbers)]),
        )  # fmt: skip

    return PictureSource(paint, live=True), measured
