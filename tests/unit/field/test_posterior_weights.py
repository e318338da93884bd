"""Later rounds of samples learn from earlier ones, however unlikely most of those are."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_t

from thigmo.field.hypotheses import UNSIGNED
from thigmo.field.proposals import Bell, learnt_bells


@pytest.mark.parametrize("unlikely", [-1e3, -1e5, -np.inf])
def test_one_sample_that_outweighs_all_others_ends_the_tempering(unlikely: float) -> None:
    rng = np.random.default_rng(0)
    q = rng.standard_normal((60, 7))
    logs = np.full(60, unlikely)
    logs[7] = 0.0
    bells, shares = learnt_bells(q, logs, np.zeros(60, dtype=np.intp), 3.0)
    assert len(bells) == len(shares) <= 1


def test_samples_of_a_bell_are_spread_as_it() -> None:
    rng = np.random.default_rng(0)
    q = rng.standard_normal((600, 7))
    bells, shares = learnt_bells(q, np.zeros(600), np.zeros(600, dtype=np.intp), 3.0)
    assert shares.tolist() == [1.0]
    assert bells[0].log_density(np.zeros((1, 7))) > bells[0].log_density(np.full((1, 7), 3.0))


def test_a_bell_counts_what_its_draws_mirror() -> None:
    rng = np.random.default_rng(1)
    half = rng.standard_normal((7, 7))
    center, covariance = 0.5 * rng.standard_normal(7), half @ half.T + 0.1 * np.eye(7)
    q = np.abs(rng.standard_normal((20, 7)))
    unmirrored = multivariate_t(center, covariance, df=6)
    density = np.zeros(20)
    for sign in range(8):
        mirrored = q.copy()
        for n, unknown in enumerate(UNSIGNED):
            mirrored[:, unknown] *= -1.0 if sign >> n & 1 else 1.0
        density += unmirrored.pdf(mirrored)
    assert Bell(center, covariance).log_density(q) == pytest.approx(np.log(density), abs=1e-9)
