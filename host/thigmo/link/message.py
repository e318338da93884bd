"""What the generated protocol.py is made of: messages, their enumerations, parameters.

A message is a frozen dataclass. Its base reads the wire's layout off the fields' types, which carry
their struct codes; enumerations are bytes. An array of muscles or sensors is as long as the board's
capacity: its code names what counts it (`muscles?h`), and the first such array of a message comes
after their number. The sentences of enumerations, and the parameters, are
data: protocol.json beside this file.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from inspect import get_annotations
from pathlib import Path
from struct import Struct, calcsize
from typing import (
    Annotated,
    Any,
    ClassVar,
    Generic,
    NamedTuple,
    Self,
    TypeVar,
    dataclass_transform,
    get_args,
)

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
    def words(self) -> tuple[str, str]:
        """The sentence in two: what it is, and what to do next (empty if it does not say)."""
        problem, _, step = self.doc.rstrip(".").partition("; ")
        return problem, step

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
    SIZE: ClassVar[int]  # of the payload, of a board for the thesis's robot
    NAME: ClassVar[str]
    CODES: ClassVar[dict[str, str]]  # struct code of each field
    _COUNTED: ClassVar[tuple[str, ...]]  # what of the capacity it counts
    _ENUMS: ClassVar[list[tuple[int, type[Documented]]]]  # places among the fields

    def __init_subclass__(cls, *, number: int = 0, deadline_s: float = 2.0) -> None:
        """Make a message of an annotated class; `number` is its id on the wire, 0 of a base."""
        super().__init_subclass__()
        if not number:
            return
        dataclass(frozen=True)(cls)
        cls.ID = number
        cls.NAME = re.sub(r"\B(?=[A-Z])", "_", cls.__name__).lower()
        types = get_annotations(cls)
        # An enumeration is a byte.
        cls.CODES = {name: getattr(hint, "__metadata__", ("B",))[0] for name, hint in types.items()}
        cls._ENUMS = [
            (index, hint) for index, hint in enumerate(types.values()) if isinstance(hint, type)
        ]
        cls._COUNTED = tuple(
            dict.fromkeys(code.partition("?")[0] for code in cls.CODES.values() if "?" in code)
        )
        cls.SIZE = cls._layout(
            tuple(_DATA["usual"][counted] for counted in cls._COUNTED)
        ).struct.size
        if issubclass(cls, Command):
            cls.DEADLINE_S = deadline_s
            (cls.REPLY,) = get_args(vars(cls)["__orig_bases__"][0])
        MESSAGES[number] = cls

    @classmethod
    @cache
    def _layout(cls, counts: tuple[int, ...]) -> _Layout:
        """The layout for given counts of the message's arrays."""
        number = dict(zip(cls._COUNTED, counts, strict=True))
        code, place, places, count_at = "<", 0, [], {}
        for field in cls.CODES.values():
            counted, _, element = field.rpartition("?")
            if counted and counted not in count_at:
                count_at[counted] = calcsize(code)
                code += "B"
                place += 1
            count = number[counted] if counted else int(element[:-1] or 1)
            code += f"{count}{element[-1]}"
            array = bool(counted) or count > 1
            places.append(slice(place, place + count) if array else place)
            place += count
        return _Layout(Struct(code), tuple(places), tuple(count_at.values()))

    @classmethod
    def counts(cls, payload: bytes) -> tuple[int, ...]:
        """Numbers of muscles, sensors and so on in a payload; ValueError if it is malformed."""
        counts: tuple[int, ...] = ()
        for number in range(len(cls._COUNTED)):
            # Where the next count stands, only those before it decide.
            layout = cls._layout((*counts, *[0] * (len(cls._COUNTED) - number)))
            if (place := layout.count_at[number]) >= len(payload):
                break
            counts += (payload[place],)
        if len(counts) == len(cls._COUNTED):
            size = cls._layout(counts).struct.size
            if size == len(payload):
                return counts
        size = cls.SIZE
        raise ValueError(f"{cls.NAME}: {len(payload)} bytes of payload, {size} expected")

    @classmethod
    def fits(cls, payload: bytes) -> bool:
        """Whether a payload is of the message's size, for the counts in it."""
        try:
            cls.counts(payload)
        except ValueError:
            return False
        return True

    def pack(self) -> bytes:
        """The payload."""
        values = [getattr(self, name) for name in self.CODES]
        flat: list[int] = []
        number: dict[str, int] = {}
        for code, value in zip(self.CODES.values(), values, strict=True):
            counted = code.rpartition("?")[0]
            if counted and counted not in number:
                number[counted] = len(value)
                flat.append(len(value))
            flat += value if isinstance(value, tuple) else (value,)
        return self._layout(tuple(number.values())).struct.pack(*flat)

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """Read a payload; raises ValueError on a bad size or an unknown enum value."""
        layout = cls._layout(cls.counts(payload))
        flat = layout.struct.unpack(payload)
        values: list[Any] = [flat[place] for place in layout.places]
        for number, enum in cls._ENUMS:
            values[number] = enum(values[number])
        return cls(*values)


class _Layout(NamedTuple):
    """Where a message's numbers are, for given counts."""

    struct: Struct
    places: tuple[int | slice, ...]  # of each field among the integers
    count_at: tuple[int, ...]  # bytes before each count


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


@cache
def parameters(**capacity: int) -> dict[str, Parameter]:
    """The parameter table, by name, of a board with these numbers of muscles, sensors and so on."""
    parameters: dict[str, Parameter] = {}
    index = 0
    for row in _DATA["parameters"]:
        count = capacity[row["counted_by"]] if row["counted_by"] else 1
        if count == 0:
            continue  # its firmware leaves that parameter out
        stated_defaults = row["defaults"]
        if len(stated_defaults) == 1:
            defaults = stated_defaults * count
        else:
            defaults = [*stated_defaults, *[0] * count][:count]
        texts = {key: row[key] for key in ("name", "id", "unit", "low", "high", "doc")}
        parameters[row["name"]] = Parameter(index=index, count=count, defaults=defaults, **texts)
        index += count
    return parameters


# Of all parameters by their ids, also of those that a board may lack.
PARAMETER_NAMES: dict[int, str] = {row["id"]: row["name"] for row in _DATA["parameters"]}
# Of boards that are built for the thesis's robot.
PARAMETERS = parameters(**_DATA["usual"])
PARAMETER_COUNT = sum(row.count for row in PARAMETERS.values())
