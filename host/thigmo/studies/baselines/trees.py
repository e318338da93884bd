"""Tree ensembles, the thesis's wish: trained on simulated readings, alone and with mechanics.

One ensemble is trained for each sensor layout, noise and number of contacts, on the beam model
with random contacts, and kept for the process. `trees` sees the readings only; `trees_mechanics`
also sees the exact solver's answer and what it leaves over. Source: Geurts, Ernst and Wehenkel,
Extremely randomized trees, Machine Learning 63, 2006 (scikit-learn); the thesis's outlook asks for
an ensemble of trees.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from thigmo.errors import DataError
from thigmo.studies.baselines.problem import Array, Problem, best_forces, influence

_EXAMPLES = 6000


def _mechanics(problem: Problem) -> Array:
    from thigmo.localization.exact import one_contact, several_contacts

    if problem.contacts == 1:
        fit = one_contact(problem.curvature, problem.position, problem.length, span=problem.span)
    else:
        fit = several_contacts(
            problem.curvature,
            problem.position,
            problem.length,
            contacts=problem.contacts,
            span=problem.span,
        )
    left = problem.curvature - influence(problem, fit.arc) @ fit.force
    return np.concatenate([fit.arc, fit.force * problem.length**2, left * problem.length])


def _features(problem: Problem, mechanics: bool) -> Array:
    plain = problem.curvature * problem.length
    return np.concatenate([plain, _mechanics(problem)]) if mechanics else plain


def _example(layout: Problem, rng: np.random.Generator) -> tuple[Problem, Array]:
    arcs = np.sort(rng.uniform(0.2, 1.0, layout.contacts)) * layout.length
    moments = rng.uniform(0.1, 1.2, layout.contacts) * layout.critical_curvature
    forces = moments * rng.choice([-1.0, 1.0], layout.contacts) / arcs
    clean = influence(layout, arcs) @ forces
    noisy = clean + layout.noise * rng.standard_normal(clean.size)
    example = Problem(
        noisy,
        layout.position,
        layout.span,
        layout.length,
        layout.contacts,
        layout.noise,
        layout.critical_curvature,
    )
    return example, arcs


@lru_cache(maxsize=16)
def _ensemble(
    position: tuple[float, ...],
    span: tuple[float, ...],
    length: float,
    contacts: int,
    noise: float,
    mechanics: bool,
) -> Any:
    try:
        from sklearn.ensemble import ExtraTreesRegressor
    except ImportError as error:
        raise DataError(
            "methods 'trees' and 'trees-mechanics' need scikit-learn",
            "run `pip install 'thigmo[bench]'`",
        ) from error
    layout = Problem(
        np.zeros(len(position)), np.array(position), np.array(span), length, contacts, noise
    )
    rng = np.random.default_rng(0)
    examples = [_example(layout, rng) for _ in range(_EXAMPLES)]
    inputs = np.array([_features(problem, mechanics) for problem, _ in examples])
    arcs = np.array([target for _, target in examples])
    forest = ExtraTreesRegressor(n_estimators=100, min_samples_leaf=3, random_state=0)
    return forest.fit(inputs, arcs if contacts > 1 else arcs[:, 0])


def _predict(problem: Problem, mechanics: bool) -> tuple[Array, Array]:
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


def trees(problem: Problem) -> tuple[Array, Array]:
    """Extremely randomised trees on the readings alone.

    Raises:
        DataError: scikit-learn is missing.
    """
    return _predict(problem, mechanics=False)


def trees_mechanics(problem: Problem) -> tuple[Array, Array]:
    """The same with the exact solver's answer and residuals as further features.

    Raises:
        DataError: scikit-learn is missing.
    """
    return _predict(problem, mechanics=True)
