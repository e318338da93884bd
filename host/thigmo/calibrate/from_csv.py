"""Every fit on a CSV of readings that a lab already has: no robot, no camera."""

from __future__ import annotations

import os
from collections.abc import Callable

import numpy as np

from thigmo.calibrate.actuator import BendReadings, fit_actuator, together
from thigmo.calibrate.buckling import PushReadings, fit_buckling
from thigmo.calibrate.columns import of_sensors
from thigmo.calibrate.encoder import fit_encoder, fit_pressure_zero, read_encoder
from thigmo.calibrate.flex import fit_flex
from thigmo.calibrate.flex_data import FlexReadings
from thigmo.calibrate.hysteresis import CreepRecord, fit_hysteresis
from thigmo.calibrate.noise import fit_noise
from thigmo.calibrate.stiffness import AxisPoints, fit_stiffness
from thigmo.calibrate.verdict import StepResult
from thigmo.config import RobotConfig
from thigmo.errors import DataError
from thigmo.record.table import MissingColumnError, Table

Path = str | os.PathLike[str]


def _actuator(path: Path, config: RobotConfig) -> StepResult:
    found = [fit_actuator(readings) for readings in BendReadings.read_all(path)]
    if not found:
        raise DataError(f"{path} holds no bends", "give one line for each bend")
    return together(found)


def _noise(path: Path, config: RobotConfig) -> StepResult:
    table = Table.read(path)
    return fit_noise(table.numbers("t_s"), of_sensors(table, "curvature", config), config)


def _pressure(path: Path, config: RobotConfig) -> StepResult:
    table = Table.read(path)
    return fit_pressure_zero(
        np.column_stack([table.numbers("left_count"), table.numbers("right_count")])
    )


FITS: dict[str, Callable[[Path, RobotConfig], StepResult]] = {
    "flex": lambda path, config: fit_flex(FlexReadings.read(path, config), config),
    "actuator": _actuator,
    "buckling": lambda path, config: fit_buckling(PushReadings.read(path, config), config),
    "hysteresis": lambda path, config: fit_hysteresis(CreepRecord.read_all(path), config),
    "stiffness": lambda path, config: fit_stiffness(AxisPoints.read_all(path), config),
    "noise": _noise,
    "encoder": lambda path, config: fit_encoder(*read_encoder(path), config),
    "pressure": _pressure,
}

COLUMNS = {
    "flex": "kind (straight, tip, bend), tip_x_cm, tip_y_cm, curvature, ohm_left_0 .. ohm_right_4 "
    "[t_s, curvature_se, active, length_cm, intended_y_cm, block, name]",
    "actuator": "side, body_pressure_psi, pressure_psi, curvature [curvature_se, branch, trial]",
    "buckling": "curvature_left_0 .. curvature_right_4 [body_pressure_psi, length_cm]",
    "hysteresis": "side, index, t_s, curvature [eversion]",
    "stiffness": "picture, x_cm, y_cm, force_arc_cm",
    "noise": "t_s, curvature_left_0 .. curvature_right_4",
    "encoder": "counts, length_cm",
    "pressure": "left_count, right_count",
}


def fit_csv(step: str, path: Path, config: RobotConfig) -> StepResult:
    """Fit a step to a CSV.

    Args:
        step: a key of `FITS`.
        path: the file; `COLUMNS` names its columns.
        config: geometry of the robot.

    Raises:
        DataError: unknown step, or a file that does not hold what the step needs.
    """
    if step not in FITS:
        raise DataError(
            f"there is no fit '{step}' for a CSV", f"use one of {', '.join(sorted(FITS))}"
        )
    try:
        return FITS[step](path, config)
    except MissingColumnError as error:
        error.add_note(f"columns of {step}: {COLUMNS[step]}; those in brackets may be left out")
        raise
