"""While an emulated robot waits for its operator, its time and its readings go on."""

from __future__ import annotations

from collections import Counter

from thigmo.emulator.scene import Scene
from thigmo.robot import connect
from thigmo.stream import Telemetry


def test_readings_of_a_wait_for_the_operator_are_spread_over_it() -> None:
    scene = Scene.load("empty")
    with connect("emulator://empty", scene.believed(1), seed=1) as robot:
        heard: list[Telemetry] = []
        robot.on_telemetry(heard.append)
        began_s = robot.now()
        robot.operator.set_body_pressure(1.5)
        assert robot.now() - began_s >= scene.operator.takes_s - 1e-6
    stamps = Counter(reading.t_s for reading in heard)
    assert len(heard) > 100 * scene.operator.takes_s
    assert max(stamps.values()) <= 2  # frames of one step of 10 ms
