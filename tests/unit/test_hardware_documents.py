"""The hardware's papers agree with each other and with the firmware: parts, drawings, pins."""

from __future__ import annotations

import csv
import json
import re
import runpy
import struct
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
HARDWARE = ROOT / "docs" / "hardware"
PARTS = ("parts.csv", "pico-parts.csv")
DRAWINGS = sorted(HARDWARE.glob("*.svg"))
NAME = re.compile(r"\b(?:PS|RV|FR|PR|NV|TL|TR|[ABCDFGJMPQRSUVY])\d*\b")


def expanded(names: str) -> list[str]:
    """Names of parts in a row: `R1 R2`, `B1-B10`."""
    parts = []
    for word in names.split():
        first, _, last = word.partition("-")
        kind, low = re.fullmatch(r"([A-Z]+)(\d*)", first).groups()  # type: ignore[union-attr]
        if last:
            parts += [f"{kind}{n}" for n in range(int(low), int(last.removeprefix(kind)) + 1)]
        else:
            parts.append(first)
    return parts


@pytest.fixture
def parts() -> dict[str, list[str]]:
    """Each row of the bills of materials: its count and its names."""
    rows = []
    for name in PARTS:
        with (HARDWARE / name).open() as file:
            rows += list(csv.DictReader(file))
    assert len({row["ref"] for row in rows}) == len(rows)
    return {row["ref"]: [row["count"], *expanded(row["ref"])] for row in rows}


def words(drawing: Path) -> str:
    """What is written in a drawing, without the Mega's pins."""
    text = "\n".join(re.findall(r">([^<]+)</t", drawing.read_text()))
    return re.sub(r"A\d+\.\.A?\d+|\bA1[0-2]\b|Mega \S+", "", text)


def test_parts_are_counted_and_named_once(parts: dict[str, list[str]]) -> None:
    names = [name for _, *row in parts.values() for name in row]
    assert sorted(names) == sorted(set(names))
    for row, (count, *cells) in parts.items():
        assert int(count) == len(cells), row


def test_every_fitting_has_its_place(parts: dict[str, list[str]]) -> None:
    page = (HARDWARE / "air.md").read_text()
    table = re.findall(r"^\| (X\d+)(?:-X(\d+))?, [^|]*\| ([^|]*) \|$", page, re.MULTILINE)
    used = []
    for first, last, places in table:
        names = expanded(f"{first}-X{last}" if last else first)
        counts = re.findall(r"(\d+)(?: \([^)]*\))?(?:,|$)", places)
        assert sum(map(int, counts)) == len(names), first
        used += names
    assert sorted(used) == sorted(n for _, *row in parts.values() for n in row if n[0] == "X")


@pytest.mark.parametrize("drawing", DRAWINGS, ids=lambda path: path.stem)
def test_what_is_drawn_is_in_the_parts_list(drawing: Path, parts: dict[str, list[str]]) -> None:
    known = {name for _, *row in parts.values() for name in row}
    drawn = {name for name in NAME.findall(words(drawing)) if name[-1].isdigit()}
    assert drawn
    drawn = {re.sub(r"^S1[ABC]$", "S1", name) for name in drawn}
    assert drawn <= known


def test_pins_are_the_firmwares() -> None:
    header = (ROOT / "firmware/mega/pins.h").read_text()
    page = (HARDWARE / "wiring.md").read_text()

    def pins(rows: list[str]) -> set[str]:
        names: set[str] = set()
        for row in rows:
            for first, last in re.findall(r"(A?\d+)(?:\.\.A(\d+))?", row):
                low = int(first.removeprefix("A"))
                names |= {
                    f"{'A' * first.startswith('A')}{n}" for n in range(low, int(last or low) + 1)
                }
        return names

    used = pins(re.findall(r"^// \| ([A0-9., ]+?) +\|", header, re.MULTILINE))
    assert used == pins(re.findall(r"^\| ([A0-9., ]+?) +\|", page, re.MULTILINE))
    drawn = set()
    for drawing in DRAWINGS:
        drawn |= set(re.findall(r"Mega (A?\d+)", drawing.read_text()))
    assert drawn <= used
    assert {"46", "24", "6", "7", "2", "3", "22"} <= drawn


def test_pico_pins_are_those_of_the_pin_map() -> None:
    pins = runpy.run_path(str(ROOT / "firmware/micropython/robot/pins.py"))["PINS"]
    page = (HARDWARE / "pico.md").read_text()
    rows = re.findall(r"^\| GP(\d+) \((\d+)\) \| `(\w+)` \|", page, re.MULTILINE)
    assert {name: int(pin) for pin, _, name in rows} == pins
    # Grounds, RUN, and the pins between GP22 and GP26 interrupt the header's count.
    grounds = (3, 8, 13, 18, 23, 28)
    header = [pin for pin in range(1, 30) if pin not in grounds]
    places = {**dict(enumerate(header)), 26: 31, 27: 32, 28: 34}
    assert {int(pin): int(place) for pin, place, _ in rows} == {
        pin: places[pin] for pin in pins.values()
    }
    drawn = set(re.findall(r"\bGP(\d+)", (HARDWARE / "pico.svg").read_text()))
    assert drawn == {str(pin) for pin in pins.values()}


def test_supplies_and_fuses_are_those_that_the_motors_stall_asks_for(
    capsys: pytest.CaptureFixture[str],
) -> None:
    tool = runpy.run_path(str(ROOT / "tools/supplies.py"))
    with (HARDWARE / "parts.csv").open() as file:
        rows = {row["ref"]: row for row in csv.DictReader(file)}

    def ampere(text: str) -> float:
        return float(re.findall(r"([\d.]+) A", text)[0])

    (stall,) = re.findall(r"([\d.]+) A and 15 kg cm stalled", rows["M1"]["data"])
    (brake,) = re.findall(r"BR1 takes ([\d.]+) A", rows["PS2"]["data"])
    assert ampere(rows["PS2"]["what"]) >= tool["motor_supply"](float(stall), float(brake))
    assert ampere(rows["F2"]["what"]) == tool["motor_fuse"](float(stall), float(brake))
    load = ampere(rows["PS1"]["data"])
    assert ampere(rows["F1"]["what"]) == tool["air_fuse"](load)
    assert ampere(rows["PS1"]["what"]) >= 1.5 * load
    page = (HARDWARE / "electronics.md").read_text()
    assert f"takes {tool['working'](float(stall), float(brake)):.1f} A at most" in page
    assert f"a slow {tool['motor_fuse'](float(stall), float(brake)):g} A fuse" in page
    assert tool["main"](["--stall", stall, "--brake", brake]) == 0
    assert "F2   2 A slow" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (["--stall", "0.9", "--brake", "1.6"], "take a weaker brake"),
        (["--stall", "-1"], "are in ampere and positive"),
    ],
)
def test_a_motor_that_no_fuse_protects_is_refused(
    wrong: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        runpy.run_path(str(ROOT / "tools/supplies.py"))["main"](wrong)
    assert said in capsys.readouterr().err


def test_printed_pieces_have_the_sizes_that_are_stated() -> None:
    folder = HARDWARE / "printed"
    sizes = json.loads((folder / "sizes.json").read_text())
    page = (HARDWARE / "parts.csv").read_text()
    for name, stated in sizes.items():
        # Binary STL: 80 bytes, a count, and for each triangle a normal, three corners, two bytes.
        data = (folder / f"{name}.stl").read_bytes()
        (count,) = struct.unpack_from("<I", data, 80)
        kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
        corners = np.frombuffer(data, kind, count, offset=84)["corners"].reshape(-1, 3)
        assert corners.max(axis=0) - corners.min(axis=0) == pytest.approx(
            stated["size_mm"], abs=0.15
        )
        assert f"printed/{name}.stl" in page
        assert (folder / f"{name}.step").read_text().startswith("ISO-10303-21")


def test_each_part_has_an_order_number_and_a_dated_price_or_says_that_none_was_found() -> None:
    tool = runpy.run_path(str(ROOT / "tools/parts.py"))
    rows = [row for name in PARTS for row in tool["read"](name)]
    for row in rows:
        if tool["is_priced"](row):
            assert re.fullmatch(r"\d+\.\d{2,4} [A-Z]{3}", row["price"]), row
            assert row["order"], row
            assert row["source"].startswith("https://"), row
            assert re.fullmatch(r"(20\d\d-\d\d(-\d\d)?)?", row["dated"]), row
        else:
            assert row["price"] in (tool["NO_PRICE"], tool["PRINTED"]), row
            assert (row["price"] == tool["PRINTED"]) == row["part"].startswith("printed/"), row
            assert not row["dated"], row


def test_the_total_is_that_of_the_rows_and_counts_what_it_leaves_out() -> None:
    tool = runpy.run_path(str(ROOT / "tools/parts.py"))
    row = {"ref": "D1", "order": "1N4148", "count": "3", "price": "0.10 USD", "dated": "2026-09-22"}
    rows = [
        row,
        {**row, "count": "2", "price": "1.97 PLN", "dated": "2025-04"},
        {**row, "count": "1", "price": "0.25 USD", "dated": ""},
        {**row, "ref": "H1", "order": "", "price": tool["NO_PRICE"], "dated": ""},
        {**row, "ref": "H2", "order": "", "price": tool["PRINTED"], "dated": ""},
    ]
    text = tool["summary"](rows)
    assert text.startswith("3 of 5 rows have a price: together 3.94 PLN and 0.55 USD,")
    assert "by prices of 2025-04 to 2026-09-22" in text
    assert "Rows without a price: 1; printed: 1." in text
    assert text.endswith("Rows without an order number (1): H1.")


def test_the_page_of_parts_shows_every_row_below_its_total(
    capsys: pytest.CaptureFixture[str],
) -> None:
    tool = runpy.run_path(str(ROOT / "tools/parts.py"))
    page = tool["page"]()
    for name in PARTS:
        rows = tool["read"](name)
        assert tool["summary"](rows) in page
        for row in rows:
            assert f"| {row['ref']} | {row['count']} |" in page
    tool["main"]()
    assert "TL TR" in capsys.readouterr().out
