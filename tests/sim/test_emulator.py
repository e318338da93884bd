"""The firmware core inside the emulated robot: a sweep that meets the peg, the trigger, the pty."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from emulated import Serve, armed, scene_at

from thigmo.emulator.plant import Plant
from thigmo.emulator.scene import Scene
from thigmo.emulator.serve import serve as serve_scene
from thigmo.errors import ConfigError, PortError
from thigmo.robot import connect


@pytest.fixture
def room() -> Scene:
    """The default room with the robot fully out and rested, and a host that knows it exactly."""
    scene = scene_at(53.0, "default")
    scene.belief = type(scene.belief)()
    return scene


def test_sweep_reaches_its_amplitude_and_touches_the_peg(room: Scene) -> None:
    robot, transport = armed(room)
    robot.select_body_pressure(2)
    robot.zero()
    plant = transport.lockstep.plant
    readings: list[tuple[float, float, float]] = []
    touched: set[int] = set()

    def look() -> None:
        readings.append((*plant.muscle_psi, plant.free_curvature))
        touched.update(contact.peg for contact in plant.truth().contacts)

    robot.while_waiting(look)
    result = robot.sweep({"left": 18.0, "right": 18.0}, period_s=30.0)
    assert max(left for left, _, _ in readings) == pytest.approx(18.0, abs=0.6)
    assert [trigger.side for trigger in result.triggers] == ["left"]
    assert touched == {0}
    assert all(curvature < 0 for _, right, curvature in readings if right > 5)


def test_trigger_threshold_is_passed_where_the_noise_free_plant_says(room: Scene) -> None:
    # The plant alone, driven slowly: base contact curvature against reach.first_felt.
    from thigmo.emulator.reach import first_felt

    felt = first_felt(room.robot, room.peg_list())
    assert felt is not None
    room.transducer.gain_error = room.transducer.hysteresis_psi = 0.0
    plant = Plant(room)
    passed = None
    for psi in np.arange(2.5, 12.0, 0.004):
        duty = round((4.0 + 16.0 * (psi - 2.0) / 58.0) / 20.0 * 1599)
        plant.step((duty, 0), (True, False), 0, True)
        excess = plant.sensor_curvature[5] - plant.free_curvature
        if passed is None and abs(excess) >= 0.005:
            passed = plant.muscle_psi[0]
    assert passed == pytest.approx(felt.pressure_psi, abs=0.4)


@pytest.mark.realtime
def test_served_robot_answers_on_its_port_and_opening_resets_it(serve: Serve) -> None:
    served = serve(Scene.load("default"))
    nonces = []
    for _ in range(2):
        with connect(served.port) as robot:
            assert robot.identity["board"] == "virtual"
            assert robot.identity["reset_cause"] == "external"
            assert robot.status().length_cm is None
            nonces.append(robot.identity["boot_nonce"])
    assert nonces[0] != nonces[1]


def test_unusable_scene_or_link_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no scene"):
        serve_scene("nowhere")
    with pytest.raises(PortError, match="link"):
        serve_scene("default", link=tmp_path / "missing" / "robot")
