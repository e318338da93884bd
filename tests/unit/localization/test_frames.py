"""A peg at rest is found from the frames of an inflation: side and end, either side, any unit."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from thigmo.errors import DataError
from thigmo.localization import ContactFilter, Localizer, LocalizeResult
from thigmo.mechanics import Peg, Tube, solve

Floats = npt.NDArray[np.float64]
FREE = np.array([0.0175, 0.0213, 0.0241])
COLUMN = np.array([5.0, 15.0, 25.0, 35.0, 45.0])
CRITICAL = 0.01108


def peg(arc: float, touch: float = 0.0175) -> Peg:
    """That the body just touches with its left side."""
    turn, reach = touch * arc, 1.75 + 0.6
    return Peg(
        np.sin(turn) / touch - reach * np.sin(turn),
        (1 - np.cos(turn)) / touch + reach * np.cos(turn),
        0.6,
    )


def frames(obstacle: Peg | None, noise: float, frees: Floats = FREE) -> Floats:
    """What the sensors read of a body that bends into the peg."""
    tube = Tube(3.5, CRITICAL)
    bodies = [solve(g, 53.0, tube=tube, pegs=[obstacle] if obstacle else []) for g in frees]
    clean = np.array([body.averages(COLUMN, 5.5) for body in bodies])
    return clean + noise * np.random.default_rng(0).standard_normal(clean.shape)


def empty(noise: float, sign: float = 1.0, unit: float = 1.0, **errors: float) -> ContactFilter:
    """A filter without a frame."""
    localizer = Localizer.of(
        position=COLUMN * unit,
        length=53.0 * unit,
        span=5.5 * unit,
        noise=max(noise, 1e-4) / unit,
        critical_curvature=CRITICAL / unit,
        tube_radius=1.75 * unit,
        **errors,
    )
    return localizer.filter(sign * FREE[-1] / unit, peg_radius=0.6 * unit)


def answer(
    obstacle: Peg | None, noise: float, sign: float = 1.0, unit: float = 1.0
) -> LocalizeResult:
    felt = empty(noise, sign, unit)
    felt.update(sign * frames(obstacle, noise) / unit, sign * FREE / unit)
    return felt.result()


@pytest.mark.parametrize("arc", [53.0, 40.0, 26.0])
def test_without_noise_the_peg_is_found(arc: float) -> None:
    true = peg(arc)
    result = answer(true, 0.0)
    assert result.parameters["peg_x"] == pytest.approx(true.x, abs=0.5)
    assert result.parameters["peg_y"] == pytest.approx(true.y, abs=0.5)
    assert (result.contacts[0].end_offset is not None) == (arc == 53.0)


def test_sides_are_mirrored_and_units_scale() -> None:
    left = answer(peg(40.0), 2e-4)
    right = answer(peg(40.0), 2e-4, sign=-1.0, unit=0.01)
    assert right.contacts[0].arc == pytest.approx(0.01 * left.contacts[0].arc, rel=1e-6)
    assert right.contacts[0].force == pytest.approx(-1e4 * left.contacts[0].force, rel=1e-6)
    assert right.parameters["peg_y"] == pytest.approx(-0.01 * left.parameters["peg_y"], rel=1e-6)


def test_a_free_body_touches_nothing() -> None:
    result = answer(None, 4e-4)
    assert not result.contacts
    assert result.hypothesis == "free body"
    assert result.status in ("no contact", "below detection")


def test_the_order_of_frames_and_their_number_at_a_time_change_nothing() -> None:
    readings = frames(peg(40.0), 3e-4)
    together, apart = empty(3e-4, gain_error=0.03), empty(3e-4, gain_error=0.03)
    together.update(readings, FREE)
    for index in (1, 0, 2):
        apart.update(readings[index], FREE[index])
    assert apart.result().contacts[0].arc == pytest.approx(together.result().contacts[0].arc)
    assert apart.result().log_odds == pytest.approx(together.result().log_odds)


def test_frames_before_the_touch_teach_the_gains() -> None:
    gains = 1.0 + 0.06 * np.array([1.0, -1.0, 0.5, -0.5, 1.0])
    rising = np.linspace(0.004, 0.0241, 12)
    readings = gains * frames(peg(28.0, touch=0.015), 2e-4, rising)
    felt, late = empty(2e-4, gain_error=0.06), empty(2e-4, gain_error=0.06)
    felt.update(readings, rising)
    late.update(readings[-3:], rising[-3:])

    def width(result: LocalizeResult) -> float:
        return float(np.ptp(result.contacts[0].interval)) if result.contacts else 53.0

    low, high = felt.result().contacts[0].interval
    assert low <= 28.0 <= high
    assert width(felt.result()) < 0.7 * width(late.result())


@pytest.mark.parametrize("sensor", range(5))
@pytest.mark.parametrize("fault", ["offset", "noise"])
def test_a_sensor_that_is_bad_in_all_frames_is_named(sensor: int, fault: str) -> None:
    rising = np.linspace(0.004, 0.0241, 12)
    readings = frames(peg(40.0, touch=0.015), 2e-4, rising)
    wild = 0.01 * np.random.default_rng(1).standard_normal(len(rising))
    readings[:, sensor] += 0.008 if fault == "offset" else wild
    felt = empty(2e-4)
    felt.update(readings, rising)
    result = felt.result()
    assert result.discarded == (sensor,)
    (contact,) = result.contacts
    assert contact.interval[0] <= 40.0 <= contact.interval[1]


def test_readings_worse_than_their_noise_widen_the_answer() -> None:
    rising = np.linspace(0.004, 0.0241, 12)
    readings = frames(peg(35.0, touch=0.015), 1.5e-3, rising)
    felt = empty(3e-4)
    felt.update(readings, rising)
    result = felt.result()
    assert "times their noise" in result.message
    low, high = result.contacts[0].interval
    assert low <= 35.0 <= high


def test_an_answer_is_there_after_any_frame() -> None:
    felt = empty(3e-4)
    with pytest.raises(DataError, match="no frame"):
        felt.result()
    for readings, free in zip(frames(peg(40.0), 3e-4), FREE, strict=True):
        felt.update(readings, free)
        found = felt.result()
        assert found.status in ("no contact", "below detection", "ambiguous", "localized")
    assert found.contacts
    assert found.hypothesis == "one obstacle at rest over 3 frames"
    assert sum(found.hypotheses.values()) == pytest.approx(1.0)
    assert found.probability.sum() == pytest.approx(1.0)
    assert found.edges[-1] == pytest.approx(53.0)


@pytest.mark.parametrize(
    ("readings", "free", "says"),
    [
        (np.zeros(4), 0.02, "shape"),
        (np.full(5, np.inf), 0.02, "infinite"),
        (np.zeros((2, 5)), 0.02, "shape"),
        (np.zeros(5), -0.02, "announced"),
        (np.zeros(5), 0.03, "announced"),
        (np.zeros(5), np.nan, "announced"),
    ],
)
def test_a_frame_that_cannot_be_is_refused_and_changes_nothing(
    readings: Floats, free: float, says: str
) -> None:
    felt = empty(3e-4)
    with pytest.raises(DataError, match=says):
        felt.update(readings, free)
    assert felt.frames == 0


def test_a_body_that_is_not_to_bend_has_no_filter() -> None:
    with pytest.raises(DataError, match="most_curvature"):
        Localizer.of(position=COLUMN, length=53.0, noise=5e-4).filter(0.0)


@pytest.mark.parametrize(
    ("told", "given", "says"),
    [
        ({"noise": None}, {}, "known noise"),
        ({"shared_errors": np.ones((5, 1))}, {}, "shared_errors"),
        ({}, {"bad_sensor_odds": -1.0}, "bad_sensor_odds"),
        ({}, {"place_error": np.nan}, "place_error"),
    ],
)
def test_what_frames_do_not_know_is_refused(
    told: dict[str, Any], given: dict[str, float], says: str
) -> None:
    localizer = Localizer.of(position=COLUMN, length=53.0, **({"noise": 5e-4} | told))
    with pytest.raises(DataError, match=says):
        localizer.filter(0.02, **given)
