"""`thigmo design`: tables and a figure for a layout, and one line for what is no layout."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from thigmo.cli.main import app
from thigmo.errors import DataError


def run(folder: Path, *options: str) -> dict[str, list[dict[str, float]]]:
    done = CliRunner().invoke(app, ["design", "--json", "--out", str(folder), *options])
    assert done.exit_code == 0, done.output
    report: dict[str, list[dict[str, float]]] = json.loads(done.stdout)
    return report


def test_more_sensors_bound_better_and_close_pairs_are_hopeless(tmp_path: Path) -> None:
    few = run(tmp_path / "few", "--centers", "5,25,45")
    many = run(tmp_path / "many", "--centers", "5,10,15,20,25,30,35,40,45,49")
    at = [row for row in few["one_contact"] if abs(row["arc"] - 50.0) < 1.0]
    better = [row for row in many["one_contact"] if abs(row["arc"] - 50.0) < 1.0]
    assert all(b["bound"] < a["bound"] for a, b in zip(at, better, strict=True))
    # Two contacts that no sensor parts have no bound (null in JSON).
    assert any(row["distal_bound"] is None for row in few["two_contacts"])
    assert (tmp_path / "few/design-bounds.png").is_file()
    assert (tmp_path / "few/design-one-contact.csv").is_file()


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (("--centers", "5,x"), "--centers"),
        (("--columns", "0"), "--columns"),
        (("--centers", "60"), "off a body of"),
    ],
)
def test_what_is_no_layout_is_named(tmp_path: Path, options: tuple[str, ...], named: str) -> None:
    done = CliRunner().invoke(app, ["design", "--out", str(tmp_path), *options])
    assert isinstance(done.exception, DataError)
    assert named in str(done.exception)


def test_two_readings_localize_nothing_and_design_says_so(tmp_path: Path) -> None:
    options = ["design", "--columns", "1", "--out", str(tmp_path), "--centers"]
    two = CliRunner().invoke(app, [*options, "15,35"])
    assert "nothing is localized with fewer than 3 readings" in two.stdout
    three = CliRunner().invoke(app, [*options, "15,25,35"])
    assert "nothing is localized" not in three.stdout
