"""Who may use the page: requests are checked before anything else sees them.

A page of any other site, open in the operator's browser, can send requests to this machine, and
with a name of its own that points here even read the answers. So the host that a request names
must be an address or this machine's own name, and whatever stops, starts or streams must come from
the page itself (Origin). Other users of this machine, and of the network if the page is served
there, need the token, which the page's address carries once and a cookie from then on. A stop needs
none.
"""

from __future__ import annotations

import hmac
import socket
from ipaddress import ip_address

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; img-src 'self' data:; style-src 'self' 'unsafe-inline'; "
        "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


def guard(token: str) -> Middleware:
    """Checks of every request, as aiohttp calls them."""

    @web.middleware
    async def checked(request: web.Request, handler: Handler) -> web.StreamResponse:
        acts = request.method not in ("GET", "HEAD") or request.path == "/stream"
        refused = refusal(request.host, request.headers.get("Origin"), acts=acts)
        given = request.query.get("token") or request.cookies.get(_cookie(request), "")
        if refused is None and not hmac.compare_digest(given.encode(), token.encode()):
            refused = "This page needs its token. Open the address that `thigmo watch` printed."
        if refused is not None:
            raise web.HTTPForbidden(text=refused, headers=HEADERS)
        if "token" in request.query:
            response = web.HTTPFound("/", headers=HEADERS)
            response.set_cookie(_cookie(request), token, httponly=True, samesite="Lax", path="/")
            raise response
        return await handler(request)

    return checked


def refusal(host: str, origin: str | None, *, acts: bool) -> str | None:
    """Why a request to a host, which `acts` or only reads, is refused; None if it is not."""
    if not _here(host):
        return f"This page is not {host}. Open it at 127.0.0.1."
    if acts and origin != f"http://{host}":
        return "This request does not come from the page itself."
    return None


def _here(host: str) -> bool:
    """Whether a request's Host is no name that others could have pointed here."""
    name = host.rpartition(":")[0] if host.rpartition(":")[2].isdigit() else host
    hostname = socket.gethostname().lower()
    if name.lower() in ("localhost", hostname, f"{hostname.partition('.')[0]}.local"):
        return True
    try:
        ip_address(name.strip("[]"))
    except ValueError:
        return False
    return True


def _cookie(request: web.Request) -> str:
    # Cookies do not tell ports apart, and two pages may be served on one machine.
    return f"thigmo-{request.host.rpartition(':')[2]}"


async def add_headers(request: web.Request, response: web.StreamResponse) -> None:
    """What browsers are asked to refuse: other sites' scripts, frames and requests."""
    response.headers.update(HEADERS)
    if request.host.partition(":")[0] in ("localhost", "127.0.0.1"):
        # Of the rest of the network, where nothing is encrypted, browsers ignore it with a warning.
        response.headers["Cross-Origin-Opener-Policy"] = "same-origin"
    if not isinstance(response, web.WebSocketResponse):
        response.headers["Connection"] = "close"  # so that StopHttp sees each request
        response.force_close()
