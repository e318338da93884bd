"""The thesis's static experiments, run: trials, three columns, figures.

Called by `thigmo experiment`. Robots are simulated with the frozen constants (`fit.py`); the
exploration row comes from whole explorations on the emulator (`explored.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from thigmo.experiments import conditions, figures, thesis
from thigmo.experiments.compare import Row, baseline, row
from thigmo.experiments.specimen import Constants, Specimen, Trial

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Progress = Callable[[int, int], None]


@dataclass
class Results:
    """What an experiment gave: rows of the table, its trials, its figures by name."""

    rows: list[Row]
    trials: list[Trial]
    figures: dict[str, Figure] = field(default_factory=dict)


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


EXPERIMENTS: dict[str, Callable[[Constants, int, int, int], Results]] = {
    "single-contact": single_contact,
    "two-contacts": two_contacts,
    "actuated": actuated,
}
