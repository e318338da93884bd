"""The order of a row's columns, one for each sensor: column by column, base first."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from thigmo.config import DEGREES, SIDES, BoardSensor, RobotConfig, Side
from thigmo.errors import DataError
from thigmo.record.table import Table
from thigmo.wiring import table_key

Array = NDArray[np.float64]
Key = TypeVar("Key", bound=Any)


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


def constants_of(config: RobotConfig, *names: str) -> Array:
    """(n, m) values of n named fields of all m sensors."""
    sensors = sensors_of(config).values()
    return np.array([[getattr(one, name) for one in sensors] for name in names], float)


def medians(rows: Array) -> Array:
    """(m,) medians of columns (n, m) without nan; nan for a column of nan only."""
    known = (own[np.isfinite(own)] for own in rows.T)
    return np.array([np.median(own) if len(own) else np.nan for own in known])


def of_sensors(table: Table, what: str, config: RobotConfig) -> Array:
    """(n, m) values of the columns `WHAT_SENSOR` of a CSV: `ohm_left_0` or `ohm_270deg_0`."""
    keys = [table_key(name) for name in sensors_of(config)]
    return np.column_stack([table.numbers(f"{what}_{key}") for key in keys])


def sides_of(table: Table) -> list[Side]:
    """(n,) values of the column `side` of a CSV. Raises DataError for another word."""
    words = table.words("side")
    if set(words) - set(SIDES):
        raise DataError(f"{table.name}: side must be {' or '.join(SIDES)}", "correct that column")
    return cast("list[Side]", words)


def muscle_sides(table: Table, config: RobotConfig) -> list[str]:
    """(n,) side of the muscle in the column `active` of a CSV, which has names or sides; or ""."""
    known: dict[str, str] = {"": "", **dict(zip(SIDES, SIDES, strict=True))}
    known |= {muscle.name.lower(): muscle.side for muscle in config.muscles if muscle.side}
    words = table.words("active", "")
    for row, word in enumerate(words):
        if word.lower() not in known:
            raise DataError(
                f"{table.name}, line {table.lines[row]}: no muscle of the plane is called {word}",
                f"use {' or '.join(m.name for m in config.muscles if m.side)}",
            )
    return [known[word.lower()] for word in words]


def grouped(keys: Iterable[Key]) -> list[tuple[Key, list[int]]]:
    """Rows of each key, keys sorted."""
    rows: dict[Key, list[int]] = {}
    for row, key in enumerate(keys):
        rows.setdefault(key, []).append(row)
    return sorted(rows.items())


def column(rows: Sequence[Mapping[str, Any]], key: str, missing: Any = None) -> Array:
    """Values of a key in all rows, (n,) or (n, m); nan, or `missing`, for a row without it."""
    return np.array([row.get(key, missing) for row in rows], float)
