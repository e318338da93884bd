"""Typed errors. Each says in one line what happened and what to do next.

Raised by every layer, printed by the command line, caught by programs that drive the robot.
`str(error)` is the operator's line: "what happened; next step".
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class ThigmoError(Exception):
    """Base of all errors that an operator can act on.

    Args:
        problem: what happened, without a full stop.
        next_step: what to do next, as an imperative.
    """

    def __init__(self, problem: str, next_step: str = "") -> None:
        self.problem = problem
        self.next_step = next_step
        super().__init__(f"{problem}; {next_step}" if next_step else problem)

    @classmethod
    @contextmanager
    def from_os(cls, problem: str, next_step: str) -> Iterator[None]:
        """Turn an OSError in the block into this error, with the system's reason."""
        try:
            yield
        except OSError as error:
            raise cls(f"{problem}: {error.strerror}", next_step) from error


class LinkError(ThigmoError):
    """The connection to the board failed."""


class PortError(LinkError):
    """The port is missing, busy or not allowed."""


class NotARobotError(LinkError):
    """No thigmo board answers on the port."""


class SchemaMismatchError(LinkError):
    """Board and host were built from different protocol schemas."""


class CommandTimeoutError(LinkError):
    """A command got no answer before its deadline."""


class BoardResetError(LinkError):
    """The board restarted during a session; its state and the everted length are lost."""


class CommandRefusedError(ThigmoError):
    """The board refused a command; `reason` is the schema's name of the reason.

    `detail` is a number that the board adds: a limit, or the index of the wrong parameter.
    """

    def __init__(
        self, problem: str, next_step: str = "", *, reason: str = "", detail: int = 0
    ) -> None:
        self.reason = reason
        self.detail = detail
        super().__init__(problem, next_step)


class RobotFaultError(ThigmoError):
    """The board latched faults; `faults` holds their names in the schema."""

    def __init__(self, problem: str, next_step: str = "", *, faults: tuple[str, ...] = ()) -> None:
        self.faults = faults
        super().__init__(problem, next_step)


class InterrogatorError(ThigmoError):
    """A fibre's interrogator is disconnected, silent or late, or a grating is lost."""


class StoppedByViewerError(ThigmoError):
    """A viewer of the run stopped the robot."""


class ConfigError(ThigmoError):
    """A robot.toml or scene file is malformed."""


class DataError(ThigmoError, ValueError):
    """Input data (arrays, CSV) cannot be used as given."""


class RunFolderError(ThigmoError):
    """A run folder cannot be written or read."""
