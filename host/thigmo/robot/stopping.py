"""Stopping robots from outside the programs that drive them.

`thigmo stop` does it. The process that owns a robot's port takes the stop, however its program is;
a port that nobody owns is opened for it.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

from thigmo.errors import LinkError
from thigmo.link import stop_socket
from thigmo.link.client import Client
from thigmo.link.transport import open_transport

# A stray byte keeps the boot loader for 9.3 s; after that a board that was reset by the opening of
# its port latches the stop.
_BOOT_S = 12.0


def stop_robot(url: str) -> None:
    """Stop the robot on a port. It stays stopped until an operator clears it (`thigmo clear`).

    Raises PortError if the port cannot be opened, LinkError if the board did not confirm.
    """
    if stop_socket.call(stop_socket.address(url.partition("?baud=")[0])) is not None:
        return
    with Client(open_transport(url), connect=False) as client:
        client.stop(_BOOT_S)


def stop_all() -> list[str]:
    """Stop every robot whose port a program of this user owns, all at once; returns the ports.

    Raises LinkError: nobody owns one, or a board did not confirm (the others are stopped).
    """
    sockets = stop_socket.running()
    with ThreadPoolExecutor(max(1, len(sockets))) as pool:
        calls = [pool.submit(stop_socket.call, where) for where in sockets]
    # The pool has waited for all of them.
    stopped = [url for call in calls if (url := call.result()) is not None]
    if not stopped:
        raise LinkError(
            "no program of yours drives a robot",
            "name its port, as in `thigmo stop --robot /dev/ttyACM0`",
        )
    return stopped
