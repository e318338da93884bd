"""A run on the page: what is seen of it, by how many, and what a page that stalls costs."""

from __future__ import annotations

import asyncio
import json
import threading
from pathlib import Path

import aiohttp
import pytest
from browsing import Looking, Served
from playwright.sync_api import Page, expect
from scripted import ScriptedRun

from thigmo.exploration.states import State


def _rows(page: Page) -> int:
    """Readings that the page's charts hold."""
    return page.evaluate("thigmo.store.columns[0].length")


def _until_rows(page: Page, count: int) -> None:
    page.wait_for_function("count => thigmo.store.columns[0].length >= count", arg=count)


def _read(run: ScriptedRun, pages: list[Page], count: int) -> None:
    """Readings as they come from a robot: few enough at a time for all of them to be drawn."""
    for page in pages:
        _expect_connected(page)
    for _ in range(count // 40):
        held = [_rows(page) for page in pages]
        run.read(40)
        for page, rows in zip(pages, held, strict=True):
            _until_rows(page, rows + 40)


def test_page_shows_state_readings_contact_and_events(page: Page, run: ScriptedRun) -> None:
    run.event("armed", "info", "The board is armed.")
    run.feel()
    run.read(400)
    expect(page.locator("#run-name")).to_have_text("scripted")
    expect(page.locator("#doing")).to_have_text("sweeping")
    expect(page.locator("#clock")).to_have_text("2.0")
    expect(page.locator("#contact-rows")).to_contain_text("31.2 of 40.0 cm 29.8 to 32.7 cm")
    expect(page.locator("#contact-rows")).to_contain_text("x 27.5, y 11.6 cm")
    expect(page.locator("#events")).to_contain_text("The board is armed.")
    expect(page.locator("#room")).to_contain_text("95 %: 29.8 to 32.7 cm")
    expect(page.locator("#body")).to_contain_text("probability density of a contact")
    # Each chart has an axis in the unit that its title names.
    units = page.locator("#charts .unit").all_inner_texts()
    assert units == ["psi", "1/cm", "1/cm", "mA", "cm", "share of full duty"]
    shown = page.evaluate(
        "import('./store.js').then(({ store, latest, COLUMN }) => "
        "[latest(COLUMN.length), latest(COLUMN.curvature + 4)])"
    )
    assert shown == [40.0, None]


def test_a_force_is_in_newtons_where_the_stiffness_is_known(page: Page, run: ScriptedRun) -> None:
    force = page.locator("#contact-rows td:nth-child(3)")
    run.feel()
    expect(force).to_have_text("0.00021 1/cm² (over EI)")
    run.feel(force_n=0.081, force_interval_n=[0.042, 0.13])
    expect(force).to_have_text("0.081 (0.042 to 0.13) N")


def _ribbon(page: Page) -> str:
    """How the posterior is drawn in the room; on an outline in dashes if the body has moved on."""
    return page.locator('#room [data-layer="posterior"]').inner_html()


def _drawn_otherwise(page: Page, before: str) -> None:
    page.wait_for_function(
        "before => document.querySelector('#room [data-layer=\"posterior\"]').innerHTML !== before",
        arg=before,
    )


def test_posterior_of_mid_sweep_moves_with_the_body_until_the_contact_is_measured(
    page: Page, run: ScriptedRun
) -> None:
    run.read(20)
    run.bend(0.006)
    run.believe(sweeping=True)
    density = page.locator("#body")
    expect(density).to_contain_text("contact, by the sweeps so far, left muscle")
    _drawn_otherwise(page, "")
    first = _ribbon(page)
    assert "dash" not in first
    run.read(20)
    run.bend(0.009)  # the posterior is still the same one
    _drawn_otherwise(page, first)
    second = _ribbon(page)
    assert "dash" not in second
    run.read(200)  # the robot has gone on for a second, and the posterior has not
    _drawn_otherwise(page, second)
    assert "dash" in _ribbon(page)
    run.bend(0.014)
    run.believe(sweeping=False)
    expect(density).to_contain_text("contact, by all its sweeps, left muscle")


def test_page_that_comes_in_the_next_sweep_shows_no_posterior_of_the_last_one(
    looking: Looking, served: Served, run: ScriptedRun
) -> None:
    run.state()
    run.feel()
    run.state(stage_cm=50.0)
    run.read(20)
    page = looking.open(served.address)
    expect(page.locator("#body")).to_contain_text("no contact measured at this stage yet")
    expect(page.locator("#contact-rows")).to_contain_text("31.2")
    assert _ribbon(page) == ""
    run.state(state="GROW", stage_cm=60.0)  # and again at rest, until the next sweep
    expect(page.locator("#body")).to_contain_text(
        "probability density of a contact, by all its sweeps, left"
    )


def test_posterior_that_is_even_along_the_body_is_drawn_level_in_uneven_cells(
    page: Page, run: ScriptedRun
) -> None:
    widths = [0.5] * 40 + [0.1, 0.3] * 40 + [4.0]  # of 40 cm in all
    middles = [sum(widths[:n]) + width / 2 for n, width in enumerate(widths)]
    run.believe(sweeping=False, places=middles, weights=widths)
    expect(page.locator("#body")).to_contain_text("probability density of a contact")
    drawn = page.locator("#body path").nth(1).get_attribute("d") or ""
    heights = {float(point.split()[1]) for point in drawn[1:].split("L")}
    assert len(heights) == 1


def test_fault_stands_at_the_top_with_what_to_do_next(page: Page, run: ScriptedRun) -> None:
    run.event("flex_open", "fault", "Left sensor 2 is open.", "Look at its plug.")
    run.read(10, faults=("flex_open",))
    banner = page.locator(".banner.fault")
    expect(banner).to_contain_text("Left sensor 2 is open.")
    expect(banner).to_contain_text("Look at its plug.")


def test_reloaded_page_has_the_run_again_and_still_operates(page: Page, run: ScriptedRun) -> None:
    run.feel()
    _read(run, [page], 400)
    page.reload()
    expect(page.locator("#contact-rows")).to_contain_text("31.2")
    _until_rows(page, 75)  # of what was before, some fifty rows a second
    expect(page.locator("#pause")).to_be_enabled()


LOSE = """() => new Promise((lost) => {
  const send = WebSocket.prototype.send;
  WebSocket.prototype.send = function () {
    WebSocket.prototype.send = send;
    this.addEventListener("close", lost);
    this.close();
  };
})"""


def test_page_whose_connection_breaks_has_the_run_again_once(page: Page, run: ScriptedRun) -> None:
    run.event("armed", "info", "The board is armed.")
    _expect_connected(page)
    run.read(20)
    _until_rows(page, 20)  # what came with the next forty would be thinned out
    run.feel()
    _read(run, [page], 400)
    page.evaluate(LOSE)
    run.read(20)
    expect(page.locator("#clock")).to_have_text("2.2")
    expect(page.locator("#events li")).to_have_count(1)
    expect(page.locator("#contact-rows tr")).to_have_count(1)
    assert page.evaluate("thigmo.store.columns[0][0]") == pytest.approx(0.005)


def test_second_page_looks_while_the_first_operates_and_operates_when_it_has_gone(
    page: Page, looking: Looking, served: Served, run: ScriptedRun
) -> None:
    page.locator("#pause").click()
    assert run.heard.wait(60)
    run.heard.clear()
    second = looking.open(served.address)
    expect(second.locator("#pause")).to_be_disabled()
    expect(second.locator("#operated")).to_have_text("Another page operates")
    expect(second.locator("#viewers")).to_have_text("2 pages look at this robot.")
    _read(run, [page, second], 40)
    page.close()
    expect(second.locator("#operated")).to_be_hidden()
    second.locator("#pause").click()  # it says "Do not pause"
    assert run.heard.wait(60)
    assert run.asked == ["pause", "resume"]


@pytest.mark.usefixtures("page")
def test_second_page_can_stop(looking: Looking, served: Served, run: ScriptedRun) -> None:
    second = looking.open(served.address)
    expect(second.locator("#stop")).to_have_attribute("data-state", "ready")
    second.keyboard.press("Space")
    assert run.heard.wait(60)
    assert run.asked == ["stop"]


def test_page_that_stalls_is_told_what_it_missed_and_slows_no_other(
    page: Page, served: Served, run: ScriptedRun
) -> None:
    missed: list[int] = []
    may_go_on = threading.Event()
    stalls = threading.Event()
    viewer = threading.Thread(
        target=lambda: asyncio.run(_stall(served.address, stalls, may_go_on, missed))
    )
    viewer.start()
    stalls.wait()
    # More than waits for one viewer, in pieces that the first page takes as they come.
    _read(run, [page], 2400)
    may_go_on.set()
    viewer.join()
    assert missed
    assert missed[-1] >= 1000
    assert page.evaluate("thigmo.store.dropped") == 0
    assert _rows(page) == 2400


def _expect_connected(page: Page) -> None:
    expect(page.locator("#stop")).to_have_attribute("data-state", "ready")


async def _stall(
    address: str, stalls: threading.Event, may_go_on: threading.Event, missed: list[int]
) -> None:
    """A viewer that answers nothing until it may, and then reads on until it hears what it
    missed."""
    origin = address.partition("/?")[0]
    async with (
        aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as session,
        session.get(address),
        session.ws_connect(f"{origin}/stream", headers={"Origin": origin}) as socket,
    ):
        await socket.receive()
        stalls.set()
        await asyncio.to_thread(may_go_on.wait)
        async for message in socket:
            for part in json.loads(message.data):
                if part["channel"] == "dropped":
                    missed.append(part["count"])
                    return
            await socket.send_str('{"ack":1}')


# Labels of both drawings that are cut off at their card's edge.
BEYOND = """[...document.querySelectorAll("#room text, #body text")].filter((label) => {
  const words = label.getBoundingClientRect();
  const card = label.closest(".card").getBoundingClientRect();
  return words.left < card.left || words.right > card.right;
}).map((label) => label.textContent)"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_page_fits_a_phone(looking: Looking, served: Served, run: ScriptedRun, scheme: str) -> None:
    page = looking.open(
        served.address,
        viewport={"width": 390, "height": 844},
        is_mobile=True,
        has_touch=True,
        color_scheme=scheme,
    )
    run.state()
    run.feel()
    run.read(200)
    expect(page.locator("#contact-rows")).to_contain_text("31.2")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    # A port's name has no place to break at.
    page.evaluate("document.querySelector('#operate').hidden = false")
    page.evaluate("document.querySelector('#finish').hidden = false")
    name = "/dev/serial/by-id/usb-Arduino_www.arduino.cc_0042_7503530363635121E0A2-if00"
    page.evaluate("name => document.querySelector('#finish-robot').textContent = name", name)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    expect(page.locator("#body")).to_contain_text("left muscle")
    assert page.evaluate(BEYOND) == []
    box = page.locator("#stop").bounding_box()
    assert box is not None
    assert box["width"] > 340
    assert 844 - 100 < box["y"] < 844 - 60  # under the thumb, wherever the page is scrolled to


@pytest.mark.parametrize("width", [1440, 1280, 768, 390])
def test_header_shows_all_of_the_longest_sentence_beside_its_buttons(
    looking: Looking, served: Served, run: ScriptedRun, width: int
) -> None:
    run.state(doing=f"{max(State, key=len)} at 50 cm")
    for _ in range(2):  # the second one has another button
        page = looking.open(served.address, viewport={"width": width, "height": 900})
        expect(page.locator("#doing")).to_contain_text("at 50 cm")
        _expect_connected(page)
        cut = page.evaluate(
            "[...document.querySelectorAll('header *')].filter((each) => each.offsetParent && "
            "each.scrollWidth > each.clientWidth + 1 && each.clientWidth).map((each) => each.id)"
        )
        assert cut == []
        assert page.evaluate("document.documentElement.scrollWidth") <= width


# Labels of contacts that lie on the body or on a peg, at any of 60 points of each.
COVERING = """[...document.querySelectorAll('#room [data-layer="labels"] text')].filter((label) => {
  const { x, y, width, height } = label.getBBox();
  const things = document.querySelectorAll(
    '#room [data-layer="body"] path:first-child, #room [data-layer="truth"] circle');
  return [...Array(60).keys()].some((n) => {
    const point = new DOMPoint(x + (n % 20) / 19 * width, y + Math.floor(n / 20) / 2 * height);
    return [...things].some((thing) => thing.isPointInFill(point));
  });
}).map((label) => label.textContent)"""


def test_label_of_a_contact_covers_neither_the_body_nor_a_peg(
    looking: Looking, served: Served, tmp_path: Path
) -> None:
    peg = {"x_cm": 25.0, "y_cm": -8.0, "radius_cm": 0.6}
    (tmp_path / "contacts.json").write_text(json.dumps({"truth": {"pegs": [peg]}}))
    with ScriptedRun(folder=str(tmp_path)) as run:
        page = looking.open(served.address)
        run.state()
        run.feel(x_cm=20.0, y_cm=-4.6)
        run.read(20)
        labels = page.locator('#room [data-layer="labels"] text')
        expect(labels).to_have_count(2)
        expect(page.locator('#room [data-layer="truth"] circle')).to_have_count(1)
        assert page.evaluate(COVERING) == []
        before = labels.first.get_attribute("y") or ""
        run.bend(-0.014)  # onto the label
        expect(labels.first).not_to_have_attribute("y", before)
        assert page.evaluate(COVERING) == []
        page.close()  # at its end it would ask for the run's record, which this one has not
