"""A board without firmware, for tests of what surrounds it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


class SilentBoard:
    """Keeps what it is given; its outputs are what a test sets."""

    def __init__(self) -> None:
        self.drive = (0, 0)
        self.drive_enabled = (False, False)
        self.motor = 0
        self.braked = True
        self.air = (False, False)
        self.motor_enables = (False, False)
        self.eeprom = b""
        self.now_us = 0
        self.written = bytearray()
        self.sending = bytearray()
        self.analog: list[npt.NDArray[np.float64]] = []
        self.encoder: list[tuple[float, float]] = []
        self.supply: list[int] = []
        self.estop: list[bool] = []
        self.resets: list[int] = []
        self.cuts: list[int] = []
        self.hung = 0
        self.noise = np.zeros(16)

    def step(self, ticks: int, /) -> None:
        self.now_us += 1000 * ticks

    def write(self, data: bytes, /) -> None:
        self.written += data

    def read(self) -> bytes:
        data = bytes(self.sending)
        self.sending.clear()
        return data

    def set_analog(self, counts: npt.NDArray[np.float64], /) -> None:
        self.analog.append(counts.copy())

    def set_adc_noise(self, sigma: npt.NDArray[np.float64], /) -> None:
        self.noise = sigma

    def set_encoder(self, start: float, end: float, /) -> None:
        self.encoder.append((start, end))

    def set_supply_mv(self, millivolt: int, /) -> None:
        self.supply.append(millivolt)

    def set_estop(self, pressed: bool, /) -> None:
        self.estop.append(pressed)

    def set_motor_power(self, on: bool, /) -> None:
        self.motor_power = on

    def cut_power_after(self, n_bytes: int, /) -> None:
        self.cuts.append(n_bytes)

    def reset(self, cause: int, /) -> None:
        self.resets.append(cause)

    def hang(self) -> None:
        self.hung += 1
