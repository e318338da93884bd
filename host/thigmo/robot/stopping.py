"""Stopping robots from outside the programs that drive them.

`thigmo stop` does it. The process that owns a robot takes the stop, however its program is; a port
that nobody owns is opened for it. Nothing here returns before the board has confirmed the stop.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

from serial.tools.list_ports import comports

from thigmo.errors import LinkError
from thigmo.link import stop_socket
from thigmo.link.client import Client
from thigmo.link.port_owner import owner, processes
from thigmo.link.transport import emulated, open_transport

# A stray byte keeps the boot loader for 9.3 s; after that a board that was reset by the opening of
# its port latches the stop.
_BOOT_S = 12.0


def stop_robot(url: str) -> None:
    """Stop the robot at an address; of an emulated one, all that are under way.

    It stays stopped until an operator clears it (`thigmo clear`).

    Raises PortError if the port cannot be opened, LinkError if the board did not confirm, or no
    program runs the emulated robot.
    """
    if _stop(stop_socket.owners(url)):
        return
    if emulated(url):
        raise LinkError(f"no program of yours runs {url}", "stop the one that does with Ctrl-C")
    with Client(open_transport(url), connect=False) as client:
        client.stop(_BOOT_S)


def stop_all() -> list[str]:
    """Stop every robot that a program of this user owns, all at once; returns their addresses.

    Raises LinkError: nobody owns one, or a board did not confirm (the others are stopped).
    """
    stopped = _stop(stop_socket.running())
    if not stopped:
        used = next((port.device for port in comports() if any(processes(port.device))), None)
        raise LinkError(
            "no program of yours drives a robot"
            + (f", but {used} is in use{owner(used)}" if used else ""),
            "name its port, as in `thigmo stop --robot /dev/ttyACM0`",
        )
    return stopped


def _stop(sockets: Sequence[str]) -> list[str]:
    """Stop the robots behind sockets; the addresses of those that answered."""
    with ThreadPoolExecutor(max(1, len(sockets))) as pool:
        calls = [pool.submit(stop_socket.call, where) for where in sockets]
    # The pool has waited for all of them.
    failed = [error for call in calls if (error := call.exception()) is not None]
    stopped = [url for call in calls if not call.exception() and (url := call.result())]
    if failed:
        if stopped:
            failed[0].add_note(f"stopped: {', '.join(stopped)}")
        raise failed[0]
    return stopped
