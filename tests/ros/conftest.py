"""Programs beside the robot: the bridge, a planner of ROS's own, a reader of transforms."""

from __future__ import annotations

import itertools
import json
import os
import re
import shlex
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

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
        said: all that it has printed; words have the topic "line".
    """

    def __init__(self, command: list[str], env: dict[str, str]) -> None:
        self.said: list[Told] = []
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
                self.said.append(json.loads(line) if is_object else {"topic": "line", "text": line})
                self._changed.notify_all()

    def say(self, line: str) -> None:
        """Write a line to it."""
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def hears(self, matches: Callable[[Told], bool]) -> Told:
        """The first object of a kind; waits for it."""
        with self._changed:
            line = self._changed.wait_for(lambda: next(filter(matches, self.said), None), 60.0)
        assert line, f"never came; the last were {self.said[-5:]}"
        return line

    def of(self, topic: str) -> list[Told]:
        return [message for message in self.said if message["topic"] == topic]

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
            "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]),
        }

    def bridge(self, *arguments: str | Path) -> Program:
        return self._start([sys.executable, "-m", "thigmo", "ros", *map(str, arguments)])

    def planner(self, namespace: str = "thigmo") -> Program:
        """A node of rclpy, once it is ready."""
        assert ROS_PYTHON.exists(), "`make .stamps/ros` installs ROS for the tests"
        planner = self._start([str(ROS_PYTHON), str(HERE / "planner.py"), namespace])
        planner.hears(lambda said: said["topic"] == "ready")
        return planner

    def launch(self, **given: str | Path) -> list[Program]:
        """The programs of ros/thigmo_ros's launch file; what is not given has its default.

        The file is read here, for the tests install nothing of ROS's `launch`: its elements
        `executable` and `node` are started as `ros2 launch` starts them.
        """
        file = ROS_PYTHON.parents[1] / "share" / "thigmo_ros" / "launch" / "thigmo.launch.xml"
        launch = ElementTree.parse(file).getroot()
        known = {
            argument.attrib["name"]: argument.attrib["default"] for argument in launch.iter("arg")
        }
        assert given.keys() <= known.keys(), "the launch file has no such argument"
        known |= {name: str(value) for name, value in given.items()}

        def filled(text: str) -> str:
            return re.sub(r"\$\(var (\w+)\)", lambda match: known[match[1]], text)

        started = []
        for program in launch:
            if program.tag == "executable":
                started.append(self._start(shlex.split(filled(program.attrib["cmd"]))))
            elif program.tag == "node":
                node = (
                    ROS_PYTHON.parents[1] / "lib" / program.attrib["pkg"] / program.attrib["exec"]
                )
                command = [str(ROS_PYTHON), str(node), "--ros-args"]
                command += ["-r", f"__ns:=/{filled(program.attrib['namespace'])}"]
                for argument in program.iter("param"):
                    value = json.dumps(filled(argument.attrib["value"]))
                    command += ["-p", f"{argument.attrib['name']}:={value}"]
                started.append(self._start(command))
            else:
                assert program.tag == "arg", f"the tests cannot start <{program.tag}>"
        return started

    def transforms(self) -> Program:
        """A reader of /tf and /tf_static."""
        return self._start([sys.executable, str(HERE / "transforms.py"), str(self.domain)])

    def _start(self, command: list[str]) -> Program:
        return self._stack.enter_context(Program(command, self._env))


@pytest.fixture
def ros(own_sockets: None) -> Iterator[Ros]:
    with ExitStack() as stack:
        yield Ros(stack)
