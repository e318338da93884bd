"""The emulated robot's free constants, fitted once to the thesis's section 3.2, then frozen.

The thesis's own solver (`alternating`, and its clamped and coupled variants) is run on simulated
robots, and the four constants are moved until its errors are the thesis's: four means and four
spreads, each weighted by what five trials at three places leave uncertain. Sections 3.3 to 3.5 are
not looked at: with the constants frozen they are predictions.
`thigmo experiment fit --seed 0` repeats this and writes a new `constants.json` into its --out.

The places come out 2 cm uncertain. The thesis states no centres, and a sensor of 5.5 cm can lie up
to 2.25 cm off the middle of its pouch of 10 cm.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from importlib.resources import files
from typing import Any

import numpy as np

from thigmo.studies.experiments import thesis
from thigmo.studies.experiments.compare import camera_errors, thesis_method
from thigmo.studies.experiments.conditions import simulated
from thigmo.studies.experiments.specimen import Constants, Specimen
from thigmo.studies.rod import Floats

# Rows of section 3.2 and the solver that made each.
ROWS: dict[str, tuple[str, str]] = {
    "high force": ("high force", "alternating"),
    "low force": ("low force", "alternating"),
    "high force, base clamped": ("high force", "clamped"),
    "high force, coupled": ("high force", "coupled"),
}
_START = Constants(noise=5e-4, gain_spread=0.05, position_cm=0.3, fold_rad=0.15)
_LOW = np.array([5e-5, 0.0, 0.0, 0.0])
_ROBOTS, _EVALUATIONS = 12, 400
_HIGH = np.array([2e-3, 0.2, 3.0, 0.5])


def frozen() -> Constants:
    """The constants that the experiments use."""
    stored = json.loads(files("thigmo.studies.experiments").joinpath("constants.json").read_text())
    return Constants(**stored["constants"])


def table(constants: Constants, robots: int, seed: int = 0) -> dict[str, tuple[float, float]]:
    """Mean over robots of each row's mean error and of its spread over the trials (cm).

    Errors are |a - x of the obstacle|, the thesis's measure.
    """
    found: dict[str, list[tuple[float, float]]] = {row: [] for row in ROWS}
    for robot in range(robots):
        rng = np.random.default_rng([seed, robot])
        trials = simulated("single-contact", Specimen(constants, rng), thesis.TRIALS, rng)
        for row, (condition, method) in ROWS.items():
            mine = [trial for trial in trials if trial.condition == condition]
            errors = [camera_errors(t, thesis_method(t, method))[0] for t in mine]
            found[row].append((float(np.mean(errors)), float(np.std(errors))))
    return {row: tuple(np.mean(each, axis=0).tolist()) for row, each in found.items()}


def misfit(found: dict[str, tuple[float, float]]) -> float:
    """Sum of squared deviations from the thesis in units of its own uncertainty."""
    total = 0.0
    readings = thesis.TRIALS * len(thesis.SINGLE_ARCS_CM)
    for row, (mean, spread) in found.items():
        told = thesis.RESULTS["single-contact", row]
        total += ((mean - told.mean_cm) / (told.std_cm / np.sqrt(readings))) ** 2
        # A standard deviation of n readings is known to 1 / sqrt(2 n - 2) of itself.
        total += (np.log(max(spread, 1e-3) / told.std_cm) * np.sqrt(2 * readings - 2)) ** 2
    return float(total)


def fit(
    *,
    seed: int = 0,
    progress: Callable[[str, int, int], None] = lambda part, done, total: None,
) -> dict[str, Any]:
    """Find the constants: a random search, then a pattern search around its best, common noise.

    Two thirds of the evaluations go to the random search.

    Returns:
        What `constants.json` holds: the constants, the table that they give, how well it agrees.
    """
    rng = np.random.default_rng(seed)
    best, least, done = np.array(list(asdict(_START).values())), np.inf, 0

    def better(trial: Floats) -> bool:
        nonlocal best, least, done
        value = misfit(table(Constants(*trial), _ROBOTS, seed))
        done += 1
        progress("constants tried", min(done, _EVALUATIONS), _EVALUATIONS)
        if value >= least:
            return False
        best, least = trial, value
        return True

    better(best)
    while done < 2 * _EVALUATIONS // 3:
        # Squared, so that small constants, the likelier ones, are tried more often.
        better(_LOW + (_HIGH - _LOW) * rng.random(4) ** 2)
    step = 0.15 * (_HIGH - _LOW)
    while done < _EVALUATIONS:
        moves = [sign * step * (np.arange(4) == axis) for axis in range(4) for sign in (-1, 1)]
        if not any([better(np.clip(best + move, _LOW, _HIGH)) for move in moves]):  # noqa: C419
            step *= 0.5
    constants = Constants(*(float(f"{value:.3g}") for value in best))
    # Fresh robots, so that the reported agreement is not the search's own luck.
    check = table(constants, 4 * _ROBOTS, seed + 1)
    return {
        "made_by": f"thigmo experiment fit --seed {seed}",
        "constants": asdict(constants),
        "table_cm": {row: {"mean": m, "std": s} for row, (m, s) in check.items()},
        "misfit": misfit(check),
    }
