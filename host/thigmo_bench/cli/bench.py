"""`thigmo bench`: the studies behind the project's numbers and figures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from thigmo.cli.output import JsonOption


def bench(
    studies: Annotated[
        list[str] | None,
        typer.Argument(help="Studies to run; all if omitted. `list` names them."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for tables and figures.")] = Path("bench-out"),
    scale: Annotated[
        str, typer.Option(help="quick (small, for a first look) or full (the published figures).")
    ] = "full",
    most: Annotated[
        int | None,
        typer.Option(min=1, help="Most cases of a group, such as rooms of a kind; all if omitted."),
    ] = None,
    kind: Annotated[
        list[str] | None,
        typer.Option(help="Of `exploration`: a kind of rooms; may be repeated. All if omitted."),
    ] = None,
    setting: Annotated[
        list[str] | None,
        typer.Option(
            help="Of `exploration`: an effort or a budget such as '100 s', tried in every room; "
            "may be repeated. The published ones if omitted."
        ),
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(
            help="Of `exploration`: how contacts are localized, as `thigmo explore` has it."
        ),
    ] = None,
    against: Annotated[
        Path | None,
        typer.Option(
            help="Of `exploration`: exploration-runs.json of an earlier study. Says what has "
            "changed in each kind, over the rooms that both explored."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of all random numbers.")] = 0,
    jobs: Annotated[int, typer.Option(help="Processes on this machine.")] = 1,
    backend: Annotated[
        str,
        typer.Option(help="loky (processes on this machine) or dask (all workers of a cluster)."),
    ] = "loky",
    scheduler: Annotated[
        str | None,
        typer.Option(
            help="Address of the Dask scheduler, tcp://HOST:8786 (its workers need thigmo)."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Run the studies that give the project's numbers and figures."""
    import os
    from contextlib import nullcontext

    # Single calls are timed on one core; idle threads of a linear-algebra library only disturb.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

    from thigmo.errors import DataError
    from thigmo_bench.cli.studies import conduct
    from thigmo_bench.studies import STUDIES, Context, load
    from thigmo_bench.studies.engine import Explorations, connect_cluster, earlier_runs

    if studies == ["list"]:
        for name, text in STUDIES.items():
            typer.echo(f"{name:18} {text}")
        return
    names = studies or list(STUDIES)
    for name in names:
        if name not in STUDIES:
            raise DataError(f"there is no study {name!r}", f"choose from {', '.join(STUDIES)}")
    if scale not in ("quick", "full"):
        raise DataError(f"--scale is {scale!r}", "choose quick or full")
    if backend not in ("loky", "dask"):
        raise DataError(f"--backend is {backend!r}", "choose loky or dask")
    if backend == "dask" and not scheduler:
        raise DataError("--backend dask needs a cluster", "give --scheduler ADDRESS")
    explorations = Explorations(
        tuple(kind or ()), tuple(setting or ()), method, earlier_runs(against) if against else ()
    )
    if explorations != Explorations() and names != ["exploration"]:
        raise DataError(
            "--kind, --setting, --method and --against are of the study exploration",
            "run `thigmo bench exploration`",
        )
    context = Context(
        seed, "quick" if scale == "quick" else "full", most, jobs, backend, explorations
    )
    with connect_cluster(scheduler) if backend == "dask" and scheduler else nullcontext():
        conduct({name: load(name) for name in names}, context, out, as_json)
