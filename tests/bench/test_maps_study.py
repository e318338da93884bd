"""The study of maps: what it gives a run, and what it says of the runs."""

from __future__ import annotations

from math import hypot

import pytest

from thigmo.emulator.scene import PegTable
from thigmo_bench.studies.exploration import Explored
from thigmo_bench.studies.maps import NONE, STALE, TRUE, given_map, judged

pytestmark = pytest.mark.bench


@pytest.mark.parametrize("radius", [0.25, 2.5])
def test_a_map_shows_the_peg_where_it_is_said_to_stand(radius: float) -> None:
    peg = PegTable(x=40.2, y=-12.4, radius=radius)
    (true,), (stale,) = given_map(peg), given_map(peg, (3.6, 4.8))
    assert hypot(true.x_cm - peg.x, true.y_cm - peg.y) < 0.5
    assert hypot(stale.x_cm - peg.x, stale.y_cm - peg.y) == pytest.approx(6.0, abs=0.5)


def test_runs_with_a_map_are_compared_with_those_without_room_by_room() -> None:
    def run(error_cm: float, time_s: float, near: int = 1) -> Explored:
        found = {"near": near, "touched": 1, "touched_missed": 1 - near}
        return Explored("map", 1, best_cm=error_cm, time_s=time_s, **found)

    visits = [
        {NONE: run(1.0, 100.0), TRUE: run(0.5, 80.0), STALE: run(1.5, 100.0)},
        {NONE: run(2.0, 100.0), TRUE: run(1.9, 90.0), STALE: run(2.5, 100.0, near=0)},
    ]
    error, time, lost = judged(visits).claims
    assert error.value == pytest.approx(-0.3)
    assert error.standard_error == pytest.approx(0.2)
    assert time.value == pytest.approx(0.85)
    assert lost.value == 1
