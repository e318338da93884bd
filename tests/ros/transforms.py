"""Prints the transforms on /tf and /tf_static, as another DDS program reads them.

tf2_msgs is in no wheel, so the types are written down here a second time, from their .msg files.
Arguments: the ROS domain.
"""

import json
import sys
import threading
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, sequence, uint32
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

LOCAL = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1"/>
</Interfaces><AllowMulticast>false</AllowMulticast></General><Discovery>
<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>
<Peers><Peer Address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>"""


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Transform(IdlStruct, typename="geometry_msgs::msg::dds_::Transform_"):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    transforms: sequence[TransformStamped]


number = int(sys.argv[1])
domain = Domain(number, LOCAL)
participant = DomainParticipant(number)
reliable = Policy.Reliability.Reliable(duration(seconds=1))
readers = {
    "tf": DataReader(
        participant, Topic(participant, "rt/tf", TFMessage),
        qos=Qos(reliable, Policy.History.KeepLast(100)),
    ),
    "tf_static": DataReader(
        participant, Topic(participant, "rt/tf_static", TFMessage),
        qos=Qos(reliable, Policy.Durability.TransientLocal, Policy.History.KeepLast(1)),
    ),
}  # fmt: skip
while True:
    threading.Event().wait(0.02)
    for topic, reader in readers.items():
        for message in reader.take(100):
            for stamped in message.transforms if isinstance(message, TFMessage) else ():
                at, turn = stamped.transform.translation, stamped.transform.rotation
                said = {
                    "topic": topic,
                    "stamp": [stamped.header.stamp.sec, stamped.header.stamp.nanosec],
                    "frame": stamped.header.frame_id,
                    "child": stamped.child_frame_id,
                    "pose": [at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w],
                }
                print(json.dumps(said), flush=True)
