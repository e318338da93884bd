"""Priors and thresholds of the localizer, all in one place.

All are in units of the everted length: arc over length, curvature times length, base moment over
EI times length. None depends on the data. Each `Localizer` passes them to the compiled code.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from thigmo.localization import _posterior

# Standard deviations of a contact's moment at the base: a touch, a push and a strong push, equally
# likely. For a body of 53 cm they are 0.003, 0.011 and 0.045 1/cm. Unactuated contacts stay below
# the moment that folds the base, 0.011 1/cm; actuated ones seldom exceed the free curvature.
MOMENTS = (0.15, 0.6, 2.4)
# Share of the body next to the base in which the prior of the force does not widen further.
LEAST_LEVER = 0.02
# Share of contacts that a sweep causes. When the whole body bends, each of its points crosses an
# area that grows as the square of its arc, and so does the chance to meet a peg: of pegs spread
# evenly over the room, 6 % touch the first 40 % of the body. All other contacts, a hand's for
# instance, are equally likely at all places; in space, all contacts are.
SWEPT = 1.0 / 3.0

# Log prior odds against a free body whose readings are all good.
CONTACT = -1.2
# The same if the noise is unknown: noise explains what a few readings show just as well.
CONTACT_UNSURE = -3.0
# Log prior odds of a contact on the end of a bent body, against one on its side. Of pegs spread
# evenly over the room that a bending body of 20 to 53 cm sweeps, 10 to 15 % touch its end. The odds
# are lowered because three free loads on the end also fit a contact on the side: with that share,
# the end would be preferred in a quarter of the frames, not in a seventh.
END = math.log(0.15 / 0.85) - 0.7
# The same if only the contact bends the body, which then hardly meets a peg with its end. The three
# free loads fit two opposed contacts as well.
END_STRAIGHT = -7.0
# Log prior odds that a hand or a clamp holds the end of the body, which need not be a tube: if an
# actuator bends it, and if nothing else does.
HELD = -1.0
HELD_STRAIGHT = 0.0
# Log prior odds of one more contact: one frame in six has a second one beside the first.
ANOTHER = math.log(1.0 / 5.0)
# Log prior odds of a kink anywhere on the body.
HINGE = -5.0
# Log prior odds of a fold near the base, if the caller does not state the critical moment.
BASE_FOLD = -2.0
# Prior odds that a given reading is bad, if the caller does not state them.
BAD_READING = 1e-3
# Standard deviation of a bad reading. A stuck one also deviates by its free curvature.
BAD_DEVIATION = 0.5
# Standard deviation of a fold's or a hinge's angle (rad).
ANGLE = 0.5

# Relative standard error of the critical moment, if the caller does not state it.
CRITICAL_ERROR = 0.1
# Share of the critical moment from which a fold is considered.
NEAR_FOLD = 0.75
# Tube radius if the caller gives none: that of the 53 cm body.
TUBE_RADIUS = 1.75 / 53.0

# Turn (rad) of the whole body below which it counts as straight, and from which a contact on its
# end is considered separately; change of curvature below which a shape has converged.
STRAIGHT = 0.25
END_TURN = 0.35
SHAPE_RESTS = 0.02
# Last share of the body on which a contact on the end is drawn.
END_CELL = 0.01

# Posterior mass of the intervals; probability below which something is excluded.
LEVEL = 0.95
EXCLUDED = 0.05
# Standard errors by which a contact must move the readings to be counted: a weaker one can never be
# excluded.
DETECTED = 3.0
# The same for a held end and for a free one: their prior odds are not known to a factor of ten.
HELD_EXCLUDED = 0.005
# Misfit of a free body less that of a contact, from which the contact is listed whatever its
# probability: five standard errors.
FIVE_SIGMA = 25.0
# Log odds against the likeliest explanation below which an explanation is dropped.
HOPELESS = -7.0
# Standard normal deviate of the misfit above which further explanations are considered; the true
# explanation exceeds it in 2 % of frames.
MISFIT_DEVIATE = 2.0

# Least error of a reading, as a share of the largest reading or of the free curvature: neither beam
# models nor sensor constants are more accurate.
TRUST = 5e-4
# If the misfit of one contact is above this standard normal deviate, as in 31 % of what a correct
# model gives, larger noises are also considered: by these factors, with these probabilities.
NOISE_DEVIATE = 0.5
NOISE_FACTORS = (2.4, 6.0, 15.0)
NOISE_ODDS = (0.05, 0.06, 0.07)

# Mistakes in the readings that are weighed if the caller does not state the error: probability of
# each row, and its size. A free curvature a little off, as a share of itself, and an offset of all
# readings, as a multiple of the noise; one row has both, with the sum of their odds.
SLIGHT_MAP_ODDS = 0.08
SLIGHT_OFFSET_ODDS = 0.25
SLIGHT_MAP = 0.08
SLIGHT_OFFSET = 2.0
# A free curvature of the wrong sign, and one that was subtracted already.
TURNED_ODDS = 0.03
# A free curvature that is off by as much as itself, or by a curvature of one over the length; the
# latter, if the caller gives none.
FAR_ODDS = 0.1
NOT_GIVEN_ODDS = 0.3
# A fold of the base by a small angle (rad).
SMALL_FOLD_ODDS = 0.1
SMALL_FOLD = 0.1
# Noise whose neighbours are correlated by these coefficients, each with this probability, for this
# number of sensors or more.
CORRELATIONS = (0.5, 0.9)
CORRELATED_ODDS = 0.1
DENSE = 40.0
# Prior odds of a contact that bears a couple, against one that does not.
COUPLE_ODDS = 0.015
# Log odds of anything else against a free body below which no mistake is weighed: then the readings
# as stated are those of the free body.
UNTOUCHED = -1.0
# Log odds against the likeliest below which a row is left out after one contact was weighed.
DROPPED_ROW = -5.0
# Noise levels considered if the noise is unknown, as shares of the readings' root mean square.
NOISE_LEVELS = tuple(1.3 * 0.6**level for level in range(9))


def place_density(place: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Prior density of contacts at places (n,) on the side of a body of length one, in a plane."""
    return 1.0 - SWEPT + 3.0 * SWEPT * place**2


def compiled() -> _posterior.Priors:
    """All of these constants, in the form that the compiled code takes."""
    return _posterior.Priors({name.lower(): globals()[name] for name in _NAMES})


_NAMES = tuple(name for name in globals() if name.isupper())
