"""The options of a `Localizer`: the body, its sensors, their errors, and prior knowledge.

Every option of `localize` and `localize_batch` is a field here, declared and described once.
Lengths are in any one unit (cm, mm, m), curvatures in its inverse, and so are the answers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from thigmo.localization import priors
from thigmo.localization.validation import Range


def _keep(part: object, *names: str) -> None:
    """Replace arrays by copies, so that a caller cannot change what was checked."""
    for name in names:
        value = getattr(part, name)
        if isinstance(value, (np.ndarray, list)):
            object.__setattr__(part, name, np.array(value))


@dataclass(frozen=True, slots=True)
class Body:
    """The slender body on which contacts are localized.

    Attributes:
        length: everted length.
        tube_radius: radius of the body; 1.75/53 of the length if not given.
        critical_curvature: contact moment over EI at which the base folds, at this body pressure
            (it is proportional to that pressure: `thigmo.mechanics.critical_moment`); infinity for
            a base that does not fold. If not given, a fold at any moment is considered. In space,
            folds are not considered.
        critical_curvature_error: relative standard error of `critical_curvature`.
        stiffness: bending stiffness EI, in newtons times the unit of length squared, and its
            relative standard error; contacts of a frame then have `newtons`.
        twist: bending over torsional stiffness, EI/GJ, in space; 0 for a body that does not twist.
        weight: (3,) weight per length over EI, in space, 1/length^3: its components along the body
            at the base, towards angle 0, and towards a quarter turn from it. `free_curvature`
            is then the curvature of the body without its weight.
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

    Contacts are localized in space, not in a plane, if the sensors have angles or axes, or the body
    has a weight. A fibre grating that measures both bends counts as two sensors at one place.

    Attributes:
        position: (N,) arcs of the sensors' centres, 0 at the base.
        span: scalar or (N,) lengths of the sensors; 0 for point sensors.
        angle: in space, (N,) the angle about the body (rad) towards which the body bends if the
            reading is positive, in a frame that is carried along the body without twist.
        axis: in place of `angle`, (N, 3) unit vectors of the axes about which the sensors measure
            the turn per length, with components along the body, towards angle 0, and towards a
            quarter turn from it.
    """

    position: npt.ArrayLike
    span: npt.ArrayLike = 0.0
    angle: npt.ArrayLike | None = None
    axis: npt.ArrayLike | None = None

    def __post_init__(self) -> None:
        _keep(self, "position", "span", "angle", "axis")


@dataclass(frozen=True, slots=True)
class Errors:
    """Standard errors of the readings.

    An error that is not stated (None) is not taken for zero: usual mistakes of its kind are weighed
    beside every explanation, and `LocalizeResult.doubts` has their probabilities. They widen the
    answer. Stating an error, or 0, takes its mistakes out.

    Attributes:
        noise: white noise of a reading, scalar or (N,), 1/length; None if it is not known.
        largest_noise_factor: factor by which the noise may at most exceed `noise`; 15 if it is not
            stated, 1 if the noise is certain.
        noise_correlation: correlation of neighbouring sensors' noise, from 0 to less than 1. If it
            is not stated, 0.5 and 0.9 are weighed for 40 sensors or more. Not in space.
        zero_error: error of each sensor's zero, scalar or (N,), 1/length. In a single frame it acts
            as noise; a noise of None includes it.
        gain_error: relative error of each sensor's gain, independent of the others', scalar or
            (N,). An error that all gains share looks like one of the map: not stated, it is 0.
        offset_error: error of an offset that all readings share, 1/length. If it is not stated, an
            offset of twice the noise is weighed.
        map_error: relative error of the free curvature, shared by all readings. If it is not
            stated, a free curvature is weighed that is 8 % off, has the wrong sign, was subtracted
            already, is far off, or was not given.
        base_fold_error: angle (rad) of a small fold at the base, shared by all readings. If it is
            not stated, one of 0.1 is weighed. Not in space.
        shared_errors: (N, K) effects on the readings of K further shared errors, at one standard
            deviation each, 1/length.
    """

    noise: npt.ArrayLike | None = None
    largest_noise_factor: float | None = None
    noise_correlation: float | None = None
    zero_error: npt.ArrayLike = 0.0
    gain_error: npt.ArrayLike | None = None
    offset_error: float | None = None
    map_error: float | None = None
    base_fold_error: float | None = None
    shared_errors: npt.ArrayLike | None = None

    def __post_init__(self) -> None:
        _keep(self, "noise", "zero_error", "gain_error", "shared_errors")


@dataclass(frozen=True, slots=True)
class Priors:
    """Prior knowledge of the contacts, and what an answer must reach to count as localized.

    Attributes:
        contacts: number of contacts (0 to 3), or "auto" to let the evidence decide.
        held_end: whether something holds the end, so that the end may bear any couple and be
            pulled; or, as a float, the prior odds of that against a contact on the side. If not
            given, default odds are used.
        contact_couple_odds: prior odds of a contact that bears a couple, such as a clamp, against
            one that does not; 0 rules it out. 0.015 if not given.
        end_face_odds: prior odds of a contact on the face of the end against one on the side; 0 if
            the face cannot be touched. If not given, default odds are used.
        within: two arcs between which a single contact is known to lie from other sources, such as
            a sweep without contact. It does not decide how many contacts there are.
        bad_reading_odds: prior odds that a given reading is bad, scalar or (N,).
        width_limit: widest 95 % interval that counts as localized; 10/53 of the length (10 cm of
            the 53 cm body) if not given.
        number_level: probability that the number of contacts must reach before any of them counts
            as localized. With 0, each contact is judged by itself, whatever their number.
    """

    contacts: int | Literal["auto"] = "auto"
    held_end: bool | float | None = None
    contact_couple_odds: float | None = None
    end_face_odds: float | None = None
    within: Range | None = None
    bad_reading_odds: npt.ArrayLike = priors.BAD_READING
    width_limit: float | None = None
    number_level: float = 0.0

    def __post_init__(self) -> None:
        _keep(self, "bad_reading_odds")
