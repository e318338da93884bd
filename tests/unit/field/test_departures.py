"""Departures from a prediction: derivatives by calibration's errors, noise, normal equations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from thigmo.field import Errors, Readings, Stage
from thigmo.field._departures import normal_equations
from thigmo.field.fit import FieldFit, Tables

BINS, SENSORS = 24, 4


def _fit(seed: int, model: float) -> tuple[FieldFit, Tables, np.ndarray]:
    """A fit to random readings with every kind of error, and tables and errors beside them."""
    rng = np.random.default_rng(seed)
    shape = BINS, SENSORS
    stage = np.repeat(np.arange(3), BINS // 3)
    curvature = 0.01 * rng.standard_normal(shape)
    curvature[3, 1] = curvature[BINS - 1] = np.nan
    readings = Readings(
        curvature=curvature,
        noise=rng.uniform(1e-4, 3e-4, shape),
        bend=rng.uniform(2e-3, 0.02, BINS),
        rate=rng.uniform(0.0, 0.01, BINS),
        stage=stage,
        sweep=stage,
        zeroing=np.minimum(stage, 1),
        stages=(Stage(40.0, 0), Stage(50.0, 0), Stage(53.0, 1)),
        centers=np.linspace(5.0, 45.0, SENSORS),
        spans=np.full(SENSORS, 5.0),
        fold_moment=np.array([0.01, 0.02]),
        radius=1.75,
        half_range=rng.uniform(0.0, 2e-3, BINS),
        response=rng.uniform(0.0, 2e-3, BINS),
        standing=rng.choice([0.0, 0.4, 1.0], BINS),
    )
    per_sensor = {
        name: sd * rng.uniform(0.5, 1.0, SENSORS)
        for name, sd in {
            "gain": 0.03, "place": 0.2, "zero": 2e-4, "zero_zeroing": 1e-4, "zero_sweep": 5e-5,
        }.items()
    }  # fmt: skip
    errors = Errors(
        **per_sensor, map_by_pressure=np.array([0.01, 0.02]), map_offset=8e-4, fold=0.1,
        shared=1e-4 * rng.standard_normal((SENSORS, 2)),
        against=np.full(SENSORS, 0.6), against_error=np.full(SENSORS, 0.2),
    )  # fmt: skip
    fit = FieldFit(readings, errors, model=model)
    rows = 3, fit.bends.size, SENSORS
    tables = Tables(
        [],
        np.cumsum(2e-3 * rng.standard_normal(rows), axis=1),
        np.broadcast_to(1e-4 * rng.standard_normal((3, 1, SENSORS)), rows).copy(),
        np.zeros((*rows, 0)),
        np.zeros((*rows[:2], 0, 4)),
    )
    return fit, tables, 0.5 * rng.standard_normal(fit.count)


@pytest.mark.parametrize("seed", range(4))
def test_derivatives_are_those_of_the_prediction(seed: int) -> None:
    fit, tables, xi = _fit(seed, model=0.0)
    exact = fit.departures(tables, xi, spread=1.3).effect.dense()
    step = 1e-6
    for n, unit in enumerate(np.eye(fit.count)):
        high, low = (
            fit.departures(tables, xi + way * step * unit, spread=1.3).value for way in (1, -1)
        )
        by_difference = (high - low) / (2 * step)
        assert np.abs(by_difference).max() > 1e-7
        # What the tables bend at a row has two derivatives, a sensor at no curvature as well.
        assert np.quantile(np.abs(exact[..., n] - by_difference), 0.95) < 1e-9


def test_the_mechanics_error_is_a_share_of_what_a_contact_adds() -> None:
    fit, tables, xi = _fit(4, model=0.2)
    known = xi.copy()
    known[-SENSORS:] = 0.0
    more = fit.departures(tables, xi).value - fit.departures(tables, known).value
    added = fit.departures(tables, known).effect.separate[..., -1]
    assert more == pytest.approx(added * xi[-SENSORS:])
    free = FieldFit(replace(fit.readings, standing=np.zeros(BINS)), fit.errors, model=0.2)
    assert free.departures(tables, xi).effect.separate[..., -1] == pytest.approx(0.0)


@pytest.mark.parametrize("model", [0.0, 0.2])
@pytest.mark.parametrize("seed", range(4))
def test_normal_equations_are_those_of_the_whitened_departures(seed: int, model: float) -> None:
    fit, tables, xi = _fit(seed, model)
    d = fit.departures(tables, xi)
    by_q = np.random.default_rng(seed).standard_normal((BINS, SENSORS, 3))
    z = d.noise.whitened(d.left)
    assert d.squares == pytest.approx(z @ z)
    assert (z.reshape(BINS, SENSORS)[fit.missing] == 0.0).all()
    for given, dense in (
        (None, d.effect.dense()),
        (by_q, np.concatenate([by_q, d.effect.dense()], axis=2)),
    ):
        white = d.noise.whitened(dense)
        matrix, right = d.normal(given)
        assert matrix == pytest.approx(white.T @ white, rel=1e-9, abs=1e-9 * np.abs(matrix).max())
        assert right == pytest.approx(white.T @ z, rel=1e-9, abs=1e-9 * np.abs(right).max())


def test_the_noise_is_that_of_readings_bends_and_mechanics() -> None:
    fit, tables, xi = _fit(1, model=0.2)
    d = fit.departures(tables, xi)
    present = ~fit.missing
    added = 0.2 * (d.value - d.bend[:, None])
    white = fit.readings.noise * 2**0.5  # two bins count as one reading
    assert d.noise.weight[present] == pytest.approx(1 / np.hypot(white, added)[present])
    volume = 0.0
    for n in range(BINS):
        on = present[n]
        covariance = np.diag(d.noise.weight[n, on] ** -2.0)
        bend = d.noise.along[n, on] / d.noise.weight[n, on]
        volume += np.linalg.slogdet(covariance + np.outer(bend, bend))[1]
        volume -= 2 * np.log(white[n, on]).sum()
    assert d.volume == pytest.approx(volume)


def test_a_touch_that_is_gone_leaves_the_free_body() -> None:
    fit, tables, _ = _fit(2, model=0.0)
    readings = replace(fit.readings, standing=np.zeros(BINS))
    d = FieldFit(readings, fit.errors).departures(tables, fit.free())
    assert d.value == pytest.approx(np.tile(d.bend[:, None], (1, SENSORS)))


def test_arrays_that_do_not_fit_are_refused() -> None:
    fit, tables, xi = _fit(3, model=0.0)
    with pytest.raises(ValueError, match="differ in shape"):
        fit.departures(tables, xi[:-1])
    with pytest.raises(ValueError, match="differ in shape"):
        fit.departures(tables._replace(mean=tables.mean[:, :-1]), xi)
    with pytest.raises(ValueError, match="differ in shape"):
        normal_equations(*(np.zeros((2, 3, 1)),) * 2, *(np.zeros((2, 2)),) * 3)
