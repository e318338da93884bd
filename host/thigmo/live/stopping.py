"""Stop, from the page: by every way that leads to the robot.

A robot on a port is stopped by the process that owns the port, whatever its program does, hangs or
is stopped itself. One that is emulated inside its run has nobody else to ask than the run.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from thigmo.errors import LinkError, PortError
from thigmo.link import stop_socket
from thigmo.robot.stopping import stop_all
from thigmo.stream import Hello

Way = Literal["port", "run", "lost", "none"]


@dataclass(frozen=True, slots=True)
class Stopped:
    """What a stop reached.

    Attributes:
        stopped: addresses of the robots whose boards have confirmed it.
        failed: why one did not, in the operator's words.
    """

    stopped: list[str] = field(default_factory=list)
    failed: str = ""


def way_to(run: Hello | None) -> Way:
    """How a stop would reach the robot now: by its port's process, by its run, or not at all.

    Args:
        run: that is under way; None if none is known.
    """
    if run is not None and run.virtual:
        return "run"
    try:
        owned = stop_socket.running()
    except PortError:
        return "lost"
    if run is None:
        return "port" if owned else "none"
    return "port" if _socket(run.url) in owned else "lost"


def stop_port(run: Hello | None) -> Stopped:
    """Stop the robot of a run on a port, or, where none is known, all that are in use. Blocks until
    the board has confirmed it, for seconds at most."""
    try:
        if run is None:
            return Stopped(stop_all())
        if stop_socket.call(_socket(run.url)) is None:
            return Stopped(failed="nobody owns the robot's port")
        return Stopped([run.url])
    except LinkError as error:
        return Stopped(failed=str(error) if run is not None or stop_socket.running() else "")


def _socket(url: str) -> str:
    return stop_socket.address(url.partition("?baud=")[0])
