"""Stopping robots from outside the programs that drive them: the one way of every such stop.

The command line, the page, ROS 2 and Foxglove all stop by this. The process that owns a robot takes
the stop, however its program is; a port that nobody owns is opened for it. A stop of an address
stops that robot alone. Nothing here returns before the board has confirmed the stop, or has not.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from serial.tools.list_ports import comports

from thigmo.errors import LinkError, PortError, ThigmoError
from thigmo.link import stop_socket
from thigmo.link.address import over_network
from thigmo.link.client import Client
from thigmo.link.port_owner import owner, processes
from thigmo.link.transport import emulated, open_transport

# A stray byte keeps the boot loader for 9.3 s; after that a board that was reset by the opening of
# its port latches the stop.
_BOOT_S = 12.0

_EMERGENCY = "use the emergency stop"

WayTo = Literal["owner", "port", "none", "lost"]
"""Through whom a stop would reach a robot: the process that owns it, or its port, which nobody
owns; "none" if there is nothing to stop, "lost" if there is no way to it."""


@dataclass(frozen=True, slots=True)
class Stopped:
    """What a stop of one robot came to.

    Attributes:
        robot: its address.
        confirmed_by: who has confirmed that its outputs are off; empty if nobody has.
        failure: why nobody has, and what to do; empty if somebody has.
    """

    robot: str
    confirmed_by: str = ""
    failure: str = ""

    def __str__(self) -> str:
        """A line for the operator."""
        if self.failure:
            return f"NOT stopped {self.robot}: {self.failure}"
        return f"stopped {self.robot}, confirmed by {self.confirmed_by}"


def stop_robot(url: str, program: int | None = None) -> list[Stopped]:
    """Stop the robot at an address, and wait until its board has confirmed that, for seconds at
    most. It stays stopped until an operator clears it (`thigmo clear`).

    Of an emulated robot, all that are under way are stopped, or that of a `program` (a process);
    the result is empty if there is none.
    """
    try:
        if stopped := _call(stop_socket.owners(url, program)):
            return [Stopped(url, result.confirmed_by, result.failure) for result in stopped]
        if emulated(url):
            return []
        with Client(open_transport(url), connect=False) as client:
            client.stop(_BOOT_S)
    except ThigmoError as error:
        return [Stopped(url, failure=failure(error))]
    return [Stopped(url, "its board, over its port, which no program had open")]


def stop_all() -> list[Stopped]:
    """Stop every robot that a program of this user owns, all at once; empty if there is none."""
    try:
        return _call(stop_socket.running())
    except PortError as error:
        return [Stopped("robots in use", failure=failure(error))]


def way_to(url: str | None, program: int | None = None) -> tuple[WayTo, str]:
    """How `stop_robot` would reach a robot, and what prevents it, in words; empty if nothing does.

    Without an address, as for `stop_all`. Touches no port, because opening it resets a board.
    """
    try:
        owned = stop_socket.running() if url is None else stop_socket.owners(url, program)
    except ThigmoError as error:
        return "lost", str(error)
    if owned:
        return "owner", ""
    if url is None:
        return "none", "no robot is in use"
    if emulated(url):
        return "none", f"no program of yours runs {url}"
    if over_network(url) or "://" in url or sys.platform == "win32":
        return "port", ""
    return _port(url.partition("?")[0])


def _port(path: str) -> tuple[WayTo, str]:
    """The way over a port that no program of thigmo owns."""
    if not Path(path).exists():
        return "none", f"there is no port {path}"
    if any(processes(path)):
        return "lost", f"{path} is in use{owner(path)}"
    if not os.access(path, os.R_OK | os.W_OK):
        return "lost", f"no permission to open {path}"
    return "port", ""


def failure(error: ThigmoError) -> str:
    """Why a robot was not stopped, and first of all what needs no program."""
    cure = error.next_step
    if not cure.startswith(_EMERGENCY):
        cure = f"{_EMERGENCY}, or {cure}" if cure else _EMERGENCY
    return f"{error.problem}; {cure}"


def nobody() -> LinkError:
    """The error of a stop without an address where no program of this user owns a robot."""
    used = next((port.device for port in comports() if any(processes(port.device))), None)
    return LinkError(
        "no program of yours drives a robot"
        + (f", but {used} is in use{owner(used)}" if used else ""),
        "name its port, as in `thigmo stop --robot /dev/ttyACM0`",
    )


def _call(sockets: Sequence[str]) -> list[Stopped]:
    """Stop the robots behind sockets, all at once: the results of those whose owner is alive."""
    with ThreadPoolExecutor(max(1, len(sockets))) as pool:
        return [result for result in pool.map(_call_one, sockets) if result is not None]


def _call_one(where: str) -> Stopped | None:
    try:
        answer = stop_socket.call(where)
    except LinkError as error:
        return Stopped(_label(where), failure=failure(error))
    if answer is None:
        return None
    if answer.outcome == "ended":
        return Stopped(answer.url, f"the end of process {answer.program}, which emulated it")
    return Stopped(answer.url, f"its board, through process {answer.program}")


def _label(where: str) -> str:
    """What is known of a robot whose owner does not answer: the end of its address."""
    return re.sub(r"(-[0-9a-f]{8})+(\.\w+-\w+)?$", "", Path(where).name)
