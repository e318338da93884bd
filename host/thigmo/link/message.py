"""What the generated protocol.py is made of: messages, their enumerations, parameters.

A message is a frozen dataclass under `message(...)`, which reads from the fields' types how the
integers of its wire format become them: `Status` an enumeration's member, `tuple[int, ...]` an
array, `int` itself.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from inspect import get_annotations
from struct import Struct
from typing import Any, ClassVar, Generic, Self, TypeVar, dataclass_transform, get_args


class Documented(IntEnum):
    """An enumeration whose members carry their sentences of the schema."""

    doc: str

    def __new__(cls, value: int, doc: str = "") -> Self:
        """A member with its sentence."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.doc = doc
        return member

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


class Message:
    """Base of all messages."""

    __slots__ = ()
    ID: ClassVar[int]
    SIZE: ClassVar[int]
    NAME: ClassVar[str]
    KIND: ClassVar[str]
    _FIELDS: ClassVar[tuple[str, ...]]
    _STRUCT: ClassVar[Struct]
    _ENUMS: ClassVar[list[tuple[int, type[Documented]]]]  # places among the integers
    _ARRAYS: ClassVar[list[slice]]  # last first: each becomes one value, and moves what follows

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


R = TypeVar("R", bound=Message)
M = TypeVar("M", bound=Message)
MESSAGES: dict[int, type[Message]] = {}  # by id


class Command(Message, Generic[R]):
    """A message that the board answers with an R, or refuses with an Ack."""

    __slots__ = ()
    REPLY: ClassVar[type[Message]]
    DEADLINE_S: ClassVar[float]


@dataclass_transform(frozen_default=True)
def message(
    number: int, kind: str, layout: str = "", deadline_s: float = 0.0
) -> Callable[[type[M]], type[M]]:
    """Make a message of a class whose fields are annotated with their types.

    Args:
        number: its id on the wire.
        kind: command, reply, datagram, telemetry or event.
        layout: struct codes of the fields in order, one each, as `10H` for an array of ten.
        deadline_s: within which a command must be answered.
    """

    def made(plain: type[M]) -> type[M]:
        types = get_annotations(plain)
        cls = dataclass(frozen=True, slots=True)(plain)
        cls.ID, cls.KIND = number, kind
        cls.NAME = re.sub(r"\B(?=[A-Z])", "_", cls.__name__).lower()
        cls._STRUCT = Struct("<" + layout)
        cls.SIZE = cls._STRUCT.size
        cls._FIELDS, cls._ENUMS, cls._ARRAYS = tuple(types), [], []
        at = 0
        for of, count in zip(types.values(), re.findall(r"(\d*)\D", layout), strict=True):
            if count:
                cls._ARRAYS.insert(0, slice(at, at + int(count)))
            elif of is not int:
                cls._ENUMS.append((at, of))
            at += int(count or 1)
        if issubclass(cls, Command):
            cls.DEADLINE_S = deadline_s
            (cls.REPLY,) = get_args(vars(cls)["__orig_bases__"][0])
        MESSAGES[number] = cls
        return cls

    return made


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
    defaults: tuple[int, ...]
    doc: str


def parameter_table(
    rows: dict[tuple[str, int, int, str, int, int, int | tuple[int, ...]], str],
) -> dict[str, Parameter]:
    """Parameters by name, in the order of their indices.

    Args:
        rows: name, id, count, unit, low, high and default (of each element, or one for all) of
            every parameter, with what it is.
    """
    table: dict[str, Parameter] = {}
    index = 0
    for (name, number, count, unit, low, high, default), doc in rows.items():
        defaults = default if isinstance(default, tuple) else (default,) * count
        table[name] = Parameter(name, number, index, count, unit, low, high, defaults, doc)
        index += count
    return table
