"""Later rounds of samples learn from earlier ones, however unlikely most of those are."""

from __future__ import annotations

import numpy as np
import pytest

from thigmo.field.proposals import learnt_bells


@pytest.mark.parametrize("unlikely", [-1e3, -1e5, -np.inf])
def test_one_sample_that_outweighs_all_others_ends_the_tempering(unlikely: float) -> None:
    rng = np.random.default_rng(0)
    q = rng.standard_normal((60, 7))
    logs = np.full(60, unlikely)
    logs[7] = 0.0
    bells, shares = learnt_bells(q, logs, np.zeros(60, dtype=np.intp))
    assert len(bells) == len(shares) <= 1


def test_samples_of_a_bell_are_spread_as_it() -> None:
    rng = np.random.default_rng(0)
    q = rng.standard_normal((600, 7))
    bells, shares = learnt_bells(q, np.zeros(600), np.zeros(600, dtype=np.intp))
    assert shares.tolist() == [1.0]
    assert bells[0].log_density(np.zeros((1, 7))) > bells[0].log_density(np.full((1, 7), 3.0))
