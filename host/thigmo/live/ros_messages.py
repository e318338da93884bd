"""The stream's messages in ROS's: SI units, REP 103's axes, which are the robot's own.

Pure functions; `ros` publishes what they return.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import atan2, cos, hypot, isnan, pi, sin
from typing import Any

import numpy as np

from thigmo.live import ros_types as ros
from thigmo.live.relay import Facts
from thigmo.record import MapContact, Pose
from thigmo.stream import BodyShape, Contacts, Grid, Telemetry

BASE, TIP = "thigmo_base", "thigmo_tip"
_M_PER_CM = 0.01
_PA_PER_PSI = 6894.757
BENDS = 10  # joints that stand for the body's bend
_SIGMAS_95 = 2 * 1.96  # standard deviations in a 95 % interval
_OK, _ERROR, _STALE = 0, 2, 3  # levels of a diagnostic status


def header(epoch_s: float, frame: str) -> Any:
    """Header at a time since 1970, UTC."""
    nanoseconds = round(epoch_s * 1e9)
    return ros.Header(ros.Time(*divmod(nanoseconds, 1_000_000_000)), frame)


def occupancy_grid(grid: Grid, frame: str) -> Any:
    """The map; its cells mean the same in both worlds."""
    head = header(grid.epoch_s, frame)
    size = grid.resolution_cm * _M_PER_CM
    info = ros.MapMetaData(head.stamp, size, grid.width, grid.height, _pose(grid.origin))
    return ros.OccupancyGrid(head, info, list(grid.cells))


def contact_poses(contacts: Contacts, frame: str) -> list[Any]:
    """One pose for each contact, all with the same stamp, in the order of their discovery.

    A pose lies on the touched surface, and its x axis points into the obstacle.
    """
    head = header(contacts.epoch_s, frame)
    return [
        ros.PoseWithCovarianceStamped(
            head,
            ros.PoseWithCovariance(
                _pose((contact.x_cm, contact.y_cm, contact.normal_rad)), _covariance(contact)
            ),
        )
        for contact in contacts.contacts
    ]


def body_path(shape: BodyShape, frame: str) -> Any:
    """The centreline, base to tip."""
    head = header(shape.epoch_s, frame)
    return ros.Path(head, [ros.PoseStamped(head, _pose(pose)) for pose in shape.poses])


def joint_state(shape: BodyShape) -> Any:
    """The everted length (a prismatic joint, m), and the turn of each tenth of the body (rad)."""
    along, heading = _along(shape)
    turns = np.diff(np.interp(np.linspace(0.0, along[-1], BENDS + 1), along, heading))
    names = ["everted_length", *(f"bend_{number}" for number in range(1, BENDS + 1))]
    positions = [float(along[-1]) * _M_PER_CM, *turns.tolist()]
    return ros.JointState(header(shape.epoch_s, ""), names, positions, [], [])


def tip_transform(shape: BodyShape) -> Any:
    """The tip in the base's frame."""
    return _transform(header(shape.epoch_s, BASE), TIP, shape.poses[-1])


def base_transform(epoch_s: float, frame: str) -> Any:
    """The base in the map's frame: at its origin."""
    return _transform(header(epoch_s, frame), BASE, (0.0, 0.0, 0.0))


def diagnostics(epoch_s: float, facts: Facts) -> Any:
    """How the way to stop, the run and the board are, at a time since 1970."""
    robot = facts.run.url if facts.run else ""
    board, state = facts.board, facts.state

    def status(part: str, level: int, said: str, values: dict[str, str]) -> Any:
        pairs = [ros.KeyValue(key, value) for key, value in values.items()]
        return ros.DiagnosticStatus(level, f"thigmo: {part}", said, robot, pairs)

    open_way = "a message on the stop topic stops the robot"
    last = {"last stop": facts.stopped}
    parts = [status("stop", _ERROR if facts.stop else _OK, facts.stop or open_way, last)]
    if state is None:
        parts.append(status("run", _STALE, "no run has spoken yet", {}))
    else:
        aborted = state.outcome.startswith("aborted")
        parts.append(
            status(
                "run",
                _ERROR if aborted else _OK,
                state.doing if state.outcome == "running" else state.outcome,
                {
                    "state": state.state,
                    "stage (m)": f"{state.stage_cm * _M_PER_CM:.4f}",
                    "done": f"{state.done:.3f}",
                    "paused": str(state.paused).lower(),
                },
            )
        )
    if board is not None:
        parts.append(
            status(
                "board",
                _board_level(board, facts),
                ", ".join(board.faults) or board.state,
                _board_values(board),
            )
        )
    return ros.DiagnosticArray(header(epoch_s, ""), parts)


def _board_level(board: Telemetry, facts: Facts) -> int:
    if not facts.under_way:
        return _STALE
    return _ERROR if board.faults else _OK


def _board_values(board: Telemetry) -> dict[str, str]:
    values = {
        "state": board.state,
        "activity": board.activity,
        "everted length (m)": _number(board.length_cm * _M_PER_CM, 4),
        "motor duty": _number(board.motor, 3),
        "supply (V)": _number(board.supply_v, 2),
    }
    for side, pressure, demand, drive in zip(
        ("left", "right"), board.pressure_psi, board.demand_psi, board.drive_ma, strict=True
    ):
        values[f"{side} pressure (Pa)"] = _number(pressure * _PA_PER_PSI, 0)
        values[f"{side} set point (Pa)"] = _number(demand * _PA_PER_PSI, 0)
        values[f"{side} transducer (mA)"] = _number(drive, 2)
    return values


def _number(value: float, digits: int) -> str:
    return "unknown" if isnan(value) else f"{value:.{digits}f}"


def _pose(pose: Pose) -> Any:
    x, y, heading = pose
    return ros.Pose(ros.Point(x * _M_PER_CM, y * _M_PER_CM, 0.0), _turned(heading))


def _turned(heading: float) -> Any:
    return ros.Quaternion(0.0, 0.0, sin(heading / 2), cos(heading / 2))


def _transform(head: Any, child: str, pose: Pose) -> Any:
    x, y, heading = pose
    moved = ros.Transform(ros.Vector3(x * _M_PER_CM, y * _M_PER_CM, 0.0), _turned(heading))
    return ros.TFMessage([ros.TransformStamped(head, child, moved)])


def _along(shape: BodyShape) -> tuple[np.ndarray, np.ndarray]:
    """Arc length (cm) and heading (unwrapped) of each pose."""
    x, y, heading = np.asarray(shape.poses, dtype=np.float64).T
    along = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))))
    return along, np.unwrap(heading)


def _covariance(contact: MapContact) -> list[float]:
    """Of x, y, z and the rotations about them; the robot moves in the plane, where the others are
    exactly known.
    """
    table = np.zeros((6, 6))
    table[:2, :2] = np.asarray(contact.covariance_cm2) * _M_PER_CM**2
    table[5, 5] = _heading_variance(contact.track)
    values: list[float] = table.ravel().tolist()
    return values


def _heading_variance(track: Sequence[tuple[float, float]]) -> float:
    """Of the surface's direction: the skin turns by so much over the 95 % interval along it."""
    steps = [
        (x1 - x0, y1 - y0)
        for (x0, y0), (x1, y1) in pairwise(track)
        if hypot(x1 - x0, y1 - y0) > 0.0
    ]
    if len(steps) < 2:
        return pi**2 / 3  # any direction
    heading = np.unwrap([atan2(dy, dx) for dx, dy in steps])
    return float((np.ptp(heading) / _SIGMAS_95) ** 2)
