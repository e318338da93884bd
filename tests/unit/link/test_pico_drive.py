"""Images for a Pico: what is refused before it is written, and what is written to its drive."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from thigmo.cli.main import app
from thigmo.errors import ConfigError, LinkError, NotARobotError, PortError, SchemaMismatchError
from thigmo.link import pico
from thigmo.link import protocol as wire
from thigmo.link.image import MAGIC

INFO = "UF2 Bootloader v3.0\r\nModel: Raspberry Pi RP2\r\nBoard-ID: RPI-RP2\r\n"
BLOCK = 512


def program(
    schema: int = wire.SCHEMA_HASH, stack: int = 0x20042000, reset: int = 0x100001F7
) -> bytes:
    boot = bytes(range(252))
    signature = MAGIC + struct.pack("<IB", schema, wire.PROTOCOL)
    whole = boot + struct.pack("<I", pico.boot_check(boot)) + struct.pack("<2I", stack, reset)
    return whole.ljust(5000, b"\0") + signature


@pytest.fixture
def uf2(tmp_path: Path) -> Path:
    return pico.write_uf2(tmp_path / "thigmo-pico.uf2", program())


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    folder = tmp_path / "RPI-RP2"
    folder.mkdir()
    (folder / "INFO_UF2.TXT").write_text(INFO, newline="")
    return folder


def test_an_image_says_what_it_is(uf2: Path) -> None:
    image = pico.read_uf2(uf2)
    assert image.program.rstrip(b"\xff") == program()
    assert (image.schema_hash, image.protocol) == (wire.SCHEMA_HASH, wire.PROTOCOL)


def test_the_check_sequence_is_the_boot_roms() -> None:
    # CRC-32/MPEG-2 of 252 zeros, from its definition in polynomials over GF(2).
    value = 0xFFFFFFFF << 252 * 8
    for bit in range(252 * 8 + 31, 31, -1):
        if value >> bit & 1:
            value ^= 0x104C11DB7 << bit - 32
    assert pico.boot_check(bytes(252)) == value


def test_a_copy_that_is_cut_anywhere_leaves_nothing_that_starts(uf2: Path) -> None:
    content = uf2.read_bytes()
    first, *_, last = (
        struct.unpack_from("<I", content, at + 12)[0] for at in range(0, len(content), BLOCK)
    )
    # The boot ROM erases a sector when the first of its pages comes, so the old boot stage is gone
    # from the first block on, and the new one is whole only with the last.
    assert first == pico.FLASH + pico.PAGE
    assert last == pico.FLASH


def damaged(change: Callable[[bytearray], object]) -> Callable[[Path], None]:
    def apply(path: Path) -> None:
        content = bytearray(path.read_bytes())
        change(content)
        path.write_bytes(content)

    return apply


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (damaged(lambda c: c.__delitem__(slice(BLOCK * 3, BLOCK * 4))), "block 0 is damaged"),
        (damaged(lambda c: c.__delitem__(slice(-100, None))), "cut off"),
        (damaged(lambda c: c.__setitem__(slice(BLOCK, BLOCK + 4), b"abcd")), "block 1 is damaged"),
        (damaged(lambda c: c.__setitem__(slice(28, 32), b"abcd")), "another chip"),
        (damaged(lambda c: c.__setitem__(slice(12, 16), bytes(4))), "where it belongs"),
        (damaged(lambda c: c.__setitem__(slice(0, 8), b":0000000")), "is not a UF2 file"),
        (damaged(lambda c: c.__setitem__(len(c) - BLOCK + 40, 77)), "boot stage"),
        (lambda path: pico.write_uf2(path, program(stack=0x10000000)), "vectors"),
        (lambda path: pico.write_uf2(path, program(reset=0x20000001)), "vectors"),
        (lambda path: pico.write_uf2(path, program(reset=0x100001F6)), "vectors"),
        (lambda path: pico.write_uf2(path, program()[:1024]), "not a thigmo image"),
        (lambda path: pico.write_uf2(path, program() + bytes(pico.STORE_AT)), "bytes"),
        (lambda path: path.unlink(), "cannot read"),
    ],
)
def test_a_damaged_image_is_refused_and_nothing_is_written(
    uf2: Path, drive: Path, damage: Callable[[Path], None], says: str
) -> None:
    damage(uf2)
    with pytest.raises(ConfigError, match=says):
        pico.flash_pico(str(drive), uf2)
    assert not (drive / "thigmo.uf2").exists()


def test_an_image_of_another_schema_is_refused(uf2: Path, drive: Path) -> None:
    pico.write_uf2(uf2, program(schema=wire.SCHEMA_HASH ^ 1))
    with pytest.raises(SchemaMismatchError, match="speaks schema"):
        pico.flash_pico(str(drive), uf2)


def test_the_command_writes_the_image_to_the_drive_that_it_finds(
    uf2: Path, drive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pico, "_mounted", lambda: [drive.parent, drive])
    done = CliRunner().invoke(app, ["flash", "--robot", "pico", "--image", str(uf2)])
    assert done.exit_code == 0, done.output
    assert "the Pico starts" in done.output
    assert (drive / "thigmo.uf2").read_bytes() == uf2.read_bytes()


def test_no_drive_or_two_are_told(drive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pico, "_mounted", lambda: [drive.parent])
    with pytest.raises(PortError, match="no drive RPI-RP2"):
        pico.find_drive()
    monkeypatch.setattr(pico, "_mounted", lambda: [drive, drive])
    with pytest.raises(PortError, match="2 boards' drives are mounted"):
        pico.find_drive()


def test_another_boards_drive_is_refused(uf2: Path, drive: Path) -> None:
    (drive / "INFO_UF2.TXT").write_text(INFO.replace("RPI-RP2", "RP2350"))
    with pytest.raises(NotARobotError, match="Board-ID: RP2350"):
        pico.flash_pico(str(drive), uf2)
    (drive / "INFO_UF2.TXT").unlink()
    with pytest.raises(NotARobotError, match="is not the drive of a Pico"):
        pico.flash_pico(str(drive), uf2)
    with pytest.raises(PortError, match="no folder"):
        pico.flash_pico(str(drive / "gone"), uf2)


@pytest.mark.parametrize("gone", [True, False])
def test_a_drive_that_goes_away_when_all_is_written_is_a_board_that_starts(
    uf2: Path, drive: Path, monkeypatch: pytest.MonkeyPatch, gone: bool
) -> None:
    def restart(_: int) -> None:
        if gone:
            (drive / "INFO_UF2.TXT").unlink()
        raise OSError(5, "Input/output error")

    monkeypatch.setattr("os.fsync", restart)
    if gone:
        pico.flash_pico(str(drive), uf2)
        return
    with pytest.raises(LinkError, match="Input/output error"):
        pico.flash_pico(str(drive), uf2)


def test_an_installation_without_sources_flashes_the_image_that_came_with_it(
    tmp_path: Path, uf2: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pico, "ROOT", tmp_path)
    monkeypatch.setattr(pico, "PACKAGED", tmp_path / "gone.uf2")
    with pytest.raises(PortError, match="no image for a Pico"):
        pico.build_uf2()
    monkeypatch.setattr(pico, "PACKAGED", uf2)
    assert pico.build_uf2() == uf2
