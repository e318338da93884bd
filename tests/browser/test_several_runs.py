"""One viewer, one run: which it is when several share a robot's address."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from browsing import Looking, Served
from playwright.sync_api import Page, expect
from scripted import ScriptedRun

ServePage = Callable[..., Served]


def _name(page: Page) -> str | None:
    name: str | None = page.evaluate("thigmo.store.page?.run?.name ?? null")
    return name


def test_start_shows_the_run_that_it_started_and_stop_stops_that_one(
    looking: Looking, serve_page: ServePage, tmp_path: Path
) -> None:
    url = "emulator://empty"
    page = looking.open(serve_page(url=url, explore=("--out", str(tmp_path))).address)
    page.locator("#start").click()  # in real time
    expect(page.locator("#doing")).to_have_text("Starting")
    with ScriptedRun(name="another", url=url, pid=1) as another:
        another.state()
        expect(page.locator("#stop")).to_have_attribute("data-state", "ready")
        expect(page.locator("#run-name")).to_have_text("empty")
        page.keyboard.press("Space")
        expect(page.locator("#stop")).to_contain_text("the board has confirmed")
        expect(page.locator("#last-stop")).to_contain_text("pressed on this computer: emulator")
        expect(page.locator("#doing")).to_contain_text("Stopped from this page, ")
        assert another.asked == []


def test_page_lists_the_runs_of_an_address_and_shows_the_one_that_is_chosen(
    looking: Looking, serve_page: ServePage
) -> None:
    with ScriptedRun(name="first", pid=1) as first, ScriptedRun(name="second", pid=2) as second:
        page = looking.open(serve_page(url="emulator://scripted").address)
        first.state()
        second.state()
        expect(page.locator("#choice option")).to_have_text(
            ["first, process 1", "second, process 2"]
        )
        shown = _name(page)
        hidden = "first" if shown == "second" else "second"
        page.locator("#choice").select_option("1" if hidden == "first" else "2")
        expect(page.locator("#run-name")).to_have_text(hidden)
        page.keyboard.press("Escape")
        run = first if hidden == "first" else second
        assert run.heard.wait(60)
        assert (first.asked, second.asked).count([]) == 1
        run.close()
        expect(page.locator("#run-name")).to_have_text(shown or "")  # the other goes on
        expect(page.locator("#last-stop")).to_contain_text("pressed on this computer: emulator")
