"""`thigmo runs`: the runs of a folder, and two of them beside each other."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from contacts import CONTACT, run_folder
from typer.testing import CliRunner

from thigmo.cli.main import app
from thigmo.errors import DataError
from thigmo.record.listing import compare_contacts, list_runs


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    run_folder(tmp_path, "b", "2026-11-01T10:00:00", contacts=[CONTACT], effort="quick")
    moved = replace(CONTACT, x_cm=CONTACT.x_cm + 3.0, y_cm=CONTACT.y_cm + 4.0)
    run_folder(tmp_path, "a", "2026-11-02T10:00:00", contacts=[moved], outcome="peg ahead")
    (tmp_path / "notes").mkdir()
    (tmp_path / "torn").mkdir()
    (tmp_path / "torn" / "contacts.json").write_text('{"thigmo"')
    return tmp_path


def test_runs_are_listed_by_time_and_a_damaged_one_says_so(runs: Path) -> None:
    listed = list_runs(runs)
    assert [run.path.name for run in listed] == ["torn", "b", "a"]
    assert "torn" in listed[0].problem
    assert [run.path.name for run in listed if run.matches("PEG AHEAD")] == ["a"]
    assert [run.path.name for run in listed if run.matches("quick")] == ["b"]


def test_contacts_are_paired_by_their_distance_in_the_plane() -> None:
    far = replace(CONTACT, x_cm=CONTACT.x_cm + 30.0)
    near = replace(CONTACT, x_cm=CONTACT.x_cm + 1.0)
    pairs = compare_contacts([CONTACT, far], [near], within_cm=4.0)
    assert [pair.distance_cm for pair in pairs] == [1.0, None]
    assert pairs[0].first is CONTACT
    assert pairs[1].first is far
    assert pairs[1].second is None
    assert [pair.second for pair in compare_contacts([far], [near], 4.0)] == [None, near]


def test_the_command_lists_finds_and_compares(runs: Path) -> None:
    def said(*arguments: object) -> str:
        result = CliRunner().invoke(app, ["runs", *map(str, arguments)], catch_exceptions=False)
        assert result.exit_code == 0
        return result.stdout

    assert "peg ahead" in said(runs)
    assert "full length" not in said(runs, "--find", "ahead")
    assert "no run with 'nowhere'" in said(runs, "--find", "nowhere")
    facts = json.loads(said(runs / "a", runs / "b", "--within", "6", "--json"))
    assert facts["contacts"][0]["distance_cm"] == 5.0
    assert said(runs / "a", runs / "b").count("not found") == 2


def test_a_folder_that_holds_no_runs_is_an_error_with_a_cure(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="name the folder"):
        list_runs(tmp_path / "none")
    with pytest.raises(DataError, match="two run folders"):
        CliRunner().invoke(app, ["runs", "a", "b", "c"], catch_exceptions=False)
