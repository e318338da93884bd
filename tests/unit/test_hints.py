"""Tables with a sign or a direction the other way round are named; right ones are not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from thigmo.cli.hints import hints
from thigmo.errors import DataError
from thigmo.localization import localize

POSITION = np.array([5.0, 15.0, 25.0, 35.0, 45.0])
NOISE = 6e-4


def _readings(arc: float, force: float, free: float, rng: np.random.Generator) -> Any:
    noise = NOISE * rng.standard_normal(POSITION.size)
    return free + force * np.maximum(arc - POSITION, 0.0) + noise


def _hints(curvature: Any, position: Any, free: float, noise: float | None = NOISE) -> str:
    options = {"length": 53.0, "span": 5.5, "free_curvature": free, "noise": noise}
    answer = localize(curvature, position, **options)
    return "; ".join(hints(answer, curvature, position, **options))


@pytest.mark.parametrize("free", [0.0, 0.03])
def test_a_contact_on_a_right_table_gets_no_hint(free: float) -> None:
    rng = np.random.default_rng(1)
    for arc in np.linspace(8.0, 52.0, 40):
        first, second = (_readings(arc, force, free, rng) for force in (4e-4, -8e-4))
        assert not _hints(first, POSITION, free)
        pressed_twice = first + second - free - 1e-3 * np.maximum(0.6 * arc - POSITION, 0.0)
        assert not _hints(pressed_twice, POSITION, free)


def test_each_mistake_gets_its_own_hint() -> None:
    right = _readings(40.0, -2e-4, 0.03, np.random.default_rng(2))
    straight = _readings(40.0, -8e-4, 0.0, np.random.default_rng(3))
    assert "other sign" in _hints(-right, POSITION, 0.03)
    assert "from the tip" in _hints(straight, 53.0 - POSITION, 0.0)
    assert "--free-curvature" in _hints(right, POSITION, 0.0)
    assert "--free-curvature" in _hints(right / 100.0, POSITION, 0.03)
    both = np.concatenate((straight, -straight)), np.tile(POSITION, 2)
    assert "the two sensors at 5, 15, 25, 35, 45" in _hints(*both, 0.0)
    weak = np.array([0.0104, 0.0083, 0.006, 0.0041, 0.0017])  # taken for a larger noise
    opposed = np.concatenate((-weak, weak)), np.tile(POSITION, 2)
    assert "the two sensors at 5, 15, 25, 35, 45" in _hints(*opposed, 0.0)
    noisy = opposed[0] + NOISE * np.random.default_rng(4).standard_normal(10), opposed[1]
    assert "the two sensors at 5, 15, 25, 35, 45" in _hints(*noisy, 0.0, noise=None)


def test_noise_alone_is_no_column_of_the_other_sign() -> None:
    rng = np.random.default_rng(5)
    columns = np.tile(POSITION, 2)
    frames = NOISE * rng.standard_normal((200, 10))
    assert not any("opposite" in _hints(frame, columns, 0.0, noise=None) for frame in frames)


def test_a_sensor_just_beyond_the_body_is_said_to_be_one_that_is_not_everted() -> None:
    with pytest.raises(DataError, match="not everted yet"):
        localize(np.full(5, 0.01), POSITION, length=43.0)


@pytest.mark.parametrize("bad", [4, 9])
def test_one_bad_sensor_of_two_at_the_end_is_not_taken_for_a_missing_free_curvature(
    bad: int,
) -> None:
    right = np.tile(_readings(40.0, -2e-4, 0.03, np.random.default_rng(2)), 2)
    right[bad] = 0.0
    assert "--free-curvature" not in _hints(right, np.tile(POSITION, 2), 0.03)
