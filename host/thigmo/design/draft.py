"""Drafts a robot of a given length, sensors and muscles by scaling the thesis's robot.

Tail friction is an assumption without a source: it grows with the length inside the body and acts
on the rim, while the pressure acts on the section, so the pressure that overcomes it goes with
1 / radius. Body pressures are those of the thesis, or what growth needs if that is more. Muscles of
a long robot are drafted weaker, so that a full bend does not close on itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from thigmo.config import (
    IMU_CM,
    BoardSettings,
    Body,
    BodyPressure,
    FibreSensor,
    FlexSensor,
    HeadingSensor,
    Muscle,
    MuscleMap,
    RobotConfig,
    Sensor,
    TanhMap,
    side_at,
)
from thigmo.errors import ConfigError

SHORTEST_CM, LONGEST_CM = 30.0, 300.0
_PRESSURES = ((0.5, 1.47), (2 / 3, 1.01), (1.0, 0.49))  # share of the length, psi (thesis, 3.5)
_MAPPED_PSI, _AMPLITUDE = (0.49, 1.01, 1.47), (0.030, 0.028, 0.026)  # scenes/default.toml
_FULL_BEND_RAD = 2.5
_GROWTH_MARGIN = 1.35  # body pressure over the pressure that growth needs
_SPAN_CM, _GAP_CM = 5.5, 1.1  # length of a sensor, and gap to the next for the tip's fold
_END_CM = 3.0  # end of the body without a sensor
_CLEAR_CM = 1.5  # distance of an IMU behind the tip where growth stops
_IMU_ADDRESSES = (0x4A, 0x4B)  # I2C addresses of a BNO085, by its pin SA0
_REST_S = 2.0  # IMUs do not creep after eversion
_GRATING_CM = 1.0  # least distance between gratings
_POUCH_CM = 10.0
_INTERROGATOR = "127.0.0.1:7400"
# Of muscles, around the body: one or two bend it in the plane, more out of it.
_MUSCLES_DEG: dict[int, tuple[float, ...]] = {
    0: (),
    1: (90.0,),
    2: (90.0, 270.0),
    3: (90.0, 210.0, 330.0),
    4: (90.0, 180.0, 270.0, 0.0),
}


def draft(
    length_cm: float,
    sensors: int | None,
    muscles: int,
    diameter_cm: float = 3.5,
    name: str = "",
    kind: str = "flex",
) -> RobotConfig:
    """Draft a robot.

    Args:
        length_cm: full length, 30 to 300.
        sensors: number of sensors in each column; None for 5, or 4 with four muscles, as many as a
            Mega has inputs for. Each muscle has a column of flex sensors on the opposite side,
            which it does not wrinkle; a robot without muscles has one on either side. One string of
            IMUs, or one fibre with two readings at each grating, serves all muscles. A fibre has
            flex sensors beside it at the base, for the board's contact trigger, if there are
            muscles.
        muscles: number of muscles: none, 1 or 2 in the plane, or 3 or 4 around the body, with flex
            sensors. Of three, the two out of the plane are guarded by a base sensor at 90 degrees,
            because the board's trigger has two inputs.
        diameter_cm: diameter of the tube.
        name: name of the robot; made from its length if empty.
        kind: kind of the sensors; each heading sensor ends with an IMU.

    Raises:
        ConfigError: a number is out of range, the sensors do not fit the length, or their kind
            is unknown.
    """
    if not SHORTEST_CM <= length_cm <= LONGEST_CM:
        raise ConfigError(
            f"a length of {length_cm:g} cm", f"give {SHORTEST_CM:g} to {LONGEST_CM:g}"
        )
    if muscles not in _MUSCLES_DEG:
        raise ConfigError(
            f"{muscles} muscles", "give 0, 1 or 2 in a plane, or 3 or 4 around the body"
        )
    if (layout := LAYOUTS.get(kind)) is None:
        raise ConfigError(f"no sensors of kind {kind!r}", f"use {', '.join(LAYOUTS)}")
    if muscles > 2 and layout.plane_only:
        raise ConfigError(
            f"{muscles} muscles with sensors of kind {kind}: {layout.plane_only}",
            "give 0, 1 or 2 muscles, or flex sensors",
        )
    if sensors is None:
        sensors = 4 if muscles == 4 else 5
    if not 0.5 <= diameter_cm <= length_cm / 4:
        raise ConfigError(
            f"a diameter of {diameter_cm:g} cm", f"give 0.5 to {length_cm / 4:g}, a slender body"
        )
    most_sensors = int((length_cm - _END_CM) / layout.least_pitch_cm)
    if not 1 <= sensors <= most_sensors:
        raise ConfigError(
            f"{sensors} sensors in a column", f"give 1 to {most_sensors} at this length"
        )
    pitch = np.floor(2 * (length_cm - _END_CM) / sensors) / 2
    pouch_cm = _POUCH_CM if layout.flex_bases else float(pitch)
    body = _body(length_cm, diameter_cm, pouch_cm)
    bends = _MUSCLES_DEG[muscles]
    opposite = [(towards + 180.0) % 360.0 for towards in bends or _MUSCLES_DEG[2]]
    columns = opposite[:1] if layout.one_column else sorted(opposite)
    # Base sensors alone, for the board's trigger.
    bases = sorted(opposite) if layout.flex_bases and bends else [90.0] if muscles == 3 else []
    return RobotConfig(
        name=name or f"vine-{length_cm:g}",
        interrogator=layout.interrogator,
        body=body,
        muscles=[_muscle(towards, body) for towards in bends],
        sensors=[
            *(sensor for lies in bases for sensor in _flex(lies, pouch_cm, 0)),
            *(
                sensor
                for lies in columns
                for number in range(sensors)
                for sensor in layout.place(lies, float(pitch), number)
            ),
        ],
        board=layout.board(),
    )


def _outside(lies_deg: float) -> Literal[-1, 1]:
    """Sign of the bends that have a sensor on their outside; positive: towards 0 to 180 degrees."""
    return -1 if lies_deg < 180.0 else 1


def _flex(lies_deg: float, pitch_cm: float, number: int) -> list[Sensor]:
    sensor = FlexSensor(
        angle_deg=lies_deg,
        center_cm=pitch_cm * (number + 0.5),
        span_cm=min(_SPAN_CM, pitch_cm - _GAP_CM),
        # Resistance rises on the outside of a bend.
        scale_per_ohm=_outside(lies_deg) * FlexSensor(center_cm=1.0).scale_per_ohm,
        bend_sign=_outside(lies_deg),
    )
    return [sensor]


def _imu(lies_deg: float, pitch_cm: float, number: int) -> list[Sensor]:
    """A span from the last IMU, or the base, to one clear of the tip's fold where growth stops."""
    end = pitch_cm * (number + 1) - _CLEAR_CM
    start = end - pitch_cm if number else 0.0
    sensor = HeadingSensor(
        kind="heading",
        angle_deg=lies_deg,
        center_cm=(start + end) / 2,
        span_cm=end - start,
        mux_channel=number // 2,
        i2c_address=_IMU_ADDRESSES[number % 2],
    )
    return [sensor]


def _grating(lies_deg: float, pitch_cm: float, number: int) -> list[Sensor]:
    """A reading in the plane, and one across it."""
    center_cm = pitch_cm * (number + 0.5)
    # The outside of a bend is stretched.
    scale = _outside(lies_deg) * FibreSensor(kind="fibre", center_cm=1.0).scale_per_ue
    return [
        FibreSensor(
            kind="fibre",
            center_cm=center_cm,
            angle_deg=angle_deg,
            scale_per_ue=reading_scale,
        )
        for angle_deg, reading_scale in ((lies_deg, scale), (0.0, abs(scale)))
    ]


@dataclass(frozen=True)
class Layout:
    """How a kind of sensors is laid along a robot."""

    place: Callable[[float, float, int], list[Sensor]]  # at an angle and pitch, by number
    least_pitch_cm: float
    plane_only: str = ""  # why it cannot serve muscles out of the plane; empty if it can
    one_column: bool = False  # one serves all muscles
    flex_bases: bool = False  # flex sensors beside it at the base, for the board's trigger
    interrogator: str | None = None
    board: Callable[[], BoardSettings] = BoardSettings


LAYOUTS: dict[str, Layout] = {
    "flex": Layout(_flex, 1.0 + _GAP_CM),
    "heading": Layout(
        _imu,
        _CLEAR_CM + 2 * IMU_CM,
        "the board's reader of IMUs measures turns about one axis",
        one_column=True,
        board=partial(BoardSettings, settle_s=_REST_S),
    ),
    "fibre": Layout(
        _grating,
        _GRATING_CM,
        "a fibre feels contacts in the plane only",
        one_column=True,
        flex_bases=True,
        interrogator=_INTERROGATOR,
    ),
}


def _body(length_cm: float, diameter_cm: float, pitch_cm: float) -> Body:
    usual = Body()
    friction = usual.growth_psi_per_cm * usual.diameter_cm / diameter_cm
    pressures = []
    for share, psi in _PRESSURES:
        end_cm = share * length_cm
        needed = _GROWTH_MARGIN * (usual.growth_psi + friction * end_cm)
        pressures.append(
            BodyPressure(until_cm=round(end_cm, 1), pressure_psi=round(max(psi, needed), 2))
        )
    pressures[-1].until_cm = length_cm
    return Body(
        length_cm=length_cm,
        diameter_cm=diameter_cm,
        pitch_cm=pitch_cm,
        growth_psi_per_cm=round(friction, 5),
        pressures=pressures,
    )


def _muscle(towards_deg: float, body: Body) -> Muscle:
    share = min(1.0, _FULL_BEND_RAD / (_AMPLITUDE[0] * body.length_cm))
    return Muscle(
        name=side_at(towards_deg) or f"{towards_deg:g}deg",
        angle_deg=towards_deg,
        lag_s=0.31,
        maps=[_map(pressure.pressure_psi, share, (9.0, 7.8)) for pressure in body.pressures],
    )


def _map(body_psi: float, share: float, scales_psi: Sequence[float]) -> MuscleMap:
    amplitude = share * float(np.interp(body_psi, _MAPPED_PSI, _AMPLITUDE))
    inflate, deflate = (
        TanhMap(amplitude=round(amplitude, 5), scale_psi=scale) for scale in scales_psi
    )
    return MuscleMap(body_pressure_psi=body_psi, inflate=inflate, deflate=deflate)
