"""What `localize` knows of its own errors: accuracy, coverage and wrong answers, error by error.

Bodies of independent truth (`touches`), each read under every error that sensors and models have in
practice (`reading_errors`), once told to `localize` and once not. A localized contact whose 95 %
interval holds no true place is wrong; shares are of all frames. The price of distrust is charted
too: contacts found, and bad readings believed, over the odds that a reading is bad.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from thigmo.report.axes import BLUE, RED
from thigmo.studies.charts import curves, legend_below, panels
from thigmo.studies.engine import Claim, Context, Outcome, Record, parts, records, share
from thigmo.studies.misfit import of_one_contact
from thigmo.studies.reading_errors import BAD, ERRORS, OTHER_NOISE, Frame, ask
from thigmo.studies.rod import Floats
from thigmo.studies.touches import GROUPS, TOUCHED, Scenes, holds

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Bools = npt.NDArray[np.bool_]

BATCH = 250  # scenes that a process takes at a time: many are drawn faster than few
RESOLVABLE = 5.0  # cm: errors are held against the Cramer-Rao bound where that is smaller
ODDS = (1e-4, 1e-3, 1e-2, 5e-2)


Case = tuple[str, str, bool, float | None]
"""Group, error, whether it is told, and the odds of a bad reading (None: the usual ones)."""


@dataclass(frozen=True)
class Task:
    """A batch of frames of a `Case`."""

    seed: int
    group: str
    error: str
    told: bool
    odds: float | None
    number: int
    size: int


def other_readings_tell(frames: list[Frame]) -> Bools:
    """(F,) whether no contact on the side explains the readings, a bad one among them.

    The best fit of one contact to all of them then has a misfit that noise passes in less than one
    frame in a hundred. All frames are of the same sensors.
    """
    least = of_one_contact(
        np.array([frame.curvature for frame in frames]),
        frames[0].position,
        np.array([frame.free for frame in frames]),
    )
    told: Bools = least > chi2.isf(0.01, frames[0].position.size - 2)
    return told


@cache
def _scenes(seed: int, group: str, number: int, size: int) -> Scenes:
    """The same bodies for every error."""
    return GROUPS[group](np.random.default_rng([seed, *_key(group, number)]), size)


def _key(group: str, number: int) -> tuple[int, int]:
    return tuple(GROUPS).index(group), number


def judge(task: Task) -> Floats:
    """(size, 6) of each frame: found, covered, localized and wrong, squared error, bound, told by.

    A contact is found if it is listed with a probability over one half. The error is NaN where
    there is none to find, or none was found. The last says whether `other_readings_tell` of a bad
    one.
    """
    scenes = _scenes(task.seed, task.group, task.number, task.size)
    error = ERRORS[task.error]
    # The same errors, told or not.
    key = [task.seed, *_key(task.group, task.number), tuple(ERRORS).index(task.error)]
    rng = np.random.default_rng(key)
    odds = {} if task.odds is None else {"bad_reading_odds": task.odds}
    frames = [
        error.spoil(rng, Frame(clean, scenes.position, free, odds))
        for clean, free in zip(scenes.curvature, scenes.free.tolist(), strict=True)
    ]
    out = np.full((task.size, 6), np.nan)
    out[:, 4] = scenes.bound
    # Only bad readings, at the usual odds, are asked about.
    out[:, 5] = other_readings_tell(frames) if task.error in BAD and task.odds is None else 0.0
    for i, frame in enumerate(frames):
        told = error.tell(frame) if task.told and error.tell is not None else {}
        contacts = ask(frame, told).contacts
        arcs = scenes.arcs[i]
        listed = [contact for contact in contacts if contact.probability > 0.5]
        wrong = any(c.status == "localized" and not holds(arcs, c.interval) for c in contacts)
        out[i, [0, 2]] = bool(listed), wrong
        if listed and arcs.size:
            out[i, 1] = any(holds(arcs, contact.interval) for contact in listed)
            out[i, 3] = min((contact.arc - arcs[0]) ** 2 for contact in listed)
    return out


@dataclass(frozen=True)
class Score:
    """Shares of one group's frames under one error.

    Attributes:
        found: frames with a contact of probability over one half.
        covered: of those, intervals that hold the true place.
        wrong: of all frames, localized where nothing is.
        wrong_against_others: likewise of the frames in which the other readings tell of a bad one.
        rmse_over_bound: root mean square of errors over that of bounds, where the bound is small.
    """

    error: str
    group: str
    told: bool
    count: int
    found: float
    covered: float
    wrong: float
    wrong_against_others: float
    rmse_over_bound: float

    @classmethod
    def of(cls, error: str, group: str, told: bool, frames: Floats) -> Score:
        """From the rows of `judge`."""
        found, covered, wrong, off, bound, tells = frames.T
        felt = np.isfinite(off)
        fine = felt & (bound < RESOLVABLE)
        ratio = np.sqrt(off[fine].sum() / (bound[fine] ** 2).sum()) if fine.any() else np.nan
        against_others = share(wrong[tells > 0.5])
        return cls(
            error, group, told, len(frames), share(found), share(covered[felt]), share(wrong),
            against_others, float(ratio),
        )  # fmt: skip


def _claims(scores: list[Score]) -> list[Claim]:
    """The promises: of clean frames, of errors told, of bad readings and of other noise."""
    clean = {s.group: s for s in scores if s.error == "none"}
    limits = {"pressed": 1.15, "bent": 1.2, "peg": 1.2, "corner": 1.0}
    claims = [
        Claim(f"{group}: RMSE over bound", clean[group].rmse_over_bound, most)
        for group, most in limits.items()
    ]
    for group, promised in (("bent", 0.85), ("peg", 0.9)):
        least = promised - 2.0 * np.sqrt(promised * (1.0 - promised) / clean[group].count)
        text = f"{group}: contacts found ({promised:g} within two standard errors)"
        claims.append(Claim(text, clean[group].found, least, at_most=False))
    fair = [s for s in scores if s.told or s.error == "none"]
    told = [s for s in fair if not s.group.startswith("free")]
    told_free = [s for s in fair if s.group.startswith("free")]
    other = [s for s in scores if s.error in OTHER_NOISE]
    covered = [s.covered for s in other if not np.isnan(s.covered)]
    bad = [s.wrong_against_others for s in scores if s.error in BAD]
    return [
        *claims,
        Claim("errors told: least coverage", min(s.covered for s in told), 0.93, at_most=False),
        Claim("errors told: localized and wrong, most", max(s.wrong for s in told), 0.03),
        Claim("errors told: false contacts, most", max(s.found for s in told_free), 0.01),
        Claim("one bad reading that others tell of: localized and wrong", np.nanmax(bad), 0.03),
        Claim("other noise than stated: least coverage", min(covered), 0.9, at_most=False),
        Claim("other noise than stated: localized and wrong", max(s.wrong for s in other), 0.05),
    ]


def _told_figure(scores: list[Score]) -> Figure:
    """Coverage and wrong answers under each error that can be told: told, and not."""
    touched = [s for s in scores if not s.group.startswith("free")]
    pairs = [(s.error, s.group) for s in touched if s.told]
    figure, (left, right) = panels(1, 2, size=(5.5, 0.3 * len(pairs) + 1.4), share=True)
    rows = np.arange(len(pairs))
    for told, color in ((False, RED), (True, BLUE)):
        some = [s for s in touched if s.told == told and (s.error, s.group) in pairs]
        place = rows + (0.2 if told else -0.2)
        left.barh(place, [100 * s.covered for s in some], 0.4, color=color)
        label = "told" if told else "not told"
        right.barh(place, [100 * s.wrong for s in some], 0.4, color=color, label=label)
    left.axvline(95.0, color="black", linewidth=0.8)
    right.axvline(3.0, color="black", linewidth=0.8, label="stated (left), promised (right)")
    names = [error if error.startswith(group) else f"{error}, {group}" for error, group in pairs]
    left.set_yticks(rows, names, fontsize=8)
    left.set(xlabel="intervals that hold the contact (%)", xlim=(40, 100), ylim=(len(pairs), -1))
    right.set_xlabel("localized where nothing is (% of frames)")
    legend_below(figure, panel=1)
    return figure


def _odds_figure(prices: list[Record]) -> Figure:
    """Contacts found, and bad readings believed, over the odds that are passed."""
    figure, axes = panels(1, 2, size=(4.6, 3.6))
    for axis, error, title, what, label in (
        (axes[0], "none", "all readings good", "found", "contacts found (%)"),
        (axes[1], BAD[0], BAD[0], "wrong", "localized where nothing is (%)"),
    ):
        lines = {
            group: [
                (float(price["odds"]), 100 * float(price[what]))
                for price in prices
                if (price["group"], price["error"]) == (group, error)
            ]
            for group in TOUCHED
        }
        curves(
            axis, lines, legend=False, xscale="log", xlabel="odds of a bad reading", ylabel=label,
            title=title,
        )  # fmt: skip
    legend_below(figure)
    return figure


def run(context: Context) -> Outcome:
    """The study: every error on every group, told and not; then the odds of a bad reading."""
    batches = parts(context.count(min(BATCH, 50), 3000), BATCH)  # shares of 1 % to a fifth
    few = batches[: max(1, len(batches) // 5)]

    def score(part: str, some: list[tuple[int, int]], cases: list[Case]) -> list[Score]:
        tasks = [Task(context.seed, *case, *batch) for case in cases for batch in some]
        got = iter(context.map(judge, tasks, part))
        return [
            Score.of(error, group, told, np.concatenate([next(got) for _ in some]))
            for group, error, told, _ in cases
        ]

    outcome = Outcome()
    scores: list[Score] = []
    for name, error in ERRORS.items():
        ways = (False, True) if error.tell else (False,)
        scores += score(
            name, batches, [(g, name, told, None) for g in error.groups for told in ways]
        )
        outcome.tables["rows"] = records(scores)
        context.save(outcome)
    outcome.claims += _claims(scores)
    cases: list[Case] = [
        (group, name, False, odds) for odds in ODDS for group in TOUCHED for name in ("none", *BAD)
    ]
    priced = zip(cases, score("odds of a bad reading", few, cases), strict=True)
    prices: list[Record] = [
        {
            "odds": odds or 0.0, "group": s.group, "error": s.error, "found": s.found,
            "wrong": s.wrong, "covered": s.covered,
        }
        for (*_, odds), s in priced
    ]  # fmt: skip
    outcome.tables["odds"] = prices
    outcome.figures |= {"told": _told_figure(scores), "odds": _odds_figure(prices)}
    return outcome
