"""One method on one case: its error and its time, as every study counts them.

Error is the mean |arc - true arc| over the contacts, ordered along the body (cm). No answer, or
another number of contacts than asked for, is an infinite error; more than 10 cm is a failure.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import numpy as np

from thigmo.bench.scenes import LENGTH, SIGMA, SPAN, Case
from thigmo.errors import ThigmoError
from thigmo.localization import localize
from thigmo.localization.baselines import BASELINES, Problem

FAILURE_CM = 10.0

Draw = Callable[[np.random.Generator], Case]


def attempt(case: Case, method: str, *, noise: float = SIGMA) -> tuple[float, float]:
    """Error (cm, infinite for no answer) and wall time (us) of one call."""
    start = perf_counter()
    try:
        result = localize(
            case.curvature,
            case.position,
            length=LENGTH,
            span=SPAN,
            free_curvature=case.free,
            noise=noise,
            contacts=len(case.arcs),
            method=method,
        )
    except ThigmoError:
        return float("inf"), (perf_counter() - start) * 1e6
    elapsed = (perf_counter() - start) * 1e6
    found = sorted(contact.arc for contact in result.contacts)
    if len(found) != len(case.arcs):
        return float("inf"), elapsed
    return float(np.mean(np.abs(np.subtract(found, sorted(case.arcs))))), elapsed


def attempt_from(case: Case, method: str, start: float) -> float:
    """Error (cm) of a baseline that starts at arc `start`; other methods take none, and none."""
    if method not in BASELINES:
        return attempt(case, method)[0]
    span = np.full(case.position.size, SPAN)
    first = np.full(len(case.arcs), start)
    problem = Problem(
        case.curvature - case.free, case.position, span, LENGTH, len(case.arcs), SIGMA, start=first
    )
    arcs, _ = BASELINES[method](problem)
    return float(np.mean(np.abs(np.subtract(sorted(arcs), sorted(case.arcs)))))


def mean_and_failures(errors: np.ndarray) -> tuple[float, float]:
    """Mean error of the answers (cm; NaN without any) and the share of failures."""
    answered = errors[np.isfinite(errors)]
    mean = float(answered.mean()) if answered.size else float("nan")
    return mean, float(np.mean(~(errors <= FAILURE_CM)))
