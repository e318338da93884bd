"""Mistakes in the readings are weighed, named, and taken out by stating the error."""

from __future__ import annotations

import numpy as np
import pytest

import thigmo
from thigmo.errors import DataError
from thigmo.mechanics.closed_forms import phi
from thigmo_bench.studies.scenes import STATED

LENGTH, NOISE, FREE = 53.0, 6e-4, 0.03
POSITION = np.linspace(2.0, 50.0, 20)
TOUCH = 6e-5 * phi(35.0, POSITION, 0.0)


def noise(seed, scale=1.0):
    return scale * NOISE * np.random.default_rng(seed).standard_normal(POSITION.size)


def find(curvature, **options):
    return thigmo.localize(curvature, POSITION, length=LENGTH, noise=NOISE, **options)


def wrong(result, arc):
    """Whether a localized contact has no true one in its set."""
    return any(
        contact.status == "localized"
        and not any(low - 0.1 <= arc <= high + 0.1 for low, high in contact.intervals)
        for contact in result.contacts
    )


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    ("actual", "stated", "name"),
    [
        (FREE, -FREE, "free curvature of the wrong sign"),
        (0.0, FREE, "free curvature subtracted twice"),
        (FREE, None, "free curvature not given"),
    ],
)
def test_a_wrong_free_curvature_is_named(actual, stated, name, seed):
    result = find(TOUCH + actual + noise(seed), free_curvature=stated)
    assert max(result.doubts, key=result.doubts.__getitem__) == name
    assert result.remarks
    assert result.remarks[0] in result.message
    assert not wrong(result, 35.0)


@pytest.mark.parametrize("seed", range(5))
def test_a_bent_body_without_a_free_curvature_is_not_touched(seed):
    assert not any(c.status == "localized" for c in find(FREE + noise(seed)).contacts)
    turned = find(FREE + noise(seed), free_curvature=-FREE)
    assert not any(c.status == "localized" for c in turned.contacts)


def test_what_is_stated_is_not_doubted():
    curvature = TOUCH + FREE + noise(3)
    plain = find(curvature, free_curvature=FREE, **STATED)
    assert plain.doubts == {} or set(plain.doubts) <= {"as stated", "noise larger than stated"}
    usual = find(curvature, free_curvature=FREE)
    assert "slightly off" in usual.doubts
    for stated, gone in (
        ({"map_error": 0.0}, "free curvature far off"),
        ({"base_fold_error": 0.0}, "small fold at the base"),
        ({"map_error": 0.0, "offset_error": 0.0}, "slightly off"),
    ):
        assert gone in usual.doubts
        assert gone not in find(curvature, free_curvature=FREE, **stated).doubts


def test_zero_is_stated_and_none_is_not():
    curvature = TOUCH + noise(4)
    assert "free curvature not given" in find(curvature).doubts
    assert "free curvature not given" not in find(curvature, free_curvature=0.0).doubts
    assert "free curvature not given" not in find(curvature, map_error=0.0).doubts


def test_a_noise_that_is_not_as_stated_is_remarked():
    result = find(TOUCH + noise(5, 8.0), free_curvature=0.0)
    assert result.doubts["noise larger than stated"] > 0.9
    assert any("larger than stated" in remark for remark in result.remarks)
    quiet = find(TOUCH + noise(6, 0.1), free_curvature=0.0)
    assert quiet.reduced_chi2 < 0.3
    assert any("far below" in remark for remark in quiet.remarks)


def test_correlated_noise_of_a_dense_array_is_remarked():
    position = np.linspace(1.0, 52.0, 100)
    rng = np.random.default_rng(7)
    noise = rng.standard_normal(100)
    for k in range(1, 100):
        noise[k] = 0.9 * noise[k - 1] + np.sqrt(1.0 - 0.81) * noise[k]
    curvature = 6e-5 * phi(35.0, position, 0.0) + NOISE * noise
    given = {"length": LENGTH, "noise": NOISE, "free_curvature": 0.0}
    result = thigmo.localize(curvature, position, **given)
    assert result.doubts["neighbours correlated"] > 0.9
    assert "neighbouring readings are correlated: give noise_correlation" in result.remarks
    stated = thigmo.localize(curvature, position, noise_correlation=0.9, **given)
    assert "neighbours correlated" not in stated.doubts


def test_predictions_and_residuals_are_the_readings():
    curvature = TOUCH + noise(8)
    curvature[4] = np.nan
    result = find(curvature, free_curvature=0.0, **STATED)
    finite = np.isfinite(curvature)
    assert np.allclose((result.predicted + result.residuals)[finite], curvature[finite])
    assert np.isnan(result.residuals[4])
    assert np.abs(result.predicted - TOUCH)[finite].max() < 3.0 * NOISE
    assert result.reduced_chi2 == pytest.approx(
        np.sum((result.residuals[finite] / NOISE) ** 2) / (finite.sum() - 2), rel=0.05
    )
    assert np.isfinite(result.correlation)


def test_the_evidence_of_a_frame_does_not_depend_on_the_unit():
    curvature = TOUCH + noise(9)
    options = {"free_curvature": 0.0, **STATED}
    cm = find(curvature, **options)
    mm = thigmo.localize(
        curvature / 10.0, 10.0 * POSITION, length=10.0 * LENGTH, noise=NOISE / 10.0, **options
    )
    assert mm.log_evidence == pytest.approx(cm.log_evidence + 20.0 * np.log(10.0), abs=1e-6)


def test_rows_say_what_single_frames_say():
    frames = np.array([TOUCH + FREE + noise(seed) for seed in range(4)] + [FREE + noise(5)])
    frames[1, 3] = np.nan
    free = np.array([FREE, FREE, -FREE, FREE, FREE])
    rows = thigmo.localize_batch(
        frames, POSITION, length=LENGTH, noise=NOISE, free_curvature=free[:, None], residuals=True
    )
    assert rows.residuals is not None
    for row, (frame, g) in enumerate(zip(frames, free, strict=True)):
        single = find(frame, free_curvature=g)
        assert rows.status[row] == single.status
        assert rows.message[row] == single.message
        assert rows.hypothesis[row] == single.hypothesis
        assert rows.touched[row] == single.touched
        assert rows.log_evidence[row] == single.log_evidence
        assert np.array_equal(rows.residuals[row], single.residuals, equal_nan=True)
        for name, probability in single.doubts.items():
            assert rows.doubts[name][row] == probability
        for contact, probability in zip(single.contacts, rows.probability[row], strict=False):
            assert contact.probability == probability


def test_a_held_end_is_true_or_one():
    curvature = TOUCH + noise(10)
    true, number_one = (find(curvature, held_end=held) for held in (True, 1))
    assert true.log_odds == number_one.log_odds
    assert find(curvature, held_end=1.0).log_odds != true.log_odds


def test_a_localizer_prints_short():
    localizer = thigmo.Localizer.of(position=POSITION, length=LENGTH, noise=NOISE)
    assert repr(localizer) == "Localizer(20 sensors, body of 53, posterior)"


def test_a_batch_draws_each_contact_at_its_row() -> None:
    frames = np.array([TOUCH + noise(1), noise(2), TOUCH + noise(3)])
    rows = thigmo.localize_batch(frames, POSITION, length=LENGTH, noise=NOISE, free_curvature=0.0)
    axes = rows.plot(moments=[0.5, 1.0, 2.0], label="time (s)", unit="cm")
    points = [line.get_xydata()[0] for line in axes.lines if line.get_marker() == "o"]
    assert [tuple(point) for point in points] == [(0.5, rows.arc[0, 0]), (2.0, rows.arc[2, 0])]
    assert axes.get_xlabel() == "time (s)"
    assert axes.get_ylim() == (0.0, LENGTH)
    with pytest.raises(DataError, match="moments"):
        rows.plot(moments=[1.0])


def test_a_less_likely_contact_on_the_end_does_not_draw_the_arc_there():
    # A contact at 21.7 cm. Its set is 19 to 36 cm with 58 %, and the end with 42 %.
    readings = [
        0.01922, 0.02178, 0.02465, 0.02629, 0.02692, 0.02788, 0.02964, 0.02902, 0.02887, 0.02841,
    ]  # fmt: skip
    result = thigmo.localize(
        readings, np.linspace(2.75, 50.25, 10), length=LENGTH, span=5.5, noise=NOISE,
        free_curvature=0.0284, tube_radius=1.75, held_end=False, critical_curvature=np.inf,
        **STATED,
    )  # fmt: skip
    (contact,) = result.contacts
    pieces = contact.intervals
    assert len(pieces) > 1
    assert pieces[0][0] < contact.arc < pieces[0][1]
    assert abs(contact.arc - 21.7) < 5.0
