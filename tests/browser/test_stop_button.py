"""Stop on the page: what presses it, and what it says, also when nobody would hear."""

from __future__ import annotations

import os
from collections.abc import Callable

import pytest
from browsing import Looking, Served
from playwright.sync_api import Page, expect
from scripted import ScriptedRun
from served import ServedRobot

from thigmo.cli.watch import parameters
from thigmo.emulator._board import VirtualBoard
from thigmo.emulator.lockstep import Lockstep
from thigmo.emulator.scene import Scene
from thigmo.emulator.serve import brought_up
from thigmo.link import protocol as wire
from thigmo.link.client import Client
from thigmo.link.transport import open_transport

ServePage = Callable[..., Served]


@pytest.mark.parametrize("key", ["Space", "Escape"])
def test_key_stops_wherever_the_focus_is(page: Page, run: ScriptedRun, key: str) -> None:
    page.locator("#pause").focus()
    page.keyboard.press(key)
    assert run.heard.wait(60)
    run.close()
    expect(page.locator("#stop .word")).to_have_text("Stopped")
    expect(page.locator("#stop-says")).to_have_text("it has ended with its run")
    expect(page.locator("#stop-robot")).to_have_text("emulator://scripted")
    expect(page.locator("#last-stop")).to_contain_text("confirmed by the end of its run scripted")
    assert run.asked == ["stop"]


def test_press_of_the_button_stops_before_it_is_let_go(page: Page, run: ScriptedRun) -> None:
    page.locator("#stop").hover()
    page.mouse.down()
    assert run.heard.wait(60)
    page.mouse.up()
    run.close()
    expect(page.locator("#stop")).to_have_attribute("data-state", "stopped")
    assert run.asked == ["stop"]


def test_focused_start_does_not_take_the_space_bar(looking: Looking, serve_page: ServePage) -> None:
    page = looking.open(serve_page(url="emulator://nowhere").address)
    start = page.locator("#start")
    expect(start).to_be_enabled()
    start.focus()
    with page.expect_request("**/stop"):
        page.keyboard.press("Space")
    expect(page.locator("#stop")).to_have_attribute("data-state", "idle")
    expect(page.locator("#doing")).to_have_text("Nothing runs yet")
    assert page.evaluate("thigmo.store.page.starting") is False


def test_a_space_in_a_text_field_is_text_and_escape_stops_there(
    looking: Looking, serve_page: ServePage
) -> None:
    page = looking.open(serve_page(url="emulator://nowhere", parameters=parameters()).address)
    stops: list[str] = []
    page.on(
        "request", lambda request: stops.append(request.url) if "/stop" in request.url else None
    )
    says = page.locator("#stop-says")
    expect(says).to_have_text("Space or Esc")
    page.locator("#parameters summary").click()
    for flag in ("--name", "--map", "--seed"):
        field = page.locator(f'[data-flag="{flag}"]')
        field.focus()
        expect(says).to_have_text("Esc")
        page.keyboard.type("1 2")
    assert page.locator('[data-flag="--map"]').input_value() == "1 2"
    assert stops == []
    with page.expect_request("**/stop"):
        page.keyboard.press("Escape")
    page.locator("#start").focus()
    expect(says).to_have_text("Space or Esc")
    with page.expect_request("**/stop"):
        page.keyboard.press("Space")


def test_lost_server_says_use_the_e_stop(page: Page, looking: Looking, served: Served) -> None:
    served.close()
    expect(page.locator("#stop")).to_contain_text("Stop not connected:use the e-stop")
    expect(page.locator(".banner.fault")).to_contain_text("Stop not connected: use the e-stop.")
    page.close()  # it would look for the server again, in this line's next moment as well
    looking.errors.clear()  # Chromium tells the lost connection on the console itself


def test_port_that_has_gone_says_use_the_e_stop(looking: Looking, serve_page: ServePage) -> None:
    with ScriptedRun(virtual=False, url="/dev/ttyNONE") as run:
        page = looking.open(serve_page().address)
        run.state()
        expect(page.locator("#stop")).to_contain_text("Stop not connected:use the e-stop")
        expect(page.locator("#stop-robot")).to_have_text("there is no port /dev/ttyNONE")


@pytest.mark.parametrize(
    ("url", "why", "then"),
    [
        ("emulator://empty", "no program of yours runs emulator://empty", "idle"),
        ("/dev/ttyNONE", "there is no port /dev/ttyNONE", "lost"),
        (None, "no robot is in use", "idle"),
    ],
)
def test_stop_that_would_reach_nobody_is_outlined_and_says_so(
    looking: Looking, serve_page: ServePage, url: str | None, why: str, then: str
) -> None:
    page = looking.open(serve_page(url=url).address)
    expect(page.locator("#stop-robot")).to_have_text(why)
    expect(page.locator("#stop")).to_have_attribute("data-state", "idle")
    with page.expect_response("**/stop"):
        page.keyboard.press("Escape")
    expect(page.locator("#stop")).to_have_attribute("data-state", then)


def test_each_page_stops_its_own_robot_and_names_it(
    looking: Looking, serve_page: ServePage, robot: ServedRobot
) -> None:
    """The page of a robot that nobody drives, while a run drives another one."""
    lockstep = Lockstep(Scene.load("empty"), VirtualBoard(4, brought_up()), seed=4)
    with ServedRobot(lockstep, reset_on_open=False) as served:
        idle = looking.open(serve_page(url=robot.port).address)
        busy = looking.open(serve_page(url=served.port).address)
        with Client(open_transport(served.port)) as client:
            expect(busy.locator("#stop-robot")).to_have_text(served.port)
            expect(busy.locator("#stop")).to_have_attribute("data-state", "ready")
            expect(idle.locator("#stop-robot")).to_have_text(robot.port)
            idle.keyboard.press("Escape")
            expect(idle.locator("#stop")).to_have_attribute("data-state", "stopped")
            expect(idle.locator("#stop-robot")).to_have_text(robot.port)
            expect(idle.locator("#last-stop")).to_contain_text(
                f"{robot.port} confirmed by its board, over its port"
            )
            assert _faults(client) == ()
            expect(busy.locator("#last-stop")).to_have_text("")
            busy.keyboard.press("Escape")
            expect(busy.locator("#stop")).to_have_attribute("data-state", "stopped")
            expect(busy.locator("#stop-robot")).to_have_text(served.port)
            expect(busy.locator("#last-stop")).to_contain_text(
                f"{served.port} confirmed by its board, through process {os.getpid()}"
            )
            assert _faults(client) == (wire.Fault.STOPPED,)
    with Client(open_transport(robot.port)) as client:
        assert _faults(client) == (wire.Fault.STOPPED,)


def _faults(client: Client) -> tuple[wire.Fault, ...]:
    return wire.Fault.from_mask(client.request(wire.GetStatus()).faults)


def test_run_that_does_not_answer_is_not_said_to_be_stopped(page: Page) -> None:
    page.keyboard.press("Escape")
    expect(page.locator("#stop")).to_contain_text("Not confirmeduse the e-stop")
