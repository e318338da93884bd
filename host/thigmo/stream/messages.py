"""The messages of the stream, and their JSON.

Lengths in cm, pressures in psi, curvature in 1/cm, currents in mA, angles in rad; x along the
straight robot from its base, y to its left. Muscles are in the order of
the board's outputs.
Sensors are numbered by the board's inputs (`thigmo.wiring`). A number that is not known is NaN,
and null in JSON.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from math import nan
from typing import Any, ClassVar, Literal, Self

from pydantic import TypeAdapter, ValidationError

from thigmo.errors import DataError
from thigmo.record import MapContact, OccupancyGrid, Pose
from thigmo.record.document import Number

# JSON has no NaN.
Severity = Literal["info", "warning", "fault"]


@dataclass(frozen=True, slots=True)
class Message:
    """Base of all messages."""

    CHANNEL: ClassVar[str]

    #: the robot's time base, as in run.mcap; the host's monotonic clock or an emulator's own time
    t_s: float
    epoch_s: float  #: since 1970, UTC; in the emulator the start of the run plus virtual time


@dataclass(frozen=True, slots=True)
class Hello(Message):
    """Which run this stream belongs to: the first message to each client of a server."""

    CHANNEL = "hello"

    url: str  #: of the robot
    name: str  #: of the run
    folder: str  #: the run folder, absolute; empty if there is none
    pid: int  #: process that drives the robot
    version: str  #: of thigmo
    virtual: bool  #: whether the robot is emulated in that process, which then also stops it


@dataclass(frozen=True, slots=True)
class Dropped(Message):
    """A viewer was too slow, and `count` messages before this one were not sent to it."""

    CHANNEL = "dropped"

    count: int


@dataclass(frozen=True, slots=True)
class Telemetry(Message):
    """One telemetry frame of the board, decoded."""

    CHANNEL = "telemetry"

    #: the board's clock when the readings were complete: evenly spaced, unlike `t_s`, at which the
    #: frame arrived at the host
    device_s: float
    pressure_psi: tuple[Number, ...]  #: of the muscles
    demand_psi: tuple[Number, ...]  #: their set points
    drive_ma: tuple[Number, ...]  #: current to the pressure transducers
    #: of the sensors; NaN where one is not healthy, everted and zeroed
    curvature_per_cm: tuple[Number, ...]
    #: what the free body would read by the calibrated map, at the measured pressure; NaN for the
    #: same sensors and for those of the inflated side, which wrinkles
    expected_per_cm: tuple[Number, ...]
    base_per_cm: (
        float  #: curvature of the base, which the contact trigger compares with `free_per_cm`
    )
    free_per_cm: float  #: free curvature by the map
    length_cm: Number  #: everted
    motor: float  #: of the spool, signed share of full duty; positive pays out
    supply_v: Number  #: of the board, when it was last asked for
    state: str  #: of the board, by the schema's names
    activity: str  #: the same
    faults: tuple[str, ...]  #: latched, by the schema's names
    flex_sum: tuple[int, ...]  #: the sensors' raw readings, sums of ADC counts


@dataclass(frozen=True, slots=True)
class Event(Message):
    """Something happened."""

    CHANNEL = "event"

    name: str  #: of the event or, for a fault, of the fault, by the schema
    severity: Severity  #: "fault": the operator must act
    message: str  #: what happened
    next: str  #: what to do now; empty if nothing


@dataclass(frozen=True, slots=True)
class RunState(Message):
    """What the run is doing."""

    CHANNEL = "state"

    state: str  #: name of the exploration's state (`exploration.State`)
    doing: str  #: the same in words
    stage_cm: float  #: everted length of the stage; 0 before the first
    done: float  #: share of the run, 0 to 1
    paused: bool = False  #: the robot waits, vented, until the run is resumed
    outcome: str = "running"  #: or how the run ended, as in contacts.json


@dataclass(frozen=True, slots=True)
class BodyShape(Message):
    """The robot as it lies now."""

    CHANNEL = "shape"

    poses: tuple[Pose, ...]  #: x, y and heading along the centreline, base to tip
    radius_cm: float  #: of the tube


@dataclass(frozen=True, slots=True)
class Posterior(Message):
    """Where along the body a contact is, by all sweeps of a side: twice a second while one feels
    something, and after a stage's measurement.
    """

    CHANNEL = "posterior"

    side: str  #: inflated muscle
    length_cm: float  #: everted length
    places_cm: tuple[float, ...]  #: (N,) middles of cells along the body; empty without a contact
    probability: tuple[float, ...]  #: (N,) mass of each cell; their sum is 1
    status: str  #: "localized", "ambiguous", "no contact" or "point estimate"
    hypothesis: str  #: what explains the readings best
    message: str  #: the answer in words
    contact_probability: Number = nan  #: that there is any contact, 0 to 1
    sweeping: bool = False  #: the sweep still runs, and this is a first answer


@dataclass(frozen=True, slots=True)
class Contacts(Message):
    """All contacts of the map so far."""

    CHANNEL = "contacts"

    contacts: tuple[MapContact, ...]


@dataclass(frozen=True, slots=True)
class Grid(Message):
    """The occupancy grid so far."""

    CHANNEL = "grid"

    resolution_cm: float  #: size of a cell
    origin: Pose  #: x, y, yaw of the outer corner of the first cell
    width: int  #: in cells
    height: int  #: in cells
    cells: tuple[int, ...]  #: 0 free, 100 occupied, -1 unknown; row by row from the lowest y

    @classmethod
    def of(cls, grid: OccupancyGrid, t_s: float, epoch_s: float) -> Self:
        """The message of a record's grid."""
        height, width = grid.cells.shape
        cells = tuple(grid.cells.ravel().tolist())
        return cls(t_s, epoch_s, grid.resolution_cm, grid.origin, width, height, cells)


@dataclass(frozen=True, slots=True)
class Log(Message):
    """A line for the operator's log."""

    CHANNEL = "log"

    level: Severity
    text: str


@dataclass(frozen=True, slots=True)
class Question(Message):
    """What the run asks its operator; any viewer may answer."""

    CHANNEL = "question"

    text: str  #: empty once it is answered
    unit: str = ""  #: of the number that is asked for; empty if only a confirmation is


CHANNELS: Mapping[str, type[Message]] = {
    kind.CHANNEL: kind
    for kind in (
        Hello, Dropped, Telemetry, Event, RunState, BodyShape, Posterior, Contacts, Grid, Log,
        Question,
    )
}  # fmt: skip
_OF_NOW = (Hello.CHANNEL, Dropped.CHANNEL, Question.CHANNEL)
RECORDED = tuple(channel for channel in CHANNELS if channel not in _OF_NOW)
# The last of each is given to later subscribers.
RETAINED = frozenset(
    kind.CHANNEL for kind in (RunState, BodyShape, Posterior, Contacts, Grid, Question)
)

ADAPTERS = {channel: TypeAdapter[Any](kind) for channel, kind in CHANNELS.items()}


def to_json(message: Message) -> bytes:
    """A message as a JSON object: its fields, after `channel`."""
    fields = ADAPTERS[message.CHANNEL].dump_json(message)
    return b'{"channel":"%b",%b' % (message.CHANNEL.encode(), fields[1:])


def from_json(data: bytes) -> Message:
    """The message of `to_json`'s bytes. Raises DataError if these are not such bytes."""
    try:
        fields = json.loads(data)
        channel = fields.pop("channel")
    except (ValueError, KeyError, AttributeError, TypeError) as error:
        raise _foreign(data) from error
    return validated(channel, fields)


def validated(channel: str, fields: dict[str, Any]) -> Message:
    """The message of a channel with these fields. Raises DataError if it has others."""
    try:
        message: Message = ADAPTERS[channel].validate_python(fields)
    except (KeyError, ValidationError) as error:
        raise _foreign(fields) from error
    return message


def _foreign(value: object) -> DataError:
    return DataError(
        f"no message of the stream: {str(value)[:80]}",
        "use the same version of thigmo on both ends",
    )
