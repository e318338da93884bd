"""Three columns: the thesis, the thesis's method here, ours; with the Cramer-Rao bound beside them.

All methods see the same trials, and each trial is solved once by each. Three errors are reported:
the thesis's measure |a - x of the obstacle|, which mixes arc length and x, with contacts ordered
along the arc; the same with the closest contact and obstacle paired first; and the workspace's
|x of the estimated contact point - x of the true one|, through the shape that each method's own
answer implies.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import nan
from typing import Any

import numpy as np
from scipy import special

from thigmo.exploration.workspace import Bend, centreline, ramp_knots, skin_point
from thigmo.localization import ContactFilter, LocalizeResult, arc_bounds, localize
from thigmo.studies.baselines import BASELINES, Problem
from thigmo.studies.experiments import thesis
from thigmo.studies.experiments.trial import Trial
from thigmo.studies.rod import Floats

THEIRS = "alternating"
OURS = "ours"
ALONE = "ours, last reading alone"


@dataclass(frozen=True)
class Answer:
    """A method's estimate: contacts base first, the fold's angle (rad), and its status.

    `bend` holds (arc, contact curvature) along the body where the method knows more of it than the
    straight beam's ramps; `end_offset_cm` where a contact on the end bears.
    """

    arcs_cm: tuple[float, ...]
    forces: tuple[float, ...]
    fold_rad: float = 0.0
    status: str = "localized"
    intervals_cm: tuple[tuple[float, float], ...] = ()
    bend: tuple[tuple[float, float], ...] = ()
    end_offset_cm: float | None = None


def thesis_method(trial: Trial, name: str = THEIRS) -> Answer:
    """The thesis's solver or one of its variants, told the number of contacts as the thesis was.

    Its model has no spans: equation 2.10 compares a reading with the curvature at the sensor's
    centre.
    """
    problem = Problem(
        trial.curvature - trial.free,
        trial.position,
        np.zeros_like(trial.span),
        trial.length_cm,
        contacts=len(trial.arcs_cm),
        noise=max(trial.noise, 1e-6),
        critical_curvature=trial.critical,
    )
    arcs, forces = BASELINES[name](problem)
    return Answer(tuple(arcs.tolist()), tuple(forces.tolist()))


def ours(trial: Trial) -> Answer:
    """The project's localizer, told the number of contacts as the thesis was.

    As in an exploration (`exploration/reference.py`), what the untouched robot has shown of its
    sensors is taken off first. Where the robot bent into a dowel, all frames are taken together,
    for the dowel stood still.
    """
    if trial.passed is None:
        return alone(trial)
    felt = ContactFilter(
        trial.position,
        most_curvature=trial.free,
        noise=max(trial.noise, 1e-9),
        gain_error=trial.passed.gain_sigma,
        place_error=trial.passed.place_cm,
        peg_radius=trial.dowel_cm,
        **_told(trial),
    )
    felt.update(trial.passed.curvature / trial.gain, trial.passed.free)
    felt.update(trial.curvature / trial.gain, trial.free)
    return _answer(felt.result())


def alone(trial: Trial) -> Answer:
    """As `ours`, of the trial's own readings, without those on the way."""
    return _answer(
        localize(
            trial.curvature / trial.gain,
            trial.position,
            free_curvature=trial.free,
            noise=trial.sigma,
            contacts=len(trial.arcs_cm),
            **_told(trial),
        )
    )


def _told(trial: Trial) -> dict[str, Any]:
    return {
        "length": trial.length_cm, "span": trial.span, "offset_error": trial.offset_sigma,
        "critical_curvature": trial.critical, "tube_radius": trial.radius_cm,
    }  # fmt: skip


def _answer(result: LocalizeResult) -> Answer:
    return Answer(
        tuple(contact.arc for contact in result.contacts),
        tuple(contact.force for contact in result.contacts),
        result.parameters.get("fold_angle", 0.0),
        result.status,
        tuple(contact.interval for contact in result.contacts),
        tuple((float(arc), float(above)) for arc, above in result.bend),
        result.contacts[-1].end_offset if result.contacts else None,
    )


@dataclass(frozen=True)
class Solved:
    """A trial with every method's answer, by name (`OURS` and the baselines'), and its bound."""

    trial: Trial
    answers: dict[str, Answer]
    bound_cm: Floats


def solve(item: tuple[Trial, Sequence[str]]) -> Solved:
    """Answer a trial with ours and with the named baselines."""
    trial, methods = item
    answers = {OURS: ours(trial)}
    if trial.passed is not None:
        answers[ALONE] = alone(trial)
    answers |= {name: thesis_method(trial, name) for name in methods}
    return Solved(trial, answers, bound_cm(trial))


Measure = Callable[[Trial, Answer], Floats]
"""Errors of an answer, one a contact, base first (cm; infinite without an answer)."""


def _of_answered(measure: Measure) -> Measure:
    def errors(trial: Trial, answer: Answer) -> Floats:
        if len(answer.arcs_cm) != len(trial.arcs_cm):
            return np.full(len(trial.arcs_cm), np.inf)
        return measure(trial, answer)

    return errors


@_of_answered
def camera_errors(trial: Trial, answer: Answer) -> Floats:
    """|a - x of the obstacle|, contacts ordered along the arc."""
    return np.abs(np.subtract(sorted(answer.arcs_cm), trial.obstacle_x_cm))


@_of_answered
def assigned_errors(trial: Trial, answer: Answer) -> Floats:
    """As `camera_errors`, with the closest pair of contact and obstacle matched first.

    Along a line no assignment has a smaller sum than the ordered one; this one tells how well the
    best-found contact was found, whatever its label. So the first entry is that contact's error,
    and the last what is left for the others.
    """
    gaps = np.abs(np.subtract.outer(answer.arcs_cm, trial.obstacle_x_cm))
    errors = []
    while gaps.size:
        i, j = np.unravel_index(gaps.argmin(), gaps.shape)
        errors.append(gaps[i, j])
        gaps = np.delete(np.delete(gaps, i, axis=0), j, axis=1)
    return np.array(errors)


@_of_answered
def workspace_errors(trial: Trial, answer: Answer) -> Floats:
    """|x of the contact point| error through the answer's own shape.

    On a real robot the contact point is not known; there it is the error of the dowel's x.
    """
    contacts = sorted(zip(answer.arcs_cm, answer.forces, strict=True))
    curve = centreline(
        Bend(trial.length_cm, trial.free, answer.bend or ramp_knots(contacts), answer.fold_rad)
    )
    point_known = bool(np.isfinite(trial.contact_x_cm).all())
    radius = trial.radius_cm + (0.0 if point_known else trial.dowel_cm)
    found = [skin_point(curve, arc, f, radius, answer.end_offset_cm)[0] for arc, f in contacts]
    truth = trial.contact_x_cm if point_known else trial.obstacle_x_cm
    return np.abs(np.subtract(found, truth))


def bound_cm(trial: Trial) -> Floats:
    """Mean absolute error of the arc at the Cramer-Rao bound of the beam model, per contact (cm).

    Of the readings' own spread over robots (white noise, gains, places), nothing else unknown.

    A Gaussian estimator at the bound has the mean absolute error sqrt(2 / pi) of its deviation;
    infinite where the information matrix is singular, NaN where forces are not known. Of a dowel
    that the robot bent into, that of all frames (`conditions.obstacle_bound`).
    """
    if trial.passed is not None:
        return np.array([trial.passed.bound_cm])
    if not np.isfinite(trial.forces).all():
        return np.full(len(trial.arcs_cm), np.nan)
    arcs, forces, noise = map(np.array, (trial.arcs_cm, trial.forces, trial.spread))
    told = np.maximum(noise, 1e-9)
    deviation = arc_bounds(arcs, forces, trial.position, trial.span, told, trial.length_cm)
    return np.asarray(np.sqrt(2 / np.pi) * deviation)


Row = dict[str, Any]
"""One line of the three-column table (cm), for CSV, JSON and the table of docs/figures.md.

    here_*, ours_*, alone_*: errors (`errors`) of the thesis's method here, of ours, and of ours
        without the readings on the way (NaN where there are none).
    perfect_arc_mean: the thesis's measure of a perfect arc: the foreshortening that it contains.
    bound_mean: mean absolute error of the arc at the Cramer-Rao bound, where that is finite.
    bound_measured_mean: the same estimator's error in the thesis's measure.
    unbounded: number of contacts without a finite bound: nothing fixes their place.
    ambiguous: number of our answers that say so.
    allowed_mean, allowed: what ours may be in the thesis's measure and in the workspace: the larger
        of half the thesis's method's error and 1.2 bounds; mean_beaten, beaten: whether it is.
"""


def row(experiment: str, condition: str, solved: Sequence[Solved], here: str) -> Row:
    """The line of one condition: the baseline `here` and ours over its trials."""
    told = thesis.RESULTS[experiment, condition]
    bounds = np.concatenate([one.bound_cm for one in solved])
    finite = np.isfinite(bounds)
    ahead = np.concatenate(
        [np.abs(np.subtract(one.trial.arcs_cm, one.trial.obstacle_x_cm)) for one in solved]
    )
    bound, measured = (
        float(values[finite].mean()) if finite.any() else float("inf")
        for values in (bounds, folded(ahead, bounds))
    )
    every = {
        f"{who}_{what}": value
        for who, method in (("here", here), ("ours", OURS), ("alone", ALONE))
        for what, value in errors(solved, method).items()
    }
    allowed = [
        max(0.5 * every[f"here_{what}"], 1.2 * (least if np.isfinite(least) else 0.0))
        for what, least in (("mean", measured), ("workspace_mean", bound))
    ]
    return {
        "experiment": experiment,
        "condition": condition,
        "trials": len(solved),
        "thesis_mean": told.mean_cm,
        "thesis_std": told.std_cm,
        **every,
        "perfect_arc_mean": float(ahead.mean()),
        "bound_mean": bound,
        "bound_measured_mean": measured,
        "unbounded": int(bounds.size - finite.sum()),
        "ambiguous": sum(one.answers[OURS].status == "ambiguous" for one in solved),
        "allowed_mean": allowed[0],
        "mean_beaten": bool(every["ours_mean"] <= allowed[0]),
        "allowed": allowed[1],
        "beaten": bool(every["ours_workspace_mean"] <= allowed[1]),
    }


def shown(r: Row) -> Row:
    """The columns that people look at first."""
    return {
        "|a - x of the obstacle|, cm": f"{r['experiment']}, {r['condition']}",
        "trials": r["trials"],
        "thesis": f"{r['thesis_mean']:.2f} +- {r['thesis_std']:.2f}",
        "its method, here": f"{r['here_mean']:.2f} +- {r['here_std']:.2f}",
        "ours": f"{r['ours_mean']:.2f} +- {r['ours_std']:.2f}",
        "perfect arc": r["perfect_arc_mean"],
        "at the bound": r["bound_measured_mean"],
        "x in the room: its": r["here_workspace_mean"],
        "ours, x": r["ours_workspace_mean"],
        "bound": r["bound_mean"],
    }


def folded(offset: Floats, spread: Floats) -> Floats:
    """Mean absolute value of Gaussians.

    Args:
        offset: (K,) their means, zero or more.
        spread: (K,) their mean absolute deviations.
    """
    deviation = np.maximum(np.sqrt(np.pi / 2) * spread, 1e-9)
    share = offset / deviation
    return np.asarray(spread * np.exp(-0.5 * share**2) + offset * special.erf(share / np.sqrt(2.0)))


def errors(solved: Sequence[Solved], method: str) -> dict[str, float]:
    """A method's errors over trials, cm; trials without an answer are left out.

    Returns:
        mean and std in the thesis's measure, contacts ordered along the arc; nearest_mean and
        other_mean with the closest pair of contact and obstacle matched first: of that pair, and of
        the others (equal for one contact); workspace_mean of the x in the workspace.
    """
    measures = (camera_errors, assigned_errors, workspace_errors)
    found = np.array([
        [measure(one.trial, one.answers[method]) for measure in measures]
        for one in solved
        if method in one.answers
    ]).reshape(-1, 3, len(solved[0].trial.arcs_cm))  # fmt: skip
    camera, assigned, room = found[np.isfinite(found[:, 0]).all(axis=1)].transpose(1, 0, 2)
    if not camera.size:
        return dict.fromkeys(("mean", "std", "nearest_mean", "other_mean", "workspace_mean"), nan)
    return {
        "mean": float(camera.mean()),
        "std": float(camera.std()),
        "nearest_mean": float(assigned[:, 0].mean()),
        "other_mean": float(assigned[:, -1].mean()),
        "workspace_mean": float(room.mean()),
    }
