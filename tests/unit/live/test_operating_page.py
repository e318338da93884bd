"""Which page operates: the one that has asked for something, as long as it is connected.

A page that only looks keeps nobody from operating.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager

import aiohttp
import pytest
from page_server import Served

from thigmo.live.server import WatchOptions

RESUME = '{"command": "resume"}'  # asks for something; nothing runs, so nothing comes of it

pytestmark = pytest.mark.usefixtures("own_sockets")


class LookingPage:
    """A page's connection to the server."""

    def __init__(self, stream: aiohttp.ClientWebSocketResponse) -> None:
        self.stream = stream

    async def may_operate(self) -> bool:
        """What the server says now, once it has taken what this page sent before."""
        for _ in range(5):  # at most four were sent before they were acknowledged
            (message,) = await self.stream.receive_json(timeout=60)
            await self.stream.send_str('{"ack": 1}')
        return bool(message["operates"])

    async def ask(self) -> None:
        """Operate."""
        await self.stream.send_str(RESUME)


@asynccontextmanager
async def visitor(address: str) -> AsyncIterator[LookingPage]:
    async with (
        aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as session,
        session.get(address) as page,
    ):
        origin = str(page.url).rstrip("/")
        async with session.ws_connect(f"{origin}/stream", origin=origin) as stream:
            yield LookingPage(stream)


@pytest.fixture
def address() -> Iterator[str]:
    server = Served(WatchOptions(port=0, url="/dev/ttyNONE"))
    yield server.address
    server.close()


def test_page_that_looks_keeps_nobody_from_operating(address: str) -> None:
    async def look() -> None:
        async with visitor(address) as first, visitor(address) as second:
            assert await first.may_operate()
            assert await second.may_operate()
            await second.ask()
            assert await second.may_operate()
            assert not await first.may_operate()
            await first.ask()  # in vain
            assert not await first.may_operate()
            assert await second.may_operate()

    asyncio.run(look())


def test_page_operates_again_that_lost_its_connection_as_another_one_came(address: str) -> None:
    async def look() -> None:
        async with visitor(address) as operator:
            await operator.ask()
            assert await operator.may_operate()
        async with visitor(address), visitor(address) as again:
            assert await again.may_operate()
            await again.ask()
            assert await again.may_operate()

    asyncio.run(look())
