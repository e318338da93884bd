"""What commands print: JSON for programs, tables for people."""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer


def named(address: str | None) -> str | None:
    """An address that a user gave, which a shell variable may have left empty."""
    if address == "":
        raise typer.BadParameter("it is empty")
    return address


RobotOption = Annotated[
    str,
    typer.Option(
        "--robot",
        help="Where it is: /dev/ttyACM0, COM3, socket://HOST:PORT, emulator://SCENE.",
        callback=named,
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]


def print_json(value: Any) -> None:
    """Print strict JSON: a number that is not finite becomes null."""
    typer.echo(json.dumps(_finite(value), indent=2, allow_nan=False))


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not (float("-inf") < value < float("inf")):
        return None
    return value
