"""The skeleton binding (firmware/skeleton) on QEMU's MPS2, as the emulator's `Board`."""

from __future__ import annotations

import shutil
import socket
import subprocess
from functools import cache
from pathlib import Path

from thigmo.emulator.micropython import MicroPythonBoard
from thigmo.link.image import ROOT, make

TOOLS = ("make", "arm-none-eabi-g++", "qemu-system-arm")
BUILD = ROOT / "build" / "skeleton"


def missing() -> str:
    """What keeps it from being built and run here; empty when nothing does."""
    absent = [tool for tool in TOOLS if shutil.which(tool) is None]
    return f"the skeleton needs {', '.join(absent)}" if absent else ""


@cache
def image() -> Path:
    """The image, built if it is not up to date."""
    return make(ROOT / "firmware" / "skeleton", BUILD / "skeleton.elf", f"BUILD={BUILD}")


class Skeleton(MicroPythonBoard):
    """A Cortex-M3 with neither Python nor an operating system; its hardware is injected alike."""

    def _built(self, kind: str) -> Path:
        return image()

    def _launch(self, its: socket.socket) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [
                "qemu-system-arm", "-machine", "mps2-an385", "-nodefaults", "-display", "none",
                "-kernel", self._image, "-serial", "null",
                "-chardev", f"socket,id=hardware,fd={its.fileno()}", "-serial", "chardev:hardware",
            ],
            pass_fds=(its.fileno(),), stdin=subprocess.DEVNULL,
            stdout=self._console, stderr=subprocess.STDOUT,
        )  # fmt: skip
