"""What the robot publishes of itself: telemetry, events, and how its body lies, in units.

It listens to the link beside whoever drives the robot, and commands nothing. What nobody listens
to is not even decoded; what somebody does is plain arithmetic on ten numbers, for each frame.
"""

from __future__ import annotations

import time
from functools import cache
from math import isfinite, nan
from typing import TYPE_CHECKING

import numpy as np

from thigmo.config import SIDES, RobotConfig
from thigmo.link import protocol as wire
from thigmo.link.inbox import ReceivedEvent, TelemetryFrame
from thigmo.mechanics import traced
from thigmo.robot.readings import SENSORS, SENSORS_A_SIDE, SensorTable, sensor_name
from thigmo.stream import BodyShape, Event, Hub, Telemetry
from thigmo.stream.messages import Severity

if TYPE_CHECKING:
    from thigmo.link.client import Client

_FULL_MA, _FULL_DRIVE, _FULL_MOTOR = 20.0, 1599, 800
_OPEN_COUNT = 0.75  # mean count below which a circuit is open
_IDLE_CPSI = 10  # below, no muscle bends the body
_SIDE_OF = [SIDES[sensor // SENSORS_A_SIDE] for sensor in range(SENSORS)]
_SHAPE_S = 0.1  # of the board's time, between two shapes
_STEP_CM = 2.0  # a tenth of the tightest bend's radius


@cache
def _phase(both: int) -> tuple[str, str]:
    """Names of state and activity."""
    return wire.State(both >> 4).key, wire.Activity(both & 0xF).key


@cache
def _faults(mask: int) -> tuple[str, ...]:
    return tuple(fault.key for fault in wire.Fault.from_mask(mask))


def _told(event: wire.Event) -> tuple[str, Severity, str, str]:
    """Name, severity, what happened, and what to do next."""
    code, arg, value = event.code, event.arg, event.value
    if code is wire.EventCode.FAULT:
        return wire.Fault(arg).key, "fault", *wire.Fault(arg).told
    if code is wire.EventCode.ACTIVITY_ABORTED and value == wire.Reason.NONE:
        return code.key, "info", f"{wire.Activity(arg).key} ended when the host asked", ""
    if code is wire.EventCode.ACTIVITY_ABORTED:
        what, cure = wire.Reason(value).told
        return code.key, "warning", f"{wire.Activity(arg).key} ended early: {what}", cure
    text = {
        wire.EventCode.CONTACT: lambda: (
            f"contact: the base is {value / 1e5:+.4f} 1/cm off the free bend to the {SIDES[arg]}"
        ),
        wire.EventCode.PEAK: lambda: f"peak of the bend to the {SIDES[arg]}: {value} readings",
        wire.EventCode.ACTIVITY_DONE: lambda: (
            f"{wire.Activity(arg).key} done at {value / 1e4:.1f} cm"
        ),
        wire.EventCode.ZEROED: lambda: f"{arg.bit_count()} sensors zeroed",
        wire.EventCode.EVERTED: lambda: (
            f"sensor {sensor_name(arg)} everted at {value / 1e4:.1f} cm"
        ),
        wire.EventCode.SETTLED: lambda: f"sensor {sensor_name(arg)} settled",
        wire.EventCode.SAVED: lambda: f"configuration {value} stored",
    }[code]()
    return code.key, "warning" if code is wire.EventCode.CONTACT else "info", text, ""


class Publisher:
    """Publishes a client's telemetry and events on its hub."""

    def __init__(self, client: Client, config: RobotConfig, table: SensorTable) -> None:
        self.hub = Hub()
        self.epoch_s = time.time() - client.now()  # UTC seconds at which the link's clock was 0
        self.supply_v = nan  # as last asked for
        self._shape_s = 0.0
        self.use(config, table)
        client.on_telemetry.append(self._publish)
        client.on_event.append(lambda received: self.hub.publish(self.event(received)))

    def use(self, config: RobotConfig, table: SensorTable) -> None:
        """Decode with these constants and zeros from now on."""
        self._radius_cm = config.body.radius_cm
        self._share = 1.0 / table.oversample
        self._divider_ohm = table.divider_ohm
        self._centers = table.center_cm.tolist()
        # Everted where it ends, and never if it is not to be used.
        used = table.healthy & np.isfinite(table.zero_sum)
        self._sensors = list(
            zip(
                np.where(used, table.center_cm + table.span_cm / 2, np.inf).tolist(),
                table.scale_per_ohm.tolist(),
                table.resistance(table.zero_sum).tolist(),
                _SIDE_OF,
                strict=True,
            )
        )

    def _publish(self, frame: TelemetryFrame) -> None:
        shape = self.hub.wanted(BodyShape)
        if not shape and not self.hub.wanted(Telemetry):
            return
        telemetry = self.telemetry(frame)
        self.hub.publish(telemetry)
        # A board that restarted counts from 0 again.
        if shape and not 0.0 <= telemetry.device_s - self._shape_s < _SHAPE_S:
            self._shape_s = telemetry.device_s
            self.hub.publish(self._shape(telemetry))

    def telemetry(self, frame: TelemetryFrame) -> Telemetry:
        """A frame in units."""
        raw = frame.message
        length_cm = raw.length_um / 1e4
        free = raw.free_e5 / 1e5
        drives = (raw.left_drive, raw.right_drive)
        left_ma, right_ma = (level * _FULL_MA / _FULL_DRIVE for level in drives)
        state, activity = _phase(raw.state_activity)
        inflated = None
        if max(raw.left_cpsi, raw.right_cpsi) >= _IDLE_CPSI:
            inflated = SIDES[0] if raw.left_cpsi >= raw.right_cpsi else SIDES[1]
        curvature, expected = [], []
        for flex_sum, (out_cm, scale, zero_ohm, side) in zip(
            raw.flex_sum, self._sensors, strict=True
        ):
            value = nan
            count = flex_sum * self._share + 0.5
            if out_cm <= length_cm and count > _OPEN_COUNT:
                # As `SensorTable.curvature`, of one reading.
                value = scale * (self._divider_ohm * (1024.0 - count) / count - zero_ohm)
            curvature.append(value)
            expected.append(nan if value != value or side == inflated else free)
        return Telemetry(
            t_s=frame.t_s,
            epoch_s=self.epoch_s + frame.t_s,
            device_s=frame.device_s,
            pressure_psi=(raw.left_cpsi / 100, raw.right_cpsi / 100),
            demand_psi=(raw.left_set_cpsi / 100, raw.right_set_cpsi / 100),
            drive_ma=(left_ma, right_ma),
            curvature_per_cm=tuple(curvature),
            expected_per_cm=tuple(expected),
            base_per_cm=raw.base_e5 / 1e5,
            free_per_cm=free,
            length_cm=length_cm,
            motor=raw.motor / _FULL_MOTOR,
            supply_v=self.supply_v,
            state=state,
            activity=activity,
            faults=_faults(raw.faults),
            flex_sum=raw.flex_sum,
        )

    def event(self, received: ReceivedEvent) -> Event:
        """An event in words, with the operator's next step if there is one."""
        return Event(received.t_s, self.epoch_s + received.t_s, *_told(received.message))

    def _shape(self, told: Telemetry) -> BodyShape:
        """The body by what its sensors read now: those of the inflated side wrinkle, and do not
        count; without any it bends as the free body would."""
        read: dict[float, list[float]] = {}
        for center, value, expected in zip(
            self._centers, told.curvature_per_cm, told.expected_per_cm, strict=True
        ):
            if isfinite(value) and isfinite(expected):
                read.setdefault(center, []).append(value)
        knots = sorted((center, sum(values) / len(values)) for center, values in read.items())
        poses = bent(told.length_cm, knots or [(0.0, told.free_per_cm)])
        return BodyShape(told.t_s, told.epoch_s, poses, self._radius_cm)


def bent(
    length_cm: float, knots: list[tuple[float, float]]
) -> tuple[tuple[float, float, float], ...]:
    """Poses along a body whose curvature (1/cm) is known at some arcs (cm), linear between them.

    Beyond the outermost it is constant.
    """
    count = max(2, round(length_cm / _STEP_CM) + 1)
    arc = np.linspace(0.0, max(length_cm, 0.0), count)
    places, values = zip(*knots, strict=True)
    curvature = np.interp(arc, places, values)
    step = arc[1]
    heading = np.concatenate(([0.0], np.cumsum(step * (curvature[1:] + curvature[:-1]) / 2)))
    x, y = traced(heading, step)
    return tuple(zip(x.tolist(), y.tolist(), heading.tolist(), strict=True))
