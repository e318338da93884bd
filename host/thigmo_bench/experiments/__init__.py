"""The thesis's experiments, repeated under the same conditions.

Each table has three columns (the thesis's result, the thesis's method here, our method) and the
Cramer-Rao bound. `trial.py` plans what is pressed where. `specimen.py` computes what a simulated
robot then reads, with the constants that `fit.py` found once. `recorded.py` takes the same trials
with a robot on the bench or with the whole emulator. `evaluate.py` compares the methods on either
kind of trial. `thigmo experiment` calls all of this.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from thigmo_bench.experiments import explorations, fit, sensitivity
from thigmo_bench.experiments.evaluate import evaluate
from thigmo_bench.experiments.specimen import Specimen, frozen
from thigmo_bench.experiments.trial import STATIC, Trial
from thigmo_bench.studies.engine import Context, Outcome

__all__ = ["EXPERIMENTS", "Experiment"]

Experiment = Callable[[int, int, Context], Outcome]
"""Takes the number of robots, each with its own errors, and of trials per condition and robot."""


def _of_robot(item: tuple[str, int, int, int]) -> list[Trial]:
    name, trials, seed, robot = item
    drawn_trials = Specimen(frozen(), np.random.default_rng([seed, robot])).trials(name, trials)
    return [replace(trial, robot=robot) for trial in drawn_trials]


def _static(name: str, robots: int, trials: int, context: Context) -> Outcome:
    """Sections 3.2 to 3.4: trials over freshly drawn robots."""
    items = [(name, trials, context.seed, robot) for robot in range(robots)]
    all_trials = [
        trial for of_robot in context.map(_of_robot, items, "robots") for trial in of_robot
    ]
    return evaluate(name, all_trials, context)


EXPERIMENTS: dict[str, Experiment] = {
    **{name: partial(_static, name) for name in STATIC},
    "predictions": fit.predictions,
    # The emulator's scene has the robot's errors: one run of each protocol for each robot.
    "exploration": lambda robots, trials, context: explorations.run(robots, context),
    "sensitivity": lambda robots, trials, context: sensitivity.run(robots * trials, context),
}
