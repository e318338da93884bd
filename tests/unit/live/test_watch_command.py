"""`thigmo watch` refuses what cannot work, in one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from thigmo.cli.main import app
from thigmo.errors import DataError, RunFolderError


def _refused(*arguments: str) -> BaseException | None:
    return CliRunner().invoke(app, ["watch", "--no-browser", *arguments]).exception


def test_finished_run_is_not_served_to_foxglove_which_opens_its_record(tmp_path: Path) -> None:
    error = _refused(str(tmp_path), "--foxglove")
    assert isinstance(error, DataError)
    assert f"open {tmp_path / 'run.mcap'} in Foxglove" in str(error)


@pytest.mark.parametrize("command", ["watch", "ros"])
@pytest.mark.parametrize("target", ["runs/none", "none"])
def test_what_is_neither_a_folder_nor_an_address_is_no_robot(command: str, target: str) -> None:
    error = CliRunner().invoke(app, [command, target]).exception
    assert isinstance(error, RunFolderError)
    assert str(error) == f"no such run folder or port: {target}; check its path"
