"""One method on one case: its error and its time, as every study counts them.

Error is the mean |arc - true arc| over the contacts, ordered along the body (cm). No answer, or
another number of contacts than there are, is an infinite error; more than 10 cm is a failure. Time
is the processor's: a busy machine stretches the clock's time of a long call, not of a short one. It
is the least of up to five calls: the first one after other methods finds nothing in the caches.
"""

from __future__ import annotations

from collections.abc import Callable
from time import process_time
from typing import Any

import numpy as np

from thigmo.errors import ThigmoError
from thigmo.localization import METHODS, Localizer
from thigmo.studies.baselines import BASELINES, Problem
from thigmo.studies.scenes import CRITICAL, LENGTH, ROBOT, SIGMA, SPAN, Case

FAILURE_CM = 10.0
# The default method as robots run it: nobody says how many contacts there are, and the fold is
# stated as calibrated.
ON_A_ROBOT = "posterior on a robot"
_CALLS, _CALLS_US = 5, 5_000.0  # calls (the quickest counts), and for how long they are repeated


def attempt(
    case: Case, method: str, *, noise: float = SIGMA, start: float | None = None
) -> tuple[float, float]:
    """Error (cm, infinite for no answer) and processor time (us) of a call, given the noise (1/cm).

    The localizer is made before, as by any caller with more than one frame.
    Baselines that need a starting point take `start`; the others none.
    """
    answer = _asked(case, method, noise, start)
    times: list[float] = []
    while len(times) < _CALLS and sum(times) < _CALLS_US:
        begun = process_time()
        try:
            found = answer()
        except ThigmoError:
            found = []
        times.append((process_time() - begun) * 1e6)
    if len(found) != len(case.arcs):
        return float("inf"), min(times)
    return float(np.mean(np.abs(np.subtract(sorted(found), sorted(case.arcs))))), min(times)


def _asked(case: Case, method: str, noise: float, start: float | None) -> Callable[[], list[float]]:
    """The call that is timed: the arcs (cm) that a method answers."""
    count = len(case.arcs)
    if method not in (*METHODS, ON_A_ROBOT):

        def baseline() -> list[float]:
            read = np.isfinite(case.curvature)
            excess, position = case.curvature[read] - case.free, case.position[read]
            span = np.full(position.size, SPAN)
            begin = None if start is None else np.full(count, start)
            problem = Problem(excess, position, span, LENGTH, count, noise=noise, start=begin)
            found: list[float] = BASELINES[method](problem)[0].tolist()
            return found

        return baseline
    fold: dict[str, Any] = {"critical_curvature": CRITICAL, "critical_curvature_error": 0.1}
    how = ROBOT | (fold if method == ON_A_ROBOT else {"contacts": count, "method": method})
    localizer = Localizer.of(
        position=case.position, length=LENGTH, span=SPAN, noise=noise, **how
    )  # fmt: skip
    return lambda: [
        contact.arc
        for contact in localizer.localize(case.curvature, free_curvature=case.free).contacts
    ]


def mean_and_failures(errors: np.ndarray) -> tuple[float, float]:
    """Mean error of the answers (cm; NaN without any) and the share of failures."""
    answered = errors[np.isfinite(errors)]
    mean = float(answered.mean()) if answered.size else float("nan")
    return mean, float(np.mean(~(errors <= FAILURE_CM)))


def mean_over(mine: np.ndarray, other: np.ndarray) -> float:
    """Mean error of one method over another's, on the cases that both answered; NaN of none."""
    both = np.isfinite(mine) & np.isfinite(other)
    return float(mine[both].mean() / other[both].mean()) if both.any() else float("nan")
