"""`thigmo experiment`: repeat the thesis's experiments and compare in three columns."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from thigmo.cli.output import JsonOption, print_json


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(experiment)


def experiment(
    name: Annotated[
        str,
        typer.Argument(
            help="single-contact, two-contacts, actuated, exploration, sensitivity, all; "
            "or fit, which fits the emulated robot's constants again."
        ),
    ],
    robots: Annotated[int, typer.Option(help="Simulated robots, each built anew.")] = 20,
    trials: Annotated[int, typer.Option(help="Trials a condition and robot; the thesis: 5.")] = 5,
    seed: Annotated[int, typer.Option(help="Every random number comes from it.")] = 1,
    out: Annotated[Path, typer.Option(help="Folder for tables and figures.")] = Path(
        "experiment-out"
    ),
    as_json: JsonOption = False,
) -> None:
    """Repeat the thesis's experiments: the thesis, its method here, ours, and the bound."""
    from thigmo.errors import DataError
    from thigmo.experiments import EXPERIMENTS, run

    names = list(EXPERIMENTS) if name == "all" else [name]
    if name == "fit":
        _fit(seed, out, as_json)
        return
    if name not in (*EXPERIMENTS, "all"):
        raise DataError(
            f"there is no experiment {name!r}", f"choose from {', '.join(EXPERIMENTS)}, all, fit"
        )
    if robots < 1 or trials < 1:
        raise DataError("--robots and --trials must be at least 1", "give larger numbers")
    found = []
    for one in names:
        if not as_json:
            typer.echo(f"{one}: {robots} robots, {trials} trials a condition ..")
        found.append(run(one, out, robots=robots, trials=trials, seed=seed))
    if as_json:
        print_json([_plain(result) for result in found])
        return
    _show([row for result in found for row in result.rows])
    for result in found:
        for claim in result.claims:
            typer.echo(f"  {claim}")
    typer.echo(f"tables and figures are in {out}/")


def _plain(result: Any) -> dict[str, Any]:
    rows = [{**vars(row), "allowed": row.allowed, "beaten": row.beaten} for row in result.rows]
    claims = [claim.record() for claim in result.claims]
    return {"rows": rows, "claims": claims}


def _fit(seed: int, out: Path, as_json: bool) -> None:
    from rich.progress import Progress

    from thigmo.experiments.fit import as_json as fit_json
    from thigmo.experiments.fit import fit

    with Progress(disable=as_json) as bar:
        task = bar.add_task("fitting the constants to section 3.2", total=None)
        found = fit(
            seed=seed, progress=lambda done, total: bar.update(task, completed=done, total=total)
        )
    out.mkdir(parents=True, exist_ok=True)
    (out / "constants.json").write_text(fit_json(found) + "\n")
    typer.echo(fit_json(found))


def _show(rows: list[Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(
        "experiment",
        "condition",
        "trials",
        "thesis",
        "its method, here",
        "ours",
        "in the workspace: its",
        "ours",
        "bound",
        "beaten",
        title="mean +- standard deviation of |a - x of the obstacle|, and workspace x error (cm)",
    )
    for row in rows:
        table.add_row(
            row.experiment,
            row.condition,
            str(row.trials),
            f"{row.thesis_mean:.2f} +- {row.thesis_std:.2f}",
            f"{row.here_mean:.2f} +- {row.here_std:.2f}",
            f"{row.ours_mean:.2f} +- {row.ours_std:.2f}",
            f"{row.here_workspace_mean:.2f}",
            f"{row.ours_workspace_mean:.2f}",
            f"{row.bound_mean:.2f}",
            "yes" if row.beaten else f"no ({row.allowed:.2f})",
        )
    Console(width=150).print(table)
