"""One version in every place that tells it."""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

import thigmo
from thigmo.cli.added import add_commands
from thigmo.cli.main import app
from thigmo.errors import ConfigError, PortError
from thigmo.extras import NotInstalledError
from thigmo.link import image

ROOT = Path(__file__).resolve().parents[2]
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]


@pytest.mark.parametrize(
    ("file", "pattern"),
    [
        ("CITATION.cff", r"^version: (.*)$"),
        ("firmware/library.properties", r"^version=(.*)$"),
        ("package.json", r'^  "version": "(.*)"'),
        ("firmware/core/link/session.h", r"kFirmwareVersion\[3\] = {(.*)}"),
    ],
)
def test_every_file_tells_the_same_version(file: str, pattern: str) -> None:
    match = re.search(pattern, (ROOT / file).read_text(), re.M)
    assert match is not None
    assert match[1].replace(", ", ".") == VERSION == thigmo.__version__


def test_an_installation_without_sources_flashes_the_image_that_came_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(image, "ROOT", tmp_path)
    monkeypatch.setattr(image, "PACKAGED", tmp_path / "thigmo.hex")
    with pytest.raises(PortError, match="no firmware image"):
        image.build_image()
    (tmp_path / "thigmo.hex").write_text(":00000001FF\n")
    assert image.build_image() == tmp_path / "thigmo.hex"
    with pytest.raises(PortError, match="500000 baud"):
        image.build_image(500_000)
    with pytest.raises(ConfigError, match="not a thigmo image"):
        image.read_image(image.build_image())


@pytest.mark.parametrize(
    ("command", "absent", "cure"),
    [
        ("watch", "aiohttp", r"thigmo\[live\]"),
        ("explore --watch", "segno", r"thigmo\[live\]"),
        ("watch --foxglove", "foxglove", r"thigmo\[foxglove\]"),
        ("camera sheet", "cv2", r"thigmo\[camera\]"),
        ("calibrate status", "cv2", r"thigmo\[camera\]"),
        ("ros", "cyclonedds", r"thigmo\[ros\]"),
        ("design", "matplotlib", r"thigmo\[plot\]"),
        ("info --robot mega-sim://default", "thigmo.emulator.mega_sim", "make install"),
        ("info --robot micropython://default", "thigmo.emulator.micropython", "make install"),
    ],
)
def test_a_command_names_what_its_installation_lacks(
    command: str, absent: str, cure: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, absent, None)
    for name in [
        module for module in sys.modules if module.startswith((f"{absent}.", "thigmo.live"))
    ]:
        monkeypatch.delitem(sys.modules, name)
    error = CliRunner().invoke(app, command.split()).exception
    assert isinstance(error, NotInstalledError)
    assert re.search(cure, str(error))


@pytest.mark.parametrize("command", ["bench list", "experiment all --jobs 2", "score answers.csv"])
def test_a_wheel_says_how_to_get_the_commands_of_the_studies(
    command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "thigmo_bench", None)
    commands = typer.Typer()
    add_commands(commands)
    error = CliRunner().invoke(commands, command.split()).exception
    assert isinstance(error, NotInstalledError)
    assert "make install" in str(error)
