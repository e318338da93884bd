"""Stop on the page: what presses it, and what it says, also when nobody would hear."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from browsing import Looking, Served
from playwright.sync_api import Page, expect
from scripted import ScriptedRun

from thigmo.cli.watch import parameters

ServePage = Callable[..., Served]


@pytest.mark.parametrize("key", ["Space", "Escape"])
def test_key_stops_wherever_the_focus_is(page: Page, run: ScriptedRun, key: str) -> None:
    page.locator("#pause").focus()
    page.keyboard.press(key)
    assert run.heard.wait(60)
    run.close()
    expect(page.locator("#stop")).to_have_text("Stoppedthe board has confirmed")
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
    expect(page.locator("#stop")).to_have_text("Stop not connected:use the e-stop")
    expect(page.locator(".banner.fault")).to_contain_text("Stop not connected: use the e-stop.")
    page.close()  # it would look for the server again, in this line's next moment as well
    looking.errors.clear()  # Chromium tells the lost connection on the console itself


def test_port_that_nobody_owns_says_use_the_e_stop(looking: Looking, serve_page: ServePage) -> None:
    with ScriptedRun(virtual=False) as run:
        page = looking.open(serve_page().address)
        run.state()
        expect(page.locator("#stop")).to_have_text("Stop not connected:use the e-stop")


def test_run_that_does_not_answer_is_not_said_to_be_stopped(page: Page) -> None:
    page.keyboard.press("Escape")
    expect(page.locator("#stop")).to_have_text("Not confirmeduse the e-stop")
