"""The problem that every baseline solves, on the thesis's model (`localization.thesis`).

A baseline gets curvature above the free curvature, in cm and 1/cm (their steps and tolerances are
lengths), and a number of contacts; it answers arcs and forces, base first. The model is averaged
over each sensor's span; the thesis's own solvers take it at the sensors' centres.
"""

from __future__ import annotations

from dataclasses import dataclass

from thigmo.localization import thesis


@dataclass(frozen=True, slots=True)
class Problem(thesis.Problem):
    """Readings of one frame."""

    noise: float = 6e-4  # standard deviation of a reading, 1/cm, for the trained baselines
