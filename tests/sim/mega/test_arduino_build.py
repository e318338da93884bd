"""The firmware as an Arduino sketch, as someone with only the Arduino IDE builds it."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from thigmo.emulator.mega_sim import SimulatedMega
from thigmo.link import protocol as wire
from thigmo.link.framing import Decoder
from thigmo.link.image import ROOT, read_hex, read_image

HARDWARE = Path("/usr/share/arduino/hardware")
BUILDER = Path("/usr/share/arduino-builder")

pytestmark = [
    pytest.mark.ci,
    pytest.mark.skipif(
        shutil.which("arduino-builder") is None or not (HARDWARE / "arduino" / "avr").exists(),
        reason="arduino-builder or arduino-core-avr is not installed",
    ),
]


@pytest.fixture(scope="module")
def sketch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sketch's image, built the way that firmware/mega/README.md tells."""
    folder = tmp_path_factory.mktemp("arduino")
    hardware = folder / "hardware"
    hardware.mkdir()
    (hardware / "arduino").symlink_to(HARDWARE / "arduino")
    for platform in BUILDER.glob("platform*.txt"):
        (hardware / platform.name).symlink_to(platform)
    libraries = folder / "sketchbook" / "libraries"
    libraries.mkdir(parents=True)
    shutil.copytree(ROOT / "firmware", libraries / "thigmo")
    build = folder / "build"
    build.mkdir()
    preferences = {
        "compiler.path": "/usr/bin/",
        "tools.ctags.path": "/usr/bin",
        "tools.ctags.cmd.path": "/usr/bin/arduino-ctags",
        # WString.cpp of the core needs the first with this avr-libc; the rest is the README's.
        "compiler.cpp.extra_flags": "-DDECIMAL_DIG=__DECIMAL_DIG__ -std=gnu++14",
        "compiler.c.elf.extra_flags": "-Wl,--undefined=thigmo_watchdog_entry,"
        "--section-start=.watchdog_entry=0x20000",
    }
    command = ["arduino-builder", "-compile", "-hardware", str(hardware), "-tools", str(hardware)]
    command += ["-tools", "/usr/bin", "-libraries", str(libraries)]
    command += ["-fqbn", "arduino:avr:mega:cpu=atmega2560", "-build-path", str(build)]
    for key, value in preferences.items():
        command += ["-prefs", f"{key}={value}"]
    command.append(str(libraries / "thigmo" / "mega" / "mega.ino"))
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr + result.stdout
    return build / "mega.ino.hex"


def test_the_sketch_builds_and_carries_the_signature(sketch: Path) -> None:
    image = read_image(sketch)
    assert image.schema_hash == wire.SCHEMA_HASH
    assert image.size < 120_000


def test_the_sketch_has_its_watchdog_entry_where_the_boot_loader_calls(sketch: Path) -> None:
    assert 0x20000 in {address for address, _ in read_hex(sketch)}, "compiler.c.elf.extra_flags"


def test_the_sketch_starts_and_announces_itself(sketch: Path) -> None:
    mega = SimulatedMega(1, image=sketch, boot_loader=False)
    mega.step(600)
    frames = Decoder().feed(mega.read())
    assert frames
    announce = frames[0].message()
    assert isinstance(announce, wire.Announce)
    assert announce.board is wire.Board.MEGA
