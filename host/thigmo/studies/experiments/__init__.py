"""The thesis's experiments, repeated: the same conditions, three columns, and the bound.

Robots are simulated with the frozen constants: `plan.py` says what is pressed where,
`specimen.py` what an imperfect robot then reads, `fit.py` how imperfect. `procedure.py` and
`recorded.py` do the same trials with a robot on the bench or the whole emulator. `compare.py` sets
the methods against each other on either. Called by `thigmo experiment`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from thigmo.studies.engine import Context, Outcome
from thigmo.studies.experiments import conditions, explored, figures, predictions, sensitivity
from thigmo.studies.experiments.evaluate import evaluate
from thigmo.studies.experiments.fit import frozen
from thigmo.studies.experiments.plan import STATIC
from thigmo.studies.experiments.specimen import Specimen
from thigmo.studies.experiments.trial import Trial

__all__ = ["EXPERIMENTS", "Experiment"]

Experiment = Callable[[int, int, Context], Outcome]
"""Of so many robots, each built anew, and so many trials a condition and robot."""


def _of_robot(item: tuple[str, int, int, int]) -> list[Trial]:
    name, trials, seed, robot = item
    rng = np.random.default_rng([seed, robot])
    return conditions.simulated(name, Specimen(frozen(), rng), trials, rng)


def _static(name: str) -> Experiment:
    """Sections 3.2 to 3.4: trials over freshly drawn robots."""

    def experiment(robots: int, trials: int, context: Context) -> Outcome:
        items = [(name, trials, context.seed, robot) for robot in range(robots)]
        found = [trial for some in context.map(_of_robot, items, "robots") for trial in some]
        outcome = evaluate(name, found, context)
        if name == "actuated":
            outcome.figures["muscle-map"] = figures.muscle_map(context.seed)
        return outcome

    return experiment


EXPERIMENTS: dict[str, Experiment] = {
    **{name: _static(name) for name in STATIC},
    "predictions": predictions.run,
    # The emulator's own scene says how imperfect its robot is: one run of each protocol a robot.
    "exploration": lambda robots, trials, context: explored.run(robots, context),
    "sensitivity": lambda robots, trials, context: sensitivity.run(robots * trials, context),
}
