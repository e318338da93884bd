"""The stream's messages as Protocol Buffers, with schemas made from their dataclasses.

A schema is a file descriptor, so that any tool that reads MCAP or Foxglove's protocol decodes the
messages without this package. A number is a double, and NaN where it is not known; a tuple is a
repeated field, also one of dataclasses; a tuple of tuples is a repeated `Row`.
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any

from google.protobuf import message_factory
from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import (
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from google.protobuf.message import Message as Proto

from thigmo.errors import DataError
from thigmo.stream.foxglove import VIEWS, views
from thigmo.stream.messages import ADAPTERS, CHANNELS, RECORDED, Message, validated

_PACKAGE = "thigmo"
_ROW = "Row"  # protobuf repeats no repeated field
_SCALARS = {
    "number": FieldDescriptorProto.TYPE_DOUBLE,
    "integer": FieldDescriptorProto.TYPE_INT64,
    "boolean": FieldDescriptorProto.TYPE_BOOL,
    "string": FieldDescriptorProto.TYPE_STRING,
}


@cache
def _file(channel: str) -> FileDescriptor:
    """The descriptor of a channel's file, from its message's JSON schema."""
    described = ADAPTERS[channel].json_schema()
    file = FileDescriptorProto(
        name=f"{_PACKAGE}/{described['title']}.proto", package=_PACKAGE, syntax="proto3"
    )
    _add(file, described, described.get("$defs", {}))
    pool = DescriptorPool()
    pool.Add(file)
    return pool.FindFileByName(file.name)


def _add(file: FileDescriptorProto, kind: dict[str, Any], kinds: dict[str, Any]) -> None:
    """Describe an object of a JSON schema and those that it holds, each once."""
    if any(known.name == kind["title"] for known in file.message_type):
        return
    message = file.message_type.add(name=kind["title"])
    for number, (name, held) in enumerate(kind["properties"].items(), start=1):
        field = message.field.add(name=name, number=number)
        if "anyOf" in held:  # it, or null
            held = held["anyOf"][0]
            field.proto3_optional = True
            field.oneof_index = len(message.oneof_decl)
            message.oneof_decl.add(name=f"_{name}")
        field.label = FieldDescriptorProto.LABEL_OPTIONAL
        if held.get("type") == "array":
            field.label = FieldDescriptorProto.LABEL_REPEATED
            held = held["items"] if "items" in held else held["prefixItems"][0]
        if held.get("type") in _SCALARS:
            field.type = _SCALARS[held["type"]]
            continue
        if "$ref" in held:
            held = kinds[held["$ref"].rpartition("/")[2]]
        else:
            held = {"title": _ROW, "properties": {"values": held}}
        field.type = FieldDescriptorProto.TYPE_MESSAGE
        field.type_name = f".{_PACKAGE}.{held['title']}"
        _add(file, held, kinds)


def schema(channel: str) -> tuple[str, bytes]:
    """A channel's schema: its name, and the serialized FileDescriptorSet."""
    return f"{_PACKAGE}.{CHANNELS[channel].__name__}", _descriptor_set(_file(channel))


def topics() -> dict[str, tuple[str, bytes]]:
    """What a run tells by protobuf, in records and to Foxglove: topics and their schemas."""
    drawn = {topic: kind.DESCRIPTOR for topic, kind in VIEWS.items()}
    return {f"/{channel}": schema(channel) for channel in RECORDED} | {
        topic: (drawing.full_name, _descriptor_set(drawing.file))
        for topic, drawing in drawn.items()
    }


def encoded(message: Message) -> list[tuple[str, bytes]]:
    """A message on `topics`: itself, and how Foxglove draws it."""
    drawn = [(topic, view.SerializeToString()) for topic, view in views(message)]
    return [(f"/{message.CHANNEL}", to_protobuf(message)), *drawn]


def _descriptor_set(file: Any) -> bytes:
    """A file and all that it imports, as a serialized FileDescriptorSet."""
    file_set = FileDescriptorSet()

    def add(descriptor: Any) -> None:
        for needed in descriptor.dependencies:
            add(needed)
        if not any(known.name == descriptor.name for known in file_set.file):
            descriptor.CopyToProto(file_set.file.add())

    add(file)
    return file_set.SerializeToString()


@cache
def _proto(channel: str) -> type[Proto]:
    name = CHANNELS[channel].__name__
    return message_factory.GetMessageClass(_file(channel).message_types_by_name[name])


@cache
def _names(kind: Any) -> tuple[str, ...]:
    """Names of a dataclass's fields."""
    return tuple(field.name for field in fields(kind))


def _arguments(value: Any) -> dict[str, Any]:
    """A dataclass as the keyword arguments of its protobuf message."""
    return {name: _held(getattr(value, name)) for name in _names(value.__class__)}


def _held(value: Any) -> Any:
    if not isinstance(value, tuple | list) or not value:
        return value
    if is_dataclass(value[0]):
        return [_arguments(part) for part in value]
    return [{"values": part} for part in value] if isinstance(value[0], tuple | list) else value


def to_protobuf(message: Message) -> bytes:
    """A message's bytes, by `schema`."""
    return _proto(message.CHANNEL)(**_arguments(message)).SerializeToString()


def from_protobuf(channel: str, data: bytes) -> Message:
    """The message of `to_protobuf`'s bytes. Raises DataError if these are of other fields."""
    proto = _proto(channel)()
    try:
        proto.MergeFromString(data)
    except DecodeError as error:
        raise DataError(
            f"a message of /{channel} is damaged", "replay the run, which needs its frames only"
        ) from error
    return validated(channel, _read(proto))


def _read(proto: Any) -> dict[str, Any]:
    read: dict[str, Any] = {}
    for field in proto.DESCRIPTOR.fields:
        value = getattr(proto, field.name)
        if field.message_type is None:
            unknown = field.has_presence and not proto.HasField(field.name)
            read[field.name] = None if unknown else value
        elif field.message_type.name == _ROW:
            read[field.name] = [row.values for row in value]
        else:
            read[field.name] = [_read(part) for part in value]
    return read
