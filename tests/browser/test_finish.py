"""After a stop: the pressures until the muscles are empty, then clear, jog and retract, and that a
motion ends when the page has gone.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from browsing import Looking, Served
from playwright.sync_api import Page, expect
from served import ServedRobot, comes

from thigmo.cli.watch import parameters
from thigmo.config import RobotConfig
from thigmo.robot import connect

ServePage = Callable[..., Served]

pytestmark = pytest.mark.realtime

# From the last sign of life to the outputs off, in the robot's time: 1.5 s, and a quarter of a
# second between two looks; the rest is for a busy computer.
GONE_S = 3.0


@pytest.fixture
def configured(robot: ServedRobot, config: Path) -> ServedRobot:
    """That robot, whose board has its configuration."""
    connect(robot.port, RobotConfig.load(config)).close()
    return robot


@pytest.fixture
def operator(looking: Looking, serve_page: ServePage, configured: ServedRobot) -> Page:
    """A page of that robot."""
    robot = configured
    page = looking.open(serve_page(url=robot.port).address)
    expect(page.locator("#finish")).to_be_visible()
    return page


def _retract(page: Page, length_cm: str, to_cm: str) -> None:
    page.locator("#retract").click()
    page.locator("#length-now").fill(length_cm)
    page.locator("#length-to").fill(to_cm)
    page.locator("#sure-yes").click()


def test_stopped_run_is_seen_to_empty_and_is_cleared_jogged_and_retracted(
    looking: Looking, serve_page: ServePage, robot: ServedRobot, config: Path, tmp_path: Path
) -> None:
    options = ("--config", str(config), "--out", str(tmp_path / "runs"))
    served = serve_page(url=robot.port, explore=options, parameters=parameters())
    page = looking.open(served.address)
    page.locator("#parameters summary").click()
    page.locator('[data-flag="--name"]').fill("finish")
    page.locator('[data-flag="--protocol"]').select_option("thesis")
    page.locator("#start").click()
    expect(page.locator("#run-name")).to_have_text("finish")
    page.locator("#answer").fill("20")
    page.keyboard.press("Enter")
    expect(page.locator("#question-text")).to_contain_text("Set the body pressure to")
    page.keyboard.press("Enter")
    page.wait_for_function("() => thigmo.store.columns[1].at(-1) > 6")
    page.keyboard.press("Space")
    expect(page.locator("#stop")).to_contain_text("the board has confirmed")
    assert robot.off
    banners = page.locator("#banners")
    expect(page.locator("#doing")).to_contain_text("Stopped from this page, ")
    expect(banners).to_contain_text("Valves off, motor braked.")
    expect(banners).to_contain_text("The muscles are empty: left 0.")
    # All of the way down was seen.
    pressures = page.evaluate("thigmo.store.columns[1].slice(-600)")
    assert max(pressures) > 5.0
    assert min(pressures) < 0.5

    page.reload()  # what is latched is known to the server
    expect(page.locator("#stop")).to_have_attribute("data-state", "stopped")
    expect(page.locator("#doing")).to_contain_text("Stopped from this page, ")
    expect(page.locator("#phase")).to_have_text("stopped")
    expect(page.locator("#age")).to_contain_text(" s ago")
    expect(page.locator("#room.old")).to_be_visible()
    for locked in ("#retract", "#jog button >> nth=0"):
        expect(page.locator(locked)).to_be_disabled()
    page.locator("#clear").click()
    expect(page.locator("#sure-text")).to_contain_text("Look at it")
    page.locator("#sure-yes").click()
    expect(banners).to_have_text("The stop has ended.")
    expect(page.locator("#doing")).to_have_text("Cleared")
    expect(page.locator("#phase")).to_have_text("safe")
    expect(page.locator("#stop")).to_have_attribute("data-state", "ready")

    page.locator("#jog-cm").fill("6")  # beyond what `thigmo jog` takes: the browser refuses
    page.locator("#jog button").first.click()
    assert page.evaluate("document.getElementById('jog-cm').validity.rangeOverflow")
    before_cm = robot.plant.length_cm
    page.locator("#jog-cm").fill("1")
    page.locator("#jog button").first.click()
    expect(banners).to_contain_text("The encoder went +1.")
    assert robot.plant.length_cm - before_cm == pytest.approx(1.0, abs=0.3)

    _retract(page, "21", "19")
    expect(page.locator("#doing")).to_have_text("Retracting")
    expect(page.locator("#run-name")).to_have_text("finish")  # its contacts stay shown
    expect(banners).to_contain_text("Retracted to 19.0 cm by the encoder; no sensor has confirmed")
    expect(page.locator("#doing")).to_have_text("Retracted")
    expect(page.locator("#phase")).to_have_text("safe")
    expect(page.locator("#length")).to_have_text("19.0")
    assert robot.plant.length_cm == pytest.approx(19.0, abs=0.6)
    assert robot.off


def test_motion_ends_when_its_page_is_closed_and_another_page_says_so(
    operator: Page, looking: Looking, robot: ServedRobot
) -> None:
    _retract(operator, "20", "0")
    assert comes(lambda: robot.board.motor < 0)
    address = operator.url
    second = operator.context.new_page()
    second.goto(address)
    expect(second.locator("#operated")).to_have_text("Another page operates")
    operator.close()
    assert robot.off_within(GONE_S)
    assert robot.plant.length_cm > 1.0
    banner = second.locator(".banner.fault")
    expect(banner).to_contain_text("The retraction did not start, or ended early.")
    expect(banner).to_contain_text("the board has confirmed")


def test_stop_ends_a_motion_at_once_and_latches(operator: Page, robot: ServedRobot) -> None:
    _retract(operator, "20", "0")
    assert comes(lambda: robot.board.motor < 0)
    robot.slow_motion()
    operator.keyboard.press("Escape")
    assert robot.off_within(0.3)
    expect(operator.locator("#stop")).to_contain_text("the board has confirmed")
    expect(operator.locator("#retract")).to_be_disabled()


@pytest.mark.parametrize("ends", ["no more signs", "the server is killed"])
def test_motion_ends_without_signs_of_life(configured: ServedRobot, ends: str) -> None:
    robot = configured
    words = [sys.executable, "-m", "thigmo", "retract", "--robot", robot.port, "--length", "20"]
    motion = subprocess.Popen(
        [*words, "--by-page"], stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert motion.stdin is not None

    def moves() -> bool:
        assert motion.stdin is not None
        os.write(motion.stdin.fileno(), b"\n")
        return robot.board.motor < 0

    assert comes(moves)
    if ends == "the server is killed":
        motion.stdin.close()
        motion.stdin = None
    assert robot.off_within(GONE_S)
    _, said = motion.communicate()
    assert motion.returncode == 1
    assert "closed, hidden or cut off" in said
    assert "(the board has confirmed)" in said
