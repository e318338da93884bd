"""The order of a row's columns, one for each sensor: column by column, base first."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from thigmo.config import SIDES, BoardSensor, RobotConfig, Side
from thigmo.errors import DataError
from thigmo.record.table import Table

Array = NDArray[np.float64]
Key = TypeVar("Key", bound=Any)


def sensors_of(config: RobotConfig) -> list[BoardSensor]:
    """All sensors on the board."""
    return [sensor for side in SIDES for sensor in config.column(side)]


def places_of(config: RobotConfig) -> list[tuple[Side, int]]:
    """Side and index of each sensor."""
    return [(side, k) for side in SIDES for k in range(len(config.column(side)))]


def constants_of(config: RobotConfig, *names: str) -> Array:
    """(n, m) entries of all sensors, by name."""
    return np.array([[getattr(one, name) for one in sensors_of(config)] for name in names], float)


def medians(rows: Array) -> Array:
    """(m,) of columns (n, m), without what is nan; nan where a column holds nothing else."""
    known = (own[np.isfinite(own)] for own in rows.T)
    return np.array([np.median(own) if len(own) else np.nan for own in known])


def of_sensors(table: Table, what: str, config: RobotConfig) -> Array:
    """(n, m) the columns `WHAT_left_0` .. `WHAT_right_N` of a CSV."""
    return np.column_stack([table.numbers(f"{what}_{side}_{k}") for side, k in places_of(config)])


def sides_of(table: Table) -> list[Side]:
    """(n,) the column `side` of a CSV."""
    words = table.words("side")
    if set(words) - set(SIDES):
        raise DataError(f"{table.name}: side must be {' or '.join(SIDES)}", "correct that column")
    return cast("list[Side]", words)


def grouped(keys: Iterable[Key]) -> list[tuple[Key, list[int]]]:
    """Rows of each key, keys sorted."""
    rows: dict[Key, list[int]] = {}
    for row, key in enumerate(keys):
        rows.setdefault(key, []).append(row)
    return sorted(rows.items())


def column(rows: Sequence[Mapping[str, Any]], key: str, missing: Any = None) -> Array:
    """What rows hold under a key, (n,) or (n, m); nan where a row has none."""
    return np.array([row.get(key, missing) for row in rows], float)
