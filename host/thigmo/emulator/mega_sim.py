"""`mega-sim://SCENE`: the real firmware image on a simulated Arduino Mega, inside the emulator.

`SimulatedMega` puts the chip's pins, converters and serial line behind the same interface as the
virtual board, so the emulator's plant drives either. The image is the one that a lab flashes, and
starts through the real boot loader where that is installed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from thigmo.emulator import mega_build
from thigmo.emulator.board import DRIVE_FULL, MOTOR_FULL, require_usual
from thigmo.emulator.chip import (
    CHANNELS,
    CYCLES_PER_MS,
    EEPROM_SIZE,
    NO_COUNT,
    Cause,
    Chip,
)
from thigmo.emulator.transport import EmulatorTransport, parse_url
from thigmo.emulator.usb_bridge import UsbBridge
from thigmo.link.image import read_hex
from thigmo.link.protocol import ResetCause

if TYPE_CHECKING:
    from pathlib import Path

    from thigmo.link.transport import Transport

Floats = npt.NDArray[np.float64]

BOOT_SECTION = 0x3E000
# Pins of firmware/mega/pins.h: port and bit.
ENCODER = ("E", 4, 5)
ESTOP = ("A", 0)
DRIVES = (("L", 3), ("L", 4))  # OC5A, OC5B
MOTOR_PWM = ("H", 3)  # OC4A
MOTOR_DIRECTION = ("H", 4)
ENABLES = (("A", 2), ("A", 4), ("A", 6), ("A", 7))  # muscles, body, motor, brake
MOTOR_POWER = ("A", 5)
# A charge pump's longest (docs/hardware/electronics.md).
HOLD_CYCLES = tuple(ms * CYCLES_PER_MS for ms in (60, 60, 30, 30))


class SimulatedMega:
    """The firmware image on the simulated chip, as the emulator's `EmulatedBoard`.

    Time passes only in `step`. Exchanges with the plant should be of 1 ms.

    Args:
        seed: of the conversions' noise and of what RAM holds at power-on.
        eeprom: contents from address 0; the rest is blank.
        image: firmware (Intel HEX); None: this source tree's, built if need be.
        baud: of the image and of the host's port.
        boot_loader: start through the real boot loader; None: if it is installed.
        usb: the USB bridge in between; None: bytes pass at once.
    """

    def __init__(
        self,
        seed: int,
        eeprom: bytes = b"",
        *,
        image: Path | None = None,
        baud: int = 250_000,
        boot_loader: bool | None = None,
        usb: UsbBridge | None = None,
    ) -> None:
        self.chip = Chip()
        self.usb = usb
        self._seed = seed
        self._power_ons = 0
        self._grid = 0  # cycle at which the last step ended
        self._skipped = 0  # cycles that passed inside `reset`
        self._received = bytearray()
        self._analog: Floats = np.zeros((CHANNELS, 2))
        self._encoder: tuple[float, float] | None = None
        self._supply_mv = 5000
        self.boots = 0  # how often the firmware has started
        self._origin = 0
        self._line_open = True
        self._enable_levels = [False] * len(ENABLES)
        self._enable_edges = [-hold for hold in HOLD_CYCLES]
        chip = self.chip
        for address, data in read_hex(image or mega_build.firmware_hex(baud)):
            chip.write("flash", address, data)
        if boot_loader or (boot_loader is None and mega_build.BOOT_LOADER.exists()):
            for address, data in read_hex(mega_build.BOOT_LOADER):
                chip.write("flash", address, data)
            chip.boot_at(BOOT_SECTION)
        chip.eeprom = eeprom + b"\xff" * (EEPROM_SIZE - len(eeprom))
        chip.line_baud(baud)
        self.set_adc_noise(np.zeros(CHANNELS))
        self.set_estop(False)
        self.set_motor_power(False)
        self._power_on()

    def _power_on(self) -> None:
        self._power_ons += 1
        self.chip.reset(Cause.POWER_ON, (self._seed & 0xFFFF) * 1000 + self._power_ons)

    # --- time -------------------------------------------------------------------------------------
    def step(self, ticks: int) -> None:
        """Run for a number of milliseconds."""
        chip = self.chip
        start, end = self._grid, self._grid + ticks * CYCLES_PER_MS
        chip.analog(self._analog[:, 0], self._analog[:, 1], start, end)
        self._analog[:, 0] = self._analog[:, 1]
        if self._encoder is not None:
            encoder_start, encoder_end = self._encoder
            if encoder_start != encoder_end:
                chip.encoder(ENCODER, encoder_start, encoder_end, start, end)
            self._encoder = (encoder_end, encoder_end)
        while self._grid < end:
            self._grid += CYCLES_PER_MS
            chip.run(self._grid)
            if chip.tick_origin not in (0, self._origin):
                self.boots += 1
            self._origin = chip.tick_origin
            self._exchange_bytes()
            # Once a tick is as often as the firmware toggles.
            for enable, pin in enumerate(ENABLES):
                if (level := self._level(pin)) != self._enable_levels[enable]:
                    self._enable_levels[enable] = level
                    self._enable_edges[enable] = self._grid

    def _exchange_bytes(self) -> None:
        down, (data, _) = b"", self.chip.take()
        if self.usb is not None:
            down, data = self.usb.exchange(self._grid / CYCLES_PER_MS, data)
        if self._line_open:
            self.chip.send(down)
            self._received += data

    def run_to_tick(self) -> None:
        """Run to the start of the firmware's tick 0 and let the steps begin there.

        The inputs of boards that are compared tick by tick then change at the same instants.
        """
        chip = self.chip
        while not chip.tick_origin:
            chip.run_ms(1)
        self._skipped += chip.tick_origin - self._grid
        self._grid = chip.tick_origin
        chip.run(self._grid)
        self.boots = max(self.boots, 1)
        self._origin = chip.tick_origin

    @property
    def now_us(self) -> int:
        """Time since construction, in us; resets do not set it back."""
        return (self._grid - self._skipped) * 1000 // CYCLES_PER_MS

    # --- serial line ------------------------------------------------------------------------------
    def write(self, data: bytes) -> None:
        """Bytes from the host."""
        if self._line_open:
            (self.chip if self.usb is None else self.usb).send(data)

    def read(self) -> bytes:
        """Bytes that have reached the host since the last call."""
        data = bytes(self._received)
        self._received.clear()
        return data

    def plug(self, connected: bool) -> None:
        """Pull or plug the cable. Plugging does not reset the board; opening the port does."""
        self._line_open = connected
        if not connected:
            self._received.clear()
            self.chip.line_clear()
            if self.usb is not None:
                self.usb.drop()

    # --- inputs -----------------------------------------------------------------------------------
    def set_analog(self, counts: Floats) -> None:
        """Ideal counts, shape (16, 2): at the next step's start and end."""
        self._analog = np.array(counts, dtype=np.float64)

    def set_adc_noise(self, sigma: Floats) -> None:
        """White noise of a conversion in counts, shape (16,)."""
        self.chip.noise(self._seed, sigma)

    def set_encoder(self, start: float, end: float) -> None:
        """Encoder position (x4 counts) at the next step's start and end."""
        if self._encoder is None:  # the shaft stands somewhere when the power comes
            port, a, b = ENCODER
            place = int(np.floor(start)) & 3
            self.chip.drive_pin(port, a, place in (1, 2))
            self.chip.drive_pin(port, b, place >= 2)
        self._encoder = (start, end)

    def set_supply_mv(self, millivolt: int) -> None:
        """Supply voltage."""
        self._supply_mv = millivolt
        self.chip.supply_mv(millivolt)

    def set_estop(self, pressed: bool) -> None:
        """Emergency stop: a closed contact to ground that opens when pressed."""
        self.chip.drive_pin(*ESTOP, pressed)

    def set_motor_power(self, powered: bool) -> None:
        """Input that shows the motor's supply, behind its contacts."""
        self.chip.drive_pin(*MOTOR_POWER, powered)

    # --- outputs ----------------------------------------------------------------------------------
    def _level(self, pin: tuple[str, int]) -> bool:
        """Level of an output pin; inputs are pulled down on the board."""
        return bool(self.chip.output(*pin))

    @property
    def drive(self) -> tuple[int, int]:
        """Transducer duties, 0..1599, from timer and pins."""
        pwm = self.chip.pwm(5)
        first, second = (
            (pwm.compare[n] + 1 if pwm.top else 0)
            if pwm.connected[n] and self.chip.output(*pin) is not None
            else DRIVE_FULL * self._level(pin)
            for n, pin in enumerate(DRIVES)
        )
        return first, second

    @property
    def drive_enabled(self) -> tuple[bool, bool]:
        """Whether each transducer's compare output is connected, or its pin high."""
        pwm = self.chip.pwm(5)
        first, second = (pwm.connected[n] or self._level(pin) for n, pin in enumerate(DRIVES))
        return first, second

    @property
    def direction(self) -> int:
        """Level of the direction pin: 1 pays out, -1 winds in."""
        return 1 if self._level(MOTOR_DIRECTION) else -1

    @property
    def motor(self) -> int:
        """Motor duty, -800..800, positive pays out."""
        pwm = self.chip.pwm(4)
        if pwm.connected[0] and pwm.top:
            duty: int = min(pwm.compare[0] + 1, MOTOR_FULL)
        else:
            duty = MOTOR_FULL * self._level(MOTOR_PWM)
        return duty * self.direction

    @property
    def braked(self) -> bool:
        """A driver of the MD10C family brakes while its PWM input is low."""
        return self.motor == 0

    @property
    def air(self) -> tuple[bool, bool]:
        """Whether the air enables of muscles and body are held on by their pins' edges."""
        return self._is_held_on(0), self._is_held_on(1)

    @property
    def motor_enables(self) -> tuple[bool, bool]:
        """Whether the enables of the motor's supply and of the brake's coil are held on so."""
        return self._is_held_on(2), self._is_held_on(3)

    def _is_held_on(self, enable: int) -> bool:
        return self._grid - self._enable_edges[enable] < HOLD_CYCLES[enable]

    # --- faults and the store ---------------------------------------------------------------------
    @property
    def eeprom(self) -> bytes:
        """The EEPROM's 4096 bytes."""
        return self.chip.eeprom

    def cut_power_after(self, n_bytes: int) -> None:
        """Cut the power in the middle of the EEPROM write after the next `n_bytes` ones."""
        self.chip.cut_power_in_write(n_bytes)

    def reset(self, cause: int) -> None:
        """Restart, the way it happens to a Mega.

        A brown-out is a sag of 4 ms; a watchdog reset is a hang that the watchdog ends in 0.25 s.
        """
        match ResetCause(cause):
            case ResetCause.WATCHDOG:
                self.hang()
            case ResetCause.BROWN_OUT:
                begun = self.chip.cycle
                self.chip.supply_mv(3900)
                self.chip.run_ms(3)
                self.chip.supply_mv(2400)
                self.chip.run_ms(1)
                self.chip.supply_mv(self._supply_mv)
                self._grid += self.chip.cycle - begun
                self._skipped += self.chip.cycle - begun
            case ResetCause.EXTERNAL:
                self.chip.reset(Cause.EXTERNAL)
            case _:
                self.chip.cut_power_in_write(None)
                self._power_on()

    def hang(self, *, interrupts: bool = True) -> None:
        """Send the main loop into an endless one; the watchdog then resets the board."""
        self.chip.hang(interrupts=interrupts)

    @property
    def powered(self) -> bool:
        """False after a power cut, until `reset`."""
        return not self.chip.power_is_cut

    @property
    def running(self) -> bool:
        """Whether the firmware runs: its tick has started."""
        return self.powered and self.chip.tick_origin != 0

    # --- traces -----------------------------------------------------------------------------------
    def feed_trace(self, rows: npt.NDArray[np.int64]) -> None:
        """Replace conversions by recorded ones, shape (n, 3): tick, channel, count."""
        first = int(rows[:, 0].min())
        table = np.full((int(rows[:, 0].max()) - first + 1, CHANNELS), NO_COUNT, dtype=np.uint16)
        table[rows[:, 0] - first, rows[:, 1]] = rows[:, 2]
        self.chip.feed_trace(table, first)

    def record_trace(self, enabled: bool) -> None:
        """Begin or end recording conversions; earlier records are discarded."""
        self.chip.take_trace()
        self.chip.record_trace(enabled)

    def recorded_trace(self) -> npt.NDArray[np.int64]:
        """Recorded conversions, shape (n, 3): tick since the firmware's start, channel, count."""
        trace = self.chip.take_trace()
        trace = trace[(trace["channel"] < CHANNELS) & (trace["tick"] != 0xFFFFFFFF)]
        return np.stack([trace[name].astype(np.int64) for name in ("tick", "channel", "count")], 1)


def open_mega_sim(url: str, *, seed: int | None = None, realtime: bool = False) -> Transport:
    """Open `mega-sim://SCENE?seed=N&baud=250000&usb=on|off`."""
    scene, used, options = parse_url(url, seed, baud=("250000", "500000"), usb=("on", "off"))
    require_usual(scene.robot)
    usb = UsbBridge(used) if options["usb"] == "on" else None
    board = SimulatedMega(used, baud=int(options["baud"]), usb=usb)
    opened = EmulatorTransport(scene, board, seed=used, realtime=realtime, exchange_ms=1, name=url)
    opened.take_stops()
    return opened
