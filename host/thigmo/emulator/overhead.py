"""An overhead camera above the emulated room: pictures of it as it is when they are taken."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count

import numpy as np

from thigmo.camera import CameraModel, PictureSource, Sheet
from thigmo.camera.model import Picture
from thigmo.camera.sheet import card_decals, tip_decal
from thigmo.config import Body
from thigmo.emulator.plant import Truth
from thigmo.emulator.render import (
    BodyShape,
    PegShape,
    View,
    overhead_camera,
    random_look,
    render,
)


def overhead_pictures(
    truth: Callable[[], Truth],
    body: Body,
    sheet: Sheet,
    *,
    seed: int = 0,
    spoil: Callable[[CameraModel], CameraModel] | None = None,
) -> tuple[PictureSource, float]:
    """Pictures of an emulated room, and the camera's height (cm) as measured with a tape.

    Args:
        truth: gives the room as it is now.
        body: of the robot.
        sheet: the printed cards and the tip's marker.
        seed: determines the camera's place and lens, and the room's light.
        spoil: changes the camera before every picture, for tests.
    """
    rng = np.random.default_rng([seed, 0xCA3E4A])
    camera = overhead_camera(rng, body.length_cm)
    look = random_look(rng, body.length_cm)
    measured = float(camera.eye_cm[2] + rng.normal(0, 0.5))
    table_seed = int(rng.integers(1 << 31))
    numbers = count(1)

    def paint() -> Picture:
        room = truth()
        x, y = room.centreline[:, 3:].T
        patches, shape = card_decals(sheet), None
        if room.length_cm > 2.0:
            shape = BodyShape(x, y, body.radius_cm)
            patches.append(tip_decal(sheet, x, y, body.diameter_cm))
        pegs = [PegShape(float(p.x), float(p.y), float(p.radius)) for p in room.pegs]
        # The room stays the same, the noise changes from picture to picture.
        return render(
            camera if spoil is None else spoil(camera), View(shape, pegs, patches), look,
            np.random.default_rng(table_seed), np.random.default_rng([table_seed, next(numbers)]),
        )  # fmt: skip

    return PictureSource(paint, live=True), measured
