"""What the views of ROS 2 and Foxglove get when one run follows another."""

from __future__ import annotations

import threading
from dataclasses import replace

import pytest
from test_ros_messages import RUN, STATE

from thigmo.live import relay
from thigmo.live.foxglove import FoxgloveServer
from thigmo.live.relay import Facts, Relay
from thigmo.stream import Grid, Hello, Message

GRID = Grid(1.0, 5.0, 0.5, (0.0, 0.0, 0.0), 1, 1, (0,))
NEXT = replace(RUN, name="next")


class FakeWatched:
    """Gives what a test puts in."""

    def __init__(self) -> None:
        self.waiting: list[Message | None] = []
        self.looked = threading.Event()
        self.sent: list[str] = []

    def take(self) -> list[Message | None]:
        taken, self.waiting = self.waiting, []
        return taken

    def stop(self, seconds: float) -> None:
        self.sent.append("stop")

    def close(self) -> None:
        pass


class Log:
    """A view that keeps what it gets, in order."""

    def __init__(self) -> None:
        self.said: list[tuple[str, str]] = []

    def publish(self, message: Message) -> None:
        self.said.append((message.CHANNEL, ""))

    def tell(self, facts: Facts) -> None:
        self.said.append((facts.run.name if facts.run else "", facts.stopped))


@pytest.fixture
def watched() -> FakeWatched:
    return FakeWatched()


def _passed(
    watched: FakeWatched, passing: Relay, *messages: Message | None
) -> list[tuple[str, str]]:
    view = Log()
    watched.waiting += messages
    passing.pass_on(view)
    return view.said


def test_view_is_told_of_a_new_run_before_its_messages_and_of_the_last_stop(
    watched: FakeWatched, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(relay, "way_to", lambda run: "port")
    monkeypatch.setattr(relay, "stop_port", lambda run: [RUN.url])
    passing = Relay(watched)  # type: ignore[arg-type]
    assert _passed(watched, passing, RUN, STATE)[:2] == [("n", ""), ("state", "")]
    assert passing.stop() == f"stopped {RUN.url}"
    assert ("n", f"stopped {RUN.url}") in _passed(watched, passing, STATE)
    said = _passed(watched, passing, None, NEXT, STATE)
    stopped = f"stopped {RUN.url}"
    assert said[:2] == [("n", stopped), ("next", stopped)]  # the last stop stays known


def test_stop_that_comes_before_a_run_under_way_is_known_stops_it(
    watched: FakeWatched, monkeypatch: pytest.MonkeyPatch
) -> None:
    passing = Relay(watched)  # type: ignore[arg-type]

    def no_port(run: Hello | None) -> list[str]:
        watched.looked.set()  # the run is found while ports are asked
        _passed(watched, passing, replace(RUN, virtual=True), STATE)
        return []

    monkeypatch.setattr(relay, "stop_port", no_port)
    assert passing.stop() == f"stopped {RUN.url}"
    assert watched.sent == ["stop"]


def test_foxglove_gives_late_comers_nothing_of_the_run_before() -> None:
    with FoxgloveServer(lambda: "", port=0) as server:
        server.tell(Facts(RUN))
        server.publish(GRID)
        assert server.late_comers_get("/grid")
        server.tell(Facts(RUN))
        assert server.late_comers_get("/grid")
        server.tell(Facts(NEXT))
        assert not server.late_comers_get("/grid")
