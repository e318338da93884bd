"""What the emulator asks of a board: the interface of the virtual board and the simulated Mega.

The board holds the controller's firmware. The emulator feeds it analog levels, the encoder and the
supply, advances it, and takes its outputs. One tick is 1 ms.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np
import numpy.typing as npt

from thigmo.errors import ConfigError
from thigmo.wiring import BOARD_SIZES, board_size

if TYPE_CHECKING:
    from thigmo.config import RobotConfig

Floats = npt.NDArray[np.float64]

CHANNELS = 16  # at least
# ADC channels of the usual board: flex sensors 0..9 (`thigmo.wiring`), pressures 10 and 11.
FLEX_RIGHT = 5
PRESSURE = 10
DRIVE_FULL = 1599  # transducer duty of 20 mA
MOTOR_FULL = 800
_CONVERTER = (12, 320)  # of the large board: bits, and us for a frame of 13 conversions


class EmulatedBoard(Protocol):
    """A controller board in lockstep with the emulated robot."""

    def step(self, ticks: int, /) -> None:
        """Run for a number of ticks of 1 ms."""

    @property
    def now_us(self) -> int:
        """Time since the start (64 bits, us)."""

    def write(self, data: bytes, /) -> None:
        """Bytes to the board's UART; they arrive at its baud rate."""

    def read(self) -> bytes:
        """Bytes that the board has sent so far."""

    def set_analog(self, counts: Floats, /) -> None:
        """Ideal ADC counts in [0, 1024), shape (channels, 2): at the next step's start and end."""

    def set_adc_noise(self, sigma: Floats, /) -> None:
        """White noise of a conversion in counts, one sigma, by channel."""

    def set_encoder(self, start: float, end: float, /) -> None:
        """Encoder position (x4 counts) at the next step's start and end."""

    def set_supply_mv(self, millivolt: int, /) -> None:
        """Supply voltage."""

    def set_estop(self, pressed: bool, /) -> None:
        """Emergency stop input."""

    def set_motor_power(self, powered: bool, /) -> None:
        """Input that shows the motor's supply, behind its contacts."""

    @property
    def drive(self) -> tuple[int, ...]:
        """Transducer duties by output, 0..1599 = 0..20 mA."""

    @property
    def drive_enabled(self) -> tuple[bool, ...]:
        """Whether each transducer's output is connected; otherwise it carries 0 mA."""

    @property
    def motor(self) -> int:
        """Motor duty -800..800, positive pays out."""

    @property
    def braked(self) -> bool:
        """The motor driver brakes."""

    @property
    def air(self) -> tuple[bool, bool]:
        """Whether the air enables of muscles and body are held on by their pins' edges."""

    @property
    def motor_enables(self) -> tuple[bool, bool]:
        """Whether the enables of the motor's supply and of the brake's coil are held on so."""

    @property
    def eeprom(self) -> bytes:
        """The configuration store's content."""

    def cut_power_after(self, n_bytes: int, /) -> None:
        """Lose power after this many more bytes have been written to the store."""

    def reset(self, cause: int, /) -> None:
        """Restart, for a `ResetCause`."""

    def hang(self) -> None:
        """Stop the main loop; the watchdog then resets the board."""


def virtual_board(robot: RobotConfig, seed: int, eeprom: bytes = b"") -> EmulatedBoard:
    """The virtual board that a robot needs, with an EEPROM of this content."""
    from thigmo.emulator import _board, _large_board

    if board_size(robot) is BOARD_SIZES[0]:
        return _board.VirtualBoard(seed, eeprom)
    return _large_board.VirtualBoard(seed, eeprom, *_CONVERTER)


def require_usual(robot: RobotConfig) -> None:
    """Raise ConfigError for a robot that needs another board than the usual one."""
    needed = board_size(robot)
    if needed is not BOARD_SIZES[0]:
        raise ConfigError(
            f"this robot needs another board ({needed.name})", "open it by emulator://SCENE"
        )
