"""The firmware core on a virtual board: a compiled extension (firmware/virtual)."""

import numpy as np
from numpy.typing import NDArray

SCHEMA_HASH: int
"""Hash of the schema that the firmware was built from."""

class Analog:
    """The analog inputs of an emulated board, and their converter.

    Counts are in 1/1024 of the reference; those that are converted have `adc_bits`.
    """

    def __init__(self, seed: int, adc_bits: int, frame_us: int) -> None:
        """A frame of eight conversions is complete `frame_us` into its tick.

        Raises ValueError for other than 10 to 16 bits and 1 to 999 us.
        """

    def set_levels(self, counts: NDArray[np.float64]) -> None:
        """Levels at the next step's start and end, shape (16, 2)."""

    def set_noise(self, sigma: NDArray[np.float64]) -> None:
        """White noise of each channel, shape (16,)."""

    def settle(self) -> None:
        """The step is over: levels stay at its end."""

    def feed(self, rows: NDArray[np.int64]) -> None:
        """Replace conversions by recorded ones, shape (n, 3): tick, channel, count."""

    def frames(self, tick: int, ticks: int, begun: int, tick_share: float) -> NDArray[np.uint16]:
        """Conversions of ticks from one on, the `begun`-th of a step and those after it.

        A tick lasts the share `tick_share` of the step. Shape (ticks, 8), as the schedule has them.
        """

class VirtualBoard:
    """The robot's controller, running in virtual time: a `thigmo.emulator.board.EmulatedBoard`.

    Time passes only in `step`. After construction and after each reset the boot loader waits for
    0.84 s, in which received bytes are lost and all outputs are off.
    """

    def __init__(
        self, seed: int, eeprom: bytes = b"", adc_bits: int = 10, frame_us: int = 832
    ) -> None:
        """Power on, with an EEPROM of that content (4096 bytes at most); the rest is blank.

        The seed is of the conversions' noise and of what a cut EEPROM write leaves behind.
        The converter has `adc_bits`, and a tick's conversions are complete `frame_us` into it.
        Raises ValueError for a longer image, and for other than 10 to 16 bits and 1 to 999 us.
        """

    # As `EmulatedBoard` has them.
    def step(self, ticks: int) -> None: ...
    now_us: int
    def write(self, data: bytes) -> None:
        """Queue bytes from the host; they reach the board one after another, 40 us each."""

    def read(self) -> bytes: ...
    def set_analog(self, counts: NDArray[np.float64]) -> None:
        """Set ideal counts, shape (16, 2): at the start and the end of the next step, linear.

        Afterwards the end values stay. A conversion is clamp(floor(ideal + noise), 0, 1023).
        """

    def set_adc_noise(self, sigma: NDArray[np.float64]) -> None: ...
    def set_encoder(self, start: float, end: float) -> None: ...
    def set_supply_mv(self, supply_mv: int) -> None: ...
    def set_encoder_errors(self, errors: int) -> None: ...
    def set_estop(self, pressed: bool) -> None: ...
    def set_motor_power(self, on: bool) -> None: ...
    def reset(self, cause: int) -> None:
        """Restart the chip (also after a power cut), with a `ResetCause`; else ValueError."""

    def hang(self) -> None: ...
    def cut_power_after(self, bytes_written: int) -> None: ...
    drive: tuple[int, int]
    drive_enabled: tuple[bool, bool]
    motor: int
    braked: bool
    air: tuple[bool, bool]
    motor_enables: tuple[bool, bool]
    eeprom: bytes

    # Its own.
    def stall(self, ticks: int) -> None:
        """Let the main loop stand still for a number of ms, and then go on."""

    def feed_trace(self, rows: NDArray[np.int64]) -> None:
        """Replace conversions by recorded ones, shape (n, 3): tick, channel, count."""

    def record_trace(self, on: bool) -> None:
        """Begin or end recording conversions; forgets what was recorded."""

    def recorded_trace(self) -> NDArray[np.int64]:
        """Recorded conversions, shape (n, 3): tick since the firmware's start, channel, count."""

    direction: int  # level of the direction pin: 1 pays out, -1 winds in
    powered: bool  # False after a power cut, until `reset`
    running: bool  # whether the firmware runs: not unpowered, not in the boot loader
    boots: int  # how often the firmware has started
