"""What telemetry and events show while the robot grows or sweeps.

Shared by the live robot and the replay of a record, so that both give the same numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from thigmo.config import Side
from thigmo.link import protocol as wire
from thigmo.link.inbox import TelemetryFrame
from thigmo.record import Truth
from thigmo.robot.creep import CreepWatch
from thigmo.robot.curvature import Floats, SensorTable, mask_of
from thigmo.robot.idle_pressure import UNBENT_CPSI
from thigmo.robot.state import ContactTrigger, Peak, SweepFrame, SweepResult
from thigmo.robot.strains import Strains
from thigmo.robot.sweep import FRAME_SPACING_S

_PEAK_READINGS = 10  # thesis: ten


class Profile(NamedTuple):
    """What the sensors read in a growth."""

    t_s: Floats  # (n,) device time
    length_cm: Floats  # (n,) everted, by the encoder
    bend: Floats  # (n, inputs) readings without a zero, 1/cm


@dataclass
class GrowthWatcher:
    """What the sensors say while the tip's fold passes through them: thinned telemetry of one
    growth or several in a row."""

    t_s: list[float] = field(default_factory=list)  # device time
    length_cm: list[float] = field(default_factory=list)  # everted, by the spool's encoder
    flex_sum: list[tuple[int, ...]] = field(default_factory=list)  # raw readings
    strains: Strains = field(default_factory=Strains)  # beside it
    _lines: int = 0  # of strains, that came before the last frame
    _next_s: float = 0.0

    def telemetry(self, frame: TelemetryFrame) -> None:
        """Take a frame; one in fifty milliseconds is decoded."""
        if frame.device_s >= self._next_s:
            self._next_s = frame.device_s + FRAME_SPACING_S
            self.t_s.append(frame.device_s)
            self.length_cm.append(frame.message.length_um / 1e4)
            self.flex_sum.append(frame.message.flex_sum)
            self._lines = self.strains.count

    def profile(self, table: SensorTable) -> Profile:
        """Times, lengths and readings so far."""
        sums: Floats = np.asarray(self.flex_sum, dtype=np.float64)
        t_s = np.asarray(self.t_s)
        raw = self.strains.beside(table, sums.reshape(-1, table.inputs), t_s, self._lines)
        return Profile(t_s, np.asarray(self.length_cm), table.unzeroed(raw))


def peak_frame(reply: wire.Snapshot, t_s: float, sides: Sequence[Side]) -> SweepFrame:
    """A reading that the board captured at a peak, in host units; `t_s` is its unwrapped time.

    `sides` are those to which the muscles bend the body.
    """
    free = reply.free_e5 / 1e5
    excess = reply.base_e5 / 1e5 - free
    side = sides[reply.muscle]
    return SweepFrame(side, t_s, reply.lagged_cpsi / 100, free, excess, reply.flex_sum)


@dataclass
class SweepWatcher:
    """Collects a sweep's frames, triggers and peaks."""

    table: SensorTable
    sensors: int  # mask of the board's that were everted, settled and zeroed when it began
    length_cm: float  # everted length
    # mask of those everted and not settled, to be used as far as `creep` knows them
    young: int = 0
    creep: CreepWatch | None = None  # what they rest at
    # the sweep is cut short after its first peak; what comes later does not count
    rising: bool = False
    sides: Sequence[Side] = ()  # to which the muscles bend the body
    strains: Strains = field(default_factory=Strains)  # beside it
    stopped: bool = False  # the sweep was stopped on the way up; its last half second is its peak
    triggers: list[ContactTrigger] = field(default_factory=list)
    peaks: list[list[SweepFrame]] = field(default_factory=list)  # captured readings of each
    frames: list[SweepFrame] = field(default_factory=list)  # thinned telemetry
    _next_s: float = 0.0
    _lines: int | None = None  # of strains, at the sweep's end

    def __post_init__(self) -> None:
        self.sensors |= self.table.gratings

    def end(self) -> None:
        """The sweep is over: later lines of strains do not count."""
        if self._lines is None:
            self._lines = self.strains.count

    def triggered(self, event: wire.Event, t_s: float) -> None:
        """Take the event of a contact, of device time `t_s`."""
        if not self.stopped:
            self.triggers.append(ContactTrigger(self.sides[event.arg], t_s, event.value / 1e5))

    def telemetry(self, frame: TelemetryFrame) -> None:
        """Take a frame; one in fifty milliseconds is decoded."""
        t_s = frame.device_s
        if self.stopped or t_s < self._next_s:
            return
        self._next_s = t_s + FRAME_SPACING_S
        row = frame.message
        pressure = max(row.pressure_cpsi)
        if pressure >= UNBENT_CPSI:
            side = self.sides[row.pressure_cpsi.index(pressure)]
            free, excess = row.free_e5 / 1e5, (row.base_e5 - row.free_e5) / 1e5
            self.frames.append(SweepFrame(side, t_s, pressure / 100, free, excess, row.flex_sum))

    def result(self, truth: Truth | None = None, *, so_far: bool = False) -> SweepResult:
        """What was collected; `so_far`: the sweep goes on, and its peak is taken to be now."""
        cut = self.rising and self.peaks and self.peaks[0]
        end_s = max(reading.t_s for reading in self.peaks[0]) if cut else np.inf
        frames = [frame for frame in self.frames if frame.t_s <= end_s]
        triggers = [trigger for trigger in self.triggers if trigger.t_s <= end_s]
        last = [self.frames[-_PEAK_READINGS:]] if so_far or self.stopped else []
        peaks = [self.average(readings) for readings in self.peaks or last if readings]
        curvature = self.table.curvature(self._raw(frames))
        return SweepResult(triggers, peaks, frames, curvature, self.sensors, truth)

    def average(self, readings: Sequence[SweepFrame]) -> Peak:
        """The average of a peak's readings."""
        raw = self._raw(readings).mean(axis=0)
        at_s = float(np.mean([s.t_s for s in readings]))
        curvature = self.table.curvature(raw)
        added = np.zeros(len(curvature))
        sensors = self.sensors
        if self.creep is not None and self.young:
            late, sigma = self.creep.curvature(raw[: self.table.inputs], at_s, self.young)
            settled = np.flatnonzero(np.isfinite(late))
            curvature[settled], added[settled] = late[settled], sigma[settled]
            sensors |= mask_of(np.isfinite(late))
        return Peak(
            side=readings[0].side,
            t_s=at_s,
            length_cm=self.length_cm,
            curvature=curvature,
            free_curvature=float(np.mean([s.free_curvature for s in readings])),
            pressure_psi=float(np.mean([s.pressure_psi for s in readings])),
            sensors=sensors,
            count=len(readings),
            added_noise=added,
            warmth=self.table.warmth(at_s),
        )

    def _raw(self, frames: Sequence[SweepFrame]) -> Floats:
        """Raw readings of frames (n, rows)."""
        sums: Floats = np.array([f.flex_sum for f in frames], dtype=np.float64)
        t_s = np.array([f.t_s for f in frames])
        sums = sums.reshape(-1, self.table.inputs)
        return self.strains.beside(self.table, sums, t_s, self._lines)
