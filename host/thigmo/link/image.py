"""Firmware images: Intel HEX, what an image says it is, and the CRC by which it starts.

The image carries a signature (firmware/mega/signature.h), so that an image of another schema is
refused before it is written, not by the hello afterwards.
"""

from __future__ import annotations

import shutil
import struct
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from thigmo.errors import ConfigError, PortError, SchemaMismatchError
from thigmo.files import DATA_BYTES, read_file
from thigmo.link import protocol as wire

ROOT = Path(__file__).resolve().parents[3]
BUILD = ROOT / "build" / "mega"
PACKAGED = Path(__file__).parents[1] / "firmware" / "thigmo.hex"  # in a wheel
MAGIC = b"thigmo-image"
_SIGNATURE = struct.Struct("<IB")  # then board and version
LARGEST = 253_952  # bytes below the Mega's boot loader
PAGE = 256  # bytes that the flash erases and writes at once
WATCHDOG_ENTRY = 0x20000  # firmware/mega/restart.h


@dataclass(frozen=True, slots=True)
class Image:
    """A firmware image and what its signature says."""

    path: Path  # the Intel HEX file, or for a Pico the UF2 file
    program: bytes
    schema_hash: int  # of the messages that it speaks
    protocol: int  # their version

    @classmethod
    def of(cls, path: Path, program: bytes, cure: str) -> Image:
        """An image by the signature in its program; ConfigError, with a cure, if there is none."""
        stated = program.partition(MAGIC)[2]
        if len(stated) < _SIGNATURE.size:
            raise ConfigError(f"{path} is not a thigmo image", cure)
        return cls(path, program, *_SIGNATURE.unpack_from(stated))

    def require_own_schema(self) -> None:
        """Raise SchemaMismatchError if this host could not talk to it."""
        if (self.schema_hash, self.protocol) != (wire.SCHEMA_HASH, wire.PROTOCOL):
            raise SchemaMismatchError(
                f"{self.path.name} speaks schema {self.schema_hash:08x} and this host"
                f" {wire.SCHEMA_HASH:08x}",
                "build the image from this host's sources, or install the thigmo that it came with",
            )


def read_hex(path: Path) -> list[tuple[int, bytes]]:
    """Blocks of an Intel HEX file, merged where they meet: (address, bytes), in its order."""
    try:
        lines = read_file(path, DATA_BYTES).decode("ascii").split()
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}", "check the path") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path} is not an Intel HEX file", "give the .hex of a build") from error
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


def write_hex(path: Path, blocks: list[tuple[int, bytes]]) -> Path:
    """Write blocks as an Intel HEX file; returns its path."""

    def record(kind: int, address: int, data: bytes) -> str:
        content = bytes([len(data), *(address & 0xFFFF).to_bytes(2, "big"), kind]) + data
        return f":{content.hex()}{-sum(content) & 255:02x}".upper()

    lines = []
    for start, data in blocks:
        row_address, end = start, start + len(data)
        while row_address < end:
            row_end = min(end, (row_address // 16 + 1) * 16)
            if row_address == start or row_address % 0x10000 == 0:
                lines.append(record(4, 0, (row_address >> 16).to_bytes(2, "big")))
            lines.append(record(0, row_address, data[row_address - start : row_end - start]))
            row_address = row_end
    path.write_text("\n".join([*lines, record(1, 0, b""), ""]), encoding="ascii")
    return path


def crc32(data: bytes, polynomial: int) -> int:
    """CRC-32 of bytes, the most significant bit first, begun with ones."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte << 24
        for _ in range(8):
            crc = (crc << 1 ^ (polynomial if crc >> 31 else 0)) & 0xFFFFFFFF
    return crc


def seal(blocks: list[tuple[int, bytes]]) -> list[tuple[int, bytes]]:
    """Put guard.h's CRC-32 behind a program: over its entry, then itself.

    The program is the block at 0, the entry after a watchdog's reset the one at `WATCHDOG_ENTRY`.
    """
    parts = dict(blocks)
    if sorted(parts) != [0, WATCHDOG_ENTRY]:
        starts = ", ".join(f"{start:#x}" for start in sorted(parts))
        raise ConfigError(
            f"the program lies at {starts}, not at 0 and {WATCHDOG_ENTRY:#x}",
            "link it as firmware/mega/Makefile does",
        )
    crc = crc32(parts[WATCHDOG_ENTRY] + parts[0], 0xAF)
    return [(0, parts[0] + crc.to_bytes(4, "big")), (WATCHDOG_ENTRY, parts[WATCHDOG_ENTRY])]


def read_image(path: Path) -> Image:
    """Read an image's signature; ConfigError if it is none, or too large for the board."""
    blocks = read_hex(path)
    end = max((start + len(data) for start, data in blocks), default=0)
    program = b"".join(data for _, data in blocks)
    image = Image.of(path, program, "build one with `make firmware` and flash that")
    if end > LARGEST:
        raise ConfigError(
            f"{path} needs {end} bytes and the board has {LARGEST}", "build it with the Makefile"
        )
    return image


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
    """Run a Makefile of the firmware; raises PortError with the first error that it prints."""
    BUILD.mkdir(parents=True, exist_ok=True)
    command = ["make", "-s", "-C", str(folder), f"BUILD={BUILD}", f"PYTHON={sys.executable}"]
    with (BUILD / ".lock").open("w") as lock:  # tests run beside each other
        with suppress(ImportError):  # not on Windows, where nobody builds twice at once
            import fcntl

            fcntl.flock(lock, fcntl.LOCK_EX)
        result = subprocess.run(
            [*command, *settings], capture_output=True, text=True, errors="replace", check=False,
            stdin=subprocess.DEVNULL,
        )  # fmt: skip
    if result.returncode or not target.exists():
        messages = [line for line in (result.stderr + result.stdout).splitlines() if line.strip()]
        problem = next((line for line in messages if "rror" in line), "no message")
        raise PortError(
            f"building {target.name} failed: {problem.strip()}",
            f"run `make -C {folder.relative_to(ROOT)}` and correct what it names",
        )
    return target
