"""Explorations as an experiment with a robot: labelled, resumed, evaluated again; over a port."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from emulated import Serve
from test_experiment_trials import Terminal

from thigmo.emulator.reach import random_peg
from thigmo.emulator.scene import PegTable, Scene
from thigmo.errors import DataError
from thigmo_bench.experiments.explorations import evaluate, run_explorations
from thigmo_bench.experiments.session import Attendant, Folder, Place, Verdict

pytestmark = pytest.mark.ci

LENGTH_CM = 26.0


@pytest.fixture
def scene() -> Scene:
    """Half of a robot, two sensors a side, and a peg in its reach."""
    made = Scene.load("default")
    robot = made.robot
    robot.sensors = [s for s in robot.sensors if s.center_cm < LENGTH_CM - 5]
    robot.body.length_cm = LENGTH_CM
    for pressure, until in zip(robot.body.pressures, (10.0, 20.0, LENGTH_CM), strict=True):
        pressure.until_cm = until
    peg, _ = random_peg(robot, np.random.default_rng(3))
    made.pegs = [PegTable(x=peg.x, y=peg.y, radius=0.6)]
    return made


class Stops(Attendant):
    """Answers with the given verdicts, then stops."""

    def __init__(self, *verdicts: Verdict) -> None:
        super().__init__()
        self.verdicts = list(verdicts)
        self.asked: list[str] = []

    def set_dowel(self, key: str) -> None:
        self.asked.append(key)

    def verdict(self, summary: str) -> Verdict:
        return self.verdicts.pop(0) if self.verdicts else "quit"


def kept(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "trials.jsonl").read_text().splitlines()]


def test_explorations_are_kept_resumed_and_evaluated_from_their_folders(
    scene: Scene, tmp_path: Path
) -> None:
    room = tmp_path / "room.toml"
    scene.save(room)
    folder = Folder(tmp_path / "one", scene.robot, "explorations")
    with pytest.raises(DataError, match="no explorations"):
        evaluate(folder)
    stops = Stops("redo", "keep")
    url = f"emulator://{room}"
    assert not run_explorations(url, stops, folder, 1, seed=4)
    assert stops.asked == ["our protocol | 1", "our protocol | 1", "the thesis's protocol | 1"]
    alone = evaluate(folder)
    assert not alone.claims  # of both protocols only
    said: list[str] = []
    assert run_explorations(url, Attendant(), folder, 1, seed=4, say=said.append)
    assert said[0] == "exploration: 1 of 2 explorations are there"
    assert [row["protocol"] for row in kept(folder.path)] == ["measure", "thesis"]
    results = evaluate(Folder(folder.path))
    assert len(results.claims) == 3
    ours, theirs = results.tables["trials"]
    # Only two sensors feel it: the answer is the middle of a wide interval.
    assert float(ours["error_x_cm"]) < 8.0
    assert float(ours["robot_time_s"]) < float(theirs["robot_time_s"])
    # A lab does not know the point of contact, only where it measured the dowel.
    document = folder.path / kept(folder.path)[0]["run"] / "contacts.json"
    known = json.loads(document.read_text())
    document.write_text(json.dumps(known | {"truth": None, "error_x_cm": None, "error_cm": None}))
    blind, _ = evaluate(folder).tables["trials"]
    assert float(blind["error_x_cm"]) == pytest.approx(float(ours["error_x_cm"]), abs=0.5)
    changed = scene.robot.model_copy(deep=True)
    changed.body.critical_curvature = 0.02
    with pytest.raises(DataError, match="another robot"):
        Folder(folder.path, changed)


@pytest.fixture
def port(scene: Scene, serve: Serve) -> str:
    """The same robot behind a serial port, in real time."""
    return serve(scene).port


@pytest.mark.realtime
def test_an_operator_explores_through_a_port_stops_and_evaluates(
    port: str, scene: Scene, tmp_path: Path
) -> None:
    config = tmp_path / "robot.toml"
    scene.robot.save(config)
    command = ("experiment", "exploration", "--trials", "1", "--out", str(tmp_path))
    terminal = Terminal(*command, "--robot", port, "--config", str(config))
    terminal.answer("0", "Measure the everted length")
    terminal.answer("", "Set one dowel")
    for _ in (*scene.robot.body.pressures, "raised to measure the contact"):
        terminal.answer("", "Set the body pressure")
    place: Place = (scene.pegs[0].x, scene.pegs[0].y)
    terminal.answer(f"{place[0]} {place[1]}", "centre by")
    terminal.answer("", "= keep")
    terminal.wait_for("winding the robot in")
    terminal.interrupt("Set one dowel")
    assert terminal.end() == 130
    (row,) = kept(tmp_path / "exploration")
    assert row["key"] == "our protocol | 1"
    assert row["dowel_cm"] == pytest.approx(place)
    again = Terminal("experiment", "exploration", "--recorded", str(tmp_path / "exploration"))
    again.wait_for("trial 1, our protocol: |x error|")
    assert again.end() == 0
    with (tmp_path / "exploration" / "exploration-trials.csv").open(newline="") as file:
        (trial,) = csv.DictReader(file)
    # Only two sensors feel it, in real time: the answer is the middle of a wide interval.
    assert float(trial["error_x_cm"]) < 8.0
