"""Delay and cost of watching: the age of readings on the screen, an exploration with three pages
open against one without, and the share of a core that publishing messages and recording them takes
on a robot of 200 readings a second, without a page.

The robot is emulated and served on a pseudo-terminal in real time, at its full rate: 200 readings a
second. The pages are a real browser's. Everything runs on this computer, which should have nothing
else to do.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any

import numpy as np

from thigmo.errors import DataError
from thigmo.link.address import OTHER_PLACE
from thigmo_bench.studies.engine import Claim, Context, Outcome

_VIEWERS = 3
_DEAD = 500  # viewers that never read
_RATE_HZ = 200
_PROMISED_S = {"p50": 0.1, "p95": 0.25}
EVER_MS = 120_000
# Streams a robot's telemetry for some seconds, as an exploration does, and moves nothing.
_STREAM = """
import sys
from thigmo.config import RobotConfig
from thigmo.robot import connect
from thigmo.stream import Hello, Server

with connect(sys.argv[1]) as robot:
    robot.configure(RobotConfig())
    now = robot.now()
    hello = Hello(now, robot.epoch_s + now, robot.url, "watched", "", 0, "", False)
    with Server(robot.hub, hello, lambda command: None):
        print("streaming", flush=True)
        robot.wait(float(sys.argv[2]))
"""
# The second of two explorations: the first one imports. All that publishes is timed, with the
# record of what it publishes; calls within a timed call are part of it. Raw frames of the link are
# not counted: a run keeps them for its replay, whether or not anything is published.
_SHARE = """
import sys, time
from thigmo.exploration import explore
from thigmo.robot.publishing import Publisher
from thigmo.stream import Hub

spent_s, timing = 0.0, False

def timed(function):
    def call(*arguments, **options):
        global spent_s, timing
        if timing:
            return function(*arguments, **options)
        timing, began_s = True, time.thread_time()
        try:
            return function(*arguments, **options)
        finally:
            spent_s += time.thread_time() - began_s
            timing = False
    return call

for kind, names in [
    (Publisher, ["take", "event"]),
    (Hub, ["publish"]),
]:
    for name in names:
        setattr(kind, name, timed(getattr(kind, name)))
for seed in (1, 2):
    before_s = spent_s
    run = explore("emulator://default", seed=seed, out=sys.argv[1])
print((spent_s - before_s) / run.document.robot_time_s)
"""


Start = Callable[..., "subprocess.Popen[str]"]
"""Starts a command where no other run of this user is watched; its output is piped."""


def run(context: Context) -> Outcome:
    """Age of readings on the screen; explorations watched and not."""
    with tempfile.TemporaryDirectory(prefix="tg") as folder:
        sockets = {**os.environ, OTHER_PLACE: folder}
        start = partial(subprocess.Popen, env=sockets, text=True, stdout=subprocess.PIPE)
        context.progress("readings to the screen", 0, 5)
        ages_s, rate_hz = _ages(start, 15.0 if context.scale == "quick" else 60.0)
        context.progress("an exploration alone", 1, 5)
        alone = _explored(start, 0)
        context.progress("an exploration with three pages", 2, 5)
        watched = _explored(start, _VIEWERS)
        context.progress("the share of publishing", 3, 5)
        share, _ = start([sys.executable, "-c", _SHARE, folder]).communicate()
        context.progress("a stop among dead viewers", 4, 5)
        stop_s = _stopped_s(start)
    context.progress("a stop among dead viewers", 5, 5)
    times = ("robot_time_s", "wall_time_s")
    quantiles = zip(_PROMISED_S.items(), np.quantile(ages_s, [0.5, 0.95]).tolist(), strict=True)
    claims = [
        Claim(f"age of a reading on the screen, {name}", value, promised, unit="s")
        for (name, promised), value in quantiles
    ]
    cost_s = watched["robot_time_s"] - alone["robot_time_s"]
    same = alone["contacts"] == watched["contacts"] and alone["stages"] == watched["stages"]
    claims += [
        Claim("readings drawn", rate_hz, 0.98 * _RATE_HZ, at_most=False, unit="1/s"),
        Claim(f"robot time that {_VIEWERS} pages cost", cost_s, 0.0, unit="s"),
        Claim(f"results that differ with {_VIEWERS} pages", float(not same), 0.0),
        Claim(f"press to the board's confirmation, {_DEAD} dead viewers", stop_s, 1.0, unit="s"),
        Claim("share of a core that publishing takes on a robot", float(share), 0.02),
    ]
    explorations = [
        {"pages": pages} | {column: exploration[column] for column in times}
        for pages, exploration in ((0, alone), (_VIEWERS, watched))
    ]
    return Outcome({"explorations": explorations}, claims=claims)


def _ages(start: Start, seconds: float) -> tuple[list[float], float]:
    """How old the newest reading was each time that the page was drawn; readings a second."""
    with ExitStack() as stack:
        config = f"{stack.enter_context(tempfile.TemporaryDirectory())}/robot.toml"
        served = running(start, "emulate", "empty", "--config", config, says="open ")
        robot = stack.enter_context(served)
        port = robot.partition("open ")[2].partition(";")[0]
        browser, address = stack.enter_context(opened_page(start))
        page = browser.new_context(viewport={"width": 1440, "height": 900}).new_page()
        page.goto(address)
        streaming = stack.enter_context(start([sys.executable, "-c", _STREAM, port, str(seconds)]))
        stack.callback(streaming.terminate)
        page.wait_for_function("() => thigmo.store.columns[0].length > 200", timeout=EVER_MS)
        page.evaluate("thigmo.keep = true")
        page.wait_for_function("() => thigmo.store.page.ended", timeout=EVER_MS)
        times: list[float] = page.evaluate("thigmo.store.columns[0]")
        ages: list[float] = page.evaluate("thigmo.ages_s")
    return ages, (len(times) - 1) / (times[-1] - times[0])


def _stopped_s(start: Start) -> float:
    """From a press of Stop to the board's confirmation on the page, among viewers that never read
    and with every core busy.

    Raises:
        DataError: the board has not confirmed it.
    """
    with ExitStack() as stack:
        config = f"{stack.enter_context(tempfile.TemporaryDirectory())}/robot.toml"
        served = running(start, "emulate", "empty", "--config", config, says="open ")
        port = stack.enter_context(served).partition("open ")[2].partition(";")[0]
        watch = running(start, "watch", port, "--no-browser", "--port", "0", says="http://")
        address_line = stack.enter_context(watch)
        place, _, token = (
            address_line.partition("http://")[2].partition(" ")[0].partition("/?token=")
        )
        streaming = stack.enter_context(start([sys.executable, "-c", _STREAM, port, "300"]))
        stack.callback(streaming.terminate)
        assert streaming.stdout is not None
        streaming.stdout.readline()
        for _ in range(os.cpu_count() or 1):
            busy = stack.enter_context(start([sys.executable, "-c", "while True: pass"]))
            stack.callback(busy.kill)
        host, _, port_number = place.partition(":")
        head = f"HTTP/1.1\r\nHost: {place}\r\nOrigin: http://{place}\r\n"
        look = (
            f"GET /stream {head}Cookie: thigmo-{port_number}={token}\r\nUpgrade: websocket\r\n"
            "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
        )
        for _ in range(_DEAD):
            viewer = stack.enter_context(socket.create_connection((host, int(port_number))))
            viewer.sendall(look.encode())
        time.sleep(3.0)  # of readings that nobody takes
        return pressed_s((host, int(port_number)))


def pressed_s(place: tuple[str, int]) -> float:
    """From a press of Stop on the page that is served at a place to the board's confirmation.

    Raises:
        DataError: the board has not confirmed it.
    """
    host, port = place
    head = f"Host: {host}:{port}\r\nOrigin: http://{host}:{port}\r\nContent-Length: 0\r\n"
    began = time.monotonic()
    with socket.create_connection(place, timeout=EVER_MS / 1e3) as pressed:
        pressed.sendall(f"POST /stop HTTP/1.1\r\n{head}\r\n".encode())
        answer = b"".join(iter(lambda: pressed.recv(4096), b""))
    took_s = time.monotonic() - began
    outcome = json.loads(answer.partition(b"\r\n\r\n")[2] or "{}")
    if not outcome.get("stopped") or outcome["failed"]:
        raise DataError(f"the board did not confirm the stop: {answer!r}", "look at `thigmo watch`")
    return took_s


def _explored(start: Start, pages: int) -> dict[str, Any]:
    """The default exploration, with a number of pages open."""
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        if pages:
            browser, address = stack.enter_context(opened_page(start))
            for _ in range(pages):
                browser.new_context().new_page().goto(address)
        command = [sys.executable, "-m", "thigmo", "explore", "--seed", "1", "--out", folder]
        output, _ = stack.enter_context(start([*command, "--json"])).communicate()
        document: dict[str, Any] = json.loads(output)
    return document


@contextmanager
def opened_page(start: Start, *options: str) -> Iterator[tuple[Any, str]]:
    """A browser, and the address of the page of whatever runs.

    Raises:
        DataError: there is no browser.
    """
    try:
        from playwright.sync_api import Error, sync_playwright
    except ImportError as error:
        raise DataError("playwright is not installed", "pip install playwright") from error
    chromium = os.environ.get("CHROMIUM", "/usr/bin/chromium")
    with ExitStack() as stack:
        playwright = stack.enter_context(sync_playwright())
        try:
            browser = playwright.chromium.launch(executable_path=chromium)
        except Error as error:
            raise DataError(
                f"no browser at {chromium}", "install chromium, or name one in CHROMIUM"
            ) from error
        stack.callback(browser.close)
        watch = running(start, "watch", "--no-browser", "--port", "0", *options, says="http://")
        address_line = stack.enter_context(watch)
        yield browser, "http://" + address_line.partition("http://")[2].partition(" ")[0]


@contextmanager
def running(start: Start, *arguments: str, says: str) -> Iterator[str]:
    """A `thigmo` command beside this one: the first line that holds `says`."""
    command = [sys.executable, "-m", "thigmo", *arguments]
    with start(command, stderr=subprocess.STDOUT) as started:
        try:
            line = next((line for line in started.stdout or () if says in line), None)
            if line is None:
                raise DataError(f"thigmo {arguments[0]} has ended", "run it by hand to see why")
            yield line.strip()
        finally:
            started.terminate()
