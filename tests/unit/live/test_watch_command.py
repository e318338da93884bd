"""`thigmo watch` refuses what cannot work, in one line."""

from __future__ import annotations

from pathlib import Path

from typer.testing import CliRunner

from thigmo.cli.main import app
from thigmo.errors import DataError, RunFolderError


def _refused(*arguments: str) -> BaseException | None:
    return CliRunner().invoke(app, ["watch", "--no-browser", *arguments]).exception


def test_finished_run_is_not_served_to_foxglove_which_opens_its_record(tmp_path: Path) -> None:
    error = _refused(str(tmp_path), "--foxglove")
    assert isinstance(error, DataError)
    assert f"open {tmp_path / 'run.mcap'} in Foxglove" in str(error)


def test_path_that_is_not_there_is_no_robot(tmp_path: Path) -> None:
    error = _refused(str(tmp_path / "none"))
    assert isinstance(error, RunFolderError)
    assert "no such run folder or port" in str(error)
