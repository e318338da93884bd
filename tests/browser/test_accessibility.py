"""Everybody can use the page: axe-core has nothing to find, and a number never looks negative."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from axe_playwright_python.sync_playwright import Axe
from browsing import Looking, Served
from contacts import CONTACT, run_folder
from playwright.sync_api import Page, expect
from scripted import ScriptedRun

from thigmo.cli.watch import expected_efforts, parameters
from thigmo.record import Explanation
from thigmo.stream import Contacts

ServePage = Callable[..., Served]
PHONE = {"viewport": {"width": 390, "height": 844}, "is_mobile": True, "has_touch": True}
SCREENS = [
    {"color_scheme": "light"},
    {"color_scheme": "dark"},
    {"color_scheme": "light", **PHONE},
    {"color_scheme": "dark", **PHONE},
]
WALL = replace(
    CONTACT,
    kind="wall",
    explanations=[Explanation("wall", 0.97), Explanation("two pegs", 0.03)],
    surface=[(20.0, 11.0), (33.0, 12.4)],
    x_cm=-2.5,
)
GUESS = replace(WALL, status="ambiguous", doubt="the model does not explain these sweeps")


def _findings(page: Page) -> list[str]:
    violations = Axe().run(page).response["violations"]
    return [
        f"{violation['id']}: {node['html'][:120]}"
        for violation in violations
        for node in violation["nodes"]
    ]


@pytest.mark.parametrize("screen", SCREENS, ids=["light", "dark", "phone", "dark phone"])
def test_axe_finds_nothing_before_a_run_in_it_and_after_it(
    looking: Looking, serve_page: ServePage, tmp_path: Path, screen: dict[str, object]
) -> None:
    port = "/dev/ttyNONE"
    run_folder(tmp_path, "earlier")
    served = serve_page(url=port, parameters=parameters(), runs=tmp_path, expect=expected_efforts)
    page = looking.open(served.address, **screen)
    expect(page.locator("#run-rows tr")).to_have_count(1)
    expect(page.locator("#effort-choices tr")).to_have_count(4)
    page.locator("#keys-button").click()
    expect(page.locator("#keys")).to_be_visible()
    page.locator("#parameters summary").click()
    page.locator("#retract").click()
    expect(page.locator("#length-now")).to_be_visible()
    assert _findings(page) == []
    with ScriptedRun(url=port, virtual=False) as run:
        run.state()
        run.feel()
        run.believe(sweeping=False)
        run.hub.publish(Contacts(0.0, 0.0, (CONTACT, WALL, GUESS)))
        run.event("flex_open", "fault", "Left sensor 2 is open.", "Look at its plug.")
        run.event("contact", "warning", "contact")
        run.ask("How many cm?", "cm")
        run.read(200, faults=("flex_open",))
        expect(page.locator("#contact-rows tr")).to_have_count(3)
        expect(page.locator("#question")).to_be_visible()
        expect(page.locator(".banner.fault").first).to_be_visible()
        assert _findings(page) == []
    expect(page.locator("#finish")).to_be_visible()
    assert _findings(page) == []


def test_a_wall_is_drawn_as_a_line_and_a_guess_says_why_it_is_one(
    page: Page, run: ScriptedRun
) -> None:
    run.feel()
    run.hub.publish(Contacts(0.0, 0.0, (WALL, GUESS)))
    rows = page.locator("#contact-rows tr")
    expect(rows.first).to_contain_text("wall 97 %, two pegs 3 %")
    expect(rows.nth(1)).to_contain_text(GUESS.doubt)
    expect(page.locator('#room [data-layer="contacts"] ellipse')).to_have_count(2)
    lines = page.locator('#room [data-layer="contacts"] path[stroke-width="3"]')
    expect(lines).to_have_count(2)
    assert [lines.nth(n).get_attribute("stroke-dasharray") for n in range(2)] == [None, "7 5"]


# Every number that the page shows: a hyphen before a digit would read as a minus sign, or not.
HYPHENS = """() => [...document.querySelectorAll("text, td, output, .chip, .banner, #events .what")]
  .map((each) => each.textContent).filter((words) => /-\\d/.test(words))"""


def test_no_number_has_a_hyphen_for_a_minus_sign_and_none_follows_a_dash(
    page: Page, run: ScriptedRun
) -> None:
    run.bend(-0.02)
    run.believe(sweeping=False)
    run.hub.publish(Contacts(0.0, 0.0, (CONTACT, WALL)))
    run.event("contact", "warning", "contact: the base is -0.0050 1/cm off the free bend")
    run.read(200)
    expect(page.locator("#contact-rows tr")).to_have_count(2)
    expect(page.locator("#events")).to_contain_text("the base is −0.0050 1/cm off")
    expect(page.locator("#contact-rows")).to_contain_text("x −2.5, y 11.6 cm")
    shown = page.locator("#room text").all_text_contents()
    assert any("−" in words for words in shown)  # the axes go below zero
    assert page.evaluate(HYPHENS) == []
    # What leads to a label ends upright: a level stroke before a number is a minus sign.
    for path in page.locator('#room [data-layer="labels"] g path').all():
        assert "V" in (path.get_attribute("d") or "")


def test_room_shows_the_robot_and_what_is_known_before_start(
    looking: Looking, serve_page: ServePage, tmp_path: Path
) -> None:
    page = looking.open(
        serve_page(url="emulator://default", explore=("--out", str(tmp_path))).address
    )
    expect(page.locator('#room [data-layer="reach"] rect')).to_have_count(1)  # the base
    expect(page.locator("#room")).to_contain_text("not everted yet")
    expect(page.locator('#room [data-layer="truth"] circle')).to_have_count(1)
    expect(page.locator("#truth-legend")).to_be_visible()
    assert math.isclose(page.evaluate("thigmo.store.page.body.length_cm"), 53.0)


def test_contacts_of_a_phone_show_every_column(looking: Looking, served: Served) -> None:
    with ScriptedRun() as run:
        page = looking.open(served.address, **PHONE)
        run.state()
        run.hub.publish(Contacts(0.0, 0.0, (CONTACT, WALL)))
        expect(page.locator("#contact-rows tr")).to_have_count(2)
        for cell in page.locator("#contact-rows td").all():
            box = cell.bounding_box()
            assert box is not None
            assert box["x"] >= 0
            assert box["x"] + box["width"] <= 390
            assert cell.inner_text()
        assert page.evaluate("document.querySelector('.contacts').scrollWidth") <= 390
