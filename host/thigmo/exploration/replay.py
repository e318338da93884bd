"""The localizer again over a run's raw record, from the frames that crossed the link.

Nothing is taken from contacts.json: the frames are decoded, zeros, lengths, peaks and triggers are
read off them as the live run did, and the same functions localize and map. So a newer localizer
can be tried on an old run, and a doubtful result can be checked.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from itertools import groupby
from typing import Any

from thigmo import __version__
from thigmo.config import SIDES, RobotConfig, Side
from thigmo.errors import RunFolderError
from thigmo.exploration.feel import check_method
from thigmo.exploration.met import lean, stall
from thigmo.exploration.obstacles import export_obstacles
from thigmo.exploration.plan import growth_zone
from thigmo.exploration.prior import kept_prior
from thigmo.exploration.stage import Interpreter
from thigmo.link import protocol as wire
from thigmo.link.clock import DeviceClock
from thigmo.link.framing import FrameError, decode
from thigmo.link.inbox import TelemetryFrame
from thigmo.record import Entry, Log, RunDocument, RunFolder
from thigmo.report import draw_map
from thigmo.robot import (
    SENSORS,
    GrowthWatcher,
    SensorTable,
    StandingWatch,
    SweepFrame,
    SweepResult,
    SweepWatcher,
    mask_of,
    peak_frame,
)
from thigmo.robot.readings import Floats

_OVERSAMPLE = wire.PARAMETERS["oversample_log2"].index
_ENABLED = wire.PARAMETERS["flex_enabled"].index
_ZEROED = 1 << 2  # of sensor_report.flags


@dataclass(frozen=True, slots=True)
class ReplayResult:
    """What the record says now."""

    document: RunDocument  # contacts and triggers found again; the truth is the run's own
    sweeps: int  # in the record
    bad_frames: int  # that could not be decoded
    truncated: bool  # the record is cut short
    gaps: int  # places at which the record is damaged
    missing: str  # the same in words, for the operator; empty if the record is whole

    def as_json(self) -> dict[str, Any]:
        """The object that `thigmo replay --json` prints."""
        facts = asdict(self)
        document = facts.pop("document")
        del facts["missing"]
        for stage in document["stages"]:
            del stage["shapes"]
        return {**document, **facts}


@dataclass
class _Sweep:
    """A sweep as it is read off the frames."""

    zone: int
    sides: set[Side]
    t_s: float
    watcher: SweepWatcher


class _Reader:
    """Reads the board's state off its frames, as the robot object does live."""

    def __init__(self, config: RobotConfig) -> None:
        self._config = config
        self.table = SensorTable.of(config)
        self._enabled = self.table.healthy.copy()
        self._standing: StandingWatch | None = None
        self._clock = DeviceClock()
        self._before = self.table  # the last zeroing
        self.zone = 0  # of the body pressure
        self._status: wire.StatusReport | None = None
        self._snapshots: list[SweepFrame] = []
        self._events: set[int] = set()
        self._last_sweep = (0, 0)
        self._swept = True  # the last sweep came to its end
        self._growing = self._peaked = False
        self.growth = GrowthWatcher()  # since the last sweep
        self.backed_off = False
        self.zeros_ahead = self.zeros()  # before and after the growth that was backed off from
        self.sweeps: list[_Sweep] = []
        self.bad = 0

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
                told = TelemetryFrame(frame.seq, entry.t_s, device_us, frame.payload)
                if self._standing is not None:
                    self._standing.telemetry(told)
                if self._growing:
                    self.growth.telemetry(told)
                elif watcher:
                    watcher.telemetry(told)
            case wire.GrowTo():
                if self.backed_off:
                    self.growth, self.backed_off = GrowthWatcher(), False
                self._growing = True
            case wire.RetractTo():
                self.backed_off = True
                self.zeros_ahead = self.zeros()
            case wire.Hello():
                self._events.clear()
            case wire.SelectZone():
                self.zone = message.zone
            case wire.StatusReport():
                self._status = message
            case wire.Arm():
                self._standing = StandingWatch(self._config, self.table.oversample)
            case wire.ParameterValue() if 0 <= message.index - _ENABLED < SENSORS:
                self._enabled[message.index - _ENABLED] = message.value
            case wire.ParameterValue() if message.index == _OVERSAMPLE:
                self.table = replace(self.table, oversample=1 << message.value)
            case wire.ZeroSensors():
                self._before = self.table
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
                if message.code == wire.EventCode.ACTIVITY_DONE:
                    self._swept, self._growing = True, False
            case wire.Vent() if watcher and not self._swept:
                watcher.rising = True  # cut short after its peak, or on the way up
                watcher.stopped |= not self._peaked
                self._swept = True
            case wire.Snapshot() if watcher and message.index < message.count:
                self._snapshot(message, watcher)

    def zeros(self) -> tuple[Floats, Floats]:
        """The zeros before the last zeroing and after it, as `Robot.zeros`."""
        return self._before.zeros, self.table.zeros

    def _device_s(self, t_us: int) -> float:
        return self._clock.unwrap(t_us) * 1e-6

    def _begin(self, command: wire.Sweep, t_s: float) -> None:
        self._swept = self._growing = self._peaked = False
        self.growth = GrowthWatcher()
        status = self._status
        mask, young, length = 0, 0, 0.0
        if status:
            young = status.everted_mask & mask_of(self.table.healthy & ~self._enabled)
            mask = status.everted_mask & status.settled_mask & status.zeroed_mask
            length = status.length_um / 1e4
        watcher = SweepWatcher(self.table, mask, length, young, self._standing)
        amplitudes = (command.left_cpsi, command.right_cpsi)
        sides = {side for side, top in zip(SIDES, amplitudes, strict=True) if top > 0}
        self.sweeps.append(_Sweep(self.zone, sides, t_s, watcher))

    def _snapshot(self, message: wire.Snapshot, watcher: SweepWatcher) -> None:
        if message.index == 0:
            self._snapshots = []
        if message.index != len(self._snapshots):
            return  # the reply to a repeated request
        self._snapshots.append(peak_frame(message, self._device_s(message.t_us)))
        if len(self._snapshots) == message.count:
            watcher.peaks.append(self._snapshots)


def replay(run: str | os.PathLike[str], *, method: str | None = None) -> ReplayResult:
    """Localize again from the raw record of a run folder.

    Writes `replay.json`, `replay.png`, `replay-obstacles.json` and `replay-map.yaml` with its
    picture into it.

    Args:
        run: its folder.
        method: of `thigmo.localize`; that of the run if not given.

    Raises:
        RunFolderError: no record, or one of another protocol schema.
        ConfigError: its robot.toml cannot be read.
    """
    folder = RunFolder(run)
    log = folder.read_log()  # first: a folder that is no run has none, and says so
    config = folder.read_config()
    reader = _read(folder, config, log)
    prior = kept_prior(folder)
    if method is not None:
        check_method(method)
    known = _document(folder, log)
    known = replace(known, method=method or known.method)
    found, table = Interpreter(config, prior, known.method), SensorTable.of(config)
    stages = []
    for looked, measured in _stages(reader.sweeps):
        sweep = looked[-1]
        result = SweepResult.joined([part.watcher.result() for part in looked])
        again = [part.watcher.result() for part in measured]
        feelings = found.feel(result, SweepResult.joined(again) if again else None, sweep.zone)
        found.add(feelings)
        length_cm = sweep.watcher.length_cm
        stages.append(found.entry(sweep.t_s, length_cm, result, feelings, sweep.zone))
    if reader.backed_off:
        grown = reader.growth.profile(reader.table)
        if (stalled := stall(*grown, table)) is not None:
            # A growth at another pressure than the length's was the trial of an earlier stall.
            usual = growth_zone(config, float(grown[0][0]), float(grown[0][-1]))
            found.map.add_met(stalled, moved_on=None if reader.zone == usual else False)
        elif (held := lean(*grown, *reader.zeros_ahead, table)) and held.released(*reader.zeros()):
            found.map.add_met(held)
    document = found.judged(replace(known, stages=stages))
    radius = config.body.radius_cm
    folder.write_document(document, "replay.json")
    export_obstacles(folder, document, radius_cm=radius, prior=prior, prefix="replay-")
    draw_map(document, folder.path / "replay.png", radius_cm=radius, prior=prior)
    return ReplayResult(
        document, len(reader.sweeps), reader.bad, log.truncated, log.gaps, log.missing
    )


def recorded_sweeps(run: str | os.PathLike[str]) -> list[SweepResult]:
    """The sweeps in a run's raw record, in their order, for who wants to localize otherwise.

    Raises as `replay` does.
    """
    folder = RunFolder(run)
    reader = _read(folder, folder.read_config(), folder.read_log())
    return [sweep.watcher.result() for sweep in reader.sweeps]


def _read(folder: RunFolder, config: RobotConfig, log: Log) -> _Reader:
    schema = log.metadata.get("schema_hash", "")
    if schema != f"{wire.SCHEMA_HASH:08x}":
        raise RunFolderError(
            f"{folder.path} was recorded with protocol schema {schema or 'unknown'}, and this is "
            f"{wire.SCHEMA_HASH:08x}",
            f"replay it with thigmo {log.metadata.get('thigmo', 'of its time')}",
        )
    reader = _Reader(config)
    for entry in log.entries:
        reader.take(entry)
    return reader


def _stages(sweeps: list[_Sweep]) -> Iterator[tuple[list[_Sweep], list[_Sweep]]]:
    """Each stage's sweeps that looked for contacts, and those that measured them.

    They follow each other at the same length; a side that is swept again is measured.
    """
    for _, group in groupby(sweeps, key=lambda each: round(each.watcher.length_cm, 1)):
        looked: list[_Sweep] = []
        measured: list[_Sweep] = []
        seen: set[Side] = set()
        for sweep in group:
            again = measured or seen & sweep.sides
            (measured if again else looked).append(sweep)
            seen |= sweep.sides
        yield looked, measured


def _document(folder: RunFolder, log: Log) -> RunDocument:
    """The replay's document without stages; name, truth, outcome are the run's own, if known."""
    recorded = log.entries[-1].t_s - log.entries[0].t_s if log.entries else 0.0
    try:
        known = folder.read_document()
    except RunFolderError:
        url, started = (log.metadata.get(name, "") for name in ("url", "started"))
        known = RunDocument(__version__, folder.path.name, url, started, "cut short")
    return replace(
        known,
        thigmo=__version__,
        outcome=f"replayed; {known.outcome}",
        robot_time_s=recorded,
        wall_time_s=0.0,
    )
