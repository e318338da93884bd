"""Stated priors and thresholds: everything that the evidence rests on, in one place.

All are in units of the everted length: arc over length, curvature times length, base moment over
EI times length. None depends on the data.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# A contact lies anywhere on the body: uniform over 0..1. Its moment at the base, f a, is of either
# sign: an equal mixture of N(0, 0.25^2) and N(0, 1.5^2). For a body of 53 cm these deviations are
# 0.005 and 0.028 1/cm: unactuated contacts stay below 0.011 1/cm (a fold), actuated ones reach the
# free curvature.
MOMENT: Array = np.zeros(2)
SPREAD: Array = np.array([0.25, 1.5])
LOG_WEIGHT: Array = np.log(np.array([0.5, 0.5]))

# One reading in fifty may be an outlier, ten times wider than the noise.
OUTLIER_ODDS = 0.02 / 0.98
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
