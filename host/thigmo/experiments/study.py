"""The thesis's static experiments, run: trials, three columns, figures.

Called by `thigmo experiment`. Robots are simulated with the frozen constants (`fit.py`); the
exploration row comes from whole explorations on the emulator (`explored.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from thigmo.bench.study import Claim, Outcome, Table, write
from thigmo.experiments import conditions, explored, figures, sensitivity, thesis
from thigmo.experiments.compare import Row, baseline, row
from thigmo.experiments.fit import frozen
from thigmo.experiments.specimen import Constants, Specimen, Trial

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Progress = Callable[[int, int], None]


@dataclass
class Results:
    """What an experiment gave: rows of the comparison, trials, figures by name, claims, tables."""

    rows: list[Row]
    trials: list[Trial]
    figures: dict[str, Figure] = field(default_factory=dict)
    claims: list[Claim] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)


def collect(
    draw: Callable[[Specimen, int, np.random.Generator], list[Trial]],
    constants: Constants,
    robots: int,
    trials: int,
    seed: int,
) -> list[Trial]:
    """Trials of an experiment over freshly drawn robots."""
    found = []
    for robot in range(robots):
        rng = np.random.default_rng([seed, robot])
        found += draw(Specimen(constants, rng), trials, rng)
    return found


def single_contact(constants: Constants, robots: int, trials: int, seed: int) -> Results:
    """Section 3.2, with the clamped and the coupled solver."""
    found = collect(conditions.single_contact, constants, robots, trials, seed)
    high = [t for t in found if t.condition == "high force"]
    low = [t for t in found if t.condition == "low force"]
    rows = [
        row("single-contact", "high force", high, baseline("alternating")),
        row("single-contact", "low force", low, baseline("alternating")),
        row("single-contact", "high force, base clamped", high, baseline("clamped")),
        row("single-contact", "high force, coupled", high, baseline("coupled")),
    ]
    return Results(rows, found, figures.single_contact(found, rows))


def two_contacts(constants: Constants, robots: int, trials: int, seed: int) -> Results:
    """Section 3.3."""
    found = collect(conditions.two_contacts, constants, robots, trials, seed)
    far = [t for t in found if conditions.gap_of(t) >= thesis.DISCRIMINATION_CM]
    near = [t for t in found if conditions.gap_of(t) < thesis.DISCRIMINATION_CM]
    here = baseline("alternating")
    rows = [
        row("two-contacts", "23.5 cm or more apart", far, here),
        row("two-contacts", "closer than 23.5 cm", near, here),
    ]
    return Results(rows, found, figures.two_contacts(found))


def actuated(constants: Constants, robots: int, trials: int, seed: int) -> Results:
    """Section 3.4."""
    found = collect(
        lambda specimen, count, _: conditions.actuated(specimen, count),
        constants,
        robots,
        trials,
        seed,
    )
    here = baseline("alternating")
    rows = [
        row("actuated", name, [t for t in found if t.condition == level], here)
        for name, level in (
            ("high force (14 psi)", "high force"),
            ("low force (10 psi)", "low force"),
        )
    ]
    return Results(rows, found, figures.actuated(found))


def sensitivity_study(constants: Constants, robots: int, trials: int, seed: int) -> Results:
    """Noise x sensors x norm; `constants` are not used, the noise is the study's own."""
    found = sensitivity.cells(robots * trials, seed)
    table = Table("cells", tuple(vars(found[0])), [tuple(vars(cell).values()) for cell in found])
    return Results(
        [], [], {"sensitivity": sensitivity.figure(found)}, sensitivity.claims(found), [table]
    )


def exploration(constants: Constants, robots: int, trials: int, seed: int) -> Results:
    """Section 3.5 on the emulator, one run of each protocol a robot; `trials` is not used.

    The emulator's own scene says how imperfect its robot is, so `constants` are not used either.
    """
    runs = [explored.run_seed(seed + robot) for robot in range(robots)]
    return Results(
        [],
        [],
        {"exploration": explored.figure(runs)},
        explored.claims(runs),
        [explored.table(runs)],
    )


EXPERIMENTS: dict[str, Callable[[Constants, int, int, int], Results]] = {
    "single-contact": single_contact,
    "two-contacts": two_contacts,
    "actuated": actuated,
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
    results = EXPERIMENTS[name](frozen(), robots, trials, seed)
    if results.rows:
        columns = (*vars(results.rows[0]), "allowed", "beaten")
        lines = [(*vars(r).values(), r.allowed, r.beaten) for r in results.rows]
        results.tables.append(Table("rows", columns, lines))
    for r in results.rows:
        results.claims.append(
            Claim(
                f"{r.experiment}, {r.condition}: workspace x error",
                r.ours_workspace_mean,
                r.allowed,
                unit="cm",
            )
        )
    write(Outcome(results.tables, results.figures, results.claims), name, out)
    return results
