"""Reads a run's steps and readings off its record, for the replay and for a run that is resumed.

The notes are the run's steps (`run_knowledge`), with their numbers; the frames that crossed the
link hold what the run read: zeros, lengths, peaks and triggers, by the same watchers as live.
Nothing is taken from contacts.json.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace

from thigmo.config import SAME_LENGTH_CM, RobotConfig, Side
from thigmo.errors import RunFolderError
from thigmo.exploration.methods import FIELD
from thigmo.exploration.run_knowledge import STEPS, RunKnowledge
from thigmo.link import protocol as wire
from thigmo.link.clock import DeviceClock
from thigmo.link.framing import FrameError, decode
from thigmo.link.inbox import TelemetryFrame
from thigmo.record import Entry, FibreLine, Log, Note, Obstacle, RunFolder
from thigmo.robot import (
    CreepWatch,
    GrowthWatcher,
    Profile,
    SensorTable,
    Strains,
    SweepFrame,
    SweepResult,
    SweepWatcher,
    mask_of,
    peak_frame,
)
from thigmo.robot.curvature import Floats
from thigmo.wiring import Wiring

_ZEROED = 1 << 2  # of sensor_report.flags


@dataclass
class RecordedSweep:
    """A sweep as it is read off the frames."""

    body_pressure: int
    sides: set[Side]
    t_s: float
    watcher: SweepWatcher


class _Frames:
    """Reads the board's state off its frames, as the robot object does live."""

    def __init__(self, wiring: Wiring) -> None:
        self._wiring = wiring
        self.table = SensorTable.laid_out(wiring)
        self._enabled = self.table.board.healthy.copy()
        rows = wire.parameters(**wiring.size.capacity)
        self._first, self._oversample = (rows[n].index for n in ("flex_enabled", "oversample_log2"))
        self._creep: CreepWatch | None = None
        self._clock = DeviceClock()
        self._previous_table = self.table  # the last zeroing
        self.body_pressure = 0  # of the body pressure
        self._status: wire.StatusReport | None = None
        self._snapshots: list[SweepFrame] = []
        self._events: set[int] = set()
        self._last_sweep = (0, 0)
        self._swept = True  # the last sweep came to its end
        self.growing = self._peaked = False
        self._strains = Strains()
        self.grows()
        self.sweeps: list[RecordedSweep] = []
        self.bad = 0

    def grows(self) -> None:
        """A stage begins, or is tried again."""
        self.growth = GrowthWatcher(strains=self._strains)

    def strained(self, line: FibreLine) -> None:
        """Take a line of a fibre's strains, or their zeros."""
        if line.zero:
            self.table = self.table.strained(line.t_s, line.strain_ue)
        else:
            self._strains.take(line)

    def take(self, entry: Entry) -> None:
        """Take one frame of the record, in its order."""
        watcher = self.sweeps[-1].watcher if self.sweeps else None
        try:
            frame = decode(entry.frame)
            message = frame.message()
        except FrameError:
            self.bad += 1
            return
        match message:
            case wire.Telemetry():
                device_us = self._clock.unwrap(message.t_us)
                telemetry = TelemetryFrame(frame.seq, entry.t_s, device_us, frame.payload)
                if self._creep is not None:
                    self._creep.telemetry(telemetry)
                if self.growing:
                    self.growth.telemetry(telemetry)
                elif watcher:
                    watcher.telemetry(telemetry)
            case wire.GrowTo():
                self.growing = True
            case wire.Hello():
                self._events.clear()
            case wire.SelectZone():
                self.body_pressure = message.zone
            case wire.StatusReport():
                self._status = message
            case wire.Arm():
                self._creep = CreepWatch(self._wiring, self.table.oversample)
            case wire.ParameterValue() if 0 <= message.index - self._first < len(self._enabled):
                self._enabled[message.index - self._first] = message.value
            case wire.ParameterValue() if message.index == self._oversample:
                self.table = replace(self.table, oversample=1 << message.value)
            case wire.ZeroSensors():
                self._previous_table = self.table
            case wire.SensorReport() if message.flags & _ZEROED:
                self.table = self.table.zeroed({message.sensor: message.zero_sum_q8 / 256})
            case wire.Sweep() if (frame.session, frame.seq) != self._last_sweep:
                # A repeat of the same command, whose reply was lost, is no other sweep.
                self._last_sweep = (frame.session, frame.seq)
                self._begin(message, entry.t_s)
            case wire.Event() if message.number not in self._events:
                self._events.add(message.number)
                if message.code == wire.EventCode.CONTACT and watcher:
                    watcher.triggered(message, self._device_s(message.t_us))
                self._peaked |= message.code == wire.EventCode.PEAK
                self._swept |= message.code == wire.EventCode.ACTIVITY_DONE
            case wire.Vent() if watcher and not self._swept:
                watcher.rising = True  # cut short after its peak, or on the way up
                watcher.stopped |= not self._peaked
                watcher.end()
                self._swept = True
            case wire.Snapshot() if watcher and message.index < message.count:
                self._snapshot(message, watcher)

    def profile(self) -> Profile:
        """Lengths of the stage's growth, and what the sensors read at each."""
        return self.growth.profile(self.table)

    def zeros(self) -> tuple[Floats, Floats]:
        """The zeros before the last zeroing and after it, as `Robot.zeros`."""
        return self._previous_table.board.zeros, self.table.board.zeros

    def _device_s(self, t_us: int) -> float:
        return self._clock.unwrap(t_us) * 1e-6

    def _begin(self, command: wire.Sweep, t_s: float) -> None:
        self._swept = self.growing = self._peaked = False
        status = self._status
        mask, young, length = 0, 0, 0.0
        if status:
            young = status.everted_mask & mask_of(self.table.board.healthy & ~self._enabled)
            mask = status.everted_mask & status.settled_mask & status.zeroed_mask
            length = status.length_um / 1e4
        muscles = self._wiring.config.muscle_sides
        watcher = SweepWatcher(
            self.table, mask, length, young, self._creep, sides=muscles, strains=self._strains
        )
        pressed = zip(muscles, command.amplitude_cpsi, strict=False)
        sides = {side for side, top in pressed if top > 0}
        self.sweeps.append(RecordedSweep(self.body_pressure, sides, t_s, watcher))

    def _snapshot(self, message: wire.Snapshot, watcher: SweepWatcher) -> None:
        if message.index == 0:
            self._snapshots = []
        if message.index != len(self._snapshots):
            return  # the reply to a repeated request
        at_s = self._device_s(message.t_us)
        self._snapshots.append(peak_frame(message, at_s, self._wiring.config.muscle_sides))
        if len(self._snapshots) == message.count:
            watcher.peaks.append(self._snapshots)


class RecordedRun:
    """A run as its records tell it: its own, and before it those of the runs that it resumes.

    Attributes:
        logs: its records (`RunFolder.read_logs`), oldest first.
        knowledge: what the run knew at the end of its record.
        sweeps: of all records.
        bad: frames that could not be decoded.

    Raises RunFolderError: a record of another protocol schema, or without the run's steps.
    """

    def __init__(
        self,
        folder: RunFolder,
        logs: list[Log],
        config: RobotConfig,
        prior: Sequence[Obstacle] = (),
        method: str = FIELD,
    ) -> None:
        self.logs = logs
        wiring = Wiring.laid_out(config)
        self.knowledge = RunKnowledge(wiring, prior, method)
        self.sweeps: list[RecordedSweep] = []
        self.bad = 0
        for log in self.logs:
            _check(folder, log)
            frames = _Frames(wiring)
            self._read(log, frames)
            if frames.sweeps and all(note.facts["topic"] != "step" for note in log.notes):
                raise RunFolderError(
                    f"the record of {folder.path} has sweeps, but none of the run's steps",
                    "read its sweeps with thigmo.exploration.recorded.recorded_sweeps",
                )

    def _read(self, log: Log, frames: _Frames) -> None:
        taken = 0
        for item in log.items:
            if isinstance(item, Entry):
                frames.take(item)
            elif isinstance(item, FibreLine):
                frames.strained(item)
            else:
                frames.growing = False  # a run that notes something has ended its growth
                new = _last_length(frames.sweeps[taken:])
                taken = len(frames.sweeps) if self._step(item, frames, new) else taken
        self.sweeps += frames.sweeps
        self.bad += frames.bad

    def _step(self, note: Note, frames: _Frames, new: list[RecordedSweep]) -> bool:
        """Take a step of the run; whether it has used the sweeps that are new since the last.

        A step whose note is damaged, or whose sweeps the record has lost, is left out.
        """
        name, numbers = str(note.facts.get("step")), note.facts.get("numbers")
        step = STEPS.get(name)
        if step is None or not isinstance(numbers, dict) or set(numbers) != set(step.numbers):
            return False
        if name == RunKnowledge.growth_begins.__name__:
            frames.grows()
        readings: list[object] = []
        for reading in step.readings:
            match reading:
                case "profile":
                    readings.append(frames.profile())
                case "zeros":
                    readings.append(frames.zeros())
                case "sweep" if new:
                    readings.append(_joined(new))
                case _:
                    return False
        getattr(self.knowledge, name)(*readings, **numbers)
        return "sweep" in step.readings


def _joined(sweeps: list[RecordedSweep]) -> SweepResult:
    return SweepResult.joined([sweep.watcher.result() for sweep in sweeps])


def _last_length(sweeps: list[RecordedSweep]) -> list[RecordedSweep]:
    """Those at the length of the last: where notes are lost, an earlier stage's are before them."""
    if not sweeps:
        return []
    length_cm = sweeps[-1].watcher.length_cm
    return [sweep for sweep in sweeps if abs(sweep.watcher.length_cm - length_cm) < SAME_LENGTH_CM]


def _check(folder: RunFolder, log: Log) -> None:
    if not log.items and not log.metadata:
        raise RunFolderError(
            f"the record of {folder.path} is empty", "its run ended before it began: run it again"
        )
    if "schema_hash" not in log.metadata:
        raise RunFolderError(
            f"the record of {folder.path} does not say which robot it is of",
            "its first block is damaged: take the run from a backup, or run it again",
        )


def recorded_sweeps(run: str | os.PathLike[str]) -> list[SweepResult]:
    """The sweeps in a run's raw record, in their order, for programs that localize otherwise.

    Raises as `replay` does.
    """
    folder = RunFolder(run)
    frames, log = _Frames(Wiring.laid_out(folder.read_config())), folder.read_log()
    _check(folder, log)
    for item in log.items:
        if isinstance(item, Entry):
            frames.take(item)
        elif isinstance(item, FibreLine):
            frames.strained(item)
    return [sweep.watcher.result() for sweep in frames.sweeps]
