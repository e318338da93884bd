"""Doubts about the readings: which mistake in them is likely, and what to say of it.

The compiled code weighs mistakes beside every explanation (`mistakes` in input.h). Here they have
their names, and the remarks that follow from them and from what the answer leaves unexplained.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan, nan, sqrt

# In the order of `Mistake` in whitening.h; a larger noise, last, goes with any of the others.
MISTAKES = (
    "as stated",
    "slightly off",
    "free curvature of the wrong sign",
    "free curvature subtracted twice",
    "free curvature far off",
    "free curvature not given",
    "small fold at the base",
    "neighbours correlated",
    "noise larger than stated",
)
_REMARKS = {
    "free curvature of the wrong sign": "the free curvature may have the wrong sign",
    "free curvature subtracted twice": "the free curvature may have been subtracted already: "
    "give the readings as they are, or a free curvature of 0",
    "free curvature far off": "the free curvature may be far off: check it",
    "free curvature not given": "the body may bend without contact: give free_curvature",
    "small fold at the base": "the base may be folded a little: give base_fold_error",
    "neighbours correlated": "neighbouring readings are correlated: give noise_correlation",
    "noise larger than stated": "the noise is larger than stated: check it",
}
# Probability from which a mistake is remarked. Few sensors leave it open whether noise or a fold
# is larger than stated, so for these it is higher.
_LIKELY = 0.5
_CERTAIN = dict.fromkeys(("small fold at the base", "noise larger than stated"), 0.95)
# Standard normal deviate of chi-square below which the noise is smaller than stated; a correct one
# goes below in 1 % of frames. Standard errors above which neighbours are correlated.
_TOO_SMALL = -2.2
_CORRELATED = 2.0
_DENSE = 40


def doubts(mistakes: Sequence[float]) -> dict[str, float]:
    """Probability of each mistake that was weighed; empty if none was."""
    if mistakes[0] >= 1.0 - 1e-12 and mistakes[-1] == 0.0:
        return {}
    return {
        name: share
        for name, share in zip(MISTAKES, mistakes, strict=True)
        if share > 0.0 or name == MISTAKES[0]
    }


def reduced(misfit: float, freedom: int) -> float:
    """Chi-square for each degree of freedom; NaN if there is none."""
    return misfit / freedom if freedom > 0 else nan


def deviate(misfit: float, freedom: int) -> float:
    """Standard normal deviate of chi-square (Wilson and Hilferty, PNAS 17 (1931)), or NaN."""
    if freedom <= 0 or isnan(misfit):
        return nan
    part = 2.0 / (9.0 * freedom)
    return float(((misfit / freedom) ** (1.0 / 3.0) - 1.0 + part) / sqrt(part))


def remarks(
    mistakes: Sequence[float], misfit: float, freedom: int, correlation: float, *,
    sensors: int, noise_stated: bool,
) -> tuple[str, ...]:  # fmt: skip
    """What to check in the readings, or in what was stated of them, the likeliest mistake first."""
    likely = [
        (share, _REMARKS[name])
        for name, share in zip(MISTAKES, mistakes, strict=True)
        if name in _REMARKS and share > _CERTAIN.get(name, _LIKELY)
    ]
    likely_remarks = [remark for _, remark in sorted(likely, reverse=True)]
    if noise_stated and deviate(misfit, freedom) < _TOO_SMALL:
        likely_remarks.append("the noise is far below what was stated: check it")
    correlated = _REMARKS["neighbours correlated"]
    if sensors >= _DENSE and correlation > _CORRELATED and correlated not in likely_remarks:
        likely_remarks.append(correlated)
    return tuple(likely_remarks)
