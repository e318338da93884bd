"""`thigmo explore --watch`: the page is opened, follows the run, and outlives the command."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import aiohttp
import pytest
from emulated import last_stages, room_file
from served import comes

# Stands for the operator's browser: tells the page's address, to which the file that it is given
# leads, and the process that serves it, which has started Python's `webbrowser`, which has started
# this.
BROWSER = """
import os, re, sys
from urllib.parse import unquote, urlparse
with open(unquote(urlparse(sys.argv[2]).path)) as leads:
    address = re.search('url=([^"]+)', leads.read())[1]
with open(f"/proc/{os.getppid()}/stat") as stat:
    server = stat.read().rpartition(")")[2].split()[1]
with open(sys.argv[1], "w") as file:
    file.write(f"{server} {address}")
"""


class Watched:
    """`thigmo explore --watch`, and the page that it has opened."""

    def __init__(self, folder: Path, *options: str) -> None:
        said = folder / "page"
        os.mkfifo(said)
        (folder / "browser.py").write_text(BROWSER)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "thigmo", "explore", "--watch", *options],
            env=os.environ | {"BROWSER": f"{sys.executable} {folder / 'browser.py'} {said} %s"},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        # An emulated run is over within seconds: it waits until its page is there.
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children")
        assert comes(lambda: bool(children.read_text()))
        self.process.send_signal(signal.SIGSTOP)
        server, self.address = said.read_text().split()
        self._server = int(server)
        self.process.send_signal(signal.SIGCONT)

    def until(self, outcome: str, *, interrupt: bool = False) -> None:
        """Look at the page until the run that it shows has ended so.

        Args:
            outcome: how its outcome begins.
            interrupt: press Ctrl-C once the robot is sweeping.
        """
        asyncio.run(self._until(outcome, interrupt=interrupt))

    async def _until(self, outcome: str, *, interrupt: bool) -> None:
        async for message in self._messages():
            if message["channel"] != "state":
                continue
            if message["outcome"].startswith(outcome):
                return
            assert message["outcome"] == "running"
            if interrupt and message["state"] == "SWEEP":
                self.process.send_signal(signal.SIGINT)
                interrupt = False

    async def _messages(self) -> Any:
        origin = self.address.partition("/?")[0]
        async with (
            aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as session,
            session.get(self.address),  # its token becomes a cookie
            session.ws_connect(f"{origin}/stream", headers={"Origin": origin}) as socket,
        ):
            async for batch in socket:
                for message in json.loads(batch.data):
                    yield message
                await socket.send_str('{"ack":1}')

    def close(self) -> None:
        self.process.kill()
        self.process.communicate()
        with suppress(ProcessLookupError):
            os.kill(self._server, signal.SIGKILL)


@pytest.fixture
def watched(own_sockets: None, tmp_path: Path) -> Iterator[Any]:
    """Explores the default room from a length on, with further options."""
    started: list[Watched] = []

    def explore(start_cm: float, *options: str) -> Watched:
        url = room_file(tmp_path, last_stages(start_cm))
        where = ["--robot", url, "--out", str(tmp_path / "runs")]
        started.append(Watched(tmp_path, *where, *options))
        return started[-1]

    yield explore
    for process in started:
        process.close()


pytestmark = pytest.mark.ci


def test_page_is_opened_and_follows_the_run_whose_result_is_the_only_output(watched: Any) -> None:
    run = watched(53.0, "--json")
    run.until("full length")
    out, err = run.process.communicate()
    assert run.process.returncode == 0, err
    assert json.loads(out)["outcome"] == "full length"
    assert err.startswith(f"The page is at {run.address}")
    run.until("full length")  # the page is still there for those who look


@pytest.mark.realtime
def test_ctrl_c_ends_the_run_and_leaves_the_page(watched: Any) -> None:
    run = watched(20.0, "--realtime")
    run.until("aborted: interrupted by the operator", interrupt=True)
    run.process.communicate()
    assert run.process.returncode == 130
    run.until("aborted: interrupted by the operator")
