"""The steps: readings of the bench, or of a CSV, into fits, verdicts and robot.toml.

    growth   -> encoder, hysteresis        bends -> actuator, and free bends for flex
    tips     -> flex; stiffness with bows  pushes -> buckling
    rest     -> noise                      pressure, check

Order on a new robot: pressure, encoder, actuator, flex, hysteresis, buckling, stiffness, noise,
check (the keys of `STEPS`).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thigmo.calibrate.actuator import (
    ActuatorResult,
    ActuatorResults,
    BendReadings,
    fit_actuator,
    together,
)
from thigmo.calibrate.bench import SAME_CM, Bench, Row
from thigmo.calibrate.buckling import BucklingResult, fit_buckling
from thigmo.calibrate.check import CheckResult, run_check
from thigmo.calibrate.columns import (
    constants_of,
    grouped,
    medians,
    of_sensors,
    places_of,
    sensors_of,
)
from thigmo.calibrate.encoder import EncoderResult, PressureResult, fit_encoder, fit_pressure_zero
from thigmo.calibrate.flex import FlexResult, fit_flex
from thigmo.calibrate.flex_data import FlexReadings
from thigmo.calibrate.flex_lines import loop_turns
from thigmo.calibrate.hysteresis import CreepRecord, HysteresisResult, fit_hysteresis
from thigmo.calibrate.lag import fit_lag
from thigmo.calibrate.noise import NoiseResult, fit_noise
from thigmo.calibrate.procedures import (
    bend_rows,
    bend_set_points,
    bow_rows,
    check_readings,
    growth_rows,
    push_rows,
    ramp,
    rest_rows,
    tip_rows,
)
from thigmo.calibrate.stiffness import AxisPoints, StiffnessResult, fit_stiffness
from thigmo.calibrate.verdict import StepResult
from thigmo.config import SIDES, RobotConfig
from thigmo.errors import DataError
from thigmo.record.table import MissingColumnError, Table

Array = NDArray[np.float64]
Path = str | os.PathLike[str]

_VENTED_PSI = 0.5
_LAG_SE_S = 0.1  # a lag known worse than that is not used


def pressure(bench: Bench) -> PressureResult:
    """Zeros of both pressure sensors at vent, into the board.

    They are what tells the board that a muscle is vented, so nothing here asks it whether one is:
    the fit sees what still moves, and what is too far from its data sheet.
    """
    bench.robot.vent(wait=False)
    bench.robot.wait(3.0)
    record = bench.robot.record(3.0)
    zero = np.array(bench.robot.parameter("pressure_zero"), float) / 64
    span = np.array(bench.robot.parameter("pressure_span"), float) / 64
    full = bench.robot.parameter("pressure_full_cpsi")[0] / 100
    psi = np.column_stack([record.left_psi, record.right_psi])
    result = fit_pressure_zero(zero + psi * span / full, 102.4, float(span.mean()), full)
    if result.verdict.good:
        bench.robot.set_parameter("pressure_zero", result.board_values())
        bench.robot.save()
    return result


def encoder(bench: Bench) -> EncoderResult:
    """Counts per cm from the growth rows."""
    rows = growth_rows(bench)
    return fit_encoder(_column(rows, "counts"), _column(rows, "seen_cm"), bench.config)


def hysteresis(bench: Bench) -> HysteresisResult:
    """Creep from the growth rows: run it after flex, which gives the scales."""
    rows = growth_rows(bench)
    config = bench.config
    records: list[CreepRecord] = []
    before = 0.0
    for row in rows:
        length = float(row["encoder_cm"])
        ohm, t = np.array(row["ohm"], float), np.array(row["t_s"], float)
        sensors = zip(places_of(config), sensors_of(config), ohm.T, strict=True)
        for (side, index), sensor, own in sensors:
            end = sensor.center_cm + sensor.span_cm / 2
            if before + SAME_CM < end <= length and sensor.healthy:
                # Everted when the tip passed its end, a little before growth stopped.
                since = t + (length - end) / float(row["speed_cm_s"])
                rest = float(np.nanmedian(own[-max(3, len(own) // 10) :]))
                k = (own - rest) * sensor.scale_per_ohm
                records.append(CreepRecord(side, index, since, k))
        before = length
    return fit_hysteresis(records, config)


def actuator(bench: Bench) -> ActuatorResults:
    """Maps of both muscles for the planned body pressures, and the lag."""
    zones = bench.plan.zones or tuple(range(len(bench.config.body.zones)))
    rows = bend_rows(bench, zones)
    ramps = {side: ramp(bench, side, zones[-1]) for side in SIDES}
    found: list[ActuatorResult] = []
    for zone in zones:
        for side in SIDES:
            mine = [r for r in rows if r["zone"] == zone and r["side"] == side]
            readings = BendReadings(
                side,
                bench.config.body.zones[zone].pressure_psi,
                _column(mine, "psi"),
                _column(mine, "k"),
                np.nan_to_num(_column(mine, "k_se"), nan=2e-4),
                tuple(r["branch"] for r in mine),
                np.array([r["trial"] for r in mine], np.int64),
            )
            result = fit_actuator(readings)
            record = ramps[side]
            if result.verdict.good and zone == zones[-1] and record is not None:
                reversal = bench.config.actuators.side(side).reversal_psi
                lag = fit_lag(*record, result.zone, side, reversal)
                if lag.inflate_se_s < _LAG_SE_S:
                    result = replace(result, lag=lag)
            found.append(result)
    return together(found)


def flex(bench: Bench) -> FlexResult:
    """Flex sensors from tip places and free bends (which it takes if there are none yet)."""
    last = len(bench.config.body.zones) - 1
    tips = tip_rows(bench)
    bends = [r for r in bench.session.rows("bends").values() if r["zone"] == last]
    if len(bends) < 2 * len(bend_set_points(bench, "left")):
        bends = bend_rows(bench, [last])
    readings = flex_readings([*tips, *bends], bench.config.body.length_cm)
    result = fit_flex(readings, bench.config)
    readings.write(bench.session.folder / "flex.csv", bench.config)
    return result


def flex_readings(rows: list[Row], length_cm: float) -> FlexReadings:
    """Rows of tips and bends as flex readings.

    Zeros change with every eversion, so readings count from the rest of their own session.
    """
    block = np.cumsum([n > 0 and r["rest"] != rows[n - 1]["rest"] for n, r in enumerate(rows)])
    rest = _column(rows, "rest")
    # A dead sensor has no rest.
    level = medians(rest)
    return FlexReadings(
        tuple(r.get("kind", "bend") for r in rows),
        _column(rows, "tip", (None, None)),
        _column(rows, "k"),
        np.nan_to_num(_column(rows, "k_se")),
        # A vented muscle wrinkles nothing: such a row is good for both sides.
        tuple(r["side"] if "side" in r and float(r["psi"]) > _VENTED_PSI else "" for r in rows),
        _column(rows, "ohm") - rest + level,
        length_cm,
        _column(rows, "asked"),
        block.astype(np.int64),
        tuple(r["key"] for r in rows),
    )


def stiffness(bench: Bench) -> StiffnessResult:
    """Stiffness under sensors against gaps, from pictures of the flex step's places and more."""
    rows = [*(row for row in tip_rows(bench) if row["kind"] == "tip"), *bow_rows(bench)]
    pictures = [
        AxisPoints(np.array(r["points"], float), bench.config.body.length_cm)
        for r in rows
        if r.get("points") is not None
    ]
    return fit_stiffness(pictures, bench.config)


def buckling(bench: Bench) -> BucklingResult:
    """Critical curvature from hard pushes: run it after flex."""
    rows = push_rows(bench)
    (scale,) = constants_of(bench.config, "scale_per_ohm")
    gone, rest = _column(rows, "ohm") * scale, _column(rows, "rest") * scale
    flex_done = bench.session.done("flex")
    if flex_done is not None:
        # Each push ends on the other side of the sensors' loops than the rest before it.
        loop = _column(flex_done["sensors"], "hysteresis")
        walk = np.empty((2 * len(rows), gone.shape[1]))
        walk[0::2], walk[1::2] = 0.0, gone - rest
        block = np.zeros(len(walk), np.int64)
        turn = loop_turns(np.nan_to_num(walk), block, float(flex_done["loop_width"]))
        rest -= np.nan_to_num(loop) * turn[0::2]
        gone -= np.nan_to_num(loop) * turn[1::2]
    body = bench.config.body
    return fit_buckling(gone - rest, body.zones[-1].pressure_psi, body.length_cm, bench.config)


def noise(bench: Bench) -> NoiseResult:
    """Noise at rest; hysteresis within a sweep from the bends, if they were taken."""
    rows = rest_rows(bench)
    (scale,) = constants_of(bench.config, "scale_per_ohm")
    ohm = _column(rows, "ohm")
    rising, falling = _loops(bench, scale)
    return fit_noise(
        _column(rows, "t_s"), (ohm - np.nanmedian(ohm, axis=0)) * scale, bench.config,
        rising=rising, falling=falling,
    )  # fmt: skip


def _loops(bench: Bench, scale: Array) -> tuple[Array | None, Array | None]:
    """Readings less the camera's curvature, rising and falling, at equal set points."""
    rows = bench.session.rows("bends")
    pairs: list[tuple[Array, Array]] = []
    a_side = len(bench.config.sensors.left)
    for key, row in rows.items():
        twin = rows.get(key.replace("inflate", "deflate"))
        if row["branch"] != "inflate" or twin is None or row["k"] is None or twin["k"] is None:
            continue
        up, down = _column([row, twin], "ohm") * scale - _column([row, twin], "k")[:, None]
        # The active side wrinkles.
        dull = slice(0, a_side) if row["side"] == "left" else slice(a_side, None)
        up[dull] = np.nan
        pairs.append((up, down))
    if len(pairs) < 4:
        return None, None
    return np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs])


def check(bench: Bench) -> CheckResult:
    """A short check of the whole robot."""
    return run_check(check_readings(bench), bench.config)


def _column(rows: Sequence[Row], key: str, missing: Any = None) -> Array:
    """What rows hold under a key, (n,) or (n, m); nan where a row has none."""
    return np.array([row.get(key, missing) for row in rows], float)


def _actuator_csv(path: Path, config: RobotConfig) -> StepResult:
    found = [fit_actuator(readings) for readings in BendReadings.read_all(path)]
    if not found:
        raise DataError(f"{path} holds no bends", "give one line for each bend")
    return together(found)


def _noise_csv(path: Path, config: RobotConfig) -> StepResult:
    table = Table.read(path)
    return fit_noise(table.numbers("t_s"), of_sensors(table, "curvature", config), config)


def _pressure_csv(path: Path, config: RobotConfig) -> StepResult:
    table = Table.read(path)
    return fit_pressure_zero(
        np.column_stack([table.numbers("left_count"), table.numbers("right_count")])
    )


def _encoder_csv(path: Path, config: RobotConfig) -> StepResult:
    table = Table.read(path)
    return fit_encoder(table.numbers("counts"), table.numbers("length_cm"), config)


def _buckling_csv(path: Path, config: RobotConfig) -> StepResult:
    table = Table.read(path)
    body = table.numbers("body_pressure_psi", config.body.critical_pressure_psi)
    length = table.numbers("length_cm", config.body.length_cm)
    if np.ptp(body) > 1e-9 or np.ptp(length) > 1e-9:
        raise DataError(f"{path}: body pressure or length varies", "one file for each")
    curvature = of_sensors(table, "curvature", config)
    return fit_buckling(curvature, float(body[0]), float(length[0]), config)


def _stiffness_csv(path: Path, config: RobotConfig) -> StepResult:
    table = Table.read(path)
    picture = table.whole("picture")
    rows = np.column_stack([table.numbers(name) for name in ("x_cm", "y_cm", "force_arc_cm")])
    seen = np.isfinite(rows).all(axis=1)
    picture, rows = picture[seen], rows[seen]
    each = [AxisPoints(rows[own, :2], rows[own[0], 2]) for _, own in grouped(picture.tolist())]
    return fit_stiffness(each, config)


@dataclass(frozen=True)
class Step:
    """A step of the calibration."""

    guided: Callable[[Bench], StepResult]  # takes the readings that are missing, and fits them
    rows: tuple[str, ...] = ()  # names of the tables of readings that are its own
    # without it later steps would measure nonsense; a bad other one spoils nothing else
    needed: bool = False
    columns: str = ""  # of its CSV; those in brackets may be left out
    of_csv: Callable[[Path, RobotConfig], StepResult] | None = None  # fits a CSV


_CURVATURES = "curvature_left_0 .. curvature_right_4"
STEPS = {
    "pressure": Step(pressure, (), True, "left_count, right_count", _pressure_csv),
    "encoder": Step(encoder, ("growth",), True, "counts, length_cm", _encoder_csv),
    "actuator": Step(
        actuator, ("bends", "lag"), True,
        "side, body_pressure_psi, pressure_psi, curvature [curvature_se, branch, trial]",
        _actuator_csv,
    ),
    "flex": Step(
        flex, ("tips",), True,
        "kind (straight, tip, bend), tip_x_cm, tip_y_cm, curvature, ohm_left_0 .. ohm_right_4 "
        "[t_s, curvature_se, active, length_cm, intended_y_cm, block, name]",
        lambda path, config: fit_flex(FlexReadings.read(path, config), config),
    ),
    "hysteresis": Step(
        hysteresis, ("growth",), False, "side, index, t_s, curvature [eversion]",
        lambda path, config: fit_hysteresis(CreepRecord.read_all(path), config),
    ),
    "buckling": Step(
        buckling, ("pushes",), False, f"{_CURVATURES} [body_pressure_psi, length_cm]", _buckling_csv
    ),
    "stiffness": Step(
        stiffness, ("bows",), False, "picture, x_cm, y_cm, force_arc_cm", _stiffness_csv
    ),
    "noise": Step(noise, ("rest",), False, f"t_s, {_CURVATURES}", _noise_csv),
    "check": Step(check),
}  # fmt: skip


def run(bench: Bench, step: str, *, again: bool = False) -> StepResult:
    """One guided step.

    Args:
        bench: robot, operator, camera and folder.
        step: a key of `STEPS`.
        again: take its readings anew.

    Raises:
        DataError: unknown step, or readings that cannot be fitted.
        CameraError, RobotFaultError and their like: as named; the folder keeps what was read.
    """
    if step not in STEPS:
        raise DataError(f"there is no step '{step}'", f"use one of {', '.join(STEPS)}")
    if again:
        for procedure in STEPS[step].rows:
            bench.session.forget(procedure)
    if step == "pressure":
        bench.configure()  # no length is taken from a robot that does not look vented
    else:
        bench.start()
    result = STEPS[step].guided(bench)
    bench.finish(step, result)
    return result


def fit_csv(step: str, path: Path, config: RobotConfig) -> StepResult:
    """Fit a step to a CSV of readings that a lab already has: no robot, no camera.

    Args:
        step: a key of `STEPS` that has columns.
        path: the file.
        config: geometry of the robot.

    Raises:
        DataError: unknown step, or a file that does not hold what the step needs.
    """
    made = {name: one.of_csv for name, one in STEPS.items() if one.of_csv is not None}
    if step not in made:
        raise DataError(
            f"there is no fit '{step}' for a CSV", f"use one of {', '.join(sorted(made))}"
        )
    try:
        return made[step](path, config)
    except MissingColumnError as error:
        columns = STEPS[step].columns
        error.add_note(f"columns of {step}: {columns}; those in brackets may be left out")
        raise
