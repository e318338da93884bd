"""The stream's messages in ROS's: SI units, REP 103's axes, which are the robot's own.

Pure functions; `ros` publishes what they return.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, isnan, pi, sin
from typing import Any

import numpy as np

from thigmo.contact_status import POINT_ESTIMATE
from thigmo.live import ros_types as ros
from thigmo.live.relay import Facts
from thigmo.reading_errors import Floats
from thigmo.record import Ellipse, MapContact, Pose
from thigmo.stream import BodyShape, Contacts, Grid, Telemetry
from thigmo.stream.recorded import config_in

BASE, TIP = "thigmo_base", "thigmo_tip"
_M_PER_CM = 0.01
_PA_PER_PSI = 6894.757
TENTHS = 10  # of the body, each of which is a link
_LONGEST_CHORD_M = 0.3  # of the longest robot, 300 cm
_SIGMAS_95 = 2 * 1.96  # standard deviations in a 95 % interval
_LINE_STRIP, _TEXT = 4, 9  # types of a marker
_ADD, _REMOVE_ALL = 0, 3  # its actions
_LINE_M, _TEXT_M = 0.005, 0.02  # width of a line and height of a letter
_SOLID, _PALE = 1.0, 0.4  # opacity of a contact that is localized, and of another
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
    poses = []
    for contact in contacts.contacts:
        pose = _pose((contact.x_cm, contact.y_cm, contact.normal_rad))
        known = ros.PoseWithCovariance(pose, _covariance(contact))
        poses.append(ros.PoseWithCovarianceStamped(head, known))
    return poses


def contact_markers(contacts: Contacts, frame: str) -> Any:
    """For a viewer: words at each contact, its 95 % ellipse, and the face of a wall.

    They are solid where the contact is localized, else pale, and replace earlier ones.
    """
    head = header(contacts.epoch_s, frame)
    markers = [_marker(head, "", 0, _LINE_STRIP, action=_REMOVE_ALL)]
    for n, contact in enumerate(contacts.contacts):
        place = contact.x_cm, contact.y_cm
        alpha = _SOLID if contact.status == "localized" else _PALE
        words = "\n".join(filter(None, (contact.certainty_text, contact.doubt)))
        markers.append(_marker(head, "words", n, _TEXT, alpha, place=place, text=words))
        if contact.status != POINT_ESTIMATE:
            ellipse = Ellipse.of(contact.covariance_cm2).outline(*place)
            markers.append(_marker(head, "ellipses", n, _LINE_STRIP, alpha, line=ellipse))
        if contact.surface:
            markers.append(_marker(head, "walls", n, _LINE_STRIP, alpha, line=contact.surface))
    return ros.MarkerArray(markers)


def _marker(
    head: Any,
    namespace: str,
    number: int,
    kind: int,
    alpha: float = 0.0,
    *,
    action: int = _ADD,
    line: Sequence[tuple[float, float]] = (),
    place: tuple[float, float] = (0.0, 0.0),
    text: str = "",
) -> Any:
    nothing = ros.CompressedImage(head, "", [])
    points = [ros.Point(x * _M_PER_CM, y * _M_PER_CM, 0.0) for x, y in line]
    return ros.Marker(
        head, namespace, number, kind, action, _pose((*place, 0.0)),
        ros.Vector3(_LINE_M, 0.0, _TEXT_M), ros.ColorRGBA(0.85, 0.15, 0.10, alpha),
        ros.Duration(0, 0), False, points, [], "", nothing, [], text, ros.MeshFile("", []), "",
        False,
    )  # fmt: skip


def body_path(shape: BodyShape, frame: str) -> Any:
    """The centreline, base to tip."""
    head = header(shape.epoch_s, frame)
    return ros.Path(head, [ros.PoseStamped(head, _pose(pose)) for pose in shape.poses])


def joint_state(shape: BodyShape) -> Any:
    """The joints of `robot_description`: turns (rad) and lengths (m) of the chords of the body's
    tenths; and the everted length (m).
    """
    bends, lengths, everted = _chords(shape)
    names = ["everted_length", *_numbered("bend"), *_numbered("grow")]
    return ros.JointState(
        header(shape.epoch_s, ""), names, [everted, *bends.tolist(), *lengths.tolist()], [], []
    )


def robot_description(shape: BodyShape) -> Any:
    """The robot as URDF: a chain of the chords of the body's tenths, each of which turns (`bend`)
    and lengthens (`grow`); spheres of the tube's radius where they meet.
    """
    ball = f'<sphere radius="{shape.radius_cm * _M_PER_CM:g}"/>'
    visual = f"<visual><geometry>{ball}</geometry></visual>"
    limits = 'lower="{}" upper="{}" effort="0" velocity="0"'
    parts = [f'<link name="{BASE}">{visual}</link>']
    parent = BASE
    for bend, grow, chord, end in _chain():
        for joint, kind, axis, link, span, shown in (
            (bend, "revolute", "0 0 1", chord, (-pi, pi), ""),
            (grow, "prismatic", "1 0 0", end, (0, _LONGEST_CHORD_M), visual),
        ):
            parts.append(
                f'<link name="{link}">{shown}</link><joint name="{joint}" type="{kind}">'
                f'<parent link="{parent}"/><child link="{link}"/><axis xyz="{axis}"/>'
                f"<limit {limits.format(*span)}/></joint>"
            )
            parent = link
    return ros.String(f'<?xml version="1.0"?><robot name="thigmo">{"".join(parts)}</robot>')


def body_transforms(shape: BodyShape) -> Any:
    """The links of `robot_description`, each in its parent's frame, and the tip in the base's."""
    transforms = [_transform(header(shape.epoch_s, BASE), TIP, shape.poses[-1])]
    bends, lengths, _ = _chords(shape)
    parent = BASE
    for turn, length, (_, _, chord, end) in zip(bends, lengths / _M_PER_CM, _chain(), strict=True):
        transforms.append(_transform(header(shape.epoch_s, parent), chord, (0.0, 0.0, turn)))
        transforms.append(_transform(header(shape.epoch_s, chord), end, (length, 0.0, 0.0)))
        parent = end
    return ros.TFMessage(transforms)


def _chords(shape: BodyShape) -> tuple[Floats, Floats, float]:
    """Turns (TENTHS,) from each chord to the next, the first from the base's axis, rad; their
    lengths (TENTHS,) and the length of the body, m.
    """
    x, y, _ = np.asarray(shape.poses, dtype=np.float64).T * _M_PER_CM
    along = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))))
    places = np.linspace(0.0, along[-1], TENTHS + 1)
    dx, dy = np.diff(np.interp(places, along, x)), np.diff(np.interp(places, along, y))
    directions = np.unwrap(np.concatenate(([0.0], np.arctan2(dy, dx))))
    return np.diff(directions), np.hypot(dx, dy), float(along[-1])


def _numbered(name: str) -> list[str]:
    return [f"{name}_{number}" for number in range(1, TENTHS + 1)]


def _chain() -> list[tuple[str, str, str, str]]:
    """Of each tenth: its two joints, and the links that they move."""
    names = ("bend", "grow", "thigmo_chord", "thigmo_end")
    return list(zip(*map(_numbered, names), strict=True))


def base_transform(epoch_s: float, frame: str) -> Any:
    """The base in the map's frame: at its origin."""
    return ros.TFMessage([_transform(header(epoch_s, frame), BASE, (0.0, 0.0, 0.0))])


def diagnostics(epoch_s: float, facts: Facts) -> Any:
    """How the way to stop, the run and the board are, at a time since 1970."""
    robot = facts.run.url if facts.run else ""
    board, state = facts.board, facts.state

    def status(part: str, level: int, text: str, values: dict[str, str]) -> Any:
        pairs = [ros.KeyValue(key, value) for key, value in values.items()]
        return ros.DiagnosticStatus(level, f"thigmo: {part}", text, robot, pairs)

    open_way = "a message on the stop topic stops the robot"
    last = {"last stop": facts.stopped}
    parts = [status("stop", _ERROR if facts.stop else _OK, facts.stop or open_way, last)]
    if state is None:
        parts.append(status("run", _STALE, "no run has spoken yet", {}))
    else:
        level = _ERROR if state.outcome.startswith("aborted") else _OK
        detail = state.doing if state.outcome == "running" else state.outcome
        values = {
            "state": state.state,
            "stage (m)": f"{state.stage_cm * _M_PER_CM:.4f}",
            "done": f"{state.done:.3f}",
            "paused": str(state.paused).lower(),
            "under way": str(facts.under_way).lower(),
        }
        parts.append(status("run", level, detail, values))
    if board is not None:
        level = _STALE if not facts.under_way else _ERROR if board.faults else _OK
        detail = ", ".join(board.faults) or board.state
        parts.append(status("board", level, detail, _board_values(board, facts)))
    return ros.DiagnosticArray(header(epoch_s, ""), parts)


def _board_values(board: Telemetry, facts: Facts) -> dict[str, str]:
    values = {
        "state": board.state,
        "activity": board.activity,
        "everted length (m)": _number(board.length_cm * _M_PER_CM, 4),
        "motor duty": _number(board.motor, 3),
        "supply (V)": _number(board.supply_v, 2),
    }
    config = config_in(facts.run.folder if facts.run else "")
    for number, muscle in enumerate(config.muscles):
        name = muscle.name
        values[f"{name} pressure (Pa)"] = _number(board.pressure_psi[number] * _PA_PER_PSI, 0)
        values[f"{name} set point (Pa)"] = _number(board.demand_psi[number] * _PA_PER_PSI, 0)
        values[f"{name} transducer (mA)"] = _number(board.drive_ma[number], 2)
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
    return ros.TransformStamped(head, child, moved)


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
    steps = np.diff(np.reshape(track, (-1, 2)), axis=0)
    x, y = steps[np.any(steps != 0.0, axis=1)].T
    if len(x) < 2:
        return pi**2 / 3  # any direction
    return float((np.ptp(np.unwrap(np.arctan2(y, x))) / _SIGMAS_95) ** 2)
