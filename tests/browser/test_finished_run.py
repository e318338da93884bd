"""A finished run on the page, and the player that moves the moment shown."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from browsing import Looking, Served
from emulated import room_file
from playwright.sync_api import Page, expect
from scripted import ScriptedRun

from thigmo.design import draft
from thigmo.emulator.reach import room_for
from thigmo.exploration import ExplorationResult, explore

ServePage = Callable[..., Served]


@pytest.fixture(scope="module")
def finished(late_url: str, tmp_path_factory: pytest.TempPathFactory) -> ExplorationResult:
    """The end of an exploration of the default room."""
    return explore(late_url, seed=1, out=tmp_path_factory.mktemp("finished"))


def _shown_s(page: Page) -> float:
    shown: float = page.evaluate("thigmo.store.now")
    return shown


def test_page_rounds_as_terminal_and_map_do(
    looking: Looking, serve_page: ServePage, finished: ExplorationResult
) -> None:
    page = looking.open(serve_page(past=finished.folder).address)
    numbers = [step / 80 for step in range(-800, -80)] + [step / 80 for step in range(4000)]
    numbers += [38.35, 38.45, 1.005, 0.285, 99.95]
    for digits in range(4):
        shown = page.evaluate(
            """async ([numbers, digits]) => {
                const { rounded } = await import(new URL("svg.js", document.baseURI));
                return numbers.map((number) => rounded(number, digits));
            }""",
            [numbers, digits],
        )
        assert shown == [f"{number:.{digits}f}".replace("-", "−") for number in numbers]


def test_player_shows_any_moment_of_a_finished_run(
    looking: Looking, serve_page: ServePage, finished: ExplorationResult
) -> None:
    page = looking.open(serve_page(past=finished.folder).address)
    expect(page.locator("#run-name")).to_have_text("late")
    (contact,) = finished.document.contacts
    expect(page.locator("#contact-rows")).to_contain_text(f"{contact.arc_cm:.1f}")
    expect(page.locator("#doing")).to_have_text("Ended: full length")
    expect(page.locator("#stop")).to_be_hidden()  # nothing is connected
    end_s = _shown_s(page)
    assert end_s > 10.0

    expect(page.locator("#position")).to_contain_text("of")  # all of it is loaded
    page.keyboard.press("Home")
    expect(page.locator("#contacts-empty")).to_be_visible()
    assert _shown_s(page) == 0.0
    page.keyboard.press("Shift+ArrowRight")
    assert _shown_s(page) == 10.0
    page.keyboard.press("Space")  # never plays: it is the stop's
    expect(page.locator("#play")).to_have_text("Play")
    page.keyboard.press("p")
    expect(page.locator("#play")).to_have_text("Hold")
    page.wait_for_function("() => thigmo.store.now > 11")
    page.keyboard.press("End")
    expect(page.locator("#contact-rows tr")).to_have_count(1)
    assert _shown_s(page) == end_s


def test_run_that_begins_while_a_record_plays_is_shown_alone(
    looking: Looking, serve_page: ServePage, finished: ExplorationResult
) -> None:
    with ScriptedRun(name="first", folder=str(finished.folder)) as first:
        page = looking.open(serve_page().address)
        first.state()
        first.read(20)
        expect(page.locator("#run-name")).to_have_text("first")
    page.locator("#open-record").click()
    expect(page.locator("#contact-rows tr")).to_have_count(1)  # all of it is loaded
    page.keyboard.press("Home")
    page.keyboard.press("p")
    with ScriptedRun(name="second") as second:
        second.state()
        expect(page.locator("#run-name")).to_have_text("second")
        second.read(40)
        expect(page.locator("#clock")).to_have_text("0.2")
        expect(page.locator("#play")).to_have_text("Play")  # no longer
        for _ in range(3):
            page.evaluate("new Promise(requestAnimationFrame)")
            assert _shown_s(page) == pytest.approx(0.2)
        expect(page.locator("#contacts-empty")).to_be_visible()


def test_readings_on_the_page_are_those_of_the_record(
    looking: Looking, serve_page: ServePage, finished: ExplorationResult
) -> None:
    from thigmo.stream import Telemetry, read_messages

    readings = [
        message for message in read_messages(finished.folder) if isinstance(message, Telemetry)
    ]
    page = looking.open(serve_page(past=finished.folder).address)
    page.wait_for_function("() => thigmo.store.columns[0].length > 0")
    length, pressures = page.evaluate("[thigmo.store.columns[0].length, thigmo.store.columns[1]]")
    assert length == len(readings)
    assert pressures == pytest.approx([message.pressure_psi[0] for message in readings], abs=1e-5)


def test_folder_without_a_record_is_refused(serve_page: ServePage, tmp_path: Path) -> None:
    from thigmo.errors import RunFolderError

    with pytest.raises(RunFolderError):
        serve_page(past=tmp_path)


def test_a_robot_of_one_column_shows_its_own_muscle_and_sensors(
    looking: Looking, serve_page: ServePage, tmp_path: Path
) -> None:
    scene = room_for(draft(120.0, 8, 1), 1)
    scene.start_length_cm = 101.5
    exploration = explore(room_file(tmp_path, scene), seed=1, out=tmp_path / "runs")
    page = looking.open(serve_page(past=exploration.folder).address)
    expect(page.locator("#doing")).to_have_text("Ended: full length")
    expect(page.locator("#body-legend")).to_contain_text("270 deg sensor")
    charts = page.locator("#charts h3")
    expect(charts).to_have_count(5)  # one of curvature
    expect(charts.nth(0)).to_contain_text("left")
    assert "right" not in page.locator("#charts").inner_text()
    expect(charts.nth(1).locator("i:not(.dash)")).to_have_count(8)
    # Each sensor that is out is drawn on the body, in a colour.
    drawn = page.locator("[data-layer=body] path[stroke^='var(--right-']")
    expect(drawn).to_have_count(8)
