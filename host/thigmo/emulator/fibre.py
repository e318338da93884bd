"""A fibre with gratings, and its interrogator, which sends lines of strains over TCP.

Temperature strains all gratings alike and drifts. Each grating has noise and a drift of its own, is
bent by the tip's fold as it everts, lies a little differently after each eversion, and loses its
peak now and then. The fibre is twisted about its axis. The format is that of
`thigmo.link.interrogator`.
"""

from __future__ import annotations

import socket
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from math import radians

import numpy as np
import numpy.typing as npt

from thigmo.config import FibreSensor
from thigmo.emulator.scene import Fibre
from thigmo.errors import ConfigError

Floats = npt.NDArray[np.float64]

_KEPT = 500  # lines for a host that does not read
_UE_PER_K = 1.1  # apparent strain per kelvin if each core is read by itself (config.FibreSensor)
_QUEUE = 65_536  # bytes for a program that does not read; beyond, it is cut off


class EmulatedFibre:
    """The gratings of a robot, read every few steps; random by `rng`.

    Attributes:
        lost_gratings: numbers of the readings that have lost their peak.
        noisy: microstrain that a fault adds, one sigma, by number.
        silent: whether the interrogator sends nothing.
    """

    name = "emulator"

    def __init__(
        self, parameters: Fibre, gratings: Sequence[FibreSensor], step_s: float,
        rng: np.random.Generator, fold_bend: float = 0.0,
    ) -> None:  # fmt: skip
        self._parameters, self._rng, self._step_s = parameters, rng, step_s
        self._every = max(1, round(1.0 / (parameters.lines_hz * step_s)))
        self._ends = np.array([grating.center_cm + grating.span_cm / 2 for grating in gratings])
        self._spans = np.array([max(grating.span_cm, 1e-9) for grating in gratings])
        self._fold_bend = fold_bend  # 1/cm, which a grating sees while the tip's fold passes
        twist = radians(parameters.twist_deg) * rng.standard_normal()
        angles = np.radians([grating.angle_deg % 180.0 for grating in gratings])
        scale = np.array([grating.scale_per_ue for grating in gratings])
        self._per_bend = np.sin(angles + twist) / scale  # microstrain for 1/cm in the plane
        self._zero = np.array([grating.zero_ue for grating in gratings])
        self._seat = np.zeros(len(gratings))
        self._drift = np.zeros(len(gratings))
        self._everted = np.zeros(len(gratings), dtype=np.bool_)
        self._ramp_k_s = parameters.warming_k_min / 60 * rng.standard_normal()
        self._warm_k = 0.0
        self.lost_gratings: set[int] = set()
        self.noisy: dict[int, float] = {}
        self.silent = False
        self._lines: deque[bytes] = deque(maxlen=_KEPT)

    def step(self, number: int, curvature: Floats, length_cm: float) -> None:
        """Advance to a step. `curvature` has the gratings' means (n,), 1/cm; 0 inside the tail."""
        if not len(self._ends) or number % self._every:
            return
        parameters, rng, count = self._parameters, self._rng, len(self._ends)
        dt_s = self._every * self._step_s
        everted = self._ends <= length_cm
        emerged = everted & ~self._everted
        self._everted = everted
        self._seat[emerged] = parameters.seat_ue * rng.standard_normal(int(emerged.sum()))
        self._drift += parameters.walk_ue_root_s * dt_s**0.5 * rng.standard_normal(count)
        walk = parameters.warm_k_root_s * dt_s**0.5 * rng.standard_normal()
        self._warm_k += self._ramp_k_s * dt_s + walk
        strain = self._zero + self._seat + self._drift + _UE_PER_K * self._warm_k
        passed = np.clip(1.0 + (length_cm - self._ends) / self._spans, 0.0, 1.0)
        fold = 0.5 * self._fold_bend * (1.0 - np.cos(2.0 * np.pi * passed))
        strain += self._per_bend * np.where(everted, curvature, fold)
        strain += parameters.noise_ue * rng.standard_normal(count)
        for grating, sigma in self.noisy.items():
            strain[grating] += sigma * rng.standard_normal()
        strain[rng.random(count) < parameters.dropout] = np.nan
        strain[[*self.lost_gratings]] = np.nan
        if not self.silent:
            values = ",".join(f"{value:.2f}" for value in strain)
            self._lines.append(f"{number * self._step_s:.3f},{values}\n".encode())

    def read(self) -> bytes:
        """Lines since the last reading."""
        data = b"".join(self._lines)
        self._lines.clear()
        return data

    def close(self) -> None:
        """Do nothing: the fibre belongs to the robot."""


class LineServer:
    """Serves a fibre's lines to all who connect to `host:port`; ConfigError if it cannot."""

    def __init__(self, address: str, fibre: EmulatedFibre) -> None:
        self._fibre = fibre
        host, _, port = address.rpartition(":")
        try:
            self._listener = socket.create_server((host, int(port)))
        except OSError as error:
            raise ConfigError(
                f"cannot serve the fibre at {address}: {error}",
                "give the scene's robot another `interrogator`, such as 127.0.0.1:7400",
            ) from error
        self._listener.setblocking(False)
        self._heard: dict[socket.socket, bytearray] = {}

    def exchange(self) -> None:
        """Accept connections and send pending lines; a client that does not read is dropped."""
        with suppress(OSError):
            joined, _ = self._listener.accept()
            joined.setblocking(False)
            self._heard[joined] = bytearray(b"# t_s, then microstrain\n")
        data = self._fibre.read()
        for reader, left in [*self._heard.items()]:
            left += data
            try:
                del left[: reader.send(left)]
            except BlockingIOError:
                pass
            except OSError:
                left += bytes(_QUEUE + 1)
            if len(left) > _QUEUE:
                reader.close()
                del self._heard[reader]

    def close(self) -> None:
        """Close all; may be called twice."""
        for connection in (self._listener, *self._heard):
            connection.close()
