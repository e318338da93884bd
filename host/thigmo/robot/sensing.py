"""The sensors: settling, zeroing, reading them; a muscle held at a pressure meanwhile."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from thigmo.errors import CommandTimeoutError, LinkError
from thigmo.link import protocol as wire
from thigmo.robot.everting import Everting
from thigmo.robot.readings import SENSORS, Floats, in_mask, mask_of
from thigmo.robot.standing import StandingWatch
from thigmo.robot.state import Reading, Recording, SweepFrame
from thigmo.robot.sweeping import peak_frame

_OPEN, _SHORT = 1 << 3, 1 << 4  # of sensor_report.flags
_SETTLE_EXTRA_S = 30.0


class Sensing(Everting):
    """A robot that feels how it is bent."""

    @property
    def oversample(self) -> int:
        """Conversions that a raw reading sums."""
        return self._table.oversample

    def follow_settling(self) -> None:
        """Watch young sensors from now on, so that sweeps can use those that are set aside."""
        if self._standing is None:
            self._standing = StandingWatch(self.config, self.oversample)
            self._follow(self._standing.telemetry)

    def young_noise(self) -> Floats:
        """Standard error of what sensors set aside rest at, (10,), 1/cm; infinite if unknown."""
        if self._standing is None:
            return np.full(SENSORS, np.inf)
        at_s = self.status().t_s
        _, sigma = self._standing.rest(at_s, self._aside)
        return np.where(np.isnan(sigma), np.inf, sigma)

    def set_aside(self, mask: int) -> None:
        """Have the board leave out everted sensors of a mask, as if they were dead; 0 takes all in.

        Outputs must be off. Sensors that have not everted stay in use: the board refuses to bend
        the body while one lies in the tip's fold.
        """
        mask &= self.status().everted
        if mask == self._aside:
            return
        healthy = self._table.healthy
        enabled = [int(healthy[n] and not mask >> n & 1) for n in range(SENSORS)]
        self.set_parameter("flex_enabled", enabled)
        self._aside = mask

    @property
    def aside(self) -> int:
        """Mask of the sensors that were set aside."""
        return self._aside

    def wait_settled(
        self,
        progress: Callable[[float], None] = lambda left_s: None,
        sensors: int = (1 << SENSORS) - 1,
    ) -> None:
        """Wait until everted sensors of a mask are past their settling time.

        Args:
            progress: told the seconds that are left, about once a second.

        Raises:
            CommandTimeoutError: they do not settle in their time.
            RobotFaultError: a fault was latched meanwhile.
        """
        end = self.now() + self.config.sensors.settle_s + _SETTLE_EXTRA_S
        while waiting := (status := self.status()).everted & ~status.settled & sensors:
            if self.now() > end:
                raise CommandTimeoutError(
                    f"sensors {in_mask(waiting)} do not settle",
                    "check the board's parameter settle_ms",
                )
            reports = [self._client.request(wire.GetSensor(n)) for n in in_mask(waiting)]
            left_s = max(report.settle_left_ms for report in reports) / 1e3
            while left_s > 0:
                progress(left_s)
                self.wait(min(left_s, 1.0))
                left_s -= 1.0
            self.wait(0.02)

    def zero(self) -> int:
        """Average the everted sensors' readings into their zeros; returns the mask of these.

        Raises:
            CommandRefusedError: not vented, not settled, or drifting (`reason`).
        """
        mask = self.status().everted & mask_of(self._table.healthy) & ~self._aside
        self._before = self._table
        if mask:
            self._start(wire.ZeroSensors(mask))
            self._watch.finish(wire.Activity.ZEROING, 20.0)
        q8 = {n: self._client.request(wire.GetSensor(n)).zero_sum_q8 for n in in_mask(mask)}
        self._table = self._table.zeroed({sensor: zero / 256 for sensor, zero in q8.items()})
        self._decode()
        return mask

    def zeros(self) -> tuple[Floats, Floats]:
        """The zeros before the last zeroing and after it, (10,) each; NaN where there is none.

        In 1/cm, from where `GrowthWatcher.profile` counts.
        """
        return self._before.zeros, self._table.zeros

    def flex_circuit(self, sensor: int) -> tuple[bool, bool]:
        """Whether a flex sensor's circuit is open, and whether it is shorted, now."""
        flags = self._client.request(wire.GetSensor(sensor)).flags
        return bool(flags & _OPEN), bool(flags & _SHORT)

    def read(self, seconds: float = 0.5, *, despite_faults: bool = False) -> Reading:
        """Average telemetry over a while; `despite_faults` as for `wait`.

        Raises:
            LinkError: no telemetry came.
        """
        frames, flex = self._frames(seconds, despite_faults)
        pressures = [(f.left_cpsi / 100, f.right_cpsi / 100) for f in frames]
        left, right = np.mean(pressures, axis=0)
        return Reading(
            t_s=float(np.mean([self._client.device_s(f.t_us) for f in frames])),
            curvature=self._table.curvature(flex.mean(axis=0)),
            spread=self._table.curvature(flex).std(axis=0),
            left_psi=float(left),
            right_psi=float(right),
            length_cm=frames[-1].length_um / 1e4,
            frames=len(frames),
            resistance=self._table.resistance(flex.mean(axis=0)),
        )

    def record(self, seconds: float) -> Recording:
        """Keep every telemetry frame of a while.

        Raises:
            LinkError: no telemetry came.
        """
        frames, flex = self._frames(seconds)
        return Recording(
            t_s=np.array([self._client.device_s(frame.t_us) for frame in frames]),
            resistance=self._table.resistance(flex),
            left_psi=np.array([frame.left_cpsi / 100 for frame in frames]),
            right_psi=np.array([frame.right_cpsi / 100 for frame in frames]),
        )

    def _frames(
        self, seconds: float, despite_faults: bool = False
    ) -> tuple[list[wire.Telemetry], Floats]:
        """Telemetry of a while, and its raw flex readings (n, 10)."""
        frames: list[wire.Telemetry] = []
        with self._telemetry_to(lambda at_s, decode: frames.append(decode())):
            self.wait(seconds, despite_faults=despite_faults)
        if not frames:
            raise LinkError("no telemetry came", "check the parameter telemetry_ms")
        return frames, np.array([frame.flex_sum for frame in frames], dtype=np.float64)

    def press(
        self, *, left_psi: float = 0.0, right_psi: float = 0.0, ramp_psi_s: float = 0.0
    ) -> None:
        """Hold a muscle pressure (at most one side above zero); returns at once.

        A set point below the transducer's live zero (about 2.2 psi) vents that muscle; a slew rate
        of 0 is as configured.

        Raises:
            CommandRefusedError: a sensor is half everted, or a set point is above the limit.
        """
        ramp = round(ramp_psi_s * 100)
        self._request(wire.SetPressure(round(left_psi * 100), round(right_psi * 100), ramp))

    def snapshots(self) -> list[SweepFrame]:
        """The readings captured around the last peak of a sweep, in time order."""
        first = self._client.request(wire.GetSnapshot(0))
        rest = [self._client.request(wire.GetSnapshot(n)) for n in range(1, first.count)]
        return [peak_frame(one, self._client.device_s(one.t_us)) for one in (first, *rest)]
