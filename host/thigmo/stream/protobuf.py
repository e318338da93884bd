"""The stream's messages as Protocol Buffers, with schemas made from their dataclasses.

A schema is a file descriptor, so that any tool that reads MCAP or Foxglove's protocol decodes the
messages without this package. A number is a double, and NaN where it is not known; a tuple is a
repeated field; a tuple of tuples is a repeated `Row`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

from google.protobuf import message_factory
from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import Message as Proto

from thigmo.stream.messages import CHANNELS, Message, validated

_PACKAGE = "thigmo"
_SCALARS = {
    float: FieldDescriptorProto.TYPE_DOUBLE,
    int: FieldDescriptorProto.TYPE_INT64,
    bool: FieldDescriptorProto.TYPE_BOOL,
    str: FieldDescriptorProto.TYPE_STRING,
}
_ROW = "Row"


class _Field(NamedTuple):
    """A dataclass's field as protobuf has it."""

    name: str
    element: Any  # a type of _SCALARS, a dataclass, or tuple for a Row
    repeated: bool
    optional: bool


def _plain(hint: Any) -> Any:
    """A type hint without its annotations."""
    if get_origin(hint) is Annotated:
        return _plain(get_args(hint)[0])
    if get_origin(hint) is Literal:
        return str
    return hint


def _element(hint: Any) -> Any:
    """The type of a sequence's elements; None for another type."""
    return _plain(get_args(hint)[0]) if get_origin(hint) in (tuple, list) else None


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
        element = _element(hint)
        repeated = element is not None
        kept = tuple if repeated and _element(element) is not None else element or hint
        made.append(_Field(each.name, kept, repeated, optional))
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
        if each.element in _SCALARS:
            added.type = _SCALARS[each.element]
        else:
            added.type = FieldDescriptorProto.TYPE_MESSAGE
            name = _ROW if each.element is tuple else each.element.__name__
            added.type_name = f".{_PACKAGE}.{name}"
            if each.element is tuple:
                _add_row(file)
            else:
                _add(file, each.element)
        if each.optional:
            added.proto3_optional = True
            added.oneof_index = len(described.oneof_decl)
            described.oneof_decl.add(name=f"_{each.name}")


def _add_row(file: FileDescriptorProto) -> None:
    if any(known.name == _ROW for known in file.message_type):
        return
    row = DescriptorProto(name=_ROW)
    row.field.add(
        name="values",
        number=1,
        type=FieldDescriptorProto.TYPE_DOUBLE,
        label=FieldDescriptorProto.LABEL_REPEATED,
    )
    file.message_type.append(row)


def schema(channel: str) -> tuple[str, bytes]:
    """A channel's schema: its name, and the serialized FileDescriptorSet."""
    return f"{_PACKAGE}.{CHANNELS[channel].__name__}", descriptor_set(_file(channel))


def descriptor_set(file: Any) -> bytes:
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
def _names(kind: type) -> tuple[tuple[str, Callable[[Any], Any] | None], ...]:
    """Each field's name, and what makes its value one for protobuf; None if it is one already."""

    def row(values: Any) -> list[dict[str, Any]]:
        return [{"values": each} for each in values]

    def record(value: Any) -> Any:
        return [_dict(each) for each in value] if isinstance(value, tuple | list) else _dict(value)

    return tuple(
        (
            each.name,
            row if each.element is tuple else record if is_dataclass(each.element) else None,
        )
        for each in _fields(kind)
    )


def _dict(value: Any) -> dict[str, Any]:
    kind: Any = type(value)
    return {
        name: getattr(value, name) if make is None else make(getattr(value, name))
        for name, make in _names(kind)
    }


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
    told: dict[str, Any] = {}
    for each in _fields(kind):
        value = getattr(proto, each.name)
        if each.optional and not proto.HasField(each.name):
            told[each.name] = None
        elif each.element is tuple:
            told[each.name] = [tuple(row.values) for row in value]
        elif is_dataclass(each.element) and isinstance(each.element, type):
            told[each.name] = (
                [_read(one, each.element) for one in value]
                if each.repeated
                else _read(value, each.element)
            )
        else:
            told[each.name] = tuple(value) if each.repeated else value
    return told
