"""Questions of a run on the page: what an answer lacks is said before it is sent."""

from __future__ import annotations

from playwright.sync_api import Page, expect
from scripted import ScriptedRun


def test_an_empty_answer_and_one_that_is_no_number_say_what_is_missing(
    page: Page, run: ScriptedRun
) -> None:
    run.ask("Measure the everted length. How many cm?", "cm")
    answer, missing = page.locator("#answer"), page.locator("#answer-missing")
    expect(answer).to_be_focused()
    page.keyboard.press("Enter")
    expect(missing).to_have_text("The number is missing: type it in cm, such as 20.5.")
    page.keyboard.type("about 20")
    page.keyboard.press("Enter")
    expect(missing).to_have_text("“about 20” is not a number of cm: type one such as 20.5.")
    assert run.asked == []
    answer.fill("20,5 cm")
    page.keyboard.press("Enter")
    assert run.heard.wait(60)
    assert run.answers == ["20,5 cm"]


def test_a_request_takes_a_button_and_no_text(page: Page, run: ScriptedRun) -> None:
    run.ask("Set the body pressure to 1.5 psi (10.3 kPa).")
    expect(page.locator("#answer-send")).to_have_text("Done")
    expect(page.locator("#answer")).to_be_hidden()
    expect(page.locator("#doing")).to_have_text("Waiting for your answer")
    page.locator("#answer-send").click()
    assert run.heard.wait(60)
    assert run.answers == [""]
