"""From a stop on: Clear, Retract and Start on the page, after a stop in a question, in growth and
in a sweep. The page says one thing of the robot all the way.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from browsing import Looking, Served
from playwright.sync_api import Page, expect
from served import ServedRobot, comes
from settled import settled_robot

from thigmo.config import RobotConfig
from thigmo.robot import connect

ServePage = Callable[..., Served]

pytestmark = pytest.mark.realtime

SWEEPS = "() => Math.max(thigmo.store.columns[1].at(-1), thigmo.store.columns[2].at(-1)) > 4"
# Keeps what the header says from now on.
LISTEN = """() => {
  window.said = [];
  const doing = document.getElementById("doing");
  new MutationObserver(() => said.push(doing.textContent)).observe(doing, { childList: true });
}"""
MOMENTS = {"in a question": 20.0, "in growth": 15.0, "in a sweep": 20.0}  # everted lengths, cm


@pytest.fixture(params=MOMENTS)
def moment(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def robot(moment: str) -> Iterator[ServedRobot]:
    yield from settled_robot(MOMENTS[moment])


def _begin(page: Page, length_cm: float) -> None:
    """Start, and answer until the robot moves."""
    page.locator("#start").click()
    expect(page.locator("#answer")).to_be_visible()
    page.locator("#answer").fill(f"{length_cm:g}")
    page.keyboard.press("Enter")
    expect(page.locator("#question-text")).to_contain_text("Set the body pressure to")
    page.locator("#answer-send").click()


def _reach(page: Page, moment: str, robot: ServedRobot) -> None:
    """Start, and let the run come to where it is to be stopped."""
    if moment == "in a question":
        page.locator("#start").click()
        expect(page.locator("#question")).to_be_visible()
        expect(page.locator("#doing")).to_have_text("Waiting for your answer")
        # Readings go on, so that the page has nothing to say of a run that hangs.
        rows = page.evaluate("thigmo.store.columns[0].length")
        page.wait_for_function("rows => thigmo.store.columns[0].length > rows + 600", arg=rows)
        expect(page.locator("#banners")).to_be_empty()
        return
    _begin(page, MOMENTS[moment])
    if moment == "in growth":
        assert comes(lambda: robot.board.motor > 0)
        robot.slow_motion()
        page.wait_for_function("() => thigmo.store.last.state?.state === 'GROW'")
    else:
        page.wait_for_function(SWEEPS)


@pytest.fixture
def exploring(
    looking: Looking,
    serve_page: ServePage,
    robot: ServedRobot,
    config: Path,
    tmp_path: Path,
    moment: str,
) -> Page:
    """The page of a robot whose exploration has come to a moment."""
    connect(robot.port, RobotConfig.load(config)).close()
    # The thesis's protocol sweeps at 20 cm; the default one first grows.
    options = ("--config", str(config), "--out", str(tmp_path / "runs"), "--protocol", "thesis")
    page = looking.open(serve_page(url=robot.port, explore=options).address)
    _reach(page, moment, robot)
    return page


def test_a_stopped_robot_is_cleared_retracted_and_started_again(
    exploring: Page, robot: ServedRobot, tmp_path: Path
) -> None:
    page = exploring
    page.evaluate(LISTEN)
    page.keyboard.press("Escape")
    doing, phase, banners = (page.locator(f"#{name}") for name in ("doing", "phase", "banners"))
    expect(doing).to_contain_text("Stopped from this page, ")
    expect(page.locator("#question")).to_be_hidden()
    assert comes(lambda: robot.off)
    expect(page.locator("#clear")).to_be_visible()  # the run has ended by itself
    said = page.evaluate("said")
    assert [words for words in said if words.startswith(("Starting", "Ended"))] == []
    expect(phase).to_have_text("stopped")
    expect(page.locator("#start")).to_be_disabled()
    expect(page.locator(".banner")).to_have_count(1)
    # The body lies as the emptied one does.
    page.wait_for_function("() => Math.abs(thigmo.store.last.shape.poses.at(-1)[1]) < 3")
    page.screenshot(path=tmp_path / "stopped.png")

    page.locator("#clear").click()
    page.locator("#sure-yes").click()
    expect(doing).to_have_text("Cleared")
    expect(phase).to_have_text("safe")
    expect(banners).to_have_text("The stop has ended.")
    expect(page.locator("#stop")).to_have_attribute("data-state", "ready")

    length_cm = robot.plant.length_cm
    page.locator("#retract").click()
    page.locator("#length-now").fill(f"{length_cm:.1f}")
    page.locator("#length-to").fill(f"{length_cm - 2:.1f}")
    page.locator("#sure-yes").click()
    expect(banners).to_contain_text(f"Retracted to {length_cm - 2:.1f} cm by the encoder")
    expect(doing).to_have_text("Retracted")
    expect(phase).to_have_text("safe")
    assert robot.off

    page.locator("#start").click()
    expect(doing).to_have_text("Starting")
    expect(doing).to_have_text("Waiting for your answer")
    expect(page.locator(".banner.fault")).to_have_count(0)
    page.keyboard.press("Escape")
    expect(doing).to_contain_text("Stopped from this page, ")


@pytest.mark.parametrize("moment", ["in growth"], indirect=True)
def test_an_open_page_sees_a_stop_cleared_from_a_terminal(
    exploring: Page, robot: ServedRobot
) -> None:
    page = exploring
    page.keyboard.press("Escape")
    expect(page.locator("#clear")).to_be_visible()
    expect(page.locator("#phase")).to_have_text("stopped")
    clear = [sys.executable, "-m", "thigmo", "clear", "--robot", robot.port]
    said = subprocess.run(clear, check=True, capture_output=True, text=True).stdout
    assert "The stop has ended." in said
    expect(page.locator("#stop")).to_have_attribute("data-state", "ready")
    expect(page.locator("#phase")).to_have_text("safe")
    expect(page.locator("#start")).to_be_enabled()
