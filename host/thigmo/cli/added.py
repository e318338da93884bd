"""Commands that come to `thigmo` by an entry point of the group `thigmo.commands`.

The studies' commands do: a wheel names them without having them. Such a command then says in one
line where to get it.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, distribution
from importlib.util import find_spec
from typing import Annotated

import typer

from thigmo.extras import require_sources

GROUP = "thigmo.commands"
_ANY_ARGUMENTS = {"ignore_unknown_options": True, "allow_extra_args": True}


def add_commands(app: typer.Typer) -> None:
    """Add every command of the group that this distribution names."""
    for entry_point in distribution("thigmo").entry_points.select(group=GROUP):
        package = entry_point.module.partition(".")[0]
        if find_spec(package) is not None:
            app.command(entry_point.name)(entry_point.load())
        else:
            _add_absent(app, entry_point, package)


def _add_absent(app: typer.Typer, entry_point: EntryPoint, package: str) -> None:
    @app.command(entry_point.name, context_settings=_ANY_ARGUMENTS)
    def command(
        _arguments: Annotated[list[str] | None, typer.Argument(hidden=True)] = None,
    ) -> None:
        """Say how to get this command: it comes with the sources of thigmo, not with its wheel."""
        require_sources(package, f"`thigmo {entry_point.name}`")
