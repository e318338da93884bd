"""Golden vectors: the Python module encodes, decodes and refuses them byte for byte.

tests/unit/firmware holds the C++ header against the same vectors.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from thigmo.link import protocol as wire
from thigmo.link.framing import Decoder, FrameError, decode, encode

ROOT = Path(__file__).parents[3]
GOLDEN = json.loads((ROOT / "protocol/golden.json").read_text())
VECTORS: list[dict[str, Any]] = GOLDEN["vectors"]


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
