"""A Raspberry Pi Pico in simulation (rp2040.mjs) with the image that `thigmo flash` writes."""

from __future__ import annotations

import json
import shutil
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from thigmo.emulator.micropython_build import BUILD
from thigmo.link.pico import build_uf2

# Of the npm registry; it brings no boot ROM.
RP2040JS = "rp2040js@1.4.1"
TOOLS = ("arm-none-eabi-g++", "cmake", "make", "apt-get", "dpkg-deb", "node", "npm")
AIR, BODY, ENABLE, BRAKE = 6, 7, 12, 13
FULL = 800


def missing() -> str:
    """What keeps the image from being built and run here; empty when nothing does."""
    absent = [tool for tool in TOOLS if shutil.which(tool) is None]
    return f"the Pico's image needs {', '.join(absent)}" if absent else ""


@cache
def library() -> Path:
    """The simulator of the chip, fetched once."""
    folder = BUILD / RP2040JS
    if not (folder / "package" / "dist").exists():
        folder.mkdir(parents=True, exist_ok=True)
        subprocess.run(
            ["npm", "pack", "--silent", RP2040JS], cwd=folder, check=True, stdout=subprocess.DEVNULL
        )
        (archive,) = folder.glob("*.tgz")
        subprocess.run(["tar", "-xzf", archive.name], cwd=folder, check=True)
    return folder / "package"


class Pico:
    """The chip: both cores, its converters and its USB prompt, as the emulator's `EmulatedBoard`.

    Time passes only in `step`.
    """

    def __init__(self, image: Path | None = None) -> None:
        self._process = subprocess.Popen(
            ["node", Path(__file__).with_name("rp2040.mjs"), library(), image or build_uf2()],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._answers: dict[str, Any] = {"estop": False, "counts": [0] * 12}
        self._sent = bytearray()
        self._received = bytearray()
        self._toggled = [0.0] * 30  # when each pin last moved, ms
        self._now_ms = 0.0
        self._origin: float | None = None
        self.console = ""
        self.eeprom = b""
        self.said: dict[str, Any] = {}
        self._advance(0)

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()

    def step(self, ticks: int) -> None:
        self._advance(ticks)

    def _advance(self, milliseconds: float, **answer: object) -> None:
        message = self._answers | answer | {"link": self._sent.hex(), "run_us": milliseconds * 1000}
        self._sent.clear()
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(message) + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            raise ConnectionError(f"the simulation has ended: {self._process.communicate()[1]}")
        self.said = json.loads(line)
        self._now_ms += milliseconds
        for pin, edges in enumerate(self.said["toggles"]):
            if edges:
                self._toggled[pin] = self._now_ms
        self._received += bytes.fromhex(self.said["link"])
        self.console += self.said["console"]

    def type(self, keys: str) -> None:
        """Type at Python's prompt, over USB."""
        self._advance(0, keys=keys)

    def interrupt(self) -> None:
        """Ctrl-C until Python's prompt is there; what is typed before USB is connected is lost."""
        for _ in range(20):
            if ">>> " in self.console:
                return
            self._advance(50, keys="\x03")
        raise AssertionError(f"no prompt in {self.console!r}")

    def until(self, text: str, limit_ms: int = 4000) -> None:
        """Let time pass until Python has printed something."""
        for _ in range(limit_ms // 10):
            if text in self.console:
                return
            self._advance(10)
        raise AssertionError(f"no {text!r} in {self.console!r}")

    @property
    def boots(self) -> int:
        """How often the chip has started."""
        return int(self.said["boots"])

    @property
    def fetched(self) -> list[int]:
        """Addresses in flash that the controller's core has touched."""
        return list(self.said["fetched"])

    # --- the emulator's board ---------------------------------------------------------------------
    @property
    def now_us(self) -> int:
        """Time since the start."""
        return round(self._now_ms * 1000)

    def write(self, data: bytes) -> None:
        self._sent += data

    def read(self) -> bytes:
        data = bytes(self._received)
        self._received.clear()
        return data

    def set_analog(self, counts: npt.NDArray[np.float64]) -> None:
        """Ideal counts in 1/1024 of the reference, shape (16, 2)."""
        self._answers["counts"] = [int(4 * c) for c in counts[:12, 1]]

    def set_adc_noise(self, sigma: npt.NDArray[np.float64]) -> None:
        """Not simulated: these converters have none."""

    def set_encoder(self, start: float, end: float) -> None:
        if self._origin is None:
            self._origin = start
        self._answers["encoder"] = int(end - self._origin)

    def set_supply_mv(self, millivolt: int) -> None:
        """Not simulated: 5 V."""

    def set_estop(self, pressed: bool) -> None:
        self._answers["estop"] = pressed

    def set_motor_power(self, on: bool) -> None:
        self._answers["motor_power"] = on

    @property
    def drive(self) -> tuple[int, int]:
        left, right = (max(round(1600 * pin), 0) for pin in self.said["pins"][2:4])
        return left, right

    @property
    def drive_enabled(self) -> tuple[bool, bool]:
        left, right = self.drive
        return left > 0, right > 0

    @property
    def motor(self) -> int:
        share, direction = self.said["pins"][4:6]
        duty = round(FULL * max(float(share), 0.0))
        return duty if direction > 0 else -duty

    @property
    def braked(self) -> bool:
        """The driver brakes while its PWM input is low."""
        return self.motor == 0

    def _held(self, pin: int, hold_ms: float) -> bool:
        return self._toggled[pin] > 0 and self._now_ms - self._toggled[pin] < hold_ms

    @property
    def air(self) -> tuple[bool, bool]:
        """Whether the air enables of muscles and body are held on by edges."""
        return self._held(AIR, 60.0), self._held(BODY, 60.0)

    @property
    def motor_enables(self) -> tuple[bool, bool]:
        """Whether those of the motor's supply and the brake are."""
        return self._held(ENABLE, 30.0), self._held(BRAKE, 30.0)

    def cut_power_after(self, n_bytes: int) -> None:
        """Not simulated; tests/unit/firmware/flash_store_cases.h cuts at every byte."""
        raise NotImplementedError

    def reset(self, cause: int) -> None:
        """Not simulated."""
        raise NotImplementedError

    def hang(self) -> None:
        """Not simulated: the image has no such switch."""
        raise NotImplementedError
