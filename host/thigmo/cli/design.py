"""`thigmo design`: what a sensor layout can know, before it is built."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thigmo.cli.output import JsonOption, print_json

if TYPE_CHECKING:
    from thigmo.design import Identifiability


def design(
    centers: Annotated[
        str, typer.Option(help="Sensor centres along the body, cm, separated by commas.")
    ] = "5,15,25,35,45",
    columns: Annotated[int, typer.Option(help="Columns of such sensors: 2 for both sides.")] = 2,
    length: Annotated[float, typer.Option(help="Length of the body, cm.")] = 53.0,
    span: Annotated[float, typer.Option(help="Active length of a sensor, cm.")] = 5.5,
    noise: Annotated[float, typer.Option(help="Standard deviation of a reading, 1/cm.")] = 6e-4,
    offset: Annotated[
        float, typer.Option(help="Standard deviation of an error that all readings share, 1/cm.")
    ] = 0.0,
    out: Annotated[Path, typer.Option(help="Folder for the table and the figure.")] = Path(
        "design-out"
    ),
    as_json: JsonOption = False,
) -> None:
    """Chart where a sensor layout feels contacts, from which force, and when it tells two apart."""
    from thigmo.errors import DataError
    from thigmo.extras import require

    try:
        places = [float(part) for part in centers.split(",")]
    except ValueError as error:
        raise DataError(f"--centers is {centers!r}", "give numbers, e.g. 5,15,25") from error
    if columns < 1:
        raise DataError(f"--columns is {columns}", "give 1 or more")
    require("plot", "the figure of a design")
    from thigmo.design import identifiability
    from thigmo.design.bounds import FEWEST_READINGS
    from thigmo.design.figure import draw_design
    from thigmo.localization.result import UNCHECKED
    from thigmo.report.files import write_files

    position = places * columns
    layout = identifiability(
        position,
        length=length,
        noise=noise,
        span=span,
        offset_error=offset,
        separations=[gap / 2 for gap in range(10, int(1.7 * length))],
    )
    contact_rows = [
        {
            "arc": arc,
            "moment": moment,
            "force": moment / arc if arc > 0.0 else 0.0,
            **{
                name: getattr(layout, name)[m, a].item() for name in ("bound", "signal", "detected")
            },
        }
        for m, moment in enumerate(layout.moment.tolist())
        for a, arc in enumerate(layout.arc.tolist())
    ]
    two = [
        {"separation": gap, "moment": moment, "proximal_bound": near, "distal_bound": far}
        for moment, bounds in zip(layout.moment.tolist(), layout.pair_bound.tolist(), strict=True)
        for gap, (near, far) in zip(layout.separation.tolist(), bounds, strict=True)
    ]
    tables = {"one-contact": contact_rows, "two-contacts": two}
    figures = {"bounds": draw_design(layout, position, span)}
    paths = write_files("design", out, tables, figures)
    localizes = len(position) >= FEWEST_READINGS
    if as_json:
        print_json(
            {
                "one_contact": contact_rows,
                "two_contacts": two,
                "localizes": localizes,
                "files": [str(p) for p in paths],
            }
        )
        return
    _show(layout, out)
    if not localizes:
        typer.echo(f"nothing is localized with fewer than {FEWEST_READINGS} readings: {UNCHECKED}")


def _show(layout: Identifiability, out: Path) -> None:
    from rich.console import Console
    from rich.table import Table as RichTable

    arcs = [round(len(layout.arc) * share) - 1 for share in (0.25, 0.5, 0.75, 0.9, 1.0)]
    table = RichTable(
        "base moment (1/cm)",
        *(f"at {layout.arc[a]:.1f} cm" for a in arcs),
        title="bound of one contact's arc (cm); -: too weak to be reported, inf: not fixed",
    )
    for m, moment in enumerate(layout.moment):
        cells = [f"{layout.bound[m, a]:.2f}" if layout.detected[m, a] else "-" for a in arcs]
        table.add_row(f"{moment:.4f}", *cells)
    Console().print(table)
    typer.echo(f"tables and figure are in {out}/")
