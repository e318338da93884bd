"""Speed against accuracy: every method on the same readings, in one run.

A method's time is the median of single calls from Python on one core, and times are compared only
within the run, as ratios, because machines are noisy. Its error is |arc - true arc|, contacts
ordered along the body; an answer without a contact, or more than 10 cm off, is a failure. The scene
that claims rest on has more cases, for errors have long tails: 200 left a ratio of means 7 % of
doubt. Methods that take up to a second a call see every fourth case.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from thigmo.localization import METHODS
from thigmo.localization.exact import one_contact_batch
from thigmo.studies.attempt import attempt, mean_and_failures
from thigmo.studies.baselines import BASELINES
from thigmo.studies.engine import Claim, Context, Outcome, Table
from thigmo.studies.scenes import LENGTH, SCENES, SPAN

if TYPE_CHECKING:
    from matplotlib.figure import Figure


CLAIMED = "one contact"
SLOW = ("alternating-trust-constr", "trust-constr")
EVERY = 4


@dataclass(frozen=True)
class Score:
    """One method's results on one kind of scene."""

    scene: str
    method: str
    cases: int
    mean_cm: float
    standard_error_cm: float  # of the mean
    median_cm: float
    p95_cm: float
    failures: float
    time_us: float
    slower: float  # times the exact method's median time


def _case_scores(task: tuple[str, int, int, tuple[str, ...]]) -> list[tuple[float, float]]:
    """All methods on one case, one after the other, so that all see the same machine.

    Error and time of each; NaN twice for one that is left out here.
    """
    scene, seed, index, methods = task
    case = SCENES[scene](np.random.default_rng([seed, index]))
    skipped = SLOW if index % EVERY else ()
    return [
        (float("nan"), float("nan")) if method in skipped else attempt(case, method)
        for method in methods
    ]


def score(context: Context, scene: str, methods: tuple[str, ...], cases: int) -> list[Score]:
    """Run the methods over random cases of one kind of scene."""
    _case_scores((scene, context.seed, cases, methods))  # compiles; not counted
    tasks = [(scene, context.seed, i, methods) for i in range(cases)]
    rows = context.map(_case_scores, tasks, scene)
    table = np.array(rows)  # (cases, methods, 2)
    exact = float(np.median(table[:, methods.index("exact"), 1]))
    scores = []
    for column, method in enumerate(methods):
        seen = ~np.isnan(table[:, column, 1])
        errors, times = table[seen, column, 0], table[seen, column, 1]
        mean, failures = mean_and_failures(errors)
        some = errors[np.isfinite(errors)] if np.isfinite(mean) else np.array([np.nan])
        scores.append(
            Score(
                scene,
                method,
                len(errors),
                mean,
                float(np.std(some) / np.sqrt(some.size)),
                float(np.median(some)),
                float(np.percentile(some, 95)),
                failures,
                float(np.median(times)),
                float(np.median(times)) / exact,
            )
        )
    return scores


def pareto(scores: list[Score]) -> list[Score]:
    """Methods that no other one beats in both time and mean error, fastest first."""
    front: list[Score] = []
    for candidate in sorted(scores, key=lambda s: (s.time_us, s.mean_cm)):
        if np.isfinite(candidate.mean_cm) and (not front or candidate.mean_cm < front[-1].mean_cm):
            front.append(candidate)
    return front


def chart(scores: list[Score]) -> Figure:
    """Mean error against time, a panel a kind of scene, with the Pareto front."""
    from matplotlib.figure import Figure

    scenes = list(dict.fromkeys(s.scene for s in scores))
    columns = 2 if len(scenes) > 1 else 1
    rows = -(-len(scenes) // columns)
    figure = Figure(figsize=(6.4 * columns, 4.6 * rows), layout="constrained")
    axes = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for axis, scene in zip(axes, scenes, strict=False):
        here = [s for s in scores if s.scene == scene and np.isfinite(s.mean_cm)]
        front = pareto(here)
        axis.plot(
            [s.time_us for s in front],
            [s.mean_cm for s in front],
            color="tab:green",
            linewidth=1.2,
            drawstyle="steps-post",
            zorder=1,
            label="Pareto front",
        )
        for one in here:
            best = one in front
            axis.scatter(
                one.time_us,
                one.mean_cm,
                s=30 + 170 * one.failures,
                color="tab:green" if best else "tab:gray",
                zorder=2,
            )
            axis.annotate(
                one.method,
                (one.time_us, one.mean_cm),
                textcoords="offset points",
                xytext=(6, 4),
                fontsize=8,
                color="black" if best else "dimgray",
            )
        axis.set(
            xscale="log",
            yscale="log",
            title=scene,
            xlabel="median time of one call (us)",
            ylabel="mean error of the arc (cm)",
        )
        # Labels stand to the right of their dots.
        least, most = (f(s.time_us for s in here) for f in (min, max))
        axis.set_xlim(least / 2, most * 12)
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter("{x:g}")
        axis.tick_params(axis="y", which="both", labelsize=7)
        axis.grid(which="both", alpha=0.2)
        axis.legend(loc="upper right", fontsize=8)
    for axis in axes[len(scenes) :]:
        axis.set_axis_off()
    figure.suptitle(
        "Speed against accuracy (dot size: share of failures, no answer or > 10 cm off)"
    )
    return figure


def _batch_us(context: Context) -> float:
    """Time of one reading in a batch of 10 000 exact 1-norm fits, us."""
    cases = [SCENES["one contact"](np.random.default_rng([context.seed, i])) for i in range(1000)]
    rows = np.tile(np.array([case.curvature for case in cases]), (10, 1))
    one_contact_batch(rows[:2], cases[0].position, LENGTH, span=SPAN)
    start = perf_counter()
    one_contact_batch(rows, cases[0].position, LENGTH, span=SPAN)
    return (perf_counter() - start) / len(rows) * 1e6


def run(context: Context) -> Outcome:
    """The study: all methods on all kinds of scene."""
    # The remedies for a folded base differ from the solver behind them only where one folds.
    methods = tuple(m for m in (*METHODS, *BASELINES) if m not in ("clamped", "coupled"))
    scores: list[Score] = []
    table = Table("methods", tuple(Score.__annotations__), [])
    outcome = Outcome([table])
    for scene in SCENES:
        cases = context.count(12, 1000 if scene == CLAIMED else 200)
        scores += score(context, scene, methods, cases)
        table.rows[:] = [tuple(vars(s).values()) for s in scores]
        context.save(outcome)
    outcome.figures["chart"] = chart(scores)
    by_name = {s.method: s for s in scores if s.scene == CLAIMED}
    thesis = by_name["alternating-trust-constr"]
    batch = _batch_us(context)
    outcome.tables.append(
        Table("batch", ("what", "time_us"), [("exact 1-norm, a reading in a batch", batch)])
    )
    outcome.claims = [
        Claim(
            "one contact: exact 1-norm in a batch, times faster than the thesis's alternation "
            "with a general interior point",
            thesis.time_us / batch,
            1000.0,
            at_most=False,
        ),
        Claim(
            "one contact: default method's mean error over the thesis's (general interior point)",
            by_name["exact"].mean_cm / thesis.mean_cm,
            0.5,
        ),
        Claim(
            "one contact: default method's mean error over the thesis's (barrier path, compiled)",
            by_name["exact"].mean_cm / by_name["alternating"].mean_cm,
            0.5,
        ),
    ]
    return outcome
