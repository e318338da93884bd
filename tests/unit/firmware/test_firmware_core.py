"""The firmware core's C++ tests, built with address and undefined-behaviour sanitizers: one case a
test. The golden vectors of the protocol are handed to them as a generated header."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import pytest
from compiled import compiled

HERE = Path(__file__).parent
ROOT = HERE.parents[2]
CORE = ROOT / "firmware" / "core"
VIRTUAL = ROOT / "firmware" / "virtual"
FLAGS = [
    *("-std=c++14", "-O1", "-g1", "-Wall", "-Wextra", "-Werror"),
    *("-fsanitize=address,undefined", "-fno-sanitize-recover=all"),
]


def _names() -> list[str]:
    """Case names, as TEST(name) declares them."""
    sources = sorted(HERE.glob("*_cases.h"))
    return [
        name for path in sources for name in re.findall(r"^TEST\((\w+)\)", path.read_text(), re.M)
    ]


def _golden_header() -> str:
    """C++ that builds each golden vector's message from its fields."""
    document = json.loads((ROOT / "protocol/golden.json").read_text())
    header = (ROOT / "firmware/core/link/protocol.h").read_text()
    structs = dict(re.findall(r"struct (\w+) \{(.*?)\n\};", header, re.S))
    lines = ["namespace link_cases {"]
    for number, vector in enumerate(document["vectors"]):
        kind = "".join(part.capitalize() for part in vector["message"].split("_"))
        lines += [f"inline void golden_{number}() {{", f"  protocol::{kind} m = {{}};"]
        for field, value in vector["fields"].items():
            declared = re.search(rf"^\s*(\w+) {field}\b", structs[kind], re.M)
            assert declared is not None
            base = declared[1] if declared[1].endswith("_t") else f"protocol::{declared[1]}"
            values = value if isinstance(value, list) else [value]
            for index, item in enumerate(values):
                at = f"[{index}]" if isinstance(value, list) else ""
                lines.append(f"  m.{field}{at} = static_cast<{base}>({item}ll);")
        lines += [
            f"  check_vector(m, {vector['seq']}, {vector['session']}, "
            f'"{vector["frame"]}", "{vector["wire"]}");',
            "}",
        ]
    calls = ", ".join(f"golden_{number}" for number in range(len(document["vectors"])))
    bad = ", ".join(f'"{entry["wire"]}"' for entry in document["bad"])
    lines += [f"void (*const kGoldenVectors[])() = {{{calls}}};"]
    lines += [f"const char* const kGoldenBadFrames[] = {{{bad}}};", "}"]
    return "\n".join(lines) + "\n"


@pytest.fixture(scope="session")
def runner() -> Path:
    """The program; it takes half a minute to build."""
    return compiled(
        "core",
        ["c++", *FLAGS, f"-I{HERE}", f"-I{CORE}", f"-I{VIRTUAL}", HERE / "runner.cpp"],
        [HERE, HERE / "runner.cpp", CORE, VIRTUAL, ROOT / "firmware" / "micropython"],
        {"golden_vectors.h": _golden_header()},
    )


def test_every_case_is_found(runner: Path) -> None:
    listed = subprocess.run([runner], capture_output=True, text=True, check=True).stdout.split()
    assert sorted(listed) == sorted(_names())


@pytest.mark.parametrize("name", _names())
def test_core(runner: Path, name: str) -> None:
    done = subprocess.run([runner, name], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
