"""Whole explorations on the emulator, of robots that are and are not what their calibration says.

Each peg is drawn where the noise-free plant says that some sweep must feel it (`emulator.reach`),
and a robot explores that room: the default scene's, or one whose body or sensors are off what
robot.toml says without a word of it. Empty rooms are explored as well; whatever is reported there
is a false contact. The map for planners of every room with pegs is held against the room (`maps`).
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from thigmo.config import SIDES
from thigmo.emulator.reach import random_peg
from thigmo.emulator.scene import PegTable, Scene
from thigmo.errors import ThigmoError
from thigmo.exploration.map import best_contact
from thigmo.record import RunDocument
from thigmo.report.axes import GREEN, ORANGE, RED
from thigmo.studies import charts, maps
from thigmo.studies.engine import Claim, Context, Outcome, Record, share
from thigmo.studies.rooms import explored

ROUND = 3  # rooms of each kind, after which all that is known is written
_LENGTH_CM = 0.1  # the everted length, where an interval ends, is known no better


@dataclass(frozen=True)
class Kind:
    """A kind of robot and room."""

    scene: str = "default"  # built-in scene of the robot
    bend: float = 1.0  # how much the body bends, over what the host's maps say
    # relative standard deviation of the sensors' gains, of which robot.toml knows nothing
    gains: float = 0.0
    noise: float = 1.0  # multiple of the scene's noise and calibration errors
    peg: bool = True  # whether a peg stands in the room
    more: bool = False  # whether up to two more do, for the map


TRUE, MORE = CALIBRATED = ("as calibrated", "one to three pegs")  # of the default scene's robot
KINDS: dict[str, Kind] = {
    TRUE: Kind(),
    MORE: Kind(more=True),
    "bends 10 % less": Kind(bend=0.9),
    "bends 5 % less": Kind(bend=0.95),
    "bends 5 % more": Kind(bend=1.05),
    "bends 10 % more": Kind(bend=1.1),
    "gains 5 % off": Kind(gains=0.05),
    "gains 10 % off": Kind(gains=0.1),
    "scene noisy": Kind(scene="noisy"),
    "empty": Kind(peg=False),
    "empty, scene noisy": Kind(scene="noisy", peg=False),
    "empty, 4 times the noise": Kind(noise=4.0, peg=False),
}


@dataclass
class Explored:
    """What an exploration of a room came to."""

    # kind, seed: of the room
    kind: str
    seed: int
    # x_cm, y_cm, radius_cm: of its peg; NaN without one
    x_cm: float = nan
    y_cm: float = nan
    radius_cm: float = nan
    status: str = "silent"  # of the best contact, "silent", or why the run was aborted
    missed: bool = True  # nothing on the map is at a peg
    false: int = 0  # contacts on the map that are not in the room
    # the best contact is localized, and its interval does not hold the true arc
    wrong: bool = False
    error_x_cm: float = nan  # of the best contact; NaN without one

    def judge(self, document: RunDocument) -> None:
        """Hold the run's best contact against the room."""
        best = best_contact(document.contacts)
        if best is None:
            return
        near = [
            contact.arc_cm
            for contact in (document.truth.contacts if document.truth else ())
            if abs(contact.everted_length_cm - best.everted_length_cm) < 0.5
        ]
        low, high = best.interval_cm
        held = any(low - _LENGTH_CM <= arc <= high + _LENGTH_CM for arc in near)
        self.status = best.status
        self.false = len(document.false or [])
        self.missed = len(document.contacts) == self.false
        self.wrong = best.status == "localized" and not held
        self.error_x_cm = nan if document.error_x_cm is None else document.error_x_cm


def visit(room: tuple[str, int]) -> tuple[Explored, list[maps.Mapped]]:
    """Explore a room of a kind and seed, and judge its map at every level."""
    name, seed = room
    kind, found = KINDS[name], Explored(name, seed)
    scene = Scene.load(kind.scene)
    for part in (scene.noise, scene.belief):
        for what, value in part.model_dump().items():
            if what != "hysteresis_width":
                setattr(part, what, value * kind.noise)
    known = scene.believed(seed)
    rng = np.random.default_rng([seed, 0x9E6])
    for side in SIDES:
        for zone in scene.robot.actuators.side(side).maps:
            zone.inflate.amplitude *= kind.bend
            zone.deflate.amplitude *= kind.bend
        for sensor in scene.robot.sensors.column(side):
            sensor.scale_per_ohm /= 1.0 + kind.gains * rng.standard_normal()
    scene.pegs = maps.room(seed).pegs if kind.more else []
    if kind.peg and not kind.more:
        peg, _ = random_peg(scene.robot, rng, radius=maps.RADII_CM)
        found.x_cm, found.y_cm, found.radius_cm = peg.x, peg.y, peg.radius
        scene.pegs = [PegTable(x=peg.x, y=peg.y, radius=peg.radius)]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "room.toml"
        scene.save(file)
        try:
            document = explored(f"emulator://{file}", folder, seed, config=known).document
        except ThigmoError as error:
            found.status = f"aborted: {error.what}"
            return found, []
    found.judge(document)
    return found, [maps.judge(document, sigmas) for sigmas in maps.LEVELS if kind.peg]


def run(context: Context) -> Outcome:
    """Rooms of every kind, and what is promised of them."""
    seeds = context.rng(0x0E).integers(0, 2**31, context.count(1, 30)).tolist()
    runs: list[tuple[Explored, list[maps.Mapped]]] = []
    outcome = Outcome()
    for start in range(0, len(seeds), ROUND):
        some = seeds[start : start + ROUND]
        part = f"rooms {start + 1} to {start + len(some)} of {len(seeds)} of each kind"
        runs += context.map(visit, [(kind, seed) for seed in some for kind in KINDS], part)
        outcome = _outcome(runs)
        context.save(outcome)
    return outcome


def _outcome(runs: list[tuple[Explored, list[maps.Mapped]]]) -> Outcome:
    found = [one for one, _ in runs]
    levels, others = (
        maps.summary([m for one, of in runs if (one.kind in CALIBRATED) is known for m in of])
        for known in (True, False)
    )
    rows = _by_kind(found)
    return Outcome(
        {"runs": [vars(one) for one in found], "rows": rows, "levels": levels},
        {"explorations": _figure(found), "map": maps.figure(levels)},
        [*_claims(found), maps.claim(levels)],
        [
            *maps.notes("maps of robots as calibrated", levels)[1:],  # the first is promised
            *maps.notes("maps of other robots", others),
        ],
        rows,
    )


def _median_x(found: list[Explored]) -> float:
    errors = np.array([one.error_x_cm for one in found])
    return float(np.nanmedian(errors)) if np.isfinite(errors).any() else nan


def _by_kind(found: list[Explored]) -> list[Record]:
    by_kind = {kind: [one for one in found if one.kind == kind] for kind in KINDS}
    return [
        {
            "kind": kind, "rooms": len(mine),
            "missed": sum(one.missed for one in mine) if KINDS[kind].peg else 0,
            "with_false_contacts": sum(one.false > 0 for one in mine),
            "localized": sum(one.status == "localized" for one in mine),
            "localized_and_wrong": sum(one.wrong for one in mine),
            "aborted": sum(one.status.startswith("aborted") for one in mine),
            "median_error_x_cm": _median_x(mine),
        }
        for kind, mine in by_kind.items()
    ]  # fmt: skip


def _claims(found: list[Explored]) -> list[Claim]:
    true = [one for one in found if one.kind == TRUE]
    off = [one for one in found if one.kind != TRUE and not KINDS[one.kind].more]
    claims = [Claim("as calibrated: median |x error|", _median_x(true), 3.0, unit="cm")]
    for text, some, (wrong, missed, false) in (
        ("as calibrated", true, (0.0, 0.035, 0.0)),
        ("not as calibrated, or empty", off, (0.06, 0.1, 0.03)),
    ):
        pegs = [one for one in some if KINDS[one.kind].peg]
        localized = share([one.wrong for one in pegs])
        phantoms = share([one.false > 0 for one in some])
        claims += [
            Claim(f"{text}: localized and wrong, of rooms with a peg", localized, wrong),
            Claim(f"{text}: pegs missed", share([one.missed for one in pegs]), missed),
            Claim(f"{text}: runs with false contacts", phantoms, false),
        ]
    return claims


def _figure(found: list[Explored]) -> Figure:
    """Where pegs were found, and what went wrong by kind."""
    figure, (left, right) = charts.panels(1, 2, size=(6.5, 5.5))
    pegs = [one for one in found if KINDS[one.kind].peg and not KINDS[one.kind].more]
    for label, marker, color, those in (
        ("found", "o", GREEN, [e for e in pegs if not e.missed and not e.wrong]),
        ("localized, and wrong", "^", ORANGE, [e for e in pegs if e.wrong]),
        ("missed", "X", RED, [e for e in pegs if e.missed]),
    ):
        x, y = [e.x_cm for e in those], [e.y_cm for e in those]
        left.scatter(x, y, 14, marker=marker, color=color, label=f"{label} ({len(those)})")
    left.fill_between([0.0, 53.0], -1.75, 1.75, color="0.85", label="straight robot")
    left.set(xlabel="x along the straight robot (cm)", ylabel="y (cm)", aspect="equal")
    rows, at = _by_kind(found), np.arange(len(KINDS))
    for shift, (label, color, what) in enumerate((
        ("missed", RED, "missed"),
        ("localized, and wrong", ORANGE, "localized_and_wrong"),
        ("with false contacts", "0.5", "with_false_contacts"),
    )):  # fmt: skip
        shares = [100 * float(row[what]) / max(float(row["rooms"]), 1.0) for row in rows]
        right.barh(at + 0.25 * (shift - 1), shares, 0.25, color=color, label=label)
    right.set_yticks(at, list(KINDS), fontsize=8)
    right.invert_yaxis()
    right.set(xlabel=f"share of {len(found) // len(KINDS)} rooms each (%)", xlim=(0, None))
    legend: dict[str, Any] = {"fontsize": 7, "ncols": 2, "frameon": False}
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower left", **legend)
    figure.legend(*right.get_legend_handles_labels(), loc="outside lower right", **legend)
    return figure
