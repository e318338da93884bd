"""Three columns: the thesis, the thesis's method here, ours; with the Cramer-Rao bound beside them.

All methods see the same trials. Two errors are reported: the thesis's measure |a - x of the
obstacle|, which mixes arc length and x, and the workspace's |x of the estimated contact point - x
of the true one|, through the shape that each method's own answer implies.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thigmo.experiments import thesis
from thigmo.experiments.specimen import Trial
from thigmo.exploration.workspace import Bend, centreline, ramp_knots, skin_point
from thigmo.localization import localize
from thigmo.localization.baselines import BASELINES, Problem
from thigmo.mechanics import phi

Floats = NDArray[np.float64]


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


Method = Callable[[Trial], Answer]


def baseline(name: str) -> Method:
    """A baseline of the localizer, told the number of contacts as the thesis was."""

    def solve(trial: Trial) -> Answer:
        problem = Problem(
            trial.curvature - trial.free,
            trial.position,
            trial.span,
            thesis.LENGTH_CM,
            contacts=len(trial.arcs_cm),
            noise=max(trial.noise, 1e-6),
            critical_curvature=thesis.CRITICAL,
        )
        arcs, forces = BASELINES[name](problem)
        return Answer(tuple(arcs.tolist()), tuple(forces.tolist()))

    return solve


def ours(trial: Trial) -> Answer:
    """The project's localizer, told the number of contacts as the thesis was."""
    result = localize(
        trial.curvature,
        trial.position,
        length=thesis.LENGTH_CM,
        span=trial.span,
        free_curvature=trial.free,
        noise=trial.sigma,
        contacts=len(trial.arcs_cm),
        critical_curvature=thesis.CRITICAL,
        tube_radius=thesis.DIAMETER_CM / 2,
    )
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


def camera_errors(trial: Trial, answer: Answer) -> Floats:
    """|a - x of the obstacle|, contacts ordered along the arc (cm; infinite without an answer)."""
    if len(answer.arcs_cm) != len(trial.arcs_cm):
        return np.full(len(trial.arcs_cm), np.inf)
    return np.abs(np.subtract(sorted(answer.arcs_cm), trial.obstacle_x_cm))


def assigned_errors(trial: Trial, answer: Answer) -> Floats:
    """As `camera_errors`, with the assignment of estimates to obstacles that errs least."""
    from itertools import permutations

    if len(answer.arcs_cm) != len(trial.arcs_cm):
        return np.full(len(trial.arcs_cm), np.inf)
    options = [
        np.abs(np.subtract(order, trial.obstacle_x_cm)) for order in permutations(answer.arcs_cm)
    ]
    return min(options, key=lambda errors: float(errors.sum()))


def workspace_errors(trial: Trial, answer: Answer) -> Floats:
    """|x of the contact point| error through the answer's own shape (cm)."""
    if len(answer.arcs_cm) != len(trial.arcs_cm):
        return np.full(len(trial.arcs_cm), np.inf)
    curve = centreline(
        Bend(
            thesis.LENGTH_CM,
            trial.free,
            answer.bend or ramp_knots(zip(answer.arcs_cm, answer.forces, strict=True)),
            answer.fold_rad,
        )
    )
    radius = thesis.DIAMETER_CM / 2
    found = [
        skin_point(curve, arc, force, radius, answer.end_offset_cm)[0]
        for arc, force in sorted(zip(answer.arcs_cm, answer.forces, strict=True))
    ]
    return np.abs(np.subtract(found, trial.contact_x_cm))


def bound_cm(trial: Trial) -> Floats:
    """Mean absolute error of the arc at the Cramer-Rao bound of the beam model, per contact (cm).

    A Gaussian estimator at the bound has the mean absolute error sqrt(2 / pi) of its deviation;
    infinite where the information matrix is singular.
    """
    arcs = np.array(trial.arcs_cm)
    forces = np.array(trial.forces)
    step = 1e-3

    def lever(at: Floats) -> Floats:
        return np.column_stack([phi(a, trial.position, trial.span) for a in at])

    slope = (lever(arcs) - lever(arcs - step)) / step * forces
    jacobian = np.hstack([slope, lever(arcs)]) / max(trial.noise, 1e-9)
    scale = np.linalg.norm(jacobian, axis=0)
    if np.any(scale == 0):
        return np.full(arcs.size, np.inf)
    information = (jacobian / scale).T @ (jacobian / scale)
    if np.linalg.cond(information) > 1e10:
        return np.full(arcs.size, np.inf)
    variance = np.diag(np.linalg.inv(information)) / scale**2
    result: Floats = np.sqrt(2 / np.pi * variance[: arcs.size])
    return result


@dataclass(frozen=True)
class Row:
    """One line of the three-column table (cm)."""

    experiment: str
    condition: str
    trials: int
    thesis_mean: float
    thesis_std: float
    here_mean: float
    here_std: float
    ours_mean: float
    ours_std: float
    here_workspace_mean: float
    ours_workspace_mean: float
    bound_mean: float
    ambiguous: int

    @property
    def allowed(self) -> float:
        """What ours may be: the larger of half the thesis's method's error and 1.2 bounds."""
        bound = self.bound_mean if np.isfinite(self.bound_mean) else 0.0
        return max(0.5 * self.here_workspace_mean, 1.2 * bound)

    @property
    def beaten(self) -> bool:
        """Whether ours is within what is allowed, in the workspace."""
        return self.ours_workspace_mean <= self.allowed


def row(
    experiment: str,
    condition: str,
    trials: Sequence[Trial],
    here: Method,
    own: Method = ours,
) -> Row:
    """Run both methods over the trials of one condition."""
    told = thesis.published(experiment, condition)
    theirs = [here(trial) for trial in trials]
    mine = [own(trial) for trial in trials]
    camera_here = np.concatenate([camera_errors(t, a) for t, a in zip(trials, theirs, strict=True)])
    camera_own = np.concatenate([camera_errors(t, a) for t, a in zip(trials, mine, strict=True)])
    room_here = np.concatenate(
        [workspace_errors(t, a) for t, a in zip(trials, theirs, strict=True)]
    )
    room_own = np.concatenate([workspace_errors(t, a) for t, a in zip(trials, mine, strict=True)])
    bounds = np.concatenate([bound_cm(trial) for trial in trials])
    finite = bounds[np.isfinite(bounds)]
    return Row(
        experiment,
        condition,
        len(trials),
        told.mean_cm,
        told.std_cm,
        _mean(camera_here),
        _std(camera_here),
        _mean(camera_own),
        _std(camera_own),
        _mean(room_here),
        _mean(room_own),
        float(finite.mean()) if finite.size else float("inf"),
        sum(answer.status == "ambiguous" for answer in mine),
    )


def _mean(errors: Floats) -> float:
    answered = errors[np.isfinite(errors)]
    return float(answered.mean()) if answered.size else float("nan")


def _std(errors: Floats) -> float:
    answered = errors[np.isfinite(errors)]
    return float(answered.std()) if answered.size else float("nan")
