"""What the methods of a robot return: status, readings, peaks, sweeps."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from operator import and_

import numpy as np

from thigmo.config import Side
from thigmo.record import Truth
from thigmo.robot.curvature import Floats
from thigmo.wiring import Wiring


def pressures_psi(cpsi: Sequence[float], wiring: Wiring) -> tuple[float, ...]:
    """Pressures (psi) of the robot's muscles, of those (0.01 psi) that the board has."""
    return tuple(pressure / 100 for pressure in cpsi[: len(wiring.config.muscles)])


@dataclass(frozen=True, slots=True)
class RobotStatus:
    """The board's whole state."""

    state: str  #: its name in the schema
    activity: str  #: its name in the schema
    body_pressure: int | None  #: its number, None if the board does not know it
    faults: tuple[str, ...]  #: names of latched faults
    conditions: frozenset[str]  #: names of the condition bits that are set
    t_s: float  #: device time
    length_cm: float | None  #: everted length, None if unknown
    pressure_psi: tuple[float, ...]  #: of each muscle
    everted: int  #: bit mask of sensors that have everted, by input
    settled: int  #: bit mask of those past their settling time
    zeroed: int  #: bit mask of those with a zero
    config_generation: int  #: of the stored configuration, 0 = none
    supply_v: float  #: the board's supply, as it measures it
    encoder_errors: int  #: illegal transitions of the spool's encoder since the board's start


@dataclass(frozen=True, slots=True)
class Reading:
    """Readings averaged over some seconds; a value for each of the board's flex inputs."""

    t_s: float  #: device time at the middle of these seconds
    curvature: Floats  #: shape (10,), 1/cm; NaN without a zero
    spread: Floats  #: standard deviation of a single telemetry reading, shape (10,), 1/cm
    pressure_psi: tuple[float, ...]  #: mean, of each muscle
    length_cm: float  #: everted length by the encoder
    frames: int  #: how many were averaged
    resistance: Floats  #: shape (10,), ohm; NaN where the circuit is open


@dataclass(frozen=True, slots=True)
class Recording:
    """Every telemetry frame of some seconds."""

    t_s: Floats  # device times, shape (n,)
    resistance: Floats  # of each sensor, shape (n, 10), ohm
    pressure_psi: Floats  # of each muscle, shape (n, muscles)


@dataclass(frozen=True, slots=True)
class Peak:
    """The average of a sweep's peak readings."""

    side: Side  # the inflated muscle
    t_s: float  # device time at the middle
    length_cm: float  # everted length
    curvature: Floats  # of each sensor, shape (10,), 1/cm
    free_curvature: float  # by the map, at the lag-filtered pressure, signed, 1/cm
    pressure_psi: float  # lag-filtered pressure of the active muscle
    sensors: int  # mask of sensors everted and settled and zeroed, or young with a known rest
    count: int  # readings averaged
    # of young sensors, the standard error of their resting value; 0 for others; (10,), 1/cm
    added_noise: Floats = field(default_factory=lambda: np.zeros(10))
    warmth: float = 1.0  # by how much more than stated temperature may have strained a fibre


def mean_peak(peaks: Sequence[Peak]) -> Peak:
    """Several sweeps' peaks of a side at one length, averaged, with the sensors that all had.

    The error of a young sensor's resting value is common to them, so it is not averaged away.
    """
    first, *others = peaks
    if not others:
        return first
    return replace(
        first,
        curvature=np.mean([peak.curvature for peak in peaks], axis=0),
        free_curvature=float(np.mean([peak.free_curvature for peak in peaks])),
        pressure_psi=float(np.mean([peak.pressure_psi for peak in peaks])),
        sensors=reduce(and_, (peak.sensors for peak in peaks)),
        count=sum(peak.count for peak in peaks),
        added_noise=np.mean([peak.added_noise for peak in peaks], axis=0),
        warmth=max(peak.warmth for peak in peaks),
    )


@dataclass(frozen=True, slots=True)
class ContactTrigger:
    """The moment at which the board's contact trigger fired."""

    side: Side  # inflated muscle
    t_s: float  # device time
    excess_per_cm: float  # base minus free curvature


@dataclass(frozen=True, slots=True)
class SweepFrame:
    """One instant of a sweep."""

    side: Side  # inflated muscle
    t_s: float  # device time
    pressure_psi: float  # its measured pressure; of a captured peak's, filtered by the lag
    free_curvature: float  # by the map, signed, 1/cm
    excess: float  # base curvature of the inactive side minus free curvature, 1/cm
    flex_sum: tuple[int, ...] = ()  # raw readings


@dataclass(frozen=True, slots=True)
class SweepResult:
    """Readings, triggers and peaks of a sweep."""

    triggers: list[ContactTrigger] = field(default_factory=list)  #: the board's contact triggers
    peaks: list[Peak] = field(default_factory=list)  #: one average for each side that was swept
    frames: list[SweepFrame] = field(default_factory=list)  #: thinned telemetry of the sweep
    #: of each sensor in these frames, shape (frames, 10), 1/cm
    curvature: Floats = field(default_factory=lambda: np.zeros((0, 10)))
    sensors: int = 0  #: mask of sensors everted, settled and zeroed
    truth: Truth | None = None  #: what the emulator knew at the peaks, None on hardware

    def half(self, side: Side) -> tuple[list[SweepFrame], Floats]:
        """The n frames of a side, and the curvature of each sensor in them, (n, 10)."""
        numbers = [number for number, frame in enumerate(self.frames) if frame.side == side]
        return [self.frames[number] for number in numbers], self.curvature[numbers]

    @classmethod
    def joined(cls, parts: Sequence[SweepResult]) -> SweepResult:
        """Several sweeps, in their order, as one; `sensors` has those that every sweep had."""
        return cls(
            [trigger for part in parts for trigger in part.triggers],
            [peak for part in parts for peak in part.peaks],
            [frame for part in parts for frame in part.frames],
            np.concatenate([part.curvature for part in parts]),
            reduce(and_, (part.sensors for part in parts)),
            together([part.truth for part in parts]),
        )


def together(truths: Iterable[Truth | None]) -> Truth | None:
    """The same emulated room at several moments: all their contacts, and the pegs as they are last.

    None on hardware.
    """
    known = [truth for truth in truths if truth is not None]
    contacts = [contact for truth in known for contact in truth.contacts]
    return Truth(known[-1].pegs, contacts) if known else None
