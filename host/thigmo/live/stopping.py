"""Stop, from the page: by every way that leads to the robot.

A robot on a port is stopped by the process that owns the port, whatever its program does, hangs or
is stopped itself. One that is emulated inside its run has nobody else to ask than the run.
"""

from __future__ import annotations

from typing import Literal

from thigmo.errors import LinkError, PortError
from thigmo.link import stop_socket
from thigmo.robot.stopping import stop_all
from thigmo.stream import Hello

Way = Literal["port", "run", "lost", "none"]


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


def stop_port(run: Hello | None) -> list[str]:
    """Stop the robot of a run on a port, or, where none is known, all that are in use. Blocks until
    the board has confirmed it, for seconds at most.

    Returns:
        Addresses of the robots whose boards have confirmed it; none where no robot is in use.

    Raises:
        LinkError: one has not.
    """
    if run is not None:
        if stop_socket.call(_socket(run.url)) is None:
            raise LinkError("nobody owns the robot's port")
        return [run.url]
    try:
        return stop_all()
    except LinkError:
        if stop_socket.running():
            raise
        return []


def _socket(url: str) -> str:
    return stop_socket.address(url.partition("?baud=")[0])
