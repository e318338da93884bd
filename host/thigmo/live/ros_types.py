"""The ROS 2 messages that `ros` speaks, as DDS types.

Fields and their order are those of ROS 2's own .msg files (common_interfaces, geometry2 and
rcl_interfaces, from Humble on). Lengths in m, angles in rad (REP 103).
"""

from typing import Any

from cyclonedds.idl import make_idl_struct, types
from cyclonedds.idl.types import byte, float32, float64, int8, int32, uint8, uint32

# The plugin for mypy knows these in annotations alone.
array: Any = types.array
sequence: Any = types.sequence


def _message(name: str, /, **fields: Any) -> Any:
    """A class of messages. DDS knows `std_msgs/Header` as `std_msgs::msg::dds_::Header_`
    (design.ros2.org, "Topic and Service name mapping to DDS")."""
    package, kind = name.split("/")
    return make_idl_struct(kind, f"{package}::msg::dds_::{kind}_", fields)


Time = _message("builtin_interfaces/Time", sec=int32, nanosec=uint32)  # since 1970, UTC
Header = _message("std_msgs/Header", stamp=Time, frame_id=str)
# IDL knows no structure without a member.
Empty = _message("std_msgs/Empty", structure_needs_at_least_one_member=uint8)

String = _message("std_msgs/String", data=str)

Point = _message("geometry_msgs/Point", x=float64, y=float64, z=float64)
Vector3 = _message("geometry_msgs/Vector3", x=float64, y=float64, z=float64)
Quaternion = _message("geometry_msgs/Quaternion", x=float64, y=float64, z=float64, w=float64)
Pose = _message("geometry_msgs/Pose", position=Point, orientation=Quaternion)
PoseStamped = _message("geometry_msgs/PoseStamped", header=Header, pose=Pose)
# The covariance is of x, y, z and the rotations about them, row by row.
PoseWithCovariance = _message(
    "geometry_msgs/PoseWithCovariance", pose=Pose, covariance=array[float64, 36]
)
PoseWithCovarianceStamped = _message(
    "geometry_msgs/PoseWithCovarianceStamped", header=Header, pose=PoseWithCovariance
)
Transform = _message("geometry_msgs/Transform", translation=Vector3, rotation=Quaternion)
TransformStamped = _message(  # the pose of a child frame in the header's frame
    "geometry_msgs/TransformStamped", header=Header, child_frame_id=str, transform=Transform
)
TFMessage = _message("tf2_msgs/TFMessage", transforms=sequence[TransformStamped])

MapMetaData = _message(
    "nav_msgs/MapMetaData",
    map_load_time=Time, resolution=float32, width=uint32, height=uint32, origin=Pose,
)  # fmt: skip
# Cells row by row from the lowest y: 0 free to 100 occupied, -1 unknown.
OccupancyGrid = _message(
    "nav_msgs/OccupancyGrid", header=Header, info=MapMetaData, data=sequence[int8]
)
Path = _message("nav_msgs/Path", header=Header, poses=sequence[PoseStamped])

# Of markers in use here: lines, words, and what removes earlier ones. The rest stays empty.
ColorRGBA = _message("std_msgs/ColorRGBA", r=float32, g=float32, b=float32, a=float32)
Duration = _message("builtin_interfaces/Duration", sec=int32, nanosec=uint32)
CompressedImage = _message(
    "sensor_msgs/CompressedImage", header=Header, format=str, data=sequence[uint8]
)
UVCoordinate = _message("visualization_msgs/UVCoordinate", u=float32, v=float32)
MeshFile = _message("visualization_msgs/MeshFile", filename=str, data=sequence[uint8])
Marker = _message(
    "visualization_msgs/Marker",
    header=Header, ns=str, id=int32, type=int32, action=int32, pose=Pose, scale=Vector3,
    color=ColorRGBA, lifetime=Duration, frame_locked=bool, points=sequence[Point],
    colors=sequence[ColorRGBA], texture_resource=str, texture=CompressedImage,
    uv_coordinates=sequence[UVCoordinate], text=str, mesh_file=MeshFile, mesh_resource=str,
    mesh_use_embedded_materials=bool,
)  # fmt: skip
MarkerArray = _message("visualization_msgs/MarkerArray", markers=sequence[Marker])

_Numbers = sequence[float64]  # empty where nothing is known
JointState = _message(
    "sensor_msgs/JointState",
    header=Header, name=sequence[str], position=_Numbers, velocity=_Numbers, effort=_Numbers,
)  # fmt: skip
KeyValue = _message("diagnostic_msgs/KeyValue", key=str, value=str)
DiagnosticStatus = _message(  # level 0 fine, 1 warning, 2 error, 3 stale
    "diagnostic_msgs/DiagnosticStatus",
    level=byte, name=str, message=str, hardware_id=str, values=sequence[KeyValue],
)  # fmt: skip
DiagnosticArray = _message(
    "diagnostic_msgs/DiagnosticArray", header=Header, status=sequence[DiagnosticStatus]
)
