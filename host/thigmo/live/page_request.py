"""What a page asks of its server, over its WebSocket: checked once, before anything else sees it.

A page of ours sends nothing else; whatever is not of this form is ignored.
"""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, FiniteFloat, ValidationError

from thigmo.stream import Text

Name = Literal["choose", "hold", "start", "clear", "retract", "jog", "pause", "resume", "answer"]


class PageRequest(BaseModel):
    """A request, or the acknowledgement of a batch.

    Attributes:
        ack: a batch was taken.
        command: what is asked; None if nothing is.
        pid: process of the run to choose.
        text: an answer.
        realtime: pace of an emulated robot, of `start`.
        parameters: values of the exploration's options by their flags, of `start`.
        length, to: everted length as measured and wanted, cm, of `retract`.
        way, cm: direction and distance of `jog`.
    """

    ack: int | None = None
    command: Name | None = None
    pid: int | None = None
    text: Text = ""
    realtime: bool = True
    parameters: dict[str, Text | FiniteFloat] = {}
    length: FiniteFloat | None = None
    to: FiniteFloat | None = None
    way: Literal["out", "in"] | None = None
    cm: FiniteFloat | None = None


def parse(text: str) -> PageRequest | None:
    """The request that a text holds; None if it holds none."""
    try:
        return PageRequest.model_validate_json(text)
    except ValidationError:
        return None
