"""Who may use the page: Host, Origin and token of every request."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Awaitable, Callable

import aiohttp
import pytest
from aiohttp import web

from thigmo.live.guard import add_headers, guard, refusal

Ask = Callable[[aiohttp.ClientSession, str], Awaitable[int]]


def _ask(ask: Ask) -> int:
    """Status that a guarded server answers, whose token is `right`."""

    async def ok(request: web.Request) -> web.Response:
        return web.Response(text="ok")

    async def run() -> int:
        app = web.Application(middlewares=[guard("right")])
        app.on_response_prepare.append(add_headers)
        app.router.add_get("/", ok)
        app.router.add_get("/stream", ok)
        app.router.add_post("/act", ok)
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


def _act(**headers: str) -> Ask:
    async def ask(session: aiohttp.ClientSession, here: str) -> int:
        filled = {name: value.replace("HERE", here) for name, value in headers.items()}
        async with session.post(
            here + "/act?token=right", headers=filled, allow_redirects=False
        ) as answer:
            return answer.status

    return ask


_RIGHT = "/?token=right"
_PASSED = 302  # to the address without the token


@pytest.mark.parametrize(
    ("ask", "status"),
    [
        pytest.param(_get(_RIGHT), 200, id="the page at its own address"),
        pytest.param(_act(Origin="HERE"), _PASSED, id="act from the page"),
        pytest.param(_act(), 403, id="act from no page"),
        pytest.param(_act(Origin="http://evil.example"), 403, id="act from another site"),
        pytest.param(_act(Origin="null"), 403, id="act from a sandboxed frame"),
        pytest.param(_act(Origin="http://127.0.0.1:1"), 403, id="act from another port"),
        pytest.param(_get("/stream?token=right"), 403, id="stream for no page"),
        pytest.param(_get(), 403, id="no token"),
        pytest.param(_get("/?token=wrong"), 403, id="wrong token"),
        pytest.param(_get("/?token="), 403, id="empty token"),
    ],
)
def test_who_is_served(ask: Ask, status: int) -> None:
    assert _ask(ask) == status


@pytest.mark.parametrize(
    ("host", "here"),
    [
        ("127.0.0.1:8421", True),
        ("localhost:80", True),
        ("[::1]:8421", True),
        ("192.168.0.7:8421", True),
        (f"{socket.gethostname()}:8421", True),
        ("evil.example:8421", False),
        ("127.0.0.1.evil.example", False),
        ("a:b:c", False),
        ("", False),
    ],
)
def test_a_name_that_points_here_is_no_address_of_the_page(host: str, *, here: bool) -> None:
    assert (refusal(host, f"http://{host}", acts=True) is None) is here


def test_token_is_kept_in_a_cookie_and_leaves_the_address() -> None:
    async def ask(session: aiohttp.ClientSession, here: str) -> int:
        async with session.get(f"{here}/?token=right") as answer:
            assert answer.status == 200
            assert str(answer.url) == f"{here}/"
        async with session.post(f"{here}/act", headers={"Origin": here}) as answer:
            return answer.status

    assert _ask(ask) == 200


def test_refusals_carry_the_policy_as_well() -> None:
    async def ask(session: aiohttp.ClientSession, here: str) -> int:
        async with session.get(here, headers={"Host": "evil.example"}) as answer:
            assert "frame-ancestors 'none'" in answer.headers["Content-Security-Policy"]
            return answer.status

    assert _ask(ask) == 403
