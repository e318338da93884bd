"""The simulated Mega as tools/budgets.py and tools/soak.py measure it: wire, load, marks, stack."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt

from thigmo.emulator import mega_build
from thigmo.emulator.chip import CYCLES_PER_MS, SRAM_END, Cause
from thigmo.emulator.mega_sim import SimulatedMega
from thigmo.emulator.scene import Scene
from thigmo.link import protocol as wire
from thigmo.link.framing import Decoder

RAM = 8192
PAINT = 0xC5


@dataclass(frozen=True)
class Figure:
    """One measured figure.

    Attributes:
        name, value, unit: the figure and its value.
        limit: of the specification, if it sets one.
        least: whether the limit is the smallest allowed value, not the largest.
    """

    name: str
    value: float
    unit: str
    limit: float | None = None
    least: bool = False

    @property
    def within_limit(self) -> bool:
        """The limit is met."""
        if self.limit is None:
            return True
        return self.value >= self.limit if self.least else self.value <= self.limit

    @property
    def line(self) -> str:
        """For a table on the screen."""
        limit = "" if self.limit is None else f"{'>=' if self.least else '<='} {self.limit:g}"
        broken = "" if self.within_limit else "EXCEEDED"
        return f"{self.name:42} {self.value:>10g} {self.unit:8} {limit:10} {broken}".rstrip()

    @property
    def row(self) -> dict[str, object]:
        """For JSON, as tools/figures.py reads it."""
        return asdict(self) | {"value": float(self.value), "kept": bool(self.within_limit)}


class Rig(SimulatedMega):
    """A simulated Mega that notes when each byte leaves, and how busy each millisecond is."""

    def __init__(self, seed: int, eeprom: bytes = b"") -> None:
        super().__init__(seed, eeprom)
        self.wire: list[tuple[bytes, npt.NDArray[np.uint64]]] = []
        self.busy: list[int] = []
        self._marks: list[npt.NDArray[np.void]] = []
        self._take = self.chip.take
        self.chip.take = self._noting_take  # type: ignore[method-assign]

    def _noting_take(self) -> tuple[bytes, npt.NDArray[np.uint64]]:
        data, cycles = self._take()
        self.wire.append((data, cycles))
        return data, cycles

    def step(self, ticks: int) -> None:
        asleep = self.chip.asleep_cycles
        super().step(ticks)
        self.busy.append(ticks * CYCLES_PER_MS - (self.chip.asleep_cycles - asleep))
        self._marks.append(self.chip.take_marks())  # the bridge has room for some seconds of them

    def take_marks(self) -> npt.NDArray[np.void]:
        """Marks of tasks since the last call (`Chip.record_marks`)."""
        marks = np.concatenate([*self._marks, self.chip.take_marks()])
        self._marks.clear()
        return marks[marks["reg"] == 1]

    def forget_frames(self) -> None:
        """Drop the frames sent so far; of one that is under way, its first bytes are kept."""
        if not self.wire:
            return
        data, cycles = self._wire_bytes()
        partial_start = data.rfind(0) + 1
        self.wire = [(data[partial_start:], cycles[partial_start:])]

    def _wire_bytes(self) -> tuple[bytes, npt.NDArray[np.uint64]]:
        data, cycles = zip(*self.wire, strict=True)
        return b"".join(data), np.concatenate(cycles)

    def frames(self) -> list[tuple[wire.Message, int]]:
        """Messages sent so far, each with the cycle at which its last byte was on the wire."""
        data, cycles = self._wire_bytes()
        decoder, messages, start = Decoder(), [], 0
        for end in np.flatnonzero(np.frombuffer(data, np.uint8) == 0):
            decoded = decoder.feed(data[start : end + 1])
            messages.extend((frame.message(), int(cycles[end])) for frame in decoded)
            start = int(end) + 1
        return messages


def scene(*, pegs: bool = False) -> Scene:
    """The default robot, out to 51.5 cm and rested, in an empty room."""
    default = Scene.load("default")
    changes: dict[str, object] = {"start_length_cm": 51.5}
    if not pegs:
        changes["pegs"] = []
    return default.model_copy(update=changes)


def symbols() -> dict[str, int]:
    """Addresses in RAM by the linker's names."""
    listing = subprocess.run(
        ["avr-nm", str(mega_build.firmware_elf())], capture_output=True, text=True, check=True
    ).stdout
    return {
        p[2]: int(p[0], 16) & 0xFFFF for line in listing.splitlines() if len(p := line.split()) == 3
    }


def static_ram() -> int:
    """Bytes of RAM that the image takes before anything runs."""
    return sum(sections().get(name, 0) for name in (".data", ".bss", ".noinit"))


def sections() -> dict[str, int]:
    """Sizes of the image's sections, bytes."""
    size = subprocess.run(
        ["avr-size", "-A", str(mega_build.firmware_elf())],
        capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    return {name: int(count) for name, count in re.findall(r"^(\.\w+)\s+(\d+)", size, re.M)}


def painted_stack(rig: Rig) -> Callable[[], int]:
    """Paint a rig's free RAM and restart it; returns how deep the stack has gone since, in bytes.

    A figure as large as all free RAM says that something wrote from the other end.
    """
    rig.step(2)
    # Painted before the firmware starts: the boot loader's own stack is above and does not count.
    end = symbols()["_end"]
    chip = rig.chip
    chip.boot_at(0)
    chip.write("ram", end, bytes([PAINT]) * (SRAM_END + 1 - end))
    chip.reset(Cause.EXTERNAL)

    def depth() -> int:
        ram = np.frombuffer(chip.read("ram", end, SRAM_END + 1 - end), np.uint8)
        return len(ram) - int(np.flatnonzero(ram != PAINT)[0])

    return depth
