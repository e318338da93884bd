"""What happens on a robot, as it happens: one model of live data, and its ways to viewers.

The robot and the exploration publish `messages` on a `Hub`; a program subscribes to it, a `Server`
passes it to other processes of the same user, and `attach` is their end. Records, the page,
Foxglove and ROS 2 are views of the same messages. A viewer never slows the robot: each has a
bounded queue, loses the oldest messages and learns how many.
"""

from thigmo.stream.hub import Hub, Subscription
from thigmo.stream.messages import (
    CHANNELS,
    RETAINED,
    BodyShape,
    Contacts,
    Dropped,
    Event,
    Grid,
    Hello,
    Log,
    Message,
    Posterior,
    Question,
    RunState,
    Telemetry,
    from_json,
    to_json,
)
from thigmo.stream.recorded import read_messages, recording
from thigmo.stream.remote import Command, RemoteRun, Server, Text, Watchable, attach, running

__all__ = [
    "CHANNELS",
    "RETAINED",
    "BodyShape",
    "Command",
    "Contacts",
    "Dropped",
    "Event",
    "Grid",
    "Hello",
    "Hub",
    "Log",
    "Message",
    "Posterior",
    "Question",
    "RemoteRun",
    "RunState",
    "Server",
    "Subscription",
    "Telemetry",
    "Text",
    "Watchable",
    "attach",
    "from_json",
    "read_messages",
    "recording",
    "running",
    "to_json",
]
