"""The firmware core inside the emulated robot: repeatability, motion, faults, and the pty."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from served import EVER_S

from thigmo.emulator._board import VirtualBoard
from thigmo.emulator.plant import Plant
from thigmo.emulator.scene import Scene
from thigmo.emulator.serve import serve
from thigmo.emulator.transport import EmulatorTransport, open_emulator
from thigmo.errors import ConfigError, PortError
from thigmo.link import protocol as wire
from thigmo.link.client import Client
from thigmo.robot import Robot, connect


def emulated(scene: Scene, seed: int = 1) -> tuple[Robot, EmulatorTransport]:
    transport = EmulatorTransport(scene, VirtualBoard(seed), seed=seed)
    return Robot(Client(transport)), transport


def ready(scene: Scene, seed: int = 1) -> tuple[Robot, EmulatorTransport]:
    """A configured, armed robot that knows its length and zone."""
    robot, transport = emulated(scene, seed)
    robot.configure(transport.config)
    robot.clear_faults()
    robot.arm()
    robot.confirm_length(scene.start_length_cm, settled=True)
    robot.select_zone(scene.robot.body.zone_at(scene.start_length_cm))
    return robot, transport


@pytest.fixture
def room() -> Scene:
    """The default room with the robot fully out and rested, and a host that knows it exactly."""
    scene = Scene.load("default")
    scene.start_length_cm = 53.0
    scene.belief = type(scene.belief)()
    return scene


def stream(seed: int) -> str:
    """Digest of every byte that the board says during a growth and a press."""
    scene = Scene.load("default")
    robot, transport = ready(scene, seed)
    digest = hashlib.sha256()

    def tap(direction: Any, frame: bytes, t_s: float) -> None:
        digest.update(f"{direction}{t_s:.6f}".encode() + frame)

    robot._client.taps.append(tap)
    robot.grow_to(10.0)
    robot.wait(5.0)
    digest.update(repr(transport.truth().length_cm).encode())
    return digest.hexdigest()


def test_same_seed_same_bytes() -> None:
    # Nonces are the host's and differ by design, so the stream begins after the hello.
    assert stream(5) == stream(5)
    assert stream(5) != stream(6)


def test_growth_ends_at_the_length_asked_for(room: Scene) -> None:
    room.start_length_cm = 0.0
    robot, transport = ready(room)
    robot.grow_to(10.0)
    assert transport.truth().length_cm == pytest.approx(10.0, abs=0.1)
    assert transport.lockstep.plant.encoder[1] == pytest.approx(2 * 10.0 * 76, rel=0.02)


def test_homing_finds_the_base(room: Scene) -> None:
    room.start_length_cm = 8.0
    robot, transport = emulated(room)
    robot.configure(transport.config)
    robot.clear_faults()
    robot.arm()
    robot.home()
    assert transport.truth().length_cm == 0.0
    assert robot.status().length_cm == pytest.approx(0.0, abs=0.05)


def test_sweep_reaches_its_amplitude_and_touches_the_peg(room: Scene) -> None:
    robot, transport = ready(room)
    robot.zero()
    plant = transport.lockstep.plant
    seen: list[tuple[float, float, float]] = []
    touched: set[int] = set()

    def look() -> None:
        seen.append((*plant.muscle_psi, plant.free_curvature))
        touched.update(contact.peg for contact in plant.truth().contacts)

    robot.while_waiting(look)
    result = robot.sweep({"left": 18.0, "right": 18.0}, period_s=30.0)
    assert max(left for left, _, _ in seen) == pytest.approx(18.0, abs=0.6)
    assert [trigger.side for trigger in result.triggers] == ["left"]
    assert touched == {0}
    assert all(curvature < 0 for _, right, curvature in seen if right > 5)


def test_operator_changes_the_pressure_that_the_board_is_told_of(room: Scene) -> None:
    robot, transport = ready(room)
    before = robot.now()
    robot.operator.set_body_pressure(1.01)
    assert transport.lockstep.plant.body_psi == 1.01
    assert robot.now() - before == pytest.approx(room.operator.takes_s)
    assert "host_alive" in robot.status().conditions  # the heart beat meanwhile


def test_known_config_is_what_the_scenes_lab_believes() -> None:
    scene = Scene.load("default")
    robot, _ = emulated(scene, seed=3)
    assert robot.known_config == scene.believed(3)
    assert robot.known_config != scene.robot


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


@pytest.fixture
def served(tmp_path: Path) -> Iterator[str]:
    """The port of an emulated robot in real time, by its link."""
    link = tmp_path / "robot"
    up, stop = threading.Event(), threading.Event()
    thread = threading.Thread(
        target=serve,
        args=("default",),
        kwargs={
            "seed": 1,
            "link": link,
            "announce": lambda text: up.set(),
            "keep_on": lambda: not stop.is_set(),
        },
    )
    thread.start()
    assert up.wait(EVER_S)
    try:
        yield str(link)
    finally:
        stop.set()
        thread.join()
    assert not link.is_symlink()


def test_served_robot_answers_on_its_port_and_opening_resets_it(served: str) -> None:
    nonces = []
    for _ in range(2):
        with connect(served) as robot:
            assert robot.identity["board"] == "virtual"
            assert robot.identity["reset_cause"] == "external"
            assert robot.status().length_cm is None
            nonces.append(robot.identity["boot_nonce"])
    assert nonces[0] != nonces[1]


def test_unusable_scene_or_link_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no scene"):
        open_emulator("emulator://nowhere")
    with pytest.raises(ConfigError, match="no scene"):
        serve("nowhere")
    with pytest.raises(PortError, match="link"):
        serve("default", link=tmp_path / "missing" / "robot")


def test_message_ids_of_the_board_are_this_hosts(room: Scene) -> None:
    from thigmo.emulator import _board

    assert _board.SCHEMA_HASH == wire.SCHEMA_HASH
