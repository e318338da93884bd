"""The thesis's three static experiments as trials on a simulated robot (`specimen.py`)."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from thigmo.config import RobotConfig, TanhMap
from thigmo.emulator.scene import Scene
from thigmo.mechanics import Peg, Solution, Tube, solve
from thigmo.studies.experiments import thesis
from thigmo.studies.experiments.bound import obstacle_bound
from thigmo.studies.experiments.specimen import Specimen
from thigmo.studies.experiments.trial import Passed, Trial

_SIGNS = (-1.0, 1.0)  # a dowel on the left pushes to the right, one on the right to the left


@cache
def emulated_robot() -> RobotConfig:
    """The robot of the emulator's default scene: the thesis publishes no map of its muscles."""
    return Scene.load("default").robot


def single_contact(specimen: Specimen, trials: int, rng: np.random.Generator) -> list[Trial]:
    """Section 3.2: one contact at L, 3L/4, L/2; high force (the base folds) and low force."""
    found = []
    for level in thesis.LEVELS:
        for place, arc in zip(thesis.PLACES, thesis.SINGLE_ARCS_CM, strict=True):
            for _ in range(trials):
                sign = float(rng.choice(_SIGNS))
                high = level == "high force"
                # Hands do not press twice alike: five per cent. A folded base presses evenly.
                share = 1.0 if high else thesis.LOW_LEVEL * (1.0 + 0.05 * rng.standard_normal())
                force = sign * share * thesis.CRITICAL / arc
                fold = sign * specimen.constants.fold_rad if high else 0.0
                found.append(specimen.press(level, place, (arc,), (force,), fold_rad=fold))
    return found


def two_contacts(specimen: Specimen, trials: int, rng: np.random.Generator) -> list[Trial]:
    """Section 3.3: a distal contact at the tip, an opposed one a gap away from it."""
    return [
        specimen.press(
            thesis.separation(gap),
            f"{gap:g} cm apart",
            (thesis.LENGTH_CM - gap, thesis.LENGTH_CM),
            opposed_forces(gap, float(rng.choice(_SIGNS))),
        )
        for gap in thesis.GAPS_CM
        for _ in range(trials)
    ]


def opposed_forces(
    gap_cm: float,
    sign: float,
    length_cm: float = thesis.LENGTH_CM,
    critical: float = thesis.CRITICAL,
) -> tuple[float, float]:
    """Forces (1/cm^2) of a proximal contact and of an opposed distal one at the tip.

    The thesis does not state them. Here the distal one bends the body by three quarters of the
    critical moment at the proximal contact, and the proximal one pushes the base back to as much
    of the other sign: both are then well visible, and nothing folds.
    """
    distal = sign * 0.75 * critical / gap_cm
    wanted = -sign * 0.75 * critical
    return (wanted - distal * length_cm) / (length_cm - gap_cm), distal


def actuated(
    specimen: Specimen,
    trials: int,
    _: np.random.Generator | None = None,
    *,
    muscle: TanhMap | None = None,
    map_error: float = 0.0,
) -> list[Trial]:
    """Section 3.4: the left muscle bends the robot into a dowel that it just touches at 6 psi.

    Only the right column reads. Each inflation passes 6 psi untouched: what the sensors say there
    of themselves counts for all of the robot's trials. From there on it is read at every second
    psi. Where along the body the dowel bears at 10 and 14 psi, and whether on the side or on the
    tip's end, is for the mechanics to say.

    Args:
        specimen: the robot.
        trials: for each place and pressure.
        muscle: its map; None takes the emulated robot's.
        map_error: relative error of the free curvature that the lab believes.
    """
    curve = muscle or emulated_robot().actuators.left.maps[-1].inflate
    planned = [
        (level, place, arc, (*(p for p in thesis.PASSED_PSI if p < pressure), pressure))
        for level, pressure in thesis.ACTUATED_PSI.items()
        for place, arc in zip(thesis.PLACES, thesis.SINGLE_ARCS_CM, strict=True)
        for _ in range(trials)
    ]
    read = [
        np.array([specimen.read(actuated_body(arc, p, muscle)[0], one_side=True) for p in way])
        for _, _, arc, way in planned
    ]
    believed = (1 + map_error) * curve.curvature(thesis.TOUCH_PSI)
    specimen.learn_gains(np.array([frames[0] for frames in read]), believed)
    found = []
    for (level, place, arc, way), frames in zip(planned, read, strict=True):
        body, peg = actuated_body(arc, way[-1], muscle)
        true = tuple(curve.curvature(p) for p in way)
        free = (1 + map_error) * np.array(true)
        column = tuple(specimen.believed[: frames.shape[1]].tolist())
        bound = obstacle_bound(peg, true, column, specimen.constants, specimen.gain_sigma)
        passed = Passed(
            frames[:-1], free[:-1], specimen.gain_sigma, specimen.constants.position_cm, bound
        )
        found.append(
            specimen.observe(level, place, body, frames[-1], free=float(free[-1]), passed=passed)
        )
    return found


STATIC: dict[str, Callable[[Specimen, int, np.random.Generator], list[Trial]]] = {
    "single-contact": single_contact,
    "two-contacts": two_contacts,
    "actuated": actuated,
}


def actuated_body(
    arc_cm: float, pressure_psi: float, muscle: TanhMap | None = None
) -> tuple[Solution, Peg]:
    """The body bent into a dowel that it just touches with its side at 6 psi, and the dowel.

    Args:
        arc_cm: where it touches at 6 psi.
        pressure_psi: of the left muscle.
        muscle: its map; None takes the emulated robot's.
    """
    curve = muscle or emulated_robot().actuators.left.maps[-1].inflate
    return _bent(arc_cm, curve.curvature(thesis.TOUCH_PSI), curve.curvature(pressure_psi))


@cache
def _bent(arc_cm: float, touch: float, free: float) -> tuple[Solution, Peg]:
    tube = Tube(thesis.DIAMETER_CM, thesis.CRITICAL)
    heading = touch * arc_cm
    reach = tube.radius_cm + thesis.DOWEL_CM
    peg = Peg(
        float(np.sin(heading)) / touch - reach * float(np.sin(heading)),
        float(1 - np.cos(heading)) / touch + reach * float(np.cos(heading)),
        thesis.DOWEL_CM,
    )
    return solve(free, thesis.LENGTH_CM, tube=tube, pegs=[peg]), peg
