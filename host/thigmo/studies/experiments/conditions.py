"""The thesis's three static experiments as trials on a simulated robot (`specimen.py`)."""

from __future__ import annotations

from functools import cache

import numpy as np

from thigmo.config import RobotConfig, TanhMap
from thigmo.emulator.scene import Scene
from thigmo.mechanics import Peg, Solution, Tube, solve
from thigmo.studies.experiments import thesis
from thigmo.studies.experiments.bound import obstacle_bound
from thigmo.studies.experiments.plan import plan
from thigmo.studies.experiments.specimen import Specimen
from thigmo.studies.experiments.trial import Passed, Trial


@cache
def emulated_robot() -> RobotConfig:
    """The robot of the emulator's default scene: the thesis publishes no map of its muscles."""
    return Scene.load("default").robot


def simulated(
    experiment: str, specimen: Specimen, trials: int, rng: np.random.Generator
) -> list[Trial]:
    """All trials of an experiment.

    Args:
        experiment: one of `plan.STATIC`.
        specimen: the robot.
        trials: for each place and condition.
        rng: of the hands that press.
    """
    if experiment == "actuated":
        return actuated(specimen, trials)
    found = []
    for planned in plan(experiment, trials):
        # Hands do not press twice alike: five per cent. A folded base presses evenly.
        low = planned.condition == thesis.LEVELS[1]
        hand = 1.0 + 0.05 * float(rng.standard_normal()) if low else 1.0
        forces = [hand * force for force in planned.forces]
        fold = planned.sign * specimen.constants.fold_rad if planned.folds else 0.0
        found.append(
            specimen.press(planned.condition, planned.place, planned.arcs_cm, forces, fold_rad=fold)
        )
    return found


def actuated(
    specimen: Specimen, trials: int, muscle: TanhMap | None = None, map_error: float = 0.0
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
    read = []
    for planned in plan("actuated", trials):
        way = (*thesis.passed_psi(planned.pressure_psi), planned.pressure_psi)
        bodies = [actuated_body(planned.arcs_cm[0], psi, muscle) for psi in way]
        frames = np.array([specimen.read(body, one_side=True) for body, _ in bodies])
        read.append((planned, way, *bodies[-1], frames))
    believed = (1 + map_error) * curve.curvature(thesis.TOUCH_PSI)
    specimen.learn_gains(np.array([frames[0] for *_, frames in read]), believed)
    found = []
    for planned, way, body, peg, frames in read:
        true = tuple(curve.curvature(psi) for psi in way)
        free = (1 + map_error) * np.array(true)
        column = tuple(specimen.believed[: frames.shape[1]].tolist())
        bound = obstacle_bound(peg, true, column, specimen.constants, specimen.gain_sigma)
        passed = Passed(
            frames[:-1], free[:-1], specimen.gain_sigma, specimen.constants.position_cm, bound
        )
        found.append(
            specimen.observe(
                planned.condition, planned.place, body, frames[-1], free=float(free[-1]),
                passed=passed,
            )
        )  # fmt: skip
    return found


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
