"""The stream in a run's record: typed channels beside the raw frames, and back.

`/telemetry`, `/event` and so on hold the messages themselves as Protocol Buffers, `/foxglove/...`
what Foxglove and Rerun draw of them. Every schema is in the file. docs/records.md lists them.
Protocol Buffers are imported when they are needed: a program that only drives a robot does not wait
for them.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from thigmo.errors import RunFolderError
from thigmo.record import LogWriter
from thigmo.record.mcap_file import read_mcap
from thigmo.stream.hub import Hub
from thigmo.stream.messages import RECORDED, Message


@contextmanager
def recording(hub: Hub, log: LogWriter) -> Iterator[None]:
    """Keep all that a hub's publishers tell in a record while the block runs."""
    from thigmo.stream.protobuf import encoded, topics

    channels = {
        topic: log.add_channel(topic, "protobuf", name, "protobuf", data)
        for topic, (name, data) in topics().items()
    }

    def keep(message: Message) -> None:
        for topic, data in encoded(message):
            log.message(channels[topic], data, message.t_s)

    hub.attach(keep, RECORDED)
    try:
        yield
    finally:
        hub.detach(keep)


def read_messages(
    run: str | os.PathLike[str], channels: Iterable[str] | None = None
) -> Iterator[Message]:
    """The messages that a run published, in their order, from its record.

    Args:
        run: the run folder, or its run.mcap.
        channels: names of `CHANNELS`; None gives all that are recorded.

    Returns:
        Those that are whole, if the record is damaged.

    Raises:
        RunFolderError: there is no record, or it holds raw frames alone (of an earlier version).
    """
    path = Path(run)
    path = path / "run.mcap" if path.is_dir() else path
    wanted = {f"/{channel}" for channel in (RECORDED if channels is None else channels)}
    found = read_mcap(path, wanted)
    if found.topics.isdisjoint(f"/{channel}" for channel in RECORDED):
        raise RunFolderError(
            f"{path} holds raw frames alone", "record the run again with this version of thigmo"
        )
    from thigmo.stream.protobuf import from_protobuf

    return (from_protobuf(topic[1:], data) for topic, _, data in found.messages)
