"""The page as a workbench: what to expect of an effort, a run's result, and the runs before it."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from browsing import Looking, Served
from clicks import clicks, counted, stated
from contacts import CONTACT, run_folder
from playwright.sync_api import Page, expect
from scripted import ScriptedRun

from thigmo.cli.watch import expected_efforts, parameters
from thigmo.config import RobotConfig
from thigmo.exploration import ExplorationResult, expectations, explore

ServePage = Callable[..., Served]
SPANS = """async () => {
  const { spans } = await import(new URL("charts.js", document.baseURI));
  return spans();
}"""
CHOSEN = """async () => {
  const { parameters } = await import(new URL("operate.js", document.baseURI));
  return parameters();
}"""


@pytest.fixture(scope="module")
def pair(
    late_url: str, tmp_path_factory: pytest.TempPathFactory
) -> tuple[ExplorationResult, ExplorationResult]:
    """Two explorations of the default room, in one folder."""
    out = tmp_path_factory.mktemp("pair")
    first, second = (explore(late_url, seed=seed, out=out, name=f"run{seed}") for seed in (1, 2))
    return first, second


def test_each_effort_says_what_to_expect_and_is_passed_on(
    looking: Looking, serve_page: ServePage
) -> None:
    served = serve_page(url="/dev/ttyNONE", parameters=parameters(), expect=expected_efforts)
    page = looking.open(served.address)
    for expected in expectations(RobotConfig()):
        row = page.locator(f"[data-effort={expected.effort}]")
        expect(row).to_contain_text(f"{expected.robot_time_s:.0f} s")
        for measured in expected.measured:
            expect(row).to_contain_text(f"{measured.error_cm:.1f} cm")
    assert page.evaluate(CHOSEN) == {}  # the usual one
    page.get_by_label("careful").check()
    assert page.evaluate(CHOSEN) == {"--effort": "careful"}
    page.locator("#budget").fill("120")
    (expected,) = expectations(RobotConfig(), 120.0)
    expect(page.locator("[data-effort=budget]")).to_contain_text(f"{expected.robot_time_s:.0f} s")
    assert page.evaluate(CHOSEN) == {"--time": "120"}
    page.locator("#budget").fill("3")
    expect(page.locator("[data-effort=budget]")).to_contain_text("too little for a sweep")


def test_a_finished_run_has_its_result_on_a_card(
    looking: Looking, serve_page: ServePage, pair: tuple[ExplorationResult, ExplorationResult]
) -> None:
    first, _ = pair
    page = looking.open(serve_page(past=first.folder).address)
    card = page.locator("#result")
    expect(card).to_contain_text(f"Result: {first.document.outcome}")
    expect(card).to_contain_text(f"{first.document.robot_time_s:.0f} s")
    expect(card).to_contain_text(str(first.folder))
    assert first.document.error_cm is not None
    expect(card).to_contain_text(f"{first.document.error_cm:.1f} cm")
    with page.context.expect_page() as opened:
        page.locator("#result-map").click()
    assert opened.value.locator("img").evaluate("image => image.naturalWidth") > 100


def test_a_run_that_has_just_ended_has_a_card_too(
    looking: Looking, serve_page: ServePage, pair: tuple[ExplorationResult, ExplorationResult]
) -> None:
    first, _ = pair
    with ScriptedRun(folder=str(first.folder)) as run:
        page = looking.open(serve_page().address)
        run.state()
        expect(page.locator("#run-name")).to_have_text("scripted")
        expect(page.locator("#result")).to_be_hidden()
    expect(page.locator("#result")).to_contain_text("Result: full length")


def test_the_card_gets_a_map_that_is_drawn_after_the_end(
    looking: Looking,
    serve_page: ServePage,
    pair: tuple[ExplorationResult, ExplorationResult],
    tmp_path: Path,
) -> None:
    folder = Path(shutil.copytree(pair[0].folder, tmp_path / pair[0].folder.name))
    picture = (folder / "map.png").read_bytes()
    (folder / "map.png").unlink()
    with ScriptedRun(folder=str(folder)) as run:
        page = looking.open(serve_page().address)
        run.state()
        expect(page.locator("#run-name")).to_have_text("scripted")
    expect(page.locator("#result")).to_contain_text("Result: full length")
    expect(page.locator("#result-map")).to_be_hidden()
    (folder / "map.png").write_bytes(picture)
    expect(page.locator("#result-map")).to_be_visible()


def test_runs_are_listed_found_opened_and_laid_over_each_other(
    looking: Looking, serve_page: ServePage, pair: tuple[ExplorationResult, ExplorationResult]
) -> None:
    first, second = pair
    page = looking.open(serve_page(runs=first.folder.parent).address)
    rows = page.locator("#run-rows tr")
    expect(rows).to_have_count(2)
    expect(rows.first).to_contain_text(second.folder.name)  # the newest
    page.locator("#runs-find").fill("run1")
    expect(rows).to_have_count(1)
    rows.get_by_text("Open").click()
    expect(page.locator("#run-name")).to_have_text("run1")
    expect(page.locator("#contact-rows tr")).to_have_count(len(first.contacts))
    page.locator("#runs-find").fill("run2")
    rows.get_by_text("Overlay").click()
    expect(page.locator('#room [data-layer="overlay"] rect')).to_have_count(len(second.contacts))
    for title in page.locator("#charts h3").all():
        expect(title).to_contain_text(second.folder.name)
    compared = page.locator("#compared-rows")
    expect(compared).to_contain_text(first.contacts[0].place_text.replace("-", "−"))
    expect(compared).to_contain_text(second.contacts[0].place_text.replace("-", "−"))
    drawn = page.evaluate("thigmo.store.overlay.columns[0].length")
    assert drawn > 1000
    page.locator("#runs-clear").click()
    expect(page.locator('#room [data-layer="overlay"] rect')).to_have_count(0)
    expect(page.locator("#compared")).to_be_hidden()


def test_an_open_run_gives_way_to_one_that_begins(
    looking: Looking, serve_page: ServePage, pair: tuple[ExplorationResult, ExplorationResult]
) -> None:
    first, _ = pair
    page = looking.open(serve_page(runs=first.folder.parent).address)
    page.get_by_label(f"Open {first.folder.name}").click()
    expect(page.locator("#run-name")).to_have_text("run1")
    with ScriptedRun(name="now") as run:
        run.state()
        expect(page.locator("#run-name")).to_have_text("now")
        expect(page.locator("#stop")).to_be_visible()
        expect(page.get_by_label(f"Open {first.folder.name}")).to_be_disabled()
        page.get_by_label(f"Overlay {first.folder.name}").click()
        expect(page.locator("#overlay-legend")).to_contain_text(first.folder.name)


def test_a_page_gets_no_file_beside_the_runs(
    looking: Looking, serve_page: ServePage, tmp_path: Path
) -> None:
    run_folder(tmp_path, "secret")
    runs = tmp_path / "secret" / "runs"
    runs.mkdir()
    run_folder(runs, "mine", contacts=[CONTACT])
    served = serve_page(runs=runs)
    page = looking.open(served.address)
    root = served.address.partition("?")[0]

    def status(name: str) -> int:
        return int(page.request.get(f"{root}runs/{name}/beside/mine.json").status)

    assert status("mine") == 200
    for name in ("%2e%2e", "..%2Fsecret", "%2e%2e%2f%2e%2e", "%2Fetc", "none"):
        assert status(name) == 404, name


def test_wheel_and_drag_move_one_time_axis_of_all_charts(page: Page, run: ScriptedRun) -> None:
    run.read(4000)  # 20 s
    page.wait_for_function("() => thigmo.store.now > 19.9")
    whole = page.evaluate(SPANS)
    over = page.locator(".u-over").first
    box = over.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + box["width"] / 3, box["y"] + 30)
    page.mouse.wheel(0, -300)
    zoomed = page.evaluate(SPANS)
    assert all(span == zoomed[0] for span in zoomed)
    assert zoomed[0][1] - zoomed[0][0] < 0.8 * (whole[0][1] - whole[0][0])
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] / 3 + 30, box["y"] + 30)
    page.mouse.up()
    moved = page.evaluate(SPANS)
    assert all(span == moved[0] for span in moved)
    assert moved[0][0] < zoomed[0][0]
    assert moved[0][1] - moved[0][0] == pytest.approx(zoomed[0][1] - zoomed[0][0])
    run.read(40)  # what is looked at stays
    page.wait_for_function("() => thigmo.store.now > 20.1")
    assert page.evaluate(SPANS) == moved
    page.mouse.dblclick(box["x"] + 50, box["y"] + 30)
    assert page.evaluate(SPANS)[0][1] - page.evaluate(SPANS)[0][0] == pytest.approx(30.0)
    page.keyboard.press("+")
    assert page.evaluate(SPANS)[0][1] - page.evaluate(SPANS)[0][0] == pytest.approx(15.0)
    page.keyboard.press("0")
    assert page.evaluate(SPANS)[0][1] - page.evaluate(SPANS)[0][0] == pytest.approx(30.0)


def test_wheel_and_drag_move_the_room(page: Page, run: ScriptedRun) -> None:
    run.feel()
    contact = page.locator('#room [data-layer="contacts"] circle').first
    expect(contact).to_be_visible()
    before = contact.bounding_box()
    assert before is not None
    page.mouse.move(before["x"] + 6, before["y"] + 6)
    page.mouse.wheel(0, -240)
    expect(page.locator("#room-whole")).to_be_visible()
    after = contact.bounding_box()
    assert after is not None
    assert after["x"] == pytest.approx(before["x"], abs=3.0)  # under the pointer, it stays
    page.mouse.down()
    page.mouse.move(before["x"] + 46, before["y"] + 6)
    page.mouse.up()
    moved = contact.bounding_box()
    assert moved is not None
    assert moved["x"] == pytest.approx(after["x"] + 40, abs=1.0)
    page.locator("#room-whole").click()
    back = contact.bounding_box()
    assert back is not None
    assert back["x"] == pytest.approx(before["x"], abs=0.5)


def test_wheel_and_drag_move_along_the_body(page: Page, run: ScriptedRun) -> None:
    run.feel()
    contact = page.locator('#body circle[r="4"]')
    expect(contact).to_have_count(1)

    def where() -> float:
        box = contact.bounding_box()
        assert box is not None
        return box["x"] + box["width"] / 2

    chart = page.locator("#body").bounding_box()
    assert chart is not None
    before, y = where(), chart["y"] + 60
    written = page.locator("#body text").all_text_contents()
    page.mouse.move(before, y)
    page.mouse.wheel(0, -240)
    assert page.locator("#body text").all_text_contents() != written
    assert where() == pytest.approx(before, abs=1.0)  # under the pointer, it stays
    page.mouse.down()
    page.mouse.move(before + 40, y)
    page.mouse.up()
    assert where() == pytest.approx(before + 40, abs=1.0)
    page.mouse.dblclick(before, y)
    assert where() == pytest.approx(before, abs=0.5)
    assert page.locator("#body text").all_text_contents() == written


def test_events_are_an_operators_until_technical_ones_are_asked_for(
    page: Page, run: ScriptedRun
) -> None:
    run.event("contact", "warning", "contact felt at the base while the left muscle bends the body")
    run.read(20, faults=("bad_config",))
    run.event("bad_config", "fault", "The board has no valid configuration.")
    expect(page.locator("#events li:visible")).to_have_count(2)
    for number in range(40):
        run.event("zeroed", "info", f"{number} sensors zeroed")
    run.read(20)
    shown = page.locator("#events li:visible")
    expect(page.locator("#events li")).to_have_count(42)
    expect(shown).to_have_count(1)
    expect(page.locator("#events-count")).to_have_text("1")
    page.locator("#events-technical").press("Enter")
    expect(shown).to_have_count(42)
    events = page.locator("#events")
    events.focus()
    page.keyboard.press("PageDown")
    page.wait_for_function("() => document.getElementById('events').scrollTop > 0")


def test_a_question_mark_lists_the_keys(page: Page) -> None:
    expect(page.locator("#keys")).to_be_hidden()
    page.keyboard.press("?")
    expect(page.locator("#keys")).to_contain_text("stop the robot")
    page.keyboard.press("?")
    expect(page.locator("#keys")).to_be_hidden()
    page.locator("#runs-find").fill("what")
    page.locator("#runs-find").press("?")  # is text there
    expect(page.locator("#keys")).to_be_hidden()


NOTED = """
  window.noted = [];
  window.Notification = class {
    static permission = "granted";
    constructor(title, { body }) { noted.push([title, body]); }
  };
  document.hasFocus = () => false;
"""


def test_title_and_notification_call_for_the_operator(looking: Looking, served: Served) -> None:
    with ScriptedRun(name="hall") as run:
        page = looking.open(served.address)
        run.state()
        expect(page).to_have_title("hall · thigmo")
        page.evaluate(NOTED)
        run.ask("Set the body pressure to 1.5 psi.")
        expect(page).to_have_title("Asks you: hall · thigmo")
        run.ask("")
        expect(page).to_have_title("hall · thigmo")
        run.state(outcome="full length")
    expect(page).to_have_title("Ended: hall · thigmo")
    assert page.evaluate("noted") == [
        ["Asks you: hall", "Set the body pressure to 1.5 psi."],
        ["Ended: hall", "full length"],
    ]


def test_the_screen_has_one_word_for_certainty(page: Page, run: ScriptedRun) -> None:
    run.feel()
    run.believe(sweeping=False, status="ambiguous", message="two places fit alike")
    expect(page.locator("#contact-rows")).to_contain_text("localized")
    assert "ambiguous" not in page.locator("main").inner_text()
    assert "ambiguous" not in " ".join(page.locator("#body text").all_text_contents())


def test_clicks_to_start_a_run(looking: Looking, serve_page: ServePage) -> None:
    page = counted(looking.open(serve_page(url="emulator://nowhere").address))
    page.locator("#start").click()
    page.wait_for_function("() => thigmo.store.page.starting")
    assert clicks(page) == stated("start a run")


def test_clicks_to_stop_and_to_answer(page: Page, run: ScriptedRun) -> None:
    run.ask("Measure the everted length. How many cm?", "cm")
    expect(counted(page).locator("#answer")).to_be_focused()
    page.keyboard.type("20")
    page.locator("#answer-send").click()
    assert run.heard.wait(60)
    assert run.answers == ["20"]
    assert clicks(page) == stated("answer a question")
    run.heard.clear()
    counted(page).locator("#stop").hover()
    page.mouse.down()
    assert run.heard.wait(60)
    assert run.asked[-1] == "stop"
    assert clicks(page) == stated("stop the robot")
    page.mouse.up()


def test_clicks_to_open_and_overlay_runs_and_to_get_at_their_files(
    looking: Looking, serve_page: ServePage, pair: tuple[ExplorationResult, ExplorationResult]
) -> None:
    first, second = (run.folder for run in pair)
    page = counted(looking.open(serve_page(runs=first.parent).address))
    page.get_by_label(f"Open {first.name}").click()
    expect(page.locator("#run-name")).to_have_text("run1")
    assert clicks(page) == stated("open a finished run")
    page.get_by_label(f"Overlay {second.name}").click()
    expect(page.locator("#runs-clear")).to_be_visible()
    assert clicks(page) == stated("lay two runs over each other")
    counted(page).locator("#result-copy").click()
    assert clicks(page) == stated("get at a run's files")
