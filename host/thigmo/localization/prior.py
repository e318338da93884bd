"""Stated priors and thresholds: everything that the evidence rests on, in one place.

All are in units of the everted length: arc over length, curvature times length, base moment over
EI times length. None depends on the data.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from thigmo.compiled import compiled

Array = npt.NDArray[np.float64]


class BaseMoment(NamedTuple):
    """Prior of a contact's moment at the base: sum_k weight_k N(mean_k, spread_k^2).

    Attributes:
        mean, spread, weight: (K,).
    """

    mean: Array
    spread: Array
    weight: Array


# A contact lies anywhere on the body: uniform over 0..1. Its moment at the base, f a, is of either
# sign: N(0, 0.4^2) with weight 0.92, N(0, 1.5^2) with 0.08. For a body of 53 cm these deviations
# are 0.0075 and 0.028 1/cm: unactuated contacts stay below 0.011 1/cm (then the body folds),
# actuated ones seldom pass the free curvature. A wider prior costs precision where only one or two
# sensors feel the contact: it lets a strong force near the base pass for a weak one farther out.
BASE_MOMENT = BaseMoment(np.zeros(2), np.array([0.4, 1.5]), np.array([0.92, 0.08]))

# Nearer to the base than this the prior of the force no longer widens (1 cm of 53).
LEAST_LEVER = 0.02

# One reading in twenty may be an outlier, ten times wider than the noise. Rarer ones would let
# heavy tails (Laplace) feign contacts; narrower ones let a dead sensor feign a second contact.
OUTLIER_ODDS = 0.05 / 0.95
OUTLIER_VARIANCE = 100.0

# Mass of the intervals.
LEVEL = 0.95
# A contact is localized if its interval is no wider than this share of the length: 10 cm of the
# 53 cm body.
WIDTH_SHARE = 10.0 / 53.0

# Between HINT and the threshold the answer is `below detection`.
HINT = 0.0


def contact_threshold(readings: int, known: bool) -> float:
    """Log evidence ratio beyond which a contact is reported.

    Simulated (bench/calibration.py) for at most 1 % false contacts in empty scenes of 2 to 20
    readings; an unknown noise needs more, the fewer the readings.
    """
    return 2.0 if known else 2.0 + 5.0 / readings


# What a richer model must add in log evidence before it replaces the plain one: its prior odds.
FOLD_PENALTY = 3.0
TIP_MOMENT_PENALTY = 4.0
DISTRIBUTED_PENALTY = 3.0
THIRD_PENALTY = 1.5
# Share of contacts that bear on the end of a bent body, beside the uniform density over its side.
# Of pegs spread evenly over the room that a bending body of 20 to 53 cm sweeps, 10 to 11 % first
# touch its end and 15 % bear on it when their moment is measured, whatever it has turned by then
# (as `press` of bench/scenes.py draws them). A body that grows meets more of them with its end.
TIP_SHARE = 0.15
# A peg can only push; a load that pulls the end is attached to it, which is rare.
PULL_SHARE = 0.01
# Radius of a peg over that of the tube, where the two corners are weighed against the face.
PEG_RADIUS = 0.6

# Prior deviations: base fold (rad), tip moment over EI times length.
FOLD_ANGLE = 0.5
TIP_MOMENT = 0.4
# Relative deviation of the critical moment.
CRITICAL_SPREAD = 0.1
# Base moment from which a fold is suspected where the critical one is not given: that of the
# thesis's robot (0.01108 1/cm over 53 cm).
SUSPECT_MOMENT = 0.59
# Half widths of a distributed contact, share of the length.
HALF_WIDTHS = (0.05, 0.1, 0.2)
# Tube radius where the caller gives none: that of the 53 cm body.
TUBE_RADIUS = 1.75 / 53.0
# A contact on the end is drawn as one somewhere on the last hundredth of the body.
CORNER_WIDTH = 0.01
# Turning (rad) between base and contact from which levers are taken from the bent shape.
BEND = 0.25
# Turning of the whole body from which a force on its end has a lever of its own.
CORNER_BEND = 0.35

# Log evidence that a second contact must add to call for any richer model at all.
HINT_OF_MORE = 1.0


# Readings from which two contacts can differ from one and noise.
LEAST_FOR_TWO = 4


@compiled
def least_misfit(readings: int) -> float:
    """Misfit (sum of squared residuals over variance) below which no further contact is sought.

    It could add half of the misfit, and must add its penalty and what its own priors cost, which
    is less where few readings bind it. Simulated: below this, in 4000 scenes of one and two
    contacts on 5 to 20 readings, no frame without outliers gained a second contact. What looks
    like an outlier may be one.
    """
    return 2.5 + 0.5 * readings


def misfit_limit(readings: int) -> float:
    """Misfit that one contact passes in 5 % of scenes."""
    return _chi_squared(max(readings - 2, 1), 1.645)


def free_limit(readings: int) -> float:
    """Misfit that a free body passes in 0.1 % of frames."""
    return _chi_squared(readings, 3.09)


def _chi_squared(freedom: int, deviations: float) -> float:
    """Chi-squared from the normal deviate (Wilson and Hilferty)."""
    share = 2.0 / (9.0 * freedom)
    return freedom * (1.0 - share + deviations * math.sqrt(share)) ** 3


def second_threshold(readings: int, known: bool) -> float:
    """Log evidence ratio that each further contact must add (<= 5 % false second contacts)."""
    return 2.0 if known else 2.0 + 15.0 / readings
