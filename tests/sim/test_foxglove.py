"""What Foxglove gets of a run: a client of its own protocol, which is not this package's."""

from __future__ import annotations

import asyncio
import json
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
import pytest
from contacts import CONTACT

import thigmo
from thigmo.errors import PortError, RobotFaultError, StoppedByViewerError
from thigmo.live.foxglove import FoxgloveServer
from thigmo.live.relay import Relay, Watched
from thigmo.record import Explanation
from thigmo.stream import Contacts, Grid, Telemetry
from thigmo.stream.foxglove import VIEWS
from thigmo.stream.protobuf import from_protobuf, schema

LAYOUT = Path(__file__).parents[2] / "docs" / "foxglove-layout.json"
Message = tuple[str, int, bytes]  # topic, time in ns, payload


class Client:
    """A client of Foxglove's protocol (github.com/foxglove/ws-protocol)."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self._socket = socket
        self.channels: dict[str, dict[str, Any]] = {}
        self.services: dict[str, int] = {}

    async def advertised(self) -> None:
        """Wait until channels and services are known."""
        while not (self.channels and self.services):
            answer = await self._socket.receive()
            assert answer.type is aiohttp.WSMsgType.TEXT, answer
            said = json.loads(answer.data)
            if said["op"] == "advertise":
                self.channels |= {offer["topic"]: offer for offer in said["channels"]}
            if said["op"] == "advertiseServices":
                self.services |= {offer["name"]: offer["id"] for offer in said["services"]}

    async def subscribe(self, *topics: str) -> None:
        wanted = [
            {"id": self.channels[t]["id"], "channelId": self.channels[t]["id"]} for t in topics
        ]
        await self._socket.send_json({"op": "subscribe", "subscriptions": wanted})

    async def message(self) -> Message:
        """The next message of a channel."""
        names = {channel["id"]: topic for topic, channel in self.channels.items()}
        while True:
            answer = await self._socket.receive()
            if answer.type is aiohttp.WSMsgType.BINARY and answer.data[0] == 1:
                number, at_ns = struct.unpack_from("<IQ", answer.data, 1)
                return names[number], at_ns, answer.data[13:]

    async def call(self, service: str) -> Any:
        """Call a service with an empty request."""
        head = struct.pack("<BIII4s", 2, self.services[service], 7, 4, b"json")
        await self._socket.send_bytes(head + b"{}")
        while True:
            answer = await self._socket.receive()
            if answer.type is aiohttp.WSMsgType.BINARY and answer.data[0] == 3:
                _, call, size = struct.unpack_from("<III", answer.data, 1)
                assert call == 7
                return json.loads(answer.data[13 + size :])


@contextmanager
def served(url: str) -> Iterator[str]:
    relay = Relay(Watched(url))
    with FoxgloveServer(relay.stop, port=0) as server:
        thread = threading.Thread(target=relay.run, args=(server,))
        thread.start()
        try:
            yield server.address
        finally:
            relay.close()
            thread.join()


async def connected(session: aiohttp.ClientSession, address: str) -> Client:
    client = Client(await session.ws_connect(address, protocols=("foxglove.sdk.v1",)))
    await client.advertised()
    return client


@pytest.mark.usefixtures("own_sockets")
def test_foxglove_sees_a_run_and_late_comers_its_map(late_url: str, tmp_path: Path) -> None:
    async def look(address: str) -> None:
        async with aiohttp.ClientSession() as session:
            client = await connected(session, address)
            assert set(VIEWS) < set(client.channels)
            await client.subscribe("/telemetry", "/foxglove/scene", "/contacts")
            exploring = asyncio.create_task(
                asyncio.to_thread(thigmo.explore, late_url, seed=1, out=tmp_path)
            )
            topics = {"/telemetry", "/foxglove/scene", "/contacts"}
            received: dict[str, bytes] = {}
            while set(received) != topics:
                topic, _, data = await client.message()
                received[topic] = data
            telemetry = from_protobuf("telemetry", received["/telemetry"])
            assert isinstance(telemetry, Telemetry)
            assert len(telemetry.curvature_per_cm) == 10
            run = await exploring
            while True:
                topic, at_ns, data = await client.message()
                if topic != "/contacts":
                    continue
                contacts = from_protobuf("contacts", data)
                assert isinstance(contacts, Contacts)
                if contacts.contacts == tuple(run.contacts):
                    break
            assert at_ns == pytest.approx(contacts.epoch_s * 1e9, abs=1000)

            late = await connected(session, address)
            await late.subscribe("/grid")
            cells: tuple[int, ...] = ()
            # On a busy computer the relay is not yet at the run's end.
            while cells != tuple(run.map.cells.ravel().tolist()):
                _, _, data = await late.message()
                grid = from_protobuf("grid", data)
                assert isinstance(grid, Grid)
                cells = grid.cells

    with served(late_url) as address:
        asyncio.run(look(address))


@pytest.mark.usefixtures("own_sockets")
def test_foxglove_draws_a_wall_s_face_and_its_ellipse_and_says_the_doubt() -> None:
    wall = replace(
        CONTACT, kind="wall", surface=[(12.0, 9.0), (33.0, 10.1)], status="ambiguous",
        explanations=[Explanation("wall", 0.8), Explanation("two pegs", 0.2)], doubt="a guess",
    )  # fmt: skip

    async def look(address: str) -> None:
        async with aiohttp.ClientSession() as session:
            client = await connected(session, address)
            await client.subscribe("/foxglove/scene")
            entities: list[Any] = []
            while not entities:
                _, _, data = await client.message()
                scene: Any = VIEWS["/foxglove/scene"].FromString(data)
                entities = [entity for entity in scene.entities if entity.id == "contact 0"]
            lines = [[(100 * p.x, 100 * p.y) for p in line.points] for line in entities[0].lines]
            track, ellipse, face = lines
            assert track == [pytest.approx(point) for point in wall.track]
            assert face == [pytest.approx(point) for point in wall.surface]
            off = np.array(ellipse) - [wall.x_cm, wall.y_cm]
            squares = np.sum(off.T * np.linalg.solve(wall.covariance_cm2, off.T), axis=0)
            assert squares == pytest.approx(5.99, abs=0.01)  # 95 % of chi-squared of two numbers
            said = {pair.key: pair.value for pair in entities[0].metadata}
            assert said["kind"] == "wall"
            assert said["explanations"] == "wall 80 %, two pegs 20 %"
            assert said["doubt"] == wall.doubt

    with FoxgloveServer(lambda: "", port=0) as server:
        server.publish(Contacts(0.0, time.time(), (wall,)))
        asyncio.run(look(server.address))


@pytest.mark.realtime
@pytest.mark.usefixtures("own_sockets")
def test_foxglove_s_service_stops_the_run(late_url: str, tmp_path: Path) -> None:
    async def stop(address: str) -> None:
        async with aiohttp.ClientSession() as session:
            client = await connected(session, address)
            await client.subscribe("/state")
            exploring = asyncio.create_task(
                asyncio.to_thread(thigmo.explore, late_url, seed=1, out=tmp_path, realtime=True)
            )
            await client.message()
            answer = await client.call("/thigmo/stop")
            assert answer["message"].startswith(f"stopped {late_url}, confirmed by ")
            # The run hears of it from its viewer and from its board, whichever is first.
            with pytest.raises((StoppedByViewerError, RobotFaultError), match="stopped"):
                await exploring

    with served(late_url) as address:
        asyncio.run(stop(address))


def test_port_that_is_taken_is_refused() -> None:
    with FoxgloveServer(lambda: "", port=0) as first:
        port = int(first.address.rpartition(":")[2])
        with pytest.raises(PortError, match="--foxglove-port"):
            FoxgloveServer(lambda: "", port=port)


def test_layout_shows_channels_and_fields_that_exist() -> None:
    layout = json.loads(LAYOUT.read_text())
    panels = layout["configById"]
    topics = set(panels["3D!room"]["topics"]) | {panels["RosOut!log"]["topicToRender"]}
    assert topics <= set(VIEWS)
    assert panels["CallService!stop"]["serviceName"] == "/thigmo/stop"
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", [])]
    assert len(paths) > 10
    for path in paths:
        channel, field = path[1:].split(".")
        assert field.partition("[")[0].encode() in schema(channel)[1]
