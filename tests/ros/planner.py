"""A planner on ROS 2: a real rclpy node, which the tests run in ROS's own environment.

It prints what it receives, one JSON object a line. Given a line, it publishes stops until the
diagnostics tell of one: DDS may lose what is published while reader and writer are still getting to
know each other. Given "stop, latched" it says it once, from a publisher that nobody knows yet.
"call NAME" calls the service of that name, "explore SECONDS" sends a goal, "cancel" cancels it.
Arguments: the namespace.
"""

import json
import sys
import threading
from typing import Any

import rclpy
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid, Path
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, String
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray


def latched(depth: int) -> QoSProfile:
    """As planners subscribe to a map."""
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


def tell(topic: str, **fields: Any) -> None:
    """Print one line. Two threads call it; `print` would write a line and its end apart."""
    sys.stdout.write(json.dumps({"topic": topic, **fields}) + "\n")
    sys.stdout.flush()


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


def on_contact_markers(array: MarkerArray) -> None:
    added = [marker for marker in array.markers if marker.action == Marker.ADD]
    tell(
        "contact_markers",
        removed=sum(marker.action == Marker.DELETEALL for marker in array.markers),
        markers={
            marker.ns: {
                "kind": marker.type, "points": [[p.x, p.y, p.z] for p in marker.points],
                "at": pose(marker.pose), "text": marker.text, "alpha": marker.color.a,
            }
            for marker in added
        },
    )  # fmt: skip


def on_body(path: Path) -> None:
    tell("body", **head(path), poses=[pose(stamped.pose) for stamped in path.poses])


def on_joints(joints: JointState) -> None:
    tell("joints", **head(joints), names=list(joints.name), positions=list(joints.position))


def on_description(urdf: String) -> None:
    tell("description", urdf=urdf.data)


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
    subscribe(MarkerArray, f"/{namespace}/contact_markers", on_contact_markers, latched(1))
    subscribe(Path, f"/{namespace}/body", on_body, latched(1))
    subscribe(JointState, f"/{namespace}/joint_states", on_joints, qos_profile_sensor_data)
    subscribe(DiagnosticArray, "/diagnostics", on_diagnostics, 10)
    subscribe(String, f"/{namespace}/robot_description", on_description, latched(1))
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


def call(node: Node, name: str) -> None:
    service = node.create_client(Trigger, name)
    service.wait_for_service()
    answer = service.call(Trigger.Request())
    tell("answer", name=name, success=answer.success, message=answer.message)


class Exploration:
    """A goal of the action; what comes of it is printed."""

    accepted = False

    def __init__(self, client: ActionClient, seconds: float) -> None:
        from thigmo_ros.action import Explore

        goal = Explore.Goal(name="by-action", time=seconds)
        client.send_goal_async(goal, self._on_feedback).add_done_callback(self._on_accepted)

    def cancel(self) -> None:
        self._goal.cancel_goal_async()

    def _on_feedback(self, message: Any) -> None:
        said = message.feedback
        tell("feedback", doing=said.doing, done=said.done, stage=said.stage)

    def _on_accepted(self, future: Any) -> None:
        self._goal = future.result()
        self.accepted = self._goal.accepted
        tell("goal", accepted=self.accepted)
        if self.accepted:
            self._goal.get_result_async().add_done_callback(self._on_result)

    def _on_result(self, future: Any) -> None:
        status, result = future.result().status, future.result().result
        name = {
            GoalStatus.STATUS_SUCCEEDED: "succeeded",
            GoalStatus.STATUS_CANCELED: "canceled",
            GoalStatus.STATUS_ABORTED: "aborted",
        }[status]
        tell(
            "result", status=name, outcome=result.outcome, folder=result.folder,
            contacts=result.contacts, length=result.length,
        )  # fmt: skip


def explorer(node: Node, name: str) -> ActionClient:
    """The client of the action. One serves all goals, as in a planner."""
    from thigmo_ros.action import Explore  # the package, which only some tests have built

    client = ActionClient(node, Explore, name)
    client.wait_for_server()
    return client


def obey(node: Node, namespace: str, stops: dict[str, Any]) -> None:
    client: ActionClient | None = None
    explorations: list[Exploration] = []
    for line in sys.stdin:
        command, _, argument = line.strip().partition(" ")
        if command == "call":
            call(node, f"/{namespace}/{argument}")
            continue
        if command == "explore":
            client = client or explorer(node, f"/{namespace}/explore")
            explorations.append(Exploration(client, float(argument)))
            continue
        if command == "cancel":
            next(
                exploration for exploration in reversed(explorations) if exploration.accepted
            ).cancel()
            continue
        if line == "stop, latched\n":
            stops["latched"] = node.create_publisher(Empty, f"/{namespace}/stop", latched(1))
            stops["latched"].publish(Empty())
            tell("said")
            continue
        while not STOPPED.wait(0.1):
            stops[line.strip()].publish(Empty())


main()
