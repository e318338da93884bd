"""A run's messages as tables, one a channel, in CSV.

Units are in the columns' names. A message with a list in it (a body's poses, the cells of a
posterior, the contacts of a map) becomes a row for each entry. The grid stays a picture (map.pgm).
"""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from thigmo.config import SIDES
from thigmo.errors import RunFolderError
from thigmo.stream.messages import RECORDED, BodyShape, Contacts, Grid, Message, Posterior
from thigmo.stream.recorded import read_messages

Row = dict[str, Any]
# What of a message becomes a row for each entry, and what no table has.
_APART = {"contacts", "places_cm", "probability", "poses", "radius_cm"}


def _rows(message: Message) -> Iterator[Row]:
    """A message's fields in columns; a tuple of numbers has one for each side, or for each place of
    a side."""
    row: Row = {}
    for name in (each.name for each in fields(message) if each.name not in _APART):
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
    return ({**row, **entry} for entry in _entries(message))


def _entries(message: Message) -> Iterator[Row]:
    match message:
        case BodyShape():
            for index, (x_cm, y_cm, heading) in enumerate(message.poses):
                yield {"pose": index, "x_cm": x_cm, "y_cm": y_cm, "heading_rad": heading}
        case Posterior():
            cells = zip(message.places_cm or [None], message.probability or [None], strict=True)
            for place_cm, probability in cells:
                yield {"place_cm": place_cm, "probability": probability}
        case Contacts():
            for index, contact in enumerate(message.contacts):
                row = {"contact": index} | asdict(contact)
                row["interval_low_cm"], row["interval_high_cm"] = row.pop("interval_cm")
                (row["variance_x_cm2"], row["covariance_xy_cm2"]), (_, row["variance_y_cm2"]) = (
                    row.pop("covariance_cm2")
                )
                row["merged_cm"] = " ".join(f"{length:g}" for length in row.pop("merged"))
                del row["track"]
                yield row
        case _:
            yield {}


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
    messages = read_messages(run, set(RECORDED) - {Grid.CHANNEL})
    writers: dict[str, csv.DictWriter[str]] = {}
    try:
        target.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            for message in messages:
                channel = message.CHANNEL
                for row in _rows(message):
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
