"""The page in a real browser: Debian's Chromium, driven by playwright.

Every page that a test opens is listened to: an error on its console or a request that leaves this
machine fails the test, whatever it tests.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from browsing import PATIENCE_MS, Looking, Served
from playwright.sync_api import Browser, Page, expect, sync_playwright
from scripted import ScriptedRun
from served import ServedRobot
from settled import settled_robot

from thigmo.live.server import WatchOptions

CHROMIUM = os.environ.get("CHROMIUM", "/usr/bin/chromium")
expect.set_options(timeout=PATIENCE_MS)


@pytest.fixture(autouse=True)
def alone(own_sockets: None) -> None:
    """Pages see this test's runs only."""


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    """A browser. While it is open, this thread has an event loop, and other tests may run none of
    theirs: it must not stay open for them."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM)
        yield browser
        browser.close()


@pytest.fixture
def serve_page() -> Iterator[Callable[..., Served]]:
    """Serves the page with the given options, on any free port."""
    with ExitStack() as stack:

        def served(**options: Any) -> Served:
            server = Served(WatchOptions(**{"port": 0, **options}))
            stack.callback(server.close)
            return server

        yield served


@pytest.fixture
def looking(chromium: Browser, serve_page: object) -> Iterator[Looking]:
    """Opens pages; they are closed before their servers, whose end they would tell."""
    eyes = Looking(chromium)
    yield eyes
    eyes.close()
    assert eyes.outside == []
    assert eyes.errors == []


@pytest.fixture
def robot() -> Iterator[ServedRobot]:
    """A robot of 20 cm whose sensors have settled, on a port in real time."""
    yield from settled_robot(20.0)


@pytest.fixture
def config(robot: ServedRobot, tmp_path: Path) -> Path:
    """What that robot's lab would know of it."""
    path = tmp_path / "robot.toml"
    robot.plant.scene.believed(3).save(path)
    return path


@pytest.fixture
def run() -> Iterator[ScriptedRun]:
    """A run that says what a test has it say."""
    with ScriptedRun() as scripted:
        yield scripted


@pytest.fixture
def served(serve_page: Callable[..., Served]) -> Served:
    """The page's server, with no options."""
    return serve_page()


@pytest.fixture
def page(looking: Looking, served: Served, run: ScriptedRun) -> Page:
    """A page that shows this run, and may stop it."""
    opened = looking.open(served.address)
    run.state()
    expect(opened.locator("#stop")).to_have_attribute("data-state", "ready")
    return opened
