"""The thesis's trials with a robot: taken on the emulator, kept through every end, evaluated again.

Prompts are answered through a pseudo-terminal, as an operator does.
"""

from __future__ import annotations

import json
import os
import pty
import select
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from thigmo.errors import DataError
from thigmo.record.log import read_log
from thigmo.robot import Robot, connect
from thigmo_bench.experiments.evaluate import evaluate
from thigmo_bench.experiments.recorded import run_trials, trials
from thigmo_bench.experiments.session import Attendant, Folder, Verdict
from thigmo_bench.experiments.trial import plan

pytestmark = pytest.mark.ci

_PATIENCE_S = 100.0  # of a test, with a command that compiles


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The default robot, fully out, its sensors rested: growth is tested elsewhere."""
    path = tmp_path_factory.mktemp("scene") / "out.toml"
    path.write_text('extends = "default"\nstart_length_cm = 53.0\npegs = []\n')
    return f"emulator://{path}"


class Stops(Attendant):
    """Answers with the given verdicts, then stops."""

    def __init__(self, robot: Robot, *verdicts: Verdict) -> None:
        super().__init__(robot=robot)
        self.verdicts = list(verdicts)

    def verdict(self, summary: str) -> Verdict:
        return self.verdicts.pop(0) if self.verdicts else "quit"


def taken(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "trials.jsonl").read_text().splitlines()]


def take_all(scene: str, path: Path, experiment: str) -> Folder:
    """A folder with every planned trial."""
    with connect(scene, seed=1) as robot:
        assert robot.known_config is not None
        folder = Folder(path, robot.known_config)
        assert run_trials(robot, Attendant(robot=robot), folder, experiment, 1)
        assert robot.status().pressure_psi[0] < 0.5
    return folder


@pytest.fixture(scope="module")
def single_contact(scene: str, tmp_path_factory: pytest.TempPathFactory) -> Folder:
    """The trials of one contact."""
    return take_all(scene, tmp_path_factory.mktemp("single"), "single-contact")


def as_planned(experiment: str, folder: Folder) -> dict[str, Any]:
    """The evaluated rows of trials that were taken where they were planned, by condition."""
    planned = plan(experiment, 1)
    rows = taken(folder.path)
    assert [row["key"] for row in rows] == [trial.key for trial in planned]
    for trial, row in zip(planned, rows, strict=True):
        assert row["true_arcs_cm"] == pytest.approx(trial.arcs_cm, abs=1.6)
        assert np.sign(row["true_forces"][-1]) <= 0  # the first of each is on the left side
    notes = read_log(folder.path / "run-1.mcap").notes
    assert [note.facts["key"] for note in notes] == [trial.key for trial in planned]
    evaluated = evaluate(experiment, trials(Folder(folder.path))).record()["rows"]
    assert all(row["trials"] in (len(planned) / 2, 4, 2) for row in evaluated)
    return {row["condition"]: row for row in evaluated}


def test_trials_of_one_contact_are_taken_where_they_were_planned_and_evaluated(
    single_contact: Folder,
) -> None:
    errors = as_planned("single-contact", single_contact)
    assert errors["high force"]["ours_workspace_mean"] < 3.0


@pytest.mark.ci
def test_trials_of_two_contacts_and_of_the_actuated_robot(scene: str, tmp_path: Path) -> None:
    two = as_planned("two-contacts", take_all(scene, tmp_path / "two", "two-contacts"))
    assert two["closer than 23.5 cm"]["ours_workspace_mean"] < 3.0
    actuated = as_planned("actuated", take_all(scene, tmp_path / "actuated", "actuated"))
    for row in actuated.values():
        assert row["ours_workspace_mean"] < 5.0


def test_a_lab_without_the_truth_gets_the_same_table(
    single_contact: Folder, tmp_path: Path
) -> None:
    shutil.copytree(single_contact.path, tmp_path / "blind")
    folder = Folder(tmp_path / "blind")
    hidden: dict[str, list[float]] = {
        "true_arcs_cm": [],
        "true_forces": [],
        "true_contact_x_cm": [],
    }
    lines = [json.dumps(row | hidden) for row in taken(folder.path)]
    (folder.path / "trials.jsonl").write_text("\n".join(lines) + "\n")
    known, blind = (
        evaluate("single-contact", trials(source)).record()["rows"]
        for source in (single_contact, folder)
    )
    for with_truth, without in zip(known, blind, strict=True):
        assert without["ours_mean"] == pytest.approx(with_truth["ours_mean"])
        # The dowel's place instead of the contact point's.
        known_x = with_truth["ours_workspace_mean"]
        assert without["ours_workspace_mean"] == pytest.approx(known_x, abs=0.3)
        assert np.isfinite(without["allowed"])


def test_a_stopped_experiment_goes_on_and_skipped_trials_are_no_trials(
    scene: str, tmp_path: Path
) -> None:
    with connect(scene, seed=1) as robot:
        assert robot.known_config is not None
        folder = Folder(tmp_path / "one", robot.known_config)
        attendant = Stops(robot, "keep", "redo", "skip")
        assert not run_trials(robot, attendant, folder, "single-contact", 1)
    assert [row["state"] for row in taken(folder.path)] == ["kept", "skipped"]
    assert len(trials(folder)) == 1
    with connect(scene, seed=2) as robot:
        said: list[str] = []
        again = Folder(folder.path, folder.config)
        person = Attendant(robot=robot)
        assert run_trials(robot, person, again, "single-contact", 1, said.append)
    assert said[0] == "single-contact: 2 of 6 trials are there"
    assert [row["state"] for row in taken(folder.path)].count("kept") == 5
    assert len({row["key"] for row in taken(folder.path)}) == 6
    assert (folder.path / "run-2.mcap").exists()


def test_another_robot_may_not_add_to_a_folder(single_contact: Folder) -> None:
    changed = single_contact.config.model_copy(deep=True)
    changed.body.critical_curvature = 0.02
    with pytest.raises(DataError, match="another robot"):
        Folder(single_contact.path, changed)


def test_a_line_that_lacks_a_reading_is_named(single_contact: Folder, tmp_path: Path) -> None:
    shutil.copytree(single_contact.path, tmp_path / "torn")
    (row, *_) = taken(single_contact.path)
    del row["curvature"]
    (tmp_path / "torn" / "trials.jsonl").write_text(json.dumps(row) + "\n")
    with pytest.raises(DataError, match="torn is damaged: KeyError\\('curvature'\\); correct"):
        trials(Folder(tmp_path / "torn"))


class Terminal:
    """A command on a pseudo-terminal: wait for a prompt, then answer it."""

    def __init__(self, *arguments: str) -> None:
        self._master, slave = pty.openpty()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "thigmo", *arguments],
            stdin=slave, stdout=slave, stderr=slave, start_new_session=True,
            preexec_fn=_take_terminal, env={**os.environ, "COLUMNS": "400", "TERM": "dumb"},
        )  # fmt: skip
        os.close(slave)
        self.text = ""
        self._read_to = 0

    def wait_for(self, text: str) -> None:
        """Read until the text comes, after what was waited for before."""
        while (at := self.text.find(text, self._read_to)) < 0:
            if not self._read():
                raise AssertionError(f"ended before {text!r}:\n{self.text[-3000:]}")
        self._read_to = at + len(text)

    def answer(self, text: str, prompt: str) -> None:
        self.wait_for(prompt)
        os.write(self._master, f"{text}\n".encode())

    def interrupt(self, prompt: str) -> None:
        self.wait_for(prompt)
        os.write(self._master, b"\x03")

    def end(self) -> int:
        while self._read():
            pass
        os.close(self._master)
        return self.process.wait()

    def _read(self) -> bool:
        if not select.select([self._master], [], [], _PATIENCE_S)[0]:
            raise AssertionError(f"silent after:\n{self.text[-3000:]}")
        try:
            data = os.read(self._master, 65536)
        except OSError:  # the other end is closed
            return False
        self.text += data.decode(errors="replace")
        return bool(data)


def _take_terminal() -> None:
    """Make the pseudo-terminal the controlling one, so that Ctrl-C reaches the command."""
    import fcntl
    import termios

    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


def command(scene: str, out: Path) -> tuple[str, ...]:
    return (
        "experiment", "actuated", "--robot", scene, "--rehearse", "--trials", "1",
        "--out", str(out),
    )  # fmt: skip


def test_the_prompts_lead_an_operator_through_trials(scene: str, tmp_path: Path) -> None:
    clear, touch, place, keep = "lay the robot straight", "just touches", "centre by", "= keep"
    terminal = Terminal(*command(scene, tmp_path))
    terminal.answer("", clear)
    terminal.wait_for("high force (14 psi), L, trial 1")
    terminal.answer("", touch)
    terminal.answer("somewhere", place)
    terminal.answer("", "Give two numbers")  # takes what the camera sees
    terminal.answer("r", keep)
    terminal.answer("", clear)
    terminal.answer("", touch)
    terminal.answer("43.0, 24.5", place)
    terminal.answer("", keep)
    terminal.answer("", clear)
    terminal.wait_for("3L/4, trial 1")
    terminal.answer("", touch)
    terminal.answer("", place)
    terminal.answer("s", keep)
    terminal.answer("", clear)
    terminal.answer("", touch)
    terminal.answer("", place)
    terminal.answer("q", keep)
    terminal.wait_for("the same command resumes")
    assert terminal.end() == 0
    rows = taken(tmp_path / "actuated")
    assert [row["state"] for row in rows] == ["kept", "skipped"]
    assert (rows[0]["dowel_x_cm"], rows[0]["dowel_y_cm"]) == ([43.0], [24.5])
    assert (tmp_path / "actuated" / "actuated-rows.csv").exists()


def test_ctrl_c_keeps_what_was_measured(scene: str, tmp_path: Path) -> None:
    terminal = Terminal(*command(scene, tmp_path))
    terminal.answer("", "lay the robot straight")
    terminal.answer("", "just touches")
    terminal.answer("", "centre by")
    terminal.answer("", "= keep")
    terminal.interrupt("lay the robot straight")
    assert terminal.end() == 130
    assert "1 trials are in" in terminal.text
    assert "the emulated robot has ended" in terminal.text
    assert len(taken(tmp_path / "actuated")) == 1
