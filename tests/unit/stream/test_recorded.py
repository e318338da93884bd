"""Typed channels of a record: the messages themselves, for this package and for any MCAP tool."""

from __future__ import annotations

from dataclasses import fields, replace
from math import isnan, nan
from pathlib import Path

import pytest
from contacts import a_telemetry
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from test_hub import ONE_OF_EACH

from thigmo.errors import RunFolderError
from thigmo.record import LogWriter, read_log
from thigmo.stream import (
    BodyShape,
    Contacts,
    Event,
    Grid,
    Hub,
    Message,
    Posterior,
    Telemetry,
    read_messages,
)
from thigmo.stream.foxglove import VIEWS, views
from thigmo.stream.messages import CHANNELS, RECORDED
from thigmo.stream.protobuf import from_protobuf, schema, to_protobuf
from thigmo.stream.recorded import recording


def _one(kind: type[Message]) -> Message:
    return next(message for message in ONE_OF_EACH if isinstance(message, kind))


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A record of one message of each kind."""
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    hub = Hub()
    with LogWriter(path, {"thigmo": "1"}, epoch_s=1.7e9) as log, recording(hub, log):
        log.frame("rx", b"frame", 0.5)
        for message in ONE_OF_EACH:
            hub.publish(message)
    hub.publish(a_telemetry())  # later: nobody records
    return path


@pytest.mark.parametrize("message", ONE_OF_EACH, ids=lambda message: message.CHANNEL)
def test_protobuf_gives_the_same_message_back(message: Message) -> None:
    assert from_protobuf(message.CHANNEL, to_protobuf(message)) == message


def test_what_is_not_known_stays_so() -> None:
    back = from_protobuf("telemetry", to_protobuf(a_telemetry(supply_v=nan)))
    assert isinstance(back, Telemetry)
    assert isnan(back.supply_v)


@pytest.mark.parametrize("channel", sorted(CHANNELS))
def test_a_schema_names_every_field_with_its_type(channel: str) -> None:
    name, data = schema(channel)
    (file,) = FileDescriptorSet.FromString(data).file
    assert f"{file.package}.{CHANNELS[channel].__name__}" == name
    described = next(m for m in file.message_type if f"thigmo.{m.name}" == name)
    assert [f.name for f in described.field] == [f.name for f in fields(CHANNELS[channel])]


def test_a_record_gives_the_published_messages_back_and_its_raw_frames(path: Path) -> None:
    published = [message for message in ONE_OF_EACH if message.CHANNEL in RECORDED]
    assert list(read_messages(path)) == published
    assert list(read_messages(path.parent, {"telemetry"})) == [_one(Telemetry)]
    assert [entry.frame for entry in read_log(path).entries] == [b"frame"]


@given(st.lists(st.integers(0, 65535), min_size=10, max_size=10), st.floats(), st.booleans())
def test_a_reading_comes_back_as_it_was(sums: list[int], value: float, moves: bool) -> None:
    reading = replace(
        a_telemetry(), flex_sum=tuple(sums), free_per_cm=value, demand_psi=(value, 0.0),
        state="moving" if moves else "ready", faults=("stopped", "flex_open") if moves else (),
    )  # fmt: skip
    back = from_protobuf("telemetry", to_protobuf(reading))
    assert str(back) == str(reading)  # NaN is not equal to itself


def test_a_record_of_raw_frames_alone_says_so(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "run.mcap", {}) as log:
        log.frame("rx", b"1", 1.0)
    with pytest.raises(RunFolderError, match="no message of a run"):
        read_messages(tmp_path)


def test_mcaps_own_tools_decode_every_channel(path: Path) -> None:
    decoded = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, message, said in reader.iter_decoded_messages(
            topics=[f"/{channel}" for channel in RECORDED] + list(VIEWS)
        ):
            assert message.log_time == pytest.approx(1.700000001e18, abs=2)
            decoded[channel.topic] = said
        summary = reader.get_summary()
    assert set(decoded) == {f"/{channel}" for channel in RECORDED} | set(VIEWS)
    telemetry = a_telemetry()
    assert decoded["/telemetry"].pressure_psi == list(telemetry.pressure_psi)
    assert decoded["/telemetry"].state == "ready"
    assert decoded["/contacts"].contacts[0].arc_cm == 31.2
    assert not decoded["/contacts"].contacts[0].HasField("known")
    assert [row.values for row in decoded["/shape"].poses] == [[0.0, 0.0, 0.0], [1.0, 0.1, 0.2]]
    assert summary is not None
    assert [index.name for index in summary.metadata_indexes] == ["run"]


def test_the_body_is_drawn_in_metres_and_its_tip_is_a_frame() -> None:
    shape = _one(BodyShape)
    (_, scene), (_, transform) = views(shape)
    (line,) = scene.entities[0].lines
    assert line.thickness == pytest.approx(0.035)
    assert [(p.x, p.y) for p in line.points] == [(0.0, 0.0), (0.01, 0.001)]
    assert (transform.translation.x, transform.translation.y) == (0.01, 0.001)
    assert transform.timestamp.ToNanoseconds() == 2_000_000_000


def test_a_contact_is_drawn_where_it_is_and_along_its_interval() -> None:
    contacts = _one(Contacts)
    ((_, scene),) = views(contacts)
    (entity,) = scene.entities
    assert entity.spheres[0].pose.position.x == pytest.approx(0.275)
    assert len(entity.lines[0].points) == 3
    assert scene.deletions[0].id == "contact 1"  # there may have been one


def test_the_grid_keeps_its_cells_and_shows_them() -> None:
    grid = _one(Grid)
    assert isinstance(grid, Grid)
    ((_, view),) = views(grid)
    assert (view.column_count, view.cell_size.x) == (3, pytest.approx(0.005))
    cells = [view.data[n * view.cell_stride] for n in range(6)]
    assert [cell - 256 if cell > 127 else cell for cell in cells] == list(grid.cells)
    assert view.data[2 * view.cell_stride + 4] == 0  # unknown: transparent


def test_an_event_is_a_line_of_the_log_with_the_next_step() -> None:
    fault = Event(1.0, 2.0, "stopped", "fault", "the robot was stopped", "look at it")
    ((_, line),) = views(fault)
    assert (line.level, line.message) == (line.ERROR, "the robot was stopped; look at it")
    assert views(_one(Posterior)) == []
