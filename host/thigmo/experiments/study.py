"""The thesis's experiments on simulated robots: trials, three columns, figures.

Called by `thigmo experiment`. Robots are simulated with the frozen constants (`fit.py`); the
exploration comes from whole explorations on the emulator (`explored.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from thigmo.bench.study import Table
from thigmo.experiments import conditions, explored, flow, muscle, predictions, sensitivity
from thigmo.experiments.evaluate import Results, evaluate, save
from thigmo.experiments.fit import frozen
from thigmo.experiments.specimen import Constants, Specimen
from thigmo.experiments.trial import Trial

Draw = Callable[[Specimen, int, np.random.Generator], list[Trial]]


def collect(draw: Draw, constants: Constants, robots: int, trials: int, seed: int) -> list[Trial]:
    """Trials of an experiment over freshly drawn robots."""
    found = []
    for robot in range(robots):
        rng = np.random.default_rng([seed, robot])
        found += draw(Specimen(constants, rng), trials, rng)
    return found


def single_contact(robots: int, trials: int, seed: int) -> Results:
    """Section 3.2, with the clamped and the coupled solver."""
    found = collect(conditions.single_contact, frozen(), robots, trials, seed)
    return evaluate("single-contact", found)


def two_contacts(robots: int, trials: int, seed: int) -> Results:
    """Section 3.3."""
    return evaluate(
        "two-contacts", collect(conditions.two_contacts, frozen(), robots, trials, seed)
    )


def actuated(robots: int, trials: int, seed: int) -> Results:
    """Section 3.4, and the muscle's map (figure 2.4c)."""

    def draw(specimen: Specimen, count: int, _: np.random.Generator) -> list[Trial]:
        return conditions.actuated(specimen, count)

    results = evaluate("actuated", collect(draw, frozen(), robots, trials, seed))
    results.figures["muscle-map"] = muscle.figure(seed)
    return results


def predicted(robots: int, trials: int, seed: int) -> Results:
    """How well the frozen constants predict sections 3.3 and 3.4, and how that hangs on each."""
    found = predictions.cells(robots, trials, seed)
    return Results(
        figures={"constants": predictions.figure(found)},
        tables=[Table("cells", tuple(vars(found[0])), [tuple(vars(c).values()) for c in found])],
        notes=predictions.remarks(found),
    )


def sensitivity_study(robots: int, trials: int, seed: int) -> Results:
    """Noise x sensors x norm; the noise is the study's own."""
    found = sensitivity.cells(robots * trials, seed)
    return Results(
        figures={"sensitivity": sensitivity.figure(found)},
        claims=sensitivity.claims(found),
        tables=[Table("cells", tuple(vars(found[0])), [tuple(vars(c).values()) for c in found])],
        notes=sensitivity.remarks(found),
    )


def exploration(robots: int, trials: int, seed: int) -> Results:
    """Section 3.5 on the emulator, one run of each protocol a robot; `trials` is not used.

    The emulator's own scene says how imperfect its robot is, so the frozen constants are not used.
    """
    runs = [explored.run_seed(seed + robot) for robot in range(robots)]
    return Results(
        figures={
            "errors": explored.figure(runs),
            "stages": explored.stages(seed),
            "flow": flow.figure(),
        },
        claims=explored.claims(runs),
        tables=[explored.table(runs)],
    )


EXPERIMENTS: dict[str, Callable[[int, int, int], Results]] = {
    "single-contact": single_contact,
    "two-contacts": two_contacts,
    "actuated": actuated,
    "predictions": predicted,
    "exploration": exploration,
    "sensitivity": sensitivity_study,
}


def run(name: str, out: Path, *, robots: int, trials: int, seed: int) -> Results:
    """Run an experiment with the frozen constants and write its tables and figures.

    Args:
        name: a key of EXPERIMENTS.
        out: folder, made if missing.
        robots: robots to build; each has its own gains and sensor places.
        trials: trials a condition and robot.
        seed: every random number comes from it.

    Raises:
        RunFolderError: the folder cannot be written.
    """
    results = EXPERIMENTS[name](robots, trials, seed)
    save(results, name, out)
    return results
