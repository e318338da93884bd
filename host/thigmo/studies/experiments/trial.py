"""One trial: what the sensors read, and what is known of where the dowels were.

Simulated robots (`specimen.py`) and robots on the bench (`recorded.py`) give the same record, so
that one table compares the methods on either.
"""

from __future__ import annotations

from dataclasses import dataclass

from thigmo.studies.experiments import thesis
from thigmo.studies.rod import Floats


@dataclass(frozen=True)
class Passed:
    """What an actuated robot read at the pressures that it passed while the dowel stood there.

    The thesis's method does not look at it.

    Attributes:
        curvature: (T, N) readings of the trial's sensors, from the dowel's touch on.
        free: (T,) believed free curvature, 1/cm.
        gain_sigma: what a lab states as relative standard deviation of its sensors' gains, as far
            as they are not known (`Trial.gain`).
        place_cm: and of the sensors' places.
        bound_cm: Cramer-Rao bound of the contact's x in the room from all of the frames, as mean
            absolute error; NaN on a real robot.
    """

    curvature: Floats
    free: Floats
    gain_sigma: float
    place_cm: float
    bound_cm: float = float("nan")


@dataclass(frozen=True)
class Trial:
    """One set of readings and its truth.

    Attributes:
        condition: level of force or separation, in words.
        place: where the dowels were meant to be, in words.
        curvature, position, span: (N,) readings (1/cm), believed centres and spans (cm).
        free: believed free curvature, 1/cm.
        noise: white noise of a reading, 1/cm.
        gain: (N,) each reading's gain, as far as the untouched robot has shown it (1 elsewhere).
            The thesis's method does not look at it.
        sigma: (N,) what a lab states as each reading's standard deviation: white noise, the
            uncertainty of its gain, and that of its place times the slope of the readings.
        spread: (N,) its true standard deviation over robots, which the bound is made of; the
            stated one on a real robot.
        arcs_cm: contacts, base first: the true ones of a simulated robot, the intended ones of a
            real one.
        forces: their normal forces, 1/cm^2; NaN on a real robot.
        obstacle_x_cm: x of each dowel as a camera sees it, base first.
        contact_x_cm: x of each contact point on the skin; NaN on a real robot.
        offset_sigma: standard deviation of an error that all readings share, 1/cm.
        length_cm: everted length.
        critical: contact curvature at which the base folds, 1/cm.
        radius_cm: of the tube.
        dowel_cm: radius of the dowels.
        passed: readings on the way; None where the robot was pushed, not bent.
    """

    condition: str
    place: str
    curvature: Floats
    position: Floats
    span: Floats
    free: float
    noise: float
    gain: Floats
    sigma: Floats
    spread: Floats
    arcs_cm: tuple[float, ...]
    forces: tuple[float, ...]
    obstacle_x_cm: tuple[float, ...]
    contact_x_cm: tuple[float, ...]
    offset_sigma: float = 0.0
    length_cm: float = thesis.LENGTH_CM
    critical: float = thesis.CRITICAL
    radius_cm: float = thesis.DIAMETER_CM / 2
    dowel_cm: float = thesis.DOWEL_CM
    passed: Passed | None = None
