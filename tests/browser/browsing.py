"""What the tests of the page use: its server, and pages that are listened to."""

from __future__ import annotations

from typing import Any

from page_server import Served
from playwright.sync_api import Browser, BrowserContext, ConsoleMessage, Page

__all__ = ["PATIENCE_MS", "Looking", "Served"]

PATIENCE_MS = 300_000  # what has not come by then, on a busy computer too, never will


class Looking:
    """Opens pages, and keeps what their consoles and their network say."""

    def __init__(self, browser: Browser) -> None:
        self._browser = browser
        self._contexts: list[BrowserContext] = []
        self.errors: list[str] = []
        self.outside: list[str] = []

    def open(self, address: str, *, refused: bool = False, lead: str = "", **options: Any) -> Page:
        """A page of this address, to which another may `lead`; one that is to be `refused` may say
        so on its console."""
        context = self._browser.new_context(
            **{"viewport": {"width": 1440, "height": 900}, **options}
        )
        context.set_default_timeout(PATIENCE_MS)
        self._contexts.append(context)
        origin = address.partition("?")[0].rstrip("/")
        page = context.new_page()
        page.on("console", lambda message: self._hear(message, refused=refused))
        page.on("pageerror", lambda error: self.errors.append(str(error)))

        inside = (origin, origin.replace("http", "ws"), "data:", "blob:", *([lead] if lead else []))

        def note(url: str) -> None:
            if not url.startswith(inside):
                self.outside.append(url)

        page.on("request", lambda request: note(request.url))
        page.on("websocket", lambda socket: note(socket.url))
        page.goto(lead or address)
        return page

    def _hear(self, message: ConsoleMessage, *, refused: bool) -> None:
        if refused and "403 (Forbidden)" in message.text:
            return
        if message.type in ("error", "warning"):
            self.errors.append(message.text)

    def close(self) -> None:
        for context in self._contexts:
            context.close()
