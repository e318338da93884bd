"""Pictures of the page for the documentation: docs/pictures/watch*.png.

    .venv/bin/python tools/pictures.py

explores a room with two pegs on the emulator, with the page open in Chromium (`apt-get install
chromium`; with `fonts-inter` they look as they do in the repository), and keeps a moment of a sweep
that measures a contact, in light, dark and on a phone, and the finished run with its player.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

PICTURES = Path(__file__).resolve().parents[1] / "docs" / "pictures"
EVER_MS = 600_000
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
# muscles' pressures are columns 1 and 2.
MEASURES = """() => {
  const { last, now, origin, columns } = thigmo.store;
  return last.contacts?.contacts.length && last.state?.state === "MEASURE"
    && last.state.stage_cm >= 50 && last.posterior?.sweeping && last.posterior.places_cm.length
    && now - (last.posterior.t_s - origin) < .2
    && Math.max(columns[1].at(-1), columns[2].at(-1)) > 5;
}"""
DRAWN = "() => new Promise((go) => setTimeout(go, 600))"


def served(*arguments: str) -> tuple[subprocess.Popen[str], str]:
    """`thigmo watch`, and the address of its page."""
    watch = [sys.executable, "-m", "thigmo", "watch", "--no-browser", "--port", "0", *arguments]
    process = subprocess.Popen(watch, text=True, stderr=subprocess.PIPE)
    assert process.stderr is not None
    for line in process.stderr:
        if "http://" in line:
            return process, "http://" + line.partition("http://")[2].partition(" ")[0]
    sys.exit("thigmo watch has ended; run it by hand to see why")


def keep(page: Page, name: str) -> None:
    """A picture of what is in view."""
    path = PICTURES / f"{name}.png"
    # Its banners tell how busy this computer is.
    page.evaluate("document.getElementById('banners').hidden = true")
    page.screenshot(path=path)
    with Image.open(path) as picture:
        picture.convert("RGB").save(path, optimize=True)
    print(f"{path}: {path.stat().st_size // 1024} kB")


def opened(browser: Browser, address: str, name: str) -> Page:
    """The page in one of the looks."""
    page = browser.new_context(**LOOKS[name]).new_page()
    page.set_default_timeout(EVER_MS)
    page.goto(address)
    return page


def main() -> None:
    """Make all pictures."""
    PICTURES.mkdir(exist_ok=True)
    chromium = os.environ.get("CHROMIUM", "/usr/bin/chromium")
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as runs:
        browser = playwright.chromium.launch(executable_path=chromium)
        process, address = served("emulator://two_pegs", "--out", runs)
        pages = {name: opened(browser, address, name) for name in LOOKS}
        first = pages["watch"]
        first.locator("#pace").select_option("fast")
        first.locator("#parameters summary").click()
        first.locator('[data-flag="--seed"]').fill("1")
        first.locator("#parameters summary").click()
        first.locator("#start").click()
        first.wait_for_function(MEASURES)
        # All three at one moment, however long a picture takes.
        run = int(first.evaluate("thigmo.store.page.run.id").split()[0])
        os.kill(run, signal.SIGSTOP)
        for page in pages.values():
            page.evaluate(DRAWN)
            page.evaluate("thigmo.still = true")
        for name, page in pages.items():
            keep(page, name)
        os.kill(run, signal.SIGCONT)
        first.evaluate("thigmo.still = false")
        first.wait_for_function("() => thigmo.store.page.ended")
        process.terminate()
        process.wait()
        process, address = served(str(next(Path(runs).iterdir())))
        page = opened(browser, address, "watch")
        page.wait_for_function("() => thigmo.store.columns[0].length > 0")
        page.wait_for_function("() => document.querySelector('#room image')")
        keep(page, "watch-record")
        process.terminate()
        process.wait()
        browser.close()


if __name__ == "__main__":
    main()
