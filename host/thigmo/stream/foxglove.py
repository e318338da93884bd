"""The stream's messages as Foxglove's well-known schemas, for tools that draw them by themselves.

The body and the contacts as a scene, the tip as a transform, the map as a grid, events and lines as
a log. Those schemas are SI: metres and radians, in frame "room", which is the robot's base frame.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from math import cos, sin
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Grid_pb2 import Grid as GridView
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log as LogView
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose as PoseView
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.Vector2_pb2 import Vector2
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.message import Message as Proto
from google.protobuf.timestamp_pb2 import Timestamp

from thigmo.contact_status import POINT_ESTIMATE
from thigmo.record import Ellipse, MapContact
from thigmo.stream.messages import BodyShape, Contacts, Event, Grid, Log, Message

SCENE, TRANSFORM, GRID, LOG = "/foxglove/scene", "/foxglove/tf", "/foxglove/grid", "/foxglove/log"
VIEWS: dict[str, type[Proto]] = {
    SCENE: SceneUpdate, TRANSFORM: FrameTransform, GRID: GridView, LOG: LogView,
}  # fmt: skip
ROOM, TIP = "room", "tip"

_M = 0.01  # per cm
_BODY, _SURE, _UNSURE = (
    Color(r=0.30, g=0.55, b=0.85, a=0.8),
    Color(r=0.85, g=0.15, b=0.10, a=1.0),
    Color(r=0.95, g=0.65, b=0.10, a=1.0),
)
_CONTACT_M = 0.01
_LEVELS = {"info": LogView.INFO, "warning": LogView.WARNING, "fault": LogView.ERROR}
# Occupancy (an int8: 0, 100, -1) and its colour: free is pale, occupied dark, unknown unseen.
_GREYS = {0: (0xE8, 0xF2, 0xE8, 0xB0), 100: (0x30, 0x18, 0x18, 0xFF), -1: (0, 0, 0, 0)}
_UINT8, _INT8 = PackedElementField.UINT8, PackedElementField.INT8


def views(message: Message) -> list[tuple[str, Proto]]:
    """What a message is in Foxglove's schemas: topics and messages; none for many."""
    stamp = Timestamp()
    stamp.FromNanoseconds(round(message.epoch_s * 1e9))
    match message:
        case BodyShape():
            return [(SCENE, _body(message, stamp)), (TRANSFORM, _tip(message, stamp))]
        case Contacts():
            return [(SCENE, _contacts(message, stamp))]
        case Grid():
            return [(GRID, _grid(message, stamp))]
        case Event():
            text = "; ".join(filter(None, (message.message, message.next)))
            name, level = message.name, message.severity
        case Log():
            name, level, text = "thigmo", message.level, message.text
        case _:
            return []
    return [(LOG, LogView(timestamp=stamp, level=_LEVELS[level], name=name, message=text))]


def _body(shape: BodyShape, stamp: Timestamp) -> SceneUpdate:
    points = [(x, y) for x, y, _ in shape.poses]
    entity = SceneEntity(timestamp=stamp, frame_id=ROOM, id="body", frame_locked=True)
    entity.lines.append(_line(points, 2 * shape.radius_cm * _M, _BODY))
    return SceneUpdate(entities=[entity])


def _tip(shape: BodyShape, stamp: Timestamp) -> FrameTransform:
    pose = _pose(*shape.poses[-1])
    return FrameTransform(
        timestamp=stamp,
        parent_frame_id=ROOM,
        child_frame_id=TIP,
        translation=pose.position,
        rotation=pose.orientation,
    )


def _contacts(message: Contacts, stamp: Timestamp) -> SceneUpdate:
    """All contacts; they replace the earlier ones."""
    entities = [
        _contact(f"contact {number}", contact, stamp)
        for number, contact in enumerate(message.contacts)
    ]
    # Merged ones get other numbers: what is beyond the last must go.
    beyond = SceneEntityDeletion(
        timestamp=stamp,
        type=SceneEntityDeletion.MATCHING_ID,
        id=f"contact {len(entities)}",
    )
    return SceneUpdate(deletions=[beyond], entities=entities)


def _contact(name: str, contact: MapContact, stamp: Timestamp) -> SceneEntity:
    color = _SURE if contact.status == "localized" else _UNSURE
    size = Vector3(x=_CONTACT_M, y=_CONTACT_M, z=_CONTACT_M)
    entity = SceneEntity(timestamp=stamp, frame_id=ROOM, id=name, frame_locked=True)
    place = _pose(contact.x_cm, contact.y_cm, contact.normal_rad)
    entity.spheres.append(SpherePrimitive(pose=place, size=size, color=color))
    if contact.status != POINT_ESTIMATE:
        entity.lines.append(_line(contact.track, _CONTACT_M / 3, color))
        ellipse = Ellipse.of(contact.covariance_cm2).outline(contact.x_cm, contact.y_cm)
        entity.lines.append(_line(ellipse, _CONTACT_M / 6, color))
    if contact.surface:
        entity.lines.append(_line(contact.surface, _CONTACT_M, color))
    for key, value in {
        "kind": contact.kind_text,
        "status": contact.status,
        "probability": f"{contact.probability:.4f}",
        "explanations": contact.explanation_text,
        "doubt": contact.doubt,
        "arc_cm": f"{contact.arc_cm:.2f}",
        "interval_cm": contact.interval_text,
        "covariance_cm2": json.dumps(contact.covariance_cm2),
        "force": contact.force_text,
    }.items():
        entity.metadata.add(key=key, value=value)
    return entity


def _grid(grid: Grid, stamp: Timestamp) -> GridView:
    cells = np.asarray(grid.cells, dtype=np.int8)
    packed = np.zeros((cells.size, 5), dtype=np.uint8)
    packed[:, 0] = cells.view(np.uint8)
    for value, color in _GREYS.items():
        packed[cells == value, 1:] = color
    fields: Any = [PackedElementField(name="occupancy", offset=0, type=_INT8)]
    for offset, name in enumerate(("red", "green", "blue", "alpha"), start=1):
        fields.append(PackedElementField(name=name, offset=offset, type=_UINT8))
    side = grid.resolution_cm * _M
    return GridView(
        timestamp=stamp,
        frame_id=ROOM,
        pose=_pose(*grid.origin),
        column_count=grid.width,
        cell_size=Vector2(x=side, y=side),
        cell_stride=5,
        row_stride=5 * grid.width,
        fields=fields,
        data=packed.tobytes(),
    )


def _line(points: Sequence[tuple[float, float]], thickness_m: float, color: Color) -> LinePrimitive:
    return LinePrimitive(
        type=LinePrimitive.LINE_STRIP,
        pose=_pose(0.0, 0.0, 0.0),
        thickness=thickness_m,
        points=[Point3(x=x * _M, y=y * _M) for x, y in points],
        color=color,
    )


def _pose(x_cm: float, y_cm: float, heading: float) -> PoseView:
    return PoseView(
        position=Vector3(x=x_cm * _M, y=y_cm * _M),
        orientation=Quaternion(z=sin(heading / 2), w=cos(heading / 2)),
    )
