"""Free constants of the simulated robots, fitted once to section 3.2 of the thesis, then frozen.

The thesis's own solver (`alternating`, and its clamped and coupled variants) runs on simulated
robots. The four constants are adjusted until its errors match the thesis's four means and four
spreads, each weighted by its uncertainty after five trials at three places. Sections 3.3 to 3.5 are
not used in the fit, so what the frozen constants give for them is a prediction.
`thigmo experiment fit --seed 0` repeats the fit and writes a new `constants.json` into its --out.

The fit finds that the sensors' places are uncertain by 2 cm. That is plausible: the thesis does not
state their centres, and a sensor of 5.5 cm can lie up to 2.25 cm off the middle of its 10 cm pouch.

`thigmo experiment predictions` shows how well sections 3.3 and 3.4 are predicted, and how much that
depends on each constant: the solver runs with one constant at a time changed by half its value. Two
more quantities are changed, which the thesis does not state and section 3.2 does not determine: the
size of the muscle's map, and an error of the map that the lab uses. Nothing is fitted there.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple, replace
from typing import Any

import numpy as np

from thigmo_bench.experiments import thesis
from thigmo_bench.experiments.compare import camera_errors, thesis_method, workspace_errors
from thigmo_bench.experiments.specimen import Constants, Specimen, emulated_robot, frozen
from thigmo_bench.experiments.trial import STATIC, Trial
from thigmo_bench.studies.engine import Context, Outcome
from thigmo_bench.studies.rod import Floats

# Rows of section 3.2 and the solver that made each.
ROWS: dict[str, tuple[str, str]] = {
    "high force": ("high force", "alternating"),
    "low force": ("low force", "alternating"),
    "high force, base clamped": ("high force", "clamped"),
    "high force, coupled": ("high force", "coupled"),
}
_START = Constants(noise=5e-4, gain_spread=0.05, position_cm=0.3, fold_rad=0.15)
_LOW = np.array([5e-5, 0.0, 0.0, 0.0])
_HIGH = np.array([2e-3, 0.2, 3.0, 0.5])
_ROBOTS, _EVALUATIONS = 12, 400
_MAP_ERROR = 0.03
_WITHIN = 4 / 3  # a prediction within this factor of the thesis's mean is said to hold
_FROZEN = "as fitted"

Setting = tuple[str, Constants, dict[str, Any]]
"""What is changed, the constants, and options of a `Specimen`."""

Cell = dict[str, Any]
"""The thesis's solver on one condition with one constant "changed": mean |a - x of the obstacle|
"camera_cm" (the thesis's own: "thesis_cm"), and mean |x error| in the workspace."""


def table(constants: Constants, robots: int, seed: int = 0) -> dict[str, tuple[float, float]]:
    """Mean error of each row and its spread over the trials, averaged over robots (cm)."""
    errors_by_row: dict[str, list[tuple[float, float]]] = {row: [] for row in ROWS}
    for robot in range(robots):
        specimen = Specimen(constants, np.random.default_rng([seed, robot]))
        trials = specimen.trials("single-contact", thesis.TRIALS)
        for row, (condition, method) in ROWS.items():
            row_trials = [trial for trial in trials if trial.condition == condition]
            errors = [camera_errors(t, thesis_method(t, method))[0] for t in row_trials]
            errors_by_row[row].append((float(np.mean(errors)), float(np.std(errors))))
    return {
        row: tuple(np.mean(per_robot, axis=0).tolist()) for row, per_robot in errors_by_row.items()
    }


def misfit(fitted: dict[str, tuple[float, float]]) -> float:
    """Sum of squared deviations from the thesis's results, in units of their uncertainty."""
    total = 0.0
    readings = thesis.TRIALS * len(thesis.SINGLE_ARCS_CM)
    for row, (mean, spread) in fitted.items():
        thesis_mean, thesis_spread = thesis.RESULTS["single-contact", row]
        total += ((mean - thesis_mean) / (thesis_spread / np.sqrt(readings))) ** 2
        # A standard deviation of n readings is known to 1 / sqrt(2 n - 2) of itself.
        total += (np.log(max(spread, 1e-3) / thesis_spread) * np.sqrt(2 * readings - 2)) ** 2
    return float(total)


def fit(seed: int, progress: Callable[[str, int, int], None]) -> dict[str, Any]:
    """Fit the constants; return them, the table that they give and its misfit, as `constants.json`.

    A random search takes two thirds of the evaluations, and a pattern search around its best point
    takes the rest. All evaluations use the same noise.
    """
    rng = np.random.default_rng(seed)
    best, lowest, count = np.array(astuple(_START)), np.inf, 0

    def improves(trial: Floats) -> bool:
        nonlocal best, lowest, count
        value = misfit(table(Constants(*trial), _ROBOTS, seed))
        count += 1
        progress("constants tried", min(count, _EVALUATIONS), _EVALUATIONS)
        if value >= lowest:
            return False
        best, lowest = trial, value
        return True

    improves(best)
    while count < 2 * _EVALUATIONS // 3:
        # Squared, so that small constants, the likelier ones, are tried more often.
        improves(_LOW + (_HIGH - _LOW) * rng.random(4) ** 2)
    step = 0.15 * (_HIGH - _LOW)
    while count < _EVALUATIONS:
        moves = [sign * step * (np.arange(4) == axis) for axis in range(4) for sign in (-1, 1)]
        if not any([improves(np.clip(best + move, _LOW, _HIGH)) for move in moves]):  # noqa: C419
            step *= 0.5
    constants = Constants(*(float(f"{value:.3g}") for value in best))
    # Fresh robots, so that the reported agreement is not the search's own luck.
    check = table(constants, 4 * _ROBOTS, seed + 1)
    return {
        "made_by": f"thigmo experiment fit --seed {seed}",
        "constants": vars(constants),
        "table_cm": {row: {"mean": m, "std": s} for row, (m, s) in check.items()},
        "misfit": misfit(check),
    }


def predictions(robots: int, trials: int, context: Context) -> Outcome:
    """Results of every setting, over robots that are drawn from the same seed."""
    items = [(setting, robots, trials, context.seed) for setting in _settings()]
    cells = [
        cell
        for of_setting in context.map(_cells, items, "changed constants")
        for cell in of_setting
    ]
    return Outcome({"cells": cells}, notes=remarks(cells))


def _settings() -> Iterator[Setting]:
    fitted = frozen()
    yield _FROZEN, fitted, {}
    for name, value in vars(fitted).items():
        label = name.removesuffix("_cm").removesuffix("_rad").replace("_", " ")
        for word, factor in (("- 50 %", 0.5), ("+ 50 %", 1.5)):
            yield f"{label} {word}", replace(fitted, **{name: factor * value}), {}
    muscle = emulated_robot().muscle("left").maps[-1].inflate
    for word, factor in (("- 25 %", 0.75), ("+ 25 %", 1.25)):
        curve = muscle.model_copy(update={"amplitude": factor * muscle.amplitude})
        yield f"muscle's map {word}", fitted, {"muscle": curve}
    for error in (-_MAP_ERROR, _MAP_ERROR):
        yield f"map believed {error:+.0%}", fitted, {"map_error": error}


def _cells(item: tuple[Setting, int, int, int]) -> list[Cell]:
    """Results of one setting on every row of sections 3.2 to 3.4 that the plain solver produced."""
    (changed, constants, options), robots, trials, seed = item
    trials_of: dict[tuple[str, str], list[Trial]] = defaultdict(list)
    for robot in range(robots):
        specimen = Specimen(constants, np.random.default_rng([seed, robot]), **options)
        for name in STATIC:
            for trial in specimen.trials(name, trials):
                trials_of[name, trial.condition].append(trial)
    cells = []
    for (experiment, condition), row_trials in trials_of.items():
        pairs = [(trial, thesis_method(trial)) for trial in row_trials]
        cells.append({
            "changed": changed,
            "experiment": experiment,
            "condition": condition,
            "thesis_cm": thesis.RESULTS[experiment, condition][0],
            "camera_cm": float(np.mean([camera_errors(*pair) for pair in pairs])),
            "workspace_cm": float(np.mean([workspace_errors(*pair) for pair in pairs])),
        })  # fmt: skip
    return cells


def remarks(cells: Sequence[Cell]) -> list[str]:
    """A sentence for each row: fitted or predicted, how close, and which constant moves it most."""
    lines = []
    for cell in [c for c in cells if c["changed"] == _FROZEN]:
        row, camera = (cell["experiment"], cell["condition"]), cell["camera_cm"]
        changed = [c for c in cells if (c["experiment"], c["condition"]) == row and c is not cell]
        most_sensitive = max(changed, key=lambda c: abs(c["camera_cm"] - camera))
        holds = 1 / _WITHIN <= camera / cell["thesis_cm"] <= _WITHIN
        verdict = "fitted" if row[0] == "single-contact" else "holds" if holds else "FAILS"
        lines.append(
            f"{row[0]}, {row[1]}: thesis {cell['thesis_cm']:.2f} cm, its method here "
            f"{camera:.2f} ({verdict}; in the workspace {cell['workspace_cm']:.2f}); "
            f"moved most by {most_sensitive['changed']}: {most_sensitive['camera_cm']:.2f}"
        )
    return lines
