"""The map for planners against the room: cells inside pegs that it calls free, and what that costs.

A run's map is drawn at several levels of certainty: how many of the cells inside pegs are free,
apart for pegs that were felt and those that were missed, and how much space is free at all. Used by
the study of explorations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot

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


@dataclass(frozen=True)
class Mapped:
    """A room's map at one level."""

    seed: int  # of the room
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


def judge(document: RunDocument, seed: int, sigmas: float = SIGMAS) -> Mapped:
    """Compare a run's map with the room that the emulator knows."""
    grid, _ = occupancy(document, RADIUS, sigmas=sigmas)
    free = grid.cells == FREE
    x, y = grid.centers()
    felt = felt_pegs(document)
    counts = np.zeros((2, 2), dtype=np.int64)
    for index, peg in enumerate(document.truth.pegs if document.truth else ()):
        inside = np.hypot(x - peg.x_cm, y - peg.y_cm) < peg.radius_cm
        counts[int(index not in felt)] += inside.sum(), (inside & free).sum()
    area = float(free.sum()) * grid.resolution_cm**2
    (felt_all, felt_free), (missed_all, missed_free) = counts.tolist()
    return Mapped(seed, sigmas, felt_all, felt_free, missed_all, missed_free, area)


def summary(found: Sequence[Mapped]) -> list[Record]:
    """All rooms together, a line a level."""
    seen = sum(one.free_cm2 for one in found if one.sigmas == 0.0)
    rows: list[Record] = []
    for sigmas in LEVELS:
        mine = [one for one in found if one.sigmas == sigmas]
        felt, missed = sum(one.felt_cells for one in mine), sum(one.missed_cells for one in mine)
        rows.append({
            "sigmas": sigmas,
            "rooms": len(mine),
            "felt_cells": felt,
            "felt_free_%": 100 * sum(one.felt_free for one in mine) / max(felt, 1),
            "rooms_with_one": sum(one.felt_free > 0 for one in mine),
            "missed_cells": missed,
            "missed_free_%": 100 * sum(one.missed_free for one in mine) / max(missed, 1),
            "kept_%": 100 * sum(one.free_cm2 for one in mine) / max(seen, 1e-9),
        })  # fmt: skip
    return rows


def _written(levels: list[Record]) -> Record:
    """The line of the maps that runs write."""
    return levels[LEVELS.index(SIGMAS)]


def claim(levels: list[Record]) -> Claim:
    """What is promised of the maps that a run of a calibrated robot writes."""
    row = _written(levels)
    text = (
        f"maps of robots as calibrated, {row['rooms']} rooms: of {row['felt_cells']} cells inside "
        "pegs that were felt, free"
    )
    return Claim(text, float(row["felt_free_%"]), 0.1, unit="%")


def notes(whose: str, levels: list[Record]) -> list[str]:
    """What maps cost, and what is not promised."""
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
