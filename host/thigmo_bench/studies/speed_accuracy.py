"""Speed against accuracy: every method on the same readings, in one run.

A method's time is the median over the cases of a warm call from Python (`attempt`), in processor
time of one core. Times are compared only within the run, as ratios, because machines are noisy. Its
error is |arc - true arc|, contacts ordered along the body; an answer without a contact, or more
than 10 cm off, is a failure. The scene of the claims has more cases, because errors have long
tails: 400 cases leave a standard error of about 5 % in a ratio of means. Methods that take up to a
second for a call see every fifth case; the default method is compared with each on the cases that
both saw. Every method is given the number of contacts, except for the default method as robots run
it, which is shown without claims.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import nan
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thigmo.display.axes import BLUE, GREEN, ORANGE, RED
from thigmo.localization import METHODS
from thigmo_bench.baselines import BASELINES
from thigmo_bench.studies import charts
from thigmo_bench.studies.attempt import ON_A_ROBOT, attempt, mean_and_failures, mean_over
from thigmo_bench.studies.engine import Claim, Context, Outcome
from thigmo_bench.studies.pegs import any_peg
from thigmo_bench.studies.rod import Floats
from thigmo_bench.studies.scenes import (
    LENGTH,
    Case,
    actuated,
    few_sensors,
    one_contact,
    two_contacts,
)

DEFAULT = METHODS[0]
CLAIMED = "one contact"
SLOW = ("alternating-trust-constr", "trust-constr", "differential-evolution", "dual-annealing")
EVERY = 5
RESAMPLED = 2000
FEWEST = 20  # least number of cases for a bootstrap
SPAN_95 = 2 * 1.96  # standard errors in a 95 % interval
# The remedies for a folded base differ from their solver only if the base folds.
_LEFT_OUT = ("clamped", "coupled", "alternating-2-norm")
COMPARED = (*METHODS, ON_A_ROBOT, *(name for name in BASELINES if name not in _LEFT_OUT))
SCENES: dict[str, Callable[[np.random.Generator], Case]] = {
    "one contact": one_contact,
    "two contacts": two_contacts,
    "actuated, on the side": actuated,
    "actuated, any peg": any_peg,
    "few sensors": few_sensors,
}


Row = dict[str, Any]
"""One method's results on one kind of scene.

    standard_error_cm: standard error of the mean.
    guess_cm: mean error of guessing evenly spaced places.
    slower: median time over the default method's.
    default_over_it: the default method's mean error over this one's on the same cases; `ratio_low`
        and `ratio_high` are its 95 % interval (bootstrap over the cases).
    tie: whether this interval contains 1.
"""


def _case_scores(task: tuple[str, int, int]) -> list[tuple[float, float]]:
    """Error and time of all methods on one case, one after the other, under the same conditions.

    Both are NaN for a method that is omitted.
    """
    scene, seed, index = task
    case = SCENES[scene](np.random.default_rng([seed, index]))
    skipped = SLOW if index % EVERY else ()
    return [(nan, nan) if method in skipped else attempt(case, method) for method in COMPARED]


def score(context: Context, scene: str, cases: int) -> list[Row]:
    """Run the methods over random cases of one kind of scene."""
    _case_scores((scene, context.seed, cases))  # loads packages and trains trees; not counted
    rows = context.map(_case_scores, [(scene, context.seed, i) for i in range(cases)], scene)
    table = np.array(rows)  # (cases, methods, 2)
    default = float(np.median(table[:, 0, 1]))
    guess = guess_cm(
        [SCENES[scene](np.random.default_rng([context.seed, i])) for i in range(cases)]
    )
    scores = []
    for column, method in enumerate(COMPARED):
        run = ~np.isnan(table[:, column, 1])
        errors, times = table[run, column].T
        mean, failures = mean_and_failures(errors)
        answered = errors[np.isfinite(errors)] if np.isfinite(mean) else np.array([nan])
        time_us = float(np.median(times))
        scores.append({
            "scene": scene, "method": method, "cases": len(errors), "mean_cm": mean,
            "standard_error_cm": float(np.std(answered) / np.sqrt(answered.size)),
            "median_cm": float(np.median(answered)), "p95_cm": float(np.percentile(answered, 95)),
            "failures": failures, "time_us": time_us, "slower": time_us / default,
            "guess_cm": guess, **_ratio(table[run, 0, 0], errors),
        })  # fmt: skip
    return scores


def _ratio(ours: Floats, baseline: Floats) -> Row:
    """The default method's mean error over another's on the same cases, with its interval."""
    answered = np.isfinite(ours) & np.isfinite(baseline)
    low = high = nan
    if (count := int(answered.sum())) >= FEWEST:
        drawn = np.random.default_rng(0).integers(0, count, (RESAMPLED, count))
        ratios = ours[answered][drawn].mean(axis=1) / baseline[answered][drawn].mean(axis=1)
        low, high = map(float, np.quantile(ratios, (0.025, 0.975)))
    return {
        "default_over_it": mean_over(ours, baseline), "ratio_low": low, "ratio_high": high,
        "tie": not (low > 1.0 or high < 1.0),
    }  # fmt: skip


def guess_cm(cases: list[Case]) -> float:
    """Mean error of evenly spaced places (the middle for one contact), which need no reading."""
    arcs = np.sort([case.arcs for case in cases], axis=1)
    even = LENGTH * np.arange(1, arcs.shape[1] + 1) / (arcs.shape[1] + 1)
    return float(np.abs(arcs - even).mean())


def pareto(scores: list[Row]) -> list[Row]:
    """Methods that no other one beats in both time and mean error, fastest first.

    The default method as robots run it is not among them: it is the same method with less input.
    """
    front: list[Row] = []
    for row in sorted((s for s in scores if s["method"] != ON_A_ROBOT), key=_point):
        if np.isfinite(row["mean_cm"]) and (not front or row["mean_cm"] < front[-1]["mean_cm"]):
            front.append(row)
    return front


def _point(score: Row) -> tuple[float, float]:
    """A method's point in a panel: time and error."""
    return score["time_us"], score["mean_cm"]


def chart(scores: list[Row]) -> Figure:
    """Mean error against time, a panel a kind of scene, with the Pareto front and all names."""
    scenes = list(dict.fromkeys(s["scene"] for s in scores))
    figure, axes = charts.panels(
        len(scenes) // 2 + 1, 2, size=(6.4, 5.6),
        title=_title(scores, scenes),
    )  # fmt: skip
    rows_by_scene = [
        [s for s in scores if s["scene"] == k and np.isfinite(s["mean_cm"])] for k in scenes
    ]
    for axis, scene, scene_rows in zip(axes, scenes, rows_by_scene, strict=False):
        _draw(axis, scene, scene_rows)
    axes[-1].set_axis_off()  # of five kinds of scene: room for the legend
    axes[-1].legend(*axes[0].get_legend_handles_labels(), loc="center", fontsize=8, frameon=False)
    # Names are placed last, because they keep their places only if nothing moves after them.
    figure.draw_without_rendering()
    for axis, scene_rows in zip(axes, rows_by_scene, strict=False):
        points, front = list(map(_point, scene_rows)), list(map(_point, pareto(scene_rows)))
        charts.named(axis, points, [s["method"] for s in scene_rows], front)
    return figure


def _title(scores: list[Row], scenes: Sequence[str]) -> str:
    """In how many kinds of scene nothing is both faster and nearer than the default method."""
    best = [
        DEFAULT in {row["method"] for row in pareto([s for s in scores if s["scene"] == scene])}
        for scene in scenes
    ]
    return (
        f"In {sum(best)} of {len(best)} kinds of scene no method is both faster and more accurate "
        f"than {DEFAULT}"
    )


def _draw(axis: Axes, scene: str, rows: list[Row]) -> None:
    front, (times, errors) = pareto(rows), np.array(list(map(_point, rows))).T
    axis.plot(
        *zip(*map(_point, front), strict=True), color=GREEN, linewidth=1.2, drawstyle="steps-post",
        zorder=1, label="Pareto front",
    )  # fmt: skip
    axis.axhline(
        rows[0]["guess_cm"], color=RED, linewidth=0.9, linestyle="--", zorder=1,
        label="guessing even places, without a reading",
    )  # fmt: skip
    colors = [
        ORANGE if row["method"] == ON_A_ROBOT
        else GREEN if row in front else BLUE if row["tie"] else "0.5"
        for row in rows
    ]  # fmt: skip
    bars = np.minimum([row["standard_error_cm"] for row in rows], 0.9 * errors)
    axis.errorbar(times, errors, bars, fmt="none", ecolor="0.45", elinewidth=0.8, zorder=2)
    sizes = [10 + 60 * row["failures"] for row in rows]
    axis.scatter(times, errors, s=sizes, color=colors, zorder=2)
    for color, label in (
        (BLUE, f"ties with {DEFAULT} (bootstrap)"),
        (ORANGE, f"{DEFAULT} as robots run it:\nnumber of contacts not given, fold stated"),
    ):
        axis.plot([], [], "o", color=color, markersize=4, label=label)
    axis.plot([], [], "|", color="0.45", markersize=10, label="standard error")
    axis.plot([], [], "o", color="0.5", markersize=7, label="larger: more failures (> 10 cm off)")
    axis.set(
        xscale="log", yscale="log", title=scene, xlabel="median time of one call (µs)",
        ylabel="mean error of the arc (cm)", xlim=(times.min() / 8, times.max() * 40),
    )  # fmt: skip
    axis.yaxis.set_major_formatter("{x:g}")
    axis.yaxis.set_minor_formatter("{x:g}")
    axis.tick_params(axis="y", which="both", labelsize=7)


def run(context: Context) -> Outcome:
    """The study: all methods on all kinds of scene."""
    scores: list[Row] = []
    outcome = Outcome()
    for scene in SCENES:
        scores += score(context, scene, context.count(12, 400 if scene == CLAIMED else 150))
        outcome.tables["methods"] = scores
        context.save(outcome)
    outcome.figures["chart"] = chart(scores)
    one_contact = {s["method"]: s for s in scores if s["scene"] == CLAIMED}
    default, thesis = one_contact[DEFAULT], one_contact["alternating-trust-constr"]
    faster = thesis["time_us"] / default["time_us"]
    text = "times faster than the thesis's alternation with a general interior point"
    outcome.claims = [Claim(f"one contact: default method, {text}", faster, 1000.0, at_most=False)]
    references = {"general interior point": thesis, "barrier path": one_contact["alternating"]}
    for name, reference in references.items():
        text = f"one contact: default method's mean error over the thesis's ({name})"
        outcome.claims.append(Claim(text, default["mean_cm"] / reference["mean_cm"], 0.5))
    on_front = 0
    for scene in SCENES:
        ours, *rivals = scene_scores = [s for s in scores if s["scene"] == scene]
        on_front += ours in pareto(scene_scores)
        rivals = [s for s in rivals if s["method"] != ON_A_ROBOT]
        best = max(rivals, key=lambda s: np.nan_to_num(s["default_over_it"]))
        sure = f"95 %: {best['ratio_low']:.2f} to {best['ratio_high']:.2f}"
        text = f"default method's mean error over that of the best other ({best['method']}"
        text += f", a tie; {sure})" if best["tie"] else f"; {sure})"
        error = (best["ratio_high"] - best["ratio_low"]) / SPAN_95
        claim = Claim(f"{scene}: {text}", best["default_over_it"], 1.0, standard_error=error)
        outcome.claims.append(claim)
    text = "panels where the default method is on the Pareto front"
    outcome.claims.append(Claim(text, on_front, len(SCENES), at_most=False))
    return outcome
