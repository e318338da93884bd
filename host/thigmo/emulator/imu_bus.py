"""The I2C bus of a string of IMUs, as a board meets it: BNO085 behind a TCA9548A, byte by byte.

What each part does is of its data sheet: TCA9548A of SCPS207, BNO085 of CEVA 1000-3927 with SHTP
(1000-3535) and SH-2 (1000-3625). Headings are those of the emulated string.
"""

from __future__ import annotations

from collections import deque
from math import cos, sin

import numpy as np
import numpy.typing as npt

from thigmo.config import HeadingSensor
from thigmo.emulator.imus import ImuString
from thigmo.errors import ConfigError
from thigmo.sensors import imus_of
from thigmo.wiring import Wiring

DONE, REFUSED, STUCK = 0, 2, 3  # how a transfer ends (firmware/core/sensing/imu_string.h)
MULTIPLEXER = 0x70
BIT_US = 2.5  # fast mode
_NINE_CLOCKS = 9
_EXECUTABLE, _CONTROL, _INPUT = 1, 2, 3
_ADVERTISEMENT = bytes(276)  # its length; the contents do not matter here
_ONE = 1 << 14


class Bno085:
    """One IMU of a string: messages of SHTP, and game rotation vectors once it is asked for them.

    Attributes:
        answers: False as of one that is unplugged.
        counts: Whether it goes on numbering its reports; otherwise the last one is repeated.
        moves: Whether its numbers follow the body; otherwise they stay as they are.
    """

    def __init__(self, string: ImuString, number: int) -> None:
        self._string, self._imu = string, number
        self.answers = self.counts = self.moves = True
        self.restart()

    def restart(self, origin_rad: float = 0.0) -> None:
        """Begin again, as after a sag of its supply: another origin, and no reports."""
        self._origin = origin_rad
        self._interval_us = 0
        self._next_us = 0
        self._number = 0
        self._left = b""  # of the message that is partly read
        self._last = (0, 0)
        self._waiting = deque([(0, _ADVERTISEMENT), (_EXECUTABLE, b"\x01")])

    @property
    def acknowledges(self) -> bool:
        """Whether it answers on the bus now."""
        return self.answers and self._imu not in self._string.hung

    def write(self, data: bytes) -> None:
        """Take a message: only the command that asks for game rotation vectors does anything."""
        if len(data) == 21 and data[2] == _CONTROL and data[4:6] == b"\xfd\x08":
            self._interval_us = int.from_bytes(data[9:13], "little")

    def read(self, count: int, now_us: int) -> bytes:
        """The next message, or the next piece of it; zeros where there is none."""
        if self._interval_us and now_us >= self._next_us:
            self._next_us = now_us + self._interval_us
            if self._waiting and self._waiting[-1][0] == _INPUT:
                self._waiting.pop()  # nobody took it in time
            self._waiting.append((_INPUT, self._report()))
        begins = not self._left
        if begins:
            if not self._waiting:
                return bytes(count)
            self._channel, self._left = self._waiting.popleft()
        length = (4 + len(self._left)) | (0 if begins else 1 << 15)
        piece, self._left = self._left[: count - 4], self._left[count - 4 :]
        header = length.to_bytes(2, "little") + bytes([self._channel, 0])
        return (header + piece).ljust(count, b"\0")

    def _report(self) -> bytes:
        if self.counts:
            self._number = (self._number + 1) % 256
        if self.moves:
            half = (float(self._string.headings[self._imu]) + self._origin) / 2
            self._last = (round(_ONE * sin(half)), round(_ONE * cos(half)))
        turn = b"".join(n.to_bytes(2, "little", signed=True) for n in (0, 0, *self._last))
        return b"\xfb\0\0\0\0" + bytes([0x08, self._number, 3, 0]) + turn


class ImuBus:
    """The bus, and the inputs of the board that are read over it.

    Attributes:
        chips: IMUs by the multiplexer's channel and their address.
        inputs: Of the board; nothing is wired to their converter.
        held_clocks: Clocks until a part that holds SDA low releases it.
        mux_answers: Whether the multiplexer acknowledges.
        mux_stuck: Whether it keeps its channel whatever is written.
        bits: That the bus has carried.
    """

    def __init__(self, chips: dict[tuple[int, int], Bno085], inputs: npt.NDArray[np.intp]) -> None:
        self.chips, self.inputs = chips, inputs
        self.held_clocks = 0
        self.mux_answers, self.mux_stuck = True, False
        self.bits = 0
        self._selected = 0

    def transfer(self, now_us: int, address: int, data: bytes, count: int) -> tuple[int, bytes]:
        """Write the data, or read `count` bytes if there is none: how it ended, and the bytes."""
        if self.held_clocks > 0:
            return STUCK, b""
        self.bits += 9 * (1 + (len(data) or count)) + 2
        if address == MULTIPLEXER:
            if not self.mux_answers:
                return REFUSED, b""
            if data and not self.mux_stuck:
                self._selected = data[-1]
            return DONE, bytes([self._selected]) * count
        addressed = [
            chip
            for (channel, chip_address), chip in self.chips.items()
            if self._selected >> channel & 1 and chip_address == address and chip.acknowledges
        ]
        if not addressed:
            return REFUSED, b""
        if data:
            for chip in addressed:
                chip.write(data)
            return DONE, b""
        # The bus is open drain: a 0 from any chip wins.
        replies = [np.frombuffer(chip.read(count, now_us), np.uint8) for chip in addressed]
        return DONE, np.bitwise_and.reduce(replies).tobytes()

    def clock(self) -> None:
        """Nine clocks and a STOP."""
        self.held_clocks = max(self.held_clocks - _NINE_CLOCKS, 0)


def string_bus(wiring: Wiring, string: ImuString) -> ImuBus:
    """The bus of a robot's emulated IMUs.

    Raises ConfigError for an IMU without an address, and for two with the same one.
    """
    heading_sensors = {n: s for n, s in enumerate(wiring.sensors) if isinstance(s, HeadingSensor)}
    chips: dict[tuple[int, int], Bno085] = {}
    _, ends = imus_of([*heading_sensors.values()])
    for row, sensor in enumerate(heading_sensors.values()):
        address = sensor.mux_channel, sensor.i2c_address
        if not sensor.i2c_address or address in chips:
            raise ConfigError(
                f"the IMU at {sensor.ends_cm[1]:g} cm has no channel and address of its own",
                "give each [[sensor]] its mux_channel and i2c_address",
            )
        chips[address] = Bno085(string, int(ends[row, 1]))
    return ImuBus(chips, np.array([*heading_sensors], dtype=np.intp))
