"""Random scenes of the studies: contacts, and the readings of the sensors.

Lengths are in cm. The robot is the thesis's (53 cm, spans of 5.5 cm). Contact moments at the base
stay below the critical one; another study covers the fold. Readings are those of the
large-deflection rod (`rod.py`) plus independent noise, never of the model that the localizer fits.
`pegs.py` gives place and force of contacts with pegs in a room.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from thigmo.reading_errors import SETTLED
from thigmo_bench.studies.rod import Floats, readings

LENGTH = 53.0
SPAN = 5.5
SIGMA = 6e-4
CRITICAL = 0.01108
RADIUS = 1.75
NEAREST = 8.0  # no contact is drawn closer to the base
FULL_CURVATURE = 0.04  # of the bent robot
COLUMN: Floats = np.array([5.0, 15.0, 25.0, 35.0, 45.0])
BOTH: Floats = np.tile(COLUMN, 2)
# Readings without errors but noise: what a caller states who knows that.
STATED: dict[str, Any] = SETTLED | {"gain_error": 0.0, "offset_error": 0.0, "map_error": 0.0}
# What a caller of `localize` with a robot states of it; a scene folds only where it says so.
ROBOT: dict[str, Any] = STATED | {
    "tube_radius": RADIUS, "held_end": False, "critical_curvature": float("inf"),
}  # fmt: skip


@dataclass(frozen=True)
class Case:
    """One set of readings and the truth behind it."""

    curvature: Floats
    position: Floats
    free: float | None  # that is passed; None if it is not given
    arcs: tuple[float, ...]
    span: float = SPAN  # of each sensor


def read(
    rng: np.random.Generator,
    arcs: tuple[float, ...],
    forces: tuple[float, ...],
    *,
    position: Floats = BOTH,
    span: float = SPAN,
    free: float = 0.0,
    sigma: float = SIGMA,
) -> Case:
    """Readings of normal contact forces, with Gaussian noise."""
    body = {"length": LENGTH, "span": span, "free_curvature": free}
    clean = readings(np.array(arcs), np.array(forces), position, **body)
    return Case(clean + sigma * rng.standard_normal(position.size), position, free, arcs)


def side_of(rng: np.random.Generator) -> float:
    """1.0 or -1.0 at random."""
    return float(rng.choice([-1.0, 1.0]))


def _moment(rng: np.random.Generator) -> float:
    return float(rng.uniform(0.3, 1.0)) * CRITICAL


def one_contact(rng: np.random.Generator, position: Floats = BOTH, span: float = SPAN) -> Case:
    """One contact on the straight robot, ten readings."""
    arc = float(rng.uniform(20.0, LENGTH))
    force = side_of(rng) * _moment(rng) / arc
    return read(rng, (arc,), (force,), position=position, span=span)


def two_contacts(rng: np.random.Generator) -> Case:
    """Two opposed contacts at least 18.5 cm apart, the distal one near the tip, ten readings."""
    distal = float(rng.uniform(45.0, LENGTH))
    proximal = float(rng.uniform(18.0, distal - 18.5))
    force = side_of(rng) * (_moment(rng) / distal)
    # The moments at the base partly cancel; similar sizes keep both contacts visible.
    return read(rng, (proximal, distal), (-force * distal / proximal, 1.5 * force))


def three_contacts(rng: np.random.Generator, position: Floats = BOTH, span: float = SPAN) -> Case:
    """Three contacts of alternating forces, near 20, 35 and 50 cm, at sensors as given."""
    arcs = np.array([20.0, 35.0, 50.0]) + rng.uniform(-1.5, 1.5, 3)
    forces = side_of(rng) * np.array([2.4, -1.6, 1.0]) * 0.6 * CRITICAL / LENGTH
    return read(rng, tuple(arcs.tolist()), tuple(forces.tolist()), position=position, span=span)


def actuated(rng: np.random.Generator, position: Floats = COLUMN) -> Case:
    """One contact on the bent robot's side, read by its inactive side only: five readings."""
    arc = float(rng.uniform(30.0, LENGTH))
    free = float(rng.uniform(0.02, FULL_CURVATURE))
    return read(rng, (arc,), (-_moment(rng) / arc,), position=position, free=free)


def few_sensors(rng: np.random.Generator) -> Case:
    """One contact anywhere along the body, three readings."""
    arc = float(rng.uniform(NEAREST, LENGTH))
    return read(rng, (arc,), (_moment(rng) / arc,), position=COLUMN[[0, 2, 3]])
