"""One method on one case: its error and its time, as every study counts them.

Error is the mean |arc - true arc| over the contacts, ordered along the body (cm). No answer, or
another number of contacts than asked for, is an infinite error; more than 10 cm is a failure. Time
is the processor's: a busy machine stretches the clock's time of a long call, not of a short one.
"""

from __future__ import annotations

from time import process_time

import numpy as np

from thigmo.errors import ThigmoError
from thigmo.localization import METHODS, Localizer
from thigmo.studies.baselines import BASELINES, Problem
from thigmo.studies.scenes import LENGTH, ROBOT, SIGMA, SPAN, Case

FAILURE_CM = 10.0


def attempt(
    case: Case, method: str, *, noise: float = SIGMA, start: float | None = None
) -> tuple[float, float]:
    """Error (cm, infinite for no answer) and processor time (us) of a call, given the noise (1/cm).

    The localizer is made before, as by any caller with more than one frame.
    Baselines that need a starting point take `start`; the others none.
    """
    count = len(case.arcs)
    localizer = None
    if method in METHODS:
        localizer = Localizer.of(
            position=case.position, length=LENGTH, span=SPAN, noise=noise, contacts=count,
            method=method, **ROBOT,
        )  # fmt: skip
    begun = process_time()
    try:
        if localizer is not None:
            result = localizer.localize(case.curvature, free_curvature=case.free)
            found = [contact.arc for contact in result.contacts]
        else:
            read = np.isfinite(case.curvature)
            excess, position = case.curvature[read] - case.free, case.position[read]
            span = np.full(position.size, SPAN)
            begin = None if start is None else np.full(count, start)
            problem = Problem(excess, position, span, LENGTH, count, noise=noise, start=begin)
            found = BASELINES[method](problem)[0].tolist()
    except ThigmoError:
        found = []
    elapsed = (process_time() - begun) * 1e6
    if len(found) != count:
        return float("inf"), elapsed
    return float(np.mean(np.abs(np.subtract(sorted(found), sorted(case.arcs))))), elapsed


def mean_and_failures(errors: np.ndarray) -> tuple[float, float]:
    """Mean error of the answers (cm; NaN without any) and the share of failures."""
    answered = errors[np.isfinite(errors)]
    mean = float(answered.mean()) if answered.size else float("nan")
    return mean, float(np.mean(~(errors <= FAILURE_CM)))


def mean_over(mine: np.ndarray, other: np.ndarray) -> float:
    """Mean error of one method over another's, on the cases that both answered; NaN of none."""
    both = np.isfinite(mine) & np.isfinite(other)
    return float(mine[both].mean() / other[both].mean()) if both.any() else float("nan")
