"""Who may use the page: requests are checked before anything else sees them.

A page of any other site, open in the operator's browser, can send requests to this machine, and
with a name of its own that points here even read the answers. So the host that a request names
must be this server's, and whatever stops, starts or streams must come from its own page (Origin).
On another interface than loopback every request needs a token as well, which the page's address
carries once and a cookie from then on.
"""

from __future__ import annotations

import hmac

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

_LOOPBACK = ("localhost", "127.0.0.1", "[::1]")
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; img-src 'self' data:; style-src 'self' 'unsafe-inline'; "
        "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


def guard(token: str | None) -> Middleware:
    """Checks of every request, as aiohttp calls them; the token is None on loopback."""

    @web.middleware
    async def checked(request: web.Request, handler: Handler) -> web.StreamResponse:
        refusal = _refusal(request, token)
        if refusal is not None:
            raise web.HTTPForbidden(text=refusal, headers=_HEADERS)
        if token is not None and "token" in request.query:
            response = web.HTTPFound("/", headers=_HEADERS)
            response.set_cookie(_cookie(request), token, httponly=True, samesite="Lax", path="/")
            raise response
        return await handler(request)

    return checked


def _refusal(request: web.Request, token: str | None) -> str | None:
    name, _, _ = request.host.rpartition(":") if ":" in request.host else (request.host, "", "")
    if token is None and name not in _LOOPBACK:
        return f"This page is not {request.host}. Open it at 127.0.0.1."
    acts = request.method not in ("GET", "HEAD") or request.path == "/stream"
    if acts and request.headers.get("Origin") != f"http://{request.host}":
        return "This request does not come from the page itself."
    if token is not None:
        given = request.query.get("token") or request.cookies.get(_cookie(request), "")
        if not hmac.compare_digest(given.encode(), token.encode()):
            return "This page needs its token. Open the address that `thigmo watch` printed."
    return None


def _cookie(request: web.Request) -> str:
    # Cookies do not tell ports apart, and two pages may be served on one machine.
    return f"thigmo-{request.url.port}"


async def add_headers(request: web.Request, response: web.StreamResponse) -> None:
    """What browsers are told to refuse: other sites' scripts, frames and requests."""
    response.headers.update(_HEADERS)
