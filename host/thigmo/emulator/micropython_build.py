"""Builds MicroPython with the controller in it, from firmware/micropython.

The sources come from Debian's packages and the images go to build/micropython, so only a checkout
(not a bare installation of the Python package) can build them. Nothing is built that is up to date.
"""

from __future__ import annotations

import shutil
from functools import cache
from pathlib import Path

from thigmo.errors import PortError
from thigmo.link.image import ROOT, make

SOURCES = ROOT / "firmware" / "micropython"
BUILD = ROOT / "build" / "micropython"
IMAGES = {
    "unix": BUILD / "unix" / "micropython",
    "unix-large": BUILD / "unix-large" / "micropython",
    "cortex-m3": BUILD / "cortex-m3" / "firmware.elf",
}
_TOOLS = {
    "unix": ("make", "gcc", "g++", "python3", "apt-get", "tar", "xz"),
    "unix-large": (),
    "cortex-m3": ("arm-none-eabi-g++", "qemu-system-arm"),
}


def missing(kind: str) -> str:
    """The reason why an image cannot be built and run here, as text; empty if it can."""
    if not (SOURCES / "Makefile").exists():
        return "MicroPython with the controller is built in a source checkout only"
    needed = {*_TOOLS["unix"], *_TOOLS[kind]}
    absent = sorted(tool for tool in needed if shutil.which(tool) is None)
    return f"MicroPython for {kind} needs {', '.join(absent)}" if absent else ""


@cache
def image(kind: str) -> Path:
    """The image of a kind: unix, unix-large or cortex-m3; PortError if it cannot be built here."""
    if reason := missing(kind):
        build = f"`make -C firmware/micropython {kind}`"
        raise PortError(
            reason, f"install that, run {build} in a source checkout, or use emulator://"
        )
    return make(SOURCES, IMAGES[kind], f"BUILD={BUILD}", kind)
