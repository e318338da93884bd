"""Three columns: the thesis, the thesis's method here, ours; with the Cramer-Rao bound beside them.

All methods see the same trials, and each trial is solved once by each. Three errors are reported:
the thesis's measure |a - x of the obstacle|, which mixes arc length and x, with contacts ordered
along the arc; the same with the closest contact and obstacle paired first; and the workspace's
|x of the estimated contact point - x of the true one|, through the shape that each method's own
answer implies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from thigmo.exploration.workspace import Bend, centreline, ramp_knots, skin_point
from thigmo.localization import LocalizeResult, localize, localize_obstacle
from thigmo.localization.influence import STRAIGHT, Sensors
from thigmo.localization.information import arc_bounds
from thigmo.localization.readings import normalise
from thigmo.studies.baselines import BASELINES, Problem
from thigmo.studies.experiments import thesis
from thigmo.studies.experiments.trial import Trial

Floats = NDArray[np.float64]

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
    model: str = ""
    bend: tuple[tuple[float, float], ...] = ()
    end_offset_cm: float | None = None


def thesis_method(trial: Trial, name: str = "alternating") -> Answer:
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
    frames = np.vstack([trial.passed.curvature, trial.curvature])
    return _answer(
        localize_obstacle(
            frames / trial.gain,
            trial.position,
            length=trial.length_cm,
            span=trial.span,
            free_curvature=np.append(trial.passed.free, trial.free),
            noise=max(trial.noise, 1e-9),
            gain_sigma=trial.passed.gain_sigma,
            place_sigma=trial.passed.place_cm,
            offset_sigma=trial.offset_sigma,
            critical_curvature=trial.critical,
            tube_radius=trial.radius_cm,
            peg_radius=trial.dowel_cm,
        )
    )


def alone(trial: Trial) -> Answer:
    """As `ours`, of the trial's own readings, without those on the way."""
    result = localize(
        trial.curvature / trial.gain,
        trial.position,
        length=trial.length_cm,
        span=trial.span,
        free_curvature=trial.free,
        noise=trial.sigma,
        offset_sigma=trial.offset_sigma,
        contacts=len(trial.arcs_cm),
        critical_curvature=trial.critical,
        tube_radius=trial.radius_cm,
    )
    return _answer(result)


def _answer(result: LocalizeResult) -> Answer:
    return Answer(
        tuple(contact.arc for contact in result.contacts),
        tuple(contact.force for contact in result.contacts),
        result.parameters.get("fold_angle", 0.0),
        result.status,
        tuple(contact.interval for contact in result.contacts),
        result.model,
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


def camera_errors(trial: Trial, answer: Answer) -> Floats:
    """|a - x of the obstacle|, contacts ordered along the arc (cm; infinite without an answer)."""
    if len(answer.arcs_cm) != len(trial.arcs_cm):
        return np.full(len(trial.arcs_cm), np.inf)
    return np.abs(np.subtract(sorted(answer.arcs_cm), trial.obstacle_x_cm))


def assigned_errors(trial: Trial, answer: Answer) -> Floats:
    """As `camera_errors`, with the closest pair of contact and obstacle matched first.

    Along a line no assignment has a smaller sum than the ordered one; this one tells how well the
    best-found contact was found, whatever its label. So the first entry is that contact's error,
    and the last what is left for the others (cm; infinite without an answer).
    """
    if len(answer.arcs_cm) != len(trial.arcs_cm):
        return np.full(len(trial.arcs_cm), np.inf)
    found, true = list(answer.arcs_cm), list(trial.obstacle_x_cm)
    errors = []
    while found:
        gap, i, j = min((abs(a - x), i, j) for i, a in enumerate(found) for j, x in enumerate(true))
        errors.append(gap)
        del found[i], true[j]
    return np.array(errors)


def workspace_errors(trial: Trial, answer: Answer) -> Floats:
    """|x of the contact point| error through the answer's own shape (cm).

    On a real robot the contact point is not known; there it is the error of the dowel's x.
    """
    if len(answer.arcs_cm) != len(trial.arcs_cm):
        return np.full(len(trial.arcs_cm), np.inf)
    curve = centreline(
        Bend(
            trial.length_cm,
            trial.free,
            answer.bend or ramp_knots(zip(answer.arcs_cm, answer.forces, strict=True)),
            answer.fold_rad,
        )
    )
    point_known = bool(np.isfinite(trial.contact_x_cm).all())
    radius = trial.radius_cm + (0.0 if point_known else trial.dowel_cm)
    found = [
        skin_point(curve, arc, force, radius, answer.end_offset_cm)[0]
        for arc, force in sorted(zip(answer.arcs_cm, answer.forces, strict=True))
    ]
    truth = trial.contact_x_cm if point_known else trial.obstacle_x_cm
    return np.abs(np.subtract(found, truth))


def bound_cm(trial: Trial) -> Floats:
    """Mean absolute error of the arc at the Cramer-Rao bound of the beam model, per contact (cm).

    Of the readings' own spread over robots (white noise, gains, places), nothing else unknown.

    A Gaussian estimator at the bound has the mean absolute error sqrt(2 / pi) of its deviation;
    infinite where the information matrix is singular, NaN where forces are not known. Of a dowel
    that the robot bent into, that of all frames (`bound.obstacle_bound`).
    """
    if trial.passed is not None:
        return np.array([trial.passed.bound_cm])
    if not np.isfinite(trial.forces).all():
        return np.full(len(trial.arcs_cm), np.nan)
    noise = np.maximum(trial.spread, 1e-9)
    readings = normalise(
        trial.curvature, trial.position, trial.length_cm, trial.span, trial.free, noise
    )
    scale = readings.length
    count = readings.y.size
    deviation = arc_bounds(
        np.array(trial.arcs_cm) / scale,
        np.array(trial.forces) * scale**2,
        Sensors(readings.low, readings.high, STRAIGHT, np.empty((count, 4))),
        (noise[readings.index] * scale) ** -2,
        np.empty((count, 0)),
    )
    return np.asarray(np.sqrt(2 / np.pi) * deviation * scale)


@dataclass(frozen=True)
class Errors:
    """Mean and spread of a method's errors over the trials of a row, cm.

    Attributes:
        mean, std: the thesis's measure, contacts ordered along the arc.
        nearest, other: means with the closest pair of contact and obstacle matched first: of that
            pair, and of the others (equal for one contact).
        workspace: mean x error in the workspace.
    """

    mean: float
    std: float
    nearest: float
    other: float
    workspace: float


@dataclass(frozen=True)
class Row:
    """One line of the three-column table (cm).

    Attributes:
        perfect: the thesis's measure of a perfect arc: the foreshortening that it contains.
        bound: mean absolute error of the arc at the Cramer-Rao bound, where that is finite.
        measured: the same estimator's error in the thesis's measure, foreshortening included.
        unbounded: number of contacts for which it is not: nothing fixes their place.
        ambiguous: number of our answers that say so.
        alone: our errors without the readings on the way; None where there are none.
    """

    experiment: str
    condition: str
    trials: int
    thesis_mean: float
    thesis_std: float
    here: Errors
    ours: Errors
    perfect: float
    bound: float
    measured: float
    unbounded: int
    ambiguous: int
    alone: Errors | None = None

    def allowed(self, workspace: bool) -> float:
        """What ours may be: the larger of half the thesis's method's error and 1.2 bounds."""
        bound = self.bound if workspace else self.measured
        bound = bound if np.isfinite(bound) else 0.0
        theirs = self.here.workspace if workspace else self.here.mean
        return max(0.5 * theirs, 1.2 * bound)

    def beaten(self, workspace: bool) -> bool:
        """Whether ours is within what is allowed, in the workspace or in the thesis's measure."""
        return (self.ours.workspace if workspace else self.ours.mean) <= self.allowed(workspace)

    def record(self) -> dict[str, float | int | str | bool]:
        """As plain data: for CSV, JSON and README's table."""
        return {
            "experiment": self.experiment,
            "condition": self.condition,
            "trials": self.trials,
            "thesis_mean": self.thesis_mean,
            "thesis_std": self.thesis_std,
            "here_mean": self.here.mean,
            "here_std": self.here.std,
            "ours_mean": self.ours.mean,
            "ours_std": self.ours.std,
            "perfect_arc_mean": self.perfect,
            "allowed_mean": self.allowed(False),
            "mean_beaten": self.beaten(False),
            "here_nearest_mean": self.here.nearest,
            "here_other_mean": self.here.other,
            "ours_nearest_mean": self.ours.nearest,
            "ours_other_mean": self.ours.other,
            "here_workspace_mean": self.here.workspace,
            "ours_workspace_mean": self.ours.workspace,
            "bound_mean": self.bound,
            "bound_measured_mean": self.measured,
            "unbounded": self.unbounded,
            "ambiguous": self.ambiguous,
            "allowed": self.allowed(True),
            "beaten": self.beaten(True),
            "alone_mean": self.alone.mean if self.alone else float("nan"),
            "alone_workspace_mean": self.alone.workspace if self.alone else float("nan"),
        }


def row(experiment: str, condition: str, solved: Sequence[Solved], here: str) -> Row:
    """The line of one condition: the baseline `here` and ours over its trials."""
    told = thesis.published(experiment, condition)
    bounds = np.concatenate([one.bound_cm for one in solved])
    finite = bounds[np.isfinite(bounds)]
    ahead = np.concatenate(
        [np.abs(np.subtract(one.trial.arcs_cm, one.trial.obstacle_x_cm)) for one in solved]
    )
    measured = folded(ahead, bounds)[np.isfinite(bounds)]
    return Row(
        experiment,
        condition,
        len(solved),
        told.mean_cm,
        told.std_cm,
        errors(solved, here),
        errors(solved, OURS),
        float(ahead.mean()),
        float(finite.mean()) if finite.size else float("inf"),
        float(measured.mean()) if finite.size else float("inf"),
        int(bounds.size - finite.size),
        sum(one.answers[OURS].status == "ambiguous" for one in solved),
        errors(solved, ALONE) if all(ALONE in one.answers for one in solved) else None,
    )


def folded(offset: Floats, spread: Floats) -> Floats:
    """Mean absolute value of Gaussians.

    Args:
        offset: (K,) their means, zero or more.
        spread: (K,) their mean absolute deviations.
    """
    deviation = np.maximum(np.sqrt(np.pi / 2) * spread, 1e-9)
    share = offset / deviation
    return np.asarray(spread * np.exp(-0.5 * share**2) + offset * special.erf(share / np.sqrt(2.0)))


def errors(solved: Sequence[Solved], method: str) -> Errors:
    """A method's errors over trials; trials without an answer are left out."""
    camera, assigned, room = (
        np.array([measure(one.trial, one.answers[method]) for one in solved])
        for measure in (camera_errors, assigned_errors, workspace_errors)
    )
    answered = np.isfinite(camera).all(axis=1)
    if not answered.any():
        return Errors(*(float("nan"),) * 5)
    return Errors(
        float(camera[answered].mean()),
        float(camera[answered].std()),
        float(assigned[answered, 0].mean()),
        float(assigned[answered, -1].mean()),
        float(room[answered].mean()),
    )
