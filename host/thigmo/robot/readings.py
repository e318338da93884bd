"""What a robot's sensors read: their zeros, which of them count, and telemetry averaged in units.

`Robot` hands its sensors' commands on to here. Values are in the order of the board's inputs.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from thigmo.errors import CommandTimeoutError, ConfigError, LinkError
from thigmo.link import protocol as wire
from thigmo.link.inbox import TelemetryFrame
from thigmo.record import FibreLine
from thigmo.robot.configuration import get_parameter, set_parameters
from thigmo.robot.creep import CreepWatch
from thigmo.robot.curvature import Floats, SensorTable, in_mask, mask_of
from thigmo.robot.fibre import FibreReading
from thigmo.robot.state import Reading, Recording, pressures_psi
from thigmo.robot.strains import Strains
from thigmo.robot.supervisor import OPEN, SHORT, Supervisor
from thigmo.wiring import Wiring

_FIBRE_ZERO_S = 1.0
_SETTLE_EXTRA_S = 30.0
_ZERO_S = 20.0  # within which the board has zeroed


class Readings:
    """The sensors of a robot.

    Attributes:
        table: the sensors as arrays, with their zeros.
        previous_zeros: the table before the last zeroing.
        aside: mask of the sensors that `set_aside` made the board leave out.
        creep: of sensors that everted since `follow_settling`; None before.
        strains: of a fibre that is read live.
        on_zero: called with the table after each change of the board's zeros.
    """

    def __init__(self, supervisor: Supervisor, wiring: Wiring) -> None:
        self.table = self.previous_zeros = SensorTable.laid_out(wiring)
        self.aside = 0
        self.creep: CreepWatch | None = None
        self.strains = Strains()
        self.on_zero: list[Callable[[SensorTable], None]] = []
        self._supervisor = supervisor
        self._link = supervisor.link
        self._wiring = wiring
        supervisor.fibre.on_line.append(self._take_strains)

    def use(self, wiring: Wiring) -> None:
        """Read this robot from now on, without zeros, by what its board sums."""
        self._wiring = wiring
        oversample = 1 << get_parameter(self._link, "oversample_log2")[0]
        self.table = SensorTable.laid_out(wiring, oversample)
        self.aside = 0

    def _take_strains(self, line: FibreLine) -> None:
        if line.zero:
            self.table = self.table.strained(line.t_s, line.strain_ue)
        else:
            self.strains.take(line)

    # Which sensors count.

    def follow_settling(self) -> None:
        """As `Robot.follow_settling`."""
        if self.creep is None:
            self.creep = CreepWatch(self._wiring, self.table.oversample)
            self._link.on_telemetry.append(self.creep.telemetry)

    def young_noise(self) -> Floats:
        """As `Robot.young_noise`."""
        if self.creep is None:
            return np.full(self.table.inputs, np.inf)
        _, sigma = self.creep.rest(self._supervisor.status().t_s, self.aside)
        return np.where(np.isnan(sigma), np.inf, sigma)

    def set_aside(self, mask: int) -> None:
        """As `Robot.set_aside`."""
        mask &= self._supervisor.status().everted
        if mask == self.aside:
            return
        healthy = self.table.healthy
        enabled = [int(healthy[n] and not mask >> n & 1) for n in range(self.table.inputs)]
        set_parameters(self._link, {"flex_enabled": enabled})
        self.aside = mask

    def wait_settled(self, progress: Callable[[float], None], sensors: int) -> None:
        """As `Robot.wait_settled`."""
        now, wait = self._link.now, self._supervisor.wait
        end = now() + self._wiring.config.board.settle_s + _SETTLE_EXTRA_S
        while waiting := self._settling(sensors):
            if now() > end:
                raise CommandTimeoutError(
                    f"sensors {in_mask(waiting)} do not settle",
                    "check the board's parameter settle_ms",
                )
            left_s = self.settles_s(waiting)
            while left_s > 0:
                progress(left_s)
                wait(min(left_s, 1.0))
                left_s -= 1.0
            wait(0.02)

    def settles_s(self, sensors: int) -> float:
        """As `Robot.settles_s`."""
        waiting = in_mask(self._settling(sensors))
        left = [self._link.request(wire.GetSensor(n)).settle_left_ms for n in waiting]
        return max(left, default=0) / 1e3

    def _settling(self, sensors: int) -> int:
        status = self._supervisor.status()
        return status.everted & ~status.settled & sensors

    # Zeros.

    def zero(self, sensors: int) -> int:
        """As `Robot.zero`."""
        supervisor = self._supervisor
        if supervisor.fibre.fitted:  # first: where it drifts, the board keeps its zeros
            supervisor.wait_vented()
            supervisor.require_fibre()
            began_s = self._link.now()
            supervisor.wait(_FIBRE_ZERO_S)
            supervisor.require_fibre().zero(began_s, supervisor.status().length_cm or 0.0)
        mask = supervisor.status().everted & mask_of(self.table.board.healthy) & ~self.aside
        mask &= sensors
        self.previous_zeros = self.table
        if mask:
            supervisor.start(wire.ZeroSensors(mask))
            supervisor.finish(wire.Activity.ZEROING, _ZERO_S)
        q8 = {n: self._link.request(wire.GetSensor(n)).zero_sum_q8 for n in in_mask(mask)}
        self.table = self.table.zeroed({sensor: zero / 256 for sensor, zero in q8.items()})
        for callback in self.on_zero:
            callback(self.table)
        return mask

    def circuit(self, sensor: int) -> tuple[bool, bool]:
        """As `Robot.flex_circuit`."""
        flags = self._link.request(wire.GetSensor(sensor)).flags
        return bool(flags & OPEN), bool(flags & SHORT)

    # Telemetry.

    def read(self, seconds: float, *, despite_faults: bool) -> Reading:
        """As `Robot.read`."""
        frames, flex = self._frames(seconds, despite_faults)
        table = self.table.board
        psi = np.mean([frame.pressure_cpsi for frame in frames], axis=0).tolist()
        return Reading(
            t_s=float(np.mean([self._link.device_s(frame.t_us) for frame in frames])),
            curvature=table.curvature(flex.mean(axis=0)),
            spread=table.curvature(flex).std(axis=0),
            pressure_psi=pressures_psi(psi, self._wiring),
            length_cm=frames[-1].length_um / 1e4,
            frames=len(frames),
            resistance=table.resistance(flex.mean(axis=0)),
        )

    def read_fibre(self, seconds: float) -> FibreReading:
        """As `Robot.read_fibre`."""
        self._supervisor.require_fibre()
        began_s, frames = self._link.now(), list[TelemetryFrame]()
        with self._supervisor.telemetry_to(frames.append):
            self._supervisor.wait(seconds)
        return self._supervisor.require_fibre().reading(frames, began_s)

    def record(self, seconds: float) -> Recording:
        """As `Robot.record`."""
        frames, flex = self._frames(seconds)
        return Recording(
            t_s=np.array([self._link.device_s(frame.t_us) for frame in frames]),
            resistance=self.table.resistance(flex),
            pressure_psi=np.array([pressures_psi(f.pressure_cpsi, self._wiring) for f in frames]),
        )

    def _frames(
        self, seconds: float, despite_faults: bool = False
    ) -> tuple[list[wire.Telemetry], Floats]:
        """Telemetry of a while, and its raw flex readings (n, inputs)."""
        supervisor = self._supervisor
        received: list[TelemetryFrame] = []
        with supervisor.telemetry_to(received.append):
            supervisor.wait(seconds, despite_faults=despite_faults)
            if not received:  # a busy computer may hear it late, and telemetry may be slow
                period_s = get_parameter(self._link, "telemetry_ms")[0] / 1e3
                supervisor.wait(max(1.0, 2 * period_s), despite_faults=despite_faults)
        if not received:
            raise LinkError("no telemetry came", "check the parameter telemetry_ms")
        frames = [frame.message for frame in received]
        if (count := len(frames[0].flex_sum)) != self.table.inputs:
            raise ConfigError(
                f"the robot of this board of {count} sensor inputs is not known",
                "send its robot.toml with `configure`",
            )
        return frames, np.array([frame.flex_sum for frame in frames], dtype=np.float64)
