"""`thigmo localize`: contacts from a CSV of readings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thigmo.cli.output import JsonOption, print_json

if TYPE_CHECKING:
    from thigmo.localization import LocalizeResult


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(localize)


def localize(
    file: Annotated[Path, typer.Argument(help="CSV with columns position, curvature[, span].")],
    length: Annotated[float, typer.Option(help="Length of the body, in the CSV's length unit.")],
    span: Annotated[float, typer.Option(help="Active length of the sensors, if no column.")] = 0.0,
    free_curvature: Annotated[
        float, typer.Option("--free-curvature", help="Curvature from actuation alone.")
    ] = 0.0,
    noise: Annotated[
        float | None, typer.Option(help="One sigma of a reading; estimated when left out.")
    ] = None,
    gain_error: Annotated[
        float, typer.Option(help="Relative standard error of each sensor's gain.")
    ] = 0.0,
    offset_error: Annotated[
        float, typer.Option(help="One sigma of an offset that all readings share.")
    ] = 0.0,
    map_error: Annotated[
        float, typer.Option(help="Relative standard error of the free curvature.")
    ] = 0.0,
    bad_reading_odds: Annotated[
        float, typer.Option(help="Prior odds that a given reading is bad.")
    ] = 1e-3,
    tube_radius: Annotated[
        float | None, typer.Option(help="Radius of the body; 1.75/53 of the length if left out.")
    ] = None,
    critical_curvature: Annotated[
        float | None, typer.Option(help="Contact moment over EI that folds the base, if any does.")
    ] = None,
    contacts: Annotated[str, typer.Option(help='"auto", or a number of contacts.')] = "auto",
    method: Annotated[
        str, typer.Option(help="posterior; or l1, l2: exact point fits without intervals.")
    ] = "posterior",
    as_json: JsonOption = False,
) -> None:
    """Say where a body is touched, from curvature readings along it."""
    import thigmo
    from thigmo.errors import DataError
    from thigmo.record import read_readings

    if not length > 0 or length == float("inf"):
        raise DataError(f"--length is {length:g}", "give the body's length, above 0")
    if contacts != "auto" and not contacts.isdecimal():
        raise DataError(f"--contacts is {contacts!r}", "give `auto` or a number")
    table = read_readings(file, length=length)
    result = thigmo.localize(
        table.curvature,
        table.position,
        length=length,
        span=span if table.span is None else table.span,
        free_curvature=free_curvature,
        noise=noise,
        gain_error=gain_error,
        offset_error=offset_error,
        map_error=map_error,
        bad_reading_odds=bad_reading_odds,
        tube_radius=tube_radius,
        critical_curvature=critical_curvature,
        contacts="auto" if contacts == "auto" else int(contacts),
        method=method,
    )
    if as_json:
        print_json(result_object(result))
        return
    _show(result)


def result_object(result: LocalizeResult) -> dict[str, Any]:
    """A localizer's result as plain data."""
    return {
        "status": result.status,
        "contacts": [
            {
                "arc": contact.arc,
                "force": contact.force,
                "end_offset": contact.end_offset,
                "interval": list(contact.interval),
                "intervals": [list(piece) for piece in contact.intervals],
                "status": contact.status,
                "probability": contact.probability,
            }
            for contact in result.contacts
        ],
        "hypothesis": result.hypothesis,
        "hypotheses": dict(result.hypotheses),
        "discarded": list(result.discarded),
        "parameters": dict(result.parameters),
        "noise": result.noise,
        "message": result.message,
    }


def _show(result: LocalizeResult) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console()
    console.print(f"[bold]{result.status}[/bold]")
    if result.contacts:
        table = Table("arc", "force / EI", "95 % interval", "probability", "status", box=None)
        for contact in result.contacts:
            low, high = contact.interval
            table.add_row(
                f"{contact.arc:.4g}", f"{contact.force:.3g}", f"{low:.4g} to {high:.4g}",
                f"{contact.probability:.3g}", contact.status,
            )  # fmt: skip
        console.print(table)
    console.print(f"Explained by: {result.hypothesis}.")
    if result.discarded:
        rows = ", ".join(str(index + 1) for index in result.discarded)
        console.print(f"Taken for bad: row {rows} of the readings.")
    console.print(result.message)
