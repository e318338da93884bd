"""The evidence is that of dense normal densities, integrated by quadrature; batches are rows."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

import thigmo
from thigmo.localization import Localizer, localize_batch, priors
from thigmo.mechanics.closed_forms import phi
from thigmo_bench.studies.scenes import STATED

LENGTH, SPAN, NOISE = 53.0, 5.5, 6e-4
POSITION = np.tile(np.arange(5.0, 50.0, 10.0), 2)
ERRORS = {"gain_error": 0.05, "offset_error": 3e-4, "map_error": 0.04}


def weighed(curvature, free, **options):
    """{(load, bad reading): log weight} of one frame, summed over a kink's places."""
    options = STATED | options
    options |= {"position": POSITION, "length": LENGTH, "span": SPAN, "noise": NOISE}
    localizer = Localizer.of(**options)._compiled
    free_row = np.full(1, free)
    answer = localizer.localize(curvature, free_row, free_row)
    assert answer.problem == 0
    weights = {}
    for load, bad, weight in answer.weighed:
        weights[load, bad] = np.logaddexp(weights.get((load, bad), -np.inf), weight)
    return weights


def covariance(curvature, free, factor):
    y, g = curvature * LENGTH, np.full(len(curvature), free * LENGTH)
    floor = priors.TRUST * max(np.abs(y - g).max(), np.abs(g).max())
    variance = (factor * NOISE * LENGTH) ** 2 + (ERRORS["gain_error"] * y) ** 2 + floor**2
    common = (ERRORS["offset_error"] * LENGTH) ** 2
    return np.diag(variance) + common + ERRORS["map_error"] ** 2 * np.outer(g, g), y - g


@pytest.mark.parametrize("free", [0.0, 0.004])
def test_log_weights_are_those_of_dense_normal_densities(free):
    rng = np.random.default_rng(5)
    levers = phi(40.0, POSITION, SPAN)
    curvature = free + 4e-5 * levers + NOISE * rng.standard_normal(10)
    curvature[3] += 4e-3
    log_odds = weighed(curvature, free, **ERRORS)
    # One reading fits no contact, so the noise may be larger than stated.
    levels = (
        (1.0, 1.0 - sum(priors.NOISE_ODDS)),
        (priors.NOISE_FACTORS[0], sum(priors.NOISE_ODDS)),
    )

    def log_density(more, bad=False):
        log_densities = []
        for factor, odds in levels:
            dense, excess = covariance(curvature, free, factor)
            if bad:
                dense[3, 3] += priors.BAD_DEVIATION**2 + (free * LENGTH) ** 2
            density = multivariate_normal(np.zeros(10), dense + more).logpdf(excess)
            log_densities.append(density + np.log(odds * (priors.BAD_READING if bad else 1.0)))
        return logsumexp(log_densities)

    assert log_odds["free body", -1] == pytest.approx(log_density(0.0), abs=1e-6)
    assert log_odds["free body", 3] == pytest.approx(log_density(0.0, bad=True), abs=1e-6)
    if free:
        return  # the levers of a contact are then those of a bent body
    for which in (-1, 3):
        log_densities = []
        for arc in (np.arange(400) + 0.5) / 400:
            column = phi(arc, POSITION / LENGTH, SPAN / LENGTH)
            for scale in priors.MOMENTS:
                deviation = scale / max(arc, priors.LEAST_LEVER)
                log_prior = log_density(deviation**2 * np.outer(column, column), which >= 0)
                log_densities.append(log_prior + np.log(priors.place_density(arc)))
        weight = logsumexp(log_densities) - np.log(len(log_densities)) + priors.CONTACT
        assert log_odds["one contact", which] == pytest.approx(weight, abs=0.02)


def dense(curvature, columns, *, doubted, mean=0.0):
    """(S,) log densities of readings less `mean` under sets of shared columns (S, K, N)."""
    levels = ((1.0, 0.0),)
    if doubted:
        levels = (
            (1.0, np.log1p(-sum(priors.NOISE_ODDS))),
            (priors.NOISE_FACTORS[0], np.log(sum(priors.NOISE_ODDS))),
        )
    y = curvature * LENGTH
    left = np.broadcast_to(y - mean, (len(columns), y.size))
    log_densities = []
    for factor, log_odds in levels:
        white = (factor * NOISE * LENGTH) ** 2 + (priors.TRUST * np.abs(y).max()) ** 2
        total = np.einsum("ski,skj->sij", columns, columns) + white * np.eye(y.size)
        square = np.einsum("si,si->s", left, np.linalg.solve(total, left[..., None])[..., 0])
        size = y.size * np.log(2.0 * np.pi)
        log_densities.append(log_odds - 0.5 * (square + np.linalg.slogdet(total)[1] + size))
    return logsumexp(log_densities, axis=0)


def levers_at(arcs):
    """(S, K, N) mean levers of forces at arcs (S, K) of a straight body of length one."""
    return phi(arcs[..., None], POSITION / LENGTH, SPAN / LENGTH)


def mean_of(logs):
    return logsumexp(logs) - np.log(np.size(logs))


@pytest.mark.parametrize(
    ("count", "cells", "load"), [(2, 24, "two contacts"), (3, 12, "three contacts")]
)
def test_several_contacts_are_weighed_as_dense_normal_densities(count, cells, load):
    curvature = 3e-5 * (phi(46.0, POSITION, SPAN) - 1.5 * phi(24.0, POSITION, SPAN))
    curvature += 0.3 * NOISE * np.random.default_rng(2).standard_normal(10)
    log_odds = weighed(curvature, 0.0, contacts=count, critical_curvature=np.inf, held_end=False)
    plain = dense(curvature, np.zeros((1, 1, 10)), doubted=False)[0]
    doubted = (log_odds["free body", -1] - plain) ** 2 > 1e-9
    middles = (np.arange(cells) + 0.5) / cells
    arcs = np.stack(np.meshgrid(*[middles] * count, indexing="ij"), -1).reshape(-1, count)
    arcs = arcs[(np.diff(arcs, axis=1) > 0.0).all(axis=1)]  # base to tip, each in its own cell
    logs = [
        dense(
            curvature,
            scale / np.maximum(arcs, priors.LEAST_LEVER)[..., None] * levers_at(arcs),
            doubted=doubted,
        )
        for scale in priors.MOMENTS
    ]
    logs += np.log(priors.place_density(arcs)).sum(axis=1)
    weight = mean_of(logs) + priors.CONTACT + (count - 1) * priors.ANOTHER
    assert log_odds[load, -1] == pytest.approx(weight, abs=1e-6)


def test_a_bad_reading_that_rescues_two_contacts_is_weighed_as_dense_normal_densities():
    # Two contacts are hopeless until the bad reading is left out.
    rng = np.random.default_rng(5)
    curvature = 3e-5 * (phi(46.0, POSITION, SPAN) - 1.5 * phi(24.0, POSITION, SPAN))
    curvature += NOISE * rng.standard_normal(10)
    curvature[3] += 0.01
    log_odds = weighed(curvature, 0.0, critical_curvature=np.inf, held_end=False, end_face_odds=0.0)
    middles = (np.arange(24) + 0.5) / 24
    arcs = np.stack(np.meshgrid(middles, middles, indexing="ij"), -1).reshape(-1, 2)
    arcs = arcs[arcs[:, 0] < arcs[:, 1]]
    bad = priors.BAD_DEVIATION * np.broadcast_to(np.arange(10) == 3, (len(arcs), 1, 10))

    def two(beside):
        logs = [
            dense(
                curvature,
                np.concatenate(
                    [
                        scale / np.maximum(arcs, priors.LEAST_LEVER)[..., None] * levers_at(arcs),
                        beside,
                    ],
                    axis=1,
                ),
                doubted=True,
            )
            for scale in priors.MOMENTS
        ]
        logs += np.log(priors.place_density(arcs)).sum(axis=1)
        return mean_of(logs) + priors.CONTACT + priors.ANOTHER

    rescued = two(bad) + math.log(priors.BAD_READING)
    assert two(np.zeros((len(arcs), 1, 10))) < rescued - 15.0
    assert log_odds["two contacts", 3] == pytest.approx(rescued, abs=0.05)


def kinks():
    """(H, N) readings of one deviation of a kink between all ends of sensors, and their widths."""
    low, high = ((POSITION + side * SPAN / 2) / LENGTH for side in (-1.0, 1.0))
    edges = np.unique(np.r_[low, high])
    middles = 0.5 * (edges[1:] + edges[:-1])
    inside = (low < middles[:, None]) & (middles[:, None] < high)
    covered = inside.any(axis=1)
    return (priors.ANGLE * inside / (high - low))[covered], np.diff(edges)[covered]


def test_kinks_are_weighed_as_dense_normal_densities():
    curvature = 1.5e-5 * phi(45.0, POSITION, SPAN) + 0.2 * kinks()[0][2] / LENGTH
    curvature += NOISE * np.random.default_rng(4).standard_normal(10)
    options = {"contacts": 1, "critical_curvature": np.inf, "held_end": False}
    log_weight = weighed(curvature, 0.0, **options)
    columns, widths = kinks()
    log_odds = priors.HINGE + np.log(widths)
    alone = dense(curvature, columns[:, None], doubted=True) + log_odds
    assert log_weight["hinge", -1] == pytest.approx(logsumexp(alone), abs=1e-6)
    arcs = ((np.arange(200) + 0.5) / 200)[:, None]
    log_densities = []
    for column, odds in zip(columns, log_odds, strict=True):
        beside = np.broadcast_to(column, (len(arcs), 1, 10))
        logs = [
            dense(
                curvature,
                np.concatenate([scale / arcs[..., None] * levers_at(arcs), beside], axis=1),
                doubted=True,
            )
            for scale in priors.MOMENTS
        ]
        logs += np.log(priors.place_density(arcs[:, 0]))
        log_densities.append(mean_of(logs) + odds + priors.CONTACT)
    assert log_weight["one contact, hinge", -1] == pytest.approx(logsumexp(log_densities), abs=0.05)


def test_a_held_end_is_weighed_as_dense_normal_densities():
    curvature = 2e-5 * phi(LENGTH, POSITION, SPAN) + 5e-4
    curvature += NOISE * np.random.default_rng(6).standard_normal(10)
    log_odds = weighed(curvature, 0.0, critical_curvature=np.inf, held_end=True, contacts=1)
    plain = dense(curvature, np.zeros((1, 1, 10)), doubted=False)[0]
    doubted = (log_odds["free body", -1] - plain) ** 2 > 1e-9
    loads = np.stack([levers_at(np.ones(1))[0], np.ones(10)])  # the tangential force bends nothing
    logs = [dense(curvature, scale * loads[None], doubted=doubted) for scale in priors.MOMENTS]
    assert log_odds["end wrench", -1] == pytest.approx(mean_of(logs) + priors.CONTACT, abs=0.02)


def test_a_folded_base_is_weighed_as_dense_normal_densities():
    critical, error, radius = 0.002, 0.1, 1.75
    low, high = ((POSITION + side * SPAN / 2) / LENGTH for side in (-1.0, 1.0))
    diameter = 2.0 * radius / LENGTH
    fold = np.maximum(np.minimum(high, diameter) - low, 0.0) / (high - low) / diameter
    curvature = critical / 40.0 * phi(40.0, POSITION, SPAN) + 0.1 * fold / LENGTH
    curvature += NOISE * np.random.default_rng(8).standard_normal(10)
    log_odds = weighed(
        curvature, 0.0, critical_curvature=critical, critical_curvature_error=error,
        tube_radius=radius, contacts=1, held_end=False, end_face_odds=0.0,
    )  # fmt: skip
    plain = dense(curvature, np.zeros((1, 1, 10)), doubted=False)[0]
    doubted = (log_odds["free body", -1] - plain) ** 2 > 1e-9
    arcs, angles = (np.arange(60) + 0.5) / 60, np.linspace(0.0, 4.0, 401)[:, None]
    half = np.full((401, 1), angles[1, 0] * 2.0 / np.sqrt(2.0 * np.pi)) * np.exp(-0.5 * angles**2)
    half[0] *= 0.5
    log_densities = []
    for arc in arcs[arcs >= 0.02]:
        levers = critical * LENGTH / arc * levers_at(np.array(arc))
        for sign in (-1.0, 1.0):
            logs = dense(
                curvature, np.broadcast_to(error * levers, (401, 1, 10)), doubted=doubted,
                mean=sign * (levers + priors.ANGLE * angles * fold),
            )  # fmt: skip
            log_evidence = logsumexp(logs + np.log(half[:, 0])) - np.log(2.0)
            log_densities.append(log_evidence + np.log(priors.place_density(arc)))
    within = [math.erf(critical * LENGTH / (np.sqrt(2.0) * m)) for m in priors.MOMENTS]
    weight = logsumexp(log_densities) - np.log(60) + priors.CONTACT + np.log(1.0 - np.mean(within))
    assert log_odds["one contact, folded base", -1] == pytest.approx(weight, abs=0.05)


def fold_shares(radius):
    """(N,) readings of a fold of one radian over the first diameter of the body."""
    low, high = ((POSITION + side * SPAN / 2) / LENGTH for side in (-1.0, 1.0))
    return np.maximum(np.minimum(high, 2.0 * radius) - low, 0.0) / (high - low) / (2.0 * radius)


@pytest.mark.parametrize("correlation", [0.0, 0.5])
def test_mistakes_are_weighed_as_dense_normal_densities(correlation, monkeypatch):
    monkeypatch.setattr(priors, "DROPPED_ROW", -1e3)  # leave none out
    free = 0.0015
    curvature = free + 4e-5 * phi(40.0, POSITION, SPAN)
    curvature += NOISE * np.random.default_rng(5).standard_normal(10)
    unstated = dict.fromkeys(("map_error", "offset_error", "base_fold_error"))
    log_odds = weighed(
        curvature, free, **unstated, largest_noise_factor=1.0, noise_correlation=correlation
    )
    y, g = curvature * LENGTH, np.full(10, free * LENGTH)
    floor = priors.TRUST * max(np.abs(y - g).max(), np.abs(g).max())
    white = (NOISE * LENGTH) ** 2 + floor**2
    rank = np.argsort(np.argsort(POSITION, kind="stable"))
    covariance = white * correlation ** np.abs(rank[:, None] - rank)
    slight = [priors.SLIGHT_MAP * g, np.full(10, priors.SLIGHT_OFFSET * NOISE * LENGTH)]
    fold = priors.SMALL_FOLD * fold_shares(priors.TUBE_RADIUS)
    rows = [
        (priors.SLIGHT_MAP_ODDS + priors.SLIGHT_OFFSET_ODDS, 0.0, slight),
        (priors.TURNED_ODDS, 2.0 * g, slight),
        (priors.TURNED_ODDS, g, slight),
        (priors.FAR_ODDS, 0.0, [g, np.ones(10)]),
        (priors.SMALL_FOLD_ODDS, 0.0, [fold]),
    ]
    rows.append((1.0 - sum(odds for odds, *_ in rows), 0.0, []))
    log_densities = []
    for odds, shift, columns in rows:
        total = covariance + sum(
            (np.outer(column, column) for column in columns), np.zeros((10, 10))
        )
        log_densities.append(
            np.log(odds) + multivariate_normal(np.zeros(10), total).logpdf(y - g + shift)
        )
    assert log_odds["free body", -1] == pytest.approx(logsumexp(log_densities), abs=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_mistakes_that_are_left_out_hardly_change_the_evidence(seed, monkeypatch):
    rng = np.random.default_rng(seed)
    free = rng.choice([-1.0, 1.0]) * rng.uniform(0.0, 0.03)
    curvature = free + rng.uniform(2e-5, 2e-4) * phi(rng.uniform(20.0, 50.0), POSITION, SPAN)
    curvature += NOISE * rng.standard_normal(10)
    options = {"length": LENGTH, "span": SPAN, "noise": NOISE, "free_curvature": free}
    usual = thigmo.localize(curvature, POSITION, **options)
    monkeypatch.setattr(priors, "DROPPED_ROW", -1e3)
    undropped = thigmo.localize(curvature, POSITION, **options)
    assert usual.log_evidence == pytest.approx(undropped.log_evidence, abs=0.1)
    assert usual.status == undropped.status


def test_an_edited_prior_changes_the_answers_of_the_next_localizer(monkeypatch):
    curvature = 2.5e-5 * phi(45.0, POSITION, SPAN)
    options = {"length": LENGTH, "span": SPAN, "noise": NOISE, **STATED}
    before = thigmo.localize(curvature, POSITION, **options).log_odds
    monkeypatch.setattr(priors, "CONTACT", priors.CONTACT - 1.0)
    after = thigmo.localize(curvature, POSITION, **options).log_odds
    assert after == pytest.approx(before - 1.0, abs=1e-6)


@pytest.mark.parametrize("jobs", [1, 3])
def test_a_batch_is_localize_row_by_row(jobs):
    rng = np.random.default_rng(8)
    free = rng.uniform(-0.04, 0.04, 40)
    rows = np.array([
        g + rng.uniform(-3e-4, 3e-4) * phi(rng.uniform(5.0, 53.0), POSITION, SPAN) for g in free
    ]) + NOISE * rng.standard_normal((40, 10))  # fmt: skip
    rows[::7, 2] = np.nan
    options = {"span": SPAN, "noise": NOISE, "tube_radius": 1.75, "map_error": 0.02}
    batch = localize_batch(
        rows, POSITION, length=LENGTH, free_curvature=free[:, None], jobs=jobs, **options
    )
    for m, (row, g) in enumerate(zip(rows, free, strict=True)):
        single = thigmo.localize(row, POSITION, length=LENGTH, free_curvature=g, **options)
        assert (batch.status[m], batch.count[m]) == (single.status, len(single.contacts))
        assert batch.log_odds[m] == single.log_odds
        assert not batch.localized[m, len(single.contacts) :].any()
        for j, contact in enumerate(single.contacts):
            assert (batch.arc[m, j], batch.force[m, j]) == (contact.arc, contact.force)
            assert (batch.low[m, j], batch.high[m, j]) == contact.interval


def test_a_bad_row_is_named():
    rows = np.zeros((3, 10))
    rows[1] = np.nan
    with pytest.raises(thigmo.ThigmoError, match="row 1: no reading is finite"):
        localize_batch(rows, POSITION, length=LENGTH, noise=NOISE)


def test_strong_and_near_the_base_is_listed_with_its_probability():
    # Only the base sensor sees it: a contact, a bad reading, or a kink just there.
    base = np.array([5.0, 15.0, 25.0, 35.0, 45.0])
    free = 0.03
    curvature = np.full(5, free)
    curvature[0] *= 0.33
    for odds in (1e-3, 0.05):
        result = thigmo.localize(
            curvature, base, length=LENGTH, span=SPAN, free_curvature=free, noise=NOISE,
            tube_radius=1.75, bad_reading_odds=odds, **STATED,
        )  # fmt: skip
        (contact,) = result.contacts
        assert contact.interval[0] < 12.0
        assert result.status == "ambiguous"
        assert 0.05 < contact.probability < 1.0


def test_odds_of_bad_readings_are_those_of_bad_readings_alone():
    contact = 1.5e-5 * phi(45.0, POSITION, SPAN)
    stuck, kinked = contact.copy(), contact + 0.2 * kinks()[0][2] / LENGTH
    stuck[2] += 6.0 * NOISE
    options = {"contacts": 1, "critical_curvature": np.inf, "held_end": False}
    rare, usual = (
        [weighed(frame, 0.0, bad_reading_odds=odds, **options) for frame in (stuck, kinked)]
        for odds in (1e-3, 1e-2)
    )
    change = usual[0]["one contact", 2] - rare[0]["one contact", 2]
    assert change == pytest.approx(math.log(10.0), abs=1e-6)
    kink = "one contact, hinge", -1
    assert usual[1][kink] == pytest.approx(rare[1][kink], abs=1e-6)
