"""Messages of the stream in ROS's units and conventions."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from contacts import CONTACT

from thigmo.live import ros_messages as made
from thigmo.live.relay import Facts
from thigmo.record import MapContact
from thigmo.stream import BodyShape, Contacts, Grid, Hello, RunState, Telemetry

NAN = math.nan
BOARD = Telemetry(
    1.0, 101.0, 1.0, (9.0, 0.0), (9.0, 0.0), (8.0, 0.0), (NAN,) * 10, (NAN,) * 10, 0.01, 0.01,
    40.0, 0.0, NAN, "moving", "sweep", (), (0,) * 10,
)  # fmt: skip
RUN = Hello(0.0, 100.0, "/dev/ttyACM0", "n", "", 1, "0", False)
STATE = RunState(1.0, 101.0, "SWEEP", "sweeping", 40.0, 0.5)


def _contact(track: list[tuple[float, float]]) -> MapContact:
    covariance_cm2 = ((4.0, 1.0), (1.0, 2.0))
    return replace(
        CONTACT, x_cm=29.5, normal_rad=math.pi / 2, covariance_cm2=covariance_cm2, track=track
    )


def test_times_keep_their_microseconds() -> None:
    stamp = made.header(1_700_000_000.000_25, "map").stamp
    assert (stamp.sec, stamp.nanosec) == (1_700_000_000, pytest.approx(250_000, abs=1000))
    early = made.header(-0.25, "map").stamp
    assert (early.sec, early.nanosec) == (-1, 750_000_000)


def test_grid_is_in_metres_and_keeps_its_cells() -> None:
    grid = made.occupancy_grid(
        Grid(1.0, 5.0, 0.5, (-5.0, -37.5, math.pi / 2), 2, 3, (0, 100, -1, 0, 0, -1)), "map"
    )
    assert (grid.info.resolution, grid.info.width, grid.info.height) == (0.005, 2, 3)
    assert (grid.info.origin.position.x, grid.info.origin.position.y) == (-0.05, -0.375)
    assert grid.info.origin.orientation.z == pytest.approx(math.sqrt(0.5))
    assert list(grid.data) == [0, 100, -1, 0, 0, -1]
    assert grid.header.stamp.sec == grid.info.map_load_time.sec == 5


def test_contact_points_into_the_obstacle_with_its_covariance() -> None:
    track = [(28.0, 7.0), (29.0, 7.5), (30.0, 8.0)]
    (pose,) = made.contact_poses(Contacts(1.0, 5.0, (_contact(track),)), "map")
    assert pose.pose.pose.position.x == pytest.approx(0.295)
    turn = pose.pose.pose.orientation
    assert 2 * math.atan2(turn.z, turn.w) == pytest.approx(math.pi / 2)
    covariance = np.reshape(pose.pose.covariance, (6, 6))
    assert covariance[:2, :2] == pytest.approx(np.array([[4e-4, 1e-4], [1e-4, 2e-4]]))
    assert covariance[5, 5] == pytest.approx(0.0)  # a straight skin has one direction


def test_direction_of_a_contact_is_as_uncertain_as_the_skin_turns() -> None:
    def variance(track: list[tuple[float, float]]) -> float:
        (pose,) = made.contact_poses(Contacts(1.0, 5.0, (_contact(track),)), "map")
        return float(pose.pose.covariance[35])

    corner = variance([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)])
    assert corner == pytest.approx((math.pi / 2 / 3.92) ** 2)
    around = variance([(0.0, 0.0), (-1.0, 0.1), (-2.0, 0.0), (-3.0, -0.2)])  # across pi
    assert around < 0.02
    assert variance([]) == pytest.approx(math.pi**2 / 3)


def test_joints_are_length_and_turns_of_the_body() -> None:
    # A quarter of a circle of 40 cm.
    radius, angles = 80.0 / math.pi, np.linspace(0.0, math.pi / 2, 41)
    poses = tuple(
        (radius * math.sin(a), radius * (1 - math.cos(a)), float(a)) for a in angles.tolist()
    )
    joints = made.joint_state(BodyShape(1.0, 5.0, poses, 1.75))
    assert joints.name[0] == "everted_length"
    assert joints.position[0] == pytest.approx(0.4, rel=1e-3)
    # Chords of equal arcs: the first turns by half of what the others do.
    turns = [math.pi / 40, *[math.pi / 20] * 9]
    assert list(joints.position[1:11]) == pytest.approx(turns, rel=1e-2)
    assert sum(joints.position[11:]) == pytest.approx(0.4, rel=2e-3)
    tip, *_ = made.body_transforms(BodyShape(1.0, 5.0, poses, 1.75)).transforms
    assert (tip.header.frame_id, tip.child_frame_id) == ("thigmo_base", "thigmo_tip")
    assert tip.transform.translation.y == pytest.approx(radius / 100)


def _levels(facts: Facts) -> dict[str, tuple[int, str]]:
    array = made.diagnostics(5.0, facts)
    return {
        status.name.removeprefix("thigmo: "): (status.level, status.message)
        for status in array.status
    }


def test_diagnostics_say_what_is_wrong() -> None:
    fine = Facts(RUN, True, STATE, BOARD)
    assert _levels(fine) == {
        "stop": (0, "a message on the stop topic stops the robot"),
        "run": (0, "sweeping"),
        "board": (0, "moving"),
    }
    lost = Facts(RUN, True, STATE, BOARD, "stop not connected: use the e-stop")
    assert _levels(lost)["stop"] == (2, "stop not connected: use the e-stop")
    assert _levels(Facts())["run"][0] == 3
    assert "board" not in _levels(Facts())
    (stop, *_) = made.diagnostics(5.0, replace(fine, stopped="stopped /dev/ttyACM0")).status
    assert [(pair.key, pair.value) for pair in stop.values] == [
        ("last stop", "stopped /dev/ttyACM0")
    ]
    over = Facts(RUN, False, STATE, BOARD)
    assert _levels(over)["board"][0] == 3


def test_diagnostics_name_faults_and_keep_units() -> None:
    array = made.diagnostics(5.0, Facts(RUN, True, STATE, replace(BOARD, faults=("stopped",))))
    board = array.status[-1]
    assert (board.level, board.message, board.hardware_id) == (2, "stopped", "/dev/ttyACM0")
    values = {pair.key: pair.value for pair in board.values}
    assert values["left pressure (Pa)"] == "62053"
    assert values["supply (V)"] == "unknown"
    assert values["everted length (m)"] == "0.4000"
