"""What the robot publishes of itself: telemetry, events, and how its body lies.

It listens to the link beside whoever drives the robot, and commands nothing. What nobody listens
to is not even decoded.
"""

from __future__ import annotations

import time
from math import isfinite, nan
from typing import TYPE_CHECKING

import numpy as np

from thigmo.config import RobotConfig
from thigmo.link.received import ReceivedEvent, TelemetryFrame
from thigmo.mechanics import traced
from thigmo.robot.decoded import Decoder
from thigmo.robot.readings import SensorTable
from thigmo.stream import BodyShape, Hub, Telemetry

if TYPE_CHECKING:
    from thigmo.link.client import Client

_SHAPE_S = 0.1  # of the board's time, between two shapes
_STEP_CM = 2.0  # a tenth of the tightest bend's radius


class Publisher:
    """Publishes a client's telemetry and events on its hub."""

    def __init__(self, client: Client, config: RobotConfig, table: SensorTable) -> None:
        self.hub = Hub()
        self.epoch_s = time.time() - client.now()  # UTC seconds at which the link's clock was 0
        self.supply_v = nan  # as last asked for
        self._shape_s = 0.0
        self.use(config, table)
        client.on_telemetry.append(self._telemetry)
        client.on_event.append(self._event)

    def use(self, config: RobotConfig, table: SensorTable) -> None:
        """Decode with these constants and zeros from now on."""
        self._decoder = Decoder(table, self.epoch_s)
        self._centers = table.center_cm.tolist()
        self._radius_cm = config.body.radius_cm

    def _telemetry(self, frame: TelemetryFrame) -> None:
        shape = self.hub.wanted(BodyShape)
        if not shape and not self.hub.wanted(Telemetry):
            return
        telemetry = self._decoder.telemetry(frame, self.supply_v)
        self.hub.publish(telemetry)
        # A board that restarted counts from 0 again.
        if shape and not 0.0 <= telemetry.device_s - self._shape_s < _SHAPE_S:
            self._shape_s = telemetry.device_s
            self.hub.publish(self._shape(telemetry))

    def _event(self, received: ReceivedEvent) -> None:
        self.hub.publish(self._decoder.event(received))

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
