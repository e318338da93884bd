"""The sensitivity study: noise x sensors x norm, for the thesis's solver and for exact ones.

Without noise, the thesis needs five readings with the 1-norm and two or three with the 2-norm
(chapter 4). The question is whether the norm or the solver sets that limit. The thesis's solver is
run with both norms. It starts at the tip and moves away only where the objective is smooth; with
few sensors, the kinks of the 1-norm stop it. The exact minimum of the 1-norm has no such limit.
"""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from thigmo_bench.studies import charts
from thigmo_bench.studies.attempt import mean_and_failures
from thigmo_bench.studies.engine import Claim, Context, Outcome
from thigmo_bench.studies.rod import Floats
from thigmo_bench.studies.scenes import CRITICAL, LENGTH, Case, read, side_of
from thigmo_bench.studies.stability import DEFAULT, Stress, errors_of, tabulate

_OURS = "posterior (default)"
METHODS = {
    "alternating": "thesis's solver (1-norm)",
    "alternating-2-norm": "thesis's solver (2-norm)",
    "l1": "exact 1-norm",
    "l2": "exact 2-norm",
    DEFAULT: _OURS,
}
# The thesis "is able to perform minimization" from this number of sensors on: mean error below.
_WORKS_CM = 2.0


def _draw(rng: np.random.Generator, noise: float, sensors: float) -> tuple[Case, float]:
    """A contact between 60 % of the length and the tip, with 0.7 of the moment that folds the base.

    Sensors are spread evenly from 5 to 45 cm, one at each place, so that two of them already span
    the body. Two or three sensors all lie before the contact; otherwise no method could place it.
    """
    arc = float(rng.uniform(0.6 * LENGTH, LENGTH))
    where = np.linspace(5.0, 45.0, int(sensors)) * (
        min(1.0, (arc - 4.0) / 45.0) if sensors < 4 else 1.0
    )
    force = 0.7 * CRITICAL / arc * side_of(rng)
    return read(rng, (arc,), (force,), position=where, sigma=noise), max(noise, 1e-5)


STUDY = Stress(
    "cells", _draw, "noise", (0.0, 1e-4, 6e-4), "sensors", (2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0),
    tuple(METHODS),
)  # fmt: skip


def run(trials: int, context: Context) -> Outcome:
    """Run the trials of each cell; they show whether the solver or the norm sets the limit."""
    errors = errors_of(context, STUDY, trials)
    means = {
        name: np.array([[mean_and_failures(cell)[0] for cell in row] for row in errors[..., m]])
        for m, name in enumerate(METHODS.values())
    }
    promised = (("exact 1-norm", 2), ("exact 1-norm", 3), ("exact 2-norm", 2), (_OURS, 2))
    return Outcome(
        {STUDY.name: tabulate(STUDY, errors)},
        {"sensitivity": _figure(means)},
        [
            Claim(
                f"without noise, {sensors} sensors: "
                f"{'default method' if name == _OURS else name}, mean error",
                float(means[name][0, STUDY.columns.index(sensors)]), 1.0, unit="cm",
            )
            for name, sensors in promised
        ],
        [_remark(name, mean[0]) for name, mean in means.items()],
    )  # fmt: skip


def _remark(name: str, quiet: Floats) -> str:
    """How many sensors a method needs without noise, and its errors."""
    failing = [n for n, mean in zip(STUDY.columns, quiet, strict=True) if not mean <= _WORKS_CM]
    works = [n for n in STUDY.columns if n > max(failing, default=0)]
    start = f"from {works[0]:g} sensors on" if works else "with no number of them"
    errors = ", ".join(f"{m:.2g} ({n:g})" for n, m in zip(STUDY.columns, quiet, strict=True))
    return (
        f"{name}, without noise: mean error below {_WORKS_CM:g} cm {start}; cm (sensors): {errors}"
    )


def _figure(means: dict[str, Floats]) -> Figure:
    """Mean error against the number of sensors, with a panel for each noise."""
    figure, axes = charts.panels(
        1, len(STUDY.rows), size=(3.2, 4.4), share=True,
        title="Sensitivity to noise, sensors and norm (dotted: the thesis's limit of five)",
    )  # fmt: skip
    for r, (axis, noise) in enumerate(zip(axes, STUDY.rows, strict=True)):
        series = {
            name: zip(STUDY.columns, np.maximum(mean[r], 1e-3), strict=True)
            for name, mean in means.items()
        }
        words = {"xlabel": "number of sensors", "title": f"noise {noise:g} 1/cm"}
        charts.curves(axis, series, yscale="log", xticks=STUDY.columns, **words)
        axis.axvline(5, color="gray", linestyle=":", linewidth=1)
    axes[0].set_ylabel("mean error of the arc (cm)")
    charts.legend_below(figure)
    return figure
