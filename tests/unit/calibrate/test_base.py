"""Compliance of the base from pictures and from files of bases that turn as known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from calibration_truth import LENGTH, Lab

from thigmo.calibrate.axis import AxisPoints
from thigmo.calibrate.base import fit_pictures
from thigmo.calibrate.flex import fit_flex
from thigmo.calibrate.session import Session, blank
from thigmo.calibrate.step_figures import draw
from thigmo.calibrate.steps import fit_csv
from thigmo.config import Body, RobotConfig
from thigmo.errors import DataError
from thigmo.field.sweeps import stated
from thigmo.mechanics import Tube, push, push_tip
from thigmo.record.table import write_table
from thigmo.wiring import Wiring

FOLD = Body().critical_curvature
COMPLIANCES = [0.0, 0.03 / FOLD, 0.1 / FOLD]  # cm, by the turn in rad at the moment of the fold
SHARES = [0.45, -0.45, 0.85, -0.85] * 2  # of the moment of the fold
_POINTS = 97
_POINT_CM = 0.015  # one sigma of a point of the axis, as the camera sees the emulated robot


def force(moment: float) -> float:
    """Force at the tip over EI that bends the base by a moment."""
    size = push_tip(abs(moment), LENGTH).contacts[0].normal
    return float(np.copysign(size, moment))


def picture(
    compliance_cm: float, share: float, rng: np.random.Generator, more_rad: float = 0.0
) -> AxisPoints:
    """Axis of a body pushed at its tip, by a camera that stands 0.003 rad and 0.5 mm off."""
    tube = Tube(base_compliance_cm=compliance_cm)
    body = push(force(share * FOLD), LENGTH, free_curvature=0.0, length=LENGTH, tube=tube)
    arc = np.linspace(1.0, 51.0, _POINTS)
    x, y, heading = (np.interp(arc, body.s, line) for line in (body.x, body.y, body.heading))
    # Errors of neighbouring points are correlated.
    error = np.convolve(rng.standard_normal(_POINTS + 2), [0.4, 1.0, 0.4], "valid")
    error *= _POINT_CM / np.sqrt(1.32)
    seen = np.column_stack([x - np.sin(heading) * error, y + np.cos(heading) * error])
    turn = 0.003 + more_rad
    camera = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return AxisPoints(seen @ camera + [0.0, 0.05], LENGTH)


@pytest.mark.parametrize("compliance_cm", COMPLIANCES)
def test_pictures_tell_the_compliance_within_its_error(compliance_cm: float) -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        result = fit_pictures([picture(compliance_cm, s, rng) for s in SHARES], RobotConfig())
        assert result.verdict.good, result.verdict
        assert result.verdict.notes == ()
        assert abs(result.compliance_cm - compliance_cm) < 3 * result.compliance_se_cm
        assert result.compliance_se_cm * FOLD < 0.005  # rad; an unmeasured base has 0.028


def test_most_of_the_stated_error_is_that_of_an_unknown_taper() -> None:
    """An even body is measured three times as well: what its camera adds is small."""
    compliance_cm = COMPLIANCES[1]
    errors = []
    for seed in range(20):
        rng = np.random.default_rng(100 + seed)
        result = fit_pictures([picture(compliance_cm, s, rng) for s in SHARES], RobotConfig())
        errors.append((result.compliance_cm - compliance_cm) / result.compliance_se_cm)
    assert 0.02 < np.sqrt(np.mean(np.square(errors))) < 0.4


def pushes_file(path: Path, compliance_cm: float, seed: int = 0, **changes: list[float]) -> Path:
    """A lab's file of moments and turns, read to 0.1 degrees."""
    rng = np.random.default_rng(seed)
    moment = FOLD * np.array([0.4, -0.4, 0.8, -0.8, 0.6, -0.6])
    turn = np.degrees(compliance_cm * moment) + 0.2 + 0.1 * rng.standard_normal(len(moment))
    columns = {"moment": moment.tolist(), "turn_deg": turn.tolist()} | changes
    write_table(path, {name: values for name, values in columns.items() if values})
    return path


@pytest.mark.parametrize("compliance_cm", COMPLIANCES)
def test_a_file_of_moments_and_turns_tells_it(tmp_path: Path, compliance_cm: float) -> None:
    for seed in range(6):
        file = pushes_file(tmp_path / "pushes.csv", compliance_cm, seed)
        result = fit_csv("base", file, RobotConfig())
        assert result.verdict.good, result.verdict
        assert abs(result.compliance_cm - compliance_cm) < 3 * result.compliance_se_cm


def test_a_file_of_points_is_fitted_as_pictures_are(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    pictures = [picture(COMPLIANCES[1], share, rng) for share in SHARES]
    points = np.vstack([axis.points_cm for axis in pictures])
    numbers = np.repeat(np.arange(len(pictures)), _POINTS)
    columns = {"picture": numbers.tolist(), "x_cm": points[:, 0].tolist()}
    write_table(tmp_path / "points.csv", columns | {"y_cm": points[:, 1].tolist()})
    read = fit_csv("base", tmp_path / "points.csv", RobotConfig())
    assert read.compliance_cm == pytest.approx(
        fit_pictures(pictures, RobotConfig()).compliance_cm, rel=1e-3
    )


def test_weights_and_the_tips_place_tell_it_as_well_as_the_stiffness_is_known(
    tmp_path: Path,
) -> None:
    """Half of the tip's way is the body's own bend, so the error of EI counts in full."""
    compliance_cm, stiffness = COMPLIANCES[1], 430.0
    config = RobotConfig()
    forces = [force(share * FOLD) for share in SHARES]
    tube = Tube(base_compliance_cm=compliance_cm)
    tips = [
        push(over_ei, LENGTH, free_curvature=0.0, length=LENGTH, tube=tube).tip[1]
        for over_ei in forces
    ]
    columns = {"force_n": [f * stiffness * 1.01 for f in forces], "tip_y_cm": tips}
    write_table(tmp_path / "weights.csv", columns | {"force_se": [0.005] * len(tips)})
    with pytest.raises(DataError, match="no bending stiffness"):
        fit_csv("base", tmp_path / "weights.csv", config)
    for stiffness_se, good in ((4.3, True), (21.5, False)):
        config.body.stiffness_n_cm2, config.body.stiffness_se_n_cm2 = stiffness, stiffness_se
        result = fit_csv("base", tmp_path / "weights.csv", config)
        assert abs(result.compliance_cm - compliance_cm) < 3 * result.compliance_se_cm
        assert result.verdict.good == good, result.verdict
    assert "more uncertain than" in result.verdict.reason


def test_pushes_against_the_turn_are_refused(tmp_path: Path) -> None:
    result = fit_csv("base", pushes_file(tmp_path / "pushes.csv", -5.0), RobotConfig())
    assert not result.verdict.good
    assert "check signs" in result.verdict.reason
    assert result.apply(RobotConfig()).body.base_compliance_cm >= 0.0


def test_a_base_that_slips_at_large_moments_is_refused() -> None:
    rng = np.random.default_rng(5)
    slips = [0.06 * np.sign(share) if abs(share) > 0.5 else 0.0 for share in SHARES]
    pictures = [
        picture(COMPLIANCES[1], share, rng, -slip)
        for share, slip in zip(SHARES, slips, strict=True)
    ]
    result = fit_pictures(pictures, RobotConfig())
    assert not result.verdict.good
    assert "not proportional" in result.verdict.reason


def test_pushes_beyond_the_fold_are_omitted_and_said() -> None:
    rng = np.random.default_rng(6)
    pictures = [picture(COMPLIANCES[1], s, rng) for s in SHARES]
    folded = [picture(COMPLIANCES[1], s, rng, -0.1 * s) for s in (1.0, -1.0)]
    result = fit_pictures([*pictures, *folded], RobotConfig())
    assert result.verdict.good
    assert result.verdict.notes == ("2 push(es) omitted: so far that the base may fold",)
    assert abs(result.compliance_cm - COMPLIANCES[1]) < 3 * result.compliance_se_cm


def test_one_size_of_push_is_said_to_show_no_proportion(tmp_path: Path) -> None:
    moment = [0.8 * FOLD, -0.8 * FOLD] * 3
    turns = [1.5, -1.5, 1.6, -1.4, 1.5, -1.6]
    file = pushes_file(tmp_path / "pushes.csv", 0.0, moment=moment, turn_deg=turns)
    result = fit_csv("base", file, RobotConfig())
    assert any("by two amounts" in note for note in result.verdict.notes)


@pytest.mark.parametrize(
    ("changes", "says"),
    [({"moment": [0.001, -0.001, 0.0005, -0.0005, 0.001, 0.0]}, "differ by 0.0020 1/cm only"),
     ({"moment": [np.nan, np.nan, np.nan, -0.004, 0.008, 0.004]}, "3 usable pushes"),
     ({"moment": [0.4, -0.4, 0.8, -0.8, 0.6, -0.6]}, "bends the body back"),
     ({"force_arc_cm": [60.0] * 6}, "off the body"),
     ({"moment_se": [-0.1] * 6}, "is negative"),
     ({"turn_deg": [90.0, -90.0, 180.0, -180.0, 120.0, -120.0]}, "beyond 57 degrees"),
     ({"turn_deg": [], "tip_y_cm": [60.0] * 6}, "the tip cannot stand 60.0 cm aside"),
     ({"turn_deg": []}, "no column 'tip_y_cm'"),
     ({"moment": []}, "no column 'force_n'")],
)  # fmt: skip
def test_files_that_tell_nothing_are_refused(
    tmp_path: Path, changes: dict[str, list[float]], says: str
) -> None:
    file = pushes_file(tmp_path / "pushes.csv", 5.0, **changes)
    with pytest.raises(DataError, match=says):
        fit_csv("base", file, RobotConfig())


def test_what_is_measured_reaches_the_fit_of_explorations(tmp_path: Path) -> None:
    session = Session(tmp_path / "calibration", blank(RobotConfig()))
    everything = np.ones(10, bool)
    before = stated(Wiring.laid_out(session.config), "left", everything)
    assert (before.base, before.base_error) == (0.0, 2.5)
    file = pushes_file(tmp_path / "pushes.csv", COMPLIANCES[2])
    result = fit_csv("base", file, session.config)
    session.keep("base", result)
    draw(result, session.figure("base"))
    assert session.figure("base").stat().st_size > 1000
    errors = stated(Wiring.laid_out(RobotConfig.load(session.robot_file)), "left", everything)
    assert errors.base == pytest.approx(COMPLIANCES[2], abs=3 * errors.base_error)
    assert errors.base_error == pytest.approx(result.compliance_se_cm)
    body = blank(session.config).body
    assert (body.base_compliance_cm, body.base_compliance_se_cm) == (0.0, 2.5)


@pytest.mark.sim
def test_a_base_that_turns_misleads_no_flex_sensor_once_it_is_measured() -> None:
    """The tip's place says how far the body is bent only if the base's turn is taken off it."""
    lab = Lab(4, base_compliance_cm=4.5)
    readings = lab.flex()
    misled = fit_flex(readings, lab.config)
    assert any("camera or the base moved" in note for note in misled.verdict.notes)
    lab.config.body.base_compliance_cm = 4.5
    fitted = fit_flex(readings, lab.config)
    assert fitted.verdict.notes == ()
    scale = np.array([fit.scale_per_ohm for fit in fitted.sensors])
    assert np.abs(scale / lab.scale - 1).max() < 0.04
