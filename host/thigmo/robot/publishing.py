"""What the robot publishes: telemetry, events, and the shape of its body, in units.

It listens to the link beside the program that drives the robot, and commands nothing. What has no
listener is not decoded.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import cache
from math import isfinite, nan
from typing import TYPE_CHECKING

import numpy as np

from thigmo.config import SIGN
from thigmo.link import protocol as wire
from thigmo.link.inbox import ReceivedEvent, TelemetryFrame
from thigmo.mechanics import heading_along, rest_turn, traced
from thigmo.robot.curvature import SensorTable
from thigmo.robot.idle_pressure import UNBENT_CPSI, UNBENT_PSI
from thigmo.robot.state import RobotStatus
from thigmo.stream import BodyShape, Event, Hub, Telemetry
from thigmo.stream.messages import Severity
from thigmo.wiring import Wiring

if TYPE_CHECKING:
    from thigmo.link.client import Client

_FULL_MA, _FULL_DRIVE, _FULL_MOTOR = 20.0, 1599, 800
_MOVING_S, _REST_S = 0.1, 1.0  # of the board's time, between two shapes
_STEP_CM = 2.0  # a tenth of the tightest bend's radius


@cache
def _names(packed: int, faults: int) -> tuple[str, str, tuple[str, ...]]:
    """Names of state, activity and faults, by the schema."""
    return (
        wire.State(packed >> 4).key,
        wire.Activity(packed & 0xF).key,
        tuple(fault.key for fault in wire.Fault.from_mask(faults)),
    )


def _described(event: wire.Event, wiring: Wiring) -> tuple[str, Severity, str, str]:
    """Name, severity, what happened, and what to do next."""
    code, arg, value = event.code, event.arg, event.value
    if code is wire.EventCode.FAULT:
        return wire.Fault(arg).key, "fault", *wire.Fault(arg).words
    if code is wire.EventCode.ACTIVITY_ABORTED and value == wire.Reason.NONE:
        return code.key, "info", f"{wire.Activity(arg).key} was ended by the program", ""
    if code is wire.EventCode.ACTIVITY_ABORTED:
        problem, cure = wire.Reason(value).words
        return code.key, "warning", f"{wire.Activity(arg).key} ended early: {problem}", cure
    text = {
        wire.EventCode.CONTACT: lambda: (
            f"contact felt at the base while the {wiring.muscle_name(arg)} muscle bends the body"
        ),
        wire.EventCode.PEAK: lambda: (
            f"the {wiring.muscle_name(arg)} muscle was at its peak: {value} readings"
        ),
        wire.EventCode.ACTIVITY_DONE: lambda: (
            f"{wire.Activity(arg).key} ended at {value / 1e4:.1f} cm"
        ),
        wire.EventCode.ZEROED: lambda: f"{arg.bit_count()} sensors zeroed",
        wire.EventCode.EVERTED: lambda: (
            f"sensor {wiring.sensor_name(arg)} everted at {value / 1e4:.1f} cm"
        ),
        wire.EventCode.SAVED: lambda: f"configuration {value} stored",
    }[code]()
    return code.key, "warning" if code is wire.EventCode.CONTACT else "info", text, ""


class Publisher:
    """Publishes a client's telemetry and events on its hub."""

    def __init__(self, client: Client, wiring: Wiring, table: SensorTable) -> None:
        self.hub = Hub()
        self.epoch_s = time.time() - client.now()  # UTC seconds at which the link's clock was 0
        self.supply_v = nan  # the board's supply, as last asked for
        self._shape_s = 0.0
        self.use(wiring, table)
        client.on_telemetry.append(self.take)
        client.on_event.append(lambda received: self.hub.publish(self.event(received)))

    def use(self, wiring: Wiring, table: SensorTable) -> None:
        """Decode with these constants and zeros from now on."""
        self._wiring = wiring
        self._radius_cm = wiring.config.body.radius_cm
        self._rest = wiring.config.body.rest_pieces
        self._table = table
        self._decode = table.board_decoder()
        # 0 for a muscle that bends the body out of the plane.
        self._bends = [SIGN[m.side] if m.side else 0.0 for m in wiring.config.muscles]
        self._lies: list[int] = table.lies.tolist()
        self._centers: list[float] = table.center_cm.tolist()
        # Everted where it ends, and never if it is not to be used.
        used = table.healthy & np.isfinite(table.zero_sum)
        everted_cm = np.where(used, table.center_cm + table.span_cm / 2, np.inf)
        self._everted_cm: list[float] = everted_cm.tolist()

    def note_status(self, status: RobotStatus) -> None:
        """Publish this supply with the telemetry from now on."""
        self.supply_v = status.supply_v

    def take(self, frame: TelemetryFrame) -> None:
        """Publish a frame, and the body's shape if it is due, to their listeners.

        Not before `configure` has described the robot of a board that is none of the usual size.
        """
        if wire.Telemetry.counts(frame.payload)[0] != len(self._table.healthy):
            return
        hub = self.hub
        if hub.wanted(Telemetry) or hub.wanted(BodyShape):
            telemetry = self.decoded(frame)
            hub.publish(telemetry)
            if hub.wanted(BodyShape) and self._shape_is_due(telemetry):
                self._shape_s = telemetry.device_s
                hub.publish(self._shape(telemetry))

    def _shape_is_due(self, telemetry: Telemetry) -> bool:
        """Whether the body has moved on since the last shape; rarely of a robot that rests."""
        rests = telemetry.motor == 0.0 and max(telemetry.pressure_psi) < UNBENT_PSI
        # A board that restarted counts from 0 again.
        passed_s = telemetry.device_s - self._shape_s
        return not 0.0 <= passed_s < (_REST_S if rests else _MOVING_S)

    def decoded(self, frame: TelemetryFrame) -> Telemetry:
        """A frame in units."""
        raw = frame.message
        length_cm, free = raw.length_um / 1e4, raw.free_e5 / 1e5
        curvature = [
            value if everted_cm <= length_cm else nan
            for value, everted_cm in zip(self._decode(raw.flex_sum), self._everted_cm, strict=True)
        ]
        wrinkled = self._wrinkled_side(raw.pressure_cpsi)
        expected = [
            nan if value != value or lies == wrinkled else free  # NaN is not equal to itself
            for value, lies in zip(curvature, self._lies, strict=True)
        ]
        state, activity, faults = _names(raw.state_activity, raw.faults)
        return Telemetry(
            t_s=frame.t_s,
            epoch_s=self.epoch_s + frame.t_s,
            device_s=frame.device_us * 1e-6,
            pressure_psi=tuple([cpsi / 100 for cpsi in raw.pressure_cpsi]),
            demand_psi=tuple([cpsi / 100 for cpsi in raw.set_cpsi]),
            drive_ma=tuple([drive * _FULL_MA / _FULL_DRIVE for drive in raw.drive]),
            curvature_per_cm=tuple(curvature),
            expected_per_cm=tuple(expected),
            base_per_cm=raw.base_e5 / 1e5,
            free_per_cm=free,
            length_cm=length_cm,
            motor=raw.motor / _FULL_MOTOR,
            supply_v=self.supply_v,
            state=state,
            activity=activity,
            faults=faults,
            flex_sum=raw.flex_sum,
        )

    def _wrinkled_side(self, pressure_cpsi: tuple[int, ...]) -> float | None:
        """The side of the muscle that bends the body, as `SensorTable.lies`; None if none does."""
        cpsi = pressure_cpsi[: len(self._bends)]
        highest = max(cpsi)
        return self._bends[cpsi.index(highest)] if highest >= UNBENT_CPSI else None

    def event(self, received: ReceivedEvent) -> Event:
        """An event in words, with the operator's next step if there is one."""
        words = _described(received.message, self._wiring)
        return Event(received.t_s, self.epoch_s + received.t_s, *words)

    def _shape(self, telemetry: Telemetry) -> BodyShape:
        """The body by what its sensors read now: those of the inflated side wrinkle, and do not
        count; without any it bends as the free body would."""
        read: dict[float, list[float]] = {}
        for center, value, expected in zip(
            self._centers, telemetry.curvature_per_cm, telemetry.expected_per_cm, strict=True
        ):
            if isfinite(expected):  # only where the sensor's own is known
                read.setdefault(center, []).append(value)
        knots = sorted((center, sum(values) / len(values)) for center, values in read.items())
        knots = knots or [(0.0, telemetry.free_per_cm)]
        poses = bent(telemetry.length_cm, knots, self._rest)
        return BodyShape(telemetry.t_s, telemetry.epoch_s, poses, self._radius_cm)


def bent(
    length_cm: float,
    knots: list[tuple[float, float]],
    rest: Sequence[tuple[float, float]] = (),
) -> tuple[tuple[float, float, float], ...]:
    """Poses along a body whose curvature (1/cm) is known at some arcs (cm), linear between them.

    Beyond the outermost it is constant. It is added to that of the rest shape (`rest_turn`).
    """
    count = max(2, round(length_cm / _STEP_CM) + 1)
    arc = np.linspace(0.0, max(length_cm, 0.0), count)
    places, values = zip(*knots, strict=True)
    curvature = np.interp(arc, places, values)
    step = arc[1]
    heading = heading_along(curvature, step) + rest_turn(rest, arc)
    x, y = traced(heading, step)
    return tuple(zip(x.tolist(), y.tolist(), heading.tolist(), strict=True))
