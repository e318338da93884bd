"""`thigmo ros` without its package says in one line what to install."""

from __future__ import annotations

import sys

import pytest
from typer.testing import CliRunner

from thigmo.cli.main import app


def test_missing_package_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cyclonedds", None)
    for name in [name for name in sys.modules if name.startswith(("cyclonedds.", "thigmo.live"))]:
        monkeypatch.delitem(sys.modules, name)
    error = CliRunner().invoke(app, ["ros"]).exception
    assert "pip install 'thigmo[ros]'" in str(error)
