"""The baselines are what they say: the thesis's solver behaves as measured, the rest find a peg."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thigmo.errors import DataError
from thigmo.localization.thesis import best_forces, influence, objective
from thigmo_bench.baselines import BASELINES, BaselineProblem
from thigmo_bench.studies.rod import readings

LENGTH = 53.0
BOTH = np.tile([5.0, 15.0, 25.0, 35.0, 45.0], 2)
SPAN = np.full(10, 5.5)
CRITICAL = 0.01108


def problem(arc: float, level: float, sigma: float, rng: np.random.Generator) -> BaselineProblem:
    clean = readings(
        np.array([arc]), np.array([level * CRITICAL / arc]), BOTH, length=LENGTH, span=SPAN
    )
    return BaselineProblem(clean + sigma * rng.standard_normal(10), BOTH, SPAN, LENGTH, noise=sigma)


def mean_error(name: str, level: float, sigma: float) -> float:
    rng = np.random.default_rng(5)
    errors = []
    for _ in range(30):
        for arc in (LENGTH, 0.75 * LENGTH, 0.5 * LENGTH):
            arcs, _ = BASELINES[name](problem(arc, level, sigma, rng))
            errors.append(abs(arcs[0] - arc))
    return float(np.mean(errors))


def test_the_thesis_solver_errs_as_measured_for_this_project() -> None:
    # The reference measurement: 2.2..2.6 cm at high force, 3.2..5.4 cm at low, sigma 3e-4..6e-4.
    assert 1.6 < mean_error("alternating", 1.0, 3e-4) < 3.2
    assert 1.6 < mean_error("alternating", 1.0, 6e-4) < 3.2
    assert 2.6 < mean_error("alternating", 0.35, 3e-4) < 4.5
    assert 4.0 < mean_error("alternating", 0.35, 6e-4) < 7.0


def test_the_barrier_path_leaves_minima_in_which_coordinate_descent_stalls() -> None:
    assert mean_error("coordinate", 1.0, 6e-4) > 1.15 * mean_error("alternating", 1.0, 6e-4)


@pytest.mark.parametrize("name", [n for n in BASELINES if n not in ("pwlf", "ruptures", "slsqp")])
def test_a_clear_contact_is_found(name: str) -> None:
    rng = np.random.default_rng(1)
    errors = [abs(BASELINES[name](problem(47.0, 0.9, 1e-4, rng))[0][0] - 47.0) for _ in range(3)]
    assert np.median(errors) < 4.0


@pytest.mark.parametrize("name", list(BASELINES))
def test_answers_lie_on_the_body_and_are_ordered(name: str) -> None:
    rng = np.random.default_rng(2)
    case = problem(40.0, 0.8, 6e-4, rng)
    arcs, forces = BASELINES[name](case)
    assert arcs.shape == forces.shape == (1,)
    assert 0.0 <= arcs[0] <= LENGTH
    assert np.isfinite(forces).all()


@pytest.mark.parametrize("name", ["alternating", "grid", "slsqp", "nelder-mead"])
def test_two_contacts_come_in_order(name: str) -> None:
    clean = readings(
        np.array([20.0, 50.0]), np.array([-5e-4, 3e-4]), BOTH, length=LENGTH, span=SPAN
    )
    arcs, _ = BASELINES[name](BaselineProblem(clean, BOTH, SPAN, LENGTH, contacts=2))
    assert arcs.shape == (2,)
    assert arcs[0] <= arcs[1]


def test_inner_forces_are_optimal_against_random_trials() -> None:
    rng = np.random.default_rng(3)
    for contacts in (1, 2):
        arcs = np.sort(rng.uniform(15.0, LENGTH, contacts))
        y = influence(BaselineProblem(np.zeros(10), BOTH, SPAN, LENGTH), arcs) @ rng.normal(
            0, 3e-4, contacts
        ) + 6e-4 * rng.standard_normal(10)
        case = BaselineProblem(y, BOTH, SPAN, LENGTH, contacts=contacts)
        best = best_forces(case, arcs)
        least = objective(case, arcs, best)
        for scale in (1e-6, 1e-5, 1e-4):
            for _ in range(200):
                trial = best + scale * rng.standard_normal(contacts)
                assert objective(case, arcs, trial) >= least - 1e-15


def test_coupling_uses_the_critical_moment_when_the_base_folds() -> None:
    clean = readings(
        np.array([3.5, 40.0]),
        np.array([0.0, CRITICAL / 40.0]),
        BOTH,
        length=LENGTH,
        span=SPAN,
        free_curvature=np.array([0.1 / 3.5, 0.0, 0.0]),  # folded by 0.1 rad up to 3.5 cm
    )
    arcs, forces = BASELINES["coupled"](BaselineProblem(clean, BOTH, SPAN, LENGTH))
    assert arcs[0] * forces[0] == pytest.approx(CRITICAL)
    assert abs(arcs[0] - 40.0) < 2.0


def test_too_few_places_are_an_error_that_names_the_cure() -> None:
    few = BaselineProblem(np.zeros(3), BOTH[:3], SPAN[:3], LENGTH)
    for name in ("pwlf", "ruptures"):
        with pytest.raises(DataError, match="localizer"):
            BASELINES[name](few)


def test_methods_that_need_a_starting_point_start_where_the_problem_says() -> None:
    """From the base the descent stalls farther from a contact than from nearby."""
    position = np.tile(np.arange(5.0, 50.0, 10.0), 2)
    span = np.full(10, 5.5)
    clean = BaselineProblem(np.zeros(10), position, span, 53.0)
    curvature = 2e-4 * influence(clean, np.array([40.0]))[:, 0]
    for method in ("alternating", "clamped", "slsqp", "trust-constr", "nelder-mead"):
        near, far = (
            abs(
                float(BASELINES[method](replace(clean, curvature=curvature, start=start))[0][0])
                - 40
            )
            for start in (np.array([38.0]), np.array([5.0]))
        )
        assert near < 3.0 < far, method


def test_the_thesis_reads_curvature_at_centres() -> None:
    """Its model knows no spans: whatever they are, its solvers answer the same."""
    case = problem(40.0, 0.8, 6e-4, np.random.default_rng(6))
    points = replace(case, span=np.zeros(10))
    for name in ("alternating", "alternating-trust-constr", "clamped", "coupled"):
        for answer, answer_at_points in zip(
            BASELINES[name](case), BASELINES[name](points), strict=True
        ):
            assert np.array_equal(answer, answer_at_points), name
