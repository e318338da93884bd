"""The lease while a program waits for its operator.

A main thread that has not touched its port for a while counts as hung, and the port's process then
stops the robot. One that waits for an answer of the person beside the robot is not hung; whoever
asks says so here, and so for every port of this process.
"""

from __future__ import annotations

from typing import TYPE_CHECKING
from weakref import WeakSet

if TYPE_CHECKING:
    from thigmo.link.serial_port import SerialTransport

# What is told is a fact about the process's main thread, hence one list for the process.
_connections: WeakSet[SerialTransport] = WeakSet()


def attend_at_prompts(connection: SerialTransport) -> None:
    """From now on tell this connection of every prompt."""
    _connections.add(connection)


def waits_for_operator() -> None:
    """The main thread is about to wait for its operator."""
    for connection in list(_connections):
        connection.attend()
