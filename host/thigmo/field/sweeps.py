"""From a robot's sweeps and its robot.toml to what the fit takes.

Frames of a half sweep's way up are averaged into bins; sensors that have not settled count by their
average at the peak alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from thigmo.config import SIGN, Muscle, RobotConfig, Side
from thigmo.field.readings import Errors, Floats, Indices, Readings, Stage
from thigmo.mechanics import critical_moment
from thigmo.robot import Peak, SensorTable, SweepResult
from thigmo.wiring import Wiring

# Of a bin: at most so many frames of 20 Hz, and so much turn of the whole free body (rad). At the
# start of a quick sweep the body passes a touch, or what gives way, within a few frames.
_FRAMES, _TURN = 6, 0.08
# A half sweep swings until so many lags of its muscle have passed. From there on the two responses
# of `_rises`, and their stated errors, hold.
_SWINGS = 1.6
_FLOOR = 1e-4  # 1/cm, least error of a bin: the board's rounding
_PEAK_FRAMES = 10
_HALF_RANGE = 3**0.5  # of evenly spread numbers, over their standard deviation
_GAP_S = 1.0  # without frames of a side, between two of its sweeps
_ENOUGH = 8  # frames whose scatter says the noise
# Shares of `zero_se` that stay for a run, change with each zeroing and with each sweep: a loop of
# hysteresis keeps to one side while the pressure rises.
_ZERO_PARTS = 1.1, 0.4, 0.28
_PRESSURE_DRIFT, _LEAST_OFFSET = 0.01, 8e-4
_FOLD = 0.1  # least relative error of the moment that folds: a body regulator is set by hand


class Swept(NamedTuple):
    """A sweep, and the body pressure at which it was made."""

    sweep: SweepResult
    body_pressure: int


class _Bin(NamedTuple):
    sweep: int
    stage: Stage
    curvature: Floats  # (sensors,)
    added: Floats  # (sensors,) noise beside the white one
    frames: int
    bend: float  # of the free body, signed
    rate: float
    half_range: float  # of the bend
    response: float  # by which the bend of a pure delay is higher


def fold_moment(config: RobotConfig, body_pressure: int) -> float:
    """Contact moment over EI (1/cm) at which the base folds, at a body pressure."""
    body = config.body
    return critical_moment(
        body.critical_curvature,
        body.critical_pressure_psi,
        body.pressures[body_pressure].pressure_psi,
    )


def fold_moments(config: RobotConfig) -> Floats:
    """(pressures,) of `fold_moment`."""
    return np.array([fold_moment(config, n) for n in range(len(config.body.pressures))])


def read(sweeps: Sequence[Swept], side: Side, wiring: Wiring) -> tuple[Readings, Errors] | None:
    """Readings of a side's sweeps in their order, with their errors; None where there are none."""
    config, table, sign = wiring.config, SensorTable.laid_out(wiring), SIGN[side]
    swings_s = _SWINGS * config.muscle(side).lag_s
    most_bend = _TURN / config.body.length_cm
    rows: list[_Bin] = []
    scatter = []
    number = 0
    for sweep, body_pressure in sweeps:
        for rise in _rises(sweep, side, config.muscle(side), body_pressure):
            use = table.readable(side, sweep.sensors, rise.curvature)
            chosen = np.flatnonzero(rise.t_s >= rise.t_s[0] + swings_s)
            if chosen.size > _ENOUGH:  # white noise: what is left of second differences
                rough = np.diff(rise.curvature[chosen], 2, axis=0).std(axis=0) / 6**0.5
                scatter.append(np.where(use, rough, np.nan))
            rate = np.gradient(rise.bend, rise.t_s) if rise.t_s.size > 1 else np.zeros(1)
            stage = Stage(round(rise.peak.length_cm, 2), body_pressure)
            for part in _bins(chosen, rise.bend, most_bend):
                if use.any():
                    y = np.where(use, rise.curvature[part].mean(axis=0), np.nan)
                    bend, half = rise.bend[part], float(_HALF_RANGE * rise.bend[part].std())
                    mean = float(bend.mean()), float(rate[part].mean())
                    response = float(rise.response[part].mean())
                    rows.append(_Bin(number, stage, y, 0.0 * y, part.size, *mean, half, response))
            peak = rise.peak
            young = table.readable(side, peak.sensors, peak.curvature) & ~use
            if young.any():
                y = np.where(young, peak.curvature, np.nan)
                mean = peak.free_curvature, 0.0
                rows.append(_Bin(number, stage, y, peak.added_noise, _PEAK_FRAMES, *mean, 0.0, 0.0))
            number += 1
    if not rows:
        return None
    curvature = np.array([row.curvature for row in rows])
    has_reading = np.asarray(np.isfinite(curvature).any(axis=0))
    white = _white(np.array(scatter).reshape(-1, curvature.shape[1]), table.white)
    count = np.array([row.frames for row in rows])[:, None]
    beside = np.nan_to_num(np.array([row.added for row in rows]))
    noise = np.sqrt(white**2 / count + beside**2 + _FLOOR**2)
    stages = tuple(sorted({row.stage for row in rows}))
    lengths = np.array([round(row.stage.length) for row in rows])
    readings = Readings(
        curvature=sign * curvature[:, has_reading],
        noise=noise[:, has_reading],
        bend=sign * np.array([row.bend for row in rows]),
        rate=sign * np.array([row.rate for row in rows]),
        stage=np.array([stages.index(row.stage) for row in rows], dtype=np.intp),
        sweep=np.unique([row.sweep for row in rows], return_inverse=True)[1],
        zeroing=np.unique(lengths, return_inverse=True)[1],
        stages=stages,
        centers=table.center_cm[has_reading],
        spans=table.span_cm[has_reading],
        fold_moment=fold_moments(config),
        radius=config.body.radius_cm,
        half_range=np.array([row.half_range for row in rows]),
        response=sign * np.array([row.response for row in rows]),
    )
    return readings, stated(wiring, side, has_reading)


def _bins(frames: Indices, bend: Floats, most_bend: float) -> list[Indices]:
    """Frames (n,), by their numbers, in bins of few frames and little bend."""
    bins: list[Indices] = []
    first = 0
    for last in range(1, frames.size + 1):
        full = last == frames.size or last - first == _FRAMES
        if full or abs(bend[frames[last]] - bend[frames[first]]) > most_bend:
            bins.append(frames[first:last])
            first = last
    return bins


class _Rise(NamedTuple):
    """One way up of a half sweep."""

    t_s: Floats  # (n,)
    bend: Floats  # (n,) of the free body, signed, 1/cm: midway between a lag and a delay
    response: Floats  # (n,) by which a delay is higher
    curvature: Floats  # (n, sensors)
    peak: Peak


def _rises(sweep: SweepResult, side: Side, muscle: Muscle, body_pressure: int) -> list[_Rise]:
    """The ways up of one side: several where sweeps were joined, as repeated measurements are."""
    frames, curvature = sweep.half(side)
    peaks = [peak for peak in sweep.peaks if peak.side == side]
    if not frames or not peaks:
        return []
    t_s, psi, lagged = np.array([(f.t_s, f.pressure_psi, f.free_curvature) for f in frames]).T
    inflate = muscle.maps[body_pressure].inflate
    delayed_psi = np.interp(t_s - muscle.lag_s, t_s, psi)
    delayed = SIGN[side] * np.array([inflate.curvature(p) for p in delayed_psi])
    parts = np.split(np.arange(t_s.size), np.flatnonzero(np.diff(t_s) > _GAP_S) + 1)
    rises = []
    for part in parts:
        up = part[: int(psi[part].argmax()) + 1]
        peak = min(peaks, key=lambda peak: abs(peak.t_s - t_s[up[-1]]))
        bend, response = 0.5 * (lagged + delayed)[up], 0.5 * (delayed - lagged)[up]
        rises.append(_Rise(t_s[up], bend, response, curvature[up], peak))
    return rises


def _white(scatter: Floats, stated: Floats) -> Floats:
    """(n,) white noise of each sensor: the median of the sweeps', or the stated one."""
    readings = [column[np.isfinite(column)] for column in scatter.T]
    return np.array(
        [np.median(s) if s.size else w for s, w in zip(readings, stated, strict=True)]
    )  # fmt: skip


def stated(wiring: Wiring, side: Side, use: npt.NDArray[np.bool_]) -> Errors:
    """Errors of the sensors in `use` as robot.toml states them, with drifts since calibration."""
    config, table = wiring.config, SensorTable.laid_out(wiring)
    muscle, body = config.muscle(side), config.body
    rows = [sensor for sensor, used in zip(wiring.read_sensors, use, strict=True) if used]
    zero = np.array([sensor.zero_error if sensor else 0.0 for sensor in rows])
    constant, zeroing, sweep = (share * zero for share in _ZERO_PARTS)
    gain = np.array([sensor.gain_error if sensor else 0.0 for sensor in rows])
    drift = np.array([sensor.drift_se if sensor else 0.0 for sensor in rows])
    against = np.array([sensor.response_against if sensor else (1.0, 0.0) for sensor in rows])
    shared = table.shared[use]
    return Errors(
        gain=np.hypot(gain, drift),
        place=np.array([sensor.center_se_cm if sensor else 0.0 for sensor in rows]),
        zero=constant,
        zero_zeroing=zeroing,
        zero_sweep=sweep,
        shared=shared[:, np.any(shared != 0.0, axis=0)],
        map_by_pressure=np.hypot([entry.scale_se for entry in muscle.maps], _PRESSURE_DRIFT),
        map_offset=max(muscle.offset_se, _LEAST_OFFSET),
        map=muscle.drift_se,
        against=against[:, 0],
        against_error=against[:, 1],
        sweep=muscle.sweep_se,
        sweep_offset=muscle.sweep_offset_se,
        lag_s=muscle.lag_se_s,
        base=body.base_compliance_cm,
        base_error=body.base_compliance_se_cm,
        fold=max(body.critical_curvature_se / body.critical_curvature, _FOLD),
    )
