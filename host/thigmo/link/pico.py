"""Writes a firmware image to a Raspberry Pi Pico: UF2 files, and the drive of its boot ROM.

A Pico that is plugged in with BOOTSEL pressed shows a drive, RPI-RP2. A UF2 file that is copied
there is written to the flash block by block, and the program starts when the last block has come.
In our files the first page of the flash comes last: a copy that is cut leaves no program that could
start, and the boot ROM shows its drive again.
"""

from __future__ import annotations

import os
import string
import struct
import sys
from pathlib import Path

from thigmo.errors import ConfigError, LinkError, NotARobotError, PortError
from thigmo.files import DATA_BYTES, read_file
from thigmo.link.image import ROOT, Image, crc32, make

PICO = "pico"  # in place of a port: the drive is looked for
PACKAGED = Path(__file__).parents[1] / "firmware" / "thigmo-pico.uf2"  # in a wheel
FLASH = 0x10000000
PAGE = 256
STORE_AT = 640 * 1024  # the controller's store; above it Python's file system
_FAMILY = 0xE48BFF56  # of the RP2040
_FAMILY_GIVEN = 0x2000
_BLOCK = struct.Struct("<8I476sI")
_STARTS, _ENDS = (0x0A324655, 0x9E5D5157), 0x0AB16F30
_RAM = range(0x20000000, 0x20042000)
_INFO = "INFO_UF2.TXT"


def boot_check(program: bytes) -> int:
    """The check sequence that the boot ROM wants behind the first 252 bytes (RP2040, 2.8.1.3.1)."""
    return crc32(program[: PAGE - 4], 0x04C11DB7)


def write_uf2(path: Path, program: bytes) -> Path:
    """Write a program as a UF2 file, its first page last; returns the path."""
    pages = [
        program[start : start + PAGE].ljust(PAGE, b"\xff") for start in range(0, len(program), PAGE)
    ]
    order = [*range(1, len(pages)), 0]
    blocks = [
        _BLOCK.pack(
            *_STARTS, _FAMILY_GIVEN, FLASH + n * PAGE, PAGE, n, len(pages), _FAMILY, pages[n], _ENDS
        )
        for n in order
    ]
    path.write_bytes(b"".join(blocks))
    return path


def read_uf2(path: Path) -> Image:
    """Read and check a UF2 file: its blocks, boot stage, vectors and signature.

    The program is that from the start of the flash.

    Raises:
        ConfigError: it cannot be read, is no image for a Pico, or is damaged.
    """
    try:
        content = read_file(path, DATA_BYTES)
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}", "check the path") from error
    again = "build it again: `make -C firmware/micropython pico`"
    if len(content) < 2 * _BLOCK.size or content[:8] != struct.pack("<2I", *_STARTS):
        raise ConfigError(f"{path} is not a UF2 file", "give the .uf2 of a build")
    if len(content) % _BLOCK.size:
        raise ConfigError(f"{path} is cut off", again)
    pages: dict[int, bytes] = {}
    count = len(content) // _BLOCK.size
    for number, block in enumerate(_BLOCK.iter_unpack(content)):
        *starts, flags, address, size, index, total, family, data, ends = block
        if (*starts, ends) != (*_STARTS, _ENDS) or size != PAGE or total != count:
            raise ConfigError(f"{path}: block {number} is damaged", again)
        if not flags & _FAMILY_GIVEN or family != _FAMILY:
            raise ConfigError(f"{path} is for another chip", "give an image for the RP2040")
        # The boot ROM erases by the block's number: it must be that of the page.
        if address != FLASH + index * PAGE or index in pages or index >= count:
            raise ConfigError(f"{path}: block {number} is not where it belongs", again)
        pages[index] = data[:PAGE]
    program = b"".join(pages[n] for n in range(count))
    stack, reset = struct.unpack_from("<2I", program, PAGE)
    if struct.unpack_from("<I", program, PAGE - 4)[0] != boot_check(program):
        raise ConfigError(f"{path}: the boot stage's check sequence is wrong", again)
    in_flash = FLASH < reset < FLASH + len(program) and reset & 1
    if not _RAM.start < stack <= _RAM.stop or not in_flash:
        raise ConfigError(f"{path}: its vectors point nowhere", again)
    if len(program) > STORE_AT:
        raise ConfigError(f"{path} needs {len(program)} of {STORE_AT} bytes", again)
    return Image.of(path, program, again)


def build_uf2() -> Path:
    """The image of this source tree, built if need be, or the one that an installation has.

    Raises:
        PortError: there is none, or it cannot be built here.
    """
    folder = ROOT / "firmware" / "micropython"
    if (folder / "Makefile").exists():
        build = ROOT / "build" / "micropython"
        return make(folder, build / "pico" / "thigmo-pico.uf2", f"BUILD={build}", "pico")
    if PACKAGED.exists():
        return PACKAGED
    raise PortError(
        "this installation has no image for a Pico",
        "build it in a checkout with `make -C firmware/micropython pico`, and give it:"
        " --image FILE.uf2",
    )


def find_drive() -> Path:
    """The drive of the one Pico that waits for an image.

    Raises:
        PortError: none is found, or more than one.
    """
    drives = [folder for folder in _mounted() if _is_drive(folder)]
    if len(drives) > 1:
        raise PortError(
            f"{len(drives)} boards' drives are mounted: {', '.join(map(str, drives))}",
            "give one of them as --robot",
        )
    if not drives:
        raise PortError(
            "no drive RPI-RP2 is mounted",
            "hold BOOTSEL while you plug the Pico in and mount its drive, or give its folder as"
            " --robot",
        )
    return drives[0]


def _mounted() -> list[Path]:
    if sys.platform == "win32":
        return [Path(f"{letter}:/") for letter in string.ascii_uppercase]
    if sys.platform == "darwin":
        return sorted(Path("/Volumes").glob("*"))
    return sorted({*Path("/media").glob("*/*"), *Path("/run/media").glob("*/*"),
                   *Path("/media").glob("*"), *Path("/mnt").glob("*")})  # fmt: skip


def _is_drive(folder: Path) -> bool:
    try:
        return (folder / _INFO).is_file()
    except OSError:  # another user's, or a drive without a disk
        return False


def check_drive(folder: Path) -> None:
    """Refuse a folder that is not the drive of an RP2040's boot ROM.

    Raises:
        NotARobotError: it is another board's, or no board's.
        PortError: it is not there, or cannot be read.
    """
    if not folder.is_dir():
        raise PortError(f"there is no folder {folder}", "plug the Pico in with BOOTSEL pressed")
    try:
        info = (folder / _INFO).read_text(encoding="ascii", errors="replace")
    except FileNotFoundError as error:
        raise NotARobotError(
            f"{folder} is not the drive of a Pico: it has no {_INFO}",
            "plug the Pico in with BOOTSEL pressed and give the drive RPI-RP2",
        ) from error
    except OSError as error:
        raise PortError(
            f"cannot read {folder / _INFO}: {error.strerror}", "plug the Pico in again"
        ) from error
    if "Board-ID: RPI-RP2" not in info.splitlines():
        board = next((line for line in info.splitlines() if line.startswith("Board-ID")), "unknown")
        raise NotARobotError(
            f"{folder} is not the drive of an RP2040 ({board})", "connect a Raspberry Pi Pico"
        )


def flash_pico(robot: str, image: Path | None) -> Image:
    """Write an image to the drive of a Pico, which then starts it.

    `robot` is the drive's folder, or `PICO` to look for it; `image` None takes this source tree's.

    Raises:
        ConfigError: the image is none, or damaged.
        SchemaMismatchError: it speaks another schema than this host.
        LinkError: the drive is missing, is another's, or went away too early.
    """
    content = read_uf2(build_uf2() if image is None else image)
    content.require_own_schema()
    drive = find_drive() if robot == PICO else Path(robot)
    check_drive(drive)
    _copy(content.path.read_bytes(), drive)
    return content


def _copy(content: bytes, drive: Path) -> None:
    """Copy to the drive; the board starts, and its drive goes, when the last byte has come."""
    again = "plug the Pico in with BOOTSEL pressed and flash again: nothing starts by itself"
    complete = False
    try:
        with (drive / "thigmo.uf2").open("wb", buffering=0) as file:
            remaining = memoryview(content)
            while remaining:
                remaining = remaining[file.write(remaining) :]
            complete = True
            os.fsync(file.fileno())
    except OSError as error:
        # The board that has everything takes its drive away before it is closed.
        if complete and not _is_drive(drive):
            return
        raise LinkError(f"the image is not on {drive}: {error.strerror}", again) from error
