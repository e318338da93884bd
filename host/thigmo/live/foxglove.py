"""A run in Foxglove: its live connection, on this machine, with a service that stops the robot.

The channels are those of a record (`stream.recorded`): the messages with schemas of their own, and
Foxglove's scene, transform, grid and log. `docs/foxglove-layout.json` arranges both.
"""

from __future__ import annotations

import json
from collections.abc import Callable

import foxglove
from foxglove import Channel, Context, MessageSchema, Schema, Service, ServiceRequest, ServiceSchema
from foxglove.websocket import ChannelView, Client, ServerListener

from thigmo.closing import Closing
from thigmo.errors import PortError
from thigmo.live.relay import Facts
from thigmo.stream import RETAINED, Hello, Message
from thigmo.stream.messages import RECORDED
from thigmo.stream.protobuf import encoded, topics

PORT = 8765  # where Foxglove looks by itself
STOP = "/thigmo/stop"
STATUS = "/thigmo/status"


class FoxgloveServer(ServerListener, Closing):
    """Serves what is published to all who connect. A context manager.

    `stop` stops the robot and says what came of it, which may take seconds; port 0 is any that is
    free. Raises PortError if the port is taken.
    """

    def __init__(self, stop: Callable[[], str], port: int = PORT) -> None:
        self._stop = stop
        self._context = context = Context()  # its channels close with it
        self._channels = {
            topic: Channel(
                topic,
                message_encoding="protobuf",
                schema=Schema(name=name, encoding="protobuf", data=data),
                context=context,
            )
            for topic, (name, data) in topics().items()
        }
        self._status = Channel(STATUS, message_encoding="json", context=context)
        # A later subscriber gets the last of each channel that seldom speaks.
        self._last: dict[str, dict[str, tuple[bytes, int]]] = {}
        self._run: Hello | None = None
        try:
            self._server = foxglove.start_server(
                name="thigmo",
                host="127.0.0.1",
                port=port,
                services=[Service(STOP, schema=_stop_schema(), handler=self._serve_stop)],
                supported_encodings=["json"],
                server_listener=self,
                context=context,
            )
        except (OSError, RuntimeError) as error:
            raise PortError(
                f"Foxglove cannot be served at port {port}: {error}",
                "stop the program that uses this port, or give another: --foxglove-port",
            ) from error

    @property
    def address(self) -> str:
        """What to open in Foxglove."""
        return f"ws://127.0.0.1:{self._server.port}"

    def publish(self, message: Message) -> None:
        """Pass a message on, as it is and as Foxglove draws it."""
        if message.CHANNEL not in RECORDED:
            return
        at_ns = round(message.epoch_s * 1e9)
        for topic, data in encoded(message):
            if message.CHANNEL in RETAINED:
                # The scene holds the body and the contacts, each with a last message of its own.
                self._last.setdefault(topic, {})[message.CHANNEL] = (data, at_ns)
            self._channels[topic].log(data, log_time=at_ns)

    def tell(self, facts: Facts) -> None:
        """Say whether stop is connected, and what the last one came to."""
        if facts.run is not self._run:
            self._run = facts.run
            self._last.clear()  # is of another run
        now = {
            "run": facts.run.name if facts.run else "",
            "under_way": facts.under_way,
            "stop": facts.stop or "connected",
            "last_stop": facts.stopped,
        }
        self._status.log(now)

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Called by the server; for those who looked already the same message changes nothing."""
        for data, at_ns in self.late_comers_get(channel.topic):
            self._channels[channel.topic].log(data, log_time=at_ns)

    def late_comers_get(self, topic: str) -> list[tuple[bytes, int]]:
        """What a channel says to a subscriber now: data, and their times in ns."""
        return list(self._last.get(topic, {}).values())

    def close(self) -> None:
        """End the server."""
        self._server.stop()

    def _serve_stop(self, request: ServiceRequest) -> bytes:
        """Called by the server, in a thread of its own."""
        return json.dumps({"message": self._stop()}).encode()


def _stop_schema() -> ServiceSchema:
    def described(name: str, properties: dict[str, dict[str, str]]) -> MessageSchema:
        data = json.dumps({"type": "object", "properties": properties}).encode()
        return MessageSchema(
            encoding="json", schema=Schema(name=name, encoding="jsonschema", data=data)
        )

    return ServiceSchema(
        "thigmo.Stop",
        request=described("thigmo.StopRequest", {}),
        response=described("thigmo.StopResponse", {"message": {"type": "string"}}),
    )
