"""A sweep while it runs: triggers noted, peaks fetched before the next half overwrites them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from thigmo.config import SIDES, Side
from thigmo.link import protocol as wire
from thigmo.record import Truth
from thigmo.robot.peaks import SweepConditions, average_peak
from thigmo.robot.readings import SENSORS, Floats
from thigmo.robot.state import ContactTrigger, SnapshotReading, SweepFrame, SweepResult

_FRAME_SPACING_S = 0.05
_IDLE_CPSI = 10
_PEAK_READINGS = 10  # thesis: ten


@dataclass
class SweepWatcher:
    """Collects what a sweep tells, from its events and its telemetry.

    Attributes:
        device_s: unwraps the device's time.
        fetch: reads the captured peak from the board.
        conditions: what was known of the sensors at its beginning.
        triggers, peaks, frames: what was collected.
        rising: the sweep is cut short after its first peak; what comes later does not count.
        stopped: the sweep was stopped on the way up; its last half second is its peak.
    """

    device_s: Callable[[int], float]
    fetch: Callable[[Side], list[SnapshotReading]]
    conditions: SweepConditions
    triggers: list[ContactTrigger] = field(default_factory=list)
    peaks: list[list[SnapshotReading]] = field(default_factory=list)
    frames: list[SweepFrame] = field(default_factory=list)
    rising: bool = False
    stopped: bool = False
    _next_s: float = 0.0

    def event(self, event: wire.Event) -> None:
        """Take one event of the sweep."""
        if self.stopped:
            return
        if event.code == wire.EventCode.CONTACT:
            self.triggers.append(
                ContactTrigger(SIDES[event.arg], self.device_s(event.t_us), event.value / 1e5)
            )
        elif event.code == wire.EventCode.PEAK:
            self.peaks.append(self.fetch(SIDES[event.arg]))

    def result(self, truth: Truth | None = None, *, so_far: bool = False) -> SweepResult:
        """What was collected, in curvature.

        Args:
            truth: what the emulator knew at the peaks.
            so_far: the sweep goes on, and its peak is taken to be now.
        """
        end_s = self._end_s()
        frames = [frame for frame in self.frames if frame.t_s <= end_s]
        triggers = [trigger for trigger in self.triggers if trigger.t_s <= end_s]
        last = [self._last()] if so_far or self.stopped else []
        peaks = [average_peak(shots, self.conditions) for shots in self.peaks or last if shots]
        sums: Floats = np.array([f.flex_sum for f in frames], dtype=np.float64)
        curvature = self.conditions.curvature(sums.reshape(-1, SENSORS))
        return SweepResult(triggers, peaks, frames, curvature, self.conditions.sensors, truth)

    def _last(self) -> list[SnapshotReading]:
        """The last frames as readings, as many as a peak has, and as far apart."""
        return [
            SnapshotReading(
                f.side,
                f.t_s,
                f.flex_sum,
                f.pressure_psi,
                f.pressure_psi,
                f.free_curvature + f.excess,
                f.free_curvature,
            )
            for f in self.frames[-_PEAK_READINGS:]
        ]

    def _end_s(self) -> float:
        """Device time of the last instant that counts."""
        if not self.rising or not self.peaks or not self.peaks[0]:
            return float("inf")
        return max(reading.t_s for reading in self.peaks[0])

    def telemetry(self, t_s: float, decode: Callable[[], wire.Telemetry]) -> None:
        """Take a telemetry frame of device time `t_s`; one in fifty milliseconds is decoded."""
        if self.stopped or t_s < self._next_s:
            return
        self._next_s = t_s + _FRAME_SPACING_S
        frame = decode()
        side: Side = "left" if frame.left_cpsi >= frame.right_cpsi else "right"
        pressure = max(frame.left_cpsi, frame.right_cpsi)
        if pressure < _IDLE_CPSI:
            return
        touched = any(trigger.side == side for trigger in self.triggers)
        excess = (frame.base_e5 - frame.free_e5) / 1e5
        self.frames.append(
            SweepFrame(
                side,
                t_s,
                pressure / 100,
                frame.free_e5 / 1e5,
                excess,
                touched,
                tuple(frame.flex_sum),
            )
        )
