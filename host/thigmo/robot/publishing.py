"""What the robot publishes: telemetry, events, and the shape of its body, in units.

It listens to the link beside the program that drives the robot, and commands nothing. What has no
listener is not decoded. Live listeners get each reading as it comes; a record gets them in blocks.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import cache
from math import isfinite, nan
from typing import TYPE_CHECKING

import numpy as np

from thigmo.config import SIGN, RobotConfig
from thigmo.link import protocol as wire
from thigmo.link.inbox import ReceivedEvent, TelemetryFrame
from thigmo.mechanics import traced
from thigmo.robot.curvature import SensorTable
from thigmo.stream import BodyShape, Event, Hub, Telemetry
from thigmo.stream.blocks import Phase, TelemetryBlock
from thigmo.stream.messages import Severity
from thigmo.wiring import muscle_outputs, sensor_name

if TYPE_CHECKING:
    from thigmo.link.client import Client

_FULL_MA, _FULL_DRIVE, _FULL_MOTOR = 20.0, 1599, 800
_IDLE_PSI = 0.1  # below, no muscle bends the body
# Of the board's time, between two shapes: in motion while somebody looks and else, and at rest.
_LIVE_S, _KEPT_S, _REST_S = 0.1, 0.2, 1.0
# Readings that a record takes at once, and seconds of this computer's that it waits for them.
_BLOCK, _BLOCK_S = 5000, 0.5
_LOOK = 20  # readings between two looks at the clock
_STEP_CM = 2.0  # a tenth of the tightest bend's radius


@cache
def _layout(counts: tuple[int, ...]) -> np.dtype[np.void]:
    """The wire's telemetry as numpy reads it, for given numbers of sensors and muscles."""
    found: list[tuple[str, str, tuple[int, ...]]] = []
    left = list(counts)
    of_each: dict[str, int] = {}
    for name, code in wire.Telemetry.CODES.items():
        of, _, element = code.rpartition("?")
        if of and of not in of_each:
            of_each[of] = left.pop(0)
            found.append((of, "u1", ()))
        found.append((name, f"<{element}", (of_each[of],) if of else ()))
    return np.dtype(found)


@cache
def _phase(both: int, faults: int) -> Phase:
    """Names of state, activity and faults."""
    return (
        wire.State(both >> 4).key,
        wire.Activity(both & 0xF).key,
        tuple(fault.key for fault in wire.Fault.from_mask(faults)),
    )


def _described(event: wire.Event, config: RobotConfig) -> tuple[str, Severity, str, str]:
    """Name, severity, what happened, and what to do next."""
    code, arg, value = event.code, event.arg, event.value
    if code is wire.EventCode.FAULT:
        return wire.Fault(arg).key, "fault", *wire.Fault(arg).words
    if code is wire.EventCode.ACTIVITY_ABORTED and value == wire.Reason.NONE:
        return code.key, "info", f"{wire.Activity(arg).key} ended when the host asked", ""
    if code is wire.EventCode.ACTIVITY_ABORTED:
        what, cure = wire.Reason(value).words
        return code.key, "warning", f"{wire.Activity(arg).key} ended early: {what}", cure
    text = {
        wire.EventCode.CONTACT: lambda: (
            f"contact: the base is {value / 1e5:+.4f} 1/cm off the free bend of muscle "
            f"{muscle_outputs(config).get(arg, arg)}"
        ),
        wire.EventCode.PEAK: lambda: (
            f"peak of muscle {muscle_outputs(config).get(arg, arg)}: {value} readings"
        ),
        wire.EventCode.ACTIVITY_DONE: lambda: (
            f"{wire.Activity(arg).key} done at {value / 1e4:.1f} cm"
        ),
        wire.EventCode.ZEROED: lambda: f"{arg.bit_count()} sensors zeroed",
        wire.EventCode.EVERTED: lambda: (
            f"sensor {sensor_name(config, arg)} everted at {value / 1e4:.1f} cm"
        ),
        wire.EventCode.SAVED: lambda: f"configuration {value} stored",
    }[code]()
    return code.key, "warning" if code is wire.EventCode.CONTACT else "info", text, ""


class Publisher:
    """Publishes a client's telemetry and events on its hub."""

    def __init__(self, client: Client, config: RobotConfig, table: SensorTable) -> None:
        self.hub = Hub()
        self.hub.publish_block = self._publish_block
        self.epoch_s = time.time() - client.now()  # UTC seconds at which the link's clock was 0
        self._supply_v = nan
        self._gathered: list[TelemetryFrame] = []  # for the record
        self._kept_s = 0.0  # when the last ones went
        self._shape_s = 0.0
        self.use(config, table)
        client.on_telemetry.append(self.take)
        client.on_event.append(lambda received: self.hub.publish(self.event(received)))

    def use(self, config: RobotConfig, table: SensorTable) -> None:
        """Decode with these constants and zeros from now on."""
        self._publish_block()
        self._config = config
        self._radius_cm = config.body.radius_cm
        self._table = table
        # 0 for a muscle that bends the body out of the plane.
        self._bends = np.array([SIGN[m.side] if m.side else 0.0 for m in config.muscles])
        self._centers = table.center_cm.tolist()
        # Everted where it ends, and never if it is not to be used.
        used = table.healthy & np.isfinite(table.zero_sum)
        self._out_cm = np.where(used, table.center_cm + table.span_cm / 2, np.inf)

    @property
    def supply_v(self) -> float:
        """The board's supply, as last asked for; NaN before."""
        return self._supply_v

    @supply_v.setter
    def supply_v(self, value: float) -> None:
        if value != self._supply_v:
            self._publish_block()
            self._supply_v = value

    def take(self, frame: TelemetryFrame) -> None:
        """Publish a frame to its listeners, and gather it for the record.

        Not before `configure` has described the robot of a board that is none of the usual size.
        """
        if wire.Telemetry.counts(frame.payload)[0] != len(self._table.healthy):
            return
        hub = self.hub
        if hub.wanted(Telemetry) or (hub.keep is None and hub.wanted(BodyShape)):
            block = self.decoded([frame])
            hub.publish(block.telemetry(0))
            if hub.wanted(BodyShape):
                self._publish_shapes(block, _LIVE_S)
        if hub.keep is not None:
            self._gathered.append(frame)
            if len(self._gathered) % _LOOK == 0 and self._block_due():
                self._publish_block()

    def _block_due(self) -> bool:
        return len(self._gathered) >= _BLOCK or time.monotonic() - self._kept_s >= _BLOCK_S

    def _publish_block(self) -> None:
        """Hand what was gathered to the record."""
        self._kept_s = time.monotonic()
        if not self._gathered or self.hub.keep is None:
            return
        block = self.decoded(self._gathered)
        self._gathered = []
        self.hub.keep(block)
        if not self.hub.wanted(Telemetry):  # else they went out with the readings
            self._publish_shapes(block, _KEPT_S)

    def _publish_shapes(self, block: TelemetryBlock, least_s: float) -> None:
        """Publish the shapes that are due, at least so far apart; fewer of a robot that rests."""
        numbers = block.numbers
        rests = (numbers["motor"] == 0.0) & (numbers["pressure_psi"].max(axis=1) < _IDLE_PSI)
        every_s = np.where(rests, _REST_S, least_s).tolist()
        for n, device_s in enumerate(numbers["device_s"].tolist()):
            # A board that restarted counts from 0 again.
            if not 0.0 <= device_s - self._shape_s < every_s[n]:
                self._shape_s = device_s
                self.hub.publish(self._shape(block, n))

    def decoded(self, frames: Sequence[TelemetryFrame]) -> TelemetryBlock:
        """Frames in units."""
        layout = _layout(wire.Telemetry.counts(frames[0].payload))
        raw = np.frombuffer(b"".join([frame.payload for frame in frames]), dtype=layout)
        t_s = np.array([frame.t_s for frame in frames])
        length_cm = raw["length_um"] / 1e4
        free = raw["free_e5"] / 1e5
        out = self._out_cm <= length_cm[:, None]
        curvature = np.where(out, self._table.curvature(raw["flex_sum"]), nan)
        cpsi = raw["pressure_cpsi"][:, : len(self._bends)]
        inflated = cpsi.max(axis=1) >= _IDLE_PSI * 100
        bends = self._bends[cpsi.argmax(axis=1)]
        hidden = inflated[:, None] & (bends[:, None] == self._table.lies)
        numbers = {
            "t_s": t_s,
            "epoch_s": self.epoch_s + t_s,
            "device_s": np.array([frame.device_us for frame in frames]) * 1e-6,
            "pressure_psi": raw["pressure_cpsi"] / 100,
            "demand_psi": raw["set_cpsi"] / 100,
            "drive_ma": raw["drive"] * _FULL_MA / _FULL_DRIVE,
            "curvature_per_cm": curvature,
            "expected_per_cm": np.where(hidden | np.isnan(curvature), nan, free[:, None]),
            "base_per_cm": raw["base_e5"] / 1e5,
            "free_per_cm": free,
            "length_cm": length_cm,
            "motor": raw["motor"] / _FULL_MOTOR,
            "supply_v": np.full(len(frames), self._supply_v),
            "flex_sum": raw["flex_sum"],
        }
        phases = map(_phase, raw["state_activity"].tolist(), raw["faults"].tolist())
        return TelemetryBlock(numbers, list(phases))

    def event(self, received: ReceivedEvent) -> Event:
        """An event in words, with the operator's next step if there is one."""
        words = _described(received.message, self._config)
        return Event(received.t_s, self.epoch_s + received.t_s, *words)

    def _shape(self, block: TelemetryBlock, n: int) -> BodyShape:
        """The body by what its sensors read now: those of the inflated side wrinkle, and do not
        count; without any it bends as the free body would."""
        row = {name: block.numbers[name][n].tolist() for name in _SHAPED_BY}
        read: dict[float, list[float]] = {}
        for center, value, expected in zip(
            self._centers, row["curvature_per_cm"], row["expected_per_cm"], strict=True
        ):
            if isfinite(expected):  # only where the sensor's own is known
                read.setdefault(center, []).append(value)
        knots = sorted((center, sum(values) / len(values)) for center, values in read.items())
        poses = bent(row["length_cm"], knots or [(0.0, row["free_per_cm"])])
        return BodyShape(row["t_s"], row["epoch_s"], poses, self._radius_cm)


_SHAPED_BY = (
    "t_s", "epoch_s", "length_cm", "free_per_cm", "curvature_per_cm", "expected_per_cm",
)  # fmt: skip


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
