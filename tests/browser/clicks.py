"""Clicks on the page, counted, and those that the table of docs/watch.md states."""

from __future__ import annotations

import re
from pathlib import Path

from playwright.sync_api import Page

_PAGE = Path(__file__).resolve().parents[2] / "docs" / "watch.md"
_CLICK_S = 2.65  # to decide, point and press, by the keystroke-level model
_COUNT = """() => {
  if (!("clicks" in window))
    addEventListener("pointerdown", (event) => { window.clicks += event.isTrusted; }, true);
  window.clicks = 0;
}"""


def counted(page: Page) -> Page:
    """The page, whose clicks are counted from now on."""
    page.evaluate(_COUNT)
    return page


def clicks(page: Page) -> int:
    """Clicks on a counted page."""
    return int(page.evaluate("clicks"))


def stated(job: str) -> int:
    """Clicks that the table has for a job; its seconds must be those of as many clicks or more."""
    line = r"^\| ([^|]+) \| [^|]+ \| (\d+), ([\d.]+) s \|"
    rows = {name: rest for name, *rest in re.findall(line, _PAGE.read_text(), re.MULTILINE)}
    clicks, seconds = rows[job]
    assert float(seconds) >= round(_CLICK_S * int(clicks), 1)
    return int(clicks)
