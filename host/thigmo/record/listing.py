"""The run folders below a folder, and two runs beside each other."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from math import dist
from pathlib import Path

from thigmo.errors import DataError, RunFolderError
from thigmo.record.document import MapContact, RunDocument
from thigmo.record.folder import RunFolder

_DOCUMENT_FILE = "contacts.json"


@dataclass(frozen=True, slots=True)
class ListedRun:
    """A run folder and its contacts.json, or why that cannot be read."""

    path: Path
    document: RunDocument | None
    problem: str = ""

    def matches(self, text: str) -> bool:
        """Whether its folder, name, address, outcome or effort has a text in it, in any case."""
        words = [str(self.path)]
        if self.document is not None:
            document = self.document
            words += [document.name, document.url, document.outcome, document.effort]
        return any(text.lower() in word.lower() for word in words)


def is_run(path: str | os.PathLike[str]) -> bool:
    """Whether a folder is that of a run."""
    return (Path(path) / _DOCUMENT_FILE).is_file()


def list_runs(parent: str | os.PathLike[str]) -> list[ListedRun]:
    """The runs in a folder, the oldest first.

    Raises DataError if the folder cannot be listed. A run that cannot be read is listed with its
    problem.
    """
    with DataError.from_os(f"cannot list {parent}", "name the folder that holds the runs"):
        folders = sorted(entry for entry in Path(parent).iterdir() if is_run(entry))
    runs = [_listed(folder) for folder in folders]
    return sorted(runs, key=lambda run: run.document.started if run.document else "")


def _listed(folder: Path) -> ListedRun:
    try:
        return ListedRun(folder, RunFolder(folder).read_document())
    except RunFolderError as error:
        return ListedRun(folder, None, str(error))


@dataclass(frozen=True, slots=True)
class ComparedContact:
    """A contact of one run, of another, or of both with the distance between them."""

    first: MapContact | None
    second: MapContact | None
    distance_cm: float | None  # None if only one of them has it


def compare_contacts(
    first: Sequence[MapContact], second: Sequence[MapContact], within_cm: float
) -> list[ComparedContact]:
    """Pair contacts of two runs in the plane, the nearest first, at most `within_cm` apart.

    What has no partner comes last. Contacts of the same obstacle at several lengths are several.
    """
    distances = sorted(
        (dist((a.x_cm, a.y_cm), (b.x_cm, b.y_cm)), i, j)
        for i, a in enumerate(first)
        for j, b in enumerate(second)
    )
    free_first, free_second = set(range(len(first))), set(range(len(second)))
    pairs = []
    for distance_cm, i, j in distances:
        if distance_cm <= within_cm and i in free_first and j in free_second:
            free_first.remove(i)
            free_second.remove(j)
            pairs.append(ComparedContact(first[i], second[j], distance_cm))
    alone = [ComparedContact(first[i], None, None) for i in sorted(free_first)]
    return pairs + alone + [ComparedContact(None, second[j], None) for j in sorted(free_second)]
