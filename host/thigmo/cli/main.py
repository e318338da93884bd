"""Entry point of the `thigmo` command: the list of commands, and how errors end.

Command modules import only typer and the standard library at their top; what a command needs is
imported when it runs, so that `thigmo --help` stays fast.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from inspect import getdoc
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from thigmo.cli import camera, emulator, signals
from thigmo.cli.added import add_commands
from thigmo.cli.board import clear, params, retract, stop
from thigmo.cli.bringup import bringup, jog, press
from thigmo.cli.calibrate import calibrate
from thigmo.cli.design import design
from thigmo.cli.explore import explore
from thigmo.cli.feel import feel
from thigmo.cli.flash import flash
from thigmo.cli.localize import localize
from thigmo.cli.output import visible
from thigmo.cli.robot import robot
from thigmo.cli.ros import ros
from thigmo.cli.runs import export, info, replay, runs
from thigmo.cli.watch import watch
from thigmo.errors import ThigmoError
from thigmo.version import VERSION

# Wrong options, values and commands; typer has no name of its own for their class.
_UsageError: Any = typer.BadParameter.__base__


class _Thigmo(TyperGroup):
    """The command: reports interrupts and usage errors that no subcommand has handled."""

    def make_context(self, *args: Any, **options: Any) -> Any:
        """Parse the arguments."""
        with _reported():
            return super().make_context(*args, **options)

    def invoke(self, ctx: Any) -> Any:
        """Run the subcommand."""
        with _reported(ctx):
            return super().invoke(ctx)


@contextmanager
def _reported(group: Any = None) -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        typer.echo("thigmo: interrupted; what was finished is kept", err=True)
        raise typer.Exit(signals.status()) from None
    except _UsageError as error:
        if type(error).show is not _UsageError.show:  # no argument at all: its help is shown
            raise
        text = " ".join(error.format_message().split()).rstrip(".").replace("Value error, ", "")
        # An option without its argument is reported without the context of its command.
        command = f" {group.invoked_subcommand}" if group else ""
        path = error.ctx.command_path if error.ctx else f"thigmo{command}"
        typer.echo(f"thigmo: {text}; see `{path} --help`", err=True)
        raise typer.Exit(error.exit_code) from None


app = typer.Typer(
    name="thigmo",
    cls=_Thigmo,
    help="Make a soft growing robot feel: where along its body, how hard, and where in the room.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
for function in (
    explore, watch, localize, feel, runs, replay, info, export, stop, params, clear, retract, ros,
    flash, bringup, jog, press, emulator.emulate, calibrate, design,
):  # fmt: skip
    app.command()(function)
add_commands(app)
groups = {"robot": robot, "scene": emulator.scene, "camera": camera.group}
for name, group in groups.items():
    app.add_typer(group, name=name)
for group in (app, *groups.values()):
    for command in group.registered_commands:
        # A docstring's lines are as long as the source's; a terminal wraps its paragraphs again.
        command.help = "\n\n".join(
            " ".join(part.split()) for part in (getdoc(command.callback) or "").split("\n\n")
        )


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"thigmo {VERSION}")
        raise typer.Exit


_VERSION = typer.Option(
    "--version", help="Print the version.", is_eager=True, callback=_print_version
)


@app.callback()
def _options(_version: Annotated[bool, _VERSION] = False) -> None:
    pass


def main() -> None:
    """Run the command line; a typed error prints its one line and ends with status 1."""
    try:
        app()
    except ThigmoError as error:
        notes = getattr(error, "__notes__", [])
        text = f"thigmo: {error}" + "".join(f" ({note})" for note in notes)
        typer.echo(visible(text), err=True)
        sys.exit(1)
