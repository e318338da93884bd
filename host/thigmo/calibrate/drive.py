"""Measures the duty that growth needs at its speed, by body pressure.

The board checks the encoder against the motor's speed at its duty. This motor and body differ from
the data sheet, above all by the pull on the tail, so the difference is measured during growth.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import Any

import numpy as np

from thigmo.config import RobotConfig
from thigmo.link import protocol as wire
from thigmo.robot import Robot
from thigmo.stream import Telemetry

Row = dict[str, Any]

_FULL = wire.PARAMETERS["speed_margin_duty"].high  # duty of the whole supply
_SHORTEST_S = 3.0  # shortest growth used; its middle half is, when the duty has settled
_PAUSE_S = 0.5  # least pause between two growths


class Drive(AbstractContextManager["Drive"]):
    """Collects telemetry of a growing robot while the context is open."""

    def __init__(self, robot: Robot, config: RobotConfig) -> None:
        self._robot, self._config = robot, config
        self._dead_zone = robot.parameter("spool_dead_zone")[0]
        self._samples: list[tuple[float, float, float]] = []
        self._end = robot.on_telemetry(self._take)

    def __exit__(self, *_: object) -> None:
        self._end()

    def _take(self, frame: Telemetry) -> None:
        if frame.activity == wire.Activity.GROWING.key:
            self._samples.append((frame.device_s, frame.length_cm, _FULL * frame.motor))

    def rows(self) -> list[Row]:
        """Duty and encoder counts a second at each body pressure used since the last call."""
        samples, self._samples = np.array(self._samples).reshape(-1, 3), []
        body, spool = self._config.body, self._config.spool
        body_pressures = np.array([body.pressure_number(length) for length in samples[:, 1]])
        duties = []
        for body_pressure in range(len(body.pressures)):
            at_pressure = samples[body_pressures == body_pressure]
            # The end of a growth may lie beyond a boundary, and the next one begins later.
            pauses = np.flatnonzero(np.diff(at_pressure[:, 0]) > _PAUSE_S) + 1
            t, length, duty = max(np.split(at_pressure, pauses), key=len).T
            if not len(t) or np.ptp(t) < _SHORTEST_S:
                continue
            middle = np.abs(t - (t[0] + t[-1]) / 2) < np.ptp(t) / 4
            cm_s = float(np.polyfit(t[middle], length[middle], 1)[0])
            duties.append({
                "body_pressure": body_pressure, "duty": float(duty[middle].mean()),
                "dead_zone": self._dead_zone,
                "counts_s": cm_s * spool.counts_per_cm * spool.payout_ratio,
            })  # fmt: skip
        return duties


def pull_duty(rows: Sequence[Row], counts_per_cm: float, config: RobotConfig) -> list[float | None]:
    """How much less duty (of 800) growth needs than by the data sheet, at each body pressure.

    The smallest of the measured differences, so that a sound encoder is never called faulty. None
    at a body pressure that was not measured.
    """
    saved: list[list[float]] = [[] for _ in config.body.pressures]
    for row in rows:
        line_cm_s = row["counts_s"] / counts_per_cm
        turning = line_cm_s / config.spool.line_speed_cm_s * (_FULL - row["dead_zone"])
        saved[row["body_pressure"]].append(row["dead_zone"] + turning - row["duty"])
    return [min(duties, default=None) for duties in saved]
