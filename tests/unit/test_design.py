"""A described robot is judged by mechanics before it is built."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from command import Thigmo

from thigmo import wiring
from thigmo.config import SIDES, RobotConfig
from thigmo.design import Finding, draft, judge
from thigmo.errors import ConfigError
from thigmo.mechanics import Peg, Rod, Tube
from thigmo.wiring import Wiring


def _bad(findings: list[Finding]) -> list[str]:
    return [f"{finding.part}: {finding.text}" for finding in findings if finding.mark == "bad"]


@pytest.mark.parametrize(
    ("length", "sensors", "muscles"), [(53, 5, 2), (120, 5, 2), (30, 3, 1), (200, 9, 1), (53, 5, 0)]
)
def test_a_draft_is_valid_and_does_what_it_must(length: float, sensors: int, muscles: int) -> None:
    config = draft(length, sensors, muscles)
    assert RobotConfig.model_validate(config.model_dump(by_alias=True)) == config
    assert _bad(judge(config)) == []
    assert len(config.muscles) == muscles
    assert config.body.pressures[-1].until_cm == length


def test_a_thick_body_slips_at_the_pressures_that_pull_harder_than_the_spool_holds() -> None:
    config = draft(53, 5, 2, diameter_cm=6.0)
    slips = [text for text in _bad(judge(config)) if "spool_slip" in text]
    # Half of 1.47 psi times 28.3 cm2 is 14.3 N; 0.49 psi pull 4.8 N, less than friction holds.
    assert len(slips) == 2
    assert "pulls 14.3 N" in slips[0]
    assert "stay below 0.62 psi" in slips[0]
    config.spool.brake = True
    assert _bad(judge(config)) == []


def test_growth_that_the_tails_friction_stops_is_said_with_what_it_needs() -> None:
    config = draft(120, 5, 2)
    config.body.growth_psi_per_cm = 0.006
    (said,) = _bad(judge(config))
    assert "does not grow to its end, which needs 0.92 psi" in said


def test_what_the_boards_parameters_cannot_hold_is_said_before_there_is_a_board() -> None:
    config = draft(120, 8, 1)
    config.spool.max_speed_cm_s = 1000.0
    (said,) = _bad(judge(config))
    assert said.startswith("board: spool_speed_um_s must lie in 100..200000 um/s, not 10000000")


def test_a_map_of_another_body_pressure_is_named() -> None:
    config = draft(120, 8, 1)
    config.muscles[0].maps.reverse()
    first, last = _bad(judge(config))
    assert first.startswith("muscle left: its map for 1.47 psi is of 0.76 psi")
    assert last.startswith("muscle left: its map for 0.76 psi is of 1.47 psi")


def test_a_sweep_without_a_base_sensor_at_rest_feels_nothing() -> None:
    config = draft(53, 5, 2)
    config.sensors = list(config.column("left"))
    findings = {finding.part: finding for finding in judge(config)}
    # As explore does: it sweeps the muscle that it can, and finds what lies there.
    assert Wiring.laid_out(config).unexplorable is None
    assert _bad(judge(config)) == []
    assert findings["sweep of left"].mark == "warning"
    assert "sweeps right only" in findings["sweep of left"].text
    config.muscles = [config.muscle("left")]
    (said,) = _bad(judge(config))
    assert said.startswith("sweep of left: feels nothing")
    assert Wiring.laid_out(config).unexplorable is not None


def _localizes(config: RobotConfig, side: str) -> Finding:
    return next(
        finding
        for finding in judge(config)
        if finding.part == f"sweep of {side}" and "localized" in finding.text
    )


def test_a_robot_that_localizes_almost_nowhere_is_told_where_one_more_sensor_cures_it() -> None:
    config = draft(53, 3, 2)
    said = _localizes(config, "left")
    assert said.mark == "warning"
    advice = re.search(r"one more sensor at (\d+) cm would make it (\d+) %", said.text)
    assert advice is not None
    first = config.column("right")[0]
    place = max(float(advice[1]), first.span_cm / 2)
    more = first.model_copy(update={"center_cm": place})
    config.sensors = [*config.column("left"), more, *config.column("right")]
    cured = _localizes(config, "left")
    assert cured.mark == "ok"
    assert f"on {advice[2]} % of the body once calibrated" in cured.text


def test_where_no_sensor_cures_it_the_noise_that_would_is_named() -> None:
    config = draft(30, 3, 1)
    said = _localizes(config, "left")
    assert said.mark == "warning"
    assert "a half of what they are" in said.text
    for sensor in config.board_sensors:
        sensor.noise /= 2
        sensor.zero_se /= 2
    assert _localizes(config, "left").mark == "ok"


def test_what_explore_refuses_is_said_first() -> None:
    for muscles in (3, 4):
        first = judge(draft(53, None, muscles))[0]
        assert (first.part, first.mark) == ("explore", "warning")


def test_where_a_sweep_feels_is_where_the_mechanics_hold_the_base_back() -> None:
    """A peg beside the arc from which contacts are said to be felt moves the base sensor so."""
    config = draft(53, 5, 2)
    config.body.critical_curvature = 1.0  # no fold, of which the base sensor sees a part
    said = next(
        finding.text for finding in judge(config) if finding.text.startswith("feels contacts")
    )
    first = float(said.split()[3])
    base = config.column("right")[0]
    g = config.muscle("left").maps[-1].inflate.curvature(18.0)
    held = []
    for arc in (0.8 * first, 1.2 * first):
        beside = Peg(arc, config.body.radius_cm + 0.55, 0.5)
        rod = Rod(Tube(config.body.diameter_cm, None), [beside])
        mean = np.zeros(1)
        for bend in np.linspace(0.0, g, 40):
            rod.step(float(bend), config.body.length_cm)
        rod.averages_into(np.array([base.center_cm]), np.array([base.span_cm]), mean)
        held.append(g - float(mean[0]))
    assert held[0] < 0.005 < held[1]


def test_what_the_board_cannot_hold_is_refused_with_its_number() -> None:
    config = draft(200, 9, 2)
    (beyond,) = wiring.beyond_board(config)
    assert "18 sensors, and the largest board holds 16" in beyond.problem
    with pytest.raises(ConfigError, match="18 sensors"):
        Wiring.laid_out(config)
    more = RobotConfig()
    last = more.body.pressures[-1]
    more.body.pressures += [last.model_copy(update={"until_cm": 60.0 + n}) for n in range(6)]
    assert "9 body pressures, and the largest board holds 8" in wiring.beyond_board(more)[0].problem
    full = draft(200, 16, 1)
    full.column("right")[0].healthy = False
    assert "without a healthy one at its base" in wiring.beyond_board(full)[0].problem


@pytest.mark.parametrize(
    ("length", "sensors", "muscles", "board"),
    [(53, 5, 2, "mega"), (120, 10, 1, "mega"), (120, 11, 1, "large"), (200, 16, 1, "large")],
)
def test_the_check_names_the_smallest_board_that_holds_the_robot(
    length: float, sensors: int, muscles: int, board: str
) -> None:
    said = next(
        finding for finding in judge(draft(length, sensors, muscles)) if finding.part == "board"
    )
    assert (said.mark, said.text.startswith(board)) == ("ok", True)


@pytest.mark.parametrize(
    ("left", "right"),
    [(5, 5), (9, 0), (0, 10), (7, 3), (1, 9), (3, 0), (8, 8), (16, 0), (0, 11), (2, 14)],
)
def test_every_sensor_has_an_input_and_base_sensors_those_of_the_trigger(
    left: int, right: int
) -> None:
    config = draft(200, 16, 2)
    config.sensors = [*config.column("left")[:left], *config.column("right")[:right]]
    inputs = Wiring.laid_out(config).inputs
    assert len(inputs) == len(set(inputs.values())) == left + right
    half = 5 if left + right <= 10 else 8
    assert Wiring.laid_out(config).base_inputs == tuple(
        first for first, count in ((0, left), (half, right)) if count
    )
    for side, first in zip(SIDES, (0, half), strict=True):
        if config.column(side):
            assert inputs[side, 0] == first
    assert len(config.sensors) == left + right


def test_a_divider_or_a_resistance_that_reads_no_bend_is_named() -> None:
    config = draft(53, 5, 2)
    config.board.divider_ohm = 1.0
    (said,) = _bad(judge(config))
    assert said.startswith("sensor left 0 and 9 more: a count of the converter is 4.9 1/cm")
    assert "divider_ohm = 1:" in said
    config = draft(53, 5, 2)
    config.column("right")[3].zero_ohm = 1e9
    (said,) = _bad(judge(config))
    assert said.startswith("sensor right 3: a count")
    assert "zero_ohm = 1e+09" in said


def test_scales_of_the_wrong_sign_are_warned_of() -> None:
    def warned(config: RobotConfig) -> list[str]:
        return [
            f"{finding.part}: {finding.text}"
            for finding in judge(config)
            if finding.mark == "warning"
        ]

    config = draft(53, 5, 2)
    assert warned(config) == []
    config.column("left")[2].rescale(-1.0)
    (said,) = warned(config)
    assert said.startswith("sensor left 2: its resistance falls in the only bends")
    for sensor in config.column("left"):
        sensor.bend_sign = 0
    (said,) = warned(config)
    assert said.startswith("column left: scales of both signs: those of flex 2 (0 = at the base)")
    config = draft(53, 10, 2, kind="fibre")
    before = warned(config)
    config.gratings[0].rescale(-1.0)
    assert len(warned(config)) == len(before) + 1


@pytest.mark.parametrize("port", ["99999", "0", "12a"])
def test_an_interrogator_at_an_impossible_port_is_refused(tmp_path: Path, port: str) -> None:
    file = tmp_path / "robot.toml"
    file.write_text(f'interrogator = "127.0.0.1:{port}"\n')
    with pytest.raises(ConfigError, match=f"interrogator: the port '{port}' does not exist"):
        RobotConfig.load(file)


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        (
            "amplitude = 0.026",
            "amplitude = -1.0",
            "line {}: muscle.0.map.0.inflate.amplitude must be above 0, not -1.0",
        ),
        ("scale_per_ohm = 3.5e-05", "scale_per_ohm = 0", "line {}: sensor.0.flex.scale_per_ohm: "),
        ("stall_n = ", "stal_n = ", "line {}: spool.stal_n is no entry that is known here"),
    ],
)
def test_an_invalid_entry_is_named_by_its_line(
    tmp_path: Path, before: str, after: str, said: str
) -> None:
    file = tmp_path / "robot.toml"
    draft(30, 3, 1).save(file)
    text = file.read_text().replace(before, after, 1)
    file.write_text(text)
    line = 1 + text[: text.index(after)].count("\n")
    with pytest.raises(ConfigError) as refused:
        RobotConfig.load(file)
    assert f"robot.toml, {said.format(line)}" in str(refused.value)


def test_a_run_whose_robot_is_refused_today_is_told_which_table_to_correct(tmp_path: Path) -> None:
    """Muscles named by the other side were accepted, and so were columns listed tip first."""
    file = tmp_path / "robot.toml"
    draft(30, 3, 1).save(file)
    text = file.read_text()
    swapped = text.replace("angle_deg = 90.0", "angle_deg = 270.0", 1)
    lines = text.splitlines()
    muscle, sensors = lines.index("[[muscle]]"), [n for n, t in enumerate(lines) if "[[sens" in t]
    reordered = text.replace("center_cm = 13.5", "center_cm = 4.0", 1)
    for changed, number in ((swapped, muscle), (reordered, sensors[1])):
        file.write_text(changed)
        with pytest.raises(ConfigError, match=rf"robot\.toml, line {number + 1}: "):
            RobotConfig.load(file)


def test_a_new_robot_leaves_no_scene_of_the_one_before(tmp_path: Path, thigmo: Thigmo) -> None:
    folder = tmp_path / "robot"
    thigmo("robot", "new", "--sensors", 10, "--kind", "fibre", "--out", folder)
    assert {"scene.toml", "empty.toml", "grown.toml"} <= {file.name for file in folder.iterdir()}
    ran = thigmo("robot", "new", "--length", 200, "--sensors", 9, "--out", folder)
    assert "no scene: 18 sensors, and the largest board holds 16" in ran.out
    assert {file.name for file in folder.iterdir()} == {"robot.toml", "robot.toml.1.bak"}


def test_the_commands_write_and_check(tmp_path: Path, thigmo: Thigmo) -> None:
    folder = tmp_path / "long"
    thigmo("robot", "new", "--length", "120", "--sensors", "8", "--muscles", "1", "--out", folder)
    scene = json.loads(thigmo("scene", "check", folder / "scene.toml", "--json").out)
    assert scene["robot"]["body"]["length_cm"] == 120
    empty = json.loads(thigmo("scene", "check", folder / "empty.toml", "--json").out)
    assert (empty["robot"], empty["pegs"]) == (scene["robot"], [])
    report = json.loads(thigmo("robot", "check", folder / "robot.toml", "--json").out)
    assert {
        finding["mark"] for finding in report["findings"] if finding["part"] in ("board", "rates")
    } == {"ok"}
    shown = thigmo("robot", "check", folder / "robot.toml").out.splitlines()
    assert max(map(len, shown)) <= 80
    assert {line[:8].strip() for line in shown} <= {"ok", "warning", "bad", ""}


@pytest.mark.parametrize(("muscles", "unguarded"), [(3, []), (4, ["180deg", "0deg"])])
def test_a_robot_of_more_than_two_muscles_has_a_column_opposite_each(
    muscles: int, unguarded: list[str]
) -> None:
    config = draft(53, None, muscles)
    assert len(config.board_sensors) == 16
    for muscle in config.muscles:
        column = [w for w in Wiring.laid_out(config).sensors_reading(muscle) if abs(w.share) > 0.99]
        assert len(column) == (5 if muscles == 3 else 4)
        assert all(sensor.sound for sensor in column)
    assert [muscle.name for muscle in Wiring.laid_out(config).unguarded_muscles] == unguarded
    said = judge(config)
    assert _bad(said) == []
    warned = [sensor.part for sensor in said if "no base sensor on the board" in sensor.text]
    assert warned == [f"muscle {name}" for name in unguarded]
    halved = [sensor.part for sensor in said if "reads 50 % of them" in sensor.text]
    assert halved == ([] if unguarded else ["muscle 210deg", "muscle 330deg"])


@pytest.mark.parametrize(("kind", "columns"), [("flex", 2), ("heading", 1), ("fibre", 0)])
def test_a_robot_without_muscles_has_sensors_to_feel_with(kind: str, columns: int) -> None:
    config = draft(53, 5, 0, kind=kind)
    assert len({sensor.angle_deg for sensor in config.board_sensors}) == columns
    assert len(config.gratings) == (10 if kind == "fibre" else 0)
    findings = {finding.part: finding for finding in judge(config)}
    assert _bad(judge(config)) == []
    assert "no muscles" in findings["explore"].text
    assert findings["feel"].mark == "ok"


def test_a_draft_names_the_kinds_of_sensors_that_it_has() -> None:
    with pytest.raises(ConfigError, match="no sensors of kind 'felx'; use flex, heading, fibre"):
        draft(53, 5, 2, kind="felx")


@pytest.mark.parametrize("kind", ["heading", "fibre"])
def test_more_than_two_muscles_take_flex_sensors(kind: str) -> None:
    with pytest.raises(ConfigError, match=f"3 muscles with sensors of kind {kind}: "):
        draft(53, 5, 3, kind=kind)


@pytest.mark.parametrize(
    ("muscles", "why"),
    [(4, "muscle 180deg (180 degrees)"), (0, "the robot has no muscles, so it cannot sweep")],
)
def test_a_new_robot_that_does_not_explore_is_told_what_works(
    thigmo: Thigmo, tmp_path: Path, muscles: int, why: str
) -> None:
    folder = tmp_path / "around"
    ran = thigmo("robot", "new", "--muscles", muscles, "--out", folder)
    assert ran.code == 0, ran.err
    assert sorted(path.name for path in folder.iterdir()) == ["empty.toml", "robot.toml"]
    assert "thigmo explore --scene" not in ran.out
    assert f"explore does not work with it: {why}" in ran.out
    assert f"thigmo calibrate all --robot emulator://{folder / 'empty.toml'}" in ran.out


def test_a_new_robot_with_a_fibre_and_no_muscles_is_told_the_step_that_exists_for_it(
    thigmo: Thigmo, tmp_path: Path
) -> None:
    ran = thigmo("robot", "new", "--muscles", 0, "--kind", "fibre", "--out", tmp_path / "rod")
    assert ran.code == 0, ran.err
    assert "calibrate it: thigmo calibrate fibre --csv FILE" in ran.out
    assert "calibrate all" not in ran.out
