"""The order of a row's columns, one for each sensor: column by column, base first."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from thigmo.config import DEGREES, SIDES, BoardSensor, RobotConfig, Side
from thigmo.errors import DataError
from thigmo.record.table import Table
from thigmo.wiring import table_key

Array = NDArray[np.float64]
Key = TypeVar("Key", bound=Any)
Kind = TypeVar("Kind", bound=BoardSensor)


class SensorFit(Protocol):
    """What a step has found of one sensor."""

    @property
    def name(self) -> str:
        """Its name, as `sensors_of` has it."""

    @property
    def healthy(self) -> bool:
        """Whether the sensor measures bends."""


Fit = TypeVar("Fit", bound=SensorFit)


class Place(NamedTuple):
    """A sensor's column, and its number in it from the base."""

    side: Side
    number: int


def places_of(config: RobotConfig) -> list[Place]:
    """The places of all sensors in the plane that the board reads."""
    return [Place(side, k) for side in SIDES for k in range(len(config.column(side)))]


def sensors_of(config: RobotConfig) -> dict[str, BoardSensor]:
    """The board's sensors in the plane, by the names that page, record and export use."""
    return {
        f"{config.column_name(DEGREES[side])} {k}": config.column(side)[k]
        for side, k in places_of(config)
    }


def mark_health(
    config: RobotConfig, fits: Iterable[Fit], kind: type[Kind]
) -> list[tuple[Fit, Kind]]:
    """Store which sensors of a kind are healthy; these, each with its fit.

    A sensor found dead keeps its old constants.
    """
    sensors = sensors_of(config)
    healthy: list[tuple[Fit, Kind]] = []
    for fit in fits:
        sensor = sensors[fit.name]
        if isinstance(sensor, kind):
            sensor.healthy = fit.healthy
            if fit.healthy:
                healthy.append((fit, sensor))
    return healthy


def constants_of(config: RobotConfig, *names: str) -> Array:
    """(n, m) values of n named fields of all m sensors."""
    sensors = sensors_of(config).values()
    return np.array([[getattr(sensor, name) for sensor in sensors] for name in names], float)


def medians(rows: Array) -> Array:
    """(m,) medians of columns (n, m) without nan; nan for a column of nan only."""
    finite = (values[np.isfinite(values)] for values in rows.T)
    return np.array([np.median(values) if len(values) else np.nan for values in finite])


def of_sensors(table: Table, quantity: str, config: RobotConfig) -> Array:
    """(n, m) values of the columns `WHAT_SENSOR` of a CSV: `ohm_left_0` or `ohm_270deg_0`."""
    keys = [table_key(name) for name in sensors_of(config)]
    return np.column_stack([table.numbers(f"{quantity}_{key}") for key in keys])


def sides_of(table: Table) -> list[Side]:
    """(n,) values of the column `side` of a CSV. Raises DataError for another word."""
    words = table.words("side")
    if set(words) - set(SIDES):
        raise DataError(f"{table.name}: side must be {' or '.join(SIDES)}", "correct that column")
    return cast("list[Side]", words)


def muscle_sides(table: Table, config: RobotConfig) -> list[str]:
    """(n,) side of the muscle in the column `active` of a CSV, which has names or sides; or ""."""
    side_by_word: dict[str, str] = {"": "", **dict(zip(SIDES, SIDES, strict=True))}
    side_by_word |= {muscle.name.lower(): muscle.side for muscle in config.muscles if muscle.side}
    words = table.words("active", "")
    for row, word in enumerate(words):
        if word.lower() not in side_by_word:
            raise DataError(
                f"{table.name}, line {table.lines[row]}: no muscle of the plane is called {word}",
                f"use {' or '.join(m.name for m in config.muscles if m.side)}",
            )
    return [side_by_word[word.lower()] for word in words]


def grouped(keys: Iterable[Key]) -> list[tuple[Key, list[int]]]:
    """Rows of each key, keys sorted."""
    rows: dict[Key, list[int]] = {}
    for row, key in enumerate(keys):
        rows.setdefault(key, []).append(row)
    return sorted(rows.items())


def column(rows: Sequence[Mapping[str, Any]], key: str, missing: Any = None) -> Array:
    """Values of a key in all rows, (n,) or (n, m); nan, or `missing`, for a row without it."""
    return np.array([row.get(key, missing) for row in rows], float)
