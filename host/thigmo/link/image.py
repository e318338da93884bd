"""Firmware images: reading Intel HEX, and what an image says it is.

The image carries a signature (firmware/mega/signature.h), so that an image of another schema is
refused before it is written, not by the hello afterwards.
"""

from __future__ import annotations

import shutil
import struct
import subprocess
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from thigmo.errors import ConfigError, PortError

ROOT = Path(__file__).resolve().parents[3]
BUILD = ROOT / "build" / "mega"
PACKAGED = Path(__file__).parents[1] / "firmware" / "thigmo.hex"  # in a wheel
MAGIC = b"thigmo-image"
_SIGNATURE = struct.Struct("<IB")  # then board and version
LARGEST = 253_952  # bytes below the Mega's boot loader


@dataclass(frozen=True, slots=True)
class Image:
    """A firmware image and what its signature says."""

    path: Path  # the Intel HEX file
    size: int  # bytes of program
    schema_hash: int  # of the messages that it speaks
    protocol: int  # their version


def read_hex(path: Path) -> list[tuple[int, bytes]]:
    """Blocks of an Intel HEX file, merged where they meet: (address, bytes), in its order."""
    try:
        lines = path.read_text(encoding="ascii").split()
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}", "check the path") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path} is no Intel HEX file", "give the .hex of a build") from error
    blocks: list[tuple[int, bytearray]] = []
    base = 0
    for number, line in enumerate(lines, 1):
        try:
            record = bytes.fromhex(line[1:]) if line.startswith(":") else b""
        except ValueError:
            record = b""
        if len(record) < 5 or len(record) != record[0] + 5 or sum(record) & 255:
            raise ConfigError(f"{path}:{number} is damaged", "build the image again")
        address, kind, data = int.from_bytes(record[1:3], "big"), record[3], record[4:-1]
        if kind == 0:
            start = base + address
            if blocks and blocks[-1][0] + len(blocks[-1][1]) == start:
                blocks[-1][1].extend(data)
            else:
                blocks.append((start, bytearray(data)))
        elif kind == 1:
            break
        elif kind in (2, 4):
            base = int.from_bytes(data, "big") << (4 if kind == 2 else 16)
    return [(start, bytes(data)) for start, data in blocks]


def read_image(path: Path) -> Image:
    """Read an image's signature; ConfigError if it is none, or too large for the board."""
    blocks = read_hex(path)
    end = max((start + len(data) for start, data in blocks), default=0)
    found = b"".join(data for _, data in blocks).partition(MAGIC)[2]
    if len(found) < _SIGNATURE.size:
        raise ConfigError(
            f"{path} is not a thigmo image", "build one with `make firmware` and flash that"
        )
    if end > LARGEST:
        raise ConfigError(
            f"{path} needs {end} bytes and the board has {LARGEST}", "build it with the Makefile"
        )
    return Image(path, sum(len(data) for _, data in blocks), *_SIGNATURE.unpack_from(found))


def build_image(baud: int = 250_000) -> Path:
    """The image of this source tree, built if need be, or the one that an installation has."""
    folder = ROOT / "firmware" / "mega"
    if not (folder / "Makefile").exists():
        if PACKAGED.exists() and baud == 250_000:
            return PACKAGED
        raise PortError(
            f"this installation has no firmware image of {baud} baud",
            "build it in a checkout with `make firmware`, and give it: --image FILE.hex",
        )
    for tool in ("make", "avr-g++"):
        if shutil.which(tool) is None:
            raise PortError(
                f"{tool} is not installed", "install gcc-avr and avr-libc, or give --image FILE.hex"
            )
    name = "thigmo.hex" if baud == 250_000 else f"thigmo-{baud}.hex"
    return make(folder, BUILD / name, f"BAUD={baud}")


def make(folder: Path, target: Path, *settings: str) -> Path:
    """Run a Makefile of the firmware; raises PortError with the first line of its failure."""
    BUILD.mkdir(parents=True, exist_ok=True)
    with (BUILD / ".lock").open("w") as lock:  # tests run beside each other
        with suppress(ImportError):  # not on Windows, where nobody builds twice at once
            import fcntl

            fcntl.flock(lock, fcntl.LOCK_EX)
        result = subprocess.run(
            ["make", "-s", "-C", str(folder), f"BUILD={BUILD}", *settings],
            capture_output=True,
            text=True,
            check=False,
        )
    if result.returncode or not target.exists():
        lines = (result.stderr or result.stdout).strip().splitlines() or ["no message"]
        raise PortError(
            f"building {target.name} failed: {lines[0]}",
            f"run `make -C {folder.relative_to(ROOT)}` and mend it",
        )
    return target
