"""The calibration folder: rows survive crashes, results back up robot.toml, blanks are blank."""

from __future__ import annotations

import numpy as np
import pytest
from calibration_truth import bends

from thigmo.calibrate.actuator import fit_actuator
from thigmo.calibrate.bench import Bench
from thigmo.calibrate.commands import commands_of
from thigmo.calibrate.regression import fit_linear
from thigmo.calibrate.session import Session, blank
from thigmo.calibrate.steps import STEPS, fit_csv, run, run_all, steps_of
from thigmo.config import FlexSensor, RobotConfig
from thigmo.design import draft
from thigmo.errors import DataError
from thigmo.record.table import MissingColumnError, Table

FITS = [name for name, step in STEPS.items() if step.of_csv is not None]


def test_rows_are_kept_in_order_and_a_torn_line_is_dropped(tmp_path):
    session = Session(tmp_path)
    session.add("tips", {"key": "a", "ohm": np.array([1.0, 2.0]), "n": np.int64(3)})
    session.add("tips", {"key": "b", "ohm": [3.0]})
    with (tmp_path / "tips.jsonl").open("a") as file:
        file.write('{"key": "c", "oh')
    again = Session(tmp_path)
    assert list(again.rows("tips")) == ["a", "b"]
    again.add("tips", {"key": "c", "ohm": [4.0]})
    assert [row["ohm"] for row in again.rows("tips").values()] == [[1.0, 2.0], [3.0], [4.0]]
    again.forget("tips")
    assert again.rows("tips") == {}
    assert (tmp_path / "tips.jsonl.old").exists()


def test_rows_are_prepared_for_once_and_not_where_all_are_held(tmp_path):
    bench = Bench(None, None, Session(tmp_path))
    done: list[str] = []

    def take(key: str, _: None) -> dict[str, int]:
        done.append(key)
        return {"n": len(done)}

    for keys in (["a", "b"], ["a", "b"], ["a", "b", "c"]):
        bench.rows("tips", dict.fromkeys(keys), take, lambda: done.append("ready"))
    assert done == ["ready", "a", "b", "ready", "c"]


def test_damage_in_the_middle_is_an_error(tmp_path):
    session = Session(tmp_path)
    (tmp_path / "tips.jsonl").write_text('{"key": "a"}\nnonsense\n{"key": "b"}\n')
    with pytest.raises(DataError, match="line 2 is damaged"):
        session.rows("tips")


def test_good_results_reach_robot_toml_with_a_backup_and_bad_ones_do_not(tmp_path):
    session = Session(tmp_path)
    before = session.robot_file.read_text()
    result = fit_actuator(bends(1))
    said, *_, last = session.keep("actuator", result)
    assert said.startswith("actuator: good: g known to")
    assert last.endswith("robot.toml updated; the one before is robot.toml.1.bak")
    assert (tmp_path / "robot.toml.1.bak").read_text() == before
    assert RobotConfig.load(session.robot_file).muscle("left").maps[2] == result.muscle_map
    assert session.good_result("actuator")["verdict"]["good"]
    after = session.robot_file.read_text()
    wrong = bends(1)
    swapped = fit_actuator(type(wrong)(**{**wrong.__dict__, "curvature": -wrong.curvature}))
    (said,) = session.keep("actuator", swapped)
    assert said.startswith("actuator: BAD: ")
    assert session.robot_file.read_text() == after
    assert session.good_result("actuator") is None


def test_an_unwritable_folder_is_said(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="choose another folder"):
        Session(tmp_path / "file" / "deeper")


def test_blank_keeps_geometry_only():
    config = RobotConfig()
    config.column("left")[1].center_cm = 16.0
    config.column("left")[1].scale_per_ohm = 1e-6
    config.muscle("right").maps[0].inflate.amplitude = 0.01
    made = blank(config)
    assert made.column("left")[1].center_cm == 16.0
    assert made.column("left")[1].scale_per_ohm == RobotConfig().column("left")[1].scale_per_ohm
    assert made.muscle("right").maps[0] == RobotConfig().muscle("right").maps[0]


def test_blank_keeps_what_maps_muscles_out_of_the_plane():
    """No step measures a sensor out of the plane, and muscles are mapped before flex sensors."""
    config = draft(53, None, 3)
    for sensor in config.board_sensors:
        sensor.scale_per_ohm *= 1.5
        sensor.zero_se = 1e-4
    for begun, sensor in zip(blank(config).board_sensors, config.board_sensors, strict=True):
        if sensor.side is None:
            assert begun == sensor
        else:
            assert begun.scale_per_ohm == pytest.approx(sensor.scale_per_ohm / 1.5)
            assert begun.zero_se == FlexSensor(center_cm=5.0).zero_se


def test_a_fit_that_there_is_not_is_named(tmp_path):
    with pytest.raises(DataError, match="no fit 'magic'"):
        fit_csv("magic", tmp_path / "any.csv", RobotConfig())
    with pytest.raises(DataError, match="no heading sensors"):
        fit_csv("heading", tmp_path / "any.csv", RobotConfig())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("a,b\n1\n", "line 2: 1 cells for 2 columns"),
        ("a,a\n1,2\n", "twice"),
        ("a\nword\n", "line 2: a is 'word', not a number"),
        ("# lab\n\na|b\n1|2\n", "by bars"),
    ],
)
def test_malformed_tables_name_the_line(tmp_path, text, message):
    path = tmp_path / "t.csv"
    path.write_text(text)
    with pytest.raises(DataError, match=message):
        Table.read(path).numbers("a")


def test_infinite_and_fractional_cells_name_the_line(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("a\n1\ninf\n")
    with pytest.raises(DataError, match="line 3: a is inf, not a finite"):
        Table.read(path).numbers("a")
    for text in ("a\n1\n2.5\n", "a,b\n1,1\n,1\n"):
        path.write_text(text)
        with pytest.raises(DataError, match="line 3: column 'a' needs a whole number"):
            Table.read(path).integers("a")


@pytest.mark.parametrize("step", [step for step in steps_of(RobotConfig()) if step in FITS])
def test_a_csv_of_something_else_is_told_the_columns_of_the_step(tmp_path, step):
    path = tmp_path / "t.csv"
    path.write_text("colour\nred\n")
    with pytest.raises(MissingColumnError, match="no column") as caught:
        fit_csv(step, path, RobotConfig())
    assert STEPS[step].columns in caught.value.__notes__[0]


def test_regression_coverage_with_known_and_unknown_errors():
    misses = []
    for seed in range(150):
        rng = np.random.default_rng(seed)
        x = rng.uniform(-1, 1, 24)
        known = rng.uniform(0.0, 0.2, 24)
        y = 2 + 3 * x + rng.normal(0, 0.1, 24) + known * rng.normal(0, 1, 24)
        fit = fit_linear(np.column_stack([np.ones(24), x]), y, known)
        misses.append(
            [(fit.coefficients[0] - 2) / fit.se(0), (fit.coefficients[1] - 3) / fit.se(1)]
        )
    assert 0.8 < np.mean(np.square(misses)) < 1.35


def test_regression_stands_a_fifth_of_outliers():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        x = rng.uniform(-1, 1, 40)
        y = 3 * x + rng.normal(0, 0.02, 40)
        y[:8] += rng.choice([-1, 1], 8) * rng.uniform(1, 20, 8)
        fit = fit_linear(np.column_stack([np.ones(40), x]), y)
        assert not fit.used[:8].any()
        assert fit.coefficients[1] == pytest.approx(3, abs=0.05)


@pytest.mark.parametrize("muscles", [0, 1, 2])
@pytest.mark.parametrize("kind", ["flex", "heading", "fibre"])
def test_the_commands_that_calibrate_a_robot_are_those_of_its_steps(kind, muscles):
    robot = draft(53, 5, muscles, kind=kind)
    by_file = [
        f"thigmo calibrate {name} --csv FILE"
        for name, step in STEPS.items()
        if step.kind and step.lacking(robot) and not step.lacking(robot, in_file=True)
    ]
    guided = ["thigmo calibrate all --robot URL"] if steps_of(robot) else []
    assert commands_of(robot, "URL") == [*guided, *by_file]


def test_a_fibre_that_nothing_on_the_board_bends_is_calibrated_from_a_file(tmp_path):
    robot = draft(30, 6, 0, kind="fibre")
    assert commands_of(robot, "URL") == ["thigmo calibrate fibre --csv FILE"]
    bench = Bench(None, None, Session(tmp_path, robot))
    with pytest.raises(DataError, match="`thigmo calibrate fibre --csv FILE`"):
        run_all(bench)
    with pytest.raises(DataError, match=r"no sensor on the board.*calibrate fibre --csv FILE"):
        run(bench, "fibre")
    gratings = robot.gratings
    bend = 0.02 * np.sin(np.arange(9.0))
    columns = [
        np.round(bend / grating.scale_per_ue if grating.side else 0 * bend, 3)
        for grating in gratings
    ]
    names = ",".join(f"strain_{n}" for n in range(len(gratings)))
    rows = [",".join(map(str, row)) for row in zip(np.arange(9.0), bend, *columns, strict=True)]
    file = tmp_path / "bends.csv"
    file.write_text("\n".join([f"t_s,curvature,{names}", *rows]))
    assert fit_csv("fibre", file, robot).verdict.good
