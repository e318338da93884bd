"""The evidence is that of dense normal densities, integrated by quadrature; batches are rows."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

import thigmo
from thigmo.localization import Localizer, localize_batch, priors
from thigmo.mechanics.closed_forms import phi

LENGTH, SPAN, NOISE = 53.0, 5.5, 6e-4
POSITION = np.tile(np.arange(5.0, 50.0, 10.0), 2)
ERRORS = {"gain_error": 0.05, "offset_error": 3e-4, "map_error": 0.04}


def weighed(curvature, free, **options):
    """{(load, bad reading): log weight} of one frame."""
    options |= {"position": POSITION, "length": LENGTH, "span": SPAN, "noise": NOISE}
    localizer = Localizer.of(**options)._compiled
    own = np.full(1, free)
    found = localizer.localize(curvature, own, own)
    assert found.problem == 0
    return {(load, bad): weight for load, bad, weight in found.weighed}


def covariance(curvature, free, factor):
    y, g = curvature * LENGTH, np.full(len(curvature), free * LENGTH)
    floor = priors.TRUST * max(np.abs(y - g).max(), np.abs(g).max())
    own = (factor * NOISE * LENGTH) ** 2 + (ERRORS["gain_error"] * y) ** 2 + floor**2
    common = (ERRORS["offset_error"] * LENGTH) ** 2
    return np.diag(own) + common + ERRORS["map_error"] ** 2 * np.outer(g, g), y - g


@pytest.mark.parametrize("free", [0.0, 0.004])
def test_log_weights_are_those_of_dense_normal_densities(free):
    rng = np.random.default_rng(5)
    levers = phi(40.0, POSITION, SPAN)
    curvature = free + 4e-5 * levers + NOISE * rng.standard_normal(10)
    curvature[3] += 4e-3
    found = weighed(curvature, free, **ERRORS)
    # One reading fits no contact, so the noise may be larger than stated.
    levels = ((1.0, 1.0 - priors.NOISE_ODDS), (priors.NOISE_FACTOR, priors.NOISE_ODDS))

    def log_density(more, bad=False):
        each = []
        for factor, odds in levels:
            dense, excess = covariance(curvature, free, factor)
            if bad:
                dense[3, 3] += priors.BAD_DEVIATION**2 + (free * LENGTH) ** 2
            density = multivariate_normal(np.zeros(10), dense + more).logpdf(excess)
            each.append(density + np.log(odds * (priors.BAD_READING if bad else 1.0)))
        return logsumexp(each)

    assert found[0, -1] == pytest.approx(log_density(0.0), abs=1e-6)
    assert found[0, 3] == pytest.approx(log_density(0.0, bad=True), abs=1e-6)
    if free:
        return  # the levers of a contact are then those of a bent body
    for which in (-1, 3):
        each = []
        for arc in (np.arange(400) + 0.5) / 400:
            column = phi(arc, POSITION / LENGTH, SPAN / LENGTH)
            for scale in priors.MOMENTS:
                deviation = scale / max(arc, priors.LEAST_LEVER)
                each.append(log_density(deviation**2 * np.outer(column, column), which >= 0))
        weight = logsumexp(each) - np.log(len(each)) + priors.CONTACT
        assert found[2, which] == pytest.approx(weight, abs=0.02)


def test_an_edited_prior_changes_the_answers_of_the_next_localizer(monkeypatch):
    curvature = 2.5e-5 * phi(45.0, POSITION, SPAN)
    options = {"length": LENGTH, "span": SPAN, "noise": NOISE}
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
        one = thigmo.localize(row, POSITION, length=LENGTH, free_curvature=g, **options)
        assert (batch.status[m], batch.contacts[m]) == (one.status, len(one.contacts))
        assert batch.log_odds[m] == one.log_odds
        assert not batch.localized[m, len(one.contacts) :].any()
        for j, contact in enumerate(one.contacts):
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
            tube_radius=1.75, bad_reading_odds=odds,
        )  # fmt: skip
        (contact,) = result.contacts
        assert contact.interval[0] < 12.0
        assert result.status == "ambiguous"
        assert 0.05 < contact.probability < 1.0
