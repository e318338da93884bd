"""Golden vectors: the Python module and the C++ header agree on every byte.

The C++ half is written here from golden.json, compiled with the system's compiler (and, where it is
installed, with avr-gcc, without running it), and run.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from compiled import compiled

from thigmo.link import protocol as wire
from thigmo.link.framing import Decoder, FrameError, decode, encode

ROOT = Path(__file__).parents[3]
GOLDEN = json.loads((ROOT / "protocol/golden.json").read_text())
VECTORS: list[dict[str, Any]] = GOLDEN["vectors"]


def camel(name: str) -> str:
    return "".join(part.capitalize() for part in name.split("_"))


def python_message(vector: dict[str, Any]) -> wire.Message:
    fields = {k: tuple(v) if isinstance(v, list) else v for k, v in vector["fields"].items()}
    return wire.MESSAGES[vector["id"]](**fields)


def test_the_vectors_are_of_this_schema_and_cover_every_message() -> None:
    assert GOLDEN["schema_hash"] == wire.SCHEMA_HASH
    assert {v["id"] for v in VECTORS} == set(wire.MESSAGES)


@pytest.mark.parametrize("vector", VECTORS, ids=lambda v: v["message"])
def test_python_encodes_and_decodes(vector: dict[str, Any]) -> None:
    message = python_message(vector)
    assert vector["message"] == message.NAME
    assert message.pack().hex() == vector["payload"]
    assert encode(message, vector["seq"], vector["session"]).hex() == vector["wire"]
    frame = decode(bytes.fromhex(vector["wire"])[:-1])
    assert (frame.id, frame.seq, frame.session) == (vector["id"], vector["seq"], vector["session"])
    assert frame.message() == message


@pytest.mark.parametrize("bad", GOLDEN["bad"], ids=lambda b: b["why"])
def test_python_refuses(bad: dict[str, str]) -> None:
    data = bytes.fromhex(bad["wire"])
    assert Decoder().feed(data) == []
    with pytest.raises(FrameError):
        decode(data[:-1])


def cpp_value(value: int) -> str:
    if value == -(1 << 31):
        return "INT32_MIN"
    return f"{value}u" if value > 0x7FFF_FFFF else str(value)


def cpp_case(number: int, vector: dict[str, Any]) -> str:
    name = camel(vector["message"])
    payload = ", ".join(str(b) for b in bytes.fromhex(vector["payload"])) or "0"
    size = len(vector["payload"]) // 2
    assign = []
    for field, value in vector["fields"].items():
        for index, item in enumerate(value if isinstance(value, list) else [value]):
            target = f"m.{field}" + (f"[{index}]" if isinstance(value, list) else "")
            assign.append(f"  set(&{target}, {cpp_value(item)});")
    return "\n".join(
        [
            f"static bool case{number}() {{",
            f"  const uint8_t golden[] = {{{payload}}};",
            f"  {name} m{{}};",
            "  static_assert("
            + f"{name}::kSize == {size} && {name}::kId == {vector['id']}"
            + ', "");',
            *assign,
            "  uint8_t out[128];",
            "  m.encode(out);",
            f"  if (!same(out, golden, {size})) return false;",
            f"  {name} back{{}};",
            f"  if (!{name}::decode(golden, {size}, &back)) return false;",
            f"  if ({name}::decode(golden, {size + 1}, &back)) return false;",
            "  uint8_t again[128];",
            "  back.encode(again);",
            f"  return same(again, golden, {size});",
            "}",
        ]
    )


def cpp_program() -> str:
    cases = [cpp_case(n, v) for n, v in enumerate(VECTORS)]
    calls = [f"  if (!case{n}()) return {n % 250 + 1};" for n in range(len(VECTORS))]
    low = [str(p.low) for p in wire.PARAMETERS.values() for _ in p.defaults]
    table = [f"{p.low}, {p.high}, {d}" for p in wire.PARAMETERS.values() for d in p.defaults]
    return "\n".join(
        [
            '#include "link/protocol.h"',
            "using namespace thigmo::protocol;",
            "static bool same(const uint8_t* a, const uint8_t* b, int n) {",
            "  for (int i = 0; i < n; ++i) if (a[i] != b[i]) return false;",
            "  return true;",
            "}",
            "template <typename T, typename V> static void set(T* to, V value) {",
            "  *to = static_cast<T>(value);",
            "}",
            *cases,
            f'static_assert(kSchemaHash == {wire.SCHEMA_HASH}u, "");',
            f'static_assert(kParamCount == {len(low)}, "");',
            "int main() {",
            *calls,
            f"  const int64_t table[] = {{{', '.join(table)}}};",
            "  for (uint16_t i = 0; i < kParamCount; ++i) {",
            "    const ParamRow& row = kParamRows.row[i];",
            "    if (row.low != table[3 * i] || row.high != table[3 * i + 1] ||",
            "        row.initial != table[3 * i + 2])",
            "      return 255;",
            "  }",
            "  return 0;",
            "}",
            "",
        ]
    )


def test_cpp_encodes_and_decodes() -> None:
    program = built("golden", "c++", "-std=c++14")
    code = subprocess.run([program], check=False).returncode
    assert code == 0, f"vector {code - 1}: {VECTORS[code - 1] if code < 255 else 'parameters'}"


@pytest.mark.skipif(not shutil.which("avr-g++"), reason="avr-g++ is not installed")
def test_the_header_compiles_for_the_mega() -> None:
    assert built("golden-avr", "avr-g++", "-mmcu=atmega2560", "-std=gnu++14", "-Os", "-c").exists()


def built(name: str, *command: str) -> Path:
    """What the generated header and its vectors compile to."""
    core = ROOT / "firmware/core"
    source = ["-x", "c++", "-include", "golden_vectors.h", "/dev/null"]
    flags = ["-Wall", "-Wextra", "-Werror", f"-I{core}"]
    return compiled(name, [*command, *flags, *source], [core], {"golden_vectors.h": cpp_program()})
