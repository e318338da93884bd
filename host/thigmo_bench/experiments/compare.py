"""Answers of the thesis's solver, its variants and our method to a trial, and their errors.

Each method solves the same trials once. Three errors are computed:

- the thesis's measure |a - x of the obstacle|, which mixes arc length and x; contacts and obstacles
  are paired in their order along the arc;
- the same measure, with the closest contact and obstacle paired first;
- |x of the estimated contact point - x of the true one| in the workspace, where the estimated point
  lies on the shape that the method's answer implies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from thigmo.exploration.workspace import Bend, centreline, ramp_knots, skin_point
from thigmo.localization import localize
from thigmo_bench.baselines import BASELINES, BaselineProblem
from thigmo_bench.experiments import thesis
from thigmo_bench.experiments.trial import Trial
from thigmo_bench.studies.rod import Floats
from thigmo_bench.studies.scenes import STATED

THEIRS = "alternating"
OURS = "ours"


@dataclass(frozen=True)
class Answer:
    """A method's estimate, with the contacts from base to tip."""

    arcs_cm: tuple[float, ...]
    forces: tuple[float, ...]
    fold_rad: float = 0.0
    status: str = "localized"
    intervals_cm: tuple[tuple[float, float], ...] = ()
    # (arc, contact curvature) along the body if the method knows more than a straight beam's ramps
    bend: tuple[tuple[float, float], ...] = ()
    end_offset_cm: float | None = None  # offset of a contact on the end from the centreline


def thesis_method(trial: Trial, name: str = THEIRS) -> Answer:
    """The thesis's solver or one of its variants, given the true number of contacts."""
    problem = BaselineProblem(
        trial.curvature - trial.free, trial.position, trial.span, trial.length_cm,
        contacts=len(trial.arcs_cm), critical_curvature=trial.critical,
    )  # fmt: skip
    arcs, forces = BASELINES[name](problem)
    return Answer(tuple(arcs.tolist()), tuple(forces.tolist()))


def ours(trial: Trial) -> Answer:
    """The project's localizer, given the true number of contacts, as the thesis's solver is.

    As in an exploration, errors learnt from the untouched robot are subtracted first.
    """
    result = localize(
        trial.curvature / trial.gain, trial.position, free_curvature=trial.free,
        noise=trial.sigma, contacts=len(trial.arcs_cm), held_end=False, length=trial.length_cm,
        span=trial.span, critical_curvature=trial.critical, tube_radius=trial.radius_cm,
        **(STATED | {"offset_error": trial.offset_error}),
    )  # fmt: skip
    return Answer(
        tuple(contact.arc for contact in result.contacts),
        tuple(contact.force for contact in result.contacts),
        result.parameters.get("fold_angle", 0.0),
        result.status,
        tuple(contact.interval for contact in result.contacts),
        tuple((float(arc), float(above)) for arc, above in result.bend),
        result.contacts[-1].end_offset if result.contacts else None,
    )


class Solved(NamedTuple):
    """A trial with every method's answer by name: `OURS` and the names of the baselines."""

    trial: Trial
    answers: dict[str, Answer]


def solve(item: tuple[Trial, Sequence[str]]) -> Solved:
    """Answer a trial with our method and with the named baselines."""
    trial, methods = item
    answers = {name: thesis_method(trial, name) for name in methods}
    return Solved(trial, {OURS: ours(trial), **answers})


def answered(solved: Sequence[Solved], method: str) -> list[tuple[Trial, Answer]]:
    """Trials in which a method found as many contacts as there are, with its answers."""
    pairs = [(trial, answers.get(method)) for trial, answers in solved]
    return [(t, a) for t, a in pairs if a and len(a.arcs_cm) == len(t.arcs_cm)]


def camera_errors(trial: Trial, answer: Answer) -> Floats:
    """|a - x of the obstacle|, contacts ordered along the arc, cm."""
    return np.abs(np.subtract(sorted(answer.arcs_cm), trial.obstacle_x_cm))


def assigned_errors(trial: Trial, answer: Answer) -> Floats:
    """As `camera_errors`, with the closest pair of contact and obstacle matched first.

    Along a line, pairing in order has the smallest sum of errors. Pairing the closest first shows
    the error of the contact that was found best, whichever it is; that error comes first.
    """
    gaps = np.abs(np.subtract.outer(answer.arcs_cm, trial.obstacle_x_cm))
    errors = []
    while gaps.size:
        i, j = np.unravel_index(gaps.argmin(), gaps.shape)
        errors.append(gaps[i, j])
        gaps = np.delete(np.delete(gaps, i, axis=0), j, axis=1)
    return np.array(errors)


def workspace_errors(trial: Trial, answer: Answer) -> Floats:
    """Absolute errors of the contact points' x on the answer's own shape, base to tip, cm.

    On a real robot the contact point is unknown, so the error of the dowel's x is used.
    """
    contacts = sorted(zip(answer.arcs_cm, answer.forces, strict=True))
    curve = centreline(
        Bend(trial.length_cm, trial.free, answer.bend or ramp_knots(contacts), answer.fold_rad)
    )
    point_known = bool(np.isfinite(trial.contact_x_cm).all())
    radius = trial.radius_cm + (0.0 if point_known else thesis.DOWEL_CM)
    estimate = [skin_point(curve, arc, f, radius, answer.end_offset_cm)[0] for arc, f in contacts]
    truth = trial.contact_x_cm if point_known else trial.obstacle_x_cm
    return np.abs(np.subtract(estimate, truth))
