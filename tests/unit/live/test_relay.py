"""What the views of ROS 2 and Foxglove get when one run follows another."""

from __future__ import annotations

import threading
from dataclasses import replace

import pytest
from test_ros_messages import RUN, STATE

from thigmo.live.foxglove import FoxgloveServer
from thigmo.live.relay import Facts, Relay, Target
from thigmo.robot.stopping import Stopped
from thigmo.stream import Grid, Hello, Message

GRID = Grid(1.0, 5.0, 0.5, (0.0, 0.0, 0.0), 1, 1, (0,))
NEXT = replace(RUN, name="next")


class FakeWatched:
    """Gives what a test puts in."""

    def __init__(self) -> None:
        self.url: str | None = None
        self.waiting: list[Message | None] = []
        self.looked = threading.Event()
        self.targets: list[Target] = []

    def take(self) -> list[Message | None]:
        taken, self.waiting = self.waiting, []
        return taken

    def stop(self, target: Target) -> list[Stopped]:
        self.targets.append(target)
        return [Stopped(target.url, "its board")] if target.url else []

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
    watched: FakeWatched,
) -> None:
    passing = Relay(watched)  # type: ignore[arg-type]
    assert _passed(watched, passing, RUN, STATE)[:2] == [("n", ""), ("state", "")]
    stopped = f"stopped {RUN.url}, confirmed by its board"
    assert passing.stop() == stopped
    assert ("n", stopped) in _passed(watched, passing, STATE)
    said = _passed(watched, passing, None, NEXT, STATE)
    assert said[:2] == [("n", stopped), ("next", stopped)]  # the last stop stays known


def test_stop_that_comes_before_a_run_under_way_is_known_stops_it(watched: FakeWatched) -> None:
    passing = Relay(watched)  # type: ignore[arg-type]
    emulated = replace(RUN, virtual=True)

    class Found(threading.Event):
        def wait(self, timeout: float | None = None) -> bool:
            _passed(watched, passing, emulated, STATE)
            return True

    passing._looked = Found()
    assert passing.stop() == f"stopped {RUN.url}, confirmed by its board"
    assert watched.targets == [Target(None), Target(RUN.url, emulated)]


VIRTUAL = replace(RUN, virtual=True, url="emulator://scripted")


@pytest.mark.parametrize(
    ("url", "run", "under_way", "target"),
    [
        ("/dev/a", None, False, Target("/dev/a")),
        ("/dev/a", RUN, False, Target("/dev/a")),
        ("/dev/a", VIRTUAL, False, Target("/dev/a")),
        (None, RUN, True, Target(RUN.url, RUN)),
        (None, RUN, False, Target(RUN.url)),  # what it has shown last
        (None, VIRTUAL, True, Target(VIRTUAL.url, VIRTUAL)),
        (None, VIRTUAL, False, Target(None)),  # it has ended with its run
        (None, None, False, Target(None)),
    ],
)
def test_a_view_stops_the_robot_whose_name_it_bears(
    url: str | None, run: Hello | None, under_way: bool, target: Target
) -> None:
    assert Target.of(url, run, under_way=under_way) == target


def test_foxglove_gives_late_comers_nothing_of_the_run_before() -> None:
    with FoxgloveServer(lambda: "", port=0) as server:
        server.tell(Facts(RUN))
        server.publish(GRID)
        assert server.late_comers_get("/grid")
        server.tell(Facts(RUN))
        assert server.late_comers_get("/grid")
        server.tell(Facts(NEXT))
        assert not server.late_comers_get("/grid")
