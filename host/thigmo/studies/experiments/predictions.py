"""Do the constants fitted to section 3.2 predict 3.3 and 3.4, and how does that hang on each?

The thesis's solver over simulated robots, with the frozen constants and with each of them changed
by half of itself, one at a time. Two things that the thesis does not state and section 3.2 cannot
tell are changed as well: the size of the muscle's map and an error of the map in the lab's hands.
Nothing is fitted here.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from thigmo.studies.engine import Context, Outcome
from thigmo.studies.experiments import conditions, thesis
from thigmo.studies.experiments.compare import camera_errors, thesis_method, workspace_errors
from thigmo.studies.experiments.fit import frozen
from thigmo.studies.experiments.plan import STATIC
from thigmo.studies.experiments.specimen import Constants, Specimen, emulated_robot
from thigmo.studies.experiments.trial import Trial

_MAP_ERROR = 0.03
_WITHIN = 4 / 3  # a prediction within this factor of the thesis's mean is said to hold
_FROZEN = "as fitted"


@dataclass(frozen=True)
class Cell:
    """The thesis's solver on one condition with one constant changed; means in cm."""

    changed: str  # what differs from the frozen constants
    # experiment, condition: the row of the thesis's results, whose mean error is `thesis_cm`
    experiment: str
    condition: str
    thesis_cm: float
    # camera_cm, workspace_cm: mean |a - x of the obstacle| and |x error| in the workspace here
    camera_cm: float
    workspace_cm: float

    @property
    def row(self) -> tuple[str, str]:
        """Of the thesis's results."""
        return self.experiment, self.condition


Setting = tuple[str, Constants, dict[str, Any]]
"""What is changed, the constants, and options of a `Specimen`."""


def _settings() -> Iterator[Setting]:
    fitted = frozen()
    yield _FROZEN, fitted, {}
    for name, value in vars(fitted).items():
        label = name.removesuffix("_cm").removesuffix("_rad").replace("_", " ")
        for word, factor in (("- 50 %", 0.5), ("+ 50 %", 1.5)):
            yield f"{label} {word}", replace(fitted, **{name: factor * value}), {}
    muscle = emulated_robot().actuators.left.maps[-1].inflate
    for word, factor in (("- 25 %", 0.75), ("+ 25 %", 1.25)):
        curve = muscle.model_copy(update={"amplitude": factor * muscle.amplitude})
        yield f"muscle's map {word}", fitted, {"muscle": curve}
    for error in (-_MAP_ERROR, _MAP_ERROR):
        yield f"map believed {error:+.0%}", fitted, {"map_error": error}


def _rows(item: tuple[Setting, int, int, int]) -> list[Cell]:
    """One setting on every row of sections 3.2 to 3.4 that the plain solver made."""
    (changed, constants, options), robots, trials, seed = item
    trials_of: dict[tuple[str, str], list[Trial]] = defaultdict(list)
    for robot in range(robots):
        rng = np.random.default_rng([seed, robot])
        specimen = Specimen(constants, rng, **options)
        for name in STATIC:
            for trial in conditions.simulated(name, specimen, trials, rng):
                trials_of[name, trial.condition].append(trial)
    cells = []
    for row, mine in trials_of.items():
        pairs = [(trial, thesis_method(trial)) for trial in mine]
        camera, room = (
            float(np.mean([measure(t, a) for t, a in pairs]))
            for measure in (camera_errors, workspace_errors)
        )
        cells.append(Cell(changed, *row, thesis.RESULTS[row].mean_cm, camera, room))
    return cells


def run(robots: int, trials: int, context: Context) -> Outcome:
    """Every setting, over robots built anew for it from the same seed."""
    items = [(setting, robots, trials, context.seed) for setting in _settings()]
    found = [cell for some in context.map(_rows, items, "changed constants") for cell in some]
    return Outcome({"cells": [vars(one) for one in found]}, notes=remarks(found))


def remarks(found: list[Cell]) -> list[str]:
    """One sentence a row: fitted or predicted, how near, and which constant moves it most."""
    told = []
    for cell in [c for c in found if c.changed == _FROZEN]:
        same = [c for c in found if c.row == cell.row and c is not cell]
        most = max(same, key=lambda c: abs(c.camera_cm - cell.camera_cm))
        ratio = cell.camera_cm / cell.thesis_cm
        fitted = cell.experiment == "single-contact"
        verdict = "fitted" if fitted else "holds" if 1 / _WITHIN <= ratio <= _WITHIN else "FAILS"
        told.append(
            f"{cell.experiment}, {cell.condition}: thesis {cell.thesis_cm:.2f} cm, its method here "
            f"{cell.camera_cm:.2f} ({verdict}; in the workspace {cell.workspace_cm:.2f}); "
            f"moved most by {most.changed}: {most.camera_cm:.2f}"
        )
    return told
