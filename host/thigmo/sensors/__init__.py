"""Sensors of a robot: a file for each kind, and the entry `[[sensor]]` of robot.toml.

A new kind is a class in a file here and an entry in `KINDS` and `Sensor`, its step in
`calibrate/steps.py`, and its emulation in `emulator/plant.py`.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Discriminator, Tag

from thigmo.sensors.fibre import FibreSensor
from thigmo.sensors.flex import FlexSensor
from thigmo.sensors.heading import (
    IMU_CM,
    RAD_PER_OHM,
    SAME_IMU_CM,
    HeadingSensor,
    imu_ends,
    imus_of,
)
from thigmo.sensors.sensor import AnySensor, Passage

KINDS: dict[str, type[AnySensor]] = {
    "flex": FlexSensor,
    "heading": HeadingSensor,
    "fibre": FibreSensor,
}

BoardSensor = FlexSensor | HeadingSensor
"""A sensor on one of the board's inputs, which reads it as a resistance."""


def _kind(data: Any) -> str:
    """Kind of a sensor's entry; an entry that names none is a flex sensor."""
    if isinstance(data, dict):
        return str(data.get("kind", "flex"))
    return data.kind if isinstance(data, AnySensor) else ""


Sensor = Annotated[
    Annotated[FlexSensor, Tag("flex")]
    | Annotated[HeadingSensor, Tag("heading")]
    | Annotated[FibreSensor, Tag("fibre")],
    Discriminator(
        _kind,
        custom_error_type="kind",
        custom_error_message=f"a sensor is a table whose kind is {', '.join([*KINDS][:-1])} or "
        f"{[*KINDS][-1]}",
    ),
]

__all__ = [
    "IMU_CM",
    "KINDS",
    "RAD_PER_OHM",
    "SAME_IMU_CM",
    "AnySensor",
    "BoardSensor",
    "FibreSensor",
    "FlexSensor",
    "HeadingSensor",
    "Passage",
    "Sensor",
    "imu_ends",
    "imus_of",
]
