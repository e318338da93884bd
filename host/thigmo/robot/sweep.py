"""How slow a sweep must be.

The trigger compares the measured base curvature with the free curvature at the *measured*
pressure, filtered by the calibrated lag. What remains is the part of the lag that calibration
leaves unknown. During a sine of period T the free curvature changes at most by 2 pi g_max / T a
second, so that residual lag looks like a contact of 2 pi g_max lag / T. The period keeps it below
a fraction of the trigger's threshold.
"""

from __future__ import annotations

from math import pi

from thigmo.config import RobotConfig

TRIGGER_PER_CM = 0.005  # the contact threshold of the thesis, and the board's default
# Half of the lag stays unknown after calibration: one constant stands for muscles that inflate with
# 0.16 s and deflate with 0.22 s and for a body that swings at 1..2 Hz behind them.
RESIDUAL_LAG = 0.5
# Of the threshold, the share that this error may take: the rest is for noise, zero and hysteresis.
ALLOWED_FRACTION = 0.25
# Faster than this the pressure loop no longer follows 18 psi (0.15 s of transducer, 15 psi/s); a
# lower pressure is reached as steeply in less time.
FRAME_SPACING_S = 0.05  # between the frames of telemetry that a sweep keeps
SHORTEST_PERIOD_S = 15.0

# On the way up only, with the muscle's inflating lag alone, less of it is unknown.
RISING_RESIDUAL_LAG = 0.25


def rising_period_s(config: RobotConfig, body_pressure: int) -> float:
    """Period (s) of a sweep that only looks for contacts, and only on the way up."""
    return sweep_period_s(config, body_pressure, residual_lag=RISING_RESIDUAL_LAG)


def sweep_period_s(
    config: RobotConfig,
    body_pressure: int,
    *,
    trigger_per_cm: float = TRIGGER_PER_CM,
    residual_lag: float = RESIDUAL_LAG,
    top_psi: float | None = None,
) -> float:
    """Period (s) of a whole sweep, both directions, at a body pressure.

    `residual_lag` is the share of the calibrated lag that is not compensated; a sweep goes to
    `top_psi`, or as high as the muscles hold.
    """
    worst = share = 0.0
    for side in config.sides:
        muscle = config.muscle(side)
        maps = muscle.maps[body_pressure]
        top = muscle.max_pressure_psi if top_psi is None else top_psi
        g_max = max(curve.curvature(top) for curve in (maps.inflate, maps.deflate))
        worst = max(worst, g_max * muscle.lag_s * residual_lag)
        share = max(share, top / muscle.max_pressure_psi)
    slowest = 2 * pi * worst / (ALLOWED_FRACTION * trigger_per_cm)
    return max(slowest, SHORTEST_PERIOD_S * min(share, 1.0))
