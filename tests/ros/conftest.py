"""Programs beside the robot: the bridge, a planner of ROS's own, a reader of transforms."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from thigmo.closing import Closing

HERE = Path(__file__).parent
ROS_PYTHON = HERE.parents[1] / ".venv-ros" / "bin" / "python"
Told = dict[str, Any]
# DDS has ports of its own for each domain; above this one they are those of outgoing connections.
_DOMAINS = 100


class Program(Closing):
    """A program that prints one JSON object a line, or words. A context manager.

    Attributes:
        told: all that it has printed; words have the topic "line".
    """

    def __init__(self, command: list[str], env: dict[str, str]) -> None:
        self.told: list[Told] = []
        self._changed = threading.Condition()
        self._process = subprocess.Popen(
            command, env=os.environ | env, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with self._changed:
                is_object = line.startswith("{")
                self.told.append(json.loads(line) if is_object else {"topic": "line", "text": line})
                self._changed.notify_all()

    def say(self, line: str) -> None:
        """Write a line to it."""
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def hears(self, wanted: Callable[[Told], bool]) -> Told:
        """The first object of a kind; waits for it."""
        with self._changed:
            found = self._changed.wait_for(lambda: next(filter(wanted, self.told), None), 60.0)
        assert found, f"never came; the last were {self.told[-5:]}"
        return found

    def of(self, topic: str) -> list[Told]:
        """Objects of a topic so far."""
        return [each for each in self.told if each["topic"] == topic]

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        self._reader.join()
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            pipe.close()


class Ros:
    """A ROS domain on this machine, which no other test uses."""

    _numbers = itertools.count()

    def __init__(self, stack: ExitStack) -> None:
        self.domain = 1 + (7 * os.getpid() + next(self._numbers)) % _DOMAINS
        self._stack = stack
        self._env = {
            "ROS_DOMAIN_ID": str(self.domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "PYTHONUNBUFFERED": "1",
        }

    def bridge(self, *arguments: str | Path) -> Program:
        """`thigmo ros`, with the same domain as its neighbours by their environment."""
        return self._start([sys.executable, "-m", "thigmo", "ros", *map(str, arguments)])

    def planner(self, namespace: str = "thigmo") -> Program:
        """A node of rclpy, once it is ready."""
        assert ROS_PYTHON.exists(), "`make .stamps/ros` installs ROS for the tests"
        planner = self._start([str(ROS_PYTHON), str(HERE / "planner.py"), namespace])
        planner.hears(lambda told: told["topic"] == "ready")
        return planner

    def robot(self, url: str, options: str, namespace: str = "thigmo") -> Program:
        """The node of ros/thigmo_ros that serves the action and the services of a robot."""
        node = ROS_PYTHON.parents[1] / "lib" / "thigmo_ros" / "robot.py"
        command = [str(ROS_PYTHON), str(node), "--ros-args", "-r", f"__ns:=/{namespace}"]
        thigmo = Path(sys.executable).with_name("thigmo")
        for name, value in (("robot", url), ("thigmo", thigmo), ("options", options)):
            command += ["-p", f"{name}:={json.dumps(str(value))}"]
        return self._start(command)

    def transforms(self) -> Program:
        """A reader of /tf and /tf_static."""
        return self._start([sys.executable, str(HERE / "transforms.py"), str(self.domain)])

    def _start(self, command: list[str]) -> Program:
        return self._stack.enter_context(Program(command, self._env))


@pytest.fixture
def ros(own_sockets: None) -> Iterator[Ros]:
    with ExitStack() as stack:
        yield Ros(stack)
