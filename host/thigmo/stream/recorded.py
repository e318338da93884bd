"""The stream in a run's record: typed channels beside the raw frames, and back, or to tables.

`/telemetry`, `/event` and so on hold the messages themselves as Protocol Buffers, `/foxglove/...`
what Foxglove and Rerun draw of them. Every schema is in the file. docs/records.md lists them.
Protocol Buffers are imported when they are needed: a program that only drives a robot does not wait
for them.

In tables, units are in the columns' names. A message with a list in it (a body's poses, the cells
of a posterior, the contacts of a map) becomes a row for each entry. The grid stays a picture
(map.pgm).
"""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import fields
from functools import cache, partial
from pathlib import Path
from typing import Any

from thigmo.config import RobotConfig
from thigmo.errors import ConfigError, RunFolderError
from thigmo.extras import require
from thigmo.files import whole_file
from thigmo.record import LogWriter
from thigmo.record.mcap_file import read_mcap
from thigmo.stream.hub import Hub
from thigmo.stream.messages import (
    CHANNELS,
    RECORDED,
    BodyShape,
    Contacts,
    Grid,
    Message,
    Posterior,
)
from thigmo.wiring import Wiring, beyond_board, table_key

Row = dict[str, Any]
Named = dict[int, list[tuple[int, str]]]  # place in a message's tuple and name
# What of a message becomes a row for each entry, and what no table has.
_APART = {"contacts", "places_cm", "probability", "poses", "radius_cm", "side"}


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
    """The messages that a run published, in order of time, from its folder or its run.mcap.

    `channels` selects some; None takes all. Of a damaged record, the intact messages are returned.
    Raises RunFolderError if there is no record, or none of a run's messages is in it.
    """
    path = Path(run)
    path = path / "run.mcap" if path.is_dir() else path
    wanted = {f"/{channel}" for channel in (RECORDED if channels is None else channels)}
    record = read_mcap(path, wanted)
    if record.topics.isdisjoint(f"/{channel}" for channel in RECORDED):
        raise RunFolderError(
            f"{path} has no message of a run", "its run ended before it began: run it again"
        )
    from thigmo.stream.protobuf import from_protobuf

    ordered = sorted(record.messages, key=lambda message: message[1])
    return (from_protobuf(topic[1:], data) for topic, _, data in ordered)


def export_csv(run: str | os.PathLike[str], folder: str | os.PathLike[str]) -> list[Path]:
    """Write a table for each channel of which the run has messages; an empty cell is not known.

    The folder is made if it does not exist; tables in it are replaced. Raises RunFolderError as
    `read_messages` does, and if the folder cannot be written.
    """
    target = Path(folder)
    writers: dict[str, Any] = {}  # of the csv module
    with _made(target), ExitStack() as stack:
        for channel, names, values in _rows(run):
            if channel not in writers:
                file = stack.enter_context((target / f"{channel}.csv").open("w", newline=""))
                writers[channel] = csv.writer(file)
                writers[channel].writerow(names())
            # As it was measured: sums of binary fractions are cut where they say nothing.
            writers[channel].writerow(
                [
                    value if type(value) is not float else f"{value:.15g}" if value == value else ""
                    for value in values
                ]
            )
    return [target / f"{channel}.csv" for channel in writers]


def export_parquet(run: str | os.PathLike[str], folder: str | os.PathLike[str]) -> list[Path]:
    """Write the tables of `export_csv` as Parquet files, with null for what is not known.

    Raises RunFolderError as `export_csv` does, and NotInstalledError without pyarrow.
    """
    require("tables", "Parquet")
    import pyarrow
    from pyarrow import parquet

    target = Path(folder)
    rows: dict[str, list[list[Any]]] = {}
    columns: dict[str, list[str]] = {}
    for channel, names, values in _rows(run):
        if channel not in rows:
            rows[channel], columns[channel] = [], names()
        rows[channel].append(values)
    paths = [target / f"{channel}.parquet" for channel in rows]
    with _made(target):
        for path, channel in zip(paths, rows, strict=True):
            arrays = [pyarrow.array(cells) for cells in zip(*rows[channel], strict=True)]
            table = pyarrow.table(arrays, names=columns[channel])
            with whole_file(path) as file:
                parquet.write_table(table, file)
    return paths


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """Write into a folder, made if need be."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    except OSError as error:
        raise RunFolderError(
            f"cannot write {error.filename or folder}: {error.strerror}", "choose another folder"
        ) from error


def config_in(folder: str | os.PathLike[str]) -> RobotConfig:
    """A run folder's robot.toml, or the defaults if it has none that can be read."""
    try:
        return RobotConfig.load(Path(folder) / "robot.toml") if folder else RobotConfig()
    except ConfigError:
        return RobotConfig()


def wiring_in(folder: str | os.PathLike[str]) -> Wiring:
    """The wiring of a run folder's robot, or of the default one if no board can hold it."""
    config = config_in(folder)
    return Wiring.laid_out(RobotConfig() if beyond_board(config) else config)


def _named(wiring: Wiring) -> Named:
    """Names of muscles and sensors, by how many numbers a message has for them."""
    sensors = [
        (number, table_key(f"{column.name} {place}"))
        for column in wiring.columns
        for place, number in enumerate(column.inputs)
    ]
    muscles = [(number, muscle.name) for number, muscle in enumerate(wiring.config.muscles)]
    return {wiring.size.muscles: muscles, wiring.size.sensors: sensors}


def _rows(run: str | os.PathLike[str]) -> Iterator[tuple[str, Callable[[], list[str]], list[Any]]]:
    """Rows of all tables: channel, function that names the columns, and values."""
    path = Path(run)
    wiring = wiring_in(path if path.is_dir() else path.parent)
    named = _named(wiring)
    muscles: dict[str, str] = {m.side: m.name for m in wiring.config.muscles if m.side}
    for message in read_messages(run, set(RECORDED) - {Grid.CHANNEL}):
        shared_values = _values(message, named)
        for entry in _entries(message, muscles):
            names = partial(_columns, message, named, entry)
            yield message.CHANNEL, names, [*shared_values, *entry.values()]


def _columns(message: Message, named: Named, entry: Row) -> list[str]:
    return [*_names(message, named), *entry]


@cache
def _own(channel: str) -> tuple[str, ...]:
    """Names of the fields that each row of a message has."""
    return tuple(entry.name for entry in fields(CHANNELS[channel]) if entry.name not in _APART)


def _names(message: Message, named: Named) -> list[str]:
    """Columns of a message's fields; a tuple has one for each muscle or sensor there is."""
    names = []
    for name in _own(message.CHANNEL):
        value = getattr(message, name)
        if name == "faults" or not isinstance(value, tuple):
            names.append(name)
            continue
        names += [f"{name}_{column}" for _, column in named[len(value)]]
    return names


def _values(message: Message, named: Named) -> list[Any]:
    """The values in these columns."""
    values: list[Any] = []
    for name in _own(message.CHANNEL):
        value = getattr(message, name)
        if name == "faults":
            values.append(" ".join(value))
        elif isinstance(value, tuple):
            values += [value[number] for number, _ in named[len(value)]]
        else:
            values.append(value)
    return values


def _entries(message: Message, muscles: Mapping[str, str]) -> Iterator[Row]:
    match message:
        case BodyShape():
            for index, (x_cm, y_cm, heading) in enumerate(message.poses):
                yield {"pose": index, "x_cm": x_cm, "y_cm": y_cm, "heading_rad": heading}
        case Posterior():
            cells = zip(message.places_cm or [None], message.probability or [None], strict=True)
            for place_cm, probability in cells:
                yield {
                    "muscle": muscles.get(message.side, message.side),
                    "place_cm": place_cm,
                    "probability": probability,
                }
        case Contacts():
            for index, contact in enumerate(message.contacts):
                yield {"contact": index} | contact.to_row(muscles)
        case _:
            yield {}
