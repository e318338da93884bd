"""The firmware as an Arduino sketch, as someone with only the Arduino IDE builds it."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from cut_uploads import UploadedBoard, mixtures, pages, some

from thigmo.emulator import mega_build
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
    assert len(image.program) < 120_000


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


STAMP = re.compile(rb"[A-Z][a-z]{2} [ \d]\d \d{4} \d\d:\d\d:\d\d")


def test_the_sketch_ends_with_the_time_of_compilation_that_its_guard_looks_for(
    sketch: Path,
) -> None:
    program = dict(read_hex(sketch))[0]
    (guard,) = STAMP.findall(program[0x100:0x200])
    assert program.endswith(guard)


@pytest.mark.parametrize("before", ["another compilation", "the Makefile's image"])
def test_a_cut_upload_of_the_sketch_starts_nothing_once_page_1_is_written(
    sketch: Path, before: str
) -> None:
    new = pages(read_hex(sketch))
    old = pages(read_hex(mega_build.firmware_hex()))
    if before == "another compilation":
        old = pages(
            [(at, STAMP.sub(b"Jan  1 2026 00:00:00", data)) for at, data in read_hex(sketch)]
        )
    entry = max(new)  # its page is not run before a watchdog bites, and avrdude verifies it
    program = {number: page for number, page in new.items() if number != entry}
    board = UploadedBoard()
    for written, state, flash in mixtures(old, new, cuts=some(len(new))):
        if written == 1 and state != "whole":
            continue  # page 1 while it is written: old pages run, which README says is not covered
        outcome = board.outcome_of(flash)
        if written < 2:
            assert outcome != "energises", (written, state)
        else:
            whole = program.items() <= flash.items()
            assert outcome == ("starts" if whole else "stays"), (written, state)
