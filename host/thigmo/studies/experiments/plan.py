"""The thesis's three static experiments: what is pressed where, trial by trial.

One plan for simulated robots (`conditions.py`) and for robots on the bench (`procedure.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

from thigmo.config import Side
from thigmo.errors import DataError
from thigmo.studies.experiments import thesis

STATIC = ("single-contact", "two-contacts", "actuated")


@dataclass(frozen=True)
class Planned:
    """One trial to take."""

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
        """What names it in a folder."""
        return f"{self.condition} | {self.place} | {self.number}"

    @property
    def label(self) -> str:
        """What names it to a person."""
        return f"{self.experiment}, {self.condition}, {self.place}, trial {self.number}"

    @property
    def folds(self) -> bool:
        """Whether the push folds the base."""
        return self.condition == thesis.LEVELS[0]

    @property
    def sign(self) -> float:
        """Of the distal force: a dowel on the left pushes to the right."""
        return -1.0 if self.side == "left" else 1.0


def opposed_forces(
    gap_cm: float, length_cm: float = thesis.LENGTH_CM, critical: float = thesis.CRITICAL
) -> tuple[float, float]:
    """Forces (1/cm^2) of a proximal contact and of an opposed distal one at the tip.

    The thesis does not state them. Here the distal one bends the body by three quarters of the
    critical moment at the proximal contact, and the proximal one pushes the base back to as much
    of the other sign: both are then well visible, and nothing folds.
    """
    distal = 0.75 * critical / gap_cm
    return (-0.75 * critical - distal * length_cm) / (length_cm - gap_cm), distal


def plan(
    experiment: str,
    trials: int,
    length_cm: float = thesis.LENGTH_CM,
    critical: float = thesis.CRITICAL,
) -> list[Planned]:
    """All trials of an experiment of STATIC, in the thesis's order; sides in turn.

    Places scale with the robot's length; `critical` is the contact curvature at which its base
    folds, 1/cm.

    Raises:
        DataError: no such experiment; a robot too short for it.
    """
    scale = length_cm / thesis.LENGTH_CM
    singles = [scale * arc for arc in thesis.SINGLE_ARCS_CM]
    arcs = list(zip(thesis.PLACES, singles, strict=True))
    # Condition, place, arcs, forces of a dowel on the right side, pressure.
    rows: list[tuple[str, str, tuple[float, ...], tuple[float, ...], float]]
    if experiment == "single-contact":
        rows = [
            (level, place, (arc,), (share * critical / arc,), 0.0)
            for level, share in zip(thesis.LEVELS, (1.0, thesis.LOW_LEVEL), strict=True)
            for place, arc in arcs
        ]
    elif experiment == "two-contacts":
        if length_cm <= thesis.GAPS_CM[0]:
            raise DataError(
                f"two contacts {thesis.GAPS_CM[0]:g} cm apart do not fit on {length_cm:g} cm",
                "use a longer robot",
            )
        rows = [
            (
                thesis.separation(gap), f"{gap:g} cm apart", (length_cm - gap, length_cm),
                opposed_forces(gap, length_cm, critical), 0.0,
            )
            for gap in thesis.GAPS_CM
        ]  # fmt: skip
    elif experiment == "actuated":
        rows = [
            (level, place, (arc,), (), pressure)
            for level, pressure in thesis.ACTUATED_PSI.items()
            for place, arc in arcs
        ]
    else:
        raise DataError(
            f"{experiment!r} is not taken trial by trial", f"choose from {', '.join(STATIC)}"
        )
    found = []
    for condition, place, where, forces, pressure in rows:
        for number in range(1, trials + 1):
            side: Side = "left" if number % 2 else "right"
            sign = -1.0 if side == "left" else 1.0
            signed = tuple(sign * force for force in forces)
            found.append(
                Planned(experiment, condition, place, number, side, where, signed, pressure)
            )
    return found
