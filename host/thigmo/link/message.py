"""What the generated protocol.py is made of: messages, their enumerations, parameters.

A message is a frozen dataclass. Its base reads the wire's layout off the fields' types, which carry
their struct codes; enumerations are bytes. The sentences of enumerations, and the parameters, are
data: protocol.json beside this file.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from enum import IntEnum
from inspect import get_annotations
from pathlib import Path
from struct import Struct
from typing import Annotated, Any, ClassVar, Generic, Self, TypeVar, dataclass_transform, get_args

_DATA = json.loads(Path(__file__).with_name("protocol.json").read_text(encoding="utf-8"))


class Documented(IntEnum):
    """An enumeration whose members have a sentence each in the schema."""

    @property
    def doc(self) -> str:
        """The schema's sentence."""
        return str(_DATA["enums"][type(self).__name__][self.key])

    @property
    def key(self) -> str:
        """The name as the schema writes it."""
        return self.name.lower()

    @property
    def told(self) -> tuple[str, str]:
        """The sentence in two: what it is, and what to do next (empty if it does not say)."""
        what, _, step = self.doc.rstrip(".").partition("; ")
        return what, step

    @property
    def mask(self) -> int:
        """The member as a bit mask (enumerations of bits)."""
        return 1 << self.value

    @classmethod
    def from_mask(cls, mask: int) -> tuple[Self, ...]:
        """The members whose bits are set in a mask."""
        return tuple(member for member in cls if mask >> int(member) & 1)


class OpenDocumented(Documented):
    """An enumeration that may travel with values which this host does not list."""

    @classmethod
    def _missing_(cls, value: object) -> Self | None:
        if not isinstance(value, int) or not 0 <= value <= 255:
            return None
        member = int.__new__(cls, value)
        member._name_, member._value_ = f"UNLISTED_{value}", value
        return cls._value2member_map_.setdefault(value, member)  # type: ignore[return-value]

    @property
    def doc(self) -> str:
        """The schema's sentence, or that it has none."""
        sentences = _DATA["enums"][type(self).__name__]
        return str(sentences.get(self.key, f"Number {self.value}, which this host does not list."))


U8 = Annotated[int, "B"]
U16 = Annotated[int, "H"]
I16 = Annotated[int, "h"]
U32 = Annotated[int, "I"]
I32 = Annotated[int, "i"]


@dataclass_transform(frozen_default=True)
class Message:
    """Base of all messages."""

    ID: ClassVar[int]
    SIZE: ClassVar[int]
    NAME: ClassVar[str]
    _FIELDS: ClassVar[tuple[str, ...]]
    _STRUCT: ClassVar[Struct]
    _ENUMS: ClassVar[list[tuple[int, type[Documented]]]]  # places among the integers
    _ARRAYS: ClassVar[list[slice]]  # last first: each becomes one value, and moves what follows

    def __init_subclass__(cls, *, number: int = 0, deadline_s: float = 2.0) -> None:
        """Make a message of an annotated class; `number` is its id on the wire, 0 of a base."""
        super().__init_subclass__()
        if not number:
            return
        dataclass(frozen=True)(cls)
        cls.ID = number
        cls.NAME = re.sub(r"\B(?=[A-Z])", "_", cls.__name__).lower()
        types = get_annotations(cls)
        cls._FIELDS, cls._ENUMS, cls._ARRAYS = tuple(types), [], []
        layout, at = "<", 0
        for of in types.values():
            code = getattr(of, "__metadata__", ("B",))[0]  # an enumeration is a byte
            count = int(code[:-1] or 1)
            if count > 1:
                cls._ARRAYS.insert(0, slice(at, at + count))
            elif isinstance(of, type):
                cls._ENUMS.append((at, of))
            layout += code
            at += count
        cls._STRUCT = Struct(layout)
        cls.SIZE = cls._STRUCT.size
        if issubclass(cls, Command):
            cls.DEADLINE_S = deadline_s
            (cls.REPLY,) = get_args(vars(cls)["__orig_bases__"][0])
        MESSAGES[number] = cls

    def pack(self) -> bytes:
        """The payload."""
        flat: list[int] = []
        for name in self._FIELDS:
            value = getattr(self, name)
            flat += value if isinstance(value, tuple) else (value,)
        return self._STRUCT.pack(*flat)

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """Read a payload; raises ValueError on a bad size or an unknown enum value."""
        if len(payload) != cls.SIZE:
            raise ValueError(f"{cls.NAME}: {len(payload)} bytes of payload, {cls.SIZE} expected")
        values: list[Any] = [*cls._STRUCT.unpack(payload)]
        for at, enum in cls._ENUMS:
            values[at] = enum(values[at])
        for place in cls._ARRAYS:
            values[place] = [tuple(values[place])]
        return cls(*values)


class Reply(Message):
    """The board's answer to a command."""


MESSAGES: dict[int, type[Message]] = {}  # by id
R = TypeVar("R", bound=Message)


class Command(Message, Generic[R]):
    """A message that the board answers with an R, or refuses with an Ack."""

    REPLY: ClassVar[type[Message]]
    DEADLINE_S: ClassVar[float]  # within which it must be answered


@dataclass(frozen=True, slots=True)
class Parameter:
    """A row of the parameter table; arrays take `count` consecutive indices."""

    name: str
    id: int
    index: int
    count: int
    unit: str
    low: int
    high: int
    defaults: list[int]
    doc: str


PARAMETERS = {row["name"]: Parameter(**row) for row in _DATA["parameters"]}
