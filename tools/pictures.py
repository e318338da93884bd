"""Pictures of the page, before, during and after a run, in light, dark and on a phone.

    .venv/bin/python tools/pictures.py

explores a room with two pegs on the emulator, with the page open in Chromium (`apt-get install
chromium`; with `fonts-inter` they look as they do in the repository). It keeps the page before
Start, at a moment of a sweep that measures a contact, after the run, and of its record with the
player, all in build/pictures, to be looked at. Those that the documentation shows go to
docs/pictures as well.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "build" / "pictures"
SHOWN = ROOT / "docs" / "pictures"
WORDS_MS = 300_000  # until a page has what it shows
RUN_MS = 600_000  # until a run has come to the moment of the picture
LOOKS = {
    "watch": {"viewport": {"width": 1440, "height": 1180}, "color_scheme": "light"},
    "watch-dark": {"viewport": {"width": 1440, "height": 1180}, "color_scheme": "dark"},
    "watch-phone": {
        "viewport": {"width": 390, "height": 844},
        "device_scale_factor": 2,
        "is_mobile": True,
        "has_touch": True,
        "color_scheme": "light",
    },
}
# One contact is on the map, and a sweep measures again: its posterior lies on the moving body. The
# muscles' pressures are columns 1 and 2. In real time, so that what is drawn is of one moment.
MEASURES = """() => {
  const { last, now, origin, columns } = thigmo.store;
  return last.contacts?.contacts.length && last.state?.state === "MEASURE"
    && last.state.stage_cm >= 50 && last.posterior?.sweeping && last.posterior.places_cm.length
    && now - (last.posterior.t_s - origin) < .2
    && Math.max(columns[1].at(-1), columns[2].at(-1)) > 5;
}"""
DRAWN = "() => new Promise((go) => setTimeout(go, 600))"


@contextmanager
def served(*arguments: str) -> Iterator[str]:
    """`thigmo watch`: the address of its page."""
    watch = [sys.executable, "-m", "thigmo", "watch", "--no-browser", "--port", "0", *arguments]
    process = subprocess.Popen(watch, text=True, stderr=subprocess.PIPE)
    assert process.stderr is not None
    try:
        for line in process.stderr:
            if "http://" in line:
                yield "http://" + line.partition("http://")[2].partition(" ")[0]
                return
        sys.exit("thigmo watch has ended; run it by hand to see why")
    finally:
        process.terminate()
        process.wait()


def keep(page: Page, name: str) -> None:
    """A picture of what is in view."""
    path = PICTURES / f"{name}.png"
    # Its banners tell how busy this computer is.
    page.evaluate("document.getElementById('banners').hidden = true")
    page.screenshot(path=path)
    with Image.open(path) as picture:
        picture.convert("RGB").save(path, optimize=True)
    if (SHOWN / path.name).exists():
        shutil.copy(path, SHOWN)
    print(f"{path}: {path.stat().st_size // 1024} kB")


def opened(browser: Browser, address: str, name: str) -> Page:
    """The page in one of the looks."""
    page = browser.new_context(**LOOKS[name]).new_page()
    page.set_default_timeout(WORDS_MS)
    page.goto(address)
    return page


def explored(browser: Browser, runs: str) -> None:
    """A run before, during and after it, in all looks."""
    with served("emulator://two_pegs", "--out", runs) as address:
        pages = {name: opened(browser, address, name) for name in LOOKS}
        first = pages["watch"]
        for name, page in pages.items():
            page.locator("#start").wait_for()
            page.evaluate(DRAWN)
            keep(page, f"{name}-before")
        first.locator("#pace").select_option("realtime")
        first.locator("#parameters summary").click()
        first.locator('[data-flag="--seed"]').fill("1")
        first.locator("#parameters summary").click()
        first.locator("#start").click()
        first.wait_for_function(MEASURES, timeout=RUN_MS)
        # All three at one moment, before its readings look old, however long a picture takes.
        run = int(first.evaluate("thigmo.store.page.run.id").split()[0])
        os.kill(run, signal.SIGSTOP)
        first.evaluate(DRAWN)
        for page in pages.values():
            page.evaluate("thigmo.still = true")
        for name, page in pages.items():
            keep(page, name)
            page.evaluate("thigmo.still = false")
        os.kill(run, signal.SIGCONT)
        for name, page in pages.items():
            page.locator("#result-map").wait_for(timeout=RUN_MS)
            page.evaluate("scrollTo(0, 0)")
            page.evaluate(DRAWN)
            keep(page, f"{name}-after")
            page.close()


def looked_back_at(browser: Browser, run: Path) -> None:
    """The finished run, with its player."""
    with served(str(run)) as address:
        page = opened(browser, address, "watch")
        page.wait_for_function("() => thigmo.store.columns[0].length > 0")
        page.wait_for_function("() => document.querySelector('#room image')")
        # Where this computer keeps its runs is nobody's business.
        page.evaluate(f"document.getElementById('result-folder').textContent = 'runs/{run.name}'")
        keep(page, "watch-record")


def main() -> None:
    """Make all pictures."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    chromium = os.environ.get("CHROMIUM", "/usr/bin/chromium")
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as runs:
        browser = playwright.chromium.launch(executable_path=chromium)
        explored(browser, runs)
        looked_back_at(browser, next(Path(runs).iterdir()))
        browser.close()


if __name__ == "__main__":
    main()
