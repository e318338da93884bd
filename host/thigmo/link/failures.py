"""The client's errors in the operator's words: what happened, and what to do next."""

from __future__ import annotations

from thigmo.errors import (
    BoardResetError,
    CommandTimeoutError,
    LinkError,
    NotARobotError,
    SchemaMismatchError,
)
from thigmo.link import protocol as wire
from thigmo.link.transport import Transport


def timed_out(command: wire.Message, limit_s: float) -> CommandTimeoutError:
    """No answer by the deadline."""
    return CommandTimeoutError(
        f"{command.NAME} got no answer within {limit_s:g} s, and may or may not be done",
        "check the cable and the board's power, and look at the robot's status",
    )


def restarted(cause: wire.ResetCause) -> BoardResetError:
    """The board has another boot nonce than at the hello."""
    return BoardResetError(
        f"the board restarted ({cause.key.replace('_', ' ')}): outputs are safe, "
        "the everted length is unknown",
        "connect again, then measure and confirm the length",
    )


def taken_over() -> LinkError:
    """The board has a session with another host."""
    return LinkError(
        "another program has taken over the robot, which now stands still",
        "close one of the two, and start again with the other",
    )


def other_schema(schema_hash: int, transport: Transport) -> SchemaMismatchError:
    """Board and host do not speak the same protocol."""
    return SchemaMismatchError(
        f"the board's firmware has schema {schema_hash:08x}, this host has {wire.SCHEMA_HASH:08x}",
        _new_firmware(transport),
    )


def _new_firmware(transport: Transport) -> str:
    flash = f"run `thigmo flash --robot {transport.name}`"
    return "run `make install`" if transport.virtual else flash


def nobody(
    transport: Transport, *, announced: bool, frames: int, strange: int, garbage: int
) -> LinkError:
    """No hello was answered.

    Args:
        transport: the connection on which no hello was answered.
        announced: whether an announce came.
        frames: whole frames with a good check sequence, which only a thigmo board sends.
        strange: frames of a layout that this host cannot read.
        garbage: bytes that were no frames.
    """
    if strange:
        return SchemaMismatchError(
            f"the board on {transport.name} speaks another layout of the protocol ({strange} whole "
            "frames that this host cannot read)",
            _new_firmware(transport),
        )
    if announced or frames:
        does = "announces itself" if announced else "talks"
        return NotARobotError(
            f"the board on {transport.name} {does} but does not answer",
            "check the cable's transmit line, or try another cable",
        )
    if garbage:
        return NotARobotError(
            f"{transport.name} sends {garbage} bytes that are not from a robot",
            "choose the robot's port, check its baud rate, or run `thigmo flash` on it",
        )
    return NotARobotError(
        f"nothing answers on {transport.name}",
        "check power and cable, choose the robot's port, or run `thigmo flash` on it",
    )
