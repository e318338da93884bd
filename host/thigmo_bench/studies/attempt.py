"""Error and time of one method on one case, as every study counts them.

The error is the mean |arc - true arc| over the contacts, ordered along the body (cm). It is
infinite without an answer, or for a wrong number of contacts; more than 10 cm is a failure. The
time is processor time, because wall time of long calls grows on a busy machine. It is the least of
up to five calls, because the caches are cold for the first one after another method.
"""

from __future__ import annotations

from collections.abc import Callable
from time import process_time
from typing import Any

import numpy as np

from thigmo.errors import ThigmoError
from thigmo.localization import METHODS, Localizer
from thigmo_bench.baselines import BASELINES, BaselineProblem
from thigmo_bench.studies.scenes import CRITICAL, LENGTH, RADIUS, ROBOT, SIGMA, Case

FAILURE_CM = 10.0
# The default method as on a robot: without the number of contacts, and with the calibrated fold.
ON_A_ROBOT = "posterior on a robot"
# The same, with no error stated but the noise.
UNSTATED = "posterior, errors not stated"
_CALLS, _CALLS_US = 5, 5_000.0  # most calls (the quickest counts), and their total time


def attempt(
    case: Case, method: str, *, noise: float = SIGMA, start: float | None = None
) -> tuple[float, float]:
    """Error (cm, infinite for no answer) and processor time (us) of a call with known noise (1/cm).

    The localizer is made before, as by any caller with more than one frame. `start` (cm) is the
    starting arc of baselines that need one.
    """
    answer = _timed_call(case, method, noise, start)
    times: list[float] = []
    while len(times) < _CALLS and sum(times) < _CALLS_US:
        began = process_time()
        try:
            arcs = answer()
        except ThigmoError:
            arcs = []
        times.append((process_time() - began) * 1e6)
    if len(arcs) != len(case.arcs):
        return float("inf"), min(times)
    return float(np.mean(np.abs(np.subtract(sorted(arcs), sorted(case.arcs))))), min(times)


def _timed_call(
    case: Case, method: str, noise: float, start: float | None
) -> Callable[[], list[float]]:
    """The call that is timed; it returns a method's arcs (cm)."""
    count = len(case.arcs)
    if method not in (*METHODS, ON_A_ROBOT, UNSTATED):

        def baseline() -> list[float]:
            read = np.isfinite(case.curvature)
            excess, position = case.curvature[read] - (case.free or 0.0), case.position[read]
            span = np.full(position.size, case.span)
            begin = None if start is None else np.full(count, start)
            problem = BaselineProblem(
                excess, position, span, LENGTH, count, noise=noise, start=begin
            )
            arcs: list[float] = BASELINES[method](problem)[0].tolist()
            return arcs

        return baseline
    fold: dict[str, Any] = {"critical_curvature": CRITICAL, "critical_curvature_error": 0.1}
    statements: dict[str, Any] = {"tube_radius": RADIUS, "contacts": count}
    if method == ON_A_ROBOT:
        statements = ROBOT | fold
    elif method != UNSTATED:
        statements = ROBOT | {"contacts": count, "method": method}
    localizer = Localizer.of(
        position=case.position, length=LENGTH, span=case.span, noise=noise, **statements
    )  # fmt: skip
    return lambda: [
        contact.arc
        for contact in localizer.localize(case.curvature, free_curvature=case.free).contacts
    ]


def mean_and_failures(errors: np.ndarray) -> tuple[float, float]:
    """Mean finite error (cm; NaN without any), and the share of failures."""
    answered = errors[np.isfinite(errors)]
    mean = float(answered.mean()) if answered.size else float("nan")
    return mean, float(np.mean(~(errors <= FAILURE_CM)))


def mean_over(errors: np.ndarray, reference: np.ndarray) -> float:
    """Mean error of one method over another's, on cases that both answered; NaN without any."""
    answered = np.isfinite(errors) & np.isfinite(reference)
    return (
        float(errors[answered].mean() / reference[answered].mean())
        if answered.any()
        else float("nan")
    )
