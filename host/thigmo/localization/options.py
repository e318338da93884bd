"""What a `Localizer` is given once: the body, its sensors, their errors, what is known beforehand.

Every option of `localize` and `localize_batch` is a field here, declared and described once.
Lengths in any one unit (cm, mm, m), curvature in its inverse: answers scale with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from thigmo.localization import priors
from thigmo.localization.validation import Range


def _keep(part: object, *names: str) -> None:
    """Replace arrays by copies, so that nobody changes what was checked."""
    for name in names:
        value = getattr(part, name)
        if isinstance(value, (np.ndarray, list)):
            object.__setattr__(part, name, np.array(value))


@dataclass(frozen=True, slots=True)
class Body:
    """A slender body that may bend, and be touched.

    Attributes:
        length: everted length.
        tube_radius: radius of the body; 1.75/53 of the length if not given.
        critical_curvature: contact moment over EI at which the base folds, at this body pressure
            (it is proportional to it: `thigmo.mechanics.critical_moment`); infinity for a base
            that does not fold. If not given, a fold at any moment is considered. In space none is.
        critical_curvature_error: its relative standard error.
        stiffness: bending stiffness EI, in newtons times the unit of length squared, and its
            relative standard error; contacts of a frame then have `newtons`.
        twist: in space, bending over torsional stiffness, EI/GJ; 0 for a body that does not twist.
        weight: (3,) in space, weight per length over EI, 1/length^3: along the body at its base,
            towards direction 0, and a quarter turn on. `free_curvature` is then that of the body
            without its weight.
    """

    length: float
    tube_radius: float | None = None
    critical_curvature: float | None = None
    critical_curvature_error: float = priors.CRITICAL_ERROR
    stiffness: tuple[float, float] | None = None
    twist: float = 0.0
    weight: npt.ArrayLike | None = None

    def __post_init__(self) -> None:
        _keep(self, "weight")


@dataclass(frozen=True, slots=True)
class Sensors:
    """N curvature sensors along the body.

    A body is localized in space if its sensors have a direction, or if it has a weight. A grating
    of a fibre that reads both of its bends is two sensors at one place.

    Attributes:
        position: (N,) their centres, 0 at the base.
        span: scalar or (N,) their lengths; 0 for point sensors.
        direction: in space, (N,) the angle about the body (rad) towards which it bends where the
            reading is positive, the same frame carried along it without a twist; or (N, 3) unit
            vectors about which a sensor measures the turn per length: along the body, towards
            direction 0, and a quarter turn on.
    """

    position: npt.ArrayLike
    span: npt.ArrayLike = 0.0
    direction: npt.ArrayLike | None = None

    def __post_init__(self) -> None:
        _keep(self, "position", "span", "direction")


@dataclass(frozen=True, slots=True)
class Errors:
    """Standard errors of the readings. If you omit one that they have, answers are overconfident.

    Attributes:
        noise: white noise of a reading, scalar or (N,), 1/length; None if it is not known.
        zero_error: of each sensor's zero, scalar or (N,), 1/length: as noise of a single frame.
            An unknown noise includes it.
        gain_error: relative, of each sensor's gain, scalar or (N,).
        offset_error: of an offset that all readings share, 1/length.
        map_error: relative, of the free curvature, shared by all readings.
        shared_errors: (N, K) further errors that readings share: what each adds at one standard
            deviation, 1/length.
    """

    noise: npt.ArrayLike | None = None
    zero_error: npt.ArrayLike = 0.0
    gain_error: npt.ArrayLike = 0.0
    offset_error: float = 0.0
    map_error: float = 0.0
    shared_errors: npt.ArrayLike | None = None

    def __post_init__(self) -> None:
        _keep(self, "noise", "zero_error", "gain_error", "shared_errors")


@dataclass(frozen=True, slots=True)
class Priors:
    """What is known beforehand, and what an answer must reach to count as localized.

    Attributes:
        contacts: how many (0 to 3), or "auto" to let the evidence decide.
        held_end: whether something holds the end, so that it may bear any couple and be pulled; or
            the prior odds of that against a contact on the side. If not given, it is weighed.
        end_face_odds: prior odds of a contact on the face of the end, against one on the side: 0 if
            it cannot be touched there, the usual ones if not given.
        within: arcs between which a single contact is known to lie from other sources (a sweep that
            met nothing, for instance). It does not decide how many contacts there are.
        bad_reading_odds: prior odds that a given reading is bad, scalar or (N,).
        width_limit: widest 95 % interval that counts as localized; 10/53 of the length (10 cm of
            the 53 cm body) if not given.
        number_level: probability that the number of contacts must have before any of them counts
            as localized. 0 leaves the number open: each contact is a claim by itself.
    """

    contacts: int | Literal["auto"] = "auto"
    held_end: bool | float | None = None
    end_face_odds: float | None = None
    within: Range | None = None
    bad_reading_odds: npt.ArrayLike = priors.BAD_READING
    width_limit: float | None = None
    number_level: float = 0.0

    def __post_init__(self) -> None:
        _keep(self, "bad_reading_odds")
