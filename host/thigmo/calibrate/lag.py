"""Time from measured pressure to bend, from ramps up and down with a stop at either end.

After a dead time, air and muscle act as a first-order lag, which is longer on the way down than up,
and the body swings. A slow bend is late by the sum of these times, and this sum is the board's one
constant; a first-order lag alone would be too long. Two effects that look like a lag are fitted as
well: the sensor's loop, which remains when the pressure stops, and an error of the pressure, whose
apparent lag is longer on slower ramps.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import bilinear, lfilter, lfilter_zi

from thigmo.calibrate.bench import Bench, Row
from thigmo.calibrate.columns import Array
from thigmo.calibrate.flex_lines import loop_turns
from thigmo.calibrate.regression import correlation_factor
from thigmo.config import Muscle, MuscleMap, TanhMap
from thigmo.errors import DataError

# Durations of ramps up and down, for a lag of 0.2..0.4 s. An error of pressure or map looks like a
# lag that is longer on slower ramps; a true lag is the same on all.
_RAMPS_S = (0.7, 0.7, 2.1) * 5
_RAMP_STOP_S = 1.5
_RAMP_END_PSI = 2.5  # just above the transducer's live zero
_RAMP_FRAME_S = 0.02
_STEP_S = 5e-3
# Upper bounds: time constants of the inflating and the deflating muscle, the swing, the root of its
# inertia, the dead time.
_LONGEST_S = (1.5, 1.5, 0.5, 0.5, 0.3)
_LEAST_S = 1e-3
# A reading is a sum of conversions. It is half a window old when the sum is complete, and waits as
# long for its frame, so it is late by one window. The base sensor is converted every millisecond,
# the others every second one (firmware/core/sensing/flex.h), which makes them later.
_LATER_SCAN_S = 1e-3


@dataclass(frozen=True)
class Lag:
    """Lag of the base sensor's reading behind the measured pressure, as the board sees both, s."""

    inflate_s: float
    inflate_se_s: float
    deflate_s: float
    deflate_se_s: float


def ramp(bench: Bench, muscle: Muscle, body_pressure: int) -> tuple[Array, Array, Array] | None:
    """Record ramps up and down: time (s), pressure (psi) and curvature towards a muscle (1/cm).

    The curvature is the mean of the sensors that read the bend, shifted to be as late as the base
    sensor. Returns None if no sound sensor reads it.
    """
    robot, top = bench.robot, 0.9 * muscle.max_pressure_psi
    wiring = bench.wiring
    sensors, bases = wiring.sensors_reading(muscle), wiring.base_inputs
    inputs = [wired.number for wired in sensors]
    if not any(wired.sound for wired in sensors):
        return None

    def take(key: str, _: None) -> Row:
        parts = []
        for seconds in _RAMPS_S:
            for target in (top, _RAMP_END_PSI):
                bench.press(muscle.name, target, top / seconds)
                parts.append(robot.record(seconds + _RAMP_STOP_S))
        robot.vent()
        t = np.concatenate([p.t_s for p in parts])
        number = bench.config.muscle_number(muscle.name)
        psi = np.concatenate([p.pressure_psi[:, number] for p in parts])
        ohm = np.concatenate([p.resistance[:, inputs] for p in parts])
        step = max(1, round(_RAMP_FRAME_S / float(np.median(np.diff(t)))))
        return {"t_s": t[::step], "psi": psi[::step], "ohm": ohm[::step]}

    prepare = partial(bench.ready_to_bend, body_pressure)
    key = f"ramp {muscle.name} body pressure {body_pressure}"
    (row,) = bench.rows("lag", {key: None}, take, prepare)
    t, psi, ohm = (np.array(row[name], float) for name in ("t_s", "psi", "ohm"))
    later = _LATER_SCAN_S * (1 << robot.parameter("oversample_log2")[0])
    bends = [
        np.interp(t + (0.0 if wired.number in bases else later), t, ohm[:, n])
        * wired.sensor.raw_scale
        / wired.share
        for n, wired in enumerate(sensors)
        if wired.sound
    ]
    return t, psi, np.mean(bends, axis=0)


def _muscle_pressure(psi: Array, rising_s: float, falling_s: float) -> Array:
    """Pressure (n,) that bends the body, every `_STEP_S`; each direction has its time constant."""
    rising, falling = (1 - np.exp(-_STEP_S / lag) for lag in (rising_s, falling_s))
    lagged = np.array(psi, float)
    state = float(lagged[0])
    for i, value in enumerate(((lagged[1:] + lagged[:-1]) / 2).tolist(), start=1):
        state += (rising if value > state else falling) * (value - state)
        lagged[i] = state
    return lagged


def _body_response(g: Array, late_s: float, inertia_s: float) -> Array:
    """(n,) curvature, every `_STEP_S`, of a second-order body that follows g."""
    b, a = bilinear([1.0], [inertia_s**2, late_s, 1.0], 1 / _STEP_S)
    return np.asarray(lfilter(b, a, g, zi=g[0] * lfilter_zi(b, a))[0])


def _deflating_share(psi: Array, reversal_psi: float) -> Array:
    """(n,) share of the deflating branch, 0..1, by a play operator as on the board."""
    share = np.empty(len(psi))
    floor = float(psi[0])
    for i, value in enumerate(psi.tolist()):
        floor = min(max(floor, value - reversal_psi), value)
        share[i] = 1 - (value - floor) / reversal_psi
    share[: int(np.argmax(psi > psi[0] + reversal_psi))] = 0.0  # it was vented before
    return share


def tanh_curve(psi: Array, amplitude: Array, scale_psi: Array, offset_psi: Array) -> Array:
    """`TanhMap.curvature` at pressures (n,); the constants are scalar or (n,)."""
    rise = np.tanh((np.maximum(psi, 0.0) - offset_psi) / scale_psi)
    return np.asarray(amplitude * (rise - np.tanh(-offset_psi / scale_psi)))


def _curve(tanh_map: TanhMap, psi: Array) -> Array:
    return tanh_curve(psi, *np.array([tanh_map.amplitude, tanh_map.scale_psi, tanh_map.offset_psi]))


def fit_lag(
    t_s: Array,
    pressure_psi: Array,
    curvature: Array,
    muscle_map: MuscleMap,
    reversal_psi: float = 1.0,
) -> Lag:
    """Lags of both directions from the ramps that `ramp` records.

    Args:
        t_s: (n,) times.
        pressure_psi: (n,) measured pressure.
        curvature: (n,) curvature towards the muscle, 1/cm, as late as the base sensor's. Its gain,
            offset and loop are fitted, so only its timing counts.
        muscle_map: its maps at the body pressure.
        reversal_psi: change of pressure that switches the muscle to its other branch.
    """
    rows = np.array([t_s, pressure_psi, curvature])
    rows = rows[:, np.isfinite(rows).all(axis=0)]
    t, p, k = rows[:, np.argsort(rows[0])]
    if len(t) < 50 or np.ptp(k) < 1e-3:
        raise DataError(
            "the ramp shows no bend to time", "ramp to 16 psi within 3 s, hold, and back"
        )
    fine = np.arange(t[0], t[-1] + _STEP_S, _STEP_S)
    fine_psi = np.interp(fine, t, p)

    def residuals(x: Array) -> Array:
        acting_psi = _muscle_pressure(np.interp(fine - x[4], fine, fine_psi), x[0], x[1])
        down = _deflating_share(acting_psi, reversal_psi)
        up, back = _curve(muscle_map.inflate, acting_psi), _curve(muscle_map.deflate, acting_psi)
        g = np.interp(t, fine, _body_response(down * back + (1 - down) * up, x[2], x[3]))
        loop = loop_turns(g[:, None], np.zeros(len(g), np.int64))[:, 0]
        slope = np.interp(t, fine, _curve(muscle_map.inflate, acting_psi + 0.1) - up)
        design = np.column_stack([g, np.ones(len(g)), loop, slope])
        return np.asarray(k - design @ np.linalg.lstsq(design, k, rcond=None)[0])

    fit = least_squares(
        residuals, [0.2, 0.2, 0.1, 0.1, 0.03], bounds=(_LEAST_S, _LONGEST_S),
        diff_step=[1e-2] * 5, x_scale=0.1,
    )  # fmt: skip
    misfit, slopes = fit.fun, np.asarray(fit.jac, float)
    variance = float(misfit @ misfit) / max(1, len(t) - 9) * correlation_factor(misfit, 0.98)
    covariance = np.linalg.pinv(slopes.T @ slopes) * variance
    sums = np.array([[1.0, 0.0, 1.0, 0.0, 1.0], [0.0, 1.0, 1.0, 0.0, 1.0]])
    (inflate, deflate), errors = sums @ fit.x, np.sqrt(np.diag(sums @ covariance @ sums.T))
    return Lag(float(inflate), float(errors[0]), float(deflate), float(errors[1]))
