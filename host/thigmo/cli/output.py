"""What commands print: JSON for programs, tables for people."""

from __future__ import annotations

import json
from pathlib import Path
from shutil import get_terminal_size
from textwrap import TextWrapper
from typing import Annotated, Any

import typer


def named(address: str | None) -> str | None:
    """An address that a user gave, which a shell variable may leave empty."""
    if address == "":
        raise typer.BadParameter("it is empty")
    return address


def robot_option(
    text: str = "Address of the robot: /dev/ttyACM0, COM3, socket://HOST:PORT, emulator://SCENE.",
) -> Any:
    """The option that names a robot; `text` is its help."""
    return typer.Option("--robot", help=text, callback=named)


RobotOption = Annotated[str, robot_option()]
AnyRobotOption = Annotated[str | None, robot_option()]
SentConfigOption = Annotated[
    Path | None, typer.Option(help="robot.toml to send first; if omitted, the board keeps its own.")
]
KnownConfigOption = Annotated[
    Path | None, typer.Option(help="robot.toml; not needed for the emulator's robot.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]


def method_option(default: str, *, explores: bool = False) -> Any:
    """The option that names a localizer's method; `default` says what an omitted one means.

    `explores`: the method is that of whole explorations.
    """
    usual = "field (one fit to all sweeps of a side)" if explores else "posterior"
    return typer.Option(
        help=f"How contacts are localized: {usual}, or thesis (the thesis's alternating fit, "
        f"without intervals). {default}",
        show_default=False,
    )


MethodOption = Annotated[str | None, method_option("Default: posterior.")]


def visible(text: str) -> str:
    """Text whose control characters are spelled out: words of a file command no terminal."""
    return "".join(
        c if c.isprintable() or c in "\n\t" else c.encode("unicode_escape").decode() for c in text
    )


def print_json(value: Any) -> None:
    """Print strict JSON: a number that is not finite becomes null."""
    typer.echo(json.dumps(_finite(value), indent=2, allow_nan=False))


def show(as_json: bool, value: Any, *lines: object) -> None:
    """Print a result as JSON for a program, or as lines for people."""
    if as_json:
        print_json(value)
    else:
        for line in lines:
            typer.echo(visible(str(line)))


def filled(text: str, indent: int = 0) -> str:
    """A sentence in lines that fit the terminal; those after the first are indented."""
    words = TextWrapper(get_terminal_size().columns, subsequent_indent=" " * indent)
    words.break_long_words = words.break_on_hyphens = False  # names and paths stay whole
    return words.fill(text)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not (float("-inf") < value < float("inf")):
        return None
    return value
