"""Is the robot still what robot.toml says? Drift, leaks, dead sensors, swapped sides."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from thigmo.calibrate.columns import medians, places_of
from thigmo.calibrate.verdict import StepResult, Verdict
from thigmo.config import SIDES, RobotConfig, Side
from thigmo.errors import DataError

Array = NDArray[np.float64]
Mark = Literal["ok", "warning", "bad"]


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at."""

    what: str
    mark: Mark
    text: str


@dataclass(frozen=True)
class CheckReadings:
    """What a short check records."""

    rest_ohm: Array  # (n, m) straight and vented
    bend_ohm: dict[Side, Array]  # readings (m,) with one muscle at `bend_psi`, by side
    bend_psi: float  # muscle pressure of those readings
    bend_seen: dict[Side, float]  # curvature by camera, by side; empty without a camera
    # (t, 2) time (s) and pressure while a muscle is held, by side, for the leak
    held_psi: dict[Side, Array]
    zone: int = 0  # pressure zone in use


@dataclass(frozen=True)
class CheckResult(StepResult):
    """All findings."""

    findings: tuple[Finding, ...]
    verdict: Verdict


def run_check(readings: CheckReadings, config: RobotConfig) -> CheckResult:
    """Judge a check's recordings against the configuration.

    Raises:
        DataError: columns that disagree with the configuration.
    """
    sensors = places_of(config)
    rest = np.atleast_2d(readings.rest_ohm)
    if rest.shape[1] != len(sensors):
        raise DataError(f"{rest.shape[1]} columns for {len(sensors)} sensors", "use its robot.toml")
    zero = medians(rest)
    findings = [
        _at_rest(side, k, zero[column], rest[:, column], config)
        for column, (side, k) in enumerate(sensors)
    ]
    for side in SIDES:
        if side in readings.bend_ohm:
            findings.extend(_bent(side, readings, zero, sensors, config))
        if side in readings.held_psi:
            findings.append(_leak(side, readings))
    bad, warned = (
        [f"{f.what}: {f.text}" for f in findings if f.mark == mark] for mark in ("bad", "warning")
    )
    first, *notes = [*(bad or ["the robot is as robot.toml says"]), *warned]
    return CheckResult(tuple(findings), Verdict(not bad, first, tuple(notes)))


def _at_rest(side: Side, k: int, zero: float, values: Array, config: RobotConfig) -> Finding:
    sensor = config.sensors.column(side)[k]
    name = f"sensor {side} {k}"
    if not sensor.healthy:
        return Finding(name, "ok", "marked unhealthy, not used")
    if not np.isfinite(zero) or zero > 300_000:
        return Finding(name, "bad", "open circuit; check its wire or mark it unhealthy")
    if zero < 1_000:
        return Finding(name, "bad", "shorted; check its wire or mark it unhealthy")
    drift = (zero - sensor.zero_ohm) * sensor.scale_per_ohm
    scatter = float(np.nanstd(values)) * abs(sensor.scale_per_ohm)
    if abs(drift) > 0.02:
        return Finding(name, "warning", f"its zero has drifted by {drift:+.3f} 1/cm: recalibrate")
    if scatter > 8 * sensor.noise:
        return Finding(name, "warning", f"scatters by {scatter:.4f} 1/cm: loose wire?")
    return Finding(name, "ok", f"zero within {abs(drift):.4f} 1/cm")


def _bent(
    side: Side,
    readings: CheckReadings,
    zero: Array,
    sensors: list[tuple[Side, int]],
    config: RobotConfig,
) -> list[Finding]:
    """One muscle inflated: camera, and sensors of both sides, against the map."""
    maps = config.actuators.side(side).maps
    sign = 1.0 if side == "left" else -1.0
    expected = sign * maps[readings.zone].inflate.curvature(readings.bend_psi)
    found: list[Finding] = []

    def add(what: str, mark: Mark, text: str) -> None:
        found.append(Finding(what, mark, text))

    seen = readings.bend_seen.get(side)
    what = f"{side} muscle"
    if seen is not None:
        if seen * sign < -0.002:
            add(what, "bad", "bends the robot to the other side: the muscles' tubes are swapped, "
                "or the camera is mirrored")  # fmt: skip
        elif abs(seen) < 0.3 * abs(expected):
            add(what, "bad", f"bends by {seen:+.4f} 1/cm, {expected:+.4f} were expected: no air, "
                "a leak, or a wrong map")  # fmt: skip
        elif abs(seen - expected) > 0.15 * abs(expected):
            add(what, "warning", f"bends by {seen:+.4f} 1/cm, the map says {expected:+.4f}: "
                "recalibrate the actuator")  # fmt: skip
        else:
            add(what, "ok", f"bends by {seen:+.4f} 1/cm as mapped")
    bent = readings.bend_ohm[side]
    shares: dict[Side, list[float]] = {"left": [], "right": []}
    target = seen if seen is not None else expected
    for column, (of, k) in enumerate(sensors):
        sensor = config.sensors.column(of)[k]
        if not sensor.healthy or not np.isfinite(bent[column]) or not np.isfinite(zero[column]):
            continue
        share = (bent[column] - zero[column]) * sensor.scale_per_ohm / target
        shares[of].append(float(share))
        if of != side and abs(share) < 0.15:
            add(f"sensor {of} {k}", "bad",
                "does not answer to bending: dead, or its pouch is loose")  # fmt: skip
    far: Side = "right" if side == "left" else "left"
    if len(shares[far]) >= 2 and len(shares[side]) >= 2:
        off = {s: float(np.median(np.abs(np.array(v) - 1))) for s, v in shares.items()}
        if off[far] > 0.3 and off[side] < 0.5 * off[far] and (off[side] < 0.3):
            add("sensor columns", "bad", f"with the {side} muscle the {side} sensors fit and the "
                "others do not: the columns are swapped")  # fmt: skip
        elif float(np.median(shares[far])) < -0.3:
            add("sensor columns", "bad",
                "read bends with the wrong sign: swapped sides, or an old robot.toml")  # fmt: skip
        elif off[far] > 0.15:
            text = f"read {100 * off[far]:.0f} % off the bend: recalibrate flex"
            add(f"{far} sensors", "warning", text)
    return found


def _leak(side: Side, readings: CheckReadings) -> Finding:
    """Whether holding a pressure takes more and more drive, or the pressure sags."""
    record = readings.held_psi[side]
    what = f"{side} muscle's tightness"
    if len(record) < 10:
        return Finding(what, "warning", "too short a hold to judge")
    t, p = record[:, 0], record[:, 1]
    slope = float(np.polyfit(t, p, 1)[0])
    sag = -slope * float(np.ptp(t))
    if sag > 0.5:
        return Finding(what, "bad", f"pressure falls by {sag:.1f} psi during the hold: a leak")
    return Finding(what, "ok", f"holds within {abs(sag):.2f} psi")
