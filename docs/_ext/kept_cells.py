"""What the pages' commands and code cells printed, kept from executing them to building the site.

`make docs-cells` sets DOCS_EXECUTE, runs everything, and keeps the output in build/cells: that of
commands here, that of code cells in a jupyter-cache. `make docs` shows what was kept and runs
nothing, so that a page whose commands fail or are slow does not hold up the others.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from myst_nb.sphinx_ import NbMetadataCollector
from sphinx.application import Sphinx
from sphinx.util import logging

EXECUTES = os.environ.get("DOCS_EXECUTE") == "1"
DOCS = Path(__file__).resolve().parents[1]
KEPT = DOCS.parent / "build" / "cells"
NOTEBOOKS = KEPT / "notebooks"
_PAGES = KEPT / "pages.json"  # hashes of the pages all of whose code cells ran
_logger = logging.getLogger(__name__)


class KeptOutput(NamedTuple):
    """What one block of commands left: the lines of each, how long they took, a picture."""

    printed: list[list[str]]
    took_s: float
    picture: Path | None = None


def _file(page: Path, commands: Sequence[str]) -> Path:
    return (
        KEPT / "console" / page / f"{hashlib.sha256(repr(commands).encode()).hexdigest()[:16]}.json"
    )


def write_output(page: Path, commands: Sequence[str], output: KeptOutput) -> None:
    """Keep the output of a page's last block, after all of its `commands` so far."""
    file = _file(page, commands)
    file.parent.mkdir(parents=True, exist_ok=True)
    name = None
    if output.picture is not None:
        name = f"{file.stem}-{output.picture.name}"
        shutil.copy(output.picture, file.with_name(name))
    file.write_text(json.dumps([output.printed, output.took_s, name]))


def read_output(page: Path, commands: Sequence[str]) -> KeptOutput | None:
    """The kept output; None if these commands have not been run with success."""
    file = _file(page, commands)
    if not file.exists():
        return None
    printed, took_s, name = json.loads(file.read_text())
    return KeptOutput(printed, took_s, None if name is None else file.with_name(name))


def _hash(page: Path) -> str:
    return hashlib.sha256(page.read_bytes()).hexdigest()


def unexecuted_pages() -> list[str]:
    """Pages (paths below docs/) with code cells that have not been executed as they stand."""
    executed = json.loads(_PAGES.read_text()) if _PAGES.exists() else {}
    pages = [page for page in sorted(DOCS.rglob("*.md")) if "{code-cell}" in page.read_text()]
    names = [(page.relative_to(DOCS).as_posix(), _hash(page)) for page in pages]
    return [name for name, hashed in names if executed.get(name) != hashed]


def _keep_pages(app: Sphinx, error: Exception | None) -> None:
    """Note which pages' code cells all ran."""
    if not EXECUTES or error is not None:
        return
    executed = {}
    for name in app.env.found_docs:
        page = DOCS / f"{name}.md"
        data = NbMetadataCollector.get_exec_data(app.env, name)
        if data is not None and data["succeeded"] and page.exists():
            executed[page.relative_to(DOCS).as_posix()] = _hash(page)
    KEPT.mkdir(parents=True, exist_ok=True)
    _PAGES.write_text(json.dumps(executed, indent=1))


def _name_unexecuted(app: Sphinx) -> None:
    if not EXECUTES:
        for page in unexecuted_pages():
            _logger.warning("its code cells have not run; `make docs-cells` runs them",
                            location=page.removesuffix(".md"))  # fmt: skip


def setup(app: Any) -> dict[str, bool]:
    """Register the bookkeeping of code cells."""
    app.connect("builder-inited", _name_unexecuted)
    app.connect("build-finished", _keep_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
