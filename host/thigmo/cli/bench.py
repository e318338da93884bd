"""`thigmo bench`: the studies behind the project's numbers and figures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thigmo.cli.output import JsonOption, print_json

if TYPE_CHECKING:
    from thigmo.cli.study_progress import Tell


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(bench)


def bench(
    studies: Annotated[
        list[str] | None,
        typer.Argument(help="Studies to run; all when left out. `list` names them."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for tables and figures.")] = Path("bench-out"),
    scale: Annotated[
        str, typer.Option(help="quick (a look) or full (the published figures).")
    ] = "full",
    seed: Annotated[int, typer.Option(help="Every random number comes from it.")] = 0,
    jobs: Annotated[int, typer.Option(help="Processes on this machine.")] = 1,
    backend: Annotated[
        str, typer.Option(help="loky (processes here) or dask (a cluster; all its workers).")
    ] = "loky",
    scheduler: Annotated[
        str | None,
        typer.Option(
            help="Address of the Dask scheduler, tcp://HOST:8786 (its workers need thigmo)."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Chart speed against accuracy, and show where each method fails."""
    import os

    # Single calls are timed on one core; idle threads of a linear-algebra library only disturb.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

    from thigmo.cli.study_progress import study_progress
    from thigmo.errors import DataError
    from thigmo.studies import STUDIES, Context, Outcome, load
    from thigmo.studies.engine import connect_cluster, write

    names = list(studies or STUDIES)
    if names == ["list"]:
        for name, text in STUDIES.items():
            typer.echo(f"{name:18} {text}")
        return
    for name in names:
        if name not in STUDIES:
            raise DataError(f"there is no study {name!r}", f"choose from {', '.join(STUDIES)}")
    if scale not in ("quick", "full"):
        raise DataError(f"--scale is {scale!r}", "choose quick or full")
    if backend not in ("loky", "dask"):
        raise DataError(f"--backend is {backend!r}", "choose loky or dask")
    if backend == "dask" and not scheduler:
        raise DataError("--backend dask needs a cluster", "give --scheduler ADDRESS")
    cluster = connect_cluster(scheduler) if backend == "dask" and scheduler else None
    found = []
    for name in names:

        def save(outcome: Outcome, name: str = name) -> None:
            write(outcome, name, out)

        with study_progress() as tell:

            def progress(
                part: str, done: int, total: int, name: str = name, tell: Tell = tell
            ) -> None:
                tell(f"{name}, {part}", done, total)

            context = Context(
                seed=seed,
                scale="quick" if scale == "quick" else "full",
                jobs=jobs,
                backend=backend,
                progress=progress,
                save=save,
            )
            try:
                outcome = load(name)(context)
            except KeyboardInterrupt:
                typer.echo(f"thigmo: stopped; finished parts are in {out}/{name}-*", err=True)
                raise typer.Exit(130) from None
        paths = write(outcome, name, out)
        found.append((name, outcome, paths))
        if not as_json:
            for claim in outcome.claims:
                typer.echo(f"  {claim}")
            typer.echo(f"  wrote {len(paths)} files to {out}/{name}-*")
    if cluster is not None:
        cluster.close()
    if as_json:
        print_json(
            [
                {
                    "study": name,
                    "claims": [claim.record() for claim in outcome.claims],
                    "files": [str(path) for path in paths],
                }
                for name, outcome, paths in found
            ]
        )
