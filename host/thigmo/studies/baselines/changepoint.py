"""Kinks in a line: general packages for piecewise-linear fits and change points.

They know neither the zero curvature beyond the last contact nor the sensors' spans.
"""

from __future__ import annotations

import numpy as np

from thigmo.errors import DataError
from thigmo.studies.baselines.problem import Array, Problem, best_forces
from thigmo.studies.engine import extra

_SEGMENT = 3  # the least that ruptures' continuous linear cost takes


def pwlf(problem: Problem) -> tuple[Array, Array]:
    """pwlf's continuous piecewise-linear fit; its inner breaks are the contacts.

    Readings at one place are averaged first, for a line has one value there. Source: Jekel and
    Venter, pwlf: A Python Library for Fitting 1D Continuous Piecewise Linear Functions, 2019.

    Raises:
        DataError: the package is missing, or there are too few places for its free parameters.
    """
    fitter = extra("pwlf")
    places = np.unique(problem.position)
    least = 2 * problem.contacts + 2
    if places.size < least:
        raise DataError(
            f"pwlf needs readings at {least} places, there are {places.size}",
            "use the localizer",
        )
    means = np.array([problem.curvature[problem.position == x].mean() for x in places])
    fit = fitter.PiecewiseLinFit(places, means, seed=0)
    breaks = np.asarray(fit.fit(problem.contacts + 1), dtype=np.float64)
    arcs = np.clip(np.sort(breaks[1:-1]), 0.0, problem.length)
    return arcs, best_forces(problem, arcs)


def ruptures(problem: Problem) -> tuple[Array, Array]:
    """ruptures' exact dynamic programme with the continuous linear cost.

    It sees a series of samples, not their places, and needs three in a segment: readings at one
    place follow each other in it, because averaged there would be too few. A change at a sample is
    a contact at its place. Source: Truong, Oudre and Vayatis, Selective review of offline change
    point detection methods, Signal Processing 167, 2020.

    Raises:
        DataError: the package is missing, or there are too few places for its segments.
    """
    finder = extra("ruptures")
    order = np.argsort(problem.position, kind="stable")
    least = _SEGMENT * (problem.contacts + 1)
    if order.size < least:
        raise DataError(
            f"ruptures needs {least} readings, there are {order.size}", "use the localizer"
        )
    fit = finder.Dynp(model="clinear", min_size=_SEGMENT, jump=1)
    fit.fit(problem.curvature[order][:, None])
    ends = np.asarray(fit.predict(n_bkps=problem.contacts)[:-1], dtype=int)
    arcs = problem.position[order][ends]
    return arcs, best_forces(problem, arcs)
