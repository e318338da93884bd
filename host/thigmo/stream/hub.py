"""Where messages are published, and the bounded queues of those who listen.

Publishing takes no longer for a slow listener: a full queue loses its oldest message. Publishers
of frequent messages ask `wanted` first, so that nobody listening costs next to nothing.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator

from thigmo.closing import Closing
from thigmo.stream.messages import CHANNELS, RETAINED, Event, Message

QUEUE = 2048  # messages: ten seconds of telemetry
_KEPT_EVENTS = 100
Sink = Callable[[Message], None]
_Entry = tuple[Sink, frozenset[str], Callable[[], None]]  # its channels; called when the hub closes


class Subscription(Closing):
    """A listener's queue of messages, which drops the oldest when it is full.

    It is a context manager, and an iterator that ends when the subscription or the hub is closed.
    Several threads may use it.
    """

    def __init__(self, hub: Hub, channels: Iterable[str], size: int) -> None:
        self._hub = hub
        self._waiting: deque[Message] = deque(maxlen=size)
        self._changed = threading.Condition()
        self._ended = threading.Event()
        self.dropped = 0  # messages lost so far
        hub.attach(self._put, channels, self._end)

    def _put(self, message: Message) -> None:
        with self._changed:
            if not self._ended.is_set():
                self.dropped += len(self._waiting) == self._waiting.maxlen
                self._waiting.append(message)
                self._changed.notify()

    def _wait(self, timeout_s: float | None = None) -> None:
        self._changed.wait_for(lambda: self._waiting or self._ended.is_set(), timeout_s)

    def get(self, timeout_s: float | None = None) -> Message | None:
        """The oldest message; None if none comes in time, or all are read and it is closed."""
        with self._changed:
            self._wait(timeout_s)
            return self._waiting.popleft() if self._waiting else None

    def take(self) -> list[Message]:
        """All messages, oldest first; waits for one. Empty once all are read and it is closed."""
        with self._changed:
            self._wait()
            taken = list(self._waiting)
            self._waiting.clear()
        return taken

    def linger(self, seconds: float) -> None:
        """Let messages gather for some seconds, or until the subscription is closed."""
        self._ended.wait(seconds)

    def close(self) -> None:
        """Stop listening; messages that have arrived can still be read. May be called twice."""
        self._hub.detach(self._put)
        self._end()

    def _end(self) -> None:
        with self._changed:
            self._ended.set()
            self._changed.notify_all()

    def __iter__(self) -> Iterator[Message]:
        while (message := self.get()) is not None:
            yield message


class Hub:
    """Passes messages from publishers to listeners. Several threads may use it."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._listen([])
        self._last: dict[str, Message] = {}
        self._events: deque[Message] = deque(maxlen=_KEPT_EVENTS)
        self._closed = False

    def publish(self, message: Message) -> None:
        """Pass a message to everyone who listens to its channel, without waiting for anyone."""
        channel = message.CHANNEL
        with self._lock:
            if channel in RETAINED:
                self._last[channel] = message
            elif channel == Event.CHANNEL:
                self._events.append(message)
            for sink, channels, _ in self._sinks:
                if channel in channels:
                    sink(message)

    def wanted(self, kind: type[Message]) -> bool:
        """Whether anybody listens to messages of a kind."""
        return kind.CHANNEL in self._wanted

    def subscribe(self, channels: Iterable[str] | None = None, size: int = QUEUE) -> Subscription:
        """Listen to channels, by the names of `CHANNELS`; None takes all.

        The last message of each slow channel and the last hundred events come first. When `size`
        messages wait, each new one replaces the oldest.
        """
        return Subscription(self, CHANNELS if channels is None else channels, size)

    def attach(
        self,
        sink: Sink,
        channels: Iterable[str] = tuple(CHANNELS),
        closed: Callable[[], None] = lambda: None,
    ) -> None:
        """Call `sink` with every message from now on, and first with those that are retained.

        It is called in the publisher's thread: it must be quick, and must not use the hub.
        `closed` is called when the hub is closed.
        """
        names = frozenset(channels)
        with self._lock:
            for message in self.retained():
                if message.CHANNEL in names:
                    sink(message)
            if self._closed:
                closed()
                return
            self._listen([*self._sinks, (sink, names, closed)])

    def detach(self, sink: Sink) -> None:
        """Stop calling `sink`; nothing happens if it is not attached."""
        with self._lock:
            self._listen([entry for entry in self._sinks if entry[0] != sink])

    def _listen(self, sinks: list[_Entry]) -> None:
        self._sinks = sinks
        self._wanted = frozenset[str]().union(*(channels for _, channels, _ in sinks))

    def retained(self) -> list[Message]:
        """The last message of each slow channel, and the last events."""
        with self._lock:
            return [*self._last.values(), *self._events]

    def close(self) -> None:
        """End all subscriptions; may be called twice."""
        with self._lock:
            sinks, self._closed = self._sinks, True
            self._listen([])
            for _, _, closed in sinks:
                closed()
