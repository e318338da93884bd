"""A planner on ROS 2 sees what the robot feels, and stops it: a real rclpy node, in its process."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from contacts import CONTACT
from emulated import room_file, scene_at
from served import LIVE, comes, ready_to_sweep

import thigmo
from thigmo.errors import RobotFaultError, StoppedByViewerError
from thigmo.record import Explanation, RunFolder
from thigmo.stream import Hello, Hub, Server

# A run hears of a stop from its viewer and from its board, whichever is first.
STOPPED = (StoppedByViewerError, RobotFaultError)


def _map_is_the_run_s(planner: Any, run: thigmo.ExplorationResult) -> None:
    grid = run.map
    cells = grid.cells.ravel().tolist()
    said = planner.hears(lambda said: said["topic"] == "map" and said["cells"] == cells)
    assert said["frame"] == "map"
    assert said["size"] == list(grid.cells.shape[::-1])
    assert said["resolution"] == pytest.approx(grid.resolution_cm / 100)
    assert said["origin"] == pytest.approx(
        [grid.origin[0] / 100, grid.origin[1] / 100, 0, 0, 0, 0, 1], abs=1e-6
    )


def _contacts_are_the_run_s(planner: Any, run: thigmo.ExplorationResult) -> None:
    """Those with the newest stamp, as docs/ros.md tells planners to read them."""

    def newest() -> list[dict[str, Any]]:
        said = planner.of("contact")
        last = max((message["stamp"] for message in said), default=None)
        return [message for message in said if message["stamp"] == last]

    assert run.contacts
    expected = [
        pytest.approx(
            [
                *(contact.x_cm / 100, contact.y_cm / 100, 0),
                *(0, 0, math.sin(contact.normal_rad / 2), math.cos(contact.normal_rad / 2)),
            ]
        )
        for contact in run.contacts
    ]
    planner.hears(lambda said: [marker["pose"] for marker in newest()] == expected)
    for said, contact in zip(newest(), run.contacts, strict=True):
        covariance = np.reshape(said["covariance"], (6, 6))
        assert covariance[:2, :2] == pytest.approx(np.array(contact.covariance_cm2) * 1e-4)
        assert np.linalg.eigvalsh(covariance).min() >= 0


def test_planner_receives_map_contacts_and_body_of_a_live_run(
    ros: Any, late_url: str, tmp_path: Path
) -> None:
    planner, transforms = ros.planner(), ros.transforms()
    ros.bridge(late_url)
    # The bridge is there before the run: what it says of it then is that it knows of none.
    planner.hears(lambda said: said.get("name") == "thigmo: run" and said["level"] == 3)
    run = thigmo.explore(late_url, seed=1, out=tmp_path)
    planner.hears(lambda said: said.get("message") == "full length")
    _map_is_the_run_s(planner, run)
    _contacts_are_the_run_s(planner, run)
    joints = [said for said in planner.of("joints") if said["positions"][0] > 0]
    tenths = range(1, 11)
    assert joints[0]["names"] == [
        "everted_length", *(f"bend_{n}" for n in tenths), *(f"grow_{n}" for n in tenths)
    ]  # fmt: skip
    assert max(said["positions"][0] for said in joints) == pytest.approx(0.53, abs=0.005)
    turns = [sum(said["positions"][1:11]) for said in joints]
    assert min(turns) < -0.5 < 0.5 < max(turns)
    assert planner.of("body")[-1]["poses"][0] == pytest.approx([0, 0, 0, 0, 0, 0, 1])
    board = planner.hears(
        lambda said: (
            said.get("name") == "thigmo: board"
            and float(said["values"]["everted length (m)"]) > 0.4
        )
    )
    assert board["hardware"] == late_url
    base = transforms.hears(lambda said: said["topic"] == "tf_static")
    assert (base["frame"], base["child"]) == ("map", "thigmo_base")
    assert base["pose"] == [0, 0, 0, 0, 0, 0, 1]
    tips = [said["pose"] for said in transforms.of("tf") if said["child"] == "thigmo_tip"]
    assert max(tip[0] for tip in tips) == pytest.approx(0.53, abs=0.01)
    assert min(tip[1] for tip in tips) < -0.1 < 0.1 < max(tip[1] for tip in tips)


def test_description_s_joints_and_the_transforms_end_at_the_tip(
    ros: Any, late_url: str, tmp_path: Path
) -> None:
    planner, transforms = ros.planner(), ros.transforms()
    ros.bridge(late_url)
    planner.hears(lambda said: said.get("name") == "thigmo: run")
    thigmo.explore(late_url, seed=1, out=tmp_path)
    planner.hears(lambda said: said.get("message") == "full length")
    described = planner.hears(lambda said: said["topic"] == "description")
    urdf = ElementTree.fromstring(described["urdf"])
    bodies = {tuple(said["stamp"]): said["poses"][-1] for said in planner.of("body")}
    sent: dict[tuple[int, int], dict[str, Any]] = {}
    for said in transforms.of("tf"):
        sent.setdefault(tuple(said["stamp"]), {})[said["child"]] = said
    compared = 0
    # A shape that is measured again at the same time replaces the one before.
    joints = {tuple(said["stamp"]): said for said in planner.of("joints")}
    for stamp, said in joints.items():
        if stamp not in bodies or len(sent.get(stamp, {})) < 21:
            continue
        values = dict(zip(said["names"], said["positions"], strict=True))
        x = y = heading = 0.0
        link = "thigmo_base"
        while (joint := urdf.find(f"joint/parent[@link='{link}']/..")) is not None:
            value, link = values[joint.attrib["name"]], joint.find("child").attrib["link"]
            frame = sent[stamp][link]
            assert frame["frame"] == joint.find("parent").attrib["link"]
            if joint.attrib["type"] == "revolute":
                heading += value
                half = value / 2
                assert frame["pose"][5:] == pytest.approx([math.sin(half), math.cos(half)])
            else:
                x, y = x + value * math.cos(heading), y + value * math.sin(heading)
                assert frame["pose"][0] == pytest.approx(value)
                assert value <= float(joint.find("limit").attrib["upper"])
        assert link == "thigmo_end_10"
        assert [x, y] == pytest.approx(bodies[stamp][:2], abs=1e-6)
        compared += 1
    assert compared > 10


def _service(planner: Any, name: str) -> dict[str, Any]:
    planner.say(f"call {name}")
    answer: dict[str, Any] = planner.hears(lambda said: said.get("name") == f"/thigmo/{name}")
    return answer


def test_launch_file_s_action_explores_with_feedback_and_returns_the_run(
    ros: Any, late_url: str, tmp_path: Path
) -> None:
    planner = ros.planner()
    ros.launch(robot=late_url, options=f"--seed 1 --out {tmp_path}")
    planner.say("explore 0")
    result = planner.hears(lambda said: said["topic"] == "result")
    assert (result["status"], result["outcome"]) == ("succeeded", "full length")
    run = thigmo.open_run(result["folder"])
    assert result["folder"].endswith("-by-action")
    assert result["contacts"] == len(run.document.contacts) > 0
    assert result["length"] == pytest.approx(0.53, abs=0.005)


@pytest.mark.realtime
def test_action_says_how_far_it_is_ends_when_cancelled_and_is_stopped_by_the_service(
    ros: Any, late_url: str, tmp_path: Path
) -> None:
    planner = ros.planner()
    ros.launch(robot=late_url, options=f"--realtime --out {tmp_path}")
    assert not _service(planner, "stop")["success"]  # nothing is to be stopped
    for ending, status in (("cancel", "canceled"), ("call stop", "aborted")):
        planner.said.clear()
        planner.say("explore 0")
        said = planner.hears(lambda said: said["topic"] == "feedback" and said["done"] > 0)
        assert said["done"] < 1
        assert said["stage"] >= 0.5
        assert said["doing"]
        planner.say("explore 0")
        planner.hears(lambda said: said["topic"] == "goal" and not said["accepted"])
        planner.say(ending)
        result = planner.hears(lambda said: said["topic"] == "result")
        assert result["status"] == status
    answer = planner.hears(lambda said: said["topic"] == "answer")
    assert answer["success"], answer["message"]
    assert "stopped" in result["outcome"]


def test_clear_service_clears_the_faults_of_a_robot_on_a_port(ros: Any) -> None:
    robot = ready_to_sweep()
    try:
        planner = ros.planner()
        ros.launch(robot=robot.port)
        answer = _service(planner, "stop")
        assert answer["success"], answer["message"]
        answer = _service(planner, "clear")
        assert answer["success"], answer["message"]
    finally:
        robot.close()


def test_planner_that_comes_later_gets_a_finished_run_s_map(
    ros: Any, late_url: str, tmp_path: Path
) -> None:
    run = thigmo.explore(late_url, seed=1, out=tmp_path)
    ros.bridge(run.folder, "--namespace", "lab/vine")
    planner = ros.planner("lab/vine")
    _map_is_the_run_s(planner, run)
    _contacts_are_the_run_s(planner, run)


def test_viewer_receives_a_wall_s_face_its_ellipse_and_the_doubt(ros: Any, tmp_path: Path) -> None:
    run = thigmo.explore(room_file(tmp_path, scene_at(51.0, "empty")), seed=1, out=tmp_path)
    wall = replace(
        CONTACT, kind="wall", surface=[(12.0, 9.0), (33.0, 10.1)], status="ambiguous",
        explanations=[Explanation("wall", 0.8), Explanation("two pegs", 0.2)], doubt="a guess",
    )  # fmt: skip
    RunFolder(run.folder).write_document(replace(run.document, contacts=[wall]))
    ros.bridge(run.folder)
    said = ros.planner().hears(lambda said: said["topic"] == "contact_markers" and said["markers"])
    assert said["removed"] == 1
    shown = said["markers"]
    assert shown.keys() == {"walls", "ellipses", "words"}
    assert [shown[name]["kind"] for name in ("walls", "ellipses", "words")] == [4, 4, 9]
    assert np.allclose(shown["walls"]["points"], [[0.12, 0.09, 0.0], [0.33, 0.101, 0.0]])
    off = np.array(shown["ellipses"]["points"])[:, :2] * 100 - [wall.x_cm, wall.y_cm]
    squares = np.einsum("ni,in->n", off, np.linalg.solve(np.array(wall.covariance_cm2), off.T))
    assert np.allclose(squares, 5.99, atol=0.01)
    assert shown["words"]["text"].endswith("wall 80 %, two pegs 20 %\n" + wall.doubt)
    assert all(marker["alpha"] < 0.5 for marker in shown.values())


@pytest.mark.realtime
@pytest.mark.parametrize("stop", ["stop", "stop, best effort"])
def test_planner_s_stop_stops_a_run(ros: Any, late_url: str, tmp_path: Path, stop: str) -> None:
    planner = ros.planner()
    bridge = ros.bridge("--run", str(os.getpid()))
    bent = threading.Event()
    asked: list[str] = []  # of another run at the same address, which is the youngest
    hello = Hello(0.0, time.time() + 3600.0, late_url, "another", "", 1, "0", True)

    def ask() -> None:
        planner.hears(lambda said: abs(sum(said.get("positions", [0])[1:11])) > 0.1)
        bent.set()
        planner.say(stop)

    asking = threading.Thread(target=ask)
    asking.start()
    with (
        Server(Hub(), hello, lambda command, text: asked.append(command)),
        pytest.raises(STOPPED, match="stopped"),
    ):
        thigmo.explore(late_url, seed=1, out=tmp_path, realtime=True)
    asking.join()
    assert bent.is_set()
    assert asked == []
    bridge.hears(lambda said: said.get("text", "").startswith(f"Stop from ROS: stopped {late_url}"))
    said = planner.hears(
        lambda said: said.get("name") == "thigmo: run" and said["message"].startswith("aborted")
    )
    assert said["level"] == 2


@pytest.mark.realtime
def test_planner_s_latched_stop_is_heard_that_was_said_once_before_anybody_listened(
    ros: Any, late_url: str, tmp_path: Path
) -> None:
    planner = ros.planner()
    planner.say("stop, latched")
    planner.hears(lambda said: said["topic"] == "said")
    bridges: list[Any] = []

    def progress(doing: str, done: float) -> None:
        if doing.startswith("sweeping") and not bridges:
            bridges.append(ros.bridge())

    with pytest.raises(STOPPED, match="stopped"):
        thigmo.explore(late_url, seed=1, out=tmp_path, progress=progress, realtime=True)


@pytest.mark.realtime
def test_planner_s_stop_reaches_the_board_while_the_program_on_its_port_hangs(ros: Any) -> None:
    planner, bridge = ros.planner(), ros.bridge()
    robot = ready_to_sweep()
    host = subprocess.Popen([sys.executable, "-c", LIVE, robot.port], stdout=subprocess.PIPE)
    try:
        assert host.stdout is not None
        assert host.stdout.readline() == b"sweeping\n"
        assert comes(lambda: robot.energised)
        host.send_signal(signal.SIGSTOP)
        planner.say("stop")
        # The port's process says so once the board has echoed the stop.
        bridge.hears(
            lambda said: said.get("text", "").startswith(f"Stop from ROS: stopped {robot.port}")
        )
        assert robot.off
    finally:
        host.kill()
        host.communicate()
        robot.close()
