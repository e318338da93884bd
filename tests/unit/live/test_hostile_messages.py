"""Messages to the page's server that no page of ours sends: they end nothing and print nothing."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import aiohttp
import pytest
from page_server import Served

from thigmo.live.page_request import parse
from thigmo.live.server import WatchOptions
from thigmo.stream.remote import _request_in

DEEP = "[" * 2000
LONG = "9" * 400
HOSTILE = [
    DEEP,
    '{"command":' * 200,
    f'{{"command": "jog", "way": "in", "cm": {LONG}}}',
    f'{{"command": "retract", "to": 0, "length": {LONG}}}',
    '{"command": "jog", "way": "in", "cm": NaN}',
    '{"command": "jog", "way": ["in"], "cm": 1}',
    '{"command": "start", "parameters": {"--name": "a\\u0000b"}}',
    '{"command": "start", "parameters": {"--name": "a\\ud800b"}}',
    '{"command": "start", "parameters": {"--name": "a\\u001b[2Jb"}}',
    '{"command": "start", "parameters": {"--name": {"a": 1}}}',
    '{"command": "answer", "text": "\\ud800"}',
    '{"command": ["start"]}',
    "\0",
    "1",
    "",
]


@pytest.mark.usefixtures("own_sockets")
def test_a_page_s_connection_outlives_them(
    capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    server = Served(WatchOptions(port=0, url="/dev/ttyNONE"))

    async def look() -> Any:
        async with (
            aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as session,
            session.get(server.address) as page,
        ):
            origin = str(page.url).rstrip("/")
            async with session.ws_connect(f"{origin}/stream", origin=origin) as stream:
                for text in HOSTILE:
                    await stream.send_str(text)
                await stream.send_bytes(b"\xff")
                await stream.send_str(json.dumps({"command": "resume"}))
                for _ in range(3):  # the server speaks four times a second
                    (message,) = json.loads((await stream.receive(60)).data)
                    await stream.send_str('{"ack": 1}')
                return message

    try:
        message = asyncio.run(look())
    finally:
        server.close()
    assert (message["channel"], message["operates"], message["started"]) == ("page", True, None)
    said = capfd.readouterr()
    assert (said.out, said.err) == ("", "")
    assert [record for record in caplog.records if record.levelname != "DEBUG"] == []


@pytest.mark.parametrize("text", HOSTILE)
def test_they_ask_nothing(text: str) -> None:
    assert parse(text) is None


@pytest.mark.parametrize("text", [*HOSTILE, '{"command": "answer", "text": "\\u0007"}'])
def test_a_run_s_stream_takes_none_of_them(text: str) -> None:
    assert _request_in(text.encode()) is None


def test_what_a_page_sends_is_taken() -> None:
    jog = parse('{"command": "jog", "way": "out", "cm": "1.5"}')
    assert jog is not None
    assert (jog.command, jog.way, jog.cm) == ("jog", "out", 1.5)
    start = parse('{"command": "start", "realtime": false, "parameters": {"--name": "my room"}}')
    assert start is not None
    assert (start.realtime, start.parameters) == (False, {"--name": "my room"})
    assert parse('{"ack": 1}') is not None
