"""Time from measured pressure to bend, from a ramp up and down with a stop at either end.

Air, muscle and swing of the body together pass for a first-order lag, larger on the way down than
up. A flex sensor's own loop looks much like a lag while the pressure moves, but it stays when the
pressure stops: both are fitted, or the lag would come out a tenth too long.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from thigmo.calibrate.flex_lines import loop_turns
from thigmo.config import Side, TanhMap, ZoneMap
from thigmo.errors import DataError

Array = NDArray[np.float64]

_TURN_PSI = 0.5  # a fall of that much is no noise: the muscle is on its other branch
_LONGEST_S = 1.5


@dataclass(frozen=True)
class Lag:
    """Lag of the bend behind the measured pressure, s, each with its standard error."""

    inflate_s: float
    inflate_se_s: float
    deflate_s: float
    deflate_se_s: float


def low_pass(t_s: Array, values: Array, rising_s: float, falling_s: float) -> Array:
    """First-order lag of a sampled signal (n,), its time constant by the direction of change."""
    made = np.array(values, float)
    for i in range(1, len(made)):
        lag = rising_s if values[i] > made[i - 1] else falling_s
        share = 1.0 if lag <= 0 else 1 - np.exp(-(t_s[i] - t_s[i - 1]) / lag)
        made[i] = made[i - 1] + share * (values[i] - made[i - 1])
    return made


def _deflating(psi: Array) -> NDArray[np.bool_]:
    """(n,) whether the muscle is on its deflating branch."""
    made = np.zeros(len(psi), bool)
    down, mark = False, float(psi[0])
    for i, value in enumerate(psi.tolist()):
        mark = min(mark, value) if down else max(mark, value)
        if abs(value - mark) > _TURN_PSI:
            down, mark = not down, value
        made[i] = down
    return made


def _curve(made: TanhMap, psi: Array) -> Array:
    """Free curvature (n,) at pressures (n,)."""
    p = np.maximum(psi, 0.0)
    turn = np.tanh((p - made.offset_psi) / made.scale_psi)
    return np.asarray(made.amplitude * (turn - np.tanh(-made.offset_psi / made.scale_psi)))


def fit_lag(t_s: Array, pressure_psi: Array, curvature: Array, zone: ZoneMap, side: Side) -> Lag:
    """Lags of both directions from a recorded ramp: pressure, and curvature by the sensors.

    The curvature may be off by a gain, an offset and a loop (they are fitted): only its timing
    counts.

    Args:
        t_s: (n,) times.
        pressure_psi: (n,) measured.
        curvature: (n,) 1/cm.
        zone: maps at the body pressure of the ramp.
        side: which muscle.

    Raises:
        DataError: fewer than 50 samples, or no bend.
    """
    good = np.isfinite(t_s) & np.isfinite(pressure_psi) & np.isfinite(curvature)
    t, p, k = t_s[good], pressure_psi[good], curvature[good]
    if len(t) < 50 or np.ptp(k) < 1e-3:
        raise DataError(
            "the ramp shows no bend to time", "ramp to 16 psi within 5 s, hold, and back"
        )
    order = np.argsort(t)
    t, p, k = t[order], p[order], k[order]
    sign = 1.0 if side == "left" else -1.0

    def residuals(x: Array) -> Array:
        felt = low_pass(t, p, x[0], x[1])
        down = _deflating(felt)
        g = sign * np.where(down, _curve(zone.deflate, felt), _curve(zone.inflate, felt))
        loop = loop_turns(g[:, None], np.zeros(len(g), np.int64))[:, 0]
        design = np.column_stack([g, np.ones(len(g)), loop])
        return np.asarray(k - design @ np.linalg.lstsq(design, k, rcond=None)[0])

    fit = least_squares(
        residuals, [0.3, 0.3], bounds=(0.0, _LONGEST_S), diff_step=[1e-2, 1e-2], x_scale=0.1
    )
    rest, slopes = fit.fun, np.asarray(fit.jac, float)
    along = float(np.corrcoef(rest[1:], rest[:-1])[0, 1])
    along = min(0.98, max(0.0, along)) if np.isfinite(along) else 0.0
    variance = float(rest @ rest) / max(1, len(t) - 5) * (1 + along) / (1 - along)
    se = np.sqrt(np.diag(np.linalg.pinv(slopes.T @ slopes)) * variance)
    return Lag(float(fit.x[0]), float(se[0]), float(fit.x[1]), float(se[1]))
