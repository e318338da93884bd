"""The map for planners against the room: cells inside pegs that it calls free, and what that costs.

A run's map is drawn at several levels of certainty: how many of the cells inside pegs are free,
apart for pegs that were felt and those that were missed, and how much space is free at all. Used by
the study of explorations.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from thigmo.emulator.reach import random_peg
from thigmo.emulator.scene import PegTable, Scene
from thigmo.exploration.missed import felt_pegs
from thigmo.exploration.obstacles import SIGMAS, occupancy
from thigmo.record import RunDocument
from thigmo.record.occupancy import FREE
from thigmo.report.axes import GREEN, RED
from thigmo.studies import charts
from thigmo.studies.engine import Claim, Record
from thigmo.studies.scenes import RADIUS

LEVELS = (0.0, 1.0, 2.0, SIGMAS, 4.0)
RADII_CM = (0.25, 2.5)
_MOST_PEGS = 3
_BETWEEN_CM = 0.5  # pegs stand at least so far apart


class Mapped(NamedTuple):
    """A room's map at one level."""

    sigmas: float  # standard errors that free cells keep from what is not
    # felt_cells, felt_free: cells inside pegs that were felt, and those of them that are free
    felt_cells: int
    felt_free: int
    # missed_cells, missed_free: the same of pegs that a sweep touched unnoticed, or did not
    missed_cells: int
    missed_free: int
    free_cm2: float  # of the whole map


def room(seed: int) -> Scene:
    """A random room of one to three pegs, each of which alone would be felt."""
    scene = Scene.load("default")
    rng = np.random.default_rng([seed, 0x3A9])
    scene.pegs = []
    for _ in range(rng.integers(1, _MOST_PEGS + 1)):
        peg, _ = random_peg(scene.robot, rng, radius=RADII_CM)
        gaps = (hypot(peg.x - o.x, peg.y - o.y) - peg.radius - o.radius for o in scene.pegs)
        if all(gap > _BETWEEN_CM for gap in gaps):
            scene.pegs.append(PegTable(x=peg.x, y=peg.y, radius=peg.radius))
    return scene


def judge(document: RunDocument, sigmas: float = SIGMAS) -> Mapped:
    """Compare a run's map with the room that the emulator knows."""
    grid, _ = occupancy(document, RADIUS, sigmas=sigmas)
    free = grid.cells == FREE
    x, y = grid.centers()
    felt = felt_pegs(document)
    counts = np.zeros((2, 2), dtype=np.int64)
    for index, peg in enumerate(document.truth.pegs if document.truth else ()):
        inside = np.hypot(x - peg.x_cm, y - peg.y_cm) < peg.radius_cm
        counts[int(index not in felt)] += inside.sum(), (inside & free).sum()
    area_cm2 = float(free.sum()) * grid.resolution_cm**2
    return Mapped._make((sigmas, *counts.ravel().tolist(), area_cm2))


def summary(found: Sequence[Mapped]) -> list[Record]:
    """All rooms together, a line a level."""
    seen = sum(one.free_cm2 for one in found if one.sigmas == 0.0)
    rows: list[Record] = []
    for sigmas in LEVELS:
        mine = [one for one in found if one.sigmas == sigmas]
        total = Mapped._make(sum(one[n] for one in mine) for n in range(len(Mapped._fields)))
        rows.append({
            "sigmas": sigmas,
            "rooms": len(mine),
            "felt_cells": total.felt_cells,
            "felt_free_%": 100 * total.felt_free / max(total.felt_cells, 1),
            "rooms_with_one": sum(one.felt_free > 0 for one in mine),
            "missed_cells": total.missed_cells,
            "missed_free_%": 100 * total.missed_free / max(total.missed_cells, 1),
            "kept_%": 100 * total.free_cm2 / max(seen, 1e-9),
        })  # fmt: skip
    return rows


def _written(levels: list[Record]) -> Record:
    """The line of the maps that runs write."""
    return levels[LEVELS.index(SIGMAS)]


def claim(levels: list[Record]) -> Claim:
    """What is promised of the maps that a run of a calibrated robot writes."""
    text, _ = notes("maps of robots as calibrated", levels)[0].rsplit(":", 1)
    return Claim(text, float(_written(levels)["felt_free_%"]), 0.1, unit="%")


def notes(whose: str, levels: list[Record]) -> list[str]:
    """What maps cost: the first is promised of robots as calibrated."""
    row = _written(levels)
    return [
        f"{whose}, {row['rooms']} rooms: of {row['felt_cells']} cells inside pegs that were "
        f"felt, free: {row['felt_free_%']:.2g} %",
        f"{whose}: of {row['missed_cells']} cells inside pegs that were missed, free: "
        f"{row['missed_free_%']:.2g} %",
        f"{whose}: free space kept of what the sweeps seem to cover: {row['kept_%']:.0f} %",
    ]


def figure(levels: list[Record]) -> Figure:
    """What a level saves and what it costs."""
    drawn, (left, right) = charts.panels(1, 2, size=(5.0, 3.6), title="The map for planners")
    sigmas = [float(row["sigmas"]) for row in levels]
    for label, color, what in (
        ("pegs that were felt", GREEN, "felt_free_%"),
        ("pegs that were missed", RED, "missed_free_%"),
    ):
        left.plot(sigmas, [float(row[what]) for row in levels], "o-", color=color, label=label)
    left.axhline(0.1, color="0.6", linestyle=":", label="promised")
    left.set_yscale("symlog", linthresh=0.1)
    left.set(ylabel="of the cells inside, free (%)", ylim=(0, 100))
    left.set_yticks([0.0, 0.1, 1.0, 10.0, 100.0], ["0", "0.1", "1", "10", "100"])
    right.plot(sigmas, [float(row["kept_%"]) for row in levels], "o-")
    right.set(ylabel="free space kept (%)", ylim=(0, 105))
    for axis in (left, right):
        axis.axvline(SIGMAS, color="0.85", linewidth=5, zorder=0)
        axis.set(xlabel="standard errors kept from the edge")
    charts.legend_below(drawn)
    return drawn
