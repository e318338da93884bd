"""How soon a stop on the page is confirmed in a crowd of connections that would keep it out.

Nobody in the crowd has the page's token. Some begin a stop and then send a byte a second, others
leave a request for the page half open. A connection that is closed comes again at once. The robot
is emulated and served on a pseudo-terminal in real time. Times are this computer's, from the press
to the end of the answer that names who has confirmed; it should have nothing else to do.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial

import numpy as np

from thigmo.link.address import OTHER_PLACE
from thigmo_bench.studies.engine import Claim, Context, Outcome
from thigmo_bench.studies.watch import Start, pressed_s, running

_DRIPPING = 700  # connections that begin a stop and send a byte a second
_HALF_OPEN = 64  # connections that begin a request for the page
_BYTE_S = 1.0
_PROMISED_S = 1.0
# Owns the robot's port, whatever becomes of the robot.
_HOLD = """
import sys
from thigmo.robot import connect

with connect(sys.argv[1]) as robot:
    print("holding", flush=True)
    while True:
        robot.wait(0.1, despite_faults=True)
"""


def run(context: Context) -> Outcome:
    """Median and worst time from the press to the board's confirmation, alone and in the crowd."""
    presses = context.count(5, 40)
    rows: list[dict[str, str | int | float]] = []
    with tempfile.TemporaryDirectory(prefix="tg") as folder, ExitStack() as stack:
        sockets = {**os.environ, OTHER_PLACE: folder}
        start: Start = partial(subprocess.Popen, env=sockets, text=True, stdout=subprocess.PIPE)
        place = stack.enter_context(_page(start, folder))
        for visitors, description, crowd in (
            ("nobody else", "the page alone", (0, 0)),
            ("a crowd", f"{_DRIPPING} dripping, {_HALF_OPEN} half open", (_DRIPPING, _HALF_OPEN)),
        ):
            with _crowd(place, *crowd):
                times = []
                for press in range(presses):
                    context.progress(visitors, press, presses)
                    times.append(1e3 * pressed_s(place))
            p50, worst = float(np.median(times)), max(times)
            rows.append(
                {
                    "who": visitors,
                    "how": description,
                    "n": presses,
                    "p50_ms": p50,
                    "worst_ms": worst,
                }
            )
    worst_s = float(rows[-1]["worst_ms"]) / 1e3
    claim = Claim("press to the board's confirmation in the crowd: worst", worst_s, _PROMISED_S,
                  unit="s")  # fmt: skip
    return Outcome({"rows": rows}, claims=[claim], summary=rows)


@contextmanager
def _page(start: Start, folder: str) -> Iterator[tuple[str, int]]:
    """A page whose robot a program holds: where it is served."""
    with ExitStack() as stack:
        emulated = running(
            start, "emulate", "empty", "--config", f"{folder}/robot.toml", says="open "
        )
        port = stack.enter_context(emulated).partition("open ")[2].partition(";")[0]
        holding = stack.enter_context(start([sys.executable, "-c", _HOLD, port]))
        stack.callback(holding.terminate)
        assert holding.stdout is not None
        holding.stdout.readline()
        watch = running(start, "watch", port, "--no-browser", "--port", "0", says="http://")
        address_line = stack.enter_context(watch)
        host, _, number = address_line.partition("http://")[2].partition("/")[0].partition(":")
        yield host, int(number)


@contextmanager
def _crowd(place: tuple[str, int], dripping: int, half_open: int) -> Iterator[None]:
    """Connections that never finish their requests, in a thread."""
    unfinished = [b"POST /stop HTTP/1.1\r\nX: "] * dripping + [b"GET / HTTP/1.1\r\n"] * half_open
    connected, finished = threading.Event(), threading.Event()

    def crowd() -> None:
        guests: list[socket.socket | None] = [None] * len(unfinished)
        while not finished.is_set():
            for n, words in enumerate(unfinished):
                guests[n] = _next_bytes(place, guests[n], words)
            connected.set()
            finished.wait(_BYTE_S)
        for guest in guests:
            if guest is not None:
                guest.close()

    thread = threading.Thread(target=crowd)
    thread.start()
    try:
        connected.wait()
        yield
    finally:
        finished.set()
        thread.join()


def _next_bytes(
    place: tuple[str, int], guest: socket.socket | None, words: bytes
) -> socket.socket | None:
    """The connection after one more byte, or a new one if it had been closed."""
    with suppress(OSError):
        if guest is not None and words.startswith(b"POST"):
            guest.sendall(b"x")
        if guest is not None and not _closed(guest):
            return guest
    with suppress(OSError):
        if guest is not None:
            guest.close()
        guest = socket.create_connection(place, timeout=5.0)
        guest.sendall(words)
        return guest
    return None


def _closed(guest: socket.socket) -> bool:
    guest.setblocking(False)
    try:
        return not guest.recv(1)
    except BlockingIOError:
        return False
    finally:
        guest.settimeout(5.0)
