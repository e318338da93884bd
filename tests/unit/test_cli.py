"""The command line: fast help, JSON for programs, one clear line for every bad input."""

from __future__ import annotations

import json
import re
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from thigmo.cli.main import main

GOOD = "position,curvature\n5,0.0104\n15,0.0083\n25,0.006\n35,0.0041\n45,0.0017\n"


class Ran:
    """What a command printed, and how it ended."""

    def __init__(self, code: int, out: str, err: str) -> None:
        self.code, self.out, self.err = code, out, err


@pytest.fixture
def thigmo(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):  # type: ignore[no-untyped-def]
    def run(*arguments: str | Path) -> Ran:
        monkeypatch.setattr(sys, "argv", ["thigmo", *map(str, arguments)])
        code = 0
        try:
            main()
        except SystemExit as ended:
            code = int(ended.code or 0)
        captured = capsys.readouterr()
        return Ran(code, captured.out, captured.err)

    return run


def test_help_answers_in_half_a_second() -> None:
    # Processor time: what it takes on a machine that does nothing else.
    times = []
    for _ in range(2):  # the first may compile bytecode
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [sys.executable, "-m", "thigmo", "--help"]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        times.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    assert "explore" in done.stdout
    print(f"{min(times):.2f} s")
    assert min(times) < 0.5


def test_help_imports_nothing_heavy() -> None:
    script = (
        "import sys; import thigmo.cli.main; "
        "print([m for m in ('numpy', 'numba', 'matplotlib', 'pydantic', 'serial', 'rich.table') "
        "if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_localize_prints_one_object(tmp_path: Path, thigmo) -> None:  # type: ignore[no-untyped-def]
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


def test_the_free_curvature_is_taken_off(tmp_path: Path, thigmo) -> None:  # type: ignore[no-untyped-def]
    rows = "".join(f"{x},0.03\n" for x in (5, 15, 25, 35, 45))
    (tmp_path / "r.csv").write_text("position,curvature\n" + rows)
    ran = thigmo(
        "localize", tmp_path / "r.csv", "--length", 53, "--span", 5.5,
        "--free-curvature", 0.03, "--noise", 6e-4, "--json",
    )  # fmt: skip
    assert json.loads(ran.out) | {"contacts": [], "status": "no contact"} == json.loads(ran.out)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("position,curvature\n5,nan\n", "line 2: curvature is nan"),
        ("position,bend\n5,1\n", "no column `curvature`"),
        (GOOD.replace("45,", "55,"), "line 6: a sensor at 55 lies outside 0..53"),
        ("", "is empty"),
    ],
)
def test_a_bad_csv_is_one_line_and_status_1(  # type: ignore[no-untyped-def]
    tmp_path: Path, thigmo, text: str, named: str
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
        (["explore", "--robot", "/dev/no-such-port"], "/dev/no-such-port"),
        (["explore", "--robot", "nonsense://x"], "nonsense"),
        (["explore", "--robot", "a", "--scene", "b"], "both given"),
        (["explore", "--config", "none.toml"], "cannot read none.toml"),
        (["explore", "--scene", "no-such-scene"], "no-such-scene"),
        (["explore", "--scene", "none.toml"], "none.toml"),
        (["explore", "--scene", "bad.toml"], "bad.toml"),
        (["scene", "check", "bad.toml"], "pegs.0.radius"),
        (["info", "/dev/no-such-port"], "/dev/no-such-port"),
        (["info", "empty"], "run.mcap"),
        (["replay", "empty"], "robot.toml"),
        (["replay", "no-such-folder"], "no-such-folder"),
        (["params", "emulator://default", "no_such_parameter"], "no_such_parameter"),
        (["retract", "--robot", "/dev/no-such-port"], "/dev/no-such-port"),
        (["emulate", "no-such-scene"], "no-such-scene"),
        (["experiment", "magic"], "no experiment 'magic'"),
        (["experiment", "single-contact", "--trials", "0"], "--trials"),
        (["experiment", "actuated", "--rehearse"], "need a robot"),
        (["experiment", "actuated", "--robot", "/dev/no-such-port"], "/dev/no-such-port"),
        (
            ["experiment", "sensitivity", "--robot", "emulator://default"],
            "is not taken with a robot",
        ),
        (["experiment", "single-contact", "--recorded", "empty"], "robot.toml"),
    ],
)
def test_every_bad_argument_is_one_clear_line(  # type: ignore[no-untyped-def]
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, thigmo, arguments: list[str], named: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "r.csv").write_text(GOOD)
    (tmp_path / "bad.toml").write_text("[[pegs]]\nx = 1\ny = 20\nradius = -1\n")
    (tmp_path / "empty").mkdir()
    ran = thigmo(*arguments)
    assert ran.code == 1
    line = ran.err.strip()
    assert named in line
    assert re.fullmatch(r"thigmo: [^\n]+; [^\n]+", line)  # what happened; what to do
    assert not (tmp_path / "runs").exists()


def test_the_version_is_said(thigmo) -> None:  # type: ignore[no-untyped-def]
    assert re.fullmatch(r"thigmo \d+\.\d+\.\d+\s*", thigmo("--version").out)
