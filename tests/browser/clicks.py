"""Clicks on the page, counted, and those that the table of docs/watch.md states."""

from __future__ import annotations

import re
from pathlib import Path

from playwright.sync_api import Page

_PAGE = Path(__file__).resolve().parents[2] / "docs" / "watch.md"
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
    """Clicks that the table has for a job."""
    rows = re.findall(r"^\| ([^|]+) \| [^|]+ \| (\d+) \|", _PAGE.read_text(), re.MULTILINE)
    return int(dict(rows)[job])
