"""The thesis's experiments on simulated robots: trials, three columns, figures.

Called by `thigmo experiment`. Robots are simulated with the frozen constants (`fit.py`); the
exploration comes from whole explorations on the emulator (`explored.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from thigmo.studies.engine import Context, Table
from thigmo.studies.experiments import conditions, explored, flow, muscle, predictions, sensitivity
from thigmo.studies.experiments.evaluate import Results, evaluate, save
from thigmo.studies.experiments.fit import frozen
from thigmo.studies.experiments.specimen import Constants, Specimen
from thigmo.studies.experiments.trial import Trial

Draw = Callable[[Specimen, int, np.random.Generator], list[Trial]]


def collect(
    draw: Draw, constants: Constants, robots: int, trials: int, context: Context
) -> list[Trial]:
    """Trials of an experiment over freshly drawn robots."""
    items = [(draw, constants, trials, context.seed, robot) for robot in range(robots)]
    return [trial for found in context.map(_of_robot, items, "robots") for trial in found]


def _of_robot(item: tuple[Draw, Constants, int, int, int]) -> list[Trial]:
    draw, constants, trials, seed, robot = item
    rng = np.random.default_rng([seed, robot])
    return draw(Specimen(constants, rng), trials, rng)


def single_contact(robots: int, trials: int, context: Context) -> Results:
    """Section 3.2, with the clamped and the coupled solver."""
    found = collect(conditions.single_contact, frozen(), robots, trials, context)
    return evaluate("single-contact", found, context)


def two_contacts(robots: int, trials: int, context: Context) -> Results:
    """Section 3.3."""
    found = collect(conditions.two_contacts, frozen(), robots, trials, context)
    return evaluate("two-contacts", found, context)


def _bent(specimen: Specimen, trials: int, _: np.random.Generator) -> list[Trial]:
    return conditions.actuated(specimen, trials)


def actuated(robots: int, trials: int, context: Context) -> Results:
    """Section 3.4, and the muscle's map (figure 2.4c)."""
    results = evaluate("actuated", collect(_bent, frozen(), robots, trials, context), context)
    results.figures["muscle-map"] = muscle.figure(context.seed)
    return results


def predicted(robots: int, trials: int, context: Context) -> Results:
    """How well the frozen constants predict sections 3.3 and 3.4, and how that hangs on each."""
    found = predictions.cells(robots, trials, context)
    return Results(
        figures={"constants": predictions.figure(found)},
        tables=[Table("cells", tuple(vars(found[0])), [tuple(vars(c).values()) for c in found])],
        notes=predictions.remarks(found),
    )


def sensitivity_study(robots: int, trials: int, context: Context) -> Results:
    """Noise x sensors x norm; the noise is the study's own."""
    found = sensitivity.cells(robots * trials, context)
    return Results(
        figures={"sensitivity": sensitivity.figure(found)},
        claims=sensitivity.claims(found),
        tables=[Table("cells", tuple(vars(found[0])), [tuple(vars(c).values()) for c in found])],
        notes=sensitivity.remarks(found),
    )


def exploration(robots: int, trials: int, context: Context) -> Results:
    """Section 3.5 on the emulator, one run of each protocol a robot; `trials` is not used.

    The emulator's own scene says how imperfect its robot is, so the frozen constants are not used.
    """
    seeds = [context.seed + robot for robot in range(robots)]
    runs = context.map(explored.run_seed, seeds, "explorations")
    return Results(
        figures={
            "errors": explored.figure(runs),
            "stages": explored.stages(context.seed),
            "flow": flow.figure(),
        },
        claims=explored.claims(runs),
        tables=[explored.table(runs)],
    )


EXPERIMENTS: dict[str, Callable[[int, int, Context], Results]] = {
    "single-contact": single_contact,
    "two-contacts": two_contacts,
    "actuated": actuated,
    "predictions": predicted,
    "exploration": exploration,
    "sensitivity": sensitivity_study,
}


def run(name: str, out: Path, *, robots: int, trials: int, seed: int, jobs: int = 1) -> Results:
    """Run an experiment with the frozen constants and write its tables and figures.

    Args:
        name: a key of EXPERIMENTS.
        out: folder, made if missing.
        robots: robots to build; each has its own gains and sensor places.
        trials: trials a condition and robot.
        seed: every random number comes from it.
        jobs: processes; the results do not depend on it.

    Raises:
        RunFolderError: the folder cannot be written.
    """
    results = EXPERIMENTS[name](robots, trials, Context(seed=seed, jobs=jobs))
    save(results, name, out)
    return results
