"""Readings of the flex step: how the robot was bent, and what camera and sensors measured."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thigmo.calibrate.bench import Row
from thigmo.calibrate.columns import Array, column, medians, muscle_sides, of_sensors, sensors_of
from thigmo.config import RobotConfig
from thigmo.errors import DataError
from thigmo.record.table import Table, write_table
from thigmo.robot import VENTED_PSI
from thigmo.wiring import table_key

KINDS = ("straight", "tip", "bend")
_LEAST_OHM = 200.0  # below, the unit is not ohm: flex sensors have thousands


@dataclass(frozen=True)
class FlexReadings:
    """n rows: how the robot was bent, and the measurements of camera and sensors."""

    kind: tuple[str, ...]  # (n,) "straight", "tip" or "bend", in order of time
    tip_cm: Array  # (n, 2) tip by camera; nan where the marker was not seen or there is none
    curvature: Array  # (n,) of free bends, by camera, 1/cm; nan elsewhere
    curvature_se: Array  # (n,) its standard error, 1/cm
    active: tuple[str, ...]  # (n,) side of the muscle in use, or ""
    ohm: Array  # (n, m) resistances, in the order of `columns`
    length_cm: float  # everted length
    intended_y_cm: Array  # (n,) where the operator was asked to put the tip (sign used); nan = free
    # (n,) session of each row: every eversion changes the sensors' zeros
    block: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    # (n,) name of each row for the operator; "row 1" and so on if none is given
    name: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.kind)
        if not len(self.block):
            object.__setattr__(self, "block", np.zeros(n, np.int64))
        if not self.name:
            object.__setattr__(self, "name", tuple(f"row {row + 1}" for row in range(n)))
        unknown = set(self.kind) - set(KINDS)
        if unknown:
            raise DataError(f"unknown kind '{unknown.pop()}'", f"use one of {', '.join(KINDS)}")

    @classmethod
    def read(cls, table: Table, config: RobotConfig) -> FlexReadings:
        """Read a CSV as `write` makes it. Raises DataError if values look like another unit."""
        path, absent = table.name, float("nan")
        ohm = of_sensors(table, "ohm", config)
        length = table.numbers("length_cm", config.body.length_cm)
        if not np.isfinite(length).all() or np.ptp(length) > 1e-9:
            raise DataError(f"{path}: length_cm varies", "calibrate at one length")
        readings = cls(
            tuple(table.words("kind")),
            np.column_stack([table.numbers("tip_x_cm", absent), table.numbers("tip_y_cm", absent)]),
            table.numbers("curvature", absent),
            table.numbers("curvature_se", 0.0),
            tuple(muscle_sides(table, config)),
            ohm,
            float(length[0]),
            table.numbers("intended_y_cm", absent),
            np.nan_to_num(table.numbers("block", 0.0)).astype(np.int64),
            tuple(table.words("name")) if "name" in table else (),
        )  # fmt: skip
        # The fit deals with single bad rows.
        measured = ohm, np.hypot(*readings.tip_cm.T), np.abs(readings.curvature)
        typical, away, bend = (medians(values.reshape(-1, 1))[0] for values in measured)
        for wrong, problem, cure in (
            (typical <= 0.0, f"resistances are about {typical:.0f}", "give Ohm, above zero"),
            (typical < _LEAST_OHM, f"resistances are about {typical:.3g}",
             "it looks like kOhm: give Ohm"),
            (away > 2.0 * readings.length_cm,
             f"tips are about {away:.0f} from the base of a body of {readings.length_cm:g} cm",
             "it looks like mm: give cm"),
            (bend > 1.0 / config.body.radius_cm,
             f"curvatures are about {bend:.2g}, tighter than the tube can bend",
             "it looks like 1/m: give 1/cm"),
        ):  # fmt: skip
            if wrong:
                raise DataError(f"{path}: {problem}", cure)
        return readings

    @classmethod
    def of_rows(cls, rows: list[Row], length_cm: float) -> FlexReadings:
        """Convert rows of tips and bends as the bench stores them.

        Zeros change with every eversion, so each reading is taken relative to the straight robot of
        its own session.
        """
        block = np.cumsum([n > 0 and r["rest"] != rows[n - 1]["rest"] for n, r in enumerate(rows)])
        rest_ohm = column(rows, "rest")
        return cls(
            tuple(r.get("kind", "bend") for r in rows),
            column(rows, "tip", (None, None)),
            column(rows, "k"),
            np.nan_to_num(column(rows, "k_se")),
            # A vented muscle wrinkles no sensor, so both sides read such a row well.
            tuple(r["side"] if "side" in r and float(r["psi"]) > VENTED_PSI else "" for r in rows),
            column(rows, "ohm") - rest_ohm + medians(rest_ohm),  # a dead sensor has no rest
            length_cm,
            column(rows, "asked"),
            block.astype(np.int64),
            tuple(r["key"] for r in rows),
        )

    def write(self, path: str | os.PathLike[str], config: RobotConfig) -> None:
        """Write a CSV that `read` takes."""
        names = {str(muscle.side): muscle.name for muscle in config.muscles}
        active = [names.get(side, side) for side in self.active]
        columns: dict[str, Any] = {
            "name": self.name, "kind": self.kind, "t_s": range(len(self.kind)),
            "tip_x_cm": self.tip_cm[:, 0], "tip_y_cm": self.tip_cm[:, 1],
            "curvature": self.curvature, "curvature_se": self.curvature_se, "active": active,
            "length_cm": [self.length_cm] * len(self.kind), "intended_y_cm": self.intended_y_cm,
            "block": self.block,
        }  # fmt: skip
        ohm = [f"ohm_{table_key(name)}" for name in sensors_of(config)]
        write_table(path, columns | dict(zip(ohm, self.ohm.T, strict=True)))
