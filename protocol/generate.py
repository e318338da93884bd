"""Generate the protocol's code, document and test vectors from schema.yaml.

One source keeps board, host and document from drifting apart. Run without arguments after a
change of the schema and commit all outputs; `--check` (make lint, CI) fails when one differs.

    firmware/core/link/protocol.h    host/thigmo/link/protocol.py and .json
    protocol/PROTOCOL.md             protocol/golden.json
    firmware/micropython/robot/thigmo_names.py
"""

from __future__ import annotations

import argparse
import hashlib
import json
import random
import re
import shutil
import struct
import subprocess
import sys
import textwrap
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import crcmod.predefined
import yaml
from cobs import cobs

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
OUTPUTS = {
    "cpp": ROOT / "firmware/core/link/protocol.h",
    "python": ROOT / "host/thigmo/link/protocol.py",
    "data": ROOT / "host/thigmo/link/protocol.json",
    "markdown": HERE / "PROTOCOL.md",
    "golden": HERE / "golden.json",
    "micropython": ROOT / "firmware/micropython/robot/thigmo_names.py",
}

HEADER = struct.Struct("<BHH")
CRC_BYTES = 2
# COBS adds one byte to frames of up to 254, the delimiter is one more.
OVERHEAD = HEADER.size + CRC_BYTES + 2
EVENT_WIRE_BYTES = 24
COLUMNS = 100
KINDS = ("command", "reply", "datagram", "telemetry", "event")
# type: (struct code, C++ type, bytes, low, high)
TYPES = {
    "u8": ("B", "uint8_t", 1, 0, 0xFF),
    "u16": ("H", "uint16_t", 2, 0, 0xFFFF),
    "i16": ("h", "int16_t", 2, -0x8000, 0x7FFF),
    "u32": ("I", "uint32_t", 4, 0, 0xFFFF_FFFF),
    "i32": ("i", "int32_t", 4, -0x8000_0000, 0x7FFF_FFFF),
}
DEADLINE_MS = 2000  # message.py's default
INBOUND_DATAGRAMS = ("heartbeat", "stop")
BIT_ENUMS = ("Fault", "Condition", "SweepOption")
# What a board has so many of: the schema's `capacity`, and the constant of the C++ header.
CAPACITY = {
    "muscles": "kMuscles",
    "sensors": "kSensors",
    "body_pressures": "kBodyPressures",
    "imus": "kImus",
}


class SchemaError(Exception):
    """The schema breaks one of its own rules."""


class _UniqueLoader(yaml.CSafeLoader):
    """YAML that refuses a key given twice, which would silently drop a message."""


def _mapping(loader: _UniqueLoader, node: yaml.MappingNode) -> dict[Any, Any]:
    loader.flatten_mapping(node)
    pairs = [
        (loader.construct_object(k, deep=True), loader.construct_object(v, deep=True))
        for k, v in node.value
    ]
    result = dict(pairs)
    if len(result) != len(pairs):
        raise SchemaError(f"a key is given twice near line {node.start_mark.line + 1}")
    return result


_UniqueLoader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _mapping)


@dataclass(frozen=True)
class Capacity:
    """How many of something a board has: at most on the wire, and for the thesis's robot."""

    most: int
    usual: int


@dataclass(frozen=True)
class Field:
    """One field of a message."""

    name: str
    type: str
    count: int  # at most
    counted_by: str  # what of the capacity counts it; "" for a fixed count
    counted: bool  # its count comes before it
    unit: str
    enum: str
    doc: str

    @property
    def code(self) -> str:
        """Its struct format; `?` and what counts it come before that of an array's element."""
        if self.counted_by:
            return f"{self.counted_by}?{TYPES[self.type][0]}"
        return (str(self.count) if self.count > 1 else "") + TYPES[self.type][0]

    @property
    def size(self) -> int:
        """Bytes on the wire, at most, its count included."""
        return TYPES[self.type][2] * self.count + self.counted

    @property
    def extent(self) -> str:
        """Its bytes as a C++ expression, its count included."""
        width = TYPES[self.type][2]
        if not self.counted_by:
            return str(width * self.count)
        extent = (
            CAPACITY[self.counted_by] if width == 1 else f"{width} * {CAPACITY[self.counted_by]}"
        )
        return f"1 + {extent}" if self.counted else extent


@dataclass(frozen=True)
class Message:
    """One message."""

    name: str
    id: int
    kind: str
    reply: str
    deadline_ms: int
    doc: str
    fields: tuple[Field, ...]

    @property
    def camel(self) -> str:
        """Its type's name in both languages."""
        return camel(self.name)

    @property
    def format(self) -> str:
        """Its struct format, little-endian."""
        return "<" + "".join(field.code for field in self.fields)

    @property
    def size(self) -> int:
        """Payload bytes."""
        return sum(field.size for field in self.fields)

    @property
    def varies(self) -> bool:
        """Whether its size is the capacity's matter."""
        return any(field.counted_by for field in self.fields)

    def offset(self, number: int) -> str:
        """Where a field (its count, if one comes before it) begins, as a C++ expression."""
        earlier = self.fields[:number]
        fixed = sum(int(field.extent) for field in earlier if not field.counted_by)
        return " + ".join([str(fixed), *(field.extent for field in earlier if field.counted_by)])

    @property
    def wire(self) -> int:
        """Most bytes on the wire, delimiter included."""
        return self.size + OVERHEAD


@dataclass(frozen=True)
class Parameter:
    """One parameter, perhaps an array."""

    name: str
    id: int
    counted_by: str  # what of the capacity counts its elements; "" for a single one
    unit: str
    low: int
    high: int
    defaults: tuple[int, ...]  # one for each element, or of the first ones: the rest is 0
    doc: str


@dataclass(frozen=True)
class Value:
    """One member of an enumeration."""

    name: str
    value: int
    doc: str


@dataclass(frozen=True)
class Schema:
    """The whole schema, checked."""

    protocol: int
    max_wire: int
    crc: str
    deadline_ms: int
    map_id: int
    map_points: int
    hash: int
    enums: dict[str, tuple[str, tuple[Value, ...]]]
    open_enums: frozenset[str]  # whose values may be others than those listed
    capacity: dict[str, Capacity]
    messages: tuple[Message, ...]
    parameters: tuple[Parameter, ...]


def camel(name: str) -> str:
    """`hello_reply` -> `HelloReply`."""
    return "".join(part.capitalize() for part in name.split("_"))


def wire_layout(tree: Any) -> Any:
    """The part of the schema that bytes on the wire and their meaning depend on.

    Names belong to it: two fields of one type that change places change what a byte means.
    """
    return {
        "frame": {
            key: tree[key] for key in ("protocol", "max_wire_bytes", "crc", "map", "capacity")
        },
        "enums": {
            name: "open"
            if members.get("open")
            else {key: body["value"] for key, body in members.items() if key != "doc"}
            for name, members in tree["enums"].items()
        },
        "messages": {
            name: [
                body["id"],
                body["kind"],
                body.get("reply", ""),
                [
                    [f["name"], f["type"], f.get("count", 1), f.get("unit", ""), f.get("enum", "")]
                    for f in body.get("fields", [])
                ],
            ]
            for name, body in tree["messages"].items()
        },
        "parameters": [
            [name, body["id"], body.get("count", 1), body.get("unit", "")]
            for name, body in tree["parameters"].items()
        ],
    }


def schema_hash(tree: Any) -> int:
    """First four bytes of SHA-256 over the canonical JSON of the wire's layout."""
    canonical = json.dumps(wire_layout(tree), sort_keys=True, separators=(",", ":"))
    return int.from_bytes(hashlib.sha256(canonical.encode()).digest()[:4], "big")


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise SchemaError(message)


def load(path: Path) -> Schema:
    """Read and check the schema.

    Raises:
        SchemaError: a rule of the protocol is broken; the message says which and where.
    """
    tree = yaml.load(path.read_text(), Loader=_UniqueLoader)
    enums: dict[str, tuple[str, tuple[Value, ...]]] = {}
    open_enums: set[str] = set()
    for name, members in tree["enums"].items():
        values = tuple(
            Value(key, body["value"], body["doc"])
            for key, body in members.items()
            if key not in ("doc", "open")
        )
        if members.get("open"):
            open_enums.add(name)
        numbers = [v.value for v in values]
        _require(len(set(numbers)) == len(numbers), f"enums.{name}: a value is used twice")
        top = 15 if name in BIT_ENUMS else 255
        _require(all(0 <= n <= top for n in numbers), f"enums.{name}: values must be 0..{top}")
        enums[name] = (members["doc"], values)

    capacity = {name: Capacity(**body) for name, body in tree["capacity"].items()}
    _require(set(capacity) == set(CAPACITY), f"capacity: give {', '.join(CAPACITY)}")
    messages = []
    for name, body in tree["messages"].items():
        where = f"messages.{name}"
        unknown = set(body) - {"id", "kind", "reply", "deadline_ms", "frozen", "doc", "fields"}
        _require(not unknown, f"{where}: unknown keys {sorted(unknown)}")
        fields = []
        for f in body.get("fields", []):
            unknown = set(f) - {"name", "type", "count", "unit", "enum", "doc"}
            _require(not unknown, f"{where}.{f['name']}: unknown keys {sorted(unknown)}")
            _require(f["type"] in TYPES, f"{where}.{f['name']}: unknown type {f['type']}")
            enum = f.get("enum", "")
            _require(not enum or enum in enums, f"{where}.{f['name']}: unknown enum {enum}")
            _require(not enum or f["type"] == "u8", f"{where}.{f['name']}: enums travel as u8")
            count = f.get("count", 1)
            counted_by = count if isinstance(count, str) else ""
            _require(
                not counted_by or counted_by in capacity,
                f"{where}.{f['name']}: nothing counts {counted_by}",
            )
            fields.append(
                Field(
                    f["name"],
                    f["type"],
                    capacity[counted_by].most if counted_by else count,
                    counted_by,
                    bool(counted_by) and all(counted_by != peer.counted_by for peer in fields),
                    f.get("unit", ""),
                    enum,
                    f["doc"],
                )
            )
        names = [f.name for f in fields]
        _require(len(set(names)) == len(names), f"{where}: a field name is used twice")
        kind = body["kind"]
        _require(kind in KINDS, f"{where}: unknown kind {kind}")
        message = Message(
            name,
            body["id"],
            kind,
            body.get("reply", ""),
            body.get("deadline_ms", tree["deadline_ms"]),
            body["doc"],
            tuple(fields),
        )
        _require(
            message.wire <= tree["max_wire_bytes"],
            f"{where}: {message.wire} bytes on the wire, {tree['max_wire_bytes']} allowed",
        )
        if kind == "event":
            _require(
                message.wire <= EVENT_WIRE_BYTES, f"{where}: {message.wire} > {EVENT_WIRE_BYTES}"
            )
        if kind == "reply":
            _require(
                bool(fields) and fields[0].name == "status" and fields[0].enum == "Status",
                f"{where}: a reply's first field is its status",
            )
        frozen = body.get("frozen")
        _require(
            frozen is None or frozen == message.format,
            f"{where}: its layout is frozen as {frozen}, found {message.format}",
        )
        messages.append(message)
    ids = [m.id for m in messages]
    _require(len(set(ids)) == len(ids), "messages: an id is used twice")
    _require(all(0 < i < 256 for i in ids), "messages: ids must be 1..255")
    replies = {m.name for m in messages if m.kind == "reply"}
    for m in messages:
        _require(
            (m.kind == "command") == bool(m.reply), f"messages.{m.name}: commands name a reply"
        )
        _require(not m.reply or m.reply in replies, f"messages.{m.name}: unknown reply {m.reply}")

    parameters = []
    for name, body in tree["parameters"].items():
        where = f"parameters.{name}"
        unknown = set(body) - {"id", "count", "unit", "range", "default", "doc"}
        _require(not unknown, f"{where}: unknown keys {sorted(unknown)}")
        _require("id" in body, f"{where}: give it an id; the next free one stands above the list")
        counted_by = body.get("count", "")
        _require(not counted_by or counted_by in capacity, f"{where}: nothing counts {counted_by}")
        low, high = body["range"]
        default = body["default"]
        defaults = tuple(default) if isinstance(default, list) else (default,)
        _require(
            len(defaults) <= (capacity[counted_by].most if counted_by else 1),
            f"{where}: too many defaults",
        )
        _require(not isinstance(default, list) or low <= 0, f"{where}: 0 is out of its range")
        _require(
            TYPES["i32"][3] <= low < high <= TYPES["i32"][4], f"{where}: bad range {low}..{high}"
        )
        _require(all(low <= d <= high for d in defaults), f"{where}: default outside its range")
        parameters.append(
            Parameter(
                name,
                body["id"],
                counted_by,
                body.get("unit", ""),
                low,
                high,
                defaults,
                body["doc"],
            )
        )
    rare = [p.counted_by in capacity and not capacity[p.counted_by].usual for p in parameters]
    _require(rare == sorted(rare), "parameters: those of which a board may have none come last")
    stored = [tree["map"]["id"], *(p.id for p in parameters)]
    _require(all(0 < i < 256 for i in stored), "parameters: ids must be 1..255")
    _require(len(set(stored)) == len(stored), "parameters: a stored id is used twice")
    return Schema(
        tree["protocol"],
        tree["max_wire_bytes"],
        tree["crc"],
        tree["deadline_ms"],
        tree["map"]["id"],
        tree["map"]["points"],
        schema_hash(tree),
        enums,
        frozenset(open_enums),
        capacity,
        tuple(messages),
        tuple(parameters),
    )


# --- C++ -----------------------------------------------------------------------------------------


def _enumerator(name: str) -> str:
    return "k" + camel(name)


def _cpp_type(field: Field) -> str:
    return field.enum or TYPES[field.type][1]


def _cpp_array(field: Field) -> str:
    """How many elements it has, as a C++ expression; "" for a single one."""
    if field.counted_by:
        return CAPACITY[field.counted_by]
    return str(field.count) if field.count > 1 else ""


def _cpp_put(field: Field, offset: str) -> list[str]:
    width = TYPES[field.type][2]
    put = {1: "put8", 2: "put16", 4: "put32"}[width]
    cast = {1: "uint8_t", 2: "uint16_t", 4: "uint32_t"}[width]
    array = _cpp_array(field)
    if not array:
        return [f"    detail::{put}(out + {offset}, static_cast<{cast}>({field.name}));"]
    count = [f"    detail::put8(out + {offset}, {array});"] if field.counted else []
    offset += " + 1" if field.counted else ""
    return [
        *count,
        f"    for (uint8_t i = 0; i < {array}; ++i) {{",
        f"      detail::{put}(out + {offset} + {width} * i, static_cast<{cast}>({field.name}[i]));",
        "    }",
    ]


def _cpp_get(field: Field, offset: str) -> list[str]:
    width = TYPES[field.type][2]
    get = {1: "get8", 2: "get16", 4: "get32"}[width]
    cast = _cpp_type(field)
    array = _cpp_array(field)
    if not array:
        return [f"    out->{field.name} = static_cast<{cast}>(detail::{get}(in + {offset}));"]
    count = [f"    if (in[{offset}] != {array}) return false;"] if field.counted else []
    offset += " + 1" if field.counted else ""
    return [
        *count,
        f"    for (uint8_t i = 0; i < {array}; ++i) {{",
        f"      out->{field.name}[i] = static_cast<{cast}>(detail::{get}(in + {offset} + "
        f"{width} * i));",
        "    }",
    ]


def _cpp_struct(m: Message) -> list[str]:
    lines = [f"// {m.doc}", f"struct {m.camel} {{"]
    lines += [
        f"  static constexpr uint8_t kId = k{m.camel};",
        f"  static constexpr uint8_t kSize = {m.offset(len(m.fields))};",
    ]
    for f in m.fields:
        array = f"[{_cpp_array(f)}]" if _cpp_array(f) else ""
        unit = f" ({f.unit})" if f.unit else ""
        lines.append(f"  {_cpp_type(f)} {f.name}{array};  // {f.doc}{unit}")
    out, source, target = ("out", "in", "out") if m.fields else ("", "", "")
    lines.append(f"  void encode(uint8_t* {out}) const {{")
    for number, f in enumerate(m.fields):
        lines += _cpp_put(f, m.offset(number))
    lines += [
        "  }",
        f"  static bool decode(const uint8_t* {source}, uint8_t length, {m.camel}* {target}) {{",
        "    if (length != kSize) return false;",
    ]
    for number, f in enumerate(m.fields):
        lines += _cpp_get(f, m.offset(number))
    return [*lines, "    return true;", "  }", "};", ""]


def cpp(schema: Schema) -> str:
    """The C++ header: C++14, <stdint.h> only, as avr-gcc 5.4 has no standard library."""
    out = [
        "// Generated by protocol/generate.py from protocol/schema.yaml: do not edit.",
        "//",
        "// Messages, enumerations and parameter table, as protocol/PROTOCOL.md documents them.",
        "// Each message encodes itself into, and decodes itself from, its little-endian payload.",
        "#ifndef THIGMO_CORE_LINK_PROTOCOL_H_",
        "#define THIGMO_CORE_LINK_PROTOCOL_H_",
        "",
        "#include <stdint.h>",
        "",
        '#include "../capacity.h"',
        "",
        "// Where constant tables live; a board whose flash is apart from its memory defines it.",
        "#ifndef THIGMO_PROGMEM",
        "#define THIGMO_PROGMEM",
        "#endif",
        "",
        "namespace thigmo {",
        "namespace protocol {",
        "",
        f"constexpr uint8_t kProtocol = {schema.protocol};",
        f"constexpr uint32_t kSchemaHash = 0x{schema.hash:08X}u;",
        f"constexpr uint8_t kMaxWire = {schema.max_wire};  // bytes of a frame, delimiter included",
        f"constexpr uint8_t kMaxFrame = {schema.max_wire - 2};  // header to check sequence",
        f"constexpr uint8_t kMaxPayload = {schema.max_wire - OVERHEAD};",
        f"constexpr uint8_t kHeaderSize = {HEADER.size};  // id u8, seq u16, session u16",
        f"constexpr uint8_t kCrcSize = {CRC_BYTES};",
        f"constexpr uint8_t kMapId = {schema.map_id};  // under which the store keeps the maps",
        f"constexpr uint8_t kMapPoints = {schema.map_points};",
        *(
            f'static_assert({CAPACITY[name]} > 0 && {CAPACITY[name]} <= {amount.most}, "{name}");'
            if amount.usual
            else f'static_assert({CAPACITY[name]} <= {amount.most}, "{name}");'
            for name, amount in schema.capacity.items()
        ),
        "",
    ]
    for name, (doc, values) in schema.enums.items():
        out += [f"// {doc}", f"enum class {name} : uint8_t {{"]
        out += [f"  {_enumerator(v.name)} = {v.value},  // {v.doc}" for v in values]
        out += ["};", f"constexpr uint8_t k{name}Count = {len(values)};", ""]
    out += ["// Bit masks of the enumerations that number bits."]
    out += [
        f"constexpr uint16_t mask({name} bit) {{ "
        "return static_cast<uint16_t>(1u << static_cast<uint8_t>(bit)); }"
        for name in BIT_ENUMS
    ]
    out += ["", "// Message ids."]
    out += [f"constexpr uint8_t k{m.camel} = 0x{m.id:02X};" for m in schema.messages]
    out += [
        "",
        "namespace detail {",
        "inline void put8(uint8_t* out, uint8_t value) { out[0] = value; }",
        "inline void put16(uint8_t* out, uint16_t value) {",
        "  out[0] = static_cast<uint8_t>(value);",
        "  out[1] = static_cast<uint8_t>(value >> 8);",
        "}",
        "inline void put32(uint8_t* out, uint32_t value) {",
        "  put16(out, static_cast<uint16_t>(value));",
        "  put16(out + 2, static_cast<uint16_t>(value >> 16));",
        "}",
        "inline uint8_t get8(const uint8_t* in) { return in[0]; }",
        "inline uint16_t get16(const uint8_t* in) {",
        "  return static_cast<uint16_t>(in[0] | static_cast<uint16_t>(in[1]) << 8);",
        "}",
        "inline uint32_t get32(const uint8_t* in) {",
        "  return get16(in) | static_cast<uint32_t>(get16(in + 2)) << 16;",
        "}",
        "}  // namespace detail",
        "",
    ]
    for m in schema.messages:
        out += _cpp_struct(m)
    inbound = [m for m in schema.messages if m.kind == "command" or m.name in INBOUND_DATAGRAMS]
    out += [
        "// Payload size of a message that the host may send, or kUnknownMessage.",
        "constexpr uint8_t kUnknownMessage = 255;",
        "constexpr uint8_t inboundSize(uint8_t id) {",
        "  switch (id) {",
        *(f"    case k{m.camel}: return {m.camel}::kSize;" for m in inbound),
        "    default: return kUnknownMessage;",
        "  }",
        "}",
        "",
        "// Parameters: first index of each; arrays take consecutive ones.",
        "enum class Param : uint16_t {",
    ]
    rare = {name for name, amount in schema.capacity.items() if not amount.usual}
    always = [p for p in schema.parameters if p.counted_by not in rare]
    sometimes = [p for p in schema.parameters if p.counted_by in rare]
    macros = sorted({f"THIGMO_{p.counted_by.upper()}" for p in sometimes})
    index = "0"
    for p in schema.parameters:
        unit = f" ({p.unit})" if p.unit else ""
        size = f" [{CAPACITY[p.counted_by]}]" if p.counted_by else ""
        out.append(f"  {_enumerator(p.name)} = {index},  // {p.doc}{unit}{size}")
        index = f"{_enumerator(p.name)} + {CAPACITY[p.counted_by] if p.counted_by else 1}"
    out += [f"  kEnd = {index}", "};"]
    out += [
        "constexpr uint16_t kParamCount = static_cast<uint16_t>(Param::kEnd);",
        "",
        "// What the store keeps them under, in the order of their indices.",
        "struct ParamKey {",
        "  uint8_t id, count;",
        "};",
        "constexpr ParamKey kParamKeyTable[] THIGMO_PROGMEM = {",
        *(
            f"    {{{p.id}, {CAPACITY[p.counted_by] if p.counted_by else 1}}},  // {p.name}"
            for p in always
        ),
        *(f"#if {name}" for name in macros),
        *(f"    {{{p.id}, {CAPACITY[p.counted_by]}}},  // {p.name}" for p in sometimes),
        *("#endif" for _ in macros),
        "};",
        "constexpr uint8_t kParamKeys = sizeof kParamKeyTable / sizeof *kParamKeyTable;",
        "",
        "// Limits and default of each element.",
        "struct ParamRow {",
        "  int32_t low, high, initial;",
        "};",
        "struct ParamRows {",
        "  ParamRow row[kParamCount];",
        "  uint16_t filled;",
        "",
        "  // Adds an array with defaults of its first elements; the rest is 0.",
        "  template <uint8_t given>",
        "  constexpr void add(uint8_t count, int32_t low, int32_t high, "
        "const int32_t (&initial)[given]) {",
        "    for (uint8_t i = 0; i < count; ++i) "
        "row[filled++] = {low, high, i < given ? initial[i] : 0};",
        "  }",
        "  // Adds one, or an array with one default.",
        "  constexpr void add(uint8_t count, int32_t low, int32_t high, int32_t initial) {",
        "    for (uint8_t i = 0; i < count; ++i) row[filled++] = {low, high, initial};",
        "  }",
        "};",
        "constexpr ParamRows param_rows() {",
        "  ParamRows rows{};",
    ]
    for p in schema.parameters:
        count = CAPACITY[p.counted_by] if p.counted_by else "1"
        if p.counted_by and len(p.defaults) > 1:
            given = ", ".join(str(d) for d in p.defaults)
            out += [
                f"  const int32_t {p.name}[] = {{{given}}};",
                f"  rows.add({count}, {p.low}, {p.high}, {p.name});",
            ]
        else:
            out.append(f"  rows.add({count}, {p.low}, {p.high}, {p.defaults[0]});  // {p.name}")
    out += [
        "  return rows;",
        "}",
        "constexpr ParamRows kParamRows THIGMO_PROGMEM = param_rows();",
        'static_assert(kParamRows.filled == kParamCount, "a row for each index");',
        "",
        "}  // namespace protocol",
        "}  // namespace thigmo",
        "",
        "#endif  // THIGMO_CORE_LINK_PROTOCOL_H_",
    ]
    return _run(_tool("clang-format"), "--assume-filename", str(OUTPUTS["cpp"]), text=out)


# --- Python --------------------------------------------------------------------------------------


def _py_type(field: Field) -> str:
    if field.counted_by or field.count > 1:
        return f'Annotated[tuple[int, ...], "{field.code}"]'
    return field.enum or field.type.upper()


def _py_line(line: str, doc: str, unit: str = "") -> list[str]:
    """A line of code with as many clauses of its comment as fit, or the first above it.

    PROTOCOL.md has all of them.
    """
    unit = f" [{unit}]" if unit else ""
    ends = [clause.start() for clause in re.finditer(r"; |(?<=\.) (?=[A-Z])", doc)]
    for end in (len(doc), *reversed(ends)):
        if len(line) + end + len(unit) + 4 <= COLUMNS:
            return [f"{line}  # {doc[:end]}{unit}"]
    indent = " " * (len(line) - len(line.lstrip()))
    first = doc[: ends[0] if ends else None] + unit
    above = textwrap.wrap(first, COLUMNS - 6, break_on_hyphens=False)
    return [*(f"{indent}# {part}" for part in above), line]


def _py_message(m: Message) -> list[str]:
    base = {"command": f"Command[{camel(m.reply)}]", "reply": "Reply"}.get(m.kind, "Message")
    deadline = f", deadline_s={m.deadline_ms / 1000}" if m.deadline_ms != DEADLINE_MS else ""
    head = f"class {m.camel}({base}, number=0x{m.id:02X}{deadline}):{'' if m.fields else ' ...'}"
    out = _py_line(head, m.doc)
    for f in m.fields:
        out += _py_line(f"    {f.name}: {_py_type(f)}", f.doc, f.unit)
    return [*out, "", ""]


def python(schema: Schema) -> str:
    """The typed Python module."""
    out = [
        '"""Generated by protocol/generate.py from protocol/schema.yaml: do not edit.',
        "",
        "Messages and enumerations, as protocol/PROTOCOL.md documents them. Integers are as on the",
        "wire; the scale is in each name and unit.",
        '"""',
        "# ruff: noqa: D101, F401, I001 - comments say what things are; the imports are passed on",
        "# mypy: implicit-reexport",
        "",
        "from typing import Annotated",
        "",
        "from thigmo.link.message import I16, I32, MESSAGES, PARAMETERS, U8, U16, U32",
        "from thigmo.link.message import PARAMETER_COUNT, PARAMETER_NAMES, Command, Documented",
        "from thigmo.link.message import Message, OpenDocumented, Parameter, Reply, parameters",
        "",
        f"PROTOCOL = {schema.protocol}",
        f"SCHEMA_HASH = 0x{schema.hash:08X}",
        f"MAX_WIRE = {schema.max_wire}",
        f"MAX_FRAME = {schema.max_wire - 2}",
        f"MAX_PAYLOAD = {schema.max_wire - OVERHEAD}",
        f'CRC = "{schema.crc}"',
        f"MAP_ID = {schema.map_id}",
        f"MAP_POINTS = {schema.map_points}",
        *(f"MOST_{name.upper()} = {amount.most}" for name, amount in schema.capacity.items()),
        "",
        "",
    ]
    for name, (doc, values) in schema.enums.items():
        base = "OpenDocumented" if name in schema.open_enums else "Documented"
        out += _py_line(f"class {name}({base}):", doc)
        for value in values:
            out += _py_line(f"    {value.name.upper()} = {value.value}", value.doc)
        out += ["", ""]
    for m in sorted(schema.messages, key=lambda m: m.kind == "command"):
        out += _py_message(m)
    formatted = _run(_tool("ruff"), "format", "--stdin-filename", str(OUTPUTS["python"]), text=out)
    long = [n for n, line in enumerate(formatted.splitlines(), 1) if len(line) > COLUMNS]
    _require(not long, f"protocol.py: lines {long} exceed 100 columns; shorten those docs")
    return formatted


def micropython(schema: Schema) -> str:
    """Names for a program on the board: small, because they lie in its flash."""

    def names(enum: str) -> dict[int, str]:
        return {v.value: v.name for v in schema.enums[enum][1]}

    conditions = {v.name: v.value for v in schema.enums["Condition"][1]}
    reasons = {v.value: f"{v.name}: {v.doc}" for v in schema.enums["Reason"][1]}
    commands = {m.name: m.id for m in schema.messages if m.kind == "command"}
    out = [
        "# Generated by protocol/generate.py from protocol/schema.yaml: do not edit.",
        "# ruff: noqa: E501",
        f"STATES = {names('State')}",
        f"ACTIVITIES = {names('Activity')}",
        f"FAULTS = {names('Fault')}",
        f"EVENTS = {names('EventCode')}",
        f"REASONS = {reasons}",
        f"MESSAGES = {commands}",
        f"LENGTH_KNOWN = {1 << conditions['length_known']}",
        f"SENSORS_ALL = {(1 << schema.capacity['sensors'].most) - 1}",
        f"SCHEMA_HASH = 0x{schema.hash:08X}",
    ]
    path = str(OUTPUTS["micropython"])
    return _run(_tool("ruff"), "format", "--stdin-filename", path, text=out)


def data(schema: Schema) -> str:
    """What the Python module reads: sentences of the enumerations, and the parameters."""
    enums = [
        f"  {json.dumps(name)}: "
        + json.dumps({v.name: v.doc for v in values}, indent=3).replace("\n}", "\n  }")
        for name, (_, values) in schema.enums.items()
    ]
    rows = [f"  {json.dumps(asdict(p))}" for p in schema.parameters]
    usual = json.dumps({name: amount.usual for name, amount in schema.capacity.items()})
    notice = json.dumps("Generated by protocol/generate.py from protocol/schema.yaml: do not edit.")
    return (
        f'{{\n "about": {notice},\n "usual": {usual},\n "enums": {{\n'
        + ",\n".join(enums)
        + '\n },\n "parameters": [\n'
        + ",\n".join(rows)
        + "\n ]\n}\n"
    )


# --- document ------------------------------------------------------------------------------------


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _amounts(schema: Schema, amount: str) -> str:
    """Capacities in words."""
    return ", ".join(
        f"{getattr(capacity, amount)} {'IMUs' if name == 'imus' else name.replace('_', ' ')}"
        for name, capacity in schema.capacity.items()
    )


def markdown(schema: Schema) -> str:
    """The protocol's document."""
    out = [
        "# Protocol",
        "",
        "Generated by `protocol/generate.py` from `protocol/schema.yaml`: do not edit.",
        "",
        f"Protocol {schema.protocol}, schema `{schema.hash:08x}`.",
        "",
        "## Frame",
        "",
        "```",
        "COBS( id u8 | seq u16 | session u16 | payload | crc u16 ) 0x00",
        "```",
        "",
        f"Integers are little-endian. A frame takes at most {schema.max_wire} bytes on the wire, "
        f"delimiter included, an event at most {EVENT_WIRE_BYTES}. The check sequence is "
        f"`{schema.crc}` (polynomial 0x1021, start 0xFFFF, unreflected) over id, seq, session and "
        "payload. A receiver drops and counts bytes that form no valid frame. The next frame "
        "begins after the next 0x00.",
        "",
        "An array is as long as the board's capacity, which the host asks for after the hello "
        "(`get_capacity`). Boards built for the thesis's robot hold "
        + _amounts(schema, "usual")
        + "; no board holds more than "
        + _amounts(schema, "most")
        + ". In a message the number of muscles (or sensors) precedes their first array. A command "
        "whose number differs from the board's is refused (`bad_value`).",
        "",
        "## Rules",
        "",
        "- **Hello** opens a session. Its header carries session 0 and any seq. The board "
        "replies with a session number and takes the hello's seq as the last one.",
        "  - A repeated hello, with the nonce of the running session, gets the same reply and "
        "changes nothing.",
        "  - Any other nonce belongs to another host: motion ends, the robot is disarmed, an "
        "event reports it (`other_host`), and the former session is over.",
        "  - A host's nonces count up. The board ignores a hello whose nonce is less "
        "than 8 below the running session's, or is that of one of its last 8 sessions. A replayed "
        "hello therefore cannot end a session.",
        "  - A host that lost its session resumes it with a hello that carries the old session "
        "number in its header and the old nonce. It gets a new session, and the activity "
        "continues. The board refuses this (`bad_session`) if it has restarted, which its boot "
        "nonce shows, or if another host has connected.",
        "  - A hello with another schema hash is refused and changes nothing; the reply holds "
        "the board's hash. The hash covers the layout of the messages and what their numbers "
        "mean; texts, defaults, ranges and deadlines may differ. The layouts of hello, "
        "hello_reply, announce and ack never change, so that a board and a host of different "
        "schemas can report the mismatch to each other.",
        "- **Stop** needs no session: the board obeys it with any session, seq and schema, in "
        "every state, also before the first hello. The board obeys it before it processes "
        "anything else, and answers each copy with `stopped`. The sender repeats it until "
        "`stopped` returns its nonce. It sends a zero byte before each copy, which ends a frame"
        " that was cut off. The layouts of both messages never change. A stop stays latched "
        "through resets until an operator clears it with `clear_stop`. This command is numbered"
        " like all others and names the stop by its nonce. A late copy of a stop may therefore "
        "stop the robot, but a late copy of `clear_stop` does nothing.",
        "- **Commands** carry the session, and the seq that follows the last one. Only one "
        "command may wait for its reply at a time. A command repeated with the same seq gets the "
        "stored reply, or `in_progress` while the board still works on it. A command with any "
        "other seq is stale: the board drops and counts it. A command of another session is "
        "dropped, counted, and answered by an ack `bad_session`.",
        "- **Replies** carry the seq and session of the frame that they answer. Every refusal "
        "is an `ack`, except that of a hello.",
        "- **Repeats.** The host repeats a command until its deadline, after a time-out that it"
        " measures from past round trips. A command that gets no answer ends its session: the "
        "host says hello again, which makes late copies of the command stale.",
        "- **Telemetry** starts with the first hello and is never repeated. Its seq counts "
        "frames, from 1 after each hello.",
        "- **Events** are sent at once, before waiting telemetry, and repeated until the host "
        "acknowledges them. `ack_event` acknowledges all numbers up to its own. A host "
        "therefore acknowledges a number only if it has received all events before it. The "
        "header of an event has seq 0 and the current session.",
        "- **Heartbeats** keep energised outputs on. A heartbeat counts if it is of the current"
        " session and its counter is above the last one of that session. Others are dropped and"
        " counted.",
        "- **After a reset** the board announces itself twice a second until the first hello. A"
        " host that opens a port sends nothing for at least 1 s (the boot loader would take "
        "it), unless it receives an announce.",
        "",
        "## Messages",
        "",
    ]
    for m in schema.messages:
        title = f"### `{m.name}` 0x{m.id:02X}"
        out += [title, "", m.doc, ""]
        most = "at most " if m.varies else ""
        facts = [m.kind, f"{most}{m.size} bytes of payload", f"at most {m.wire} on the wire"]
        if m.kind == "command":
            facts += [f"answered by `{m.reply}`", f"within {m.deadline_ms} ms"]
        out += ["; ".join(facts).capitalize() + ".", ""]
        if m.fields:
            out += ["| field | type | unit | meaning |", "| --- | --- | --- | --- |"]
            for f in m.fields:
                if f.counted:
                    out.append(f"| | u8 | | How many {f.counted_by.replace('_', ' ')} follow. |")
                count = f.counted_by or (f.count if f.count > 1 else "")
                kind = f.type + (f"[{count}]" if count else "")
                kind += f" {f.enum}" if f.enum else ""
                out.append(f"| `{f.name}` | {kind} | {f.unit} | {_cell(f.doc)} |")
            out.append("")
    out += ["## Enumerations", ""]
    for name, (doc, values) in schema.enums.items():
        out += [f"### {name}", "", doc, "", "| value | name | meaning |", "| --- | --- | --- |"]
        out += [f"| {v.value} | `{v.name}` | {_cell(v.doc)} |" for v in values]
        out.append("")
    out += [
        "## Parameters",
        "",
        "Each value is an i32. Indices number the elements in this order; an array has as many as "
        "the board's capacity. A list of defaults sets the first elements; the rest are 0. The "
        "store keeps each parameter under its id, also when the firmware is updated.",
        "",
        "| elements | id | name | unit | range | default | meaning |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for p in schema.parameters:
        default = ", ".join(str(d) for d in p.defaults)
        out.append(
            f"| {p.counted_by.replace('_', ' ') or 1} | {p.id} | `{p.name}` | {p.unit} "
            f"| {p.low}..{p.high} | {default} | {_cell(p.doc)} |"
        )
    return "\n".join(out) + "\n"


# --- golden vectors ------------------------------------------------------------------------------


def _vector_value(field: Field, choice: str, rng: random.Random, schema: Schema) -> int:
    _, _, _, low, high = TYPES[field.type]
    if field.enum:
        values = [v.value for v in schema.enums[field.enum][1]]
        return rng.choice(values) if choice == "random" else values[-1 if choice == "high" else 0]
    return {"low": low, "high": high, "zero": 0}.get(choice, rng.randint(low, high))


def golden(schema: Schema) -> str:
    """Vectors: every message at its extremes and at random values, and frames to be refused."""
    crc = crcmod.predefined.mkPredefinedCrcFun(schema.crc)
    rng = random.Random(schema.protocol)
    vectors: list[dict[str, Any]] = []
    for m in schema.messages:
        for choice in ("zero", "low", "high", "random") if m.fields else ("zero",):
            fields: dict[str, Any] = {}
            flat: list[int] = []
            layout = "<"
            for f in m.fields:
                count = schema.capacity[f.counted_by].usual if f.counted_by else f.count
                values = [_vector_value(f, choice, rng, schema) for _ in range(count)]
                fields[f.name] = values if f.counted_by or count > 1 else values[0]
                layout += ("B" if f.counted else "") + f"{count}{TYPES[f.type][0]}"
                flat += [count, *values] if f.counted else values
            seq = {"zero": 0, "low": 1, "high": 0xFFFF}.get(choice, rng.randrange(0x10000))
            session = {"zero": 0, "low": 1, "high": 0xFFFF}.get(choice, rng.randrange(0x10000))
            payload = struct.pack(layout, *flat)
            body = HEADER.pack(m.id, seq, session) + payload
            frame = body + struct.pack("<H", crc(body))
            vectors.append(
                {
                    "message": m.name,
                    "id": m.id,
                    "seq": seq,
                    "session": session,
                    "fields": fields,
                    "payload": payload.hex(),
                    "frame": frame.hex(),
                    "wire": (cobs.encode(frame) + b"\0").hex(),
                }
            )
    good = bytes.fromhex(vectors[-1]["frame"])
    flipped = bytes([good[0] ^ 1]) + good[1:]
    short = good[: HEADER.size + 1]
    long_body = bytes(range(1, schema.max_wire))
    long_frame = long_body + struct.pack("<H", crc(long_body))
    bad = [
        {"why": "one bit flipped", "wire": (cobs.encode(flipped) + b"\0").hex()},
        {"why": "truncated", "wire": (cobs.encode(good[:-1]) + b"\0").hex()},
        {
            "why": "shorter than header and check sequence",
            "wire": (cobs.encode(short) + b"\0").hex(),
        },
        {"why": "longer than allowed", "wire": (cobs.encode(long_frame) + b"\0").hex()},
        {"why": "stuffing points beyond the end", "wire": "ff010200"},
        {"why": "empty", "wire": "00"},
    ]
    document = {
        "about": "Generated by protocol/generate.py; read by the tests of both languages.",
        "schema_hash": schema.hash,
        "vectors": vectors,
        "bad": bad,
    }
    text = json.dumps(document, indent=1)
    return re.sub(r"\[\s+([-\d,\s]+?)\s+\]", lambda g: f"[{' '.join(g[1].split())}]", text) + "\n"


# --- main ----------------------------------------------------------------------------------------


def _tool(name: str) -> str:
    sibling = Path(sys.executable).with_name(name)
    program = str(sibling) if sibling.exists() else shutil.which(name)
    _require(program is not None, f"{name} is missing; run `make install`")
    return str(program)


def _run(*command: str, text: list[str]) -> str:
    done = subprocess.run(
        command, input="\n".join(text) + "\n", text=True, capture_output=True, cwd=ROOT, check=False
    )
    _require(done.returncode == 0, f"{command[0]} failed: {done.stderr}")
    return done.stdout


def render(schema: Schema) -> dict[str, str]:
    """All outputs."""
    return {
        "cpp": cpp(schema),
        "python": python(schema),
        "data": data(schema),
        "markdown": markdown(schema),
        "golden": golden(schema),
        "micropython": micropython(schema),
    }


def main() -> int:
    """Write the outputs, or compare them with --check."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="compare instead of writing")
    check = parser.parse_args().check
    try:
        outputs = render(load(HERE / "schema.yaml"))
    except SchemaError as error:
        print(f"schema.yaml: {error}", file=sys.stderr)
        return 1
    stale = []
    for key, text in outputs.items():
        path = OUTPUTS[key]
        if path.exists() and path.read_text() == text:
            continue
        stale.append(str(path.relative_to(ROOT)))
        if not check:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
    if check and stale:
        print(
            f"{', '.join(stale)}: not what schema.yaml gives; run `python protocol/generate.py`",
            file=sys.stderr,
        )
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
