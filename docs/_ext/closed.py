"""After the build: no page asks another host for anything, and no internal link is dead.

Sphinx itself checks the links that it resolves; this reads the pages as a browser does, with what
themes and extensions put on them.
"""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urldefrag, urlsplit

from sphinx.util import logging

_LOG = logging.getLogger(__name__)
# What a browser fetches by itself: tag, attribute.
_FETCHED = {
    ("script", "src"), ("link", "href"), ("img", "src"), ("iframe", "src"), ("source", "src"),
    ("video", "src"), ("object", "data"),
}  # fmt: skip


class _Page(HTMLParser):
    """Links, fetched addresses and anchors of one page."""

    def __init__(self) -> None:
        super().__init__()
        self.links: set[str] = set()
        self.fetched: set[str] = set()
        self.anchors: set[str] = {""}

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if not value:
                continue
            if name in ("id", "name"):
                self.anchors.add(value)
            if (tag, name) in _FETCHED:
                self.fetched.add(value)
            elif (tag, name) == ("a", "href"):
                self.links.add(value)


def _check(app: Any, failure: Exception | None) -> None:
    if failure or app.builder.name != "html":
        return
    out = Path(app.outdir)
    pages: dict[Path, _Page] = {}
    for path in sorted(out.rglob("*.html")):
        page = pages[path.resolve()] = _Page()
        page.feed(path.read_text())
    for path, page in pages.items():
        name = path.relative_to(out.resolve())
        for address in sorted(page.fetched):
            if urlsplit(address).netloc:
                _LOG.warning("%s fetches %s", name, address)
        for link in sorted(page.links | page.fetched):
            target, anchor = urldefrag(link)
            if urlsplit(link).scheme or urlsplit(link).netloc:
                continue
            aim = (path.parent / unquote(urlsplit(target).path)).resolve() if target else path
            if not aim.exists():
                _LOG.warning("%s: no file for the link %s", name, link)
            elif aim in pages and unquote(anchor) not in pages[aim].anchors:
                _LOG.warning("%s: no anchor for the link %s", name, link)


def setup(app: Any) -> dict[str, bool]:
    """Check when the build is finished."""
    app.connect("build-finished", _check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
