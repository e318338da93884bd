"""Checks the robot against its robot.toml: drift, leaks, dead sensors, swapped sides."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from thigmo.calibrate.actuator import curvature_by_sensors
from thigmo.calibrate.bench import STEADY_S, Bench
from thigmo.calibrate.columns import Array, medians, sensors_of
from thigmo.calibrate.verdict import StepResult, Verdict
from thigmo.config import DEGREES, SIDES, SIGN, BoardSensor, RobotConfig, Side, opposite
from thigmo.errors import DataError

Mark = Literal["ok", "warning", "bad"]


@dataclass(frozen=True)
class Finding:
    """The result of checking one part."""

    part: str
    mark: Mark
    text: str


@dataclass(frozen=True)
class CheckReadings:
    """The recordings of a check."""

    rest_ohm: Array  # (n, m) resistances of the straight, vented robot
    bend_ohm: dict[Side, Array]  # resistances (m,) with the muscle of a side at `bend_psi`
    bend_psi: float  # muscle pressure of those readings
    camera_bend: dict[Side, float]  # curvature by camera, 1/cm, by side; empty without a camera
    # (t, 2) time (s) and pressure (psi) while the muscle of a side is held, to find leaks
    hold_psi: dict[Side, Array]
    body_pressure: int = 0  # number of the one in use
    # by name of a muscle out of the plane: bend by the sensors, 1/cm (nan if none reads it), and
    # (t, 2) time and pressure while it is held
    out_of_plane: dict[str, tuple[float, Array]] = field(default_factory=dict)


@dataclass(frozen=True)
class CheckResult(StepResult):
    """All findings."""

    findings: tuple[Finding, ...]
    verdict: Verdict


def guided(bench: Bench) -> CheckResult:
    """Record the robot at rest, then a bend and a hold of each muscle, and judge them."""
    bench.ready_to_bend()
    robot, config = bench.robot, bench.config
    reads = [robot.read(0.25) for _ in range(8)]
    rest_ohm, straight = np.array([bench.ohm(reading) for reading in reads]), reads[-1].resistance
    top = 0.7 * min(muscle.max_pressure_psi for muscle in config.muscles)
    readings = CheckReadings(
        rest_ohm, {}, top, {}, {}, body_pressure=len(config.body.pressures) - 1
    )
    for number, muscle in enumerate(config.muscles):
        bench.press(muscle.name, top)
        robot.wait(STEADY_S)
        record = robot.record(4.0)
        hold = np.column_stack([record.t_s - record.t_s[0], record.pressure_psi[:, number]])
        if muscle.side is None:
            change_ohm = robot.read(1.0).resistance - straight
            sensors = [w for w in bench.wiring.sensors_reading(muscle) if w.sound]
            bend = curvature_by_sensors(change_ohm[None], sensors)[0][0]
            readings.out_of_plane[muscle.name] = float(bend), hold
        else:
            readings.hold_psi[muscle.side] = hold
            readings.bend_ohm[muscle.side] = bench.mean_ohm(record)
            picture = bench.camera_reading(lambda: {"k": _bend(bench)}, {"k": None})
            if picture["k"] is not None:
                readings.camera_bend[muscle.side] = picture["k"]
        robot.vent()
        robot.wait(1.0)
    return run_check(readings, config)


def _bend(bench: Bench) -> float:
    """Curvature of the free bend that the camera sees, 1/cm."""
    axis = bench.camera.axis(free_bend=True, length_cm=bench.config.body.length_cm)
    return float(axis.coefficients[2])


def run_check(readings: CheckReadings, config: RobotConfig) -> CheckResult:
    """Judge a check's recordings. Raises DataError if the sensors are not this robot's."""
    sensors = sensors_of(config)
    if readings.rest_ohm.shape[1] != len(sensors):
        shapes = f"{readings.rest_ohm.shape[1]} columns for {len(sensors)} sensors"
        raise DataError(shapes, "use its robot.toml")
    zero = medians(readings.rest_ohm)
    scatter = np.ma.masked_invalid(readings.rest_ohm).std(axis=0).filled(np.nan)
    findings = []
    for number, (name, sensor) in enumerate(sensors.items()):
        mark, text = _judge_rest(sensor, zero[number], scatter[number])
        findings.append(Finding(f"sensor {name}", mark, text))
    for side in config.sides:
        findings += [Finding(*finding) for finding in _judge_bend(side, readings, zero, config)]
        tight = f"{config.muscle(side).name} muscle's tightness"
        findings.append(Finding(tight, *_judge_hold(readings.hold_psi[side])))
    for name, (bend, hold) in readings.out_of_plane.items():
        muscle_map = config.muscles[config.muscle_number(name)].maps[readings.body_pressure]
        expected = muscle_map.inflate.curvature(readings.bend_psi)
        if not np.isfinite(bend):
            text = "is not calibrated: no healthy sensor reads its bend, out of the plane"
            findings.append(Finding(f"{name} muscle", "warning", text))
        elif not muscle_map.calibrated:
            text = f"is not calibrated; it bends by {bend:+.4f} 1/cm"
            findings.append(Finding(f"{name} muscle", "warning", text))
        else:
            findings.append(Finding(f"{name} muscle", *_compare_with_map(bend, expected)))
        findings.append(Finding(f"{name} muscle's tightness", *_judge_hold(hold)))
    bad, warned = (
        [f"{f.part}: {f.text}" for f in findings if f.mark == mark] for mark in ("bad", "warning")
    )
    fine = "the robot is as robot.toml says"
    if warned:
        count = f"{len(warned)} warning{'s' if len(warned) > 1 else ''}"
        fine = f"the robot can be used, with {count}"
    first, *notes = [*(bad or [fine]), *warned]
    return CheckResult(tuple(findings), Verdict(not bad, first, tuple(notes)))


def _judge_rest(sensor: BoardSensor, zero: float, scatter: float) -> tuple[Mark, str]:
    if not sensor.healthy:
        return "ok", "marked unhealthy, not used"
    if not np.isfinite(zero) or zero > 300_000:
        return "bad", "open circuit; check its wire or mark it unhealthy"
    if zero < 1_000:
        return "bad", "shorted; check its wire or mark it unhealthy"
    drift = (zero - sensor.raw_zero) * sensor.raw_scale
    loose = scatter * abs(sensor.raw_scale)
    if abs(drift) > 0.02:
        return "warning", f"its zero has drifted by {drift:+.3f} 1/cm: recalibrate"
    if loose > 8 * sensor.noise:
        return "warning", f"scatters by {loose:.4f} 1/cm: loose wire?"
    return "ok", f"zero within {abs(drift):.4f} 1/cm"


def _judge_bend(
    side: Side, readings: CheckReadings, zero: Array, config: RobotConfig
) -> Iterator[tuple[str, Mark, str]]:
    """Findings of one inflated muscle: camera and sensors of both sides against the map."""
    sign = SIGN[side]
    muscle = config.muscle(side)
    mapped = muscle.maps[readings.body_pressure].inflate
    expected = sign * mapped.curvature(readings.bend_psi)
    target = measured = readings.camera_bend.get(side)
    subject = f"{muscle.name} muscle"
    if measured is None:
        target = expected
    else:
        yield subject, *_compare_with_map(measured, expected)
    shares: dict[Side, list[float]] = {side: [] for side in SIDES}
    change = readings.bend_ohm[side] - zero
    for (name, sensor), ohm in zip(sensors_of(config).items(), change.tolist(), strict=True):
        if not sensor.side or not sensor.healthy or not np.isfinite(ohm):
            continue
        share = ohm * sensor.raw_scale / target
        shares[sensor.side].append(share)
        if sensor.side != side and abs(share) < 0.15:
            yield (f"sensor {name}", "bad",
                   "does not answer to bending: dead, or its pouch is loose")  # fmt: skip
    far: Side = opposite(side)
    if min(map(len, shares.values())) < 2:
        return
    far_error, near_error = (float(np.median(np.abs(np.array(shares[s]) - 1))) for s in (far, side))
    if far_error > 0.3 and near_error < min(0.5 * far_error, 0.3):
        yield ("sensor columns", "bad", f"with the {muscle.name} muscle the sensors on its side "
               "fit and the others do not: the columns are swapped")  # fmt: skip
    elif float(np.median(shares[far])) < -0.3:
        yield ("sensor columns", "bad", "read bends with the wrong sign: swapped sides, or an old "
               "robot.toml")  # fmt: skip
    elif far_error > 0.15:
        column = config.column_name(DEGREES[far])
        error_text = f"read {100 * far_error:.0f} % off the bend: recalibrate flex"
        yield f"{column} sensors", "warning", error_text


def _compare_with_map(measured: float, expected: float) -> tuple[Mark, str]:
    """Whether a muscle bends the body as its map says; both curvatures are signed, 1/cm."""
    if measured * np.sign(expected) < -0.002:
        return "bad", (
            "bends the robot to the other side: the muscles' tubes are swapped, or the camera is "
            "mirrored"
        )
    if abs(measured) < 0.3 * abs(expected):
        return "bad", (
            f"bends by {measured:+.4f} 1/cm, {expected:+.4f} were expected: no air, a leak, or a "
            "wrong map"
        )
    if abs(measured - expected) > 0.15 * abs(expected):
        return "warning", (
            f"bends by {measured:+.4f} 1/cm, the map says {expected:+.4f}: recalibrate the actuator"
        )
    return "ok", f"bends by {measured:+.4f} 1/cm as mapped"


def _judge_hold(hold: Array) -> tuple[Mark, str]:
    """Whether the pressure (n, 2: time, psi) sags while it is held."""
    if len(hold) < 10:
        return "warning", "too short a hold to judge"
    t, psi = hold.T
    sag = -float(np.polyfit(t, psi, 1)[0]) * float(np.ptp(t))
    if sag > 0.5:
        return "bad", f"pressure falls by {sag:.1f} psi during the hold: a leak"
    return "ok", f"holds within {abs(sag):.2f} psi"
