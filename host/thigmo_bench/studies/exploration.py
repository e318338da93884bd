"""Whole explorations on the emulator, of robots that agree or disagree with their calibration.

Each peg is drawn where some sweep of the noise-free plant must feel it (`emulator.reach`). The
robot that explores the room is the default scene's, or one with a body or sensors that differ from
its robot.toml. Empty rooms are explored as well, where every contact reported is
false, and so are rooms of walls, corners and gaps, of dowels apart or side by side, and growths
that tail friction stops without an obstacle, two pegs that a side touches at once, pegs that give
way, and pegs that stand while the body slips past. Contacts are compared with the surfaces that
were touched, never with what was out of reach. The planners' map of every room with pegs is
compared with the room: it counts cells inside pegs that are called free, separately for pegs that
were felt and missed. Last, rooms of three kinds are explored with every effort, with budgets of
robot time and by the thesis's protocol, to show what robot time gains.

A study of other code or another method explores the same rooms with the same seeds: given the
earlier one's table of runs, it says by how much each kind has become better, room by room.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, permutations
from math import hypot, nan, sqrt
from time import process_time
from typing import Any, Literal, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from thigmo.config import RobotConfig
from thigmo.display.axes import BLUE, GREEN, ORANGE, RED
from thigmo.emulator.reach import random_peg
from thigmo.emulator.scene import PegTable, Scene
from thigmo.errors import DataError, ThigmoError
from thigmo.exploration.effort import EFFORTS, THESIS, Effort, within
from thigmo.exploration.map import best_contact, true_touches
from thigmo.exploration.methods import FIELD, check_exploration_method
from thigmo.exploration.obstacles import occupancy
from thigmo.exploration.scoring import felt_pegs, from_line
from thigmo.record import MapContact, RunDocument, TrueContact, TruePeg, Truth
from thigmo.record.occupancy import FREE, OCCUPIED
from thigmo.wiring import Wiring
from thigmo_bench.studies import charts
from thigmo_bench.studies.engine import Claim, Context, Explorations, Outcome, Record, share
from thigmo_bench.studies.random_rooms import (
    RADII_CM,
    random_pair,
    random_pegs,
    random_slipped,
    random_wall,
)
from thigmo_bench.studies.rooms import explored_scene
from thigmo_bench.studies.scenes import RADIUS

ROUNDS = 10  # parts of all rooms; the results so far are written after each
LENGTH_CM = 0.1  # error of the everted length, at which intervals end


@dataclass(frozen=True)
class Kind:
    """A kind of robot and room."""

    rooms: int  # number of rooms for the published figures
    scene: str = "default"  # built-in scene of the robot
    bend: float = 1.0  # bend of the body over that of the host's maps
    # relative standard deviation of the sensors' gains, which robot.toml does not state
    gains: float = 0.0
    noise: float = 1.0  # multiple of the scene's noise and calibration errors
    # what stands in the room; two pegs are those that the longest sweep of a side touches at once,
    # and a peg is slipped past in a full sweep at some length
    stands: Literal["a peg", "pegs", "a wall", "two pegs", "a peg slipped past", ""] = "a peg"
    # whether the peg gives way for good, to a share of the force on it that would fold the base
    gives_way: bool = False
    # tail friction (psi/cm) at which growth stalls somewhere; None: the scene's
    friction: tuple[float, float] | None = None
    rubs: float = 0.0  # largest friction coefficient between body and obstacles
    base_rad: float = 0.0  # most by which the base turns at the moment that folds it
    yields_cm: float = 0.0  # most by which a peg yields to a force that folds the base
    round_tip: bool = False
    # Whether what the emulator has one value of is drawn for each robot: gain against the valid
    # direction, hysteresis, and how fast muscles inflate.
    drawn: bool = False


TRUE, MORE = CALIBRATED = ("as calibrated", "one to three pegs")  # of the default scene's robot
WALLS, STALLS = "walls, corners, gaps", "stalls, empty"
PAIR, GIVES_WAY, SLIPS = "two pegs on a side", "pegs that give way", "pegs slipped past"
KINDS: dict[str, Kind] = {
    TRUE: Kind(60),
    "bends 10 % less": Kind(20, bend=0.9),
    "bends 5 % less": Kind(20, bend=0.95),
    "bends 5 % more": Kind(20, bend=1.05),
    "bends 10 % more": Kind(20, bend=1.1),
    "gains 5 % off": Kind(20, gains=0.05),
    "gains 10 % off": Kind(20, gains=0.1),
    MORE: Kind(80, stands="pegs"),
    WALLS: Kind(240, stands="a wall", rubs=0.6),
    STALLS: Kind(40, stands="", friction=(0.006, 0.012)),
    "scene noisy": Kind(20, scene="noisy"),
    "empty": Kind(20, stands=""),
    "empty, scene noisy": Kind(20, scene="noisy", stands=""),
    "empty, 4 times the noise": Kind(20, noise=4.0, stands=""),
    # Robots and rooms beside what a calibration states; their errors are drawn.
    "drawn errors": Kind(60, drawn=True),
    "friction to 0.6": Kind(60, rubs=0.6, drawn=True),
    "base turns to 0.05 rad": Kind(60, base_rad=0.05, drawn=True),
    "pegs yield to 1 cm": Kind(60, yields_cm=1.0, drawn=True),
    "round tip": Kind(60, round_tip=True, drawn=True),
    PAIR: Kind(40, stands="two pegs", rubs=0.6),
    GIVES_WAY: Kind(60, gives_way=True),
    SLIPS: Kind(20, stands="a peg slipped past", rubs=0.6),
}
_OTHERS = tuple(name for name, kind in KINDS.items() if kind.bend != 1.0 or kind.gains)
_NOISY = tuple(name for name in KINDS if "noisy" in name or "empty," in name or name == "empty")
# Rooms of each kind in which every effort is tried: what is promised of them is of one peg.
DIALLED = {TRUE: 40, MORE: 12, WALLS: 12}
BUDGETS_S = (60.0, 100.0, 150.0, 250.0, 400.0)
SETTINGS = ("thesis", *EFFORTS, *(f"{time_s:g} s" for time_s in BUDGETS_S))
_NEAR_CM = 1.5  # distance to a surface within which an occupied cell is right
_YIELDS_AT_CM = 45.0  # arc at which a force that folds the base acts on a yielding peg
_AGAINST, _LOOPS, _SLOWER = (0.3, 1.0), (0.5, 2.0), (0.8, 1.3)  # ranges of what is drawn
_IN_ELLIPSE = 5.99  # chi-squared of two numbers at 95 %
_OFF_CM = 4.0  # distance to all touched surfaces beyond which a contact is false or missed
_BOTH_CM = 2.0  # distance from the truth within which one of two contacts is placed
_WEAK = (0.3, 0.9)  # share of the force that folds the base, to which a peg gives way


@dataclass
class Explored:
    """The result of exploring a room."""

    # kind, seed: of the room
    kind: str
    seed: int
    setting: str = "default"  # an effort, a budget of robot time, or the thesis's protocol
    time_s: float = nan  # robot time
    # x_cm, y_cm, radius_cm: of its peg; NaN without one
    x_cm: float = nan
    y_cm: float = nan
    radius_cm: float = nan
    status: str = "silent"  # of the best contact, "silent", or why the run was aborted
    error_x_cm: float = nan  # of the best contact; NaN without one
    # All contacts, against surfaces. touched, touched_missed: true contacts, each as touched last,
    # and those of them that no contact is near
    touched: int = 0
    touched_missed: int = 0
    # far: contacts that are near no surface that was touched
    far: int = 0
    # near: the other contacts; error_cm: their mean distance in the plane from the true contact
    near: int = 0
    error_cm: float = nan
    # contacts_localized; sets_missed: those of them whose interval holds no true arc;
    # contacts_wrong: those of these that stand over a tube's radius from the truth
    contacts_localized: int = 0
    sets_missed: int = 0
    contacts_wrong: int = 0
    # ellipses, ellipses_missed: whether the best contact has a 95 % ellipse, and lacks the truth in
    ellipses: int = 0
    ellipses_missed: int = 0
    best_cm: float = nan  # distance of the best contact from the truth in the plane
    # pairs: whether a sweep's peak touched two pegs; pairs_placed: whether two contacts are those,
    # each near the truth and with it in its 95 % ellipse
    pairs: int = 0
    pairs_placed: int = 0
    # gave_way, gave_way_said: pegs that did, and those of them that a contact says it of;
    # standing_gone: contacts said to have given way that are near no such peg
    gave_way: int = 0
    gave_way_said: int = 0
    standing_gone: int = 0
    samples: float = nan  # effective samples of the fit behind it; NaN if it has none
    processor_s: float = nan  # time of the processor, the emulator's included
    cause: str = ""  # the likeliest of a stall: "obstacle", "wall" or "pressure"; empty without one

    def judge(self, document: RunDocument) -> None:
        """Compare the run's contacts with the room."""
        self.time_s = document.robot_time_s
        if (stalled := document.stall) is not None:
            self.cause = max(
                "obstacle", "wall", "pressure", key=lambda cause: getattr(stalled, cause)
            )
        truth = document.truth or Truth()
        if (best := best_contact(document.contacts)) is not None:
            self.status = best.status
            self.error_x_cm = nan if document.error_x_cm is None else document.error_x_cm
            self.best_cm = nan if document.error_cm is None else document.error_cm
            self.samples = nan if best.fit_samples is None else best.fit_samples
            nearby = true_touches(best, truth.contacts)
            if nearby and _has_ellipse(best):
                self.ellipses = 1
                self.ellipses_missed = int(not any(_in_ellipse(best, true) for true in nearby))
        self._judge_pair(document.contacts, truth)
        others = self._judge_what_gave_way(document.contacts, truth)
        last = {contact.peg: contact for contact in truth.contacts}
        self.touched = len(last)
        self.touched_missed = sum(
            not any(
                from_line([*c.surface, (c.x_cm, c.y_cm)], true.x_cm, true.y_cm) <= _OFF_CM
                for c in document.contacts
            )
            for true in last.values()
        )
        pegs = [truth.pegs[peg] for peg in last]
        errors: list[float] = []
        for contact in others:
            if min((_from_surface(contact, peg) for peg in pegs), default=np.inf) > _OFF_CM:
                self.far += 1
            else:
                errors.append(_distance(contact, truth.contacts))
            if contact.status == "localized":
                low, high = contact.interval_cm
                held = any(
                    low - LENGTH_CM <= true.arc_cm <= high + LENGTH_CM
                    for true in true_touches(contact, truth.contacts)
                )
                self.contacts_localized += 1
                self.sets_missed += not held
                self.contacts_wrong += not held and _distance(contact, truth.contacts) > RADIUS
        self.near, self.error_cm = len(errors), float(np.mean(errors)) if errors else nan

    def _judge_pair(self, contacts: Sequence[MapContact], truth: Truth) -> None:
        """Compare contacts with two pegs, if both were touched at a sweep's peak."""
        sweeps = {(true.everted_length_cm, true.side, true.peg) for true in truth.contacts}
        at_once = [
            {first, second}
            for (*sweep, first), (*other, second) in combinations(sorted(sweeps), 2)
            if sweep == other
        ]
        self.pairs = int(bool(at_once))
        self.pairs_placed = int(any(
            _is_placed(contact, truth.contacts, first)
            and _is_placed(further, truth.contacts, second)
            for contact, further in permutations(contacts, 2)
            for first, second in at_once
        ))  # fmt: skip

    def _judge_what_gave_way(
        self, contacts: Sequence[MapContact], truth: Truth
    ) -> list[MapContact]:
        """Compare what is said to have given way with the pegs that did; all other contacts."""
        gone = [peg for peg in truth.pegs if peg.gave_way]
        said: set[int] = set()
        others: list[MapContact] = []
        for contact in contacts:
            near = {n for n, peg in enumerate(gone) if _from_surface(contact, peg) <= _OFF_CM}
            if contact.gave_way_per_cm is not None and near:
                said |= near
            else:
                others.append(contact)
                self.standing_gone += contact.gave_way_per_cm is not None
        self.gave_way, self.gave_way_said = len(gone), len(said)
        return others


def _distance(contact: MapContact, true_contacts: Sequence[TrueContact]) -> float:
    """Distance in the plane to the nearest true contact that it may be, or to any; else inf."""
    nearby = true_touches(contact, true_contacts) or true_contacts
    away = [hypot(contact.x_cm - t.x_cm, contact.y_cm - t.y_cm) for t in nearby]
    return min(away, default=np.inf)


def _from_surface(contact: MapContact, peg: TruePeg) -> float:
    """Distance of a contact from a peg's surface, cm."""
    return abs(hypot(contact.x_cm - peg.x_cm, contact.y_cm - peg.y_cm) - peg.radius_cm)


def _has_ellipse(contact: MapContact) -> bool:
    return bool(np.linalg.det(np.array(contact.covariance_cm2)) > 0.0)


def _in_ellipse(contact: MapContact, true: TrueContact) -> bool:
    """Whether a contact's 95 % ellipse holds a true contact."""
    off = np.array([true.x_cm - contact.x_cm, true.y_cm - contact.y_cm])
    return float(off @ np.linalg.solve(np.array(contact.covariance_cm2), off)) <= _IN_ELLIPSE


def _is_placed(contact: MapContact, true_contacts: Sequence[TrueContact], peg: int) -> bool:
    """Whether a contact is that with a peg: near its truth, which its 95 % ellipse holds."""
    return _has_ellipse(contact) and any(
        hypot(true.x_cm - contact.x_cm, true.y_cm - contact.y_cm) <= _BOTH_CM
        and _in_ellipse(contact, true)
        for true in true_touches(contact, true_contacts)
        if true.peg == peg
    )


class Mapped(NamedTuple):
    """Comparison of a run's map with the room."""

    # felt, felt_free: cells inside pegs that were felt, and how many of them are called free
    felt: int
    felt_free: int
    # missed, missed_free: the same for all other pegs
    missed: int
    missed_free: int
    # free, swept: cells called free, and cells that the sweeps seem to cover
    free: int
    swept: int
    # occupied, occupied_near: cells called occupied, and how many of them are near a surface
    occupied: int
    occupied_near: int


def judge_map(document: RunDocument) -> Mapped:
    """Compare a run's map with the emulator's room."""
    grid, _ = occupancy(document, RADIUS)
    bold, _ = occupancy(document, RADIUS, sigmas=0.0)
    free, felt = grid.cells == FREE, felt_pegs(document)
    x, y = grid.centers()
    counts = np.zeros((2, 2), dtype=np.int64)
    for index, peg in enumerate(document.truth.pegs if document.truth else ()):
        inside = np.hypot(x - peg.x_cm, y - peg.y_cm) < peg.radius_cm
        counts[int(index not in felt)] += inside.sum(), (inside & free).sum()
    swept = int((bold.cells == FREE).sum())
    occupied = grid.cells == OCCUPIED
    near = np.zeros(occupied.shape, dtype=np.bool_)
    for peg in document.truth.pegs if document.truth else ():
        away = np.hypot(x - peg.x_cm, y - peg.y_cm) - peg.radius_cm
        near |= np.abs(away) < _NEAR_CM
    cells = int(occupied.sum()), int((occupied & near).sum())
    return Mapped._make([*counts.ravel().tolist(), int(free.sum()), swept, *cells])


Run = tuple[Explored, Mapped | None]


class Room(NamedTuple):
    """A room, and how it is explored."""

    kind: str
    seed: int
    setting: str = "default"  # an effort, a budget of robot time, or the thesis's protocol
    method: str = FIELD


def visit(room: Room) -> Run:
    """Explore a room of a kind and seed with a setting; judge its map if it has pegs."""
    name, seed, setting, method = room
    kind, explored = KINDS[name], Explored(name, seed, setting)
    scene = Scene.load(kind.scene)
    scene.rescale_errors(kind.noise)
    known = scene.believed(seed)
    rng = np.random.default_rng([seed, 0x9E6])
    for side in scene.robot.sides:
        for muscle_map in scene.robot.muscle(side).maps:
            muscle_map.inflate.amplitude *= kind.bend
            muscle_map.deflate.amplitude *= kind.bend
        for sensor in scene.robot.column(side):
            sensor.rescale(1.0 / (1.0 + kind.gains * rng.standard_normal()))
    if kind.friction is not None:
        scene.robot.body.growth_psi_per_cm = float(rng.uniform(*kind.friction))
    scene.body.friction = friction = float(rng.uniform(0.0, kind.rubs))
    match kind.stands:
        case "a peg":
            peg, _ = random_peg(scene.robot, rng, radius=RADII_CM)
            explored.x_cm, explored.y_cm, explored.radius_cm = peg.x, peg.y, peg.radius
            scene.pegs = [PegTable(x=peg.x, y=peg.y, radius=peg.radius)]
        case "pegs":
            scene.pegs = random_pegs(seed)
        case "a wall":
            scene.pegs = random_wall(seed)
        case "two pegs":
            scene.pegs = random_pair(seed, friction)
        case "a peg slipped past":
            scene.pegs = [random_slipped(seed, friction)]
        case "":
            scene.pegs = []
    critical = scene.robot.body.critical_curvature
    scene.body.base_compliance_cm = float(rng.uniform(0.0, kind.base_rad)) / critical
    for table in scene.pegs:
        yields = float(rng.uniform(0.0, kind.yields_cm))
        table.compliance_cm3 = yields * _YIELDS_AT_CM / critical
        if kind.gives_way:
            table.gives_way = float(rng.uniform(*_WEAK)) * critical / hypot(table.x, table.y)
    if kind.round_tip:
        scene.body.tip_rounding_cm = scene.robot.body.radius_cm
    if kind.drawn:
        scene.flex.against_gain = float(rng.uniform(*_AGAINST))
        scene.noise.hysteresis *= float(rng.uniform(*_LOOPS))
        scene.noise.hysteresis_width *= float(rng.uniform(*_LOOPS))
        scene.muscle.inflate_tau_s *= float(rng.uniform(*_SLOWER))
    protocol, effort = "thesis" if setting == "thesis" else "measure", _effort(setting, known)
    began_s = process_time()
    try:
        document = explored_scene(
            scene, seed, config=known, protocol=protocol, effort=effort, method=method
        )
    except ThigmoError as error:
        explored.status = f"aborted: {error.problem}"
        return explored, None
    explored.processor_s = process_time() - began_s
    explored.judge(document)
    return explored, judge_map(document) if kind.stands else None


def _effort(setting: str, config: RobotConfig) -> Effort:
    if setting == "thesis":
        return THESIS
    if setting in EFFORTS:
        return EFFORTS[setting]
    return within(float(setting.split()[0]), Wiring.laid_out(config))


def rooms(context: Context) -> list[list[Room]]:
    """All rooms, in rounds: those of the promises, then those of the dial.

    Where settings are chosen, every room is explored with each of them.
    """
    choice = context.explorations
    method = choice.method or FIELD
    rounds: list[list[Room]] = [[] for _ in range(2 * ROUNDS)]
    for number, (name, kind) in enumerate(KINDS.items()):
        if choice.kinds and name not in choice.kinds:
            continue
        count = context.count(1, kind.rooms)
        seeds = context.rng(0x0E, number).integers(0, 2**31, count).tolist()
        for n, seed in enumerate(seeds):
            rounds[ROUNDS * n // count] += [
                Room(name, seed, setting, method) for setting in choice.settings or ("default",)
            ]
        if name in DIALLED and not choice.settings:
            dialled = seeds[: context.count(1, DIALLED[name])]
            for n, seed in enumerate(dialled):
                rounds[ROUNDS + ROUNDS * n // len(dialled)] += [
                    Room(name, seed, setting, method)
                    for setting in SETTINGS
                    if setting != "default"
                ]
    return [planned for planned in rounds if planned]


def check(choice: Explorations) -> None:
    """Raises DataError if there are no such kinds, settings or method."""
    if choice.method is not None:
        check_exploration_method(choice.method)
    for noun, chosen, known in (
        ("kind of rooms", choice.kinds, tuple(KINDS)), ("setting", choice.settings, SETTINGS),
    ):  # fmt: skip
        for name in chosen:
            if name not in known:
                raise DataError(f"there is no {noun} {name!r}", f"choose from {', '.join(known)}")


def run(context: Context) -> Outcome:
    """Explore rooms of every kind, and check the promises."""
    check(context.explorations)
    runs: list[Run] = []
    outcome = Outcome()
    rounds = rooms(context)
    for number, round_rooms in enumerate(rounds, 1):
        part = f"rooms, part {number} of {len(rounds)}"
        runs += context.map(visit, round_rooms, part)
        del context.samples[part]
        context.samples["rooms"] = len(runs)
        outcome = judged(runs, context.explorations)
        context.save(outcome)
    return outcome


def judged(visits: list[Run], choice: Explorations | None = None) -> Outcome:
    """Tables, figures and promises of explored rooms."""
    choice = choice or Explorations()
    explored = [room for room, _ in visits]
    runs = [(room, mapped) for room, mapped in visits if room.setting == "default"]
    dialled = _dial(explored)
    default_rooms = [room for room, _ in runs]
    rows = _by_kind(explored if choice.settings else default_rooms)
    tables: dict[str, Sequence[Record]] = {"runs": [vars(room) for room in explored], "rows": rows}
    claims, notes = _claims(default_rooms), list[str]()
    maps: dict[str, list[Mapped]] = {
        name: [] for name in ("robots as calibrated", WALLS, "other robots")
    }
    for room, mapped in runs:
        if mapped:
            group = room.kind if room.kind == WALLS else "other robots"
            maps["robots as calibrated" if room.kind in CALIBRATED else group].append(mapped)
    if any(maps.values()):
        map_claims, notes = _map_claims(maps)
        claims += map_claims
    figures = {"explorations": _figure(default_rooms)} if default_rooms else {}
    if dialled:
        tables["dial"] = dialled
        claims += _dial_claims(dialled)
        if {(row["kind"], row["setting"]) for row in dialled} == {
            (kind, setting) for kind in DIALLED for setting in SETTINGS
        }:
            figures["dial"] = dial_figure(dialled)
    summary = rows
    if choice.against and (paired := pairs(choice.against, tables["runs"])):
        tables["pairs"] = summary = paired
    return Outcome(tables, figures, claims, notes, summary, published=("rows", "dial", "pairs"))


def _map_claims(maps: dict[str, list[Mapped]]) -> tuple[list[Claim], list[str]]:
    """Promises of the planners' maps, and notes on those of which nothing is promised."""
    promised, *unpromised = [
        row for name, group in maps.items() for row in _map_shares(f"maps of {name}", group)
    ]
    total = Mapped._make(
        sum(mapped[n] for group in maps.values() for mapped in group)
        for n in range(len(Mapped._fields))
    )
    near = 100 * total.occupied_near / max(total.occupied, 1)
    claims = [
        Claim(*promised, 0.1, unit="%"),
        Claim(f"occupied cells within {_NEAR_CM:g} cm of a surface", near, 60.0, False, "%"),
    ]
    notes = [f"{text}: {cells:{'.2g' if cells < 10 else '.0f'}} %" for text, cells in unpromised]
    return claims, notes


_COUNTED = {
    "missed": "touched_missed", "false": "far", "wrong": "contacts_wrong",
    "ellipses_missed": "ellipses_missed",
}  # fmt: skip


def pairs(old_rows: Sequence[Record], new_rows: Sequence[Record]) -> list[Record]:
    """Differences between two tables of runs, in the rooms that both explored.

    A row for each kind and setting: errors of the best contact in rooms where both have one, the
    mean of their difference with its standard error, and counts before and after.
    """

    def key(run: Record) -> tuple[str, int, str]:
        return str(run["kind"]), int(run["seed"]), str(run["setting"])

    def number(run: Record, column: str) -> float:
        value = run[column]
        return nan if value is None else float(value)  # strict JSON has no NaN

    earlier = {key(run): run for run in old_rows}
    pairs = [(earlier[key(run)], run) for run in new_rows if key(run) in earlier]
    rows: list[Record] = []
    for kind, setting in dict.fromkeys((run["kind"], run["setting"]) for _, run in pairs):
        group = [pair for pair in pairs if (pair[1]["kind"], pair[1]["setting"]) == (kind, setting)]
        errors = np.array([[number(run, "best_cm") for run in pair] for pair in group])
        errors = errors[np.isfinite(errors).all(axis=1)]
        change = errors[:, 1] - errors[:, 0]
        placed = len(errors)
        old_cm, new_cm = errors.mean(axis=0).tolist() if placed else (nan, nan)
        counts = {
            f"{count}{suffix}": int(sum(number(pair[n], column) for pair in group))
            for count, column in _COUNTED.items()
            for n, suffix in enumerate(("_before", ""))
        }
        rows.append({
            "kind": str(kind), "setting": str(setting), "rooms": len(group), "placed": placed,
            "error_before_cm": old_cm, "error_cm": new_cm,
            "change_cm": float(change.mean()) if placed else nan,
            "change_se_cm": float(change.std(ddof=1)) / sqrt(placed) if placed > 1 else nan,
            **counts,
            "samples": _median([number(run, "samples") for _, run in group]),
            "processor_before_s": float(np.mean([number(run, "processor_s") for run, _ in group])),
            "processor_s": float(np.mean([number(run, "processor_s") for _, run in group])),
        })  # fmt: skip
    return rows


def _map_shares(name: str, maps: list[Mapped]) -> list[tuple[str, float]]:
    """Shares of wrong cells in per cent; the first is promised for calibrated robots."""
    total = Mapped._make(sum(mapped[n] for mapped in maps) for n in range(len(Mapped._fields)))
    return [
        (f"{name}, {len(maps)} rooms: of {total.felt} cells inside pegs that were felt, free",
         100 * total.felt_free / max(total.felt, 1)),
        (f"{name}: of {total.missed} cells inside pegs that were missed, free",
         100 * total.missed_free / max(total.missed, 1)),
        (f"{name}: free space kept of what the sweeps seem to cover",
         100 * total.free / max(total.swept, 1)),
    ]  # fmt: skip


def _median(numbers: Sequence[float]) -> float:
    """Median of what is known; NaN if nothing is."""
    return float(np.nanmedian(numbers)) if np.isfinite(numbers).any() else nan


def _median_x(explored: list[Explored]) -> float:
    return _median([room.error_x_cm for room in explored])


def _error(explored: list[Explored]) -> float:
    """Mean error of all contacts in the plane, cm; NaN without one."""
    near = sum(room.near for room in explored)
    return sum(room.near * room.error_cm for room in explored if room.near) / near if near else nan


def _mean(numbers: Sequence[float]) -> float:
    """Mean of what is known; NaN if nothing is."""
    return float(np.nanmean(numbers)) if np.isfinite(numbers).any() else nan


def _standard_error(numbers: Sequence[float]) -> float:
    """Standard error of that mean; NaN of fewer than two numbers."""
    known = np.array(numbers)[np.isfinite(numbers)]
    return float(known.std(ddof=1)) / sqrt(known.size) if known.size > 1 else nan


def _by_kind(explored: list[Explored]) -> list[Record]:
    """A row for each kind and setting."""
    groups = [
        (kind, setting, rooms)
        for kind in KINDS
        for setting in SETTINGS
        if (rooms := [room for room in explored if (room.kind, room.setting) == (kind, setting)])
    ]
    return [
        {
            "kind": kind, "setting": setting, "rooms": len(rooms),
            "with_false_contacts": sum(room.far > 0 for room in rooms),
            "aborted": sum(room.status.startswith("aborted") for room in rooms),
            "median_error_x_cm": _median_x(rooms),
            **{
                counted: sum(getattr(room, counted) for room in rooms)
                for counted in ("touched", "touched_missed", "far", "contacts_localized",
                             "sets_missed", "contacts_wrong", "ellipses", "ellipses_missed",
                             "pairs", "pairs_placed", "gave_way", "gave_way_said", "standing_gone")
            },
            "error_cm": _error(rooms),
            "best_cm": _mean([room.best_cm for room in rooms]),
            "best_se_cm": _standard_error([room.best_cm for room in rooms]),
            "samples": _median([room.samples for room in rooms]),
            "processor_s": float(np.mean([room.processor_s for room in rooms])),
        }
        for kind, setting, rooms in groups
    ]  # fmt: skip


def _claims(explored: list[Explored]) -> list[Claim]:
    def of_kinds(*names: str) -> list[Explored]:
        return [room for room in explored if room.kind in names]

    def total(group: list[Explored], column: str) -> float:
        return float(sum(getattr(room, column) for room in group))

    def per(rooms: int, group: list[Explored], column: str) -> float:
        return rooms * total(group, column) / max(len(group), 1)

    def missed(group: list[Explored]) -> float:
        return 100 * total(group, "touched_missed") / max(total(group, "touched"), 1.0)

    walls, stalls, several = of_kinds(WALLS), of_kinds(STALLS), of_kinds(MORE)
    sides = [room for room in of_kinds(PAIR) if room.pairs]
    gone = [room for room in of_kinds(GIVES_WAY) if room.gave_way]
    standing = [room for room in explored if KINDS[room.kind].stands and not room.gave_way]
    pegs = of_kinds(TRUE, *_OTHERS)
    noisy = share([room.far > 0 for room in of_kinds(*_NOISY)])
    held = per(60, walls, "contacts_localized") - per(60, walls, "contacts_wrong")
    stalled = [room for room in stalls if room.cause]
    one_peg, off = f"one peg, {len(pegs)} rooms", f"{_OFF_CM:g} cm"
    empty, several_pegs = f"{STALLS}, {len(stalls)} rooms", f"{MORE}, {len(several)} rooms"
    walled = f"{WALLS}, {len(walls)} rooms"
    # Of kinds that were not explored nothing is claimed.
    claims: list[Claim] = []
    if walls:
        claims += [
            Claim(f"{walled}: localized wrong, of 60 rooms", per(60, walls, "contacts_wrong"), 1.0),
            Claim(f"{WALLS}: localized, and held, of 60 rooms", held, 8.0, False),
            Claim(f"{WALLS}: false contacts, a room", per(1, walls, "far"), 0.3),
            Claim(f"{WALLS}: contacts missed by {off}", missed(walls), 20.0, unit="%"),
        ]
    if stalls:
        claims += [
            Claim(f"{empty}: localized", total(stalls, "contacts_localized"), 0.0),
            Claim(
                f"{STALLS}: of {len(stalled)} that stalled, the cause is true after a trial",
                share([room.cause == "pressure" for room in stalled]), 0.8, False,
            ),
        ]  # fmt: skip
    if pegs:
        claims += [
            Claim(f"{one_peg}: missed by {off}, of 60 rooms", per(60, pegs, "touched_missed"), 1.0),
            Claim(f"{one_peg}: false contacts, of 60 rooms", per(60, pegs, "far"), 1.0),
        ]
    if several:
        claims += [
            Claim(
                f"{several_pegs}: localized wrong, of 40 rooms",
                per(40, several, "contacts_wrong"),
                2.0,
            ),
            Claim(f"{MORE}: contacts missed by {off}", missed(several), 10.0, unit="%"),
        ]
    if sides:
        both = share([room.pairs_placed > 0 for room in sides])
        claims.append(Claim(f"{PAIR}, {len(sides)} sides: both placed", both, 0.6, False))
    if gone:
        said = share([room.gave_way_said > 0 for room in gone])
        claims.append(Claim(f"{GIVES_WAY}, {len(gone)} that did: said so", said, 0.8, False))
    if standing:
        text = f"pegs that stand, {len(standing)} rooms: said to have given way, of 60 rooms"
        claims.append(Claim(text, per(60, standing, "standing_gone"), 1.0))
    if of_kinds(TRUE):
        claims.append(Claim(f"{TRUE}: median |x error|", _median_x(of_kinds(TRUE)), 3.0, unit="cm"))
    if of_kinds(*_NOISY):
        claims.append(Claim("noisy or empty: runs with false contacts", noisy, 0.03))
    return _coverage_claims(explored) + claims


def _coverage_claims(explored: list[Explored]) -> list[Claim]:
    """Promises of ellipses, sets and localized contacts: over all kinds, and of the worst."""
    kinds = {str(row["kind"]): row for row in _by_kind(explored) if row["ellipses"]}
    if not kinds:
        return []

    def missed(*names: str) -> float:
        ellipses = sum(int(kinds[name]["ellipses"]) for name in names)
        return 100 * sum(int(kinds[name]["ellipses_missed"]) for name in names) / ellipses

    def per_60(name: str, counted: str) -> float:
        return 60 * float(kinds[name][counted]) / float(kinds[name]["rooms"])

    worst = max(kinds, key=missed)
    text = "95 % ellipses without the truth"
    claims = [
        Claim(f"{text}, all kinds", missed(*kinds), 8.0, unit="%"),
        Claim(f"{text}, the worst kind ({worst})", missed(worst), 15.0, unit="%"),
    ]
    for text, counted, most in (
        ("localized wrong", "contacts_wrong", 1.0),
        ("localized, the arc outside of its set", "sets_missed", 5.0),
    ):
        rates = {name: per_60(name, counted) for name in kinds}
        worst = max(rates, key=lambda name: rates[name])
        claims.append(Claim(f"{text}, of 60 rooms, the worst kind ({worst})", rates[worst], most))
    if TRUE in kinds:
        wrong = per_60(TRUE, "contacts_wrong")
        claims.append(Claim(f"{TRUE}: localized wrong, of 60 rooms", wrong, 0.0))
    return claims


def _dial(explored: list[Explored]) -> list[Record]:
    """Results of each setting of robot time in each kind of room."""
    rows: list[Record] = []
    seeds = {room.seed for room in explored if room.setting != "default"}
    for kind in DIALLED:
        for setting in SETTINGS:
            rooms = [
                o for o in explored if (o.kind, o.setting) == (kind, setting) and o.seed in seeds
            ]
            if not rooms:
                continue
            near, touched = (
                sum(getattr(o, counted) for o in rooms) for counted in ("near", "touched")
            )
            errors = sum(room.near * room.error_cm for room in rooms if room.near)
            localized = sum(room.contacts_localized for room in rooms)
            rows.append({
                "kind": kind, "setting": setting, "rooms": len(rooms),
                "time_s": float(np.mean([room.time_s for room in rooms])),
                "longest_s": max(room.time_s for room in rooms),
                "contacts": near,
                "error_cm": errors / near if near else nan,
                "error_se_cm": _standard_error([room.error_cm for room in rooms]),
                "missed": sum(room.touched_missed for room in rooms) / max(touched, 1),
                "localized": localized,
                "wrong": sum(room.contacts_wrong for room in rooms) / max(localized, 1),
            })  # fmt: skip
    return rows


def _dial_claims(rows: list[Record]) -> list[Claim]:
    """Promises of each effort in rooms with one peg, and of budgets in all rooms."""
    by_setting = {row["setting"]: row for row in rows if row["kind"] == TRUE}
    if len(by_setting) < len(SETTINGS):
        return []

    def value(setting: str, column: str) -> float:
        return float(by_setting[setting][column])

    claims = [
        Claim(
            f"one peg, {setting}: mean error in the plane",
            value(setting, "error_cm"),
            most,
            unit="cm",
            standard_error=value(setting, "error_se_cm"),
        )
        for setting, most in (("careful", 0.5), ("default", 0.6), ("quick", 0.9), ("100 s", 1.2))
    ]
    longer = value("careful", "time_s") / value("thesis", "time_s")
    localized = 100 * value("100 s", "localized") / max(value("100 s", "contacts"), 1.0)
    longest = max(
        float(row["longest_s"]) / float(str(row["setting"]).split()[0])
        for row in rows
        if str(row["setting"])[0].isdigit()
    )
    return [
        *claims,
        Claim("one peg, careful: robot time over the thesis's protocol's", longer, 0.57),
        Claim("one peg, default: robot time", value("default", "time_s"), 150.0, unit="s"),
        Claim("one peg, quick: robot time", value("quick", "time_s"), 120.0, unit="s"),
        Claim("one peg, 100 s: localized, of those felt", localized, 25.0, False, "%"),
        Claim("budgets: longest run over its budget", longest, 1.1),
    ]


def dial_figure(rows: Sequence[Record]) -> Figure:
    """Error, contacts missed and contacts localized wrong, against robot time."""
    figure, axes = charts.panels(
        2, len(DIALLED), size=(3.4, 2.9),
        title="What robot time buys: mean error (above), contacts missed or wrongly localized",
    )  # fmt: skip
    most_cm = max((float(row["error_cm"]) for row in rows if row["contacts"]), default=1.0)
    most = max(max(float(row["missed"]), float(row["wrong"])) for row in rows)
    named = []
    for column, kind in enumerate(DIALLED):
        upper, lower = axes[column], axes[len(DIALLED) + column]
        dials = sorted((row for row in rows if row["kind"] == kind), key=lambda row: row["time_s"])
        budgets = [row for row in dials if str(row["setting"])[0].isdigit()]
        x = [row["time_s"] for row in budgets]
        upper.plot(x, [row["error_cm"] for row in budgets], "o-", color=BLUE, label="a budget")
        efforts = [row for row in dials if row not in budgets and row["setting"] != "thesis"]
        thesis = [row for row in dials if row["setting"] == "thesis"]
        for runs, label, color, marker in (
            (efforts, "an effort", GREEN, "D"), (thesis, "the thesis's protocol", "0.4", "s"),
        ):  # fmt: skip
            upper.scatter([row["time_s"] for row in runs], [row["error_cm"] for row in runs], 40,
                          marker=marker, color=color, label=label)  # fmt: skip
        for share_name, label, color, marker, face in (
            ("missed", "contacts missed", RED, "X", RED),
            ("wrong", "localized ones that are wrong", ORANGE, "^", "none"),
        ):
            y = [100 * float(row[share_name]) for row in dials]
            lower.scatter([row["time_s"] for row in dials], y, 24, marker=marker, edgecolors=color,
                          facecolors=face, label=label)  # fmt: skip
        named.append((upper, dials, budgets))
        upper.set_title(kind, fontsize=9)
        for axis in (upper, lower):
            axis.set_xlim(-20, None)  # room for the first name
        upper.set_ylim(0, 1.15 * most_cm)
        lower.set(xlabel="robot time (s)", ylim=(-2, 115 * most + 2))
    axes[0].set_ylabel("mean error in the plane (cm)")
    axes[len(DIALLED)].set_ylabel("share (%)")
    charts.legend_below(figure, axes[0], axes[len(DIALLED)])
    figure.draw_without_rendering()
    for axis, dials, budgets in named:
        points, line = (
            [(float(row["time_s"]), float(row["error_cm"])) for row in rows]
            for rows in (dials, budgets)
        )
        x, y = np.array(line).T
        fine = np.linspace(x[0], x[-1], 200)  # steps fine enough to look like a line
        steps = list(zip(fine, np.interp(fine, x, y), strict=True))
        charts.named(axis, points, [str(row["setting"]) for row in dials], steps)
    return figure


def _figure(explored: list[Explored]) -> Figure:
    """Places where pegs were found, and failures by kind."""
    figure, (first, second) = charts.panels(
        1, 2, size=(6.5, 5.5),
        title="Where pegs were found and missed, and how often each kind of robot and room fails",
    )  # fmt: skip
    pegs = [room for room in explored if np.isfinite(room.x_cm)]
    for label, marker, color, rooms in (
        ("found", "o", GREEN, [e for e in pegs if not e.touched_missed and not e.contacts_wrong]),
        ("localized, and wrong", "^", ORANGE, [e for e in pegs if e.contacts_wrong]),
        ("missed", "X", RED, [e for e in pegs if e.touched_missed]),
    ):
        x, y = [e.x_cm for e in rooms], [e.y_cm for e in rooms]
        first.scatter(x, y, 14, marker=marker, color=color, label=f"{label} ({len(rooms)})")
    first.fill_between([0.0, 53.0], -1.75, 1.75, color="0.85", label="straight robot")
    first.set(xlabel="x along the straight robot (cm)", ylabel="y (cm)", aspect="equal")
    rows = _by_kind(explored)
    places = np.arange(len(rows))
    for shift, (label, color, counted, total) in enumerate((
        ("contacts missed", RED, "touched_missed", "touched"),
        ("localized ones that are wrong", ORANGE, "contacts_wrong", "contacts_localized"),
        ("rooms with false contacts", "0.5", "with_false_contacts", "rooms"),
    )):  # fmt: skip
        shares = [100 * float(row[counted]) / max(float(row[total]), 1.0) for row in rows]
        second.barh(places + 0.25 * (shift - 1), shares, 0.25, color=color, label=label)
    second.set_yticks(places, [str(row["kind"]) for row in rows], fontsize=8)
    second.invert_yaxis()
    second.set(xlabel="share (%)", xlim=(0, None))
    legend: dict[str, Any] = {"fontsize": 7, "ncols": 2, "frameon": False}
    figure.legend(*first.get_legend_handles_labels(), loc="outside lower left", **legend)
    figure.legend(*second.get_legend_handles_labels(), loc="outside lower right", **legend)
    return figure
