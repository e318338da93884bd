"""Builds what the simulated Mega needs: the bridge to libsimavr, and the firmware image.

Both come from the source tree by its own Makefiles, so only a checkout (not a bare installation of
the Python package) can open mega-sim:// URLs. Nothing is built that is up to date.
"""

from __future__ import annotations

import shutil
from functools import cache
from pathlib import Path

from thigmo.errors import PortError
from thigmo.link.image import BUILD, ROOT, build_image, make

BOOT_LOADER = Path(
    "/usr/share/arduino/hardware/arduino/avr/bootloaders/stk500v2/stk500boot_v2_mega2560.hex"
)
PACKAGES = "gcc-avr avr-libc binutils-avr libsimavr-dev libelf-dev make gcc"
BRIDGE = ROOT / "firmware" / "mega" / "sim"


def missing() -> str:
    """The reason why the simulated Mega cannot run here, as text; empty if it can."""
    if not (BRIDGE / "Makefile").exists():
        return "it links to libsimavr (GPL) and is built in a source checkout only"
    absent = [tool for tool in ("make", "cc", "avr-g++") if shutil.which(tool) is None]
    if not Path("/usr/include/simavr/sim_avr.h").exists():
        absent.append("libsimavr-dev")
    return f"not installed: {', '.join(absent)}" if absent else ""


def _require() -> None:
    """Raises PortError where the simulated Mega cannot run, as do those below."""
    if reason := missing():
        raise PortError(
            f"the simulated Mega cannot run here: {reason}",
            f"install {PACKAGES} and work in a source checkout, or use emulator://",
        )


def bridge_library() -> Path:
    """The bridge's shared library."""
    _require()
    return make(BRIDGE, BUILD / "libmega_bridge.so")


@cache
def firmware_hex(baud: int = 250_000) -> Path:
    """The firmware image (Intel HEX) that speaks 250 000 or 500 000 baud."""
    _require()
    return build_image(baud)


def firmware_elf() -> Path:
    """The linked program that the image was made from, with its symbols."""
    return firmware_hex().with_suffix(".elf")
