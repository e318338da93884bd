"""Whole explorations on the emulator: random pegs found or missed, empty rooms silent or not.

Each peg is drawn where the noise-free plant says that some sweep must feel it (`emulator.reach`),
and a robot with the default scene's noise and calibration errors then explores that room. Empty
rooms are explored at several multiples of that noise; whatever is reported there is a false alarm.
Last, the body bends more or less than the map says, as with a regulator that is set wrong: then the
run has to doubt its contacts.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from thigmo.config import SIDES
from thigmo.emulator.reach import random_peg
from thigmo.emulator.scene import PegTable, Scene
from thigmo.errors import ThigmoError
from thigmo.exploration import explore
from thigmo.exploration.map import best_contact
from thigmo.record import MapContact, RunDocument, TrueContact
from thigmo.studies.engine import Cell, Claim, Context, Outcome, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NOISE_LEVELS = (1.0, 2.0, 4.0)  # multiples of the default scene's noise and calibration errors
BENDS = (0.7, 0.8, 0.9, 1.1, 1.2, 1.3)  # the body's bend over the map's
_SURELY = 0.2  # so much more or less has to be noticed
_FOUND = ("localized", "ambiguous")
_PROMISED_CM = 3.0
_LENGTH_CM = 0.1  # the everted length, where an interval ends, is known no better


@dataclass(frozen=True)
class Room:
    """A room to explore: at most one peg, and the stage and side that must first feel it.

    Attributes:
        bend: how much the body bends, over what the host's maps say.
    """

    seed: int
    noise: float = 1.0
    peg: tuple[float, float, float] | None = None
    stage_cm: float = nan
    side: str = ""
    peak: float = nan
    bend: float = 1.0


@dataclass(frozen=True)
class Explored:
    """What an exploration of a room came to.

    Attributes:
        found_cm: first stage at which a trigger was taken for a contact; NaN if none was.
        contacts: on the map.
        strays: contacts of stages in whose measurement the room knows no contact at all.
        error_x_cm, error_cm, error_arc_cm: of the best contact; NaN without one.
        width_cm: of its interval.
        covered: whether its interval holds the true arc.
        status: of the best contact, "silent", or why the run was aborted.
        robot_time_s: of the run.
        doubted: whether the run doubts its contacts.
    """

    room: Room
    found_cm: float = nan
    contacts: int = 0
    strays: int = 0
    error_x_cm: float = nan
    error_cm: float = nan
    error_arc_cm: float = nan
    width_cm: float = nan
    covered: bool = False
    status: str = "silent"
    robot_time_s: float = 0.0
    doubted: bool = False


def random_room(seed: int) -> Room:
    """A room with one peg within reach, other seeds giving other pegs."""
    peg, felt = random_peg(Scene.load("default").robot, np.random.default_rng([seed, 0x9E6]))
    return Room(seed, 1.0, (peg.x, peg.y, peg.radius), felt.length_cm, felt.side, felt.peak)


def visit(room: Room) -> Explored:
    """Explore a room."""
    scene = Scene.load("default")
    scene.pegs = []
    if room.peg is not None:
        x, y, radius = room.peg
        scene.pegs = [PegTable(x=x, y=y, radius=radius)]
    for part in (scene.noise, scene.belief):
        for name, value in part.model_dump().items():
            if name != "hysteresis_width":
                setattr(part, name, value * room.noise)
    known = scene.believed(room.seed)
    for side in SIDES:
        for zone in scene.robot.actuators.side(side).maps:
            zone.inflate.amplitude *= room.bend
            zone.deflate.amplitude *= room.bend
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "room.toml"
        scene.save(file)
        try:
            result = explore(f"emulator://{file}", config=known, seed=room.seed, out=folder)
        except ThigmoError as error:
            return Explored(room, status=f"aborted: {error.what}")
    return _judged(room, result.document)


def _judged(room: Room, document: RunDocument) -> Explored:
    truth = document.truth.contacts if document.truth else []
    felt = [
        stage.everted_length_cm
        for stage in document.stages
        if any(trigger.status in _FOUND for trigger in stage.triggers)
    ]
    best = best_contact(document.contacts)
    near = [] if best is None else _at_stage(best, truth)
    arc = (
        min((t.arc_cm for t in near), key=lambda a: abs(a - best.arc_cm), default=nan)
        if best
        else nan
    )
    low, high = best.interval_cm if best else (nan, nan)
    return Explored(
        room,
        found_cm=felt[0] if felt else nan,
        contacts=len(document.contacts),
        strays=sum(not _at_stage(contact, truth) for contact in document.contacts),
        error_x_cm=nan if document.error_x_cm is None else document.error_x_cm,
        error_cm=nan if document.error_cm is None else document.error_cm,
        error_arc_cm=abs(arc - best.arc_cm) if best else nan,
        width_cm=high - low,
        covered=low - _LENGTH_CM <= arc <= high + _LENGTH_CM,
        status=best.status if best else "silent",
        robot_time_s=document.robot_time_s,
        doubted=bool(document.doubt),
    )


def _at_stage(contact: MapContact, truth: list[TrueContact]) -> list[TrueContact]:
    return [t for t in truth if abs(t.everted_length_cm - contact.everted_length_cm) < 0.5]


def run(context: Context) -> Outcome:
    """Pegs and empty rooms, the numbers of both, and what is promised of them."""
    seeds = context.rng(0x0E).integers(0, 2**31, context.count(3, 30)).tolist()
    with_peg = [random_room(seed) for seed in seeds]
    empty = [
        Room(seed, noise) for noise in NOISE_LEVELS for seed in range(1, 1 + context.count(1, 20))
    ]
    otherwise = [
        replace(random_room(seed) if peg else Room(seed), bend=bend)
        for bend in (BENDS if context.scale == "full" else (0.8, 1.2))
        for seed in seeds[: context.count(1, 5)]
        for peg in (True, False)
    ]
    pegs = context.map(visit, with_peg, "rooms with a peg")
    rooms = context.map(visit, empty, "empty rooms")
    bent = context.map(visit, otherwise, "other bends than the map's")
    return Outcome(
        tables=[_peg_table(pegs), _room_table(rooms), _summary(pegs), _bend_table(bent)],
        figures={"pegs": _figure(pegs, rooms)},
        claims=[*_claims(pegs, rooms), *_doubts(pegs, rooms, bent)],
    )


def _at_predicted(e: Explored) -> bool:
    return abs(e.found_cm - e.room.stage_cm) < 0.5


def _missed(e: Explored) -> bool:
    return np.isnan(e.found_cm) or e.found_cm > e.room.stage_cm + 0.5


def _peg_table(pegs: list[Explored]) -> Table:
    columns = (
        "seed", "x_cm", "y_cm", "radius_cm", "predicted_stage_cm", "predicted_side",
        "predicted_peak_per_cm", "found_stage_cm", "at_predicted_stage", "contacts", "strays",
        "status", "error_x_cm", "error_cm", "error_arc_cm", "interval_cm", "interval_covers",
        "robot_time_s",
    )  # fmt: skip
    rows: list[tuple[Cell, ...]] = []
    for e in pegs:
        assert e.room.peg is not None
        rows.append((
            e.room.seed, *e.room.peg, e.room.stage_cm, e.room.side, round(e.room.peak, 5),
            e.found_cm, _at_predicted(e), e.contacts, e.strays, e.status, round(e.error_x_cm, 3),
            round(e.error_cm, 3), round(e.error_arc_cm, 3), round(e.width_cm, 2), e.covered,
            round(e.robot_time_s, 1),
        ))  # fmt: skip
    return Table("pegs", columns, rows)


def _room_table(rooms: list[Explored]) -> Table:
    lines: list[tuple[Cell, ...]] = []
    for noise in NOISE_LEVELS:
        those = [e for e in rooms if e.room.noise == noise]
        aborted = sum(e.status.startswith("aborted") for e in those)
        lines.append(
            (
                noise,
                len(those),
                sum(e.contacts > 0 for e in those),
                sum(e.contacts for e in those),
                aborted,
            )
        )
    return Table(
        "empty-rooms",
        ("noise_level", "rooms", "rooms_with_false_alarm", "false_contacts", "aborted"),
        lines,
    )


def _bend_table(bent: list[Explored]) -> Table:
    lines: list[tuple[Cell, ...]] = []
    for bend in sorted({e.room.bend for e in bent}):
        those = [e for e in bent if e.room.bend == bend]
        errors = [e.error_x_cm for e in those if not np.isnan(e.error_x_cm)]
        sure = [e for e in those if e.contacts and not e.doubted]
        lines.append(
            (
                bend,
                len(those),
                sum(e.doubted for e in those),
                len(sure),
                round(float(np.median(errors)), 3) if errors else nan,
            )
        )
    return Table(
        "bends",
        ("bend_over_map", "rooms", "doubted", "contacts_not_doubted", "median_error_x_cm"),
        lines,
    )


def _summary(pegs: list[Explored]) -> Table:
    rows: list[tuple[Cell, ...]] = [
        ("pegs", len(pegs)),
        ("found at the predicted stage", sum(map(_at_predicted, pegs))),
        ("found at an earlier stage", sum(e.found_cm < e.room.stage_cm - 0.5 for e in pegs)),
        ("found at a later stage", sum(e.found_cm > e.room.stage_cm + 0.5 for e in pegs)),
        ("missed", sum(bool(np.isnan(e.found_cm)) for e in pegs)),
        ("with more than one contact on the map", sum(e.contacts > 1 for e in pegs)),
        ("stray contacts", sum(e.strays for e in pegs)),
        ("interval covers the truth", sum(e.covered for e in pegs)),
        ("localized", sum(e.status == "localized" for e in pegs)),
        ("ambiguous", sum(e.status == "ambiguous" for e in pegs)),
        ("aborted", sum(e.status.startswith("aborted") for e in pegs)),
    ]
    for name, values in _errors(pegs).items():
        at = np.percentile(values, (50, 75, 90))
        rows += [
            (f"{name}, {share} % quantile", round(float(value), 3))
            for share, value in zip((50, 75, 90), at, strict=True)
        ]
    return Table("summary", ("what", "value"), rows)


def _errors(pegs: list[Explored]) -> dict[str, list[float]]:
    """Errors of those that have one, cm."""
    named = {
        "|x error| (cm)": [e.error_x_cm for e in pegs],
        "error in the plane (cm)": [e.error_cm for e in pegs],
        "error along the body (cm)": [e.error_arc_cm for e in pegs],
    }
    return {name: [v for v in values if not np.isnan(v)] or [nan] for name, values in named.items()}


def _claims(pegs: list[Explored], rooms: list[Explored]) -> list[Claim]:
    quiet = [e for e in rooms if e.room.noise == 1.0]
    return [
        Claim("pegs not found at the stage of the noise-free plant", sum(map(_missed, pegs)), 0),
        Claim("pegs reported where nothing touches", sum(e.strays for e in pegs), 0),
        Claim("empty rooms with a contact, default noise", sum(e.contacts > 0 for e in quiet), 0),
        Claim(
            "median |x error| over random pegs",
            float(np.median(_errors(pegs)["|x error| (cm)"])),
            _PROMISED_CM,
            unit="cm",
        ),
    ]


def _doubts(pegs: list[Explored], rooms: list[Explored], bent: list[Explored]) -> list[Claim]:
    healthy = [*pegs, *(e for e in rooms if e.room.noise == 1.0)]
    far = [e for e in bent if abs(e.room.bend - 1.0) > _SURELY - 1e-9]
    missed = sum(not e.doubted for e in far)
    return [
        Claim("rooms doubted though the map holds", sum(e.doubted for e in healthy), 0),
        Claim("rooms not doubted, the body bending 20 % or more off the map", missed, 0),
    ]


def _figure(pegs: list[Explored], rooms: list[Explored]) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 4.2), layout="constrained")
    axes = figure.subplots(1, 3)
    _draw_map(axes[0], pegs)
    _draw_errors(axes[1], pegs)
    _draw_alarms(axes[2], rooms)
    return figure


def _draw_map(axis: Axes, pegs: list[Explored]) -> None:
    kinds = (
        ("found at the predicted stage", "o", "tab:green", _at_predicted),
        ("found earlier", "^", "tab:blue", lambda e: not _at_predicted(e) and not _missed(e)),
        ("found later, or missed", "X", "tab:red", _missed),
    )
    for label, marker, colour, is_it in kinds:
        those = [e.room.peg for e in pegs if is_it(e) and e.room.peg]
        x, y = [p[0] for p in those], [p[1] for p in those]
        axis.scatter(x, y, marker=marker, color=colour, label=f"{label} ({len(those)})")
    axis.axhspan(-1.75, 1.75, color="0.85", label="straight robot")
    axis.set(xlabel="x along the straight robot (cm)", ylabel="y (cm)", title="Random pegs")
    axis.set_aspect("equal", adjustable="datalim")
    axis.legend(fontsize=7, loc="upper left")


def _draw_errors(axis: Axes, pegs: list[Explored]) -> None:
    for name, values in _errors(pegs).items():
        ordered = np.sort(values)
        axis.step(ordered, np.arange(1, len(ordered) + 1) / len(ordered), where="post", label=name)
    axis.axvline(_PROMISED_CM, color="0.5", ls=":", label=f"promised: {_PROMISED_CM:g} cm")
    axis.set(xlabel="error (cm)", ylabel="share of found pegs", title="Errors", ylim=(0, 1.02))
    axis.legend(fontsize=7, loc="lower right")


def _draw_alarms(axis: Axes, rooms: list[Explored]) -> None:
    groups = [[e for e in rooms if e.room.noise == noise] for noise in NOISE_LEVELS]
    place = np.arange(len(groups))
    alarms = [sum(e.contacts > 0 for e in group) for group in groups]
    aborted = [sum(e.status.startswith("aborted") for e in group) for group in groups]
    axis.bar(place, alarms, color="tab:red", label="with a false contact")
    axis.bar(place, aborted, bottom=alarms, color="0.6", label="run ended early")
    axis.set_xticks(place, [f"{noise:g} x" for noise in NOISE_LEVELS])
    axis.set(
        xlabel="noise and calibration errors (times the default)",
        ylabel=f"rooms, of {len(groups[0])}",
        title="Empty rooms",
        ylim=(0, max(len(groups[0]), 1)),
    )
    axis.legend(fontsize=7)
