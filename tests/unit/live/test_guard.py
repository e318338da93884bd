"""Who may use the page: Host, Origin and token of every request."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import aiohttp
import pytest
from aiohttp import web

from thigmo.live.guard import add_headers, guard

Ask = Callable[[aiohttp.ClientSession, str], Awaitable[int]]


def _ask(token: str | None, ask: Ask) -> int:
    """Status that a guarded server answers."""

    async def ok(request: web.Request) -> web.Response:
        return web.Response(text="ok")

    async def run() -> int:
        app = web.Application(middlewares=[guard(token)])
        app.on_response_prepare.append(add_headers)
        app.router.add_get("/", ok)
        app.router.add_get("/stream", ok)
        app.router.add_post("/stop", ok)
        runner = web.AppRunner(app)
        await runner.setup()
        site = web.TCPSite(runner, "127.0.0.1", 0)
        await site.start()
        try:
            port = runner.addresses[0][1]
            jar = aiohttp.CookieJar(unsafe=True)  # keeps cookies of an address that is a number
            async with aiohttp.ClientSession(cookie_jar=jar) as session:
                return await ask(session, f"http://127.0.0.1:{port}")
        finally:
            await runner.cleanup()

    return asyncio.run(run())


def _get(path: str = "/", **headers: str) -> Ask:
    async def ask(session: aiohttp.ClientSession, here: str) -> int:
        filled = {name: value.replace("HERE", here) for name, value in headers.items()}
        async with session.get(here + path, headers=filled) as answer:
            return answer.status

    return ask


def _stop(**headers: str) -> Ask:
    async def ask(session: aiohttp.ClientSession, here: str) -> int:
        filled = {name: value.replace("HERE", here) for name, value in headers.items()}
        async with session.post(here + "/stop", headers=filled) as answer:
            return answer.status

    return ask


@pytest.mark.parametrize(
    ("ask", "status"),
    [
        pytest.param(_get(), 200, id="the page at its own address"),
        pytest.param(_get(Host="localhost:80"), 200, id="by another name of loopback"),
        pytest.param(_get(Host="evil.example:8421"), 403, id="a name that points here"),
        pytest.param(_get(Host="127.0.0.1.evil.example"), 403, id="a name that looks alike"),
        pytest.param(_stop(Origin="HERE"), 200, id="stop from the page"),
        pytest.param(_stop(), 403, id="stop from no page"),
        pytest.param(_stop(Origin="http://evil.example"), 403, id="stop from another site"),
        pytest.param(_stop(Origin="null"), 403, id="stop from a sandboxed frame"),
        pytest.param(_stop(Origin="http://127.0.0.1:1"), 403, id="stop from another port"),
        pytest.param(_get("/stream", Origin="HERE"), 200, id="stream for the page"),
        pytest.param(_get("/stream", Origin="http://evil.example"), 403, id="for another site"),
        pytest.param(_get("/stream"), 403, id="stream for no page"),
    ],
)
def test_loopback(ask: Ask, status: int) -> None:
    assert _ask(None, ask) == status


@pytest.mark.parametrize(
    ("ask", "status"),
    [
        pytest.param(_get(), 403, id="no token"),
        pytest.param(_get("/?token=wrong"), 403, id="wrong token"),
        pytest.param(_get("/?token="), 403, id="empty token"),
        pytest.param(_get("/?token=right"), 200, id="right token"),
        pytest.param(_stop(Origin="HERE"), 403, id="stop without a token"),
    ],
)
def test_token(ask: Ask, status: int) -> None:
    assert _ask("right", ask) == status


def test_token_is_kept_in_a_cookie_and_leaves_the_address() -> None:
    async def ask(session: aiohttp.ClientSession, here: str) -> int:
        async with session.get(f"{here}/?token=right") as answer:
            assert answer.status == 200
            assert str(answer.url) == f"{here}/"
        async with session.post(f"{here}/stop", headers={"Origin": here}) as answer:
            return answer.status

    assert _ask("right", ask) == 200


def test_refusals_carry_the_policy_as_well() -> None:
    async def ask(session: aiohttp.ClientSession, here: str) -> int:
        async with session.get(here, headers={"Host": "evil.example"}) as answer:
            assert "frame-ancestors 'none'" in answer.headers["Content-Security-Policy"]
            return answer.status

    assert _ask(None, ask) == 403
