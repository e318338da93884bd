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
    """

    curvature: Floats  # (T, N) readings of the trial's sensors, from the dowel's touch on
    free: Floats  # (T,) believed free curvature, 1/cm
    # what a lab states as relative standard deviation of its sensors' gains, as far as they are not
    # known (`Trial.gain`)
    gain_sigma: float
    place_cm: float  # and of the sensors' places
    # Cramer-Rao bound of the contact's x in the room from all of the frames, as mean absolute
    # error; NaN on a real robot
    bound_cm: float = float("nan")


@dataclass(frozen=True)
class Trial:
    """One set of readings and its truth."""

    condition: str  # level of force or separation, in words
    place: str  # where the dowels were meant to be, in words
    # curvature, position, span: (N,) readings (1/cm), believed centres and spans (cm)
    curvature: Floats
    position: Floats
    span: Floats
    free: float  # believed free curvature, 1/cm
    noise: float  # white noise of a reading, 1/cm
    # (N,) each reading's gain, as far as the untouched robot has shown it (1 elsewhere). The
    # thesis's method does not look at it.
    gain: Floats
    # (N,) what a lab states as each reading's standard deviation: white noise, the uncertainty of
    # its gain, and that of its place times the slope of the readings
    sigma: Floats
    # (N,) its true standard deviation over robots, which the bound is made of; the stated one on a
    # real robot
    spread: Floats
    # contacts, base first: the true ones of a simulated robot, the intended ones of a real one
    arcs_cm: tuple[float, ...]
    forces: tuple[float, ...]  # their normal forces, 1/cm^2; NaN on a real robot
    obstacle_x_cm: tuple[float, ...]  # x of each dowel as a camera sees it, base first
    contact_x_cm: tuple[float, ...]  # x of each contact point on the skin; NaN on a real robot
    offset_sigma: float = 0.0  # standard deviation of an error that all readings share, 1/cm
    length_cm: float = thesis.LENGTH_CM  # everted length
    critical: float = thesis.CRITICAL  # contact curvature at which the base folds, 1/cm
    radius_cm: float = thesis.DIAMETER_CM / 2  # of the tube
    dowel_cm: float = thesis.DOWEL_CM  # radius of the dowels
    passed: Passed | None = None  # readings on the way; None where the robot was pushed, not bent
