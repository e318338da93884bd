"""`thigmo ros` refuses what cannot work, in one line."""

from __future__ import annotations

import sys

import pytest
from typer.testing import CliRunner

from thigmo.cli.main import app
from thigmo.errors import ThigmoError


def _refused(*arguments: str) -> str:
    error = CliRunner().invoke(app, ["ros", *arguments]).exception
    assert isinstance(error, ThigmoError)
    return str(error)


def test_namespace_that_ros_does_not_allow_is_refused() -> None:
    assert "no ROS namespace" in _refused("--namespace", "my robot")


def test_missing_package_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cyclonedds", None)
    for name in [name for name in sys.modules if name.startswith(("cyclonedds.", "thigmo.live"))]:
        monkeypatch.delitem(sys.modules, name)
    assert "pip install 'thigmo[ros]'" in _refused()
