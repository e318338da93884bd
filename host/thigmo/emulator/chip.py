"""The simulated ATmega2560: a typed view of the bridge in firmware/mega/sim.

One `Chip` is one microcontroller on libsimavr, stepped to absolute cycle targets: deterministic,
16 million cycles a second of device time. `mega_sim.SimulatedMega` makes the robot's board of it;
tests and tools/budgets.py use it directly.
"""

from __future__ import annotations

import ctypes
import re
from ctypes import byref
from enum import IntFlag
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thigmo.emulator.mega_build import BRIDGE, bridge_library

CYCLES_PER_MS = 16_000
CHANNELS = 16
FLASH_SIZE = 0x40000
EEPROM_SIZE = 4096
SRAM_END = 0x21FF
NO_COUNT = 0xFFFF
_SIZES = {"flash": FLASH_SIZE, "eeprom": EEPROM_SIZE, "ram": SRAM_END + 1}


class Cause(IntFlag):
    """Reset causes, as the bits of MCUSR."""

    POWER_ON = 1
    EXTERNAL = 2
    BROWN_OUT = 4
    WATCHDOG = 8


class InterruptFigures(ctypes.Structure):
    """What one interrupt vector cost, in cycles from acceptance to the end of RETI.

    `waited` is the longest time from request to acceptance; `shortest` means nothing at a count
    of 0.
    """

    _fields_ = [
        (name, ctypes.c_uint64) for name in ("count", "total", "longest", "shortest", "waited")
    ]


class Pwm(ctypes.Structure):
    """A 16-bit timer's outputs A to C (which reach their pins, compare values), and its top."""

    _fields_ = [
        ("connected", ctypes.c_bool * 3), ("inverted", ctypes.c_bool * 3),
        ("compare", ctypes.c_uint16 * 3), ("top", ctypes.c_uint16),
        ("period_cycles", ctypes.c_uint32),
    ]  # fmt: skip


MARK = np.dtype([("cycle", "<u8"), ("reg", "u1"), ("value", "u1")], align=True)
"""A write to a general-purpose register 0..2: when, which, what."""

CONVERSION = np.dtype(
    [("sampled", "<u8"), ("tick", "<u4"), ("count", "<u2"), ("channel", "u1")], align=True
)
"""An analog conversion: cycle of the sample, tick of timer 1, count, channel (30 = bandgap)."""

# Whatever else the bridge takes or returns is a pointer.
_SCALARS = {
    "void": None, "char": ctypes.c_char, "int": ctypes.c_int, "double": ctypes.c_double,
    "uint32_t": ctypes.c_uint32, "int64_t": ctypes.c_int64, "uint64_t": ctypes.c_uint64,
}  # fmt: skip


@cache
def _library() -> ctypes.CDLL:
    """The bridge, its functions typed as its header declares them."""
    library = ctypes.CDLL(str(bridge_library()))
    header = (BRIDGE / "bridge.h").read_text()
    for result, name, arguments in re.findall(r"^(\S+) (bridge_\w+)\(([^)]*)\);", header, re.M):
        function = getattr(library, name)
        function.restype = _SCALARS.get(result, ctypes.c_void_p)
        kinds = [argument.strip().rpartition(" ")[0] for argument in arguments.split(",")]
        function.argtypes = [_SCALARS.get(kind, ctypes.c_void_p) for kind in kinds if kind]
    return library


def _doubles(values: ArrayLike) -> NDArray[np.float64]:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.shape != (CHANNELS,):
        raise ValueError(f"{CHANNELS} channels are needed, not shape {array.shape}")
    return array


def _figure(name: str) -> property:
    """A number that the bridge tells, as an attribute of the chip."""
    return property(lambda chip: getattr(chip._lib, f"bridge_{name}")(chip._chip))


def _function(name: str) -> property:
    """A function of the bridge, as a method of the chip."""
    return property(lambda chip: partial(getattr(chip._lib, f"bridge_{name}"), chip._chip))


class Chip:
    """A simulated ATmega2560 at 16 MHz, on, its flash empty; PortError if it cannot be built."""

    cycle = _figure("cycle")
    """Cycles since the chip was made."""
    pc = _figure("pc")
    """Byte address of the next instruction."""
    asleep_cycles = _figure("asleep")
    """Cycles spent in sleep since the last `measure_again`."""
    tick_origin = _figure("tick_origin")
    """Cycle at which tick 0 of timer 1 begins; 0 while that timer stands still."""
    lost_triggers = _figure("lost_triggers")
    """Timer triggers that met a running conversion or an uncleared flag."""
    line_backlog = _figure("line_backlog")
    """Queued bytes that have not reached the board yet."""
    line_overruns = _figure("line_overruns")
    """Bytes that the board's USART lost because nobody read it in time."""
    line_byte_cycles = _figure("line_cycles")
    """Cycles of one byte at the board's setting; 0 while the USART is off."""
    power_is_cut = _figure("power_is_cut")
    """The power is off; a power-on reset brings it back."""
    eeprom_writes = _figure("eeprom_writes")
    """EEPROM bytes whose write was started."""

    boot_at = _function("boot_at")
    """(address): where execution starts after a reset, 0 or the boot loader's section."""
    resets = _function("resets")
    """(cause): how often the chip restarted for it."""
    supply_mv = _function("supply")
    """(millivolt): below 2.7 V the chip is held in brown-out reset until the supply recovers."""
    record_trace = _function("trace_record")
    """(on): record every conversion from now on."""
    line_baud = _function("line_baud")
    """(baud): the host's rate; 0 = always the board's own."""
    line_clear = _function("line_clear")
    """Drop what waits on the wire, both ways."""
    measure_again = _function("measure_reset")
    """Forget interrupt figures, and sleep so far."""
    record_marks = _function("marks_on")
    """(on): record writes to GPIOR0..2 from now on."""

    def __init__(self) -> None:
        self._lib = _library()
        self._chip = self._lib.bridge_new()
        if not self._chip:
            raise MemoryError("the simulated chip could not be made")
        self._bytes = np.zeros(1 << 16, dtype=np.uint8)
        self._cycles = np.zeros(1 << 16, dtype=np.uint64)

    def __del__(self) -> None:
        if getattr(self, "_chip", None):
            self._lib.bridge_free(self._chip)
            self._chip = None

    # --- memories ---------------------------------------------------------------------------------
    def write(self, memory: str, address: int, data: bytes) -> None:
        """Store bytes in "flash", "eeprom" or "ram" (no side effects of device registers)."""
        self._check(memory, address, len(data))
        getattr(self._lib, f"bridge_{memory}_write")(self._chip, address, data, len(data))

    def read(self, memory: str, address: int, count: int) -> bytes:
        """Bytes of a memory (no side effects of device registers)."""
        self._check(memory, address, count)
        buffer = ctypes.create_string_buffer(count)
        getattr(self._lib, f"bridge_{memory}_read")(self._chip, address, buffer, count)
        return buffer.raw

    @property
    def eeprom(self) -> bytes:
        """All of the EEPROM."""
        return self.read("eeprom", 0, EEPROM_SIZE)

    @eeprom.setter
    def eeprom(self, data: bytes) -> None:
        self.write("eeprom", 0, data)

    @staticmethod
    def _check(memory: str, address: int, count: int) -> None:
        if address < 0 or address + count > _SIZES[memory]:
            raise ValueError(f"bytes {address}..{address + count} do not fit in {_SIZES[memory]}")

    # --- life -------------------------------------------------------------------------------------
    def reset(self, cause: Cause, filler: int = 0) -> None:
        """Restart the chip; power-on also fills SRAM with bytes made from `filler`."""
        self._lib.bridge_reset(self._chip, int(cause), filler)

    def hang(self, *, interrupts: bool = True) -> None:
        """Send the main program into an endless loop, with its interrupts running or not."""
        if self._lib.bridge_hang(self._chip, int(interrupts)):
            raise ValueError("this image holds no endless loop to send it to")

    def run(self, cycle: int) -> bool:
        """Run to an absolute cycle; False when the program died."""
        return not self._lib.bridge_run(self._chip, cycle)

    def run_ms(self, milliseconds: float) -> bool:
        """Run for a number of milliseconds."""
        return self.run(self.cycle + round(milliseconds * CYCLES_PER_MS))

    # --- analog -----------------------------------------------------------------------------------
    def analog(self, start: ArrayLike, end: ArrayLike, first: int, last: int) -> None:
        """Ideal counts (16 channels, 0..1024) at cycles `first` and `last`, linear in between."""
        a, b = _doubles(start), _doubles(end)
        self._lib.bridge_analog(self._chip, a.ctypes.data, b.ctypes.data, first, last)

    def noise(self, seed: int, sigma: ArrayLike) -> None:
        """Noise of conversions, in counts, per channel; a pure function of seed, tick, channel."""
        self._lib.bridge_noise(self._chip, seed & (2**64 - 1), _doubles(sigma).ctypes.data)

    def feed_trace(self, counts: NDArray[np.uint16], first_tick: int = 0) -> None:
        """Counts to deliver, shape (ticks, 16), `NO_COUNT` where the analog input is to be used."""
        table = np.ascontiguousarray(counts, dtype=np.uint16)
        if table.ndim != 2 or table.shape[1] != CHANNELS:
            raise ValueError(f"shape (ticks, {CHANNELS}) is needed, not {table.shape}")
        self._lib.bridge_trace_feed(self._chip, table.ctypes.data, first_tick, len(table))

    def take_trace(self) -> NDArray[np.void]:
        """Conversions recorded since the last call: array of `CONVERSION`."""
        return self._drain(self._lib.bridge_trace_read, CONVERSION)

    # --- pins -------------------------------------------------------------------------------------
    def drive_pin(self, port: str, bit: int, level: bool) -> None:
        """Set an input's level."""
        self._lib.bridge_pin(self._chip, port.encode(), bit, int(level))

    def output(self, port: str, bit: int) -> bool | None:
        """Level that the chip drives, or None when the pin is an input."""
        pins = self._lib.bridge_port(self._chip, port.encode())
        return bool(pins >> bit & 1) if pins >> (8 + bit) & 1 else None

    def encoder(
        self, pins: tuple[str, int, int], start: float, end: float, first: int, last: int
    ) -> None:
        """Quadrature edges of a count (x4) moving from `start` at cycle `first` to `end` at `last`.

        The pins are a port's letter, the bit of A, the bit of B.
        """
        port, a, b = pins
        self._lib.bridge_encoder(self._chip, port.encode(), a, b, start, end, first, last)

    def pwm(self, timer: int) -> Pwm:
        """Outputs of timer 1, 3, 4 or 5."""
        outputs = Pwm()
        self._lib.bridge_pwm_read(self._chip, timer, byref(outputs))
        return outputs

    # --- wire of USART0 ---------------------------------------------------------------------------
    def send(self, data: bytes) -> int:
        """Queue bytes for the board at the host's rate; returns how many found room."""
        return int(self._lib.bridge_line_send(self._chip, data, len(data)))

    def take(self) -> tuple[bytes, NDArray[np.uint64]]:
        """Bytes that the board has sent since the last call, and the cycle at which each ended."""
        count = self._lib.bridge_line_take(
            self._chip, self._bytes.ctypes.data, self._cycles.ctypes.data, len(self._bytes)
        )
        return self._bytes[:count].tobytes(), self._cycles[:count].copy()

    # --- EEPROM's power ---------------------------------------------------------------------------
    def cut_power_in_write(self, write: int | None) -> None:
        """Cut the power in the middle of the n-th EEPROM write from now; None: never."""
        self._lib.bridge_eeprom_cut(self._chip, -1 if write is None else write)

    # --- measurement ------------------------------------------------------------------------------
    def interrupt(self, vector: int) -> InterruptFigures:
        """Cost of an interrupt vector since the last `measure_again`."""
        figures = InterruptFigures()
        self._lib.bridge_interrupt_read(self._chip, vector, byref(figures))
        return figures

    def take_marks(self) -> NDArray[np.void]:
        """Marks since the last call: array of `MARK`."""
        return self._drain(self._lib.bridge_marks, MARK)

    def _drain(self, function: Any, dtype: np.dtype[Any]) -> NDArray[np.void]:
        parts = []
        while True:
            block: NDArray[np.void] = np.zeros(8192, dtype=dtype)
            count = function(self._chip, block.ctypes.data, len(block))
            parts.append(block[:count])
            if count < len(block):
                return np.concatenate(parts)
