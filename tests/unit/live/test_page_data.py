"""Readings as rows of numbers."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from contacts import a_telemetry

from thigmo.link.protocol import MOST_SENSORS
from thigmo.live.page_data import COLUMNS, block, row_text, thinned
from thigmo.stream import Telemetry


def _reading(t_s: float) -> Telemetry:
    curvature = (*(0.01 * n for n in range(9)), math.nan)
    expected = tuple(0.02 * n for n in range(10))
    return replace(
        a_telemetry(t_s), pressure_psi=(1.0, 2.0), demand_psi=(3.0, 4.0), drive_ma=(5.0, 6.0),
        curvature_per_cm=curvature, expected_per_cm=expected,
    )  # fmt: skip


def test_row_has_every_column_in_its_place() -> None:
    said = dict(zip(COLUMNS, json.loads(row_text(_reading(1.5))), strict=True))
    assert said["t_s"] == 1.5
    assert (said["pressure_0"], said["demand_1"], said["drive_1"]) == (1.0, 4.0, 6.0)
    assert said["curvature_3"] == 0.03
    assert said["curvature_9"] is None
    assert said["expected_9"] == 0.18
    assert said["expected_10"] is None  # of a larger board
    assert (said["length_cm"], said["motor"]) == (30.0, -0.25)


def test_the_pages_script_has_the_same_columns() -> None:
    from thigmo.live.server import PAGE

    script = (PAGE / "store.js").read_text()
    for name, column in (
        ("pressure", "pressure_0"), ("demand", "demand_0"), ("drive", "drive_0"),
        ("curvature", "curvature_0"), ("expected", "expected_0"), ("length", "length_cm"),
        ("motor", "motor"),
    ):  # fmt: skip
        assert f"{name}: {COLUMNS.index(column)}," in script
    assert f"COLUMNS = {len(COLUMNS)};" in script
    assert f"SENSORS = {MOST_SENSORS};" in script


@pytest.mark.parametrize(("count", "most"), [(1, 5), (5, 5), (6, 5), (1000, 7)])
def test_thinned_keeps_the_last_one_and_no_more_than_asked(count: int, most: int) -> None:
    kept = list(range(count))[thinned(count, most)]
    assert kept[-1] == count - 1
    assert len(kept) <= most
    assert len(set(np.diff(kept))) <= 1


def test_block_counts_from_the_run_s_start_and_holds_hours_to_a_millisecond() -> None:
    month_s = 2.6e6
    readings = [_reading(month_s + t) for t in (0.0, 3600.005, 3600.010)]
    table = block(readings, month_s, most=10)
    assert table.shape == (len(COLUMNS), 3)
    assert table.dtype == np.float32
    assert np.diff(table[0])[1] == pytest.approx(0.005, abs=1e-3)
    assert np.isnan(table[COLUMNS.index("curvature_9")]).all()


def test_block_of_nothing() -> None:
    assert block([], 0.0, most=10).shape == (len(COLUMNS), 0)
