"""The command line: fast help, JSON for programs, one clear line for every bad input."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from command import Thigmo, run_python
from typer.main import get_command

from thigmo import localize as thigmo_localize
from thigmo.cli.main import app
from thigmo.config import RobotConfig
from thigmo.link import protocol as wire

BENT = "position,curvature\n5,0.021\n15,0.0223\n25,0.0244\n35,0.0268\n45,0.0285\n"
GOOD = "position,curvature\n5,0.0104\n15,0.0083\n25,0.006\n35,0.0041\n45,0.0017\n"


def test_help_imports_nothing_heavy() -> None:
    script = (
        "import sys; import thigmo.cli.main; "
        "print([m for m in ('numpy', 'matplotlib', 'pydantic', 'serial', 'rich.table') "
        "if m in sys.modules])"
    )
    assert run_python(script).out.strip() == "[]"


def test_localize_prints_one_object(tmp_path: Path, thigmo: Thigmo) -> None:
    (tmp_path / "r.csv").write_text(GOOD)
    ran = thigmo("localize", tmp_path / "r.csv", "--length", 53, "--span", 5.5, "--json")
    assert ran.code == 0
    result = json.loads(ran.out)
    assert result["status"] == "localized"
    (contact,) = result["contacts"]
    assert contact["interval"][0] <= contact["arc"] <= contact["interval"][1] <= 53
    assert contact["arc"] == pytest.approx(52.5, abs=1.5)
    assert contact["force"] == pytest.approx(2.2e-4, rel=0.1)
    shown = thigmo("localize", tmp_path / "r.csv", "--length", 53, "--span", 5.5)
    assert "localized" in shown.out


def test_the_free_curvature_is_taken_off(tmp_path: Path, thigmo: Thigmo) -> None:
    rows = "".join(f"{x},{0.03 + x * 1e-6}\n" for x in (5, 15, 25, 35, 45))
    (tmp_path / "r.csv").write_text("position,curvature\n" + rows)
    ran = thigmo(
        "localize", tmp_path / "r.csv", "--length", 53, "--span", 5.5,
        "--free-curvature", 0.03, "--noise", 6e-4, "--json",
    )  # fmt: skip
    assert json.loads(ran.out) | {"contacts": [], "status": "no contact"} == json.loads(ran.out)


def test_every_error_can_be_told_by_a_flag_and_widens_the_answer(
    tmp_path: Path, thigmo: Thigmo
) -> None:
    (tmp_path / "r.csv").write_text(BENT)
    stated = ["localize", tmp_path / "r.csv", "--length", 53, "--span", 5.5, "--json"]
    stated += ["--free-curvature", 0.03, "--noise", 6e-4]

    def width(*flags: object) -> float:
        result = json.loads(thigmo(*stated, *flags).out)
        low, high = result["contacts"][-1]["interval"]
        return float(high - low)

    sharp = width()
    for flags in (
        ("--gain-error", 0.1),
        ("--offset-error", 2e-3),
        ("--map-error", 0.1),
        ("--noise", 2e-3),
    ):
        assert width(*flags) > 1.1 * sharp, flags


def test_a_robot_toml_tells_the_errors_of_the_sensors_in_the_file(
    tmp_path: Path, thigmo: Thigmo
) -> None:
    robot = RobotConfig()
    robot.body.critical_curvature_se = 0.1 * robot.body.critical_curvature
    robot.muscle("left").offset_se = 2e-4
    robot.muscle("left").maps[2].scale_se = 0.01
    for sensor in robot.column("right"):
        sensor.scale_se = 0.03
    robot.save(tmp_path / "robot.toml")
    (tmp_path / "r.csv").write_text(BENT)
    stated = ["localize", tmp_path / "r.csv", "--length", 53, "--span", 5.5, "--json"]
    stated += ["--free-curvature", 0.03]
    known = json.loads(thigmo(*stated, "--config", tmp_path / "robot.toml", "--side", "left").out)
    spelt = thigmo_localize(
        [0.021, 0.0223, 0.0244, 0.0268, 0.0285], [5.0, 15.0, 25.0, 35.0, 45.0], length=53.0,
        span=5.5, free_curvature=0.03, noise=6e-4, gain_error=0.03, offset_error=2e-4,
        map_error=0.01, critical_curvature=0.01108, tube_radius=1.75, base_fold_error=0.0,
        noise_correlation=0.0, largest_noise_factor=2.4, contact_couple_odds=0.0,
    ).to_dict()  # fmt: skip
    assert known["status"] != "no contact"
    assert known["contacts"][0]["interval"] == pytest.approx(spelt["contacts"][0]["interval"])
    assert known["noise"] == pytest.approx(6e-4)
    sure = json.loads(
        thigmo(*stated, "--config", tmp_path / "robot.toml", "--side", "left", "--noise", 1e-4).out
    )
    assert sure["noise"] == pytest.approx(1e-4)
    wrong = thigmo(*stated, "--config", tmp_path / "robot.toml", "--side", "up")
    assert "the robot has no muscle up; use left (90) or right (270)" in wrong.err
    robot.muscles[0].name = "port"
    robot.save(tmp_path / "named.toml")
    named = json.loads(thigmo(*stated, "--config", tmp_path / "named.toml", "--muscle", "port").out)
    assert named["contacts"] == known["contacts"]
    (tmp_path / "r.csv").write_text(BENT.replace("25,", "28,"))
    off = thigmo(*stated, "--config", tmp_path / "robot.toml", "--side", "left")
    assert "no sensor for the reading at 28 cm" in off.err


def test_a_discarded_reading_is_named_with_its_line(tmp_path: Path, thigmo: Thigmo) -> None:
    rows = [(x, 2.2e-4 * (50 - x) * (x < 50)) for x in range(2, 50, 4)]
    rows[5] = (rows[5][0], -0.05)
    (tmp_path / "r.csv").write_text("position,curvature\n" + "".join(f"{x},{k}\n" for x, k in rows))
    stated = ["localize", tmp_path / "r.csv", "--length", 53, "--noise", 2e-4]
    result = json.loads(thigmo(*stated, "--json").out)
    assert result["discarded"] == [{"line": 7, "position": 22.0}]
    assert result["hypotheses"][result["hypothesis"]] > 0.5
    assert 0.9 < result["contacts"][0]["probability"] <= 1.0
    shown = thigmo(*stated).out
    assert "taken for bad: line 7" in shown
    assert result["hypothesis"] in shown


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("position,curvature\n5,nan\n", "no reading is finite"),
        (GOOD.replace("45,", "55,"), "centred at 55, off a body of 53"),
        (GOOD.replace("45,", "150,"), "off a body of 53; check positions and units"),
        ("position,curvature,span\n5,0.01,-1\n", "span"),
        (GOOD.replace("5,", "50,"), "looks like mm where the length is in cm"),
        (re.sub(r"(?m)^(\d+),", r"0.0\1,", GOOD), "look mixed"),
        (
            re.sub(r",0\.0", ",1.0", GOOD),
            "tighter than the tube itself can bend; it looks like 1/m",
        ),
        (re.sub(r",0\..*", ",0.01", GOOD), "all readings are 0.01"),
        (re.sub(r"(?m)^\d+,", "5,", GOOD), "all positions are 5"),
    ],
)
def test_a_bad_csv_is_one_line_and_status_1(
    tmp_path: Path, thigmo: Thigmo, text: str, named: str
) -> None:
    (tmp_path / "r.csv").write_text(text)
    ran = thigmo("localize", tmp_path / "r.csv", "--length", 53, "--json")
    assert ran.code == 1
    assert ran.out == ""
    assert named in ran.err
    assert len(ran.err.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["localize", "none.csv", "--length", "53"], "cannot read none.csv"),
        (["localize", "r.csv", "--length", "-1"], "--length is -1"),
        (["localize", "r.csv", "--length", "nan"], "--length is nan"),
        (["localize", "r.csv", "--length", "53", "--method", "magic"], "unknown method 'magic'"),
        (["localize", "r.csv", "--length", "53", "--contacts", "many"], "--contacts is 'many'"),
        (["localize", "r.csv", "--length", "53", "--span", "-2"], "span"),
        (["localize", "r.csv", "--length", "53", "--noise", "-1"], "noise"),
        (["localize", "r.csv", "--length", "53", "--gain-error", "-1"], "gain_error"),
        (["localize", "r.csv", "--length", "53", "--offset-error", "nan"], "offset_error"),
        (["localize", "r.csv", "--length", "53", "--map-error", "-1"], "map_error"),
        (["localize", "r.csv", "--length", "53", "--tube-radius", "-1"], "tube_radius"),
        (["localize", "r.csv", "--length", "53", "--config", "none.toml"], "none.toml"),
        (["explore", "--robot", "/dev/no-such-port"], "/dev/no-such-port"),
        (["explore", "--robot", "nonsense://x"], "nonsense"),
        (["localize", "r.csv", "--length", "53", "--muscle", "left"], "give --config robot.toml"),
        (["explore", "--robot", "a", "--scene", "b"], "both given"),
        (["explore", "--config", "none.toml"], "cannot read none.toml"),
        (["explore", "--config", "bad.toml"], "bad.toml is a scene, not a robot"),
        (["robot", "check", "bad.toml"], "check it with `thigmo scene check`"),
        (["explore", "--config", "empty"], "empty"),
        (["explore", "--scene", "./empty"], "empty"),
        (["explore", "--scene", "noise.toml"], "noise.toml"),
        (["explore", "--scene", "empty", "--out", "r.csv"], "--out"),
        (["explore", "--scene", "empty", "--out", "r.csv/runs"], "--out"),
        (["explore", "--scene", "empty", "--map", "no-such-run"], "ROS map"),
        (["explore", "--scene", "empty", "--map", "bad.yaml"], "ROS map"),
        (["explore", "--scene", "empty", "--map", "."], "ROS map"),
        (["emulate", "bad.toml"], "pegs.0.radius"),
        (["localize", "empty", "--length", "53"], "empty"),
        (["localize", "noise.toml", "--length", "53"], "noise.toml"),
        (["explore", "--scene", "no-such-scene"], "no-such-scene"),
        (["explore", "--scene", "none.toml"], "none.toml"),
        (["explore", "--scene", "bad.toml"], "bad.toml"),
        (["scene", "check", "bad.toml"], "pegs.0.radius"),
        (["info", "--robot", "/dev/no-such-port"], "/dev/no-such-port"),
        (["info", "empty"], "run.mcap"),
        (["replay", "empty"], "give a run folder"),
        (["replay", "no-such-folder"], "no-such-folder"),
        (["params", "--robot", "emulator://default", "no_such_parameter"], "no_such_parameter"),
        (["retract", "--robot", "/dev/no-such-port"], "/dev/no-such-port"),
        (["emulate", "no-such-scene"], "no-such-scene"),
        (["info"], "give a run folder, or --robot URL"),
        (["info", "no-such-folder"], "no-such-folder"),
        (["watch", "--no-browser", "--foxglove", "empty"], "run.mcap in Foxglove"),
        (["watch", "runs/none"], "no such run folder or port: runs/none; check its path"),
        (["watch", "none"], "no such run folder or port: none; check its path"),
        (["ros", "runs/none"], "no such run folder or port: runs/none; check its path"),
        (["ros", "none"], "no such run folder or port: none; check its path"),
        (["ros", "--namespace", "my robot"], "not a ROS namespace"),
        (["stop"], "no program of yours drives a robot"),
        (["stop", "--robot", "/dev/no-such-port"], "/dev/no-such-port"),
        (["clear", "--robot", "/dev/no-such-port"], "/dev/no-such-port"),
        (["flash", "--robot", "/dev/no-such-port", "--image", "r.csv"], "r.csv"),
        (["flash", "--robot", "emulator://default"], "cannot be flashed"),
        (["calibrate", "magic"], "no step 'magic'"),
        (["calibrate", "magic", "--csv", "r.csv"], "no step 'magic'"),
        (["calibrate", "status"], "calibration is not a calibration folder"),
        (["calibrate", "status", "--folder", "empty"], "empty is not a calibration folder"),
        (["calibrate", "flex"], "no robot is named"),
        (["calibrate", "flex", "--csv", "none.csv"], "none.csv"),
        (["calibrate", "flex", "--csv", "r.csv"], "no column"),
        (["calibrate", "encoder", "--csv", "r.csv"], "columns of encoder: counts, length_cm"),
        (["bench", "magic"], "no study 'magic'"),
        (["bench", "faults", "--scale", "huge"], "--scale is 'huge'"),
        (["camera", "locate", "none.png"], "none.png"),
        (["camera", "check", "none.png"], "none"),
        (["experiment", "magic"], "no experiment 'magic'"),
        (["experiment", "single-contact", "--trials", "0"], "--trials"),
        (["experiment", "actuated", "--rehearse"], "need a robot"),
        (["experiment", "actuated", "--robot", "/dev/no-such-port"], "/dev/no-such-port"),
        (
            ["experiment", "sensitivity", "--robot", "emulator://default"],
            "cannot be done with a robot",
        ),
        (["experiment", "single-contact", "--recorded", "empty"], "robot.toml"),
    ],
)
def test_every_bad_argument_is_one_clear_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    thigmo: Thigmo,
    arguments: list[str],
    named: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "r.csv").write_text(GOOD)
    (tmp_path / "bad.toml").write_text("[[pegs]]\nx = 1\ny = 20\nradius = -1\n")
    (tmp_path / "bad.yaml").write_text("resolution: fine")
    (tmp_path / "noise.toml").write_bytes(b"\xff\xfe\x00")
    (tmp_path / "empty").mkdir()
    ran = thigmo(*arguments)
    assert ran.code == 1
    line = ran.err.strip()
    assert named in line
    assert re.fullmatch(r"thigmo: [^\n]+; [^\n]+", line)  # what happened; what to do
    left = {path.name for path in tmp_path.rglob("*")}
    assert left == {"r.csv", "bad.toml", "bad.yaml", "noise.toml", "empty"}  # nothing is begun


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["explore", "--seed", "many"], r"'--seed': .*`thigmo explore --help`"),
        (["explore", "--sead", "1"], r"No such option: --sead .*--seed"),
        (["explor"], r"No such command 'explor'.*'explore'.*`thigmo --help`"),
        (["localize"], r"Missing argument .*`thigmo localize --help`"),
        (["localize", "r.csv"], r"Missing option '--length'"),
        (["localize", "--length"], r"requires an argument; see `thigmo localize --help`"),
        (["params"], r"Missing option '--robot'"),
        (["watch", ""], r"Invalid value for .*: it is empty"),
        (["ros", ""], r"Invalid value for .*: it is empty"),
        (["retract", "--robot", "emulator://empty", "--to", "-1"], "'--to': .* or equal to 0"),
        (["camera", "lok"], r"No such command 'lok'.*`thigmo camera --help`"),
        (["info", "a", "b"], r"unexpected extra argument.*b"),
        (["watch", "--port", "99999"], r"'--port': "),
    ],
)
def test_every_wrong_usage_is_one_line_and_status_2(
    thigmo: Thigmo, arguments: list[str], named: str
) -> None:
    ran = thigmo(*arguments)
    assert (ran.code, ran.out) == (2, "")
    assert re.fullmatch(r"thigmo: [^\n]+; see `thigmo[^\n]*--help`", ran.err.strip()), ran.err
    assert re.search(named, ran.err), ran.err


def test_no_command_takes_an_empty_name_for_a_robot(thigmo: Thigmo) -> None:
    commands: dict[str, Any] = get_command(app).commands  # type: ignore[attr-defined]
    named = [
        name for name, command in commands.items() if "robot" in {p.name for p in command.params}
    ]
    assert {"explore", "calibrate", "experiment", "stop", "info"} <= set(named)
    for name in named:
        ran = thigmo(name, "--robot", "")
        said = f"thigmo: Invalid value for '--robot': it is empty; see `thigmo {name} --help`\n"
        assert (ran.code, ran.out, ran.err) == (2, "", said)


def test_parameters_have_their_whole_names_in_80_columns(thigmo: Thigmo) -> None:
    lines = thigmo("params", "--robot", "emulator://default").out.splitlines()
    assert max(map(len, lines)) <= 80
    first = {line.split()[0] for line in lines if line.strip()}
    assert set(wire.PARAMETERS) <= first


@pytest.mark.parametrize(
    "arguments",
    [
        ["info", "--robot", "emulator://default"],
        ["localize", "example", "--length", "53", "--span", "5.5"],
        ["bench", "list"],
        ["params", "--robot", "emulator://default", "settle_ms"],
    ],
    ids=lambda arguments: arguments[0],
)
def test_tables_fit_80_columns_with_whole_words(thigmo: Thigmo, arguments: list[str]) -> None:
    ran = thigmo(*arguments)
    assert ran.code == 0
    assert max(map(len, ran.out.splitlines())) <= 80
    assert "…" not in ran.out


def test_the_version_is_said(thigmo: Thigmo) -> None:
    assert re.fullmatch(r"thigmo \d+\.\d+\.\d+\s*", thigmo("--version").out)


def test_frames_in_rows_get_an_answer_each(tmp_path: Path, thigmo: Thigmo) -> None:
    frames = tmp_path / "frames.csv"
    frames.write_text(
        "t_s;k0;k1;k2;k3;k4\n0;0;0;0;0;0,0001\n1;0,0107;0,0073;0,0043;0,0012;0\n2;;;nan;;\n"
    )
    columns = "k0=5,k1=15,k2=25,k3=35,k4=45"
    call = ["localize", str(frames), "--length", "53", "--span", "5.5", "--noise", "0.0006"]
    ran = thigmo(*call, "--columns", columns, "--plot", str(tmp_path / "arcs.png"))
    assert ran.code == 0, ran.err
    head, free, touched, unread = ran.out.splitlines()
    assert head == "line,t_s,status,contacts,arc,low,high,force,probability"
    assert free == "2,0,no contact,0,,,,,"
    assert touched.startswith("3,1,")
    assert float(touched.split(",")[4]) == pytest.approx(38.0, abs=3.0)
    assert unread == "4,2,no reading,0,,,,,"
    assert (tmp_path / "arcs.png").stat().st_size > 5000
    answers = json.loads(thigmo(*call, "--columns", columns, "--json").out)
    assert [answer["line"] for answer in answers] == [2, 3, 4]
    assert (answers[2]["status"], answers[2]["contacts"]) == ("no reading", [])
    assert "NAME=POSITION" in thigmo(*call, "--columns", "k0").err


def test_columns_with_angles_are_localized_in_space(tmp_path: Path, thigmo: Thigmo) -> None:
    arcs = (10, 20, 30, 40, 50)
    bends = [(2e-4 * max(45 - arc, 0), -1e-4 * max(45 - arc, 0)) for arc in arcs]
    table, frames = tmp_path / "fibre.csv", tmp_path / "frames.csv"
    rows = [f"{a},{k},{d}" for a, both in zip(arcs, bends, strict=True)
            for k, d in zip(both, (0, 90), strict=True)]  # fmt: skip
    table.write_text("position,curvature,angle_deg\n" + "\n".join(rows) + "\n")
    stated = ["--length", "53", "--noise", "0.0003", "--twist", "1.3", "--held-end", "no"]
    answer = json.loads(thigmo("localize", table, *stated, "--json").out)
    _, toward_0, toward_90 = answer["contacts"][0]["vector"]
    assert abs(answer["contacts"][0]["arc"] - 45) < 2
    assert toward_0 == pytest.approx(2e-4, rel=0.2)
    assert toward_90 == pytest.approx(-1e-4, rel=0.2)
    assert "vector" in thigmo("localize", table, *stated).out
    names = [f"k{n}" for n in range(10)]
    frames.write_text(",".join(names) + "\n" + ",".join(str(k) for b in bends for k in b) + "\n")
    places = [f"{n}={a}@{d}" for n, (a, d) in zip(
        names, ((a, d) for a in arcs for d in (0, 90)), strict=True)]  # fmt: skip
    row = thigmo("localize", frames, *stated, "--columns", ",".join(places))
    assert float(row.out.splitlines()[1].split(",")[4]) == pytest.approx(
        answer["contacts"][0]["arc"], rel=1e-5
    )
    partial = thigmo("localize", frames, *stated, "--columns", "k0=10@0,k1=10")
    assert "DEGREES" in partial.err
    heavy = thigmo("localize", table, *stated, "--weight", "0,1")
    assert "three numbers" in heavy.err


def test_a_held_end_and_the_stiffness_are_flags(tmp_path: Path, thigmo: Thigmo) -> None:
    stated = ["localize", "example", "--length", 53, "--span", 5.5, "--noise", 6e-4]
    plain = json.loads(thigmo(*stated, "--json").out)
    assert plain["contacts"][0]["newtons"] is None
    known = json.loads(thigmo(*stated, "--stiffness", "400,0.1", "--json").out)
    low, high = known["contacts"][0]["newtons"]["across"]["interval"]
    assert low < 400 * plain["contacts"][0]["force"] < high
    assert " N " in thigmo(*stated, "--stiffness", "400,0.1").out
    held = json.loads(thigmo(*stated, "--held-end", "yes", "--json").out)
    free = json.loads(thigmo(*stated, "--held-end", "no", "--end-face-odds", 0, "--json").out)
    assert not any("end wrench" in name for name in free["hypotheses"])
    assert any("end wrench" in name for name in held["hypotheses"])
    assert "--held-end is 'maybe'" in thigmo(*stated, "--held-end", "maybe").err
    assert "--stiffness is 'EI'" in thigmo(*stated, "--stiffness", "EI").err
    (tmp_path / "rows.csv").write_text("k0,k1,k2\n0.0107,0.0073,0.0043\n")
    rows = thigmo(
        "localize", tmp_path / "rows.csv", "--length", 53, "--columns", "k0=5,k1=15,k2=25",
        "--noise", 6e-4, "--stiffness", "400,0.1",
    ).out.splitlines()  # fmt: skip
    assert rows[0].endswith(",newtons,newtons_low,newtons_high")
    assert len(rows[1].split(",")) == len(rows[0].split(","))
