"""The generator refuses a schema that breaks the protocol's rules."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def generate() -> ModuleType:
    spec = importlib.util.spec_from_file_location("generate", ROOT / "protocol/generate.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["generate"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def committed() -> dict[str, Any]:
    return yaml.safe_load((ROOT / "protocol/schema.yaml").read_text())


@pytest.fixture
def tree(committed: dict[str, Any]) -> dict[str, Any]:
    return deepcopy(committed)


def load(generate: ModuleType, tree: dict[str, Any], folder: Path) -> Any:
    path = folder / "schema.yaml"
    path.write_text(yaml.dump(tree, Dumper=yaml.CSafeDumper, sort_keys=False))
    return generate.load(path)


@pytest.mark.parametrize(
    "path",
    [
        ("messages", "arm", "doc"),
        ("enums", "State", "doc"),
        ("enums", "State", "safe", "doc"),
        ("messages", "hello", "deadline_ms"),
        ("parameters", "settle_ms", "doc"),
        ("parameters", "settle_ms", "default"),
        ("parameters", "settle_ms", "range"),
    ],
    ids="-".join,
)
def test_words_defaults_ranges_and_deadlines_do_not_change_the_hash(
    generate: ModuleType, tree: dict[str, Any], tmp_path: Path, path: tuple[str, ...]
) -> None:
    before = load(generate, tree, tmp_path).hash
    *parents, last = path
    node = tree
    for name in parents:
        node = node[name]
    assert last in node
    node[last] = {"range": [1, 600001], "default": 31000, "deadline_ms": 2999}.get(last, "Other.")
    assert load(generate, tree, tmp_path).hash == before


LAYOUT: dict[str, Callable[[dict[str, Any]], object]] = {
    "a message's id": lambda tree: tree["messages"]["arm"].update(id=0x2F),
    "a message's kind": lambda tree: tree["messages"]["pulse"].update(kind="telemetry"),
    "a command's reply": lambda tree: tree["messages"]["arm"].update(reply="status_report"),
    "the order of fields": lambda tree: tree["messages"]["grow_to"]["fields"].reverse(),
    "a field's name": lambda tree: tree["messages"]["grow_to"]["fields"][0].update(name="depth"),
    "a field's type": lambda tree: tree["messages"]["grow_to"]["fields"][0].update(type="u32"),
    "a field's unit": lambda tree: tree["messages"]["grow_to"]["fields"][0].update(unit="mm"),
    "a field's count": lambda tree: tree["messages"]["telemetry"]["fields"][1].update(count=9),
    "a field's enumeration": lambda tree: tree["messages"]["set_map"]["fields"][2].pop("enum"),
    "an enumeration's number": lambda tree: tree["enums"]["Branch"]["inflate"].update(value=7),
    "a bit": lambda tree: tree["enums"]["Fault"].pop("watchdog"),
    "a parameter's id": lambda tree: tree["parameters"]["settle_ms"].update(id=250),
    "a parameter's unit": lambda tree: tree["parameters"]["settle_ms"].update(unit="s"),
    "a parameter's count": lambda tree: tree["parameters"]["settle_ms"].update(count="muscles"),
    "a parameter's place": lambda tree: tree["parameters"].update(
        imu_from=tree["parameters"].pop("imu_from")
    ),
    "the map's step": lambda tree: tree["map"].update(step_cpsi=100),
    "the frame": lambda tree: tree.update(max_wire_bytes=97),
}


@pytest.mark.parametrize("part", LAYOUT)
def test_the_wires_layout_changes_the_hash(
    generate: ModuleType, tree: dict[str, Any], tmp_path: Path, part: str
) -> None:
    before = load(generate, tree, tmp_path).hash
    LAYOUT[part](tree)
    assert load(generate, tree, tmp_path).hash != before


def test_a_board_can_be_listed_without_a_change_of_the_hash(
    generate: ModuleType, tree: dict[str, Any], tmp_path: Path
) -> None:
    before = load(generate, tree, tmp_path).hash
    tree["enums"]["Board"]["bench_rig"] = {"value": 130, "doc": "A lab's own."}
    assert load(generate, tree, tmp_path).hash == before
    tree["enums"]["State"]["asleep"] = {"value": 9, "doc": "A new state is a new meaning."}
    assert load(generate, tree, tmp_path).hash != before


def breakage(name: str, tree: dict[str, Any]) -> None:
    messages, parameters = tree["messages"], tree["parameters"]
    filler = {"name": "filler", "type": "u32", "count": 10, "doc": "Too much."}
    match name:
        case "bytes on the wire":
            messages["telemetry"]["fields"].append(filler)
        case "> 24":
            messages["event"]["fields"].append({"name": "more", "type": "u32", "doc": "Too much."})
        case "an id is used twice":
            messages["vent"]["id"] = messages["arm"]["id"]
        case "a value is used twice":
            tree["enums"]["State"]["safe"]["value"] = 0
        case "default outside its range":
            parameters["settle_ms"]["default"] = 600001
        case "too many defaults":
            parameters["flex_center_um"]["default"] = [1] * 17
        case "give it an id":
            del parameters["settle_ms"]["id"]
        case "a stored id is used twice":
            parameters["settle_ms"]["id"] = tree["map"]["id"]
        case "bad range":
            parameters["settle_ms"]["range"] = [5, 5]
        case "unknown reply":
            messages["arm"]["reply"] = "telemetry"
        case "frozen":
            messages["ack"]["fields"].append({"name": "more", "type": "u8", "doc": "Grown."})
        case "unknown keys":
            messages["arm"]["repyl"] = "ack"
        case "first field is its status":
            messages["snapshot"]["fields"].reverse()
        case "unknown enum":
            messages["set_map"]["fields"][1]["enum"] = "Sides"


@pytest.mark.parametrize(
    "rule",
    [
        "bytes on the wire",
        "> 24",
        "an id is used twice",
        "a value is used twice",
        "default outside its range",
        "too many defaults",
        "give it an id",
        "a stored id is used twice",
        "bad range",
        "unknown reply",
        "frozen",
        "unknown keys",
        "first field is its status",
        "unknown enum",
    ],
)
def test_a_broken_rule_is_named(
    generate: ModuleType, tree: dict[str, Any], tmp_path: Path, rule: str
) -> None:
    breakage(rule, tree)
    with pytest.raises(generate.SchemaError, match=rule):
        load(generate, tree, tmp_path)


def test_a_key_given_twice_is_refused(generate: ModuleType, tmp_path: Path) -> None:
    text = (ROOT / "protocol/schema.yaml").read_text()
    path = tmp_path / "schema.yaml"
    path.write_text(text + "\nprotocol: 2\n")
    with pytest.raises(generate.SchemaError, match="given twice"):
        generate.load(path)
