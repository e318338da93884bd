"""`micropython://SCENE`: the controller as a MicroPython module, inside the emulator.

`MicroPythonBoard` starts MicroPython's unix port, or QEMU's Cortex-M3 with `?on=cortex-m3`, runs
the robot's main.py there, and is that program's hardware: it injects conversions, encoder and the
line's bytes, and takes outputs, in lockstep (messages in firmware/micropython/thigmo_board).
"""

from __future__ import annotations

import os
import select
import socket
import struct
import subprocess
import tempfile
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from thigmo.emulator._board import Analog
from thigmo.emulator._large_board import Analog as LargeAnalog
from thigmo.emulator.board import require_usual
from thigmo.emulator.imu_bus import ImuBus, string_bus
from thigmo.emulator.micropython_build import image
from thigmo.emulator.transport import EmulatorTransport, parse_url
from thigmo.errors import PortError
from thigmo.link.framing import check_sequence
from thigmo.link.protocol import ResetCause
from thigmo.wiring import BOARD_SIZES, board_size

if TYPE_CHECKING:
    from pathlib import Path

    from thigmo.link.transport import Transport

Floats = npt.NDArray[np.float64]
Processor = Literal["unix", "cortex-m3"]

BOOT_MS = 840  # as the Mega's boot loader takes, so that runs on both can be compared
# Size of the core's store on the usual board and on the large one, bytes. The flash keeps an image
# of it in one of two sectors.
STORE_SIZE, _LARGE_STORE = 2048, 8192
_SECTORS = {STORE_SIZE: 4096, _LARGE_STORE: 3 * 4096}
_PAGE = 256
_START_S = 20.0  # of the wall clock, within which the program must have started
_MOST_TICKS = 10  # in one message
_LARGE_BITS = 16  # of the large board's counts, so that a turn keeps 0.1 mrad
_LARGE_FRAME_US = 320
_TRANSFER = struct.Struct("<IBBB21s")
_LATCHES = struct.Struct("<BIH")  # whether a stop is latched, its nonce; faults
_ERASURES = struct.Struct("<II")
_RUNS, _POWERED, _BITES, _OUT, _MUSCLE_AIR, _BODY_AIR, _MOTOR_SUPPLY, _BRAKE_OPEN = (
    1 << n for n in range(8)
)


def flash_of(store: bytes, size: int = STORE_SIZE) -> bytes:
    """The flash that holds a store's bytes: one image (firmware/micropython, flash_store.h)."""
    flash_size = 2 * _SECTORS[size]
    if not store:
        return b"\xff" * flash_size
    image = store[:size].ljust(size, b"\xff")
    header = struct.pack("<IH", 1, 0)
    header += struct.pack("<H", check_sequence(header))
    page = header.ljust(_PAGE // 2, b"\xff") * 2
    return (page + image).ljust(flash_size, b"\xff")


class MicroPythonBoard:
    """The controller under MicroPython, as the emulator's `EmulatedBoard`.

    Time passes only in `step`; a program that has ended keeps its outputs off and is silent.

    Args:
        seed: of the conversions' noise.
        store: the core's bytes, as `eeprom` gives them; the rest is blank.
        on: the processor that runs MicroPython.
        program: what Python runs; None: the robot's main.py.
        adc_bits: of the converter.
        frame_us: into a tick, when its conversions are complete.
        large: Whether it is built for more muscles and sensors, and for IMUs.
        attended: Whether this terminal is its prompt, for a person who starts the controller; no
            program is run then.

    Attributes:
        bus: Where it reads IMUs; set it before time passes. Only a large board asks it.
        direction: 1 pays out, -1 winds in.
        running: Whether the controller runs.
        powered: False after a power cut, until `reset`.
        ended: Whether the person has left the prompt.
    """

    bus: ImuBus | None = None

    def __init__(
        self,
        seed: int,
        store: bytes = b"",
        *,
        processor: Processor = "unix",
        program: str | None = None,
        adc_bits: int = 10,
        frame_us: int = 832,
        large: bool = False,
        attended: bool = False,
    ) -> None:
        self._program = program or "from main import board"
        self._attended = attended
        if large:
            adc_bits, frame_us = _LARGE_BITS, _LARGE_FRAME_US
        self._image = self._built("unix-large" if large else processor)
        self._processor: Processor = processor
        self._profile = (adc_bits, frame_us)
        self._passes = np.array(sorted({250, 500, 990, frame_us})) * 1e-3
        analog_kind = LargeAnalog if large else Analog
        self._analog = analog_kind(seed, adc_bits, frame_us)
        self._muscles = 4 if large else 2
        self._state = struct.Struct(f"<B{self._muscles + 1}hH")
        self._store_size = _LARGE_STORE if large else STORE_SIZE
        self._flash = flash_of(store, self._store_size)
        self._latches = bytes(_LATCHES.size)
        self._process: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None
        self._console = tempfile.TemporaryFile()  # noqa: SIM115 - as long as the board
        self._keys = -1  # where the unix port's prompt takes keys from
        self._host_bytes = bytearray()
        self._received = bytearray()
        self._supply_mv = 5000
        self._encoder_errors = 0
        self._estop = self._hung = self._motor_power = False
        self._encoder = (0.0, 0.0)
        self._encoder_origin = np.int32(0)
        self._now_ms = 0
        self._ticks = 0  # of the running firmware
        self.direction = 1
        self.boots = 0
        self.reset(ResetCause.POWER_ON)

    def _built(self, kind: str) -> Path:
        return image(kind)

    # --- life -------------------------------------------------------------------------------------
    def reset(self, cause: int) -> None:
        """Begin a start for a `ResetCause`; the program runs when the boot time is over."""
        self._kill()
        if cause == ResetCause.POWER_ON:
            self._latches = bytes(_LATCHES.size)
        self._cause = ResetCause(cause)
        self._boot_left = 1 if self._attended else BOOT_MS  # until the program runs
        self.ended = False
        self._hung = False
        self.powered = True
        self._outputs_off()
        self._host_bytes.clear()

    def _outputs_off(self) -> None:
        self.running = False
        self._drive = (-1,) * self._muscles
        self.motor = 0
        self.air = self.motor_enables = (False, False)

    def _start(self) -> None:
        host_end, board_end = socket.socketpair()
        with board_end:
            self._process = self._launch(board_end)
        host_end.settimeout(_START_S)
        self._socket = host_end
        adc_bits, frame_us = self._profile
        description = bytes([self._cause]) + self._latches + struct.pack("<BH", adc_bits, frame_us)
        self._tell(b"I" + description + self._flash)
        if self._attended:
            return
        started, problem = b"", ""
        end = time.monotonic() + _START_S
        while not started and not problem and time.monotonic() < end:
            if select.select([host_end], [], [], 0.05)[0]:
                started = host_end.recv(1)
                problem = "" if started else "it has ended"
            else:
                problem = next((x for x in self.console().splitlines() if "Error:" in x), "")
        if started != b"R":
            self._kill(keep=False)
            raise PortError(
                f"MicroPython has not started the controller: {problem or 'it is silent'}",
                "see firmware/micropython/README.md, and correct main.py and pins.py",
            )
        self._begin()

    def _begin(self) -> None:
        self._ticks = 0
        self.running = True
        self.boots += 1

    def _begins(self) -> bool:
        """Whether the controller has started; at a prompt, a person starts it."""
        assert self._socket is not None
        assert self._process is not None
        if not self.boots and select.select([self._socket], [], [], 0)[0]:
            self._socket.recv(1)
            self._begin()
        self.ended = self._process.poll() is not None
        return self.boots > 0 and not self.ended

    def _launch(self, board_end: socket.socket) -> subprocess.Popen[bytes]:
        if self._processor == "unix":
            command = [str(self._image), "-X", "heapsize=128k"]
            environment = os.environ | {"THIGMO_HARDWARE": str(board_end.fileno())}
            if self._attended:
                return subprocess.Popen(command, env=environment, pass_fds=(board_end.fileno(),))
            self._keys, terminal = os.openpty()
            try:
                # A new session's first terminal makes a signal of Ctrl-C while a program runs.
                return subprocess.Popen(
                    ["sh", "-c", 'exec "$@" <"$0"', os.ttyname(terminal), *command,
                     "-i", "-c", self._program],
                    env=environment, pass_fds=(board_end.fileno(),), start_new_session=True,
                    stdin=subprocess.DEVNULL, stdout=self._console, stderr=subprocess.STDOUT,
                )  # fmt: skip
            finally:
                os.close(terminal)
        monitor, board_monitor = socket.socketpair()
        with board_monitor, monitor:
            process = subprocess.Popen(
                [
                    "qemu-system-arm", "-machine", "mps2-an385", "-nodefaults", "-display", "none",
                    "-semihosting-config", "enable=on,target=native", "-kernel", self._image,
                    "-chardev", "stdio,id=prompt,signal=off", "-serial", "chardev:prompt",
                    "-chardev", f"socket,id=hardware,fd={board_end.fileno()}",
                    "-serial", "chardev:hardware",
                    "-chardev", f"socket,id=monitor,fd={board_monitor.fileno()}",
                    "-mon", "chardev=monitor",
                ],
                pass_fds=(board_end.fileno(), board_monitor.fileno()), stdin=subprocess.PIPE,
                stdout=self._console, stderr=subprocess.STDOUT,
            )  # fmt: skip
            self._process = process
            end = time.monotonic() + _START_S
            # It looks at a serial line that was off when the bytes came only after some event.
            while b">>> " not in os.pread(self._console.fileno(), 4096, 0):
                if process.poll() is not None or time.monotonic() > end:
                    return process
                time.sleep(0.01)
            # The port has no file system to start main.py from: its prompt starts it.
            self.type(self._program.replace("\n", "\r").encode() + b"\r")
            while b"import" not in os.pread(self._console.fileno(), 4096, 0):
                monitor.sendall(b"\n")
                if process.poll() is not None or time.monotonic() > end:
                    return process
                time.sleep(0.01)
        return process

    def type(self, keys: bytes) -> None:
        """Type at Python's prompt."""
        if self._keys >= 0:
            os.write(self._keys, keys)
            return
        assert self._process is not None
        assert self._process.stdin is not None
        self._process.stdin.write(keys)
        self._process.stdin.flush()

    def interrupt(self) -> None:
        """Ctrl-C at Python's prompt."""
        self.type(b"\x03")

    def printed(self, past: int = 0) -> bytes:
        """Python's output so far, without its first `past` bytes."""
        return os.pread(self._console.fileno(), 1 << 20, past)

    def console(self) -> str:
        """The same as text."""
        return self.printed().decode(errors="replace")

    def _tell(self, message: bytes) -> None:
        assert self._socket is not None
        self._socket.sendall(message)

    def _hear(self, count: int) -> bytes:
        assert self._socket is not None
        heard = bytearray()
        while len(heard) < count:
            piece = self._socket.recv(count - len(heard))
            if not piece:
                raise ConnectionError("MicroPython has ended")
            heard += piece
        return bytes(heard)

    def _kill(self, *, keep: bool = True) -> None:
        if self._process is None:
            return
        with suppress(OSError):  # it has ended, and its store has been read
            if keep:
                self._keep()
        assert self._socket is not None
        self._socket.close()
        self._process.kill()
        self._process.wait()
        if self._process.stdin is not None:
            self._process.stdin.close()
        if self._keys >= 0:
            os.close(self._keys)
            self._keys = -1
        self._process = self._socket = None

    def __del__(self) -> None:
        if hasattr(self, "_process"):
            self._kill(keep=False)

    def _keep(self) -> bytes:
        """Take flash, latches and store out of the machine; returns the store."""
        self._tell(b"G")
        self._hear(1)
        self._latches = self._hear(_LATCHES.size)
        self.erasures = list(_ERASURES.unpack(self._hear(_ERASURES.size)))
        self._flash = self._hear(len(self._flash))
        return self._hear(self._store_size)

    # --- time -------------------------------------------------------------------------------------
    def step(self, ticks: int) -> None:
        """Run for a number of milliseconds."""
        elapsed = 0
        while elapsed < ticks:
            count = min(ticks - elapsed, self._boot_left or _MOST_TICKS)
            if self._boot_left:
                self._host_bytes.clear()  # nobody takes it
                self._boot_left -= count
                if not self._boot_left:
                    self._start()
            elif self._process is not None and (not self._attended or self._begins()):
                self._exchange(elapsed, count, ticks)
            elapsed += count
            self._now_ms += count
        self._analog.settle()
        self._encoder = (self._encoder[1], self._encoder[1])

    def _exchange(self, elapsed: int, count: int, ticks: int) -> None:
        """Run the program for `count` ms, from `elapsed` ms into a step of `ticks` ms."""
        counts = self._analog.frames(self._ticks, count, elapsed, 1.0 / ticks)
        encoder_start, encoder_end = self._encoder
        shares = (elapsed + np.arange(count)[:, None] + self._passes) * (1.0 / ticks)
        places = np.floor(encoder_start + (encoder_end - encoder_start) * shares).astype("<i4")
        if self._ticks == 0:  # the controller counts from where it began
            self._encoder_origin = places[0, 0]
        places -= self._encoder_origin
        rows = np.hstack([counts.astype("<u2").view("u1"), places.view("u1")])
        flags = self._estop | self._hung << 1 | self._motor_power << 2
        line = bytes(self._host_bytes)
        self._host_bytes.clear()
        errors = self._encoder_errors
        message = struct.pack("<BBHHH", count, flags, self._supply_mv, errors, len(line))
        try:
            self._tell(b"S" + message + line + rows.tobytes())
            while (kind := self._hear(1)) != b"S":
                if kind == b"R":  # the program has begun again, in this step or before
                    self.boots += 1
                elif self.bus is not None:
                    self._serve_bus(self.bus, kind)
            state, *drive, motor, length = self._state.unpack(self._hear(self._state.size))
            self._received += self._hear(length)
        except OSError:  # Python itself has ended, and the pins float
            self._outputs_off()
            return
        self.running = bool(state & _RUNS)
        # A controller that restarts in the next step begins with tick 0.
        self._ticks = self._ticks + count if self.running else 0
        self.powered = bool(state & _POWERED)
        self._drive = tuple(drive)
        self.motor = motor
        if motor:
            self.direction = 1 if state & _OUT else -1
        self.air = (bool(state & _MUSCLE_AIR), bool(state & _BODY_AIR))
        self.motor_enables = (bool(state & _MOTOR_SUPPLY), bool(state & _BRAKE_OPEN))
        if state & _BITES:
            self.reset(ResetCause.WATCHDOG)

    def _serve_bus(self, bus: ImuBus, kind: bytes) -> None:
        """Carry out one I2C transfer of the firmware on the bus."""
        if kind == b"N":
            bus.clock()
            return
        now_us, address, reads, count, data = _TRANSFER.unpack(self._hear(_TRANSFER.size))
        now_us += 1000 * (self._now_ms - self._ticks)
        written, read_count = (b"", count) if reads else (data[:count], 0)
        ended, read = bus.transfer(now_us, address, written, read_count)
        self._tell(bytes([ended]) + read.ljust(21, b"\xff"))

    @property
    def now_us(self) -> int:
        """Time since construction, us."""
        return self._now_ms * 1000

    # --- serial line ------------------------------------------------------------------------------
    def write(self, data: bytes) -> None:
        """Bytes from the host; they reach the board one after another, 40 us each."""
        self._host_bytes += data

    def read(self) -> bytes:
        """Bytes that have reached the host since the last call."""
        data = bytes(self._received)
        self._received.clear()
        return data

    # --- inputs -----------------------------------------------------------------------------------
    def set_analog(self, counts: Floats) -> None:
        """Ideal counts in 1/1024 of the reference, shape (16, 2): at the step's start and end."""
        levels = np.array(counts, dtype=np.float64, order="C")
        if self.bus is not None:
            levels[self.bus.inputs] = 0.0  # pulled down
        self._analog.set_levels(levels)

    def set_adc_noise(self, sigma: Floats) -> None:
        """White noise of a conversion in 1/1024 of the reference, shape (16,)."""
        self._analog.set_noise(np.ascontiguousarray(sigma, dtype=np.float64))

    def feed_trace(self, rows: npt.NDArray[np.int64]) -> None:
        """Replace conversions by recorded ones, shape (n, 3): tick, channel, count."""
        self._analog.feed(rows)

    def set_encoder(self, start: float, end: float) -> None:
        """Encoder position (x4 counts) at the next step's start and end."""
        self._encoder = (start, end)

    def set_encoder_errors(self, errors: int) -> None:
        """Illegal transitions of the encoder so far, modulo 65536."""
        self._encoder_errors = errors

    def set_supply_mv(self, millivolt: int) -> None:
        """Supply voltage."""
        self._supply_mv = millivolt

    def set_estop(self, pressed: bool) -> None:
        """Emergency stop."""
        self._estop = pressed

    def set_motor_power(self, powered: bool) -> None:
        """Input that shows the motor's supply, behind its contacts."""
        self._motor_power = powered

    # --- outputs ----------------------------------------------------------------------------------
    @property
    def drive(self) -> tuple[int, ...]:
        """Transducer duties, 0..1599."""
        return tuple(max(duty, 0) for duty in self._drive)

    @property
    def drive_enabled(self) -> tuple[bool, ...]:
        """Whether each transducer's output is connected."""
        return tuple(duty >= 0 for duty in self._drive)

    @property
    def braked(self) -> bool:
        """The motor driver brakes while its PWM input is low."""
        return self.motor == 0

    # --- faults and the store ---------------------------------------------------------------------
    @property
    def eeprom(self) -> bytes:
        """The core's store."""
        return self._keep() if self._process is not None else b""

    def cut_power_after(self, n_bytes: int) -> None:
        """Cut the power after this many more bytes have been written to the flash."""
        self._tell(b"C" + struct.pack("<I", n_bytes))

    def hang(self) -> None:
        """Stop the controller's loop; the watchdog then resets the board."""
        self._hung = True


def open_micropython(url: str, *, seed: int | None = None, realtime: bool = False) -> Transport:
    """Open `micropython://SCENE?seed=N&on=unix|cortex-m3`."""
    scene, used, options = parse_url(url, seed, on=("unix", "cortex-m3"))
    processor: Processor = "cortex-m3" if options["on"] == "cortex-m3" else "unix"
    large = board_size(scene.robot) is not BOARD_SIZES[0]
    if processor == "cortex-m3":
        require_usual(scene.robot)
    board = MicroPythonBoard(used, processor=processor, large=large)
    transport = EmulatorTransport(scene, board, seed=used, realtime=realtime, name=url)
    if large:
        plant = transport.lockstep.plant
        board.bus = string_bus(plant.wiring, plant.imus)
    transport.take_stops()
    return transport
