"""Paints the table that own-robot.md's camera looks at: `python -m painted FILE`."""

import sys

import numpy as np

from thigmo.camera import Sheet
from thigmo.camera.detection import write_picture
from thigmo.camera.sheet import card_decals, tip_decal
from thigmo.emulator.render import BodyShape, Look, PegShape, View, overhead_camera, render
from thigmo_bench.studies.camera import axis_of

SHEET = Sheet(camera_height_cm=105.0)


def main() -> None:
    """Robot, two dowels, four cards, one tip marker."""
    _, _, x, y = axis_of(np.full(400, 0.02), 53.0)
    pegs = [PegShape(30.0, -8.0, 1.0), PegShape(20.0, 14.0, 1.4)]
    decals = [*card_decals(SHEET), tip_decal(SHEET, x, y, 3.5)]
    view = View(BodyShape(x, y), pegs, decals)
    picture = render(overhead_camera(None), view, Look(), np.random.default_rng(5))
    write_picture(sys.argv[1], picture)


if __name__ == "__main__":
    main()
