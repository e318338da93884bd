"""The simulated ATmega2560: a typed view of the bridge in firmware/mega/sim.

One `Chip` is one microcontroller on libsimavr, stepped to absolute cycle targets: deterministic,
16 million cycles a second of device time. `mega_sim.SimulatedMega` makes the robot's board of it;
tests and tools/budgets.py use it directly.
"""

from __future__ import annotations

import ctypes
from ctypes import POINTER, byref, c_bool, c_char, c_char_p, c_double, c_int, c_int64
from ctypes import c_uint16 as u16
from ctypes import c_uint32 as u32
from ctypes import c_uint64 as u64
from ctypes import c_void_p as handle
from dataclasses import dataclass
from enum import IntFlag
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

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

    _fields_ = [(name, u64) for name in ("count", "total", "longest", "shortest", "waited")]

    @property
    def mean(self) -> float:
        """Mean cost; 0 where there was none."""
        return float(self.total / max(self.count, 1))


@dataclass(frozen=True, slots=True)
class Pwm:
    """A 16-bit timer's outputs: which of them reach their pins, compare values, top."""

    connected: tuple[bool, ...]
    compare: tuple[int, ...]
    top: int
    period_cycles: int


@dataclass(frozen=True, slots=True)
class Port:
    """A digital port's registers."""

    ddr: int
    port: int

    def output(self, bit: int) -> bool | None:
        """Level that the chip drives, or None when the pin is an input."""
        return bool(self.port >> bit & 1) if self.ddr >> bit & 1 else None


class _Pwm(ctypes.Structure):
    _fields_ = [
        ("connected", c_bool * 3),
        ("inverted", c_bool * 3),
        ("compare", u16 * 3),
        ("top", u16),
        ("period", u32),
    ]


MARK = np.dtype({"names": ["cycle", "reg", "value"], "formats": ["<u8", "u1", "u1"],
                 "offsets": [0, 8, 9], "itemsize": 16})  # fmt: skip
"""A write to a general-purpose register 0..2: when, which, what."""

CONVERSION = np.dtype(
    {
        "names": ["sampled", "tick", "count", "channel"],
        "formats": ["<u8", "<u4", "<u2", "u1"],
        "offsets": [0, 8, 12, 14],
        "itemsize": 16,
    }
)
"""An analog conversion: cycle of the sample, tick of timer 1, count, channel (30 = bandgap)."""


@cache
def _library(path: Path) -> ctypes.CDLL:
    library = ctypes.CDLL(str(path))
    signatures: dict[str, tuple[Any, list[Any]]] = {
        "new": (handle, []),
        "free": (None, [handle]),
        **{
            f"{memory}_{way}": (None, [handle, u32, c_char_p, u32])
            for memory in _SIZES
            for way in ("write", "read")
        },
        "boot_at": (None, [handle, u32]),
        "reset": (None, [handle, c_int, u64]),
        "hang": (c_int, [handle, c_int]),
        "run": (c_int, [handle, u64]),
        "cycle": (u64, [handle]),
        "asleep": (u64, [handle]),
        "resets": (u64, [handle, c_int]),
        "analog": (None, [handle, handle, handle, u64, u64]),
        "noise": (None, [handle, u64, handle]),
        "supply": (None, [handle, u32]),
        "trace_feed": (None, [handle, handle, u64, u64]),
        "trace_read": (u32, [handle, handle, u32]),
        "trace_record": (None, [handle, c_int]),
        "tick_origin": (u64, [handle]),
        "lost_triggers": (u32, [handle]),
        "pin": (None, [handle, c_char, c_int, c_int]),
        "port": (c_int, [handle, c_char]),
        "encoder": (None, [handle, c_char, c_int, c_int, c_double, c_double, u64, u64]),
        "pwm_read": (None, [handle, c_int, POINTER(_Pwm)]),
        "line_baud": (None, [handle, u32]),
        "line_send": (u32, [handle, c_char_p, u32]),
        "line_take": (u32, [handle, handle, handle, u32]),
        "line_backlog": (u32, [handle]),
        "line_overruns": (u64, [handle]),
        "line_clear": (None, [handle]),
        "line_cycles": (u32, [handle]),
        "eeprom_cut": (None, [handle, c_int64]),
        "power_is_cut": (c_int, [handle]),
        "eeprom_writes": (u64, [handle]),
        "interrupt_read": (None, [handle, c_int, POINTER(InterruptFigures)]),
        "measure_reset": (None, [handle]),
        "marks": (u32, [handle, handle, u32]),
        "marks_on": (None, [handle, c_int]),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(library, f"bridge_{name}")
        function.restype = result
        function.argtypes = arguments
    return library


def _doubles(values: ArrayLike) -> NDArray[np.float64]:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.shape != (CHANNELS,):
        raise ValueError(f"{CHANNELS} channels are needed, not shape {array.shape}")
    return array


class _Figure:
    """A number that the bridge tells, as an attribute of the chip."""

    def __init__(self, name: str) -> None:
        self._name = f"bridge_{name}"

    def __get__(self, chip: Chip, owner: type[Chip]) -> int:
        return int(getattr(chip._lib, self._name)(chip._chip))


class Chip:
    """One simulated ATmega2560 at 16 MHz, powered on with empty flash.

    Args:
        library: the bridge's shared library (see `mega_build.bridge_library`).
    """

    cycle = _Figure("cycle")
    """Cycles since the chip was made."""
    asleep_cycles = _Figure("asleep")
    """Cycles spent in sleep since the last `measure_again`."""
    tick_origin = _Figure("tick_origin")
    """Cycle at which tick 0 of timer 1 begins; 0 while that timer stands still."""
    lost_triggers = _Figure("lost_triggers")
    """Timer triggers that met a running conversion or an uncleared flag."""
    line_backlog = _Figure("line_backlog")
    """Queued bytes that have not reached the board yet."""
    line_overruns = _Figure("line_overruns")
    """Bytes that the board's USART lost because nobody read it in time."""
    line_byte_cycles = _Figure("line_cycles")
    """Cycles of one byte at the board's setting; 0 while the USART is off."""
    power_is_cut = _Figure("power_is_cut")
    """The power is off; a power-on reset brings it back."""
    eeprom_writes = _Figure("eeprom_writes")
    """EEPROM bytes whose write was started."""

    def __init__(self, library: Path) -> None:
        self._lib = _library(library)
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
    def write_flash(self, address: int, data: bytes) -> None:
        """Store program bytes."""
        self._store("flash", address, data)

    def read_flash(self, address: int, count: int) -> bytes:
        """Program bytes."""
        return self._load("flash", address, count)

    @property
    def eeprom(self) -> bytes:
        """All of the EEPROM."""
        return self._load("eeprom", 0, EEPROM_SIZE)

    @eeprom.setter
    def eeprom(self, data: bytes) -> None:
        self._store("eeprom", 0, data)

    def write_ram(self, address: int, data: bytes) -> None:
        """Store data-space bytes (no side effects of device registers)."""
        self._store("ram", address, data)

    def read_ram(self, address: int, count: int) -> bytes:
        """Data-space bytes (no side effects of device registers)."""
        return self._load("ram", address, count)

    def _store(self, memory: str, address: int, data: bytes) -> None:
        self._check(memory, address, len(data))
        getattr(self._lib, f"bridge_{memory}_write")(self._chip, address, data, len(data))

    def _load(self, memory: str, address: int, count: int) -> bytes:
        self._check(memory, address, count)
        buffer = ctypes.create_string_buffer(count)
        getattr(self._lib, f"bridge_{memory}_read")(self._chip, address, buffer, count)
        return buffer.raw

    @staticmethod
    def _check(memory: str, address: int, count: int) -> None:
        if address < 0 or address + count > _SIZES[memory]:
            raise ValueError(f"bytes {address}..{address + count} do not fit in {_SIZES[memory]}")

    # --- life -------------------------------------------------------------------------------------
    def boot_at(self, address: int) -> None:
        """Where execution starts after a reset: 0, or the boot loader's section."""
        self._lib.bridge_boot_at(self._chip, address)

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
        """Run on for so long."""
        return self.run(self.cycle + round(milliseconds * CYCLES_PER_MS))

    def resets(self, cause: Cause) -> int:
        """How often the chip restarted for that cause."""
        return int(self._lib.bridge_resets(self._chip, int(cause)))

    # --- analog -----------------------------------------------------------------------------------
    def analog(self, start: ArrayLike, end: ArrayLike, first: int, last: int) -> None:
        """Ideal counts (16 channels, 0..1024) at cycles `first` and `last`, linear in between."""
        a, b = _doubles(start), _doubles(end)
        self._lib.bridge_analog(self._chip, a.ctypes.data, b.ctypes.data, first, last)

    def noise(self, seed: int, sigma: ArrayLike) -> None:
        """Noise of conversions, in counts, per channel; a pure function of seed, tick, channel."""
        self._lib.bridge_noise(self._chip, seed & (2**64 - 1), _doubles(sigma).ctypes.data)

    def supply_mv(self, millivolt: int) -> None:
        """Supply voltage; below 2.7 V the chip is held in brown-out reset until it recovers."""
        self._lib.bridge_supply(self._chip, millivolt)

    def feed_trace(self, counts: NDArray[np.uint16], first_tick: int = 0) -> None:
        """Counts to deliver, shape (ticks, 16), `NO_COUNT` where the analog input is to be used."""
        table = np.ascontiguousarray(counts, dtype=np.uint16)
        if table.ndim != 2 or table.shape[1] != CHANNELS:
            raise ValueError(f"shape (ticks, {CHANNELS}) is needed, not {table.shape}")
        self._lib.bridge_trace_feed(self._chip, table.ctypes.data, first_tick, len(table))

    def record_trace(self, on: bool) -> None:
        """Record every conversion from now on."""
        self._lib.bridge_trace_record(self._chip, int(on))

    def take_trace(self) -> NDArray[np.void]:
        """Conversions recorded since the last call: array of `CONVERSION`."""
        return self._drain(self._lib.bridge_trace_read, CONVERSION)

    # --- pins -------------------------------------------------------------------------------------
    def drive_pin(self, port: str, bit: int, level: bool) -> None:
        """Set an input's level."""
        self._lib.bridge_pin(self._chip, port.encode(), bit, int(level))

    def port(self, letter: str) -> Port:
        """A port's registers."""
        state = self._lib.bridge_port(self._chip, letter.encode())
        return Port(ddr=state >> 8 & 255, port=state & 255)

    def encoder(
        self, pins: tuple[str, int, int], start: float, end: float, first: int, last: int
    ) -> None:
        """Quadrature edges of a count moving from `start` to `end` between two cycles.

        Args:
            pins: port letter, bit of A, bit of B.
            start: count (x4) at cycle `first`.
            end: count at cycle `last`.
            first: absolute cycle.
            last: absolute cycle.
        """
        port, a, b = pins
        self._lib.bridge_encoder(self._chip, port.encode(), a, b, start, end, first, last)

    def pwm(self, timer: int) -> Pwm:
        """Outputs of timer 1, 3, 4 or 5."""
        raw = _Pwm()
        self._lib.bridge_pwm_read(self._chip, timer, byref(raw))
        return Pwm(tuple(raw.connected), tuple(raw.compare), raw.top, raw.period)

    # --- wire of USART0 ---------------------------------------------------------------------------
    def line_baud(self, baud: int) -> None:
        """The host's rate; 0 = always the board's own."""
        self._lib.bridge_line_baud(self._chip, baud)

    def send(self, data: bytes) -> int:
        """Queue bytes for the board at the host's rate; returns how many found room."""
        return int(self._lib.bridge_line_send(self._chip, data, len(data)))

    def take(self) -> tuple[bytes, NDArray[np.uint64]]:
        """Bytes that the board has sent since the last call, and the cycle at which each ended."""
        count = self._lib.bridge_line_take(
            self._chip, self._bytes.ctypes.data, self._cycles.ctypes.data, len(self._bytes)
        )
        return self._bytes[:count].tobytes(), self._cycles[:count].copy()

    def line_clear(self) -> None:
        """Drop what waits on the wire, both ways."""
        self._lib.bridge_line_clear(self._chip)

    # --- EEPROM's power ---------------------------------------------------------------------------
    def cut_power_in_write(self, write: int | None) -> None:
        """Cut the power in the middle of the n-th EEPROM write from now; None: never."""
        self._lib.bridge_eeprom_cut(self._chip, -1 if write is None else write)

    # --- measurement ------------------------------------------------------------------------------
    def interrupt(self, vector: int) -> InterruptFigures:
        """Cost of an interrupt vector since the last `measure_again`."""
        raw = InterruptFigures()
        self._lib.bridge_interrupt_read(self._chip, vector, byref(raw))
        return raw

    def measure_again(self) -> None:
        """Forget interrupt figures, and sleep so far."""
        self._lib.bridge_measure_reset(self._chip)

    def record_marks(self, on: bool) -> None:
        """Record writes to GPIOR0..2 from now on."""
        self._lib.bridge_marks_on(self._chip, int(on))

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
