"""Who stands beside a robot that is powered up for the first time."""

from __future__ import annotations

from typing import Literal, Protocol

Turned = Literal["out", "in", "not"]


class Attendant(Protocol):
    """Does with his hands what a check needs, and says what he sees."""

    def ready(self, request: str) -> None:
        """Do something; return when it is done."""

    def press_emergency_stop(self, pressed: bool) -> None:
        """Press the emergency stop, or release it; return when it is done."""

    def spool_turned(self) -> Turned:
        """Say how the spool turned since the last question: it paid out, wound in, or neither."""
