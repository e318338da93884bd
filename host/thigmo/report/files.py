"""Tables and figures as files: CSV and JSON for tables, PNG, SVG and PDF for figures."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thigmo.errors import RunFolderError
from thigmo.files import whole_file, write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_files(
    name: str,
    folder: Path,
    tables: Mapping[str, Sequence[Mapping[str, Any]]],
    figures: Mapping[str, Figure],
) -> list[Path]:
    """Write tables (none empty) and figures, by label, as NAME-LABEL files; returns their paths.

    Raises:
        RunFolderError: the folder cannot be written.
    """
    paths: list[Path] = []

    def path(label: str, kind: str) -> Path:
        paths.append(folder / f"{name}-{label}.{kind}")
        return paths[-1]

    with RunFolderError.from_os(f"cannot write to {folder}", "choose another --out"):
        folder.mkdir(parents=True, exist_ok=True)
        for label, rows in tables.items():
            with whole_file(path(label, "csv"), text=True) as file:
                writer = csv.DictWriter(file, list(rows[0]))
                writer.writeheader()
                writer.writerows(rows)
            text = json.dumps(rows, indent=1, default=lambda number: number.item())
            write_whole(path(label, "json"), text)
        for label, figure in figures.items():
            for axis in figure.axes:
                axis.title.set_fontsize(9)  # `set_title` goes back to matplotlib's
            for kind in ("png", "svg", "pdf"):
                with whole_file(path(label, kind)) as file:
                    figure.savefig(file, format=kind, dpi=200)
    return paths
