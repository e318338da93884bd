"""The firmware core on a virtual board: a compiled extension (firmware/virtual)."""

import numpy as np
from numpy.typing import NDArray

SCHEMA_HASH: int
"""Hash of the schema that the firmware was built from."""

class VirtualBoard:
    """The robot's controller, running in virtual time.

    Time passes only in `step`. After construction and after each reset the boot loader waits for
    0.84 s, in which received bytes are lost and all outputs are off.
    """

    def __init__(self, seed: int, eeprom: bytes = b"") -> None:
        """Power on.

        Args:
            seed: of the conversion noise and of what a cut EEPROM write leaves behind.
            eeprom: contents from address 0 (at most 4096 bytes); the rest is blank (0xFF).

        Raises:
            ValueError: the EEPROM image is too long.
        """

    def step(self, ticks: int) -> None:
        """Advance by whole milliseconds."""

    @property
    def now_us(self) -> int:
        """Virtual time since construction, in us; resets do not set it back."""

    def write(self, data: bytes) -> None:
        """Queue bytes from the host; they reach the board one after another, 40 us each."""

    def read(self) -> bytes:
        """All bytes that have reached the host since the last call."""

    def set_analog(self, counts: NDArray[np.float64]) -> None:
        """Set ideal counts, shape (16, 2): at the start and the end of the next step, linear.

        Afterwards the end values stay. A conversion is clamp(floor(ideal + noise), 0, 1023).
        """

    def set_adc_noise(self, sigma: NDArray[np.float64]) -> None:
        """Set the standard deviation of each channel's noise in counts, shape (16,)."""

    def set_encoder(self, start: float, end: float) -> None:
        """Set the encoder's x4 count at the start and the end of the next step, linear."""

    def set_supply_mv(self, supply_mv: int) -> None:
        """Set the supply that the board measures, in mV."""

    def set_estop(self, pressed: bool) -> None:
        """Press or release the emergency stop."""

    def reset(self, cause: int) -> None:
        """Restart the chip (also after a power cut), with a `ResetCause`.

        Raises:
            ValueError: no such cause.
        """

    def hang(self) -> None:
        """Stop the main loop, until the watchdog resets the board after 0.25 s."""

    def stall(self, ticks: int) -> None:
        """Let the main loop stand still for so many ms, and then go on."""

    def cut_power_after(self, bytes_written: int) -> None:
        """Cut the power in the middle of the EEPROM write after the next `bytes_written` ones."""

    def feed_trace(self, rows: NDArray[np.int64]) -> None:
        """Replace conversions by recorded ones, shape (n, 3): tick, channel, count."""

    def record_trace(self, on: bool) -> None:
        """Begin or end recording conversions; forgets what was recorded."""

    def recorded_trace(self) -> NDArray[np.int64]:
        """Recorded conversions, shape (n, 3): tick since the firmware's start, channel, count."""

    @property
    def drive(self) -> tuple[int, int]:
        """Duty of both transducers, 0..1599 = 0..20 mA."""

    @property
    def drive_enabled(self) -> tuple[bool, bool]:
        """Whether each transducer's output is connected; if not, it carries true zero."""

    @property
    def motor(self) -> int:
        """Motor duty, -800..800, positive pays out."""

    @property
    def braked(self) -> bool:
        """Whether the motor is braked."""

    @property
    def air(self) -> tuple[bool, bool]:
        """Whether the air enables of muscles and body are held on by their pins' edges."""

    @property
    def direction(self) -> int:
        """Level of the direction pin: 1 pays out, -1 winds in."""

    @property
    def powered(self) -> bool:
        """False after a power cut, until `reset`."""

    @property
    def running(self) -> bool:
        """Whether the firmware runs: not unpowered, not in the boot loader."""

    @property
    def boots(self) -> int:
        """How often the firmware has started."""

    @property
    def eeprom(self) -> bytes:
        """The EEPROM's 4096 bytes."""
