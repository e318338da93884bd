"""Accuracy, coverage and wrong answers of `localize` under each kind of error.

Truth is independent (`contact_scenes`). Each body is read under every error that sensors and models
have in practice (`ERRORS`), once stated to `localize` and once not. A localized contact is wrong if
its 95 % interval contains no true place; their share is given of all frames, and of those with a
localized contact. A further chart shows contacts found and bad readings believed over the prior
odds that a reading is bad.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import chi2

from thigmo.display.axes import BLUE, RED
from thigmo.localization import LocalizeResult, localize
from thigmo_bench.studies import contact_scenes
from thigmo_bench.studies.charts import curves, legend_below, panels
from thigmo_bench.studies.contact_scenes import BENT, GROUPS, TOUCHED, Scenes, holds
from thigmo_bench.studies.engine import Claim, Context, Outcome, last, parts, share
from thigmo_bench.studies.rod import Floats, solve
from thigmo_bench.studies.scenes import LENGTH, ROBOT, SIGMA, SPAN

BATCH = 250  # scenes in one task: large batches are drawn faster
RESOLVABLE = 5.0  # cm: errors are compared with Cramer-Rao bounds below this
ODDS = (1e-4, 1e-3, 1e-2, 5e-2)
OFFSET = 5e-4  # 1/cm: 2 % of the actuator map's full scale
STEP = 1.6e-3  # 1/cm: one count of the converter


@dataclass(frozen=True)
class Frame:
    """Readings (N,) of one body, and the arguments of `localize` for them."""

    curvature: Floats
    position: Floats
    free: float
    stated: dict[str, Any]


def _noise(rng: np.random.Generator, size: int) -> Floats:
    return SIGMA * rng.standard_normal(size)


@dataclass(frozen=True)
class Error:
    """One kind of error: how it changes a frame, and how it is stated to `localize`."""

    # keyword arguments of `localize`, from the frame; None if it cannot be stated
    tell: Callable[[Frame], dict[str, Any]] | None = None
    # changes a frame without noise
    clean: Callable[[np.random.Generator, Frame], Frame] = lambda rng, frame: frame
    # draws noise of a number of readings
    noise: Callable[[np.random.Generator, int], Floats] = _noise
    # changes readings with noise
    read: Callable[[np.random.Generator, Floats], Floats] = lambda rng, readings: readings
    # groups of scenes that it is applied to
    groups: tuple[str, ...] = (*TOUCHED, "free", "free, bent")

    def spoil(self, rng: np.random.Generator, frame: Frame) -> Frame:
        """The frame with this error and noise."""
        frame = self.clean(rng, frame)
        noisy = frame.curvature + self.noise(rng, frame.curvature.size)
        return replace(frame, curvature=self.read(rng, noisy))


def _gains(size: float) -> Error:
    def clean(rng: np.random.Generator, frame: Frame) -> Frame:
        gains = 1.0 + size * rng.standard_normal(frame.curvature.size)
        return replace(frame, curvature=frame.curvature * gains)

    return Error(lambda frame: {"gain_error": size}, clean)


def _map(size: float) -> Error:
    def clean(rng: np.random.Generator, frame: Frame) -> Frame:
        return replace(frame, free=frame.free / (1.0 + size * rng.standard_normal()))

    return Error(lambda frame: {"map_error": size}, clean, groups=(*BENT, "free, bent"))


def _offset(rng: np.random.Generator, frame: Frame) -> Frame:
    return replace(frame, curvature=frame.curvature + OFFSET * rng.standard_normal())


def _bad(offset: float | None) -> Error:
    """One reading is off by `offset`; with None, it is always zero."""

    def read(rng: np.random.Generator, readings: Floats) -> Floats:
        index = rng.integers(readings.size)
        sign = rng.choice([-1.0, 1.0])
        readings[index] = 0.0 if offset is None else readings[index] + sign * offset
        return readings

    return Error(read=read)


def _tell_friction(frame: Frame) -> dict[str, Any]:
    """A column of `shared_errors`: the effect of friction at the contact found without it."""
    plain = ask(frame, {})
    if len(plain.contacts) != 1:
        return {}
    (contact,) = plain.contacts
    arc, force = np.array([[contact.arc]]), np.array([[contact.force]])
    body: dict[str, Any] = {"length": LENGTH, "free_curvature": frame.free}
    load = contact_scenes.rubbing(force, np.sqrt(np.mean(np.square(contact_scenes.FRICTION))))
    rough, smooth = solve(arc, force, **body, **load), solve(arc, force, **body)
    change = rough.readings(frame.position, SPAN) - smooth.readings(frame.position, SPAN)
    return {"shared_errors": change.T}


def _tell_uneven(frame: Frame) -> dict[str, Any]:
    """Columns of `shared_errors`: the bend under each sensor times each shape of the softness."""
    phase = contact_scenes.WAVES * frame.position
    shapes = contact_scenes.SOFTNESS * np.concatenate([np.cos(phase), np.sin(phase)])
    return {"shared_errors": (shapes * (frame.curvature - frame.free)).T}


ERRORS: dict[str, Error] = {
    "none": Error(groups=tuple(GROUPS)[:6]),
    **{f"gains {percent} %": _gains(percent / 100) for percent in (3, 5, 10)},
    **{f"map {percent} %": _map(percent / 100) for percent in (5, 10)},
    "offset": Error(lambda frame: {"offset_error": OFFSET}, _offset),
    "friction": Error(_tell_friction, groups=("friction",)),
    "stiffness 20 %": Error(_tell_uneven, groups=("uneven",)),
    "one reading 2e-3 off": _bad(2e-3),
    "one reading 8e-3 off": _bad(8e-3),
    "one reading stuck": _bad(None),
    "Student's noise": Error(noise=lambda rng, n: SIGMA * rng.standard_t(4.0, n) / np.sqrt(2.0)),
    "noise twice stated": Error(noise=lambda rng, n: 2.0 * _noise(rng, n)),
    "noise half stated": Error(noise=lambda rng, n: 0.5 * _noise(rng, n)),
    "counts": Error(read=lambda rng, readings: np.round(readings / STEP) * STEP),
}
BAD = ("one reading 2e-3 off", "one reading 8e-3 off", "one reading stuck")
OTHER_NOISE = ("Student's noise", "noise twice stated", "noise half stated", "counts")


def ask(frame: Frame, stated: dict[str, Any]) -> LocalizeResult:
    """The answer of `localize` with these options in addition to the usual ones."""
    return localize(
        frame.curvature, frame.position, length=LENGTH, span=SPAN, free_curvature=frame.free,
        noise=SIGMA, **(ROBOT | frame.stated | stated),
    )  # fmt: skip


class Case(NamedTuple):
    """Group, error, whether it is stated, and the odds of a bad reading (None: the usual ones)."""

    group: str
    error: str
    stated: bool = False
    odds: float | None = None


Row = dict[str, Any]
"""A group's frames under an error.

    found: share of frames with a contact of probability over one half.
    covered: of those, intervals that hold the true place.
    localized: of all frames, with a localized contact.
    wrong: of all frames, localized where nothing is.
    wrong_of_localized: likewise, of the frames with a localized contact.
    wrong_against_others: likewise of the frames in which the other readings tell of a bad one.
    rmse_over_bound: root mean square of errors over that of bounds, where the bound is small.
"""


def other_readings_tell(frames: list[Frame]) -> NDArray[np.bool_]:
    """(F,) whether one contact fits all readings of a frame poorly, the bad one included.

    Its misfit is then larger than noise gives in one of a hundred frames. All frames must have the
    same sensors.
    """
    position = frames[0].position
    curvature, free = [frame.curvature for frame in frames], [frame.free for frame in frames]
    misfit = contact_scenes.misfit_of_one_contact(np.array(curvature), position, np.array(free))
    return np.greater(misfit, chi2.isf(0.01, position.size - 2))


@cache
def _scenes(seed: int, group: str, number: int, size: int) -> Scenes:
    """The same bodies for every error."""
    key = [seed, tuple(GROUPS).index(group), number]
    return GROUPS[group](np.random.default_rng(key), size)


def judge(task: tuple[Case, int, int, int]) -> Floats:
    """Answer a batch of frames; a task is a case with the batch's seed, number and size.

    A contact is found if it is listed with a probability over one half. The error is NaN if there
    is no contact, or none was found.

    Returns:
        (size, 7) for each frame: found, covered, localized and wrong, squared error, bound,
        `other_readings_tell`, and localized.
    """
    case, seed, number, size = task
    scenes, error = _scenes(seed, case.group, number, size), ERRORS[case.error]
    # The same errors, stated or not.
    key = [seed, tuple(GROUPS).index(case.group), number, tuple(ERRORS).index(case.error)]
    rng = np.random.default_rng(key)
    odds = {} if case.odds is None else {"bad_reading_odds": case.odds}
    frames = [
        error.spoil(rng, Frame(clean, scenes.position, free, odds))
        for clean, free in zip(scenes.curvature, scenes.free.tolist(), strict=True)
    ]
    out = np.full((size, 7), np.nan)
    out[:, 4] = scenes.bound
    # Only needed for bad readings at the usual odds.
    out[:, 5] = other_readings_tell(frames) if case.error in BAD and case.odds is None else 0.0
    for i, (frame, arcs) in enumerate(zip(frames, scenes.arcs, strict=True)):
        contacts = ask(frame, error.tell(frame) if case.stated and error.tell else {}).contacts
        listed = [contact for contact in contacts if contact.probability > 0.5]
        placed = [contact for contact in contacts if contact.status == "localized"]
        wrong = any(not holds(arcs, contact.interval) for contact in placed)
        out[i, [0, 2, 6]] = bool(listed), wrong, bool(placed)
        if listed and arcs.size:
            out[i, 1] = any(holds(arcs, contact.interval) for contact in listed)
            out[i, 3] = min((contact.arc - arcs[0]) ** 2 for contact in listed)
    return out


def score(case: Case, frames: Floats) -> Row:
    """The row of a case, from the frames (n, 7) of `judge`."""
    listed, covered, wrong, squared_error, bound, tells, localized = frames.T
    answered = np.isfinite(squared_error)
    resolvable = answered & (bound < RESOLVABLE)
    ratio = (
        np.sqrt(squared_error[resolvable].sum() / (bound[resolvable] ** 2).sum())
        if resolvable.any()
        else np.nan
    )
    return {
        "error": case.error, "group": case.group, "stated": case.stated, "count": len(frames),
        "found": share(listed), "covered": share(covered[answered]), "localized": share(localized),
        "wrong": share(wrong), "wrong_of_localized": share(wrong[localized > 0.5]),
        "wrong_against_others": share(wrong[tells > 0.5]), "rmse_over_bound": float(ratio),
    }  # fmt: skip


def _claims(rows: list[Row]) -> list[Claim]:
    """Promises for clean frames, stated errors, bad readings and other noise."""
    clean = {row["group"]: row for row in rows if row["error"] == "none"}
    limits = {"pressed": 1.15, "bent": 1.2, "peg": 1.2, "corner": 1.0}
    claims = [
        Claim(f"{group}: RMSE over bound", clean[group]["rmse_over_bound"], limit)
        for group, limit in limits.items()
    ]
    for group, promised in (("bent", 0.85), ("peg", 0.9)):
        lower_limit = promised - 2.0 * np.sqrt(promised * (1.0 - promised) / clean[group]["count"])
        text = f"{group}: contacts found ({promised:g} within two standard errors)"
        claims.append(Claim(text, clean[group]["found"], lower_limit, at_most=False))
    fair = [row for row in rows if row["stated"] or row["error"] == "none"]
    stated = [row for row in fair if not row["group"].startswith("free")]
    free = [row["found"] for row in fair if row["group"].startswith("free")]
    other_noise = [row for row in rows if row["error"] in OTHER_NOISE]
    bad = [row["wrong_against_others"] for row in rows if row["error"] in BAD]
    return [
        *claims,
        Claim("errors stated: least coverage", min(row["covered"] for row in stated), 0.93, False),
        Claim("errors stated: localized and wrong, most", max(r["wrong"] for r in stated), 0.03),
        Claim("errors stated: false contacts, most", max(free), 0.01),
        Claim("one bad reading that others contradict: localized and wrong", np.nanmax(bad), 0.03),
        Claim("other noise than stated: least coverage",
              np.nanmin([row["covered"] for row in other_noise]), 0.9, False),
        Claim("other noise than stated: localized and wrong",
              max(row["wrong"] for row in other_noise), 0.04),
    ]  # fmt: skip


def _stated_figure(rows: list[Row]) -> Figure:
    """Coverage and wrong answers under each error that can be stated: stated, and not."""
    lines = {(row["error"], row["group"], row["stated"]): row for row in rows}
    pairs = [(e, g) for e, g, stated in lines if stated and not g.startswith("free")]
    figure, (first, second, third) = panels(
        1, 3, size=(3.7, 0.3 * len(pairs) + 1.4), share=True,
        title="What stating an error is worth: coverage, and contacts localized where nothing is",
    )  # fmt: skip
    positions = np.arange(len(pairs))
    for label, color, place in (
        ("not stated", RED, positions - 0.2),
        ("stated", BLUE, positions + 0.2),
    ):
        selected = [lines[*pair, label == "stated"] for pair in pairs]
        first.barh(place, [100 * row["covered"] for row in selected], 0.4, color=color)
        second.barh(place, [100 * row["wrong"] for row in selected], 0.4, color=color, label=label)
        third.barh(place, [100 * row["wrong_of_localized"] for row in selected], 0.4, color=color)
    first.axvline(95.0, color="black", linewidth=0.8)
    second.axvline(3.0, color="black", linewidth=0.8, label="stated, and promised")
    names = [error if error.startswith(group) else f"{error}, {group}" for error, group in pairs]
    first.set_yticks(positions, names, fontsize=8)
    first.set(xlabel="intervals that hold the contact (%)", xlim=(40, 100), ylim=(len(pairs), -1))
    second.set_xlabel("localized where nothing is (% of frames)")
    third.set_xlabel("the same (% of localized)")
    legend_below(figure, second)
    return figure


def _odds_figure(prices: list[Row]) -> Figure:
    """Contacts found, and bad readings believed, over the odds that are passed."""
    figure, axes = panels(
        1, 3, size=(3.1, 3.0),
        title="Odds of a bad reading: what stating them costs (left) and prevents (middle, right)",
    )  # fmt: skip
    for axis, error, title, column, label in (
        (axes[0], "none", "all readings good", "found", "contacts found (%)"),
        (axes[1], BAD[0], BAD[0], "wrong", "localized where nothing is (% of frames)"),
        (axes[2], BAD[0], BAD[0], "wrong_of_localized", "the same (% of localized)"),
    ):
        lines: dict[str, list[tuple[float, float]]] = {group: [] for group in TOUCHED}
        for price in prices:
            if price["error"] == error:
                lines[price["group"]].append((price["odds"], 100 * price[column]))
        curves(axis, lines, xscale="log", xlabel="odds of a bad reading", ylabel=label, title=title)
    legend_below(figure)
    return figure


def run(context: Context) -> Outcome:
    """The study: every error on every group, stated and not; then the odds of a bad reading."""
    batches = parts(context.count(min(BATCH, 50), 3000), BATCH)  # shares of 1 % to a fifth
    fewer_batches = batches[: max(1, len(batches) // 5)]

    def scored(part: str, part_batches: list[tuple[int, int]], cases: list[Case]) -> list[Row]:
        tasks = [(case, context.seed, *batch) for case in cases for batch in part_batches]
        results = iter(context.map(judge, tasks, part, last))
        return [
            score(case, np.concatenate([next(results) for _ in part_batches])) for case in cases
        ]

    outcome = Outcome()
    rows: list[Row] = []
    for name, error in ERRORS.items():
        statements = (False, True) if error.tell else (False,)
        rows += scored(
            name, batches, [Case(g, name, stated) for g in error.groups for stated in statements]
        )
        outcome.tables["rows"] = rows
        context.save(outcome)
    cases = [Case(g, e, odds=o) for o in ODDS for g in TOUCHED for e in ("none", *BAD)]
    priced = zip(cases, scored("odds of a bad reading", fewer_batches, cases), strict=True)
    columns = ("group", "error", "found", "wrong", "wrong_of_localized", "covered")
    prices = [
        {"odds": case.odds} | {column: row[column] for column in columns} for case, row in priced
    ]
    outcome.tables["odds"] = prices
    outcome.claims = _claims(rows)
    outcome.figures = {"stated": _stated_figure(rows), "odds": _odds_figure(prices)}
    return outcome
