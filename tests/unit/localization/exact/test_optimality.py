"""No oracle beats the exact solvers: 10 000 cases for one contact, 1 000 for two, 200 for three."""

from __future__ import annotations

import numpy as np
import pytest
from exact_oracles import (
    LENGTH,
    Case,
    grid_minimum,
    influence,
    objective,
    programme_minimum,
    random_case,
)

from thigmo.localization.exact import Solution, one_contact, several_contacts
from thigmo.localization.exact.dense_one_contact import fit_dense_l1
from thigmo.localization.exact.response import ForceRange, Readings, inverse_spans

TOLERANCE = 1e-9


def oracle(case: Case, norm: int, contacts: int, bounds: tuple[float, float]) -> float:
    points, starts, levels, fine = {1: (130, 4, 6, 25), 2: (20, 3, 5, 7), 3: (9, 2, 5, 5)}[contacts]
    return float(
        grid_minimum(
            case.curvature,
            case.position,
            case.span,
            case.weight,
            LENGTH,
            float(bounds[0]),
            float(bounds[1]),
            norm,
            contacts,
            points,
            starts,
            levels,
            fine,
        )
    )


def check(case: Case, solution: Solution, norm: int, best: float, limit: float) -> None:
    scale = case.scale if norm == 1 else case.square_scale
    slack = TOLERANCE * max(scale, best) + 1e-300
    attained = objective(case, solution.arc, solution.force, norm)
    assert solution.objective <= best + slack, case
    assert attained == pytest.approx(solution.objective, abs=2 * slack), case
    assert np.all((solution.arc >= 0) & (solution.arc <= LENGTH))
    assert np.all(np.diff(solution.arc) >= 0)
    assert np.all(np.abs(solution.force) <= limit * (1 + 1e-12))
    assert solution.gap <= 1.1 * slack


@pytest.mark.parametrize(("norm", "cases"), [(1, 10_000), (2, 3_000)])
def test_one_contact_is_never_worse(norm: int, cases: int) -> None:
    rng = np.random.default_rng(20 + norm)
    for _ in range(cases):
        case = random_case(rng, 12)
        solution = one_contact(
            case.curvature,
            case.position,
            LENGTH,
            span=case.span,
            weight=case.weight,
            norm=1 if norm == 1 else 2,
            force_bounds=case.bounds,
        )
        check(case, solution, norm, oracle(case, norm, 1, case.bounds), np.inf)
        assert case.bounds[0] <= solution.force[0] <= case.bounds[1]


@pytest.mark.parametrize(("norm", "cases"), [(1, 1_000), (2, 1_000)])
def test_two_contacts_are_never_worse(norm: int, cases: int) -> None:
    rng = np.random.default_rng(40 + norm)
    for _ in range(cases):
        case = random_case(rng, 9, contacts=2)
        solution = several_contacts(
            case.curvature,
            case.position,
            LENGTH,
            contacts=2,
            span=case.span,
            weight=case.weight,
            norm=1 if norm == 1 else 2,
        )
        limit = case.limit
        check(case, solution, norm, oracle(case, norm, 2, (-limit, limit)), limit)


@pytest.mark.parametrize(("norm", "cases"), [(1, 200), (2, 200)])
def test_three_contacts_are_never_worse(norm: int, cases: int) -> None:
    rng = np.random.default_rng(60 + norm)
    for _ in range(cases):
        case = random_case(rng, 7, contacts=3)
        solution = several_contacts(
            case.curvature,
            case.position,
            LENGTH,
            contacts=3,
            span=case.span,
            weight=case.weight,
            norm=1 if norm == 1 else 2,
        )
        limit = case.limit
        check(case, solution, norm, oracle(case, norm, 3, (-limit, limit)), limit)


@pytest.mark.parametrize(("contacts", "cases", "most"), [(1, 60, 8), (2, 10, 5)])
def test_linear_programmes_agree(contacts: int, cases: int, most: int) -> None:
    rng = np.random.default_rng(80 + contacts)
    for _ in range(cases):
        case = random_case(rng, most, contacts)
        case.span[:] = 0.0
        # HiGHS has absolute tolerances: readings of order one, weights of order one.
        case.curvature *= 1.0 / max(float(np.abs(case.curvature).max()), 1e-300)
        limit = 20.0 / LENGTH
        if contacts == 1:
            found = one_contact(
                case.curvature,
                case.position,
                LENGTH,
                weight=case.weight,
                force_bounds=(-limit, limit),
            )
        else:
            found = several_contacts(
                case.curvature, case.position, LENGTH, contacts=contacts, weight=case.weight
            )
        best = programme_minimum(case, contacts, limit)
        assert found.objective == pytest.approx(best, abs=1e-6 * max(case.scale, 1.0))


def test_hundreds_of_sensors_are_fitted_exactly_too() -> None:
    rng = np.random.default_rng(7)
    for n, span in ((40, 5.5), (80, 0.0), (200, 0.1), (200, 0.0)):
        for norm in (1, 2):
            position = np.sort(rng.uniform(0.0, LENGTH, n))
            case = Case(
                6e-4 * rng.standard_normal(n) + 4e-4 * np.maximum(37.0 - position, 0.0),
                position,
                np.full(n, span),
                np.ones(n),
                (-np.inf, np.inf),
            )
            case.curvature[n // 3] += 0.05
            solution = one_contact(
                case.curvature, position, LENGTH, span=span, norm=1 if norm == 1 else 2
            )
            profile = _profile_minimum(case, norm, float(solution.arc[0]))
            check(case, solution, norm, profile, np.inf)


def test_the_dense_fit_agrees_with_enumeration() -> None:
    """Also where medians are ties: sensors on both sides of the same places, equal readings."""
    rng = np.random.default_rng(8)
    for index in range(600):
        case = random_case(rng, 16)
        bounds = ((-np.inf, np.inf), (0.0, np.inf), (-np.inf, 0.0))[index % 3]
        expected = one_contact(
            case.curvature,
            case.position,
            LENGTH,
            span=case.span,
            weight=case.weight,
            force_bounds=bounds,
        )
        near = case.position - 0.5 * case.span
        order = np.argsort(near, kind="stable")
        span = case.span[order]
        readings = Readings(
            case.curvature[order], near[order], span, inverse_spans(span), case.weight[order]
        )
        forces = ForceRange(float(bounds[0]), float(bounds[1]))
        found = fit_dense_l1(readings, LENGTH, forces, TOLERANCE)
        assert found[0] == pytest.approx(expected.objective, abs=2 * TOLERANCE * case.scale)
        arc, force = np.array([found[1]]), np.array([found[2]])
        assert objective(case, arc, force, 1) == pytest.approx(
            found[0], abs=2 * TOLERANCE * case.scale
        )
        assert found[5] < 1000, "arcs looked at: the bound must not bisect to the last bit"


def _profile_minimum(case: Case, norm: int, near: float) -> float:
    """Weighted medians (or projections) on a grid of arcs, fine around one place."""
    ends = np.concatenate([case.position - case.span / 2, case.position + case.span / 2])
    arcs = np.concatenate(
        [np.linspace(0.1, LENGTH, 1500), ends, near + np.linspace(-0.5, 0.5, 2001)]
    )
    best = np.inf
    for arc in arcs[(arcs > 0) & (arcs <= LENGTH)]:
        phi = case.weight * _influences(arc, case)
        y = case.weight * case.curvature
        used = phi > 0
        if not used.any():
            continue
        if norm == 1:
            ratio = y[used] / phi[used]
            order = np.argsort(ratio)
            sums = np.cumsum(phi[used][order])
            force = ratio[order][np.searchsorted(sums, 0.5 * sums[-1])]
            best = min(best, float(np.abs(y - force * phi).sum()))
        else:
            force = float(phi @ y / (phi @ phi))
            best = min(best, float(((y - force * phi) ** 2).sum()))
    return best


def _influences(arc: float, case: Case) -> np.ndarray:
    return influence(arc, case.position, case.span)
