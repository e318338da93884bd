"""Sweeps drawn from the independent rod, as a robot's host would have recorded them."""

from __future__ import annotations

from math import hypot

import numpy as np
import pytest

from thigmo.config import RobotConfig
from thigmo.emulator.scene import Scene
from thigmo_bench.studies.drawn import KINDS, DrawnRoom, rooms

LENGTHS = (40.0, 53.0)
COUNT = 4


@pytest.fixture(scope="module")
def config() -> RobotConfig:
    return Scene.load("default").believed(3)


@pytest.fixture(scope="module")
def calibrated(config: RobotConfig) -> list[DrawnRoom]:
    return rooms(KINDS["as calibrated"], config, LENGTHS, COUNT, 5)


def test_a_room_has_a_sweep_of_every_stop(calibrated: list[DrawnRoom]) -> None:
    for room in calibrated:
        assert room.ended or [sweep.peaks[0].length_cm for sweep, _ in room.sweeps] == [*LENGTHS]
        for sweep, _ in room.sweeps:
            frames, curvature = sweep.half("left")
            assert len(frames) == len(curvature) > 50
            free = [frame.free_curvature for frame in frames]
            assert np.all(np.diff(free) >= 0.0)
            assert sweep.peaks[0].free_curvature == pytest.approx(free[-1], rel=0.02)


def test_touched_skin_lies_on_the_peg(calibrated: list[DrawnRoom]) -> None:
    touched = [room for room in calibrated if room.contact is not None]
    assert len(touched) >= COUNT - 1
    for room in touched:
        assert room.peg is not None
        assert room.contact is not None
        (x, y, radius), (_, skin_x, skin_y) = room.peg, room.contact
        assert hypot(skin_x - x, skin_y - y) == pytest.approx(radius, abs=1e-5)
        assert room.touched


def test_an_empty_rooms_sensors_read_the_maps_bend_within_their_errors(
    config: RobotConfig,
) -> None:
    for room in rooms(KINDS["empty"], config, LENGTHS, COUNT, 6):
        assert room.peg is None
        assert room.contact is None
        assert not room.touched
        for sweep, _ in room.sweeps:
            peak = sweep.peaks[0]
            everted = [n for n in range(10) if peak.sensors >> n & 1]
            assert len(everted) == {40.0: 4, 53.0: 5}[peak.length_cm]
            off = peak.curvature[everted] / peak.free_curvature - 1.0
            assert np.abs(off).max() < 0.2


def test_a_seed_gives_the_same_rooms(config: RobotConfig, calibrated: list[DrawnRoom]) -> None:
    again = rooms(KINDS["as calibrated"], config, LENGTHS, COUNT, 5)
    for first, second in zip(calibrated, again, strict=True):
        assert first.peg == second.peg
        for (sweep, _), (same, _) in zip(first.sweeps, second.sweeps, strict=True):
            assert np.array_equal(sweep.curvature, same.curvature, equal_nan=True)
