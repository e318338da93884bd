"""Answers of `localize` to readings with the mistakes that labs make, stated and not stated.

A mistake is a free curvature of the wrong sign, subtracted twice, not given or a little off, gains
or an offset that all readings share, correlated noise, a noise that was guessed, a contact that
bears a couple and no force, or a small fold at the base. Beside them stand frames without a
mistake, and bodies that nothing touches. Each frame is answered twice: with nothing stated of its
errors but the noise, and with all of them stated. Truth is the independent rod (`rod`).

A frame is wrong if one of its localized contacts has no true contact in its 95 % set. The share of
wrong frames is given among all frames and among those with a localized contact: a user sees the
latter.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from thigmo.display.axes import BLUE, RED
from thigmo.localization import Contact, Localizer
from thigmo_bench.studies.charts import legend_below, panels
from thigmo_bench.studies.contact_scenes import signs
from thigmo_bench.studies.engine import Claim, Context, Outcome, last, parts, share
from thigmo_bench.studies.rod import Floats, solve
from thigmo_bench.studies.scenes import BOTH, COLUMN, CRITICAL, LENGTH, RADIUS, SIGMA, SPAN, STATED

BATCH = 50  # frames in one task
SPARE_CM = 0.1  # by which a true contact may lie beside a set
FEW = 5  # sensors, of which so few localize that wrong answers are counted among all frames
APART_CM = 8.0  # least distance of two contacts
OFFSET = 1e-3  # 1/cm
FOLD = np.deg2rad(5.0)
DIAMETER = 2.0 * RADIUS


@dataclass(frozen=True)
class Body:
    """A straight or bent body and its sensors: averages over spans, or points if there are many."""

    bent: bool
    sensors: int

    @property
    def position(self) -> Floats:
        """(N,) centres of the sensors."""
        if self.sensors == FEW:
            return COLUMN
        if self.sensors == BOTH.size and not self.bent:
            return BOTH
        evenly: Floats = np.linspace(2.75, LENGTH - 2.75, self.sensors)
        return evenly

    @property
    def span(self) -> float:
        """Length of each sensor."""
        return SPAN if self.sensors <= 20 else 0.0

    def __str__(self) -> str:
        return f"{'bent' if self.bent else 'straight'}, {self.sensors} sensors"


class Loads(NamedTuple):
    """Loads on S bodies, as `rod.solve` takes them, and the places of the contacts among them."""

    arcs: Floats  # (S, E)
    normal: Floats  # (S, E)
    contacts: Floats  # (S, C)
    more: dict[str, Any] = {}  # noqa: RUF012


Draw = Callable[[np.random.Generator, Floats], Loads]
"""Loads on bodies of these free curvatures (S,)."""


def _moment(rng: np.random.Generator, free: Floats) -> Floats:
    """(S,) a contact's moment at the base over EI: against the bend, or to either side."""
    most = np.where(free == 0.0, CRITICAL, np.minimum(CRITICAL, 0.9 * np.abs(free)))
    side = np.where(free == 0.0, signs(rng, len(free)), -np.sign(free))
    moment: Floats = side * rng.uniform(0.2, 1.0, len(free)) * most
    return moment


def nothing(rng: np.random.Generator, free: Floats) -> Loads:
    """A body that nothing touches."""
    end = np.full((len(free), 1), LENGTH)
    return Loads(end, np.zeros_like(end), np.empty((len(free), 0)))


def one(rng: np.random.Generator, free: Floats) -> Loads:
    """One contact on the side."""
    arcs = rng.uniform(12.0, LENGTH, (len(free), 1))
    return Loads(arcs, _moment(rng, free)[:, None] / arcs, arcs)


def two(rng: np.random.Generator, free: Floats) -> Loads:
    """Two contacts anywhere, with independent moments to either side."""
    arcs = 12.0 + np.sort(rng.uniform(0.0, LENGTH - 12.0 - APART_CM, (len(free), 2)), axis=1)
    arcs += APART_CM * np.arange(2)
    moments = rng.choice([-1.0, 1.0], arcs.shape) * rng.uniform(0.3, 1.0, arcs.shape) * CRITICAL
    return Loads(arcs, moments / arcs, arcs)


def on_end(rng: np.random.Generator, free: Floats) -> Loads:
    """A peg that pushes on the face of the end, 10 to 90 degrees from the body's axis."""
    end = np.full((len(free), 1), LENGTH)
    across = _moment(rng, free)[:, None] / LENGTH
    along = -np.abs(across) / np.tan(rng.uniform(np.deg2rad(10.0), np.pi / 2, end.shape))
    along = np.maximum(along, -2.0 * CRITICAL / LENGTH)
    couple = rng.uniform(-RADIUS, RADIUS, end.shape) * along
    return Loads(end, across, end, {"tangential": along, "couple": couple})


def grip(rng: np.random.Generator, free: Floats) -> Loads:
    """A hand that holds the end, by a force within 60 degrees of its normal and a couple."""
    end = np.full((len(free), 1), LENGTH)
    force = rng.choice([-1.0, 1.0], end.shape) * rng.uniform(0.3, 2.0, end.shape) / LENGTH**2
    slant = rng.uniform(-np.pi / 3, np.pi / 3, end.shape)
    couple = rng.uniform(-1.0, 1.0, end.shape) / LENGTH
    end_loads = {"tangential": force * np.sin(slant), "couple": couple}
    return Loads(end, force * np.cos(slant), end, end_loads)


def couple(rng: np.random.Generator, free: Floats) -> Loads:
    """A couple without a force."""
    arcs = rng.uniform(12.0, LENGTH, (len(free), 1))
    size = signs(rng, len(free)) * rng.uniform(0.3, 1.0, len(free)) * CRITICAL
    return Loads(arcs, np.zeros_like(arcs), arcs, {"couple": size[:, None]})


def folded(rng: np.random.Generator, free: Floats) -> Loads:
    """One contact, and a fold to either side that is spread over a diameter at the base."""
    touch = one(rng, free)
    arcs = np.hstack([np.full_like(touch.arcs, DIAMETER), touch.arcs])
    normal = np.hstack([np.zeros_like(touch.normal), touch.normal])
    added = np.zeros((len(free), 3))
    added[:, 0] = signs(rng, len(free)) * FOLD / DIAMETER
    return Loads(arcs, normal, touch.arcs, {"added": added})


class Readings(NamedTuple):
    """Readings (S, N) of S bodies, and the free curvature (S,) that is passed; None: not given."""

    curvature: Floats
    free: Floats | None


Spoil = Callable[[np.random.Generator, Readings], Readings]


def _as_it_is(rng: np.random.Generator, given: Readings) -> Readings:
    return given


def _free_times(factor: float | None, rng: np.random.Generator, given: Readings) -> Readings:
    """Pass a multiple of the free curvature; None: pass none."""
    assert given.free is not None
    return Readings(given.curvature, None if factor is None else factor * given.free)


def _free_off(size: float, rng: np.random.Generator, given: Readings) -> Readings:
    assert given.free is not None
    return Readings(given.curvature, given.free * (1.0 + size * signs(rng, len(given.free))))


def _subtracted(rng: np.random.Generator, given: Readings) -> Readings:
    assert given.free is not None
    return Readings(given.curvature - given.free[:, None], given.free)


def _gains(size: float, rng: np.random.Generator, given: Readings) -> Readings:
    gains = 1.0 + size * signs(rng, len(given.curvature))
    return Readings(given.curvature * gains[:, None], given.free)


def _offset(size: float, rng: np.random.Generator, given: Readings) -> Readings:
    offset = size * signs(rng, len(given.curvature))
    return Readings(given.curvature + offset[:, None], given.free)


@dataclass(frozen=True)
class Kind:
    """One mistake: what loads the bodies, what is wrong, and how it is stated."""

    bodies: tuple[Body, ...]
    loads: Draw = one
    spoil: Spoil = _as_it_is  # changes readings without noise, and what is passed with them
    noise: float = 1.0  # that is passed, over the true one
    correlation: float = 0.0  # of neighbouring readings' noise
    stated: dict[str, Any] = field(default_factory=dict)  # beside all errors as 0
    # whether the right free curvature is passed where the error is stated
    corrected: bool = False
    most: float = 0.12  # promised share of wrong frames of those localized
    remark: str = "\0"  # part of the remark that names it
    named: float | None = None  # promised share of frames that are named, 20 sensors or more


STRAIGHT = {n: Body(False, n) for n in (10, 20, 100)}
BENT = {n: Body(True, n) for n in (5, 10, 20, 100)}
_BENT = tuple(BENT.values())
_CLEAN = (STRAIGHT[10], *_BENT)
_MANY = (STRAIGHT[100], BENT[100])
TOUCHED_KINDS: dict[str, Kind] = {
    "one contact": Kind(_CLEAN, most=0.05),
    "two contacts": Kind((STRAIGHT[20], BENT[10], BENT[20]), two, most=0.05),
    "peg on the end": Kind((BENT[10], BENT[20]), on_end, most=0.05),
    "grip": Kind((STRAIGHT[10], BENT[20]), grip, most=0.05),
    "sign turned": Kind(
        _BENT, spoil=partial(_free_times, -1.0), corrected=True, remark="wrong sign", named=0.95
    ),
    "subtracted twice": Kind(
        _BENT, spoil=_subtracted, corrected=True, remark="subtracted already", named=0.85
    ),
    "not given": Kind(_BENT, spoil=partial(_free_times, None), corrected=True),
    "stated as 0": Kind((BENT[20],), spoil=partial(_free_times, 0.0), corrected=True, most=0.2),
    "5 % off": Kind(_BENT, spoil=partial(_free_off, 0.05), stated={"map_error": 0.05}),
    "10 % off": Kind(_BENT, spoil=partial(_free_off, 0.1), stated={"map_error": 0.1}),
    # A gain that all readings share changes the contact's part as its force would.
    "gains 10 % off": Kind(_BENT[:3], spoil=partial(_gains, 0.1), stated={"map_error": 0.1}),
    "offset": Kind(_CLEAN, spoil=partial(_offset, OFFSET), stated={"offset_error": OFFSET}),
    "correlation 0.5": Kind(
        _MANY, correlation=0.5, stated={"noise_correlation": 0.5}, remark="correlated"
    ),
    "correlation 0.9": Kind(
        _MANY, correlation=0.9, stated={"noise_correlation": 0.9}, remark="correlated"
    ),
    "couple": Kind(
        (STRAIGHT[20], BENT[20], STRAIGHT[100]), couple, stated={"contact_couple_odds": 1.0}
    ),
    "fold of 5 degrees": Kind(
        (STRAIGHT[10], STRAIGHT[20], BENT[20]), folded, stated={"base_fold_error": FOLD}, most=0.16
    ),
    "noise ten times too low": Kind(_CLEAN[:4], noise=0.1, remark="larger than stated"),
    "noise ten times too high": Kind(_CLEAN[:4], noise=10.0, remark="far below"),
}
# Those of which a body that nothing touches may be taken for a touched one.
EMPTY_KINDS: dict[str, Kind] = {
    "empty": Kind(_CLEAN, nothing),
    **{
        f"empty, {name}": replace(TOUCHED_KINDS[name], bodies=(BENT[5], BENT[20]), loads=nothing)
        for name in (
            "sign turned", "subtracted twice", "not given", "5 % off", "10 % off",
            "gains 10 % off", "offset", "noise ten times too low",
        )
    },
}  # fmt: skip
KINDS = TOUCHED_KINDS | EMPTY_KINDS
ACCUSING = (TOUCHED_KINDS["sign turned"].remark, TOUCHED_KINDS["subtracted twice"].remark)
CLEAN = ("one contact", "two contacts", "peg on the end", "grip")


class Frames(NamedTuple):
    """S frames of a group: readings with noise, what is passed, and the truth."""

    given: Readings
    true_free: Floats  # (S,)
    contacts: Floats  # (S, C)


def white(rng: np.random.Generator, shape: tuple[int, int], correlation: float) -> Floats:
    """Noise (S, N) of variance 1 whose neighbours are correlated: a process of the first order."""
    out = rng.standard_normal(shape)
    for n in range(1, shape[1]):
        out[:, n] = correlation * out[:, n - 1] + np.sqrt(1.0 - correlation**2) * out[:, n]
    return out


def draw(rng: np.random.Generator, kind: Kind, body: Body, count: int) -> Frames:
    """Frames of a kind of mistake on a body."""
    free = signs(rng, count) * rng.uniform(0.01, 0.04, count) * body.bent
    loads = kind.loads(rng, free)
    bodies = solve(
        loads.arcs, loads.normal, length=LENGTH, free_curvature=free[:, None], **loads.more
    )
    clean = bodies.readings(body.position, body.span)
    spoilt = kind.spoil(rng, Readings(clean, free))
    noisy = spoilt.curvature + SIGMA * white(rng, clean.shape, kind.correlation)
    return Frames(Readings(noisy, spoilt.free), free, loads.contacts)


class Seen(NamedTuple):
    """An answer compared with the truth."""

    localized: bool  # whether a contact is
    wrong: bool  # whether one is that has no true contact in its set
    listed: int  # contacts
    held: int  # of these, whose set holds a true contact
    off_cm: float  # largest distance of a true contact from the nearest that is listed; NaN: none
    named: bool  # whether a remark names the mistake
    accused: bool  # whether a remark doubts the sign or the use of the free curvature
    remarked: bool  # whether there is any remark


def holds(contact: Contact, arcs: Floats) -> bool:
    """Whether a contact's set holds one of the true places."""
    return any(
        bool(np.any((arcs >= low - SPARE_CM) & (arcs <= high + SPARE_CM)))
        for low, high in contact.intervals
    )


class Case(NamedTuple):
    """A group of frames, and whether their errors are stated."""

    kind: str
    body: Body
    stated: bool


def judge(task: tuple[Case, int, int, int]) -> list[Seen]:
    """Answer a batch of frames; a task is a case with the study's seed, the batch and its size."""
    (name, body, stated), seed, number, size = task
    kind = KINDS[name]
    key = [seed, tuple(KINDS).index(name), int(body.bent), body.sensors, number]
    frames = draw(np.random.default_rng(key), kind, body, size)
    noise = SIGMA * (1.0 if stated else kind.noise)
    options = STATED | kind.stated if stated else {}
    localizer = Localizer.of(
        position=body.position, span=body.span, length=LENGTH, tube_radius=RADIUS, noise=noise,
        **options,
    )  # fmt: skip
    free = frames.true_free if stated and kind.corrected else frames.given.free
    curvature = frames.given.curvature
    if stated and kind.spoil is _subtracted:
        curvature = curvature + frames.true_free[:, None]
    judged = []
    for row, (readings, arcs) in enumerate(zip(curvature, frames.contacts, strict=True)):
        given = None if free is None else float(free[row])
        answer = localizer.localize(readings, free_curvature=given)
        placed = [contact for contact in answer.contacts if contact.status == "localized"]
        listed = np.array([contact.arc for contact in answer.contacts])
        apart = np.abs(arcs[:, None] - listed[None, :])
        judged.append(
            Seen(
                bool(placed),
                any(not holds(contact, arcs) for contact in placed),
                len(answer.contacts),
                sum(holds(contact, arcs) for contact in answer.contacts),
                float(apart.min(axis=1).max()) if apart.size else np.nan,
                any(kind.remark in remark for remark in answer.remarks),
                any(phrase in remark for remark in answer.remarks for phrase in ACCUSING),
                bool(answer.remarks),
            )
        )
    return judged


Row = dict[str, Any]


def score(case: Case, frames: Sequence[Seen]) -> Row:
    """The row of a case."""
    placed = [frame.wrong for frame in frames if frame.localized]
    listed = sum(frame.listed for frame in frames)
    off = np.array([frame.off_cm for frame in frames])
    return {
        "kind": case.kind, "body": str(case.body), "sensors": case.body.sensors,
        "stated": case.stated, "count": len(frames),
        "localized": share([s.localized for s in frames]),
        "wrong": share([s.wrong for s in frames]), "wrong_of_localized": share(placed),
        "covered": sum(frame.held for frame in frames) / listed if listed else np.nan,
        "median_off_cm": float(np.nanmedian(off)) if np.isfinite(off).any() else np.nan,
        "named": share([s.named for s in frames]), "accused": share([s.accused for s in frames]),
        "remarked": share([s.remarked for s in frames]),
    }  # fmt: skip


def _standard_error(row: Row, probability: float) -> float:
    """Of a share among the localized frames."""
    count = max(row["count"] * row["localized"], 1.0)
    return float(np.sqrt(max(probability * (1.0 - probability), 1.0 / count) / count))


def _claims(rows: list[Row]) -> list[Claim]:
    """The promises, for errors that are not stated."""
    unstated = [row for row in rows if not row["stated"]]
    stated = {(row["kind"], row["body"]): row for row in rows if row["stated"]}
    claims = []
    for name in EMPTY_KINDS:
        most = max(row["localized"] for row in unstated if row["kind"] == name)
        claims.append(Claim(f"{name}: localized, most", most, 0.01))
    for name, kind in TOUCHED_KINDS.items():
        for row in (row for row in unstated if row["kind"] == name):
            text = f"{name}, {row['body']}: wrong"
            if row["sensors"] == FEW and name not in CLEAN:
                claims.append(Claim(f"{text} of all", row["wrong"], 0.03))
                continue
            value = float(np.nan_to_num(row["wrong_of_localized"]))
            error = _standard_error(row, kind.most)
            claims.append(Claim(f"{text} of localized", value, kind.most, standard_error=error))
    for name in CLEAN:
        kind_rows = [row for row in unstated if row["kind"] == name]
        claims.append(
            Claim(f"{name}: coverage, least", min(row["covered"] for row in kind_rows), 0.95, False)
        )
        for row in kind_rows:
            all_stated = stated[name, row["body"]]["localized"]
            kept = row["localized"] / all_stated if all_stated else np.nan
            least = 0.95 if row["sensors"] == 100 else 0.75
            text = f"{name}, {row['body']}: localized, over that with all errors stated"
            claims.append(Claim(text, kept, least, False))
    for name, kind in TOUCHED_KINDS.items():
        if kind.named is None:
            continue
        kind_rows = [row for row in unstated if row["kind"] == name and row["sensors"] >= 20]
        text = f"{name}, 20 sensors or more: named, least"
        claims.append(Claim(text, min(row["named"] for row in kind_rows), kind.named, False))
    clean = [row for row in unstated if row["kind"] in CLEAN[:3] and row["sensors"] >= 20]
    frames = sum(row["count"] for row in clean)
    accused, remarked = (
        sum(row[column] * row["count"] for row in clean) for column in ("accused", "remarked")
    )
    text = f"{frames} frames without a mistake or a grip"
    claims += [
        Claim(f"{text}: sign or use of the free curvature doubted", accused, 0.0),
        # Chi-square and the correlation are remarked in one of a hundred right frames each.
        Claim(f"{text}: share with any remark", remarked / max(frames, 1), 0.02),
    ]
    return claims


def _figure(rows: list[Row]) -> Figure:
    """Wrong answers of all frames and of the localized, and localized frames; stated and not."""
    groups = list(dict.fromkeys((row["kind"], row["body"]) for row in rows))
    lines = {(row["kind"], row["body"], row["stated"]): row for row in rows}
    figure, axes = panels(
        1, 3, size=(3.4, 0.17 * len(groups) + 1.2), share=True,
        title="Users' mistakes: wrong answers and localized frames, each mistake stated and not",
    )  # fmt: skip
    places = np.arange(len(groups))
    for label, color, place in (("not stated", RED, places - 0.2), ("stated", BLUE, places + 0.2)):
        bars = [lines[*group, label == "stated"] for group in groups]
        for axis, column in zip(axes, ("wrong_of_localized", "wrong", "localized"), strict=True):
            axis.barh(place, [100 * row[column] for row in bars], 0.4, color=color, label=label)
    axes[0].set_yticks(places, [f"{kind}: {body}" for kind, body in groups], fontsize=5)
    axes[0].set_ylim(len(groups), -1)
    for axis, text in zip(
        axes, ("wrong (% of localized)", "wrong (% of all)", "localized (% of all)"), strict=True
    ):
        axis.set_xlabel(text)
        axis.set_xlim(0, 100)
    legend_below(figure)
    return figure


def run(context: Context) -> Outcome:
    """The study: every mistake on its bodies, not stated and stated."""
    batches = parts(context.count(10, 400), BATCH)
    outcome = Outcome()
    rows: list[Row] = []
    for name, kind in KINDS.items():
        cases = [Case(name, body, stated) for body in kind.bodies for stated in (False, True)]
        tasks = [(case, context.seed, *batch) for case in cases for batch in batches]
        judged = iter(context.map(judge, tasks, name, last))
        rows += [score(case, [frame for _ in batches for frame in next(judged)]) for case in cases]
        outcome.tables["rows"] = rows
        context.save(outcome)
    outcome.claims = _claims(rows)
    outcome.figures = {"chart": _figure(rows)}
    return outcome
