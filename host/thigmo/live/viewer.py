"""One page that looks: what waits to be sent to it, bounded, and how far behind it is.

Every batch is acknowledged by the page. While too many are not, readings are dropped, the oldest
first, and the page gets their number: a viewer that stalls costs the server nothing and slows
nobody.
"""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import Iterable

from aiohttp import web

from thigmo.stream import RETAINED, BodyShape

_PAGE = "page"  # channel of what the server says of itself
_UNANSWERED = 4  # batches under way
_MOST_ROWS = 600  # three seconds of telemetry
_MOST_EVENTS = 500
_MOST_SHAPES = 40  # what the body swept is drawn of them: two seconds


class Viewer:
    """A page behind its WebSocket."""

    def __init__(self, socket: web.WebSocketResponse) -> None:
        self.socket = socket
        self._rows: deque[str] = deque()
        self._board = ""
        self._once: deque[str] = deque(maxlen=_MOST_EVENTS)
        self._shapes: deque[str] = deque(maxlen=_MOST_SHAPES)
        self._last: dict[str, str] = {}
        self._due = asyncio.Event()
        self._under_way = 0
        self._reported = 0
        self.dropped = 0  # readings that it has missed

    def add_rows(self, rows: Iterable[str], board: str, *, most: int = _MOST_ROWS) -> None:
        """Queue telemetry in JSON: rows, of which `most` may wait, and what else the last says."""
        self._rows.extend(rows)
        self._board = board
        while len(self._rows) > most:
            self._rows.popleft()
            self.dropped += 1
        self._due.set()

    def add(self, channel: str, text: str) -> None:
        """Queue a message; of most channels that are retained, only the last one counts."""
        if channel == BodyShape.CHANNEL:
            self._shapes.append(text)
        elif channel in RETAINED or channel == _PAGE:
            self._last.pop(channel, None)
            self._last[channel] = text
        else:
            self._once.append(text)
        self._due.set()

    def forget(self) -> None:
        """Drop what waits: it has been sent, or is of a run that is no longer shown."""
        self._rows.clear()
        self._once.clear()
        self._shapes.clear()
        self._last.clear()

    def acknowledged(self) -> None:
        """The page has taken a batch."""
        self._under_way = max(0, self._under_way - 1)
        self._due.set()

    async def send_on(self) -> None:
        """Send what waits, until the page has gone."""
        while not self.socket.closed:
            await self._due.wait()
            self._due.clear()
            if self._under_way >= _UNANSWERED:
                continue
            batch = self._batch()
            if batch is None:
                continue
            self._under_way += 1
            try:
                await self.socket.send_str(batch)
            except ConnectionError:
                return

    def _batch(self) -> str | None:
        # The page's own message first: it says which run the others are of.
        parts = [self._last.pop(_PAGE)] if _PAGE in self._last else []
        if self.dropped > self._reported:
            self._reported = self.dropped
            parts.append(json.dumps({"channel": "dropped", "count": self.dropped}))
        # Shapes before the posterior, which lies on one of them.
        parts += [*self._shapes, *self._last.values(), *self._once]
        if self._rows:
            rows = ",".join(self._rows)
            parts.append(f'{{"channel":"telemetry",{self._board},"rows":[{rows}]}}')
        self.forget()
        return f"[{','.join(parts)}]" if parts else None
