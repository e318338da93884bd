"""A trial of the thesis's static experiments: its plan, and what was read in it.

Simulated robots (`specimen.py`) and robots on the bench (`recorded.py`) follow the same plan and
give the same record, so that one table compares the methods on both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thigmo.config import SIGN, Side
from thigmo.design import arc_bounds
from thigmo.errors import DataError
from thigmo_bench.experiments import thesis
from thigmo_bench.studies.rod import Floats

STATIC = ("single-contact", "two-contacts", "actuated")


@dataclass(frozen=True)
class Planned:
    """A trial that is planned."""

    # experiment, condition, place, number: its label; trials of a condition count from 1
    experiment: str
    condition: str
    place: str
    number: int
    side: Side  # of the robot on which the (distal) dowel stands; an actuated robot bends to it
    arcs_cm: tuple[float, ...]  # where the dowels touch, base first
    forces: tuple[float, ...] = ()  # with which they push, 1/cm^2; empty for an actuated robot
    pressure_psi: float = 0.0  # of the muscle on the dowel's side; 0 unactuated

    @property
    def key(self) -> str:
        """The trial's name in a folder."""
        return f"{self.condition} | {self.place} | {self.number}"

    @property
    def label(self) -> str:
        """The trial's name for a person."""
        return f"{self.experiment}, {self.condition}, {self.place}, trial {self.number}"

    @property
    def folds(self) -> bool:
        """Whether the push folds the base."""
        return self.condition == thesis.LEVELS[0]

    @property
    def sign(self) -> float:
        """Sign of the distal force: a dowel on the left pushes to the right."""
        return -SIGN[self.side]

    def fold(self, angle_rad: float) -> float:
        """The signed fold of the base (rad) if the push folds it by `angle`."""
        return self.sign * angle_rad if self.folds else 0.0


def plan(
    experiment: str,
    trials: int,
    length_cm: float = thesis.LENGTH_CM,
    critical: float = thesis.CRITICAL,
) -> list[Planned]:
    """All trials of an experiment in STATIC, in the thesis's order, with alternating sides.

    Places scale with the robot's length, forces with the contact curvature that folds its base.

    Raises:
        DataError: the robot is too short for the experiment.
    """
    arcs = [length_cm / thesis.LENGTH_CM * arc for arc in thesis.SINGLE_ARCS_CM]
    places = list(zip(thesis.PLACES, arcs, strict=True))
    # Condition, place, arcs, forces of a dowel on the right side, pressure.
    rows: list[tuple[str, str, tuple[float, ...], tuple[float, ...], float]]
    if experiment == "single-contact":
        rows = [
            (level, place, (arc,), (share * critical / arc,), 0.0)
            for level, share in zip(thesis.LEVELS, (1.0, thesis.LOW_LEVEL), strict=True)
            for place, arc in places
        ]
    elif experiment == "actuated":
        rows = [
            (level, place, (arc,), (), pressure)
            for level, pressure in thesis.ACTUATED_PSI.items()
            for place, arc in places
        ]
    elif length_cm <= thesis.GAPS_CM[0]:
        raise DataError(
            f"two contacts {thesis.GAPS_CM[0]:g} cm apart do not fit on {length_cm:g} cm",
            "use a longer robot",
        )
    else:
        rows = [
            (
                thesis.separation(gap), f"{gap:g} cm apart", (length_cm - gap, length_cm),
                _opposed_forces(gap, length_cm, critical), 0.0,
            )
            for gap in thesis.GAPS_CM
        ]  # fmt: skip
    sides: tuple[tuple[Side, float], ...] = (("right", 1.0), ("left", -1.0))
    return [
        Planned(
            experiment, condition, place, number, side, where,
            tuple(sign * force for force in forces), pressure,
        )
        for condition, place, where, forces, pressure in rows
        for number in range(1, trials + 1)
        for side, sign in [sides[number % 2]]
    ]  # fmt: skip


def _opposed_forces(gap_cm: float, length_cm: float, critical: float) -> tuple[float, float]:
    """Forces (1/cm^2) of a proximal contact and of an opposed distal one at the tip.

    The thesis does not state them. Here the distal force causes three quarters of the critical
    moment at the proximal contact. The proximal force brings the moment at the base to as much of
    the opposite sign. Both contacts are then well visible, and nothing folds.
    """
    distal = 0.75 * critical / gap_cm
    return (-0.75 * critical - distal * length_cm) / (length_cm - gap_cm), distal


@dataclass(frozen=True)
class Trial:
    """One set of readings, and the true contacts."""

    condition: str  # level of force or separation, in words
    place: str  # where the dowels were meant to be, in words
    position: Floats  # (N,) believed centres, cm
    span: Floats  # (N,) active lengths, cm
    curvature: Floats  # (N,) readings, 1/cm
    free: float  # believed free curvature, 1/cm
    gain: Floats  # (N,) of each sensor, as far as the untouched robot has shown it; 1 elsewhere
    # (N,) standard deviation of the readings as a lab would state it, 1/cm: white noise, the
    # uncertainty of the gains, and that of the places times the slope of the readings
    sigma: Floats
    # contacts, base first: the true ones of a simulated robot, the intended ones of a real one
    arcs_cm: tuple[float, ...]
    forces: tuple[float, ...]  # their normal forces, 1/cm^2; NaN on a real robot
    obstacle_x_cm: tuple[float, ...]  # x of each dowel as a camera sees it, base first
    contact_x_cm: tuple[float, ...]  # x of each contact point on the skin; NaN on a real robot
    # mean absolute error at the Cramer-Rao bound, of each contact's arc; of a robot that bends into
    # a dowel, of the contact's x. Infinite where nothing fixes it, NaN where the forces are not
    # known.
    bound_cm: tuple[float, ...]
    offset_error: float = 0.0  # standard deviation of an error that all readings share, 1/cm
    length_cm: float = thesis.LENGTH_CM  # everted length
    critical: float = thesis.CRITICAL  # contact curvature at which the base folds, 1/cm
    radius_cm: float = thesis.DIAMETER_CM / 2  # of the tube
    robot: int = 0  # number of the simulated robot, whose errors its trials share


def arc_bound_cm(
    arcs_cm: tuple[float, ...],
    forces: tuple[float, ...],
    position: Floats,
    span: Floats,
    sigma: Floats,
    length_cm: float,
) -> tuple[float, ...]:
    """Mean absolute error of each arc for a Gaussian estimator at the beam model's bound."""
    stated = np.array(arcs_cm), np.array(forces), position, span, np.maximum(sigma, 1e-9)
    return tuple((np.sqrt(2 / np.pi) * arc_bounds(*stated, length_cm)).tolist())
