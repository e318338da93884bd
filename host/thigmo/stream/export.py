"""A run's messages as tables, one a channel, in CSV.

Units are in the columns' names. A message with a list in it (a body's poses, the cells of a
posterior, the contacts of a map) becomes a row for each entry. The grid stays a picture (map.pgm).
"""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import fields
from pathlib import Path
from typing import Any

from thigmo.config import SIDES
from thigmo.errors import RunFolderError
from thigmo.stream.messages import (
    BodyShape,
    Contacts,
    Event,
    Log,
    Message,
    Posterior,
    RunState,
    Telemetry,
)
from thigmo.stream.recorded import read_messages

Row = dict[str, Any]


def _flat(message: Message, *without: str) -> Row:
    """Fields in columns; a tuple of numbers has one for each side, or for each place of a side."""
    row: Row = {}
    for name in (each.name for each in fields(message) if each.name not in without):
        value = getattr(message, name)
        if name == "faults":
            row[name] = " ".join(value)
        elif isinstance(value, tuple):
            a_side = len(value) // len(SIDES)
            for number, one in enumerate(value):
                side, place = SIDES[number // a_side], number % a_side
                row[f"{name}_{side}" + (f"_{place}" if a_side > 1 else "")] = one
        else:
            row[name] = value
    return row


def _plain(message: Message) -> Iterator[Row]:
    yield _flat(message)


def _shape(message: BodyShape) -> Iterator[Row]:
    row = _flat(message, "poses", "radius_cm")
    for index, (x_cm, y_cm, heading) in enumerate(message.poses):
        yield {**row, "pose": index, "x_cm": x_cm, "y_cm": y_cm, "heading_rad": heading}


def _posterior(message: Posterior) -> Iterator[Row]:
    row = _flat(message, "places_cm", "probability")
    cells: list[tuple[float | None, float | None]]
    cells = list(zip(message.places_cm, message.probability, strict=True)) or [(None, None)]
    for place_cm, probability in cells:
        yield {**row, "place_cm": place_cm, "probability": probability}


def _contacts(message: Contacts) -> Iterator[Row]:
    for index, contact in enumerate(message.contacts):
        row = {**_flat(message, "contacts"), "contact": index}
        row |= {each.name: getattr(contact, each.name) for each in fields(contact)}
        row["interval_low_cm"], row["interval_high_cm"] = row.pop("interval_cm")
        (row["variance_x_cm2"], row["covariance_xy_cm2"]), (_, row["variance_y_cm2"]) = row.pop(
            "covariance_cm2"
        )
        row["merged_cm"] = " ".join(f"{length:g}" for length in row.pop("merged"))
        del row["track"]
        yield row


_TABLES: dict[str, Callable[[Any], Iterator[Row]]] = {
    Telemetry.CHANNEL: _plain,
    Event.CHANNEL: _plain,
    RunState.CHANNEL: _plain,
    BodyShape.CHANNEL: _shape,
    Posterior.CHANNEL: _posterior,
    Contacts.CHANNEL: _contacts,
    Log.CHANNEL: _plain,
}


def export_csv(run: str | os.PathLike[str], folder: str | os.PathLike[str]) -> list[Path]:
    """Write a table for each channel that the run has messages of; empty cells are not known.

    Args:
        run: the run folder.
        folder: made if need be; `telemetry.csv` and so on in it are replaced.

    Returns:
        The files.

    Raises:
        RunFolderError: no record, one of raw frames alone, or a folder that cannot be written.
    """
    target = Path(folder)
    messages = read_messages(run, _TABLES)
    writers: dict[str, csv.DictWriter[str]] = {}
    try:
        target.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            for message in messages:
                channel = message.CHANNEL
                for row in _TABLES[channel](message):
                    if channel not in writers:
                        file = (target / f"{channel}.csv").open("w", newline="")
                        writers[channel] = csv.DictWriter(stack.enter_context(file), row)
                        writers[channel].writeheader()
                    writers[channel].writerow(
                        {name: "" if value != value else value for name, value in row.items()}
                    )
    except OSError as error:
        raise RunFolderError(
            f"cannot write {error.filename or target}: {error.strerror}", "choose another folder"
        ) from error
    return [target / f"{channel}.csv" for channel in writers]
