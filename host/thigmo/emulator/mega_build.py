"""Builds what the simulated Mega needs: the firmware image and the bridge to libsimavr.

Both come from the source tree by its own Makefiles, so only a checkout (not a bare installation of
the Python package) can open mega-sim:// URLs. Nothing is built that is up to date.
"""

from __future__ import annotations

import shutil
import subprocess
from functools import cache
from pathlib import Path

from thigmo.errors import PortError

ROOT = Path(__file__).resolve().parents[3]
BUILD = ROOT / "build" / "mega"
BOOT_LOADER = Path(
    "/usr/share/arduino/hardware/arduino/avr/bootloaders/stk500v2/stk500boot_v2_mega2560.hex"
)
PACKAGES = "gcc-avr avr-libc binutils-avr libsimavr-dev libelf-dev make gcc"


def missing() -> str:
    """What keeps the simulated Mega from running here, in words; empty when nothing does."""
    if not (ROOT / "firmware" / "mega" / "sim" / "Makefile").exists():
        return "this installation has no firmware sources"
    absent = [tool for tool in ("make", "cc", "avr-g++") if shutil.which(tool) is None]
    if not Path("/usr/include/simavr/sim_avr.h").exists():
        absent.append("libsimavr-dev")
    return f"not installed: {', '.join(absent)}" if absent else ""


def _make(folder: Path, target: Path, *settings: str) -> Path:
    reason = missing()
    if reason:
        raise PortError(
            f"the simulated Mega cannot run here: {reason}",
            f"install {PACKAGES} and work in a source checkout, or use emulator://",
        )
    result = subprocess.run(
        ["make", "-s", "-C", str(folder), f"BUILD={BUILD}", *settings],
        capture_output=True,
        text=True,
        check=False,
    )
    if result.returncode or not target.exists():
        lines = (result.stderr or result.stdout).strip().splitlines() or ["no message"]
        raise PortError(
            f"building {target.name} failed: {lines[0]}", f"run `make -C {folder}` and mend it"
        )
    return target


@cache
def bridge_library() -> Path:
    """The bridge's shared library, built if need be.

    Raises:
        PortError: a tool is missing, or the build failed.
    """
    return _make(ROOT / "firmware" / "mega" / "sim", BUILD / "libmega_bridge.so")


@cache
def firmware_hex(baud: int = 250_000) -> Path:
    """The firmware image (Intel HEX), built if need be.

    Args:
        baud: rate that it speaks; 250 000 or 500 000.

    Raises:
        PortError: a tool is missing, or the build failed.
    """
    name = "thigmo.hex" if baud == 250_000 else f"thigmo-{baud}.hex"
    return _make(ROOT / "firmware" / "mega", BUILD / name, f"BAUD={baud}")


def read_hex(path: Path) -> list[tuple[int, bytes]]:
    """Blocks of an Intel HEX file: (address, bytes), in the file's order, merged where they meet.

    Raises:
        ValueError: malformed record or wrong checksum.
    """
    blocks: list[tuple[int, bytearray]] = []
    base = 0
    for number, line in enumerate(path.read_text().split(), 1):
        if not line.startswith(":"):
            raise ValueError(f"{path}:{number}: not an Intel HEX record")
        record = bytes.fromhex(line[1:])
        if len(record) != record[0] + 5 or sum(record) & 255:
            raise ValueError(f"{path}:{number}: damaged record")
        address, kind, data = int.from_bytes(record[1:3], "big"), record[3], record[4:-1]
        if kind == 0:
            start = base + address
            if blocks and blocks[-1][0] + len(blocks[-1][1]) == start:
                blocks[-1][1].extend(data)
            else:
                blocks.append((start, bytearray(data)))
        elif kind == 1:
            break
        elif kind == 2:
            base = int.from_bytes(data, "big") << 4
        elif kind == 4:
            base = int.from_bytes(data, "big") << 16
    return [(start, bytes(data)) for start, data in blocks]
