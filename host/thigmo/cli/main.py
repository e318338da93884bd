"""Entry point of the `thigmo` command: the list of commands, and how errors end.

Command modules import only typer and the standard library at their top; what a command needs is
imported when it runs, so that `thigmo --help` stays fast.
"""

from __future__ import annotations

import sys
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from thigmo.cli import (
    bench,
    board,
    bringup,
    calibrate,
    camera,
    design,
    emulator,
    ending,
    experiment,
    explore,
    flash,
    localize,
    ros,
    runs,
    watch,
)
from thigmo.errors import ThigmoError


class _Thigmo(TyperGroup):
    """The command; what nobody below it said of an interrupt, it says."""

    def invoke(self, ctx: Any) -> Any:
        """Run the subcommand."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            typer.echo("thigmo: interrupted; what was finished is kept", err=True)
            raise typer.Exit(ending.status()) from None


app = typer.Typer(
    name="thigmo",
    cls=_Thigmo,
    help="Make a soft growing robot feel: where along its body, how hard, and where in the room.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
for module in (
    explore,
    watch,
    localize,
    runs,
    board,
    ros,
    flash,
    bringup,
    emulator,
    camera,
    calibrate,
    experiment,
    bench,
    design,
):
    module.register(app)


@app.callback()
def _options(
    _version: Annotated[
        bool,
        typer.Option(
            "--version",
            help="Print the version.",
            is_eager=True,
            callback=lambda wanted: _print_version() if wanted else None,
        ),
    ] = False,
) -> None:
    pass


def _print_version() -> None:
    from thigmo import __version__

    typer.echo(f"thigmo {__version__}")
    raise typer.Exit


def main() -> None:
    """Run the command line; a typed error prints its one line and ends with status 1."""
    try:
        app()
    except ThigmoError as error:
        notes = getattr(error, "__notes__", [])
        typer.echo(f"thigmo: {error}" + "".join(f" ({note})" for note in notes), err=True)
        sys.exit(1)
