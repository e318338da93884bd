"""The stream's messages as Protocol Buffers, with schemas made from their dataclasses.

A schema is a file descriptor, so that any tool that reads MCAP or Foxglove's protocol decodes the
messages without this package. A number is a double, and NaN where it is not known; a tuple is a
repeated field; a tuple of tuples is a repeated `Row`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from operator import attrgetter
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

from google.protobuf import message_factory
from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import (
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import Message as Proto

from thigmo.stream.foxglove import VIEWS, views
from thigmo.stream.messages import CHANNELS, RECORDED, Message, validated

_PACKAGE = "thigmo"
_SCALARS = {
    float: FieldDescriptorProto.TYPE_DOUBLE,
    int: FieldDescriptorProto.TYPE_INT64,
    bool: FieldDescriptorProto.TYPE_BOOL,
    str: FieldDescriptorProto.TYPE_STRING,
}


@dataclass(frozen=True, slots=True)
class Row:
    """A tuple in a tuple: protobuf repeats no repeated field."""

    values: tuple[float, ...]


class _Field(NamedTuple):
    """A dataclass's field as protobuf has it."""

    name: str
    kind: type  # of _SCALARS, or a dataclass
    repeated: bool
    optional: bool


def _plain(hint: Any) -> Any:
    """A type hint without its annotations."""
    if get_origin(hint) is Annotated:
        return _plain(get_args(hint)[0])
    return str if get_origin(hint) is Literal else hint


@cache
def _fields(kind: type) -> tuple[_Field, ...]:
    hints = get_type_hints(kind, include_extras=True)
    made = []
    for each in fields(kind):
        hint = _plain(hints[each.name])
        options = get_args(hint) if get_origin(hint) in (Union, UnionType) else ()
        optional = NoneType in options
        if optional:
            (hint,) = (_plain(option) for option in options if option is not NoneType)
        repeated = get_origin(hint) in (tuple, list)
        if repeated:
            hint = _plain(get_args(hint)[0])
        made.append(_Field(each.name, Row if get_origin(hint) else hint, repeated, optional))
    return tuple(made)


@cache
def _file(channel: str) -> FileDescriptor:
    """The descriptor of a channel's file."""
    kind = CHANNELS[channel]
    file = FileDescriptorProto(
        name=f"{_PACKAGE}/{kind.__name__}.proto", package=_PACKAGE, syntax="proto3"
    )
    _add(file, kind)
    pool = DescriptorPool()
    pool.Add(file)
    return pool.FindFileByName(file.name)


def _add(file: FileDescriptorProto, kind: type) -> None:
    if any(known.name == kind.__name__ for known in file.message_type):
        return
    described = file.message_type.add(name=kind.__name__)
    for number, each in enumerate(_fields(kind), start=1):
        added = described.field.add(name=each.name, number=number)
        added.label = (
            FieldDescriptorProto.LABEL_REPEATED
            if each.repeated
            else FieldDescriptorProto.LABEL_OPTIONAL
        )
        added.type = _SCALARS.get(each.kind, FieldDescriptorProto.TYPE_MESSAGE)
        if each.kind not in _SCALARS:
            added.type_name = f".{_PACKAGE}.{each.kind.__name__}"
            _add(file, each.kind)
        if each.optional:
            added.proto3_optional = True
            added.oneof_index = len(described.oneof_decl)
            described.oneof_decl.add(name=f"_{each.name}")


def schema(channel: str) -> tuple[str, bytes]:
    """A channel's schema: its name, and the serialized FileDescriptorSet."""
    return f"{_PACKAGE}.{CHANNELS[channel].__name__}", _descriptor_set(_file(channel))


def topics() -> dict[str, tuple[str, bytes]]:
    """What a run tells by protobuf, in records and to Foxglove: topics and their schemas."""
    drawn = {topic: kind.DESCRIPTOR for topic, kind in VIEWS.items()}
    return {f"/{channel}": schema(channel) for channel in RECORDED} | {
        topic: (each.full_name, _descriptor_set(each.file)) for topic, each in drawn.items()
    }


def encoded(message: Message) -> list[tuple[str, bytes]]:
    """A message on `topics`: itself, and how Foxglove draws it."""
    drawn = [(topic, view.SerializeToString()) for topic, view in views(message)]
    return [(f"/{message.CHANNEL}", to_protobuf(message)), *drawn]


def _descriptor_set(file: Any) -> bytes:
    """A file and all that it imports, as a serialized FileDescriptorSet."""
    every = FileDescriptorSet()

    def add(each: Any) -> None:
        for needed in each.dependencies:
            add(needed)
        if not any(known.name == each.name for known in every.file):
            each.CopyToProto(every.file.add())

    add(file)
    return every.SerializeToString()


@cache
def _proto(channel: str) -> type[Proto]:
    name = CHANNELS[channel].__name__
    return message_factory.GetMessageClass(_file(channel).message_types_by_name[name])


@cache
def _reader(kind: Any) -> tuple[list[str], attrgetter[Any], list[_Field]]:
    """A dataclass's names, what reads them all (a frame of telemetry is recorded 200 times a
    second), and the fields that hold more than numbers and words."""
    names = [each.name for each in _fields(kind)]
    return names, attrgetter(*names), [each for each in _fields(kind) if each.kind not in _SCALARS]


def _dict(value: Any) -> dict[str, Any]:
    kind: Any = type(value)
    names, read, nested = _reader(kind)
    made = dict(zip(names, read(value), strict=True))
    for each in nested:
        held = made[each.name]
        if each.kind is Row:
            made[each.name] = [{"values": row} for row in held]
        else:
            made[each.name] = [_dict(one) for one in held] if each.repeated else _dict(held)
    return made


def to_protobuf(message: Message) -> bytes:
    """A message's bytes, by `schema`."""
    return _proto(message.CHANNEL)(**_dict(message)).SerializeToString()


def from_protobuf(channel: str, data: bytes) -> Message:
    """The message of `to_protobuf`'s bytes.

    Raises:
        DataError: these are not such bytes.
        KeyError: there is no such channel.
    """
    proto = _proto(channel)()
    proto.MergeFromString(data)
    return validated(channel, _read(proto, CHANNELS[channel]))


def _read(proto: Any, kind: type) -> dict[str, Any]:
    read: dict[str, Any] = {}
    for each in _fields(kind):
        value = getattr(proto, each.name)
        if each.optional and not proto.HasField(each.name):
            value = None
        elif each.kind is Row:
            value = [tuple(row.values) for row in value]
        elif each.kind not in _SCALARS:
            value = (
                [_read(one, each.kind) for one in value]
                if each.repeated
                else _read(value, each.kind)
            )
        elif each.repeated:
            value = tuple(value)
        read[each.name] = value
    return read
