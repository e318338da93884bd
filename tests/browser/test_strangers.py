"""Who does not belong here: another site in the same browser, and whoever lacks the token."""

from __future__ import annotations

from collections.abc import Callable

from browsing import Looking, Served
from playwright.sync_api import Browser, Page, expect
from scripted import ScriptedRun

from thigmo.live.opening_file import OpeningFile

ServePage = Callable[..., Served]
TRY = """async (address) => {
  const tried = {};
  const stop = (mode) => fetch(address + "stop", { method: "POST", mode }).then(
    (answer) => answer.type, () => "refused");
  tried.stop = await stop("no-cors");
  tried.read = await fetch(address).then((answer) => answer.text(), () => "refused");
  tried.stream = await new Promise((tell) => {
    const socket = new WebSocket(address.replace("http", "ws") + "stream");
    socket.onopen = () => tell("open");
    socket.onerror = () => tell("refused");
  });
  return tried;
}"""


def test_another_site_can_neither_stop_nor_look(
    chromium: Browser, served: Served, page: Page, run: ScriptedRun
) -> None:
    context = chromium.new_context()
    site = context.new_page()
    site.route(
        "http://evil.example/", lambda route: route.fulfill(body="", content_type="text/html")
    )
    site.goto("http://evil.example/")
    tried = site.evaluate(TRY, served.address.partition("?")[0])
    context.close()
    # The browser lets the request out and the answer not in; the server refuses it.
    assert tried["stop"] in ("opaque", "refused")
    assert (tried["read"], tried["stream"]) == ("refused", "refused")
    page.keyboard.press("Escape")  # the first and only stop that arrives
    assert run.heard.wait(60)
    assert run.asked == ["stop"]
    run.close()
    expect(page.locator("#stop")).to_have_attribute("data-state", "stopped")


def test_the_page_asks_for_its_token_once(
    looking: Looking, serve_page: ServePage, run: ScriptedRun
) -> None:
    address = serve_page(host="0.0.0.0").address
    assert not address.startswith(("http://0.0.0.0", "http://127.0.0.1"))  # a phone's way here
    plain, _, token = address.partition("?token=")
    assert len(token) > 20
    stranger = looking.open(plain, refused=True)
    expect(stranger.locator("body")).to_contain_text("This page needs its token.")
    guesser = looking.open(f"{plain}?token=guess", refused=True)
    expect(guesser.locator("body")).to_contain_text("This page needs its token.")
    page = looking.open(address)
    run.state()
    expect(page.locator("#doing")).to_have_text("sweeping")
    assert page.url == plain
    page.reload()
    expect(page.locator("#doing")).to_have_text("sweeping")
    page.keyboard.press("Escape")
    assert run.heard.wait(60)
    run.close()
    expect(page.locator("#stop")).to_have_attribute("data-state", "stopped")


def test_a_browser_comes_in_by_the_file_that_leads_to_the_page(
    looking: Looking, serve_page: ServePage
) -> None:
    address = serve_page().address
    with OpeningFile(address) as leads:
        page = looking.open(address, lead=leads.url)
        expect(page.locator("#doing")).to_contain_text("Waiting for a run")
        assert page.url == address.partition("?")[0]
