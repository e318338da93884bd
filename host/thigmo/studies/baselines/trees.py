"""Tree ensembles, the thesis's wish: trained on simulated readings, alone and with mechanics.

One ensemble is trained for each sensor layout, noise and number of contacts, on the beam model
with random contacts, and kept for the process. With mechanics it also sees the exact 1-norm fit and
what that leaves over. Source: Geurts, Ernst and Wehenkel, Extremely randomized trees, Machine
Learning 63, 2006 (scikit-learn); the thesis's outlook asks for an ensemble of trees.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from thigmo.localization import localize
from thigmo.studies.baselines.problem import Array, Problem, best_forces, influence
from thigmo.studies.engine import extra

_EXAMPLES = 6000


def _features(problem: Problem, mechanics: bool) -> Array:
    plain = problem.curvature * problem.length
    if not mechanics:
        return plain
    fit = localize(
        problem.curvature,
        problem.position,
        length=problem.length,
        span=problem.span,
        contacts=problem.contacts,
        method="l1",
    ).contacts
    arcs, forces = (np.array([getattr(c, what) for c in fit]) for what in ("arc", "force"))
    left = problem.curvature - influence(problem, arcs) @ forces
    return np.concatenate([plain, arcs, forces * problem.length**2, left * problem.length])


def _example(layout: Problem, rng: np.random.Generator) -> tuple[Problem, Array]:
    arcs = np.sort(rng.uniform(0.2, 1.0, layout.contacts)) * layout.length
    moments = rng.uniform(0.1, 1.2, layout.contacts) * layout.critical_curvature
    forces = moments * rng.choice([-1.0, 1.0], layout.contacts) / arcs
    clean = influence(layout, arcs) @ forces
    return replace(layout, curvature=clean + layout.noise * rng.standard_normal(clean.size)), arcs


@lru_cache(maxsize=16)
def _ensemble(
    position: tuple[float, ...],
    span: tuple[float, ...],
    length: float,
    contacts: int,
    noise: float,
    mechanics: bool,
) -> Any:
    layout = Problem(
        np.zeros(len(position)), np.array(position), np.array(span), length, contacts, noise
    )
    rng = np.random.default_rng(0)
    examples = [_example(layout, rng) for _ in range(_EXAMPLES)]
    inputs = np.array([_features(problem, mechanics) for problem, _ in examples])
    arcs = np.array([target for _, target in examples])
    forest = extra("sklearn.ensemble").ExtraTreesRegressor(
        n_estimators=100, min_samples_leaf=3, random_state=0
    )
    return forest.fit(inputs, arcs if contacts > 1 else arcs[:, 0])


def trees(problem: Problem, mechanics: bool = False) -> tuple[Array, Array]:
    """Extremely randomised trees on the readings, alone or with the exact fit beside them."""
    forest = _ensemble(
        tuple(problem.position.tolist()),
        tuple(problem.span.tolist()),
        problem.length,
        problem.contacts,
        problem.noise,
        mechanics,
    )
    arcs = np.sort(np.atleast_1d(forest.predict(_features(problem, mechanics)[None, :])[0]))
    return arcs, best_forces(problem, arcs)
