"""What the exact solvers promise besides the optimum: sets, units, gaps, batches, typed errors."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from exact_oracles import LENGTH, influence, inner_minimum, random_case
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from thigmo.errors import DataError
from thigmo.localization.exact import (
    one_contact,
    one_contact_batch,
    several_contacts,
    solve,
)
from thigmo.localization.exact.absolute_descent import Descent, descend
from thigmo.localization.exact.absolute_fit import SignedFit
from thigmo.localization.exact.knots import best_knots
from thigmo.localization.exact.one_contact_l1 import fit_l1_rows
from thigmo.localization.exact.one_contact_l2 import fit_l2_rows

BOTH = np.tile([5.0, 15.0, 25.0, 35.0, 45.0], 2)


def profile(case, arc: float, norm: int, bounds: tuple[float, float]) -> float:
    return float(
        inner_minimum(
            np.array([arc]),
            case.curvature,
            case.position,
            case.span,
            case.weight,
            float(bounds[0]),
            float(bounds[1]),
            norm,
        )
    )


@pytest.mark.parametrize("norm", [1, 2])
def test_the_set_holds_every_optimal_arc_and_no_other(norm: int) -> None:
    rng = np.random.default_rng(3)
    wide = 0
    for _ in range(400):
        case = random_case(rng, 10)
        solution = one_contact(
            case.curvature,
            case.position,
            LENGTH,
            span=case.span,
            weight=case.weight,
            norm=1 if norm == 1 else 2,
            force_bounds=case.bounds,
        )
        scale = max(case.scale if norm == 1 else case.square_scale, solution.objective)
        ranges = solution.ranges[0]
        assert ranges
        for low, high in ranges:
            wide += high - low > 0.3
            for share in (1e-6, 0.3, 0.7, 1.0):
                value = profile(case, low + share * (high - low), norm, case.bounds)
                assert value <= solution.objective + 1e-6 * scale + 1e-30
        for arc in np.linspace(0.0, LENGTH, 150):
            if profile(case, arc, norm, case.bounds) <= solution.objective + 1e-13 * scale:
                # A least-squares valley is flat to rounding somewhat beyond its set's tolerance.
                assert any(low - 0.1 <= arc <= high + 0.1 for low, high in ranges)
    assert wide > 20


def test_left_and_right_sensors_leave_a_flat_optimum() -> None:
    rng = np.random.default_rng(4)
    clean = 3e-4 * influence(41.0, BOTH, np.full(10, 5.5))
    batch = one_contact_batch(clean + 6e-4 * rng.standard_normal((500, 10)), BOTH, LENGTH, span=5.5)
    width = batch.high - batch.low
    assert 0.3 < np.mean(width > 0.3) < 0.8
    assert np.all(batch.low <= batch.arc)
    assert np.all(batch.arc <= batch.high)


@pytest.mark.parametrize("norm", [1, 2])
@pytest.mark.parametrize("contacts", [1, 2, 3])
def test_units_only_scale_the_answer(norm: int, contacts: int) -> None:
    rng = np.random.default_rng(5)
    norm_ = 1 if norm == 1 else 2
    for _ in range(15):
        case = random_case(rng, 9, contacts)
        answers = []
        for unit in (1.0, 10.0, 0.01):  # cm, mm, m
            solution = several_contacts(
                case.curvature / unit,
                case.position * unit,
                LENGTH * unit,
                contacts=contacts,
                span=case.span * unit,
                weight=case.weight,
                norm=norm_,
            )
            plain = one_contact(
                case.curvature / unit,
                case.position * unit,
                LENGTH * unit,
                span=case.span * unit,
                weight=case.weight,
                norm=norm_,
            )
            answers.append((solution.objective * unit**norm, plain.objective * unit**norm))
        scale = case.scale if norm == 1 else case.square_scale
        assert np.ptp(np.array(answers), axis=0) == pytest.approx(0.0, abs=2e-9 * scale)


def test_missing_sensors_are_as_if_they_were_not_there() -> None:
    rng = np.random.default_rng(6)
    for norm in (1, 2):
        norm_ = 1 if norm == 1 else 2
        for _ in range(50):
            case = random_case(rng, 10)
            gone = rng.random(len(case.curvature)) < 0.3
            holed = np.where(gone, np.nan, case.curvature)
            kept = ~gone
            for fit, options in ((one_contact, {}), (several_contacts, {"contacts": 2})):
                full = fit(
                    holed,
                    case.position,
                    LENGTH,
                    span=case.span,
                    weight=case.weight,
                    norm=norm_,
                    **options,
                )
                less = fit(
                    case.curvature[kept],
                    case.position[kept],
                    LENGTH,
                    span=case.span[kept],
                    weight=case.weight[kept],
                    norm=norm_,
                    **options,
                )
                assert full.objective == pytest.approx(less.objective, rel=1e-9, abs=1e-18)


def test_nothing_felt_says_nothing_of_the_arc() -> None:
    for y in (np.zeros(10), np.full(10, np.nan), np.zeros(0)):
        x = BOTH[: len(y)]
        solution = one_contact(y, x, LENGTH, span=5.5)
        assert solution.objective == 0.0
        assert solution.force[0] == 0.0
        assert solution.ranges == (((0.0, LENGTH),),)
        assert several_contacts(y, x, LENGTH, contacts=3, span=5.5).objective == 0.0


def test_one_informative_sensor_gives_its_interval() -> None:
    y = np.array([4e-3, 0.0, 0.0])
    for norm in (1, 2):
        solution = one_contact(y, [5.0, 15.0, 25.0], LENGTH, span=5.5, norm=1 if norm == 1 else 2)
        assert solution.objective == pytest.approx(0.0, abs=1e-12)
        ((low, high),) = solution.ranges[0]
        assert low == pytest.approx(2.25, abs=1e-6)
        assert high == pytest.approx(12.25, abs=0.02)


def test_ranges_of_two_contacts_hold_optima() -> None:
    rng = np.random.default_rng(8)
    flat = 0
    for norm in (1, 2):
        for _ in range(6):
            span = np.full(10, 5.5)
            y = 5e-4 * (influence(27.0, BOTH, span) - influence(44.0, BOTH, span))
            y += 6e-4 * rng.standard_normal(10)
            norm_ = 1 if norm == 1 else 2
            solution = several_contacts(
                y, BOTH, LENGTH, contacts=2, span=5.5, norm=norm_, optimum_set=True
            )
            limit = 20.0 * np.abs(y).max() / LENGTH
            scale = np.abs(y).sum() if norm == 1 else (y**2).sum()
            for j, ((low, high),) in enumerate(solution.ranges):
                assert low - 1e-6 <= solution.arc[j] <= high + 1e-6
                flat += high - low > 0.3
                # With this contact held at an end of its range, the other finds the optimum.
                for end in (low, high):
                    others = np.concatenate([np.linspace(0, LENGTH, 1061), solution.arc])
                    best = min(
                        inner_minimum(
                            np.array([end, other]),
                            y,
                            BOTH,
                            span,
                            np.ones(10),
                            -limit,
                            limit,
                            norm,
                        )
                        for other in others
                    )
                    assert best <= solution.objective + 1e-3 * scale
    assert flat > 4


def test_a_search_cut_short_says_so() -> None:
    rng = np.random.default_rng(9)
    x = np.linspace(3.0, 48.0, 10)
    y = 3e-3 * rng.standard_normal(10)
    full = several_contacts(y, x, LENGTH, contacts=3, span=5.5)
    cut = several_contacts(y, x, LENGTH, contacts=3, span=5.5, max_nodes=20)
    assert full.gap <= 1.1e-9 * np.abs(y).sum()
    assert cut.gap > full.gap
    assert cut.objective - cut.gap <= full.objective <= cut.objective


def test_signs_and_limits_of_forces_hold() -> None:
    rng = np.random.default_rng(10)
    span = np.full(10, 5.5)
    for norm in (1, 2):
        for _ in range(10):
            y = 4e-4 * (influence(20.0, BOTH, span) - influence(46.0, BOTH, span))
            y += 6e-4 * rng.standard_normal(10)
            norm_ = 1 if norm == 1 else 2
            either = several_contacts(y, BOTH, LENGTH, contacts=2, span=5.5, norm=norm_)
            left = several_contacts(y, BOTH, LENGTH, contacts=2, span=5.5, norm=norm_, sign=1)
            weak = several_contacts(
                y, BOTH, LENGTH, contacts=2, span=5.5, norm=norm_, force_limit=2e-4
            )
            assert np.all(left.force >= 0.0)
            assert np.all(np.abs(weak.force) <= 2e-4 * (1 + 1e-9))
            assert left.objective >= either.objective * (1 - 1e-9)
            assert weak.objective >= either.objective * (1 - 1e-9)


def test_a_batch_is_its_rows() -> None:
    rng = np.random.default_rng(11)
    y = 2e-3 * rng.standard_normal((400, 8))
    y[rng.random(y.shape) < 0.1] = np.nan
    x = np.sort(rng.uniform(0, 50, (400, 8)), axis=1)
    lengths = rng.uniform(50, 60, 400)
    spans = rng.uniform(0, 8, (400, 8))
    weights = rng.uniform(0.5, 2, (400, 8))
    for norm in (1, 2):
        norm_ = 1 if norm == 1 else 2
        many = [
            one_contact_batch(
                y, x, lengths, span=spans, weight=weights, norm=norm_, threads=threads
            )
            for threads in (1, 3)
        ]
        assert np.array_equal(many[0].objective, many[1].objective)
        for b in range(400):
            one = one_contact(y[b], x[b], lengths[b], span=spans[b], weight=weights[b], norm=norm_)
            assert many[0].objective[b] == one.objective
            assert many[0].arc[b] == one.arc[0]
            assert many[0].low[b] == one.ranges[0][0][0]
            assert many[0].high[b] == one.ranges[0][-1][1]


def test_rows_are_compiled_once_whatever_arrays_they_are_given_in() -> None:
    """Twice compiled code may differ in the last digit, and costs seconds: no read-only arrays."""
    y = np.linspace(-1e-3, 1e-3, 8).reshape(1, 8)
    for kernel, norm in ((fit_l1_rows, 1), (fit_l2_rows, 2)):
        norm_ = 1 if norm == 1 else 2
        for rows in (y, y[:, ::-1], np.asfortranarray(np.repeat(y, 3, axis=0)), _frozen(y)):
            where, point = _frozen(np.arange(8.0)), _frozen(y * 0)
            one_contact_batch(rows, where, 53.0, span=point, norm=norm_)
            one_contact(rows[0], np.arange(8.0), 53, tolerance=1, norm=norm_)
        assert len(kernel.signatures) == 1


def _frozen(array: np.ndarray) -> np.ndarray:
    copy = array.copy()
    copy.flags.writeable = False
    return copy


def test_knots_on_a_grid_are_the_best_ones() -> None:
    rng = np.random.default_rng(12)
    for _ in range(40):
        n, contacts = int(rng.integers(6, 40)), int(rng.integers(1, 4))
        x = np.sort(rng.uniform(0, LENGTH, n))
        y = rng.standard_normal(n)
        w = rng.uniform(0.5, 2, n)
        knots = np.sort(rng.uniform(0, LENGTH, 11))
        values, index = np.empty(3), np.empty((3, contacts), dtype=np.int64)
        best_knots(x, y, w, knots, contacts, values, index)
        best = np.inf
        for pick in itertools.combinations(range(11), contacts):
            model = np.maximum(knots[list(pick)] - x[:, None], 0.0) * w[:, None]
            forces = np.linalg.lstsq(model, y * w, rcond=None)[0]
            best = min(best, float(((y * w - model @ forces) ** 2).sum()))
        assert values[0] == pytest.approx(best, rel=1e-7)
        assert np.all(np.diff(values[np.isfinite(values)]) >= 0)


def test_descent_reaches_the_least_deviations_from_any_start() -> None:
    rng = np.random.default_rng(15)
    for _ in range(60):
        n, m = int(rng.integers(8, 60)), int(rng.integers(1, 7))
        g, y, w = rng.standard_normal((m, n)), rng.standard_normal(n), rng.uniform(0.3, 3.0, n)
        if rng.random() < 0.3:
            y = np.round(y)  # ties
        basis, beta = rng.permutation(n)[:m], np.empty(m)
        room = Descent(
            *np.empty((5, n)),
            np.empty(n, np.int64),
            np.empty((m, 2 * m)),
            np.empty((m, m)),
            np.empty(m),
        )
        value = descend(SignedFit(g, y, w, np.zeros(m, np.int64)), m, basis, beta, room)
        eye = np.eye(n)
        best = linprog(
            np.concatenate([np.zeros(m), w]),
            A_ub=np.block([[g.T, -eye], [-g.T, -eye]]),
            b_ub=np.concatenate([y, -y]),
            bounds=[(None, None)] * m + [(0.0, None)] * n,
            method="highs",
        ).fun
        assert value == pytest.approx(best, rel=1e-7)
        assert float((w * np.abs(y - beta @ g)).sum()) == pytest.approx(value, rel=1e-9)
        np.testing.assert_allclose(beta @ g[:, basis], y[basis], atol=1e-8)


@pytest.mark.parametrize("norm", [1, 2])
def test_a_thousand_gratings_resolve_three_contacts(norm: int) -> None:
    rng = np.random.default_rng(13)
    x = np.linspace(0.3, 52.7, 1000)
    arcs, forces = np.array([18.0, 33.0, 47.0]), np.array([4e-4, -5e-4, 6e-4])
    y = sum(f * np.maximum(a - x, 0.0) for a, f in zip(arcs, forces, strict=True))
    y = y + 1e-4 * rng.standard_normal(1000)
    if norm == 1:
        y[rng.integers(0, 1000, 20)] += 0.02
    solution = several_contacts(y, x, LENGTH, contacts=3, norm=1 if norm == 1 else 2)
    assert solution.gap == np.inf
    np.testing.assert_allclose(solution.arc, arcs, atol=0.3)
    np.testing.assert_allclose(solution.force, forces, atol=4e-5)
    model = sum(f * np.maximum(a - x, 0.0) for a, f in zip(arcs, forces, strict=True))
    truth = np.abs(y - model).sum() if norm == 1 else ((y - model) ** 2).sum()
    assert solution.objective <= truth


def test_refined_knots_reach_the_proven_optimum(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(14)
    x = np.linspace(0.3, 52.7, 60)
    for contacts in (2, 3):
        for _ in range(4):
            arcs = np.sort(rng.uniform(8, LENGTH, contacts))
            forces = rng.uniform(2e-4, 6e-4, contacts) * rng.choice([-1, 1], contacts)
            y = np.maximum(arcs - x[:, None], 0.0) @ forces + 3e-4 * rng.standard_normal(60)
            proven = several_contacts(y, x, LENGTH, contacts=contacts, norm=2)
            with monkeypatch.context() as patch:
                patch.setattr(solve, "BOUNDED", {2: 0, 3: 0})
                dense = several_contacts(y, x, LENGTH, contacts=contacts, norm=2)
            assert np.isfinite(proven.gap)
            assert not np.isfinite(dense.gap)
            assert dense.objective <= proven.objective * (1 + 1e-6)


@settings(max_examples=150, deadline=None)
@given(
    st.lists(st.floats(-1e3, 1e3) | st.just(float("nan")), min_size=1, max_size=6),
    st.floats(1e-3, 1e6),
    st.floats(0.0, 1.0),
    st.integers(0, 2**32 - 1),
    st.sampled_from([1, 2]),
)
def test_any_finite_input_gives_a_finite_answer(
    values: list[float], length: float, span: float, seed: int, norm: int
) -> None:
    rng = np.random.default_rng(seed)
    x = rng.uniform(-0.2, 1.2, len(values)) * length
    options = {"span": span * length, "norm": norm}
    for solution in (
        one_contact(values, x, length, **options),
        several_contacts(values, x, length, contacts=2, max_nodes=20_000, **options),
    ):
        assert np.isfinite(solution.objective)
        assert np.isfinite(solution.force).all()
        assert np.all((solution.arc >= 0) & (solution.arc <= length))
        felt = np.abs(np.nan_to_num(values))
        assert solution.objective <= (felt.sum() if norm == 1 else (felt**2).sum()) * (1 + 1e-9)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"curvature": [1e-3, np.inf]}, "infinite"),
        ({"curvature": [1e-3]}, "position"),
        ({"position": [5.0, np.nan]}, "position"),
        ({"span": [-1.0, 5.0]}, "span"),
        ({"weight": [1.0, 1.0, 1.0]}, "weight"),
        ({"length": 0.0}, "length"),
        ({"length": np.nan}, "length"),
        ({"force_bounds": (1.0, 0.0)}, "force_bounds"),
    ],
)
def test_unusable_input_is_named(change: dict[str, object], what: str) -> None:
    given_ = {"curvature": [1e-3, 1e-3], "position": [5.0, 15.0], "length": LENGTH} | change
    with pytest.raises(DataError, match=what):
        one_contact(given_.pop("curvature"), given_.pop("position"), given_.pop("length"), **given_)


def test_unusable_requests_for_several_contacts_are_named() -> None:
    with pytest.raises(DataError, match="4 contacts"):
        several_contacts([0.0], [5.0], LENGTH, contacts=4)
    with pytest.raises(DataError, match="force_limit"):
        several_contacts([0.0], [5.0], LENGTH, contacts=2, force_limit=-1.0)
