"""What `localize` knows of its own errors: accuracy, coverage and wrong answers, error by error.

Bodies of independent truth (`touches`), each read under every error that sensors and models have in
practice (`reading_errors`), once told to `localize` and once not. A localized contact whose 95 %
interval holds no true place is wrong; shares are of all frames. The price of distrust is charted
too: contacts found, and bad readings believed, over the odds that a reading is bad.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from thigmo.report.axes import BLUE, RED
from thigmo.studies.charts import curves, legend_below, panels
from thigmo.studies.engine import Cell, Claim, Context, Outcome, Table
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


@dataclass(frozen=True)
class Task:
    """A batch of frames: one group, one error, told or not, at given odds of a bad reading."""

    seed: int
    group: str
    error: str
    told: bool
    number: int
    size: int
    odds: float | None = None


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
        ratio: root mean square of errors over that of bounds, where the bound is small.
    """

    count: int
    found: float
    covered: float
    wrong: float
    wrong_against_others: float
    ratio: float

    @classmethod
    def of(cls, frames: Floats) -> Score:
        """From the rows of `judge`."""
        found, covered, wrong, error, bound, tells = frames.T
        felt = np.isfinite(error)
        fine = felt & (bound < RESOLVABLE)
        return cls(
            len(frames),
            float(found.mean()),
            float(covered[felt].mean()) if felt.any() else float("nan"),
            float(wrong.mean()),
            float(wrong[tells > 0.5].mean()) if (tells > 0.5).any() else float("nan"),
            float(np.sqrt(error[fine].sum() / (bound[fine] ** 2).sum())) if fine.any() else np.nan,
        )


def _claims(scores: dict[tuple[str, str, bool], Score]) -> list[Claim]:
    """The promises: of clean frames, of errors told, of bad readings and of other noise."""
    clean = {group: scores[group, "none", False] for group in ERRORS["none"].groups}
    limits = {"pressed": 1.15, "bent": 1.2, "peg": 1.2, "corner": 1.0}
    claims = [Claim(f"{g}: RMSE over bound", clean[g].ratio, most) for g, most in limits.items()]
    for group, share in (("bent", 0.85), ("peg", 0.9)):
        least = share - 2.0 * np.sqrt(share * (1.0 - share) / clean[group].count)
        text = f"{group}: contacts found ({share:g} within two standard errors)"
        claims.append(Claim(text, clean[group].found, least, at_most=False))
    told = [
        score
        for (group, error, is_told), score in scores.items()
        if group not in ("free", "free, bent") and (is_told or error == "none")
    ]
    told_free = [
        score
        for (group, error, is_told), score in scores.items()
        if group in ("free", "free, bent") and (is_told or error == "none")
    ]
    other = [s for (_, error, _), s in scores.items() if error in OTHER_NOISE]
    bad = [s.wrong_against_others for (_, error, _), s in scores.items() if error in BAD]
    return [
        *claims,
        Claim("errors told: least coverage", min(s.covered for s in told), 0.93, at_most=False),
        Claim("errors told: localized and wrong, most", max(s.wrong for s in told), 0.03),
        Claim("errors told: false contacts, most", max(s.found for s in told_free), 0.01),
        Claim("one bad reading that others tell of: localized and wrong", np.nanmax(bad), 0.03),
        Claim(
            "other noise than stated: least coverage",
            min(s.covered for s in other if not np.isnan(s.covered)),
            0.9,
            at_most=False,
        ),
        Claim("other noise than stated: localized and wrong", max(s.wrong for s in other), 0.05),
    ]


def _told_figure(scores: dict[tuple[str, str, bool], Score]) -> Figure:
    """Coverage and wrong answers under each error that can be told: told, and not."""
    pairs = [(g, error) for g, error, told in scores if told and not g.startswith("free")]
    figure, (left, right) = panels(1, 2, size=(5.5, 0.3 * len(pairs) + 1.4), share=True)
    rows = np.arange(len(pairs))
    for told, color in ((False, RED), (True, BLUE)):
        some = [scores[group, error, told] for group, error in pairs]
        place = rows + (0.2 if told else -0.2)
        left.barh(place, [100 * s.covered for s in some], 0.4, color=color)
        label = "told" if told else "not told"
        right.barh(place, [100 * s.wrong for s in some], 0.4, color=color, label=label)
    left.axvline(95.0, color="black", linewidth=0.8)
    right.axvline(3.0, color="black", linewidth=0.8, label="stated (left), promised (right)")
    names = [error if error.startswith(group) else f"{error}, {group}" for group, error in pairs]
    left.set_yticks(rows, names, fontsize=8)
    left.set(xlabel="intervals that hold the contact (%)", xlim=(40, 100), ylim=(len(pairs), -1))
    right.set_xlabel("localized where nothing is (% of frames)")
    legend_below(figure, panel=1)
    return figure


def _odds_figure(rows: list[tuple[Cell, ...]]) -> Figure:
    """Contacts found, and bad readings believed, over the odds that are passed."""
    figure, (left, right) = panels(1, 2, size=(4.6, 3.6))

    def over_odds(error: str, column: int) -> dict[str, list[tuple[float, float]]]:
        return {
            group: [(float(r[0]), 100 * float(r[column])) for r in rows if r[1:3] == (group, error)]
            for group in TOUCHED
        }

    label, smallest = "odds of a bad reading", BAD[0]
    found = over_odds("none", 3)
    curves(left, found, legend=False, xscale="log", xlabel=label, ylabel="contacts found (%)")
    wrong = "localized where nothing is (%)"
    curves(
        right, over_odds(smallest, 4), legend=False, xscale="log", xlabel=label, ylabel=wrong,
        title=smallest,
    )  # fmt: skip
    left.set_title("all readings good")
    legend_below(figure)
    return figure


def run(context: Context) -> Outcome:
    """The study: every error on every group, told and not; then the odds of a bad reading."""
    full = context.count(min(BATCH, 50), 3000)  # shares of 1 % to a fifth
    parts = [(k, min(BATCH, full - BATCH * k)) for k in range(-(-full // BATCH))]
    outcome = Outcome()
    scores: dict[tuple[str, str, bool], Score] = {}
    names = ("count", "found", "covered", "wrong", "wrong_against_others", "rmse_over_bound")
    columns = ("error", "group", "told", *names)
    rows: list[tuple[Cell, ...]] = []
    outcome.tables.append(Table("rows", columns, rows))
    for name, error in ERRORS.items():
        cases = [
            (group, told)
            for group in error.groups
            for told in ((False, True) if error.tell else (False,))
        ]
        tasks = [Task(context.seed, g, name, told, *part) for g, told in cases for part in parts]
        got = iter(context.map(judge, tasks, name))
        for group, told in cases:
            score = Score.of(np.concatenate([next(got) for _ in parts]))
            scores[group, name, told] = score
            rows.append((name, group, told, *astuple(score)))
        context.save(outcome)
    outcome.claims += _claims(scores)
    prices: list[tuple[Cell, ...]] = []
    cells = [(odds, group, error) for odds in ODDS for group in TOUCHED for error in ("none", *BAD)]
    some = parts[: max(1, len(parts) // 5)]
    tasks = [
        Task(context.seed, g, error, False, *part, odds)
        for odds, g, error in cells
        for part in some
    ]
    got = iter(context.map(judge, tasks, "odds of a bad reading"))
    for odds, group, name in cells:
        score = Score.of(np.concatenate([next(got) for _ in some]))
        prices.append((odds, group, name, score.found, score.wrong, score.covered))
    outcome.tables.append(
        Table("odds", ("odds", "group", "error", "found", "wrong", "covered"), prices)
    )
    outcome.figures["told"] = _told_figure(scores)
    outcome.figures["odds"] = _odds_figure(prices)
    return outcome
