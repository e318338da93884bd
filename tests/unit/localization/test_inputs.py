"""Any finite input gets an answer, anything else a typed error."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import thigmo
from thigmo.errors import DataError

STATUSES = {"localized", "ambiguous", "below detection", "no contact"}
finite = st.floats(-25.0, 25.0, allow_nan=False)  # turns of the body: what a tube can bend


def check(result, length):
    assert result.status in STATUSES
    numbers = [result.noise, result.log_odds]
    for contact in result.contacts:
        assert contact.status in STATUSES
        low, high = contact.interval
        assert -1e-9 * length <= low <= high <= length * (1 + 1e-9)
        assert 0.0 <= contact.arc <= length * (1 + 1e-9)
        numbers += [contact.arc, contact.force, low, high]
    assert all(math.isfinite(number) for number in numbers)
    assert np.isfinite(result.mass).all()
    assert result.mass.sum() == pytest.approx(1.0 if result.contacts else 0.0)


@settings(suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_any_finite_input_is_answered(data):
    n = data.draw(st.integers(1, 12))
    length = data.draw(st.floats(0.01, 1e4))
    scale = data.draw(st.sampled_from([1e-9, 1e-3, 1.0])) / length
    curvature = [scale * data.draw(st.one_of(finite, st.just(math.nan))) for _ in range(n)]
    curvature[0] = scale * data.draw(finite)
    position = [length * data.draw(st.floats(0.0, 1.0)) for _ in range(n)]
    position[-1] = 0.9 * length
    position[0] = 0.5 * length
    span = length * data.draw(st.sampled_from([0.0, 1e-7, 0.1, 1.0]))
    free = data.draw(st.sampled_from([0.0, 1.5, -20.0])) / length
    noise = data.draw(st.sampled_from([None, 1e-6, 0.03, 1e3]))
    noise = None if noise is None else noise / length
    contacts = data.draw(st.sampled_from(["auto", "auto", 0, 1, 2]))
    critical = data.draw(st.sampled_from([None, 0.6 / length, 0.0]))
    options = {
        "position": position,
        "length": length,
        "span": span,
        "free_curvature": free,
        "noise": noise,
        "contacts": contacts,
        "critical_curvature": critical,
        "offset_error": data.draw(st.sampled_from([0.0, 0.03])) / length,
        "gain_error": data.draw(st.sampled_from([0.0, 0.1])),
        "map_error": data.draw(st.sampled_from([0.0, 0.1])),
        "held_end": data.draw(st.sampled_from([None, True, False])),
    }
    if n >= 3 and free == 0.0 and curvature[0] != 0.0 and len(set(curvature)) == 1:
        with pytest.raises(DataError, match="all readings are"):
            thigmo.localize(curvature, **options)
        return
    result = thigmo.localize(curvature, **options)
    check(result, length)
    if contacts != "auto":
        assert len(result.contacts) in (contacts, 0)


def test_three_contacts_on_any_readings():
    rng = np.random.default_rng(31)
    for scale in (0.0, 1e-3, 0.1):
        result = thigmo.localize(
            scale * rng.standard_normal(10),
            np.tile(np.arange(5.0, 50.0, 10.0), 2),
            length=53.0,
            span=5.5,
            noise=6e-4,
            contacts=3,
        )
        check(result, 53.0)
        assert len(result.contacts) == 3


GOOD = {
    "curvature": [1e-3, 2e-3, 0.0],
    "position": [5.0, 15.0, 25.0],
    "length": 53.0,
    "span": 5.5,
    "noise": 6e-4,
}


@pytest.mark.parametrize(
    "change",
    [
        {"curvature": [1e-3, 2e-3]},
        {"curvature": [[1e-3, 2e-3, 0.0]]},
        {"curvature": [math.nan] * 3},
        {"curvature": [1e-3, math.inf, 0.0]},
        {"curvature": []},
        {"curvature": ["a", "b", "c"]},
        {"position": [5.0, 15.0, 60.0]},
        {"position": [-5.0, 15.0, 25.0]},
        {"position": [5.0, math.nan, 25.0]},
        {"span": -1.0},
        {"span": [5.5, 5.5]},
        {"span": math.inf},
        {"noise": -1.0},
        {"noise": math.nan},
        {"noise": []},
        {"noise": [1e-3, 1e-3]},
        {"free_curvature": math.inf},
        {"free_curvature": [0.0, 0.0]},
        {"length": 0.0},
        {"length": math.nan},
        {"length": "long"},
        {"contacts": 4},
        {"contacts": -1},
        {"contacts": "many"},
        {"contacts": 1.5},
        {"contacts": True},
        {"method": "guess"},
        {"offset_error": -1.0},
        {"map_error": math.nan},
        {"gain_error": [-0.1, 0.0, 0.0]},
        {"bad_reading_odds": -1.0},
        {"zero_error": math.nan},
        {"shared_errors": [1.0, 2.0, 3.0]},
        {"shared_errors": [[math.nan]] * 3},
        {"method": "thesis", "contacts": 4},
        {"critical_curvature": math.nan},
        {"tube_radius": -1.0},
        {"width_limit": math.inf},
    ],
)
def test_unusable_input_is_a_typed_error(change):
    arguments = GOOD | change
    curvature, position = arguments.pop("curvature"), arguments.pop("position")
    with pytest.raises(DataError) as caught:
        thigmo.localize(curvature, position, **arguments)
    assert caught.value.next_step


@pytest.mark.parametrize(
    ("change", "cure"),
    [
        ({"curvature": [0.1, 5.0, 0.0]}, "1/m"),  # 1/m where lengths are in cm
        ({"curvature": [10.0, 25.0, 0.0]}, "degrees"),
        ({"position": [50.0, 150.0, 250.0]}, "mm"),
        ({"position": [0.05, 0.15, 0.25]}, "same unit"),
        ({"span": 55.0}, "mm"),
        ({"position": [5.0, 5.0, 5.0]}, "centre"),
        ({"curvature": [1e-3, 1e-3, 1e-3]}, "column"),
    ],
)
def test_another_unit_is_refused_with_its_likely_cure(change, cure):
    arguments = GOOD | change
    curvature, position = arguments.pop("curvature"), arguments.pop("position")
    with pytest.raises(DataError) as caught:
        thigmo.localize(curvature, position, **arguments)
    assert cure in caught.value.next_step


def test_an_option_that_is_none_names_those_that_are():
    with pytest.raises(TypeError, match=r"'nois' is no option; options are length.*noise"):
        thigmo.localize([1e-3], [5.0], length=53.0, nois=6e-4)


def test_a_localizer_is_checked_once_and_stays_as_it_was():
    position = np.array([5.0, 15.0, 25.0])
    localizer = thigmo.Localizer(
        thigmo.Body(53.0), thigmo.Sensors(position, 5.5), thigmo.Errors(noise=6e-4)
    )
    frame = [1e-3, 2e-3, 0.0]
    before = localizer.localize(frame).log_odds
    position += 20.0
    assert localizer.localize(frame).log_odds == before
    assert pickle.loads(pickle.dumps(localizer)).localize(frame).log_odds == before
    with pytest.raises(AttributeError):
        localizer.body = thigmo.Body(54.0)
    with pytest.raises(DataError, match="differ in length"):
        localizer.localize([1e-3])


def test_an_error_of_the_zero_is_noise_of_a_frame():
    arguments = GOOD | {"curvature": [3e-3, 2e-3, 1e-3]}
    stated = thigmo.localize(**arguments | {"zero_error": 8e-4})
    assert stated.log_odds == thigmo.localize(**arguments | {"noise": 1e-3}).log_odds
