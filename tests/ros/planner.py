"""A planner on ROS 2: a real rclpy node, which the tests run in ROS's own environment.

It prints what it receives, one JSON object a line. Given a line, it publishes stops until the
diagnostics tell of one: DDS may lose what is published while reader and writer are still getting to
know each other. Given "stop, latched" it says it once, from a publisher that nobody knows yet.
Arguments: the namespace.
"""

import json
import sys
import threading
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid, Path
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty
from visualization_msgs.msg import Marker, MarkerArray


def latched(depth: int) -> QoSProfile:
    """As planners subscribe to a map."""
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


def tell(topic: str, **fields: Any) -> None:
    print(json.dumps({"topic": topic, **fields}), flush=True)


def head(message: Any) -> dict[str, Any]:
    stamp = message.header.stamp
    return {"stamp": [stamp.sec, stamp.nanosec], "frame": message.header.frame_id}


def pose(message: Any) -> list[float]:
    at, turn = message.position, message.orientation
    return [at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w]


def on_map(grid: OccupancyGrid) -> None:
    info = grid.info
    tell(
        "map", **head(grid), resolution=info.resolution, size=[info.width, info.height],
        origin=pose(info.origin), cells=list(grid.data),
    )  # fmt: skip


def on_contact(contact: PoseWithCovarianceStamped) -> None:
    inner = contact.pose
    tell("contact", **head(contact), pose=pose(inner.pose), covariance=list(inner.covariance))


def on_walls(walls: MarkerArray) -> None:
    lines = [each for each in walls.markers if each.action == Marker.ADD]
    tell(
        "walls",
        removed=sum(each.action == Marker.DELETEALL for each in walls.markers),
        lines=[[[p.x, p.y, p.z] for p in each.points] for each in lines],
        kinds=[each.type for each in lines], texts=[each.text for each in lines],
        solid=[each.color.a for each in lines],
    )  # fmt: skip


def on_body(path: Path) -> None:
    tell("body", **head(path), poses=[pose(each.pose) for each in path.poses])


def on_joints(joints: JointState) -> None:
    tell("joints", **head(joints), names=list(joints.name), positions=list(joints.position))


STOPPED = threading.Event()


def on_diagnostics(array: DiagnosticArray) -> None:
    for status in array.status:
        if any(value.key == "last stop" and value.value for value in status.values):
            STOPPED.set()
        tell(
            "diagnostics", name=status.name, level=status.level[0], message=status.message,
            hardware=status.hardware_id, values={v.key: v.value for v in status.values},
        )  # fmt: skip


def main() -> None:
    namespace = sys.argv[1]
    rclpy.init()
    node = Node("planner")
    subscribe = node.create_subscription
    subscribe(OccupancyGrid, f"/{namespace}/map", on_map, latched(1))
    subscribe(PoseWithCovarianceStamped, f"/{namespace}/contacts", on_contact, latched(100))
    subscribe(MarkerArray, f"/{namespace}/walls", on_walls, latched(1))
    subscribe(Path, f"/{namespace}/body", on_body, latched(1))
    subscribe(JointState, f"/{namespace}/joint_states", on_joints, qos_profile_sensor_data)
    subscribe(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
    stops = {
        "stop": node.create_publisher(Empty, f"/{namespace}/stop", 1),
        "stop, best effort": node.create_publisher(
            Empty, f"/{namespace}/stop", qos_profile_sensor_data
        ),
    }
    threading.Thread(target=obey, args=(node, namespace, stops), daemon=True).start()
    tell("ready")
    while rclpy.ok():
        rclpy.spin_once(node, timeout_sec=0.1)


def obey(node: Node, namespace: str, stops: dict[str, Any]) -> None:
    """Thread: stops."""
    for line in sys.stdin:
        if line == "stop, latched\n":
            stops["latched"] = node.create_publisher(Empty, f"/{namespace}/stop", latched(1))
            stops["latched"].publish(Empty())
            tell("said")
            continue
        while not STOPPED.wait(0.1):
            stops[line.strip()].publish(Empty())


main()
