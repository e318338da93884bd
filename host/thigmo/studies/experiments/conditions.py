"""The thesis's three static experiments as trials on a simulated robot (`specimen.py`)."""

from __future__ import annotations

from functools import cache

import numpy as np

from thigmo.config import TanhMap
from thigmo.mechanics import Peg, Solution, Tube, solve
from thigmo.studies.experiments import thesis
from thigmo.studies.experiments.plan import plan
from thigmo.studies.experiments.specimen import Constants, Specimen
from thigmo.studies.experiments.trial import Passed, Trial

_STEP_CM = 0.02  # of the differences that the bound is made of


def simulated(
    experiment: str, specimen: Specimen, trials: int, rng: np.random.Generator
) -> list[Trial]:
    """So many trials of each place and condition; `rng` is of the hands that press."""
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


def actuated(specimen: Specimen, trials: int) -> list[Trial]:
    """Section 3.4: the left muscle bends the robot into a dowel that it just touches at 6 psi.

    Only the right column reads. Each inflation passes 6 psi untouched: what the sensors say there
    of themselves counts for all of the robot's trials. From there on it is read at every second
    psi. Where along the body the dowel bears at 10 and 14 psi, and whether on the side or on the
    tip's end, is for the mechanics to say.
    """
    curve, scale = specimen.muscle, 1 + specimen.map_error
    read = []
    for planned in plan("actuated", trials):
        way = (*thesis.passed_psi(planned.pressure_psi), planned.pressure_psi)
        bodies = [actuated_body(planned.arcs_cm[0], psi, curve) for psi in way]
        frames = np.array([specimen.read(body, one_side=True) for body, _ in bodies])
        read.append((planned, way, *bodies[-1], frames))
    believed = scale * curve.curvature(thesis.TOUCH_PSI)
    specimen.learn_gains(np.array([frames[0] for *_, frames in read]), believed)
    found = []
    for planned, way, body, peg, frames in read:
        true = tuple(curve.curvature(psi) for psi in way)
        free = scale * np.array(true)
        bound = obstacle_bound(peg, true, specimen.constants, specimen.gain_sigma)
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


def actuated_body(arc_cm: float, pressure_psi: float, muscle: TanhMap) -> tuple[Solution, Peg]:
    """The body bent into a dowel that touches its side there at 6 psi, and the dowel."""
    return _bent(arc_cm, muscle.curvature(thesis.TOUCH_PSI), muscle.curvature(pressure_psi))


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


@cache
def obstacle_bound(
    peg: Peg,
    free: tuple[float, ...],
    constants: Constants,
    gain_sigma: float,
) -> float:
    """Cramer-Rao bound of a dowel that stands still while the robot bends into it, from all frames.

    Unknown are the two coordinates of the dowel; every reading has its noise, and every sensor an
    error of its gain and of its place, the same in all frames. Bounded is the x of the contact in
    the last frame, as mean absolute error (cm) of a Gaussian estimator; infinite if singular.

    Args:
        peg: the dowel, touched in the last frame.
        free: (T,) free curvature in each frame, 1/cm.
        constants: noise and places.
        gain_sigma: relative standard deviation of the gains.
    """
    tube = Tube(thesis.DIAMETER_CM, thesis.CRITICAL)
    at = np.array(thesis.CENTERS_CM)

    def bent(dx: float, dy: float) -> tuple[np.ndarray, np.ndarray, float]:
        moved = Peg(peg.x + dx, peg.y + dy, peg.radius)
        found = [solve(g, thesis.LENGTH_CM, tube=tube, pegs=[moved]) for g in free]
        seen = np.array([body.averages(at, thesis.SPAN_CM) for body in found])
        onward = np.array([body.averages(at + _STEP_CM, thesis.SPAN_CM) for body in found])
        x = found[-1].contacts[-1].x if found[-1].contacts else float("nan")
        return seen, (onward - seen) / _STEP_CM, x

    here, slope, _ = bent(0.0, 0.0)
    jacobian, gradient = [], []
    for dx, dy in ((_STEP_CM, 0.0), (0.0, _STEP_CM)):
        (far, _, far_x), (near, _, near_x) = bent(dx, dy), bent(-dx, -dy)
        jacobian.append((far - near) / (2 * _STEP_CM))
        gradient.append((far_x - near_x) / (2 * _STEP_CM))
    information = np.zeros((2, 2))
    for sensor in range(len(at)):
        covariance = max(constants.noise, 1e-9) ** 2 * np.eye(len(free))
        covariance += np.outer(here[:, sensor], here[:, sensor]) * gain_sigma**2
        covariance += np.outer(slope[:, sensor], slope[:, sensor]) * constants.position_cm**2
        sensed = np.array([part[:, sensor] for part in jacobian])
        information += sensed @ np.linalg.solve(covariance, sensed.T)
    if np.linalg.cond(information) > 1e12:
        return float("inf")
    variance = np.array(gradient) @ np.linalg.solve(information, np.array(gradient))
    return float(np.sqrt(2 / np.pi * variance))
