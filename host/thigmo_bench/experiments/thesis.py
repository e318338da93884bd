"""The thesis's conditions and published results, which are to be repeated and improved on.

Source: M. Bryant, Tactile Perception for Growing Robots via Discrete Curvature Measurements, UC
San Diego, 2022, chapter 3. Errors are mean and standard deviation of |x error| in cm over five
trials of each condition. Comments mark what the thesis does not state and is therefore chosen here,
such as the size of its two forces and the places of the sensors.
"""

from __future__ import annotations

from math import nan

LENGTH_CM = 53.0
SPAN_CM = 5.5
DIAMETER_CM = 3.5
CRITICAL = 0.01108  # 1/cm, contact curvature at which the base folds, at 0.49 psi
TRIALS = 5
DOWEL_CM = 0.6  # radius; the dowels are of metal, their size is not stated
# Sensor centres are stated nowhere; pouches of 10 cm suggest 5, 15, ..
CENTERS_CM = (5.0, 15.0, 25.0, 35.0, 45.0)

LEVELS = ("high force", "low force")
PLACES = ("L", "3L/4", "L/2")
SINGLE_ARCS_CM = (LENGTH_CM, 0.75 * LENGTH_CM, 0.5 * LENGTH_CM)
# "High" folds the base (section 3.2); "low" is unstated: about a third of the critical moment
# brings the thesis's solver to the thesis's error (see `fit.py`).
LOW_LEVEL = 0.35
GAPS_CM = (39.0, 34.0, 29.0, 23.5, 18.5, 13.0)
DISCRIMINATION_CM = 23.5
LEAST_READINGS = 5  # that its solver needs
TOUCH_PSI = 6.0
ACTUATED_PSI = {"high force (14 psi)": 14.0, "low force (10 psi)": 10.0}
SEPARATIONS = ("23.5 cm or more apart", "closer than 23.5 cm")


def separation(gap_cm: float) -> str:
    """The condition of section 3.3 that a gap belongs to."""
    return SEPARATIONS[0] if gap_cm >= DISCRIMINATION_CM else SEPARATIONS[1]


RESULTS: dict[tuple[str, str], tuple[float, float]] = {
    ("single-contact", "high force"): (3.44, 1.38),
    ("single-contact", "low force"): (4.59, 6.78),
    ("single-contact", "high force, base clamped"): (2.98, 1.38),
    ("single-contact", "high force, coupled"): (1.93, 1.04),
    ("two-contacts", "23.5 cm or more apart"): (4.49, 2.79),
    ("two-contacts", "closer than 23.5 cm"): (16.94, 2.55),
    ("actuated", "high force (14 psi)"): (4.62, 0.95),
    ("actuated", "low force (10 psi)"): (15.21, 9.72),
    ("exploration", "obstacle at the farthest place"): (6.82, nan),
}
"""Mean and standard deviation (cm) by experiment and condition."""
