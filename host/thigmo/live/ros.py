"""A run on ROS 2: maps, contacts and the body for planners, and a topic that stops the robot.

Cyclone DDS speaks to every ROS 2 middleware on DDS without an installation of ROS. Of ROS's own
conventions the topics' and types' names and the qualities of service are all that is needed.
Services and actions do not interoperate between the vendors' layers: those are ros/thigmo_ros's.
docs/ros.md lists all.

Contacts are poses with covariances because that is what estimators and planners take; markers are
for eyes and carry no covariance. Walls are markers as well: no pose says where a line is.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from typing import Any
from xml.sax.saxutils import quoteattr

from cyclonedds.core import DDSException, Listener, Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from thigmo.closing import Closing
from thigmo.errors import DataError, LinkError
from thigmo.live import ros_messages as made
from thigmo.live import ros_types as ros
from thigmo.live.relay import Facts
from thigmo.stream import BodyShape, Contacts, Grid, Message

_DEPTH = 100  # contacts that a late listener gets, and transforms under way
# Types, how many messages a reader may be behind, and whether late listeners get the last of them.
_TOPICS = {
    "map": (ros.OccupancyGrid, 1, True),
    "contacts": (ros.PoseWithCovarianceStamped, _DEPTH, True),
    "contact_markers": (ros.MarkerArray, 1, True),
    "body": (ros.Path, 1, True),
    "robot_description": (ros.String, 1, True),
    "joint_states": (ros.JointState, 10, False),
    "tf": (ros.TFMessage, _DEPTH, False),
    "tf_static": (ros.TFMessage, 1, True),
    "diagnostics": (ros.DiagnosticArray, 10, False),
}
_GLOBAL = ("tf", "tf_static", "diagnostics")  # in no namespace
_WIRE = Policy.DataRepresentation(use_cdrv0_representation=True)  # XCDR 1, as all of ROS 2
_RELIABLE = Policy.Reliability.Reliable(duration(milliseconds=100))
# DDS ports of a machine's first participants, at which ROS 2 looks for local ones, too
# (ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST).
_LOCAL_PARTICIPANTS = 32


class RosNode(Closing):
    """The topics. A context manager.

    `on_stop` is called when a stop arrives, in a thread of DDS: it must be quick. A frame of
    `made.BASE` says nothing of where the robot stands; without an interface it keeps to this
    machine. Raises DataError for a name that ROS does not allow, LinkError if DDS cannot start.
    """

    def __init__(
        self,
        on_stop: Callable[[], None],
        *,
        namespace: str = "thigmo",
        frame: str = "map",
        domain: int = 0,
        interface: str | None = None,
    ) -> None:
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*", namespace):
            raise DataError(f"{namespace!r} is not a ROS namespace", "use letters, digits and /")
        self._frame = frame
        self._described = False
        try:
            self._domain = Domain(domain, configuration(interface))
            self._participant = DomainParticipant(domain)
            self._writers = {
                topic: self._writer(topic if topic in _GLOBAL else f"{namespace}/{topic}", *offer)
                for topic, offer in _TOPICS.items()
            }
            self._stops = self._stop_readers(f"rt/{namespace}/stop", on_stop)
        except DDSException as error:
            raise LinkError(
                f"DDS cannot start in domain {domain}: {error}",
                "check --domain, --interface and CYCLONEDDS_URI",
            ) from error
        if frame != made.BASE:
            self._writers["tf_static"].write(made.base_transform(time.time(), frame))

    def publish(self, message: Message) -> None:
        """Publish what a message of the stream says, if ROS has its kind."""
        match message:
            case Grid():
                self._writers["map"].write(made.occupancy_grid(message, self._frame))
            case Contacts():
                for pose in made.contact_poses(message, self._frame):
                    self._writers["contacts"].write(pose)
                markers = made.contact_markers(message, self._frame)
                self._writers["contact_markers"].write(markers)
            case BodyShape() if len(message.poses) > 1:
                if not self._described:
                    self._described = True
                    self._writers["robot_description"].write(made.robot_description(message))
                self._writers["body"].write(made.body_path(message, self._frame))
                self._writers["joint_states"].write(made.joint_state(message))
                self._writers["tf"].write(made.body_transforms(message))

    def tell(self, facts: Facts) -> None:
        """Publish how things are, as diagnostics."""
        self._writers["diagnostics"].write(made.diagnostics(time.time(), facts))

    def close(self) -> None:
        """Leave the domain."""
        del self._stops, self._writers, self._participant, self._domain

    def _writer(self, topic: str, kind: Any, depth: int, latched: bool) -> DataWriter[Any]:
        history = Policy.History.KeepLast(depth)
        policies = [_RELIABLE, history, _WIRE]
        if latched:
            # What a late listener gets is kept apart from what is under way.
            policies += [
                Policy.Durability.TransientLocal,
                Policy.DurabilityService(duration(seconds=0), history, -1, -1, -1),
            ]
        named = Topic(self._participant, f"rt/{topic}", kind)
        return DataWriter(self._participant, named, qos=Qos(*policies))

    def _stop_readers(self, topic: str, on_stop: Callable[[], None]) -> list[DataReader[Any]]:
        """A reader for each quality that publishers may offer: DDS connects none with a reader that
        wants more. Those that keep their last message for late listeners deliver also what they
        said before the two knew each other.
        """
        offered = (
            (_RELIABLE, Policy.Durability.TransientLocal),
            (_RELIABLE, Policy.Durability.Volatile),
            (Policy.Reliability.BestEffort, Policy.Durability.Volatile),
        )
        named = Topic(self._participant, topic, ros.Empty)
        return [
            DataReader(
                self._participant,
                named,
                qos=Qos(*quality, Policy.History.KeepLast(10), _WIRE),
                listener=_Stops(on_stop),
            )
            for quality in offered
        ]


class _Stops(Listener):
    """Hears stops; a publisher's leaving is none."""

    def __init__(self, on_stop: Callable[[], None]) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self._on_stop = on_stop

    def on_data_available(self, reader: DataReader[Any]) -> None:
        """Called by DDS."""
        if any(isinstance(sample, ros.Empty) for sample in reader.take(10)):
            self._on_stop()


def configuration(interface: str | None) -> str:
    """Cyclone DDS's configuration: this machine alone, or one network interface.

    It sends on that one only, and binds what it receives with to all of them: version 11.0 knows no
    other way (its ddsi_udp.c).
    """
    if interface is not None:
        attribute = "address" if interface[:1].isdigit() else "name"
        general = f"<Interfaces><NetworkInterface {attribute}={quoteattr(interface)}/></Interfaces>"
        return f'<CycloneDDS><Domain Id="any"><General>{general}</General></Domain></CycloneDDS>'
    return (
        '<CycloneDDS><Domain Id="any">'
        '<General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>'
        "<AllowMulticast>false</AllowMulticast></General>"
        "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
        f"<MaxAutoParticipantIndex>{_LOCAL_PARTICIPANTS}</MaxAutoParticipantIndex>"
        '<Peers><Peer Address="127.0.0.1"/></Peers></Discovery>'
        "</Domain></CycloneDDS>"
    )
