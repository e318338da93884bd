"""Models the robot's printed pieces: docs/hardware/printed/*.step and *.stl, and pieces.svg.

    pip install -e ".[cad]"
    python tools/printed_parts.py            model and write all pieces
    python tools/printed_parts.py --check    fail if a piece is not of the stated size and volume

Lengths are in mm. Dimensions that the drawing `nozzle-and-spool` has are the same; the mounts are
for the parts of parts.csv. Nothing here has been printed yet.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from build123d import (
    Align,
    Axis,
    Box,
    Cylinder,
    Location,
    Part,
    Rot,
    export_step,
    export_stl,
    fillet,
)

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "hardware" / "printed"
SIZES = FOLDER / "sizes.json"
CENTER_MIN = (Align.CENTER, Align.CENTER, Align.MIN)

# Nozzle: the thesis's body is 35 mm across; the rest is this design's choice.
NOZZLE_OUTER, NOZZLE_INNER, NOZZLE_LENGTH = 35.0, 31.0, 60.0
FLANGE_OUTER, FLANGE_THICK = 64.0, 5.0
FLANGE_CIRCLE, M4_HOLE = 52.0, 4.4
RING_INNER, RING_THICK, RING_FROM_WALL = 12.0, 3.0, 4.0
# Spool: one layer of 17 turns of line.
SPOOL_CORE, SPOOL_WIDTH, SPOOL_FLANGE, SPOOL_FLANGE_THICK = 20.0, 20.0, 30.0, 3.0
SHAFT = 8.0  # of steel, between coupling, bearings, spool and brake
LINE_HOLE = 1.5
SET_SCREW = 3.3  # drilled for M4
# M1, Pololu 25D: two M3 on 17 mm, a boss of 7 mm, 25 mm across.
MOTOR_HOLES, MOTOR_BOSS, M3_HOLE = 17.0, 7.4, 3.4
# Bearing 608: 8 x 22 x 7.
BEARING_OUTER, BEARING_WIDTH = 22.1, 7.0
# BR1: any brake with three screws on a circle of 60 to 80 mm; measure yours.
BRAKE_CIRCLES, BRAKE_HOLE, BRAKE_SLOT = (60.0, 80.0), 26.0, 4.4
AXIS_HEIGHT = 48.0  # of the shaft above the base plate: more than a brake's radius
WALL, FOOT = 8.0, 30.0


def nozzle() -> Part:
    """The tube on which the body is clamped, its flange, and the stop ring inside."""
    piece = Cylinder(FLANGE_OUTER / 2, FLANGE_THICK, align=CENTER_MIN)
    piece += Cylinder(NOZZLE_OUTER / 2, NOZZLE_LENGTH, align=CENTER_MIN)
    piece -= Cylinder(NOZZLE_INNER / 2, NOZZLE_LENGTH, align=CENTER_MIN)
    ring = Cylinder(NOZZLE_OUTER / 2 - 0.5, RING_THICK, align=CENTER_MIN)
    ring -= Cylinder(RING_INNER / 2, RING_THICK, align=CENTER_MIN)
    piece += Location((0, 0, RING_FROM_WALL)) * ring
    for turn in range(4):
        hole = Cylinder(M4_HOLE / 2, FLANGE_THICK, align=CENTER_MIN)
        piece -= Rot(0, 0, 45 + 90 * turn) * Location((FLANGE_CIRCLE / 2, 0, 0)) * hole
    # No edge may cut the body that everts over the free end.
    rim = piece.faces().sort_by(Axis.Z)[-1].edges()
    return Part() + fillet(rim, (NOZZLE_OUTER - NOZZLE_INNER) / 4 - 0.05)


def spool() -> Part:
    """Core and flanges on the shaft, two set screws at right angles, a hole for the line."""
    flange = Cylinder(SPOOL_FLANGE / 2, SPOOL_FLANGE_THICK, align=CENTER_MIN)
    top = SPOOL_FLANGE_THICK + SPOOL_WIDTH
    hub = 10.0  # beyond a flange, for the set screws
    piece = flange + Location((0, 0, top)) * flange
    piece += Cylinder(SPOOL_CORE / 2, top + SPOOL_FLANGE_THICK + hub, align=CENTER_MIN)
    piece -= Cylinder(SHAFT / 2 + 0.05, 2 * top + hub, align=CENTER_MIN)
    for turn in (0, 90):
        screw = Rot(0, 90, 0) * Cylinder(SET_SCREW / 2, SPOOL_CORE, align=CENTER_MIN)
        piece -= Rot(0, 0, turn) * Location((0, 0, top + SPOOL_FLANGE_THICK + hub / 2)) * screw
    line = Rot(0, 90, 0) * Cylinder(LINE_HOLE / 2, SPOOL_FLANGE, align=CENTER_MIN)
    line_at = SPOOL_FLANGE_THICK + 1.0 + LINE_HOLE / 2
    return Part() + (piece - Location((0, 0, line_at)) * line)


def _bracket(width: float) -> Part:
    """An upright plate on a foot with four slots; the shaft's axis is at AXIS_HEIGHT along y."""
    plate = Box(width, WALL, AXIS_HEIGHT + width / 2, align=(Align.CENTER, Align.MIN, Align.MIN))
    foot = Box(width, FOOT, WALL, align=(Align.CENTER, Align.MIN, Align.MIN))
    piece = plate + foot
    for x in (-width / 2 + 8, width / 2 - 8):
        slot = Box(M4_HOLE, 12, WALL, align=(Align.CENTER, Align.CENTER, Align.MIN))
        piece -= Location((x, WALL + (FOOT - WALL) / 2, 0)) * slot
    return Part() + piece


def _along_shaft(radius: float, length: float, x: float = 0.0, z: float = 0.0) -> Part:
    """What a drill along the shaft takes away, from the plate's outer face."""
    drill = Rot(-90, 0, 0) * Cylinder(radius, length, align=CENTER_MIN)
    return Part() + Location((x, 0, AXIS_HEIGHT + z)) * drill


def motor_mount() -> Part:
    """M1's face on an upright plate."""
    piece = _bracket(40.0) - _along_shaft(MOTOR_BOSS / 2, WALL)
    for side in (-1, 1):
        piece -= _along_shaft(M3_HOLE / 2, WALL, x=side * MOTOR_HOLES / 2)
    return Part() + piece


def bearing_mount() -> Part:
    """A seat for one bearing; two of them carry the spool's shaft."""
    piece = _bracket(40.0) - _along_shaft(BEARING_OUTER / 2, BEARING_WIDTH)
    return Part() + (piece - _along_shaft(BEARING_OUTER / 2 - 2, WALL))


def brake_mount() -> Part:
    """An upright plate for BR1, with slots for three screws on circles of 60 to 80 mm."""
    piece = _bracket(92.0) - _along_shaft(BRAKE_HOLE / 2, WALL)
    low, high = (circle / 2 for circle in BRAKE_CIRCLES)
    for turn in (90, 210, 330):
        slot = Box(high - low + BRAKE_SLOT, WALL, BRAKE_SLOT,
                   align=(Align.CENTER, Align.MIN, Align.CENTER))  # fmt: skip
        moved = Location((0, 0, AXIS_HEIGHT)) * Rot(0, turn, 0) * Location(((low + high) / 2, 0, 0))
        piece -= moved * slot
    return Part() + piece


PIECES: dict[str, Callable[[], Part]] = {
    "nozzle": nozzle,
    "spool": spool,
    "motor-mount": motor_mount,
    "bearing-mount": bearing_mount,
    "brake-mount": brake_mount,
}


def size(piece: Part) -> dict[str, Any]:
    """What identifies a piece: its outer size and its volume, in mm and cm3."""
    box = piece.bounding_box().size
    return {
        "size_mm": [round(length, 1) for length in (box.X, box.Y, box.Z)],
        "volume_cm3": round(piece.volume / 1000, 1),
    }


def draw(pieces: dict[str, Part]) -> None:
    """Write pieces.svg: the visible edges of every piece at an angle, with its outer size."""
    figure, axes = plt.subplots(1, len(pieces), figsize=(11, 3.2))
    for place, (name, piece) in zip(axes, pieces.items(), strict=True):
        visible, _ = piece.project_to_viewport((-200, -300, 250), look_at=piece.center())
        for edge in visible:
            points = [edge.position_at(share) for share in np.linspace(0, 1, 24)]
            place.plot([p.X for p in points], [p.Y for p in points], color="0.15", linewidth=0.8)
        lengths = " x ".join(f"{length:g}" for length in size(piece)["size_mm"])
        place.set_title(f"{name}, {lengths} mm", fontsize=8)
        place.set_aspect("equal")
        place.axis("off")
    figure.tight_layout()
    plt.rcParams["svg.hashsalt"] = "printed"
    figure.savefig(FOLDER / "pieces.svg", bbox_inches="tight", metadata={"Date": None})


def main() -> None:
    """Model, write or compare."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="compare, write nothing")
    check = parser.parse_args().check
    pieces = {name: make() for name, make in PIECES.items()}
    for name, piece in pieces.items():
        if len(piece.solids()) != 1 or not piece.is_valid:
            sys.exit(f"{name}: not one sound solid")
    sizes = {name: size(piece) for name, piece in pieces.items()}
    if check:
        if json.loads(SIZES.read_text()) != sizes:
            sys.exit("pieces have changed; run tools/printed_parts.py and commit what it writes")
        return
    FOLDER.mkdir(exist_ok=True)
    for name, piece in pieces.items():
        export_step(piece, FOLDER / f"{name}.step")
        export_stl(piece, FOLDER / f"{name}.stl", tolerance=0.05, angular_tolerance=0.2)
    SIZES.write_text(json.dumps(sizes, indent=1) + "\n")
    draw(pieces)


if __name__ == "__main__":
    main()
