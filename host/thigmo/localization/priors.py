"""Stated priors and thresholds: everything that the evidence rests on, in one place.

All are in units of the everted length: arc over length, curvature times length, base moment over
EI times length. None depends on the data. They are handed to the compiled code with each
`Localizer`.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from thigmo.localization import _posterior

# Standard deviations of a contact's largest moment: a touch, a push, a lean; equally likely. For a
# body of 53 cm they are 0.003, 0.011 and 0.045 1/cm: unactuated contacts stay below the moment that
# folds the base, 0.011 1/cm, and actuated ones seldom pass the free curvature.
MOMENTS = (0.15, 0.6, 2.4)
# Nearer to the base than this share of the body the prior of the force no longer widens.
LEAST_LEVER = 0.02
# Share of contacts that a sweep brings about. A bend of the whole body carries each of its points
# across an area that grows as the square of the arc, and so do the chances of a peg there; of pegs
# spread evenly over the room 6 % bear on the first 40 % of the body. The others, as of a hand,
# lie anywhere alike, as all do in space.
SWEPT = 1.0 / 3.0

# Log prior odds against a free body whose readings are all good.
CONTACT = -1.2
# The same where the noise is unknown: what few readings say of it is as likely said by noise.
CONTACT_UNSURE = -3.0
# Of a contact on the end of a bent body, against one on its side. Of pegs spread evenly over the
# room that a bending body of 20 to 53 cm sweeps, 10 to 15 % bear on its end.
# Less here, for three free loads fit a contact on the side as well: weighed as often as pegs meet
# it, the end would be believed in a quarter of such frames instead of a seventh.
END = math.log(0.15 / 0.85) - 0.7
# The same where nothing but the contact bends the body, which then hardly meets a peg end on. Its
# three free loads fit two opposed contacts as well.
END_STRAIGHT = -7.0
# Of a hand or a clamp that holds the end of a body that need not be a tube: where an actuator bends
# it, and where nothing else does.
HELD = -1.0
HELD_STRAIGHT = 0.0
# Of one more contact: one frame in six has another beside the first.
ANOTHER = math.log(1.0 / 5.0)
# Of a kink anywhere on the body.
HINGE = -5.0
# Of a fold near the base, where the caller does not say at which moment the body folds.
BASE_FOLD = -2.0
# Odds that a given reading is bad, where the caller does not say.
BAD_READING = 1e-3
# Standard deviation of a bad reading; one that is stuck departs by its free curvature as well.
BAD_DEVIATION = 0.5
# Standard deviation of a fold's or a hinge's angle (rad).
ANGLE = 0.5

# Relative standard error of the critical moment, where the caller does not say.
CRITICAL_ERROR = 0.1
# Share of the critical moment from which a fold is weighed.
NEAR_FOLD = 0.75
# Tube radius where the caller gives none: that of the 53 cm body.
TUBE_RADIUS = 1.75 / 53.0

# Turn (rad) of the whole body below which it counts as straight, and from which a contact on its
# end is weighed apart; change of curvature below which a shape rests.
STRAIGHT = 0.25
END_TURN = 0.35
SHAPE_RESTS = 0.02
# A contact on the end is drawn as one on this last share of the body.
END_CELL = 0.01

# Mass of the intervals; probability below which something is excluded.
LEVEL = 0.95
EXCLUDED = 0.05
# Standard errors by which a contact moves the readings, from which it counts: a weaker one can
# never be excluded.
FELT = 3.0
# The same of a held end, whose odds nobody knows to a factor of ten.
HELD_EXCLUDED = 0.005
# A contact is localized if its interval is no wider than this share of the length: 10 cm of 53.
WIDTH_SHARE = 10.0 / 53.0
# Misfit of a free body over that of a contact, from which the contact is listed whatever its
# probability: five standard errors.
FIVE_SIGMA = 25.0
# Log odds against the likeliest explanation below which one is not weighed further.
HOPELESS = -7.0
# Standard normal deviate of the misfit that calls for further explanations: 2 % of true ones.
MISFIT_DEVIATE = 2.0

# Readings are never trusted to more than this share of the largest of them or of the free
# curvature: no beam model and no sensor constant is better.
TRUST = 5e-4
# Where one contact leaves a misfit beyond this standard normal deviate, as 31 % of true ones do,
# the noise may be larger than stated: by this factor, and with this probability.
NOISE_DEVIATE = 0.5
NOISE_FACTOR = 2.4
NOISE_ODDS = 0.18
# Where the noise is unknown, its levels: shares of the readings' root mean square.
NOISE_LEVELS = tuple(1.3 * 0.6**level for level in range(9))


def place_density(place: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Prior density of contacts on the side of a body of length one, in a plane."""
    return 1.0 - SWEPT + 3.0 * SWEPT * place**2


def narrow(interval: tuple[float, float], length: float) -> bool:
    """Whether an interval on a body of a length is short enough to count as localized."""
    return interval[1] - interval[0] <= WIDTH_SHARE * length + 1e-9


def compiled() -> _posterior.Priors:
    """All of them, as the compiled code takes them."""
    return _posterior.Priors({name.lower(): globals()[name] for name in _NAMES})


_NAMES = tuple(name for name in globals() if name.isupper())
