"""Readings of the flex step: what was done with the robot, what camera and sensors said."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thigmo.calibrate.columns import of_sensors, places_of
from thigmo.config import RobotConfig
from thigmo.errors import DataError
from thigmo.record.table import Table, write_table

Array = NDArray[np.float64]
KINDS = ("straight", "tip", "bend")
_LEAST_OHM = 200.0  # flex sensors have thousands


@dataclass(frozen=True)
class FlexReadings:
    """What was done and what was read."""

    kind: tuple[str, ...]  # (n,) of "straight", "tip", "bend", in order of time
    tip_cm: Array  # (n, 2) tip by camera; nan where the marker was not seen or there is none
    curvature: Array  # (n,) of free bends, by camera, 1/cm; nan elsewhere
    curvature_se: Array  # (n,) its one sigma
    active: tuple[str, ...]  # (n,) muscle in use: "left", "right" or ""
    ohm: Array  # (n, m) resistances, left base first
    length_cm: float  # everted length
    intended_y_cm: Array  # (n,) where the operator was asked to put the tip (sign used); nan = free
    # (n,) session of each row: after an eversion the sensors' zeros are others
    block: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    # (n,) what an operator calls each row; "row 1" and so on where none is given
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
    def read(cls, path: str | os.PathLike[str], config: RobotConfig) -> FlexReadings:
        """From a CSV: kind, tip_x_cm, tip_y_cm, curvature, ohm_left_0 .. ohm_right_N.

        Optional: t_s, curvature_se, active, length_cm, intended_y_cm, block, name.

        Raises:
            DataError: missing or malformed columns.
        """
        table = Table.read(path)
        ohm = of_sensors(table, "ohm", config)
        length = table.numbers("length_cm", config.body.length_cm)
        if not np.isfinite(length).all() or np.ptp(length) > 1e-9:
            raise DataError(f"{path}: length_cm varies", "calibrate at one length")
        none = float("nan")
        readings = cls(
            tuple(table.words("kind")),
            np.column_stack([table.numbers("tip_x_cm", none), table.numbers("tip_y_cm", none)]),
            table.numbers("curvature", none),
            table.numbers("curvature_se", 0.0),
            tuple(table.words("active", "")),
            ohm,
            float(length[0]),
            table.numbers("intended_y_cm", none),
            np.nan_to_num(table.numbers("block", 0.0)).astype(np.int64),
            tuple(table.words("name")) if "name" in table else (),
        )  # fmt: skip
        readings._check_units(path, config.body.radius_cm)
        return readings

    def _check_units(self, path: str | os.PathLike[str], radius_cm: float) -> None:
        """Most of what is read in another unit gives it away; single bad rows are the fit's."""
        ohm = _typical(self.ohm)
        if ohm <= 0.0:
            raise DataError(f"{path}: resistances are about {ohm:.0f}", "give Ohm, above zero")
        if ohm < _LEAST_OHM:
            raise DataError(
                f"{path}: resistances are about {ohm:.3g}", "it looks like kOhm: give Ohm"
            )
        away = _typical(np.hypot(*self.tip_cm.T))
        if away > 2.0 * self.length_cm:
            raise DataError(
                f"{path}: tips are about {away:.0f} from the base of a body of "
                f"{self.length_cm:g} cm",
                "it looks like mm: give cm",
            )
        bend = _typical(np.abs(self.curvature))
        if bend > 1.0 / radius_cm:
            raise DataError(
                f"{path}: curvatures are about {bend:.2g}, tighter than the tube can bend",
                "it looks like 1/m: give 1/cm",
            )

    def write(self, path: str | os.PathLike[str], config: RobotConfig) -> None:
        """To a CSV that `read` takes."""
        columns: dict[str, Any] = {
            "name": self.name, "kind": self.kind, "t_s": range(len(self.kind)),
            "tip_x_cm": self.tip_cm[:, 0], "tip_y_cm": self.tip_cm[:, 1],
            "curvature": self.curvature, "curvature_se": self.curvature_se, "active": self.active,
            "length_cm": [self.length_cm] * len(self.kind), "intended_y_cm": self.intended_y_cm,
            "block": self.block,
        }  # fmt: skip
        for (side, k), ohm in zip(places_of(config), self.ohm.T, strict=True):
            columns[f"ohm_{side}_{k}"] = ohm
        write_table(path, columns)


def _typical(values: Array) -> float:
    """The median of what was measured; NaN if nothing was."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")
