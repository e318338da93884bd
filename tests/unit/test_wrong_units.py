"""Values of robot.toml in another unit than the file's are refused or asked about."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from pydantic import ValidationError

from thigmo.config import RobotConfig
from thigmo.design import draft, judge
from thigmo.emulator.scene import Scene

Table = dict[str, Any]


def measured() -> Table:
    """The thesis's robot, stiffness measured, as its file has it."""
    robot = RobotConfig()
    robot.body.stiffness_n_cm2 = 500.0
    robot.body.stiffness_se_n_cm2 = 50.0
    return robot.model_dump(by_alias=True)


def _body(key: str, factor: float) -> Callable[[Table], None]:
    def turn(file: Table) -> None:
        file["body"][key] *= factor

    return turn


def _each(table: str, key: str, factor: float, plus: float = 0.0) -> Callable[[Table], None]:
    def turn(file: Table) -> None:
        for row in file[table]:
            row[key] = row[key] * factor + plus

    return turn


def _one(table: str, key: str, factor: float) -> Callable[[Table], None]:
    def turn(file: Table) -> None:
        file[table][key] *= factor

    return turn


def _maps(key: str, factor: float) -> Callable[[Table], None]:
    def turn(file: Table) -> None:
        for muscle in file["muscle"]:
            for muscle_map in muscle["map"]:
                for branch in ("inflate", "deflate"):
                    muscle_map[branch][key] *= factor

    return turn


def _pressures(factor: float) -> Callable[[Table], None]:
    def turn(file: Table) -> None:
        for pressure in file["body"]["pressure"]:
            pressure["pressure_psi"] *= factor
        for muscle in file["muscle"]:
            for muscle_map in muscle["map"]:
                muscle_map["body_pressure_psi"] *= factor

    return turn


BAR = 0.0689476  # a psi
WRONG: dict[str, Callable[[Table], None]] = {
    # The ten that were silent.
    "radius for diameter": _body("diameter_cm", 0.5),
    "bar for psi, muscles": _each("muscle", "max_pressure_psi", BAR),
    "start for centre": _each("sensor", "center_cm", 1.0, -2.75),
    "scale_per_ohm a tenth": _each("sensor", "scale_per_ohm", 0.1),
    "all signs turned": _each("sensor", "scale_per_ohm", -1.0),
    "ohms for kilohms": _each("sensor", "zero_ohm", 1e-3),
    "counts per turn": _one("spool", "counts_per_cm", 6.28),
    "x1 counts": _one("spool", "counts_per_cm", 0.25),
    "critical curvature in 1/m": _body("critical_curvature", 100.0),
    "stiffness in N m2": _body("stiffness_n_cm2", 1e-4),
    # Sixteen more.
    "bar for psi, body": _pressures(BAR),
    "kPa for psi, body": _pressures(6.894757),
    "kPa for psi, muscles": _each("muscle", "max_pressure_psi", 6.894757),
    "bar for psi, critical pressure": _body("critical_pressure_psi", BAR),
    "critical curvature in 1/mm": _body("critical_curvature", 0.1),
    "stiffness in N mm2": _body("stiffness_n_cm2", 100.0),
    "diameter in mm": _body("diameter_cm", 10.0),
    "length in m": _body("length_cm", 0.01),
    "pitch in mm": _body("pitch_cm", 10.0),
    "centres in mm": _each("sensor", "center_cm", 10.0),
    "scale per kilohm": _each("sensor", "scale_per_ohm", 1e3),
    "noise in 1/m": _each("sensor", "noise", 100.0),
    "map's amplitude in 1/m": _maps("amplitude", 100.0),
    "map's pressure in bar": _maps("scale_psi", BAR),
    "speed in mm/s": _one("spool", "max_speed_cm_s", 10.0),
    "stall pull in kgf": _one("spool", "stall_n", 0.102),
}


def _complaints(file: Table) -> set[str]:
    """What is refused or asked about."""
    try:
        robot = RobotConfig.model_validate(file)
    except ValidationError as error:
        return {str(error)}
    return {f"{finding.part}: {finding.text}" for finding in judge(robot) if finding.mark != "ok"}


@pytest.mark.parametrize("unit", WRONG)
def test_a_wrong_unit_is_noticed(unit: str) -> None:
    file = measured()
    before = _complaints(file)
    WRONG[unit](file)
    assert _complaints(file) - before


@pytest.mark.parametrize(
    ("kind", "muscles"),
    [("flex", 1), ("flex", 2), ("flex", 3), ("flex", 4), ("heading", 2), ("fibre", 1)],
)
@pytest.mark.parametrize("length", [30.0, 53.0, 120.0, 200.0])
def test_nothing_is_asked_of_a_draft(length: float, kind: Any, muscles: int) -> None:
    robot = draft(length, None, muscles, kind=kind)
    assert [finding.text for finding in judge(robot) if finding.part == "units"] == []


@pytest.mark.parametrize("diameter", [2.0, 7.0, 10.0])
def test_nothing_is_asked_of_a_thin_or_thick_body(diameter: float) -> None:
    robot = draft(53.0, 5, 2, diameter_cm=diameter)
    assert [finding.text for finding in judge(robot) if finding.part == "units"] == []


@pytest.mark.parametrize("scene", ["default", "noisy", "wall"])
def test_nothing_is_asked_of_a_scenes_robot(scene: str) -> None:
    findings = judge(Scene.load(scene).believed(1))
    assert [finding.text for finding in findings if finding.part == "units"] == []
