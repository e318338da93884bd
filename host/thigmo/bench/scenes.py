"""Random scenes of the studies: what touches where, and what the sensors then read.

All lengths in cm. The robot is the thesis's (53 cm, spans of 5.5 cm); contact moments at the base
stay below the fold's, which is a study of its own. Readings are of the large-deflection rod
(`truth.py`) plus fresh noise, never of the model that the localizer fits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thigmo.bench.truth import readings

Floats = NDArray[np.float64]

LENGTH = 53.0
SPAN = 5.5
SIGMA = 6e-4
CRITICAL = 0.01108
COLUMN: Floats = np.array([5.0, 15.0, 25.0, 35.0, 45.0])
BOTH: Floats = np.tile(COLUMN, 2)


@dataclass(frozen=True)
class Case:
    """One set of readings and the truth behind it."""

    curvature: Floats
    position: Floats
    free: float
    arcs: tuple[float, ...]
    forces: tuple[float, ...]


def read(
    rng: np.random.Generator,
    arcs: tuple[float, ...],
    forces: tuple[float, ...],
    *,
    position: Floats = BOTH,
    free: float = 0.0,
    sigma: float = SIGMA,
) -> Case:
    """Readings of normal contact forces, with Gaussian noise."""
    clean = readings(
        np.array(arcs),
        np.array(forces),
        position,
        length=LENGTH,
        span=SPAN,
        free_curvature=free,
    )
    return Case(clean + sigma * rng.standard_normal(position.size), position, free, arcs, forces)


def _moment(rng: np.random.Generator) -> float:
    return float(rng.uniform(0.3, 1.0)) * CRITICAL


def one_contact(rng: np.random.Generator) -> Case:
    """One contact on the straight robot, ten readings."""
    arc = float(rng.uniform(20.0, LENGTH))
    return read(rng, (arc,), (float(rng.choice([-1.0, 1.0])) * _moment(rng) / arc,))


def two_contacts(rng: np.random.Generator) -> Case:
    """Two opposed contacts at least 18.5 cm apart, the distal one near the tip, ten readings."""
    distal = float(rng.uniform(45.0, LENGTH))
    proximal = float(rng.uniform(18.0, distal - 18.5))
    sign = float(rng.choice([-1.0, 1.0]))
    force = _moment(rng) / distal
    # The forces' moments at the base partly cancel; equal sizes keep both contacts visible.
    return read(rng, (proximal, distal), (-sign * force * distal / proximal, sign * 1.5 * force))


def actuated(rng: np.random.Generator) -> Case:
    """One contact on the bent robot, read by the inactive side only: five readings."""
    arc = float(rng.uniform(30.0, LENGTH))
    free = float(rng.uniform(0.02, 0.04))
    return read(rng, (arc,), (-_moment(rng) / arc,), position=COLUMN, free=free)


def few_sensors(rng: np.random.Generator) -> Case:
    """One contact, three readings."""
    arc = float(rng.uniform(38.0, LENGTH))
    return read(rng, (arc,), (_moment(rng) / arc,), position=COLUMN[[0, 2, 3]])


SCENES: dict[str, Callable[[np.random.Generator], Case]] = {
    "one contact": one_contact,
    "two contacts": two_contacts,
    "actuated": actuated,
    "few sensors": few_sensors,
}
