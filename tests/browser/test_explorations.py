"""Explorations on the page: from Start to the map, and stopped in mid-sweep on a port, also while
the exploration's own process is stopped.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from browsing import Looking, Served
from playwright.sync_api import expect
from served import ServedRobot

ServePage = Callable[..., Served]
EXPLORE = """
import sys
from thigmo.config import RobotConfig
from thigmo.exploration import explore

class Beside:
    def everted_length_cm(self): return 20.0
    def set_body_pressure(self, pressure_psi): pass
    def place_pegs(self, pegs): pass
    def warn(self, danger): pass

port, config, out = sys.argv[1:]
explore(port, config=RobotConfig.load(config), out=out, operator=Beside())
"""


def test_exploration_from_start_to_map(
    looking: Looking, serve_page: ServePage, late_url: str, tmp_path: Path
) -> None:
    runs = tmp_path / "runs"
    page = looking.open(serve_page(url=late_url, explore=("--out", str(runs))).address)
    expect(page.locator("#doing")).to_have_text("Nothing runs yet")
    page.locator("#pace").select_option("fast")
    page.locator("#start").click()
    expect(page.locator("#run-name")).to_have_text("late")
    page.wait_for_function("() => thigmo.store.last.state?.outcome === 'full length'")
    expect(page.locator("#doing")).to_have_text("Ended: full length")
    expect(page.locator("#contact-rows tr")).to_have_count(1)
    expect(page.locator("#room image")).to_have_count(1)  # the map
    expect(page.locator("#truth-legend")).to_be_visible()
    expect(page.locator("#start")).to_be_enabled()  # for another
    page.wait_for_function("() => thigmo.store.page.ended")
    (folder,) = runs.iterdir()
    assert page.evaluate("thigmo.store.page.run.folder") == str(folder)
    assert (folder / "map.yaml").exists()
    expect(page.locator("#open-record")).to_be_visible()
    page.evaluate("thigmo.still = true")  # nothing is drawn until the record's first moment is
    page.locator("#open-record").click()
    expect(page.locator("#player")).to_be_visible()
    expect(page.locator("#position")).to_contain_text("of")  # all of it is loaded
    page.keyboard.press("Home")
    page.evaluate("thigmo.still = false")
    page.keyboard.press("Home")
    expect(page.locator("#contacts-empty")).to_be_visible()
    page.keyboard.press("End")
    expect(page.locator("#contact-rows tr")).to_have_count(1)
    page.locator("#start").click()  # a robot that moves is shown live, with its stop
    expect(page.locator("#player")).to_be_hidden()
    expect(page.locator("#stop")).to_be_visible()
    page.keyboard.press("Space")
    expect(page.locator("#stop")).to_contain_text("the board has confirmed")


def test_posterior_moves_with_the_body_in_mid_sweep(
    looking: Looking, serve_page: ServePage, late_url: str, tmp_path: Path
) -> None:
    options = ("--out", str(tmp_path / "runs"))
    page = looking.open(serve_page(url=late_url, explore=options).address)
    page.locator("#start").click()  # in real time
    page.wait_for_function("() => thigmo.store.last.posterior?.sweeping")
    expect(page.locator("#doing")).to_contain_text("sweeping")
    expect(page.locator("#body")).to_contain_text(
        "probability density of a contact, by the sweeps so far"
    )
    expect(page.locator('#room [data-layer="posterior"] path')).not_to_have_count(0)
    page.keyboard.press("Space")
    expect(page.locator("#stop")).to_contain_text("the board has confirmed")


@pytest.fixture
def exploration(
    robot: ServedRobot, config: Path, tmp_path: Path
) -> Iterator[subprocess.Popen[bytes]]:
    """An exploration of that robot, in a process group of its own."""
    started = subprocess.Popen(
        [sys.executable, "-c", EXPLORE, robot.port, str(config), str(tmp_path / "runs")],
        start_new_session=True,
    )
    yield started
    with suppress(ProcessLookupError):
        os.killpg(started.pid, signal.SIGKILL)
    started.wait()


@pytest.mark.realtime
@pytest.mark.parametrize("hangs", [False, True], ids=["running", "stopped by SIGSTOP"])
def test_stop_in_mid_sweep_takes_the_current_off_the_valves_within_300_ms_of_the_click(
    looking: Looking,
    serve_page: ServePage,
    robot: ServedRobot,
    exploration: subprocess.Popen[bytes],
    *,
    hangs: bool,
) -> None:
    page = looking.open(serve_page().address)
    page.wait_for_function(
        "() => thigmo.store.columns[1].at(-1) > 3 || thigmo.store.columns[2].at(-1) > 3"
    )
    assert robot.energised
    if hangs:
        os.kill(exploration.pid, signal.SIGSTOP)
    page.locator("#stop").hover()
    # What this computer's other work costs is not the robot's: its promise is in its own time.
    robot.slow_motion()
    clicked_s = robot.lockstep.t_s
    page.mouse.down()
    assert robot.off_within(0.3)
    assert robot.lockstep.t_s >= clicked_s
    expect(page.locator("#stop")).to_contain_text("the board has confirmed")
    expect(page.locator("#doing")).to_contain_text("Stopped from this page, ")


@pytest.mark.realtime
@pytest.mark.parametrize("terminal", [True, False], ids=["at a terminal", "in the background"])
def test_question_of_a_run_reaches_a_page_that_comes_later_and_again(
    looking: Looking,
    serve_page: ServePage,
    robot: ServedRobot,
    config: Path,
    tmp_path: Path,
    *,
    terminal: bool,
) -> None:
    ours, its = os.openpty()
    words = ["--robot", robot.port, "--config", str(config), "--out", str(tmp_path / "runs")]
    run = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "thigmo",
            "explore",
            *words,
            *([] if terminal else ["--asks-viewers"]),
        ],
        stdin=its if terminal else subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        page = looking.open(serve_page().address)
        asked = "Measure the everted length. How many cm?"
        expect(page.locator("#question-text")).to_have_text(asked)
        page.reload()
        expect(page.locator("#question-text")).to_have_text(asked)
        page.locator("#answer").fill("20.0")
        page.keyboard.press("Enter")
        expect(page.locator("#question-text")).to_contain_text("Set the body pressure to")
        if terminal:
            os.write(ours, b"\n")  # whoever answers first
        else:
            page.locator("#answer-send").click()
        expect(page.locator("#question")).to_be_hidden()
        page.wait_for_function("() => thigmo.store.last.state?.stage_cm >= 20")
        page.keyboard.press("Escape")
        expect(page.locator("#stop")).to_contain_text("the board has confirmed")
    finally:
        run.terminate()
        run.wait()
        for address in (ours, its):
            os.close(address)


@pytest.mark.realtime
def test_run_on_a_port_asks_its_operator_on_the_page(
    looking: Looking, serve_page: ServePage, robot: ServedRobot, config: Path, tmp_path: Path
) -> None:
    options = ("--config", str(config), "--out", str(tmp_path / "runs"))
    page = looking.open(serve_page(url=robot.port, explore=options).address)
    page.locator("#start").click()
    question, answer = page.locator("#question-text"), page.locator("#answer")
    expect(question).to_have_text("Measure the everted length. How many cm?")
    expect(answer).to_be_focused()
    page.keyboard.type("20.0")
    page.keyboard.press("Enter")
    expect(question).to_contain_text("Set the body pressure to")
    page.keyboard.press("Enter")
    expect(page.locator("#question")).to_be_hidden()
    page.wait_for_function("() => thigmo.store.last.state?.stage_cm >= 20")
    robot.slow_motion()
    page.keyboard.press("Escape")
    expect(page.locator("#stop")).to_contain_text("the board has confirmed")
    assert robot.off_within(0.3)
