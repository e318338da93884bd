"""Do the constants fitted to section 3.2 predict 3.3 and 3.4, and how does that hang on each?

The thesis's solver over simulated robots, with the frozen constants and with each of them changed
by half of itself, one at a time; a constant that the fit put at zero is raised instead. Two things
that the thesis does not state and section 3.2 cannot tell are changed as well: the size of the
muscle's map and an error of the map in the lab's hands. Nothing is fitted here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from thigmo.config import TanhMap
from thigmo.studies.engine import Context
from thigmo.studies.experiments import conditions, thesis
from thigmo.studies.experiments.compare import camera_errors, thesis_method, workspace_errors
from thigmo.studies.experiments.fit import frozen
from thigmo.studies.experiments.specimen import Constants, Specimen
from thigmo.studies.experiments.trial import Trial

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Raised to these where the fit says zero.
_FROM_ZERO = {"noise": 3e-4, "gain_spread": 0.05, "position_cm": 0.3, "fold_rad": 0.05}
_MAP_ERROR = 0.03
_WITHIN = 4 / 3  # a prediction within this factor of the thesis's mean is said to hold
_FROZEN = "as fitted"


@dataclass(frozen=True)
class Cell:
    """The thesis's solver on one condition with one constant changed; means in cm.

    Attributes:
        changed: what differs from the frozen constants.
        experiment, condition: the row of the thesis's results.
        thesis_cm: the thesis's mean error.
        camera_cm: mean |a - x of the obstacle| here.
        workspace_cm: mean |x error| in the workspace here.
    """

    changed: str
    experiment: str
    condition: str
    thesis_cm: float
    camera_cm: float
    workspace_cm: float


@dataclass(frozen=True)
class _Setting:
    changed: str
    constants: Constants
    muscle: TanhMap | None = None
    map_error: float = 0.0


def _settings() -> Iterator[_Setting]:
    fitted = frozen()
    yield _Setting(_FROZEN, fitted)
    for name, value in vars(fitted).items():
        label = name.removesuffix("_cm").removesuffix("_rad").replace("_", " ")
        if value == 0:
            raised = _FROM_ZERO[name]
            yield _Setting(f"{label} 0 -> {raised:g}", replace(fitted, **{name: raised}))
            continue
        for word, factor in (("- 50 %", 0.5), ("+ 50 %", 1.5)):
            yield _Setting(f"{label} {word}", replace(fitted, **{name: factor * value}))
    muscle = conditions.emulated_robot().actuators.left.maps[-1].inflate
    for word, factor in (("- 25 %", 0.75), ("+ 25 %", 1.25)):
        curve = muscle.model_copy(update={"amplitude": factor * muscle.amplitude})
        yield _Setting(f"muscle's map {word}", fitted, curve)
    for sign in (-1, 1):
        error = sign * _MAP_ERROR
        yield _Setting(f"map believed {error:+.0%}", fitted, map_error=error)


def cells(robots: int, trials: int, context: Context) -> list[Cell]:
    """Every setting on every row of sections 3.2 to 3.4 that the plain solver made.

    Args:
        robots: built anew for each setting, from the same seed.
        trials: for each place and condition.
        context: seed of robots and noise; settings are shared out among its processes.
    """
    items = [(setting, robots, trials, context.seed) for setting in _settings()]
    return [cell for found in context.map(_rows, items, "changed constants") for cell in found]


def _rows(item: tuple[_Setting, int, int, int]) -> list[Cell]:
    """One setting on every row."""
    setting, robots, trials, seed = item
    trials_of: dict[str, list[Trial]] = {"single-contact": [], "two-contacts": [], "actuated": []}
    for robot in range(robots):
        rng = np.random.default_rng([seed, robot])
        specimen = Specimen(setting.constants, rng)
        trials_of["single-contact"] += conditions.single_contact(specimen, trials, rng)
        trials_of["two-contacts"] += conditions.two_contacts(specimen, trials, rng)
        trials_of["actuated"] += conditions.actuated(
            specimen, trials, setting.muscle, setting.map_error
        )
    found = []
    for experiment, every in trials_of.items():
        for condition in dict.fromkeys(trial.condition for trial in every):
            mine = [trial for trial in every if trial.condition == condition]
            pairs = [(trial, thesis_method(trial)) for trial in mine]
            found.append(
                Cell(
                    setting.changed,
                    experiment,
                    condition,
                    thesis.published(experiment, condition).mean_cm,
                    float(np.mean([camera_errors(t, a) for t, a in pairs])),
                    float(np.mean([workspace_errors(t, a) for t, a in pairs])),
                )
            )
    return found


def remarks(found: list[Cell]) -> list[str]:
    """One sentence a row: fitted or predicted, how near, and which constant moves it most."""
    told = []
    for cell in found:
        if cell.changed != _FROZEN:
            continue
        same = [
            c for c in found
            if (c.experiment, c.condition) == (cell.experiment, cell.condition) and c is not cell
        ]  # fmt: skip
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


def figure(found: list[Cell]) -> Figure:
    """Mean error over the thesis's, a column a row of its table, a line a changed constant."""
    from matplotlib.figure import Figure

    rows = list(dict.fromkeys((c.experiment, c.condition) for c in found))
    changes = list(dict.fromkeys(c.changed for c in found))
    value = {(c.changed, c.experiment, c.condition): c for c in found}
    ratio = np.array(
        [[value[(w, *r)].camera_cm / value[(w, *r)].thesis_cm for r in rows] for w in changes]
    )
    picture = Figure(figsize=(11, 0.42 * len(changes) + 2.6), layout="constrained")
    axis = picture.subplots()
    image = axis.imshow(np.log2(ratio), cmap="RdBu_r", vmin=-2, vmax=2, aspect="auto")
    for y, change in enumerate(changes):
        for x, key in enumerate(rows):
            cell = value[(change, *key)]
            axis.text(
                x, y, f"{cell.camera_cm:.2f} ({cell.workspace_cm:.2f})",
                ha="center", va="center", fontsize=8,
            )  # fmt: skip
    names = [f"{e}\n{c}\nthesis {value[(_FROZEN, e, c)].thesis_cm:.2f}" for e, c in rows]
    axis.set_xticks(range(len(rows)), names, fontsize=8)
    axis.set_yticks(range(len(changes)), changes, fontsize=8)
    axis.axvline(1.5, color="k")
    bar = picture.colorbar(image, ax=axis, ticks=[-2, -1, 0, 1, 2])
    bar.set_ticklabels(["1/4", "1/2", "1", "2", "4"])
    bar.set_label("|a - x| here over the thesis's")
    picture.suptitle(
        "The thesis's solver: mean |a - x of the obstacle| (in the workspace), cm. "
        "Left of the line fitted, right of it predicted.",
        fontsize=10,
    )
    return picture
