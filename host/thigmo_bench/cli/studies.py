"""How commands run studies: how far each is, what it found, and its files.

Progress is a bar on a terminal, on a pipe a line now and then; both on stderr. Called by
`thigmo bench` and `thigmo experiment`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from math import isfinite
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

import typer

from thigmo.cli import signals
from thigmo.cli.output import print_json

if TYPE_CHECKING:
    from thigmo_bench.studies.engine import Context, Outcome, Record, Scale, Study

Tell = Callable[[str, int, int], None]

LINE_EVERY_S = 10.0


def conduct(studies: Mapping[str, Study], context: Context, out: Path, as_json: bool) -> None:
    """Run studies by name, one after the other; write to `out` and print what each found."""
    from dataclasses import replace

    from thigmo_bench.studies.engine import write

    records = []
    for name, study in studies.items():
        with study_progress(name) as tell:
            save = partial(write, name=name, folder=out)
            try:
                study_context = replace(context, progress=tell, save=save, samples={})
                outcome = study(study_context)
            except KeyboardInterrupt:
                typer.echo(f"thigmo: stopped; finished parts are in {out}/{name}-*", err=True)
                raise typer.Exit(signals.status()) from None
        outcome.samples = study_context.samples
        records.append(report(name, outcome, out, as_json, context.scale))
    if as_json:
        print_json(records)


def report(
    name: str, outcome: Outcome, out: Path, as_json: bool, scale: Scale = "full"
) -> dict[str, Any]:
    """Write a study's results, print them for people, and return them for programs."""
    from thigmo_bench.studies.engine import write

    paths = write(outcome, name, out)
    if not as_json:
        if outcome.summary:
            _show(name, outcome.summary)
        if outcome.samples:
            cases = "; ".join(f"{part} {count}" for part, count in outcome.samples.items())
            typer.echo(f"  cases: {cases}")
        for line in (*(claim.sentence(scale) for claim in outcome.claims), *outcome.notes):
            typer.echo(f"  {line}")
        typer.echo(f"  wrote {len(paths)} files to {out}/{name}-*")
    return {"study": name, **outcome.record(), "files": [str(path) for path in paths]}


_ROW_NAME = 20  # characters that the name of a row has at least


def _show(name: str, rows: Sequence[Record]) -> None:
    from rich import box
    from rich.console import Console
    from rich.measure import Measurement
    from rich.table import Table as RichTable

    table = RichTable(title=name, box=box.SIMPLE_HEAD, padding=0, show_edge=False, pad_edge=False)
    first, *columns = rows[0]
    widest = max(len(str(row[first])) for row in rows)
    table.add_column(first, min_width=min(widest, _ROW_NAME))
    for column in columns:
        table.add_column(column, justify="right")
    for row in rows:
        cells = (
            str(cell) if not isinstance(cell, float) else f"{cell:.2f}" if isfinite(cell) else "-"
            for cell in row.values()
        )
        table.add_row(*cells)
    console = Console()
    # Words are not cut: a table that needs more width than the terminal has goes beyond it.
    needed = Measurement.get(console, console.options.update_width(1000), table).minimum
    console.width = max(console.width, needed)
    console.print(table)


@contextmanager
def study_progress(name: str) -> Iterator[Tell]:
    """Yields a function of (part, done, total) that shows how far each part of a study is."""
    from rich import progress
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        write_line = lines(partial(console.print, highlight=False, soft_wrap=True), monotonic)
        yield lambda part, done, total: write_line(f"{name}, {part}", done, total)
        return
    tasks: dict[str, Any] = {}
    with progress.Progress(
        progress.TextColumn("{task.description}"), progress.BarColumn(24),
        progress.MofNCompleteColumn(), progress.TimeElapsedColumn(),
        progress.TimeRemainingColumn(), console=console,
    ) as bar:  # fmt: skip

        def tell(part: str, done: int, total: int) -> None:
            if part not in tasks:
                tasks[part] = bar.add_task(f"{name}, {part}", total=total)
            if done == 0:
                bar.reset(tasks[part], total=total)
            bar.update(tasks[part], completed=done)

        yield tell


def lines(write: Callable[[str], object], clock: Callable[[], float]) -> Tell:
    """A line a part at its start and end, and one every ten seconds between them."""
    began: dict[str, float] = {}
    written_s = clock()

    def tell(part: str, done: int, total: int) -> None:
        nonlocal written_s
        now_s = clock()
        first = done == 0 or part not in began
        if first:
            began[part] = now_s
        elapsed_s = now_s - began[part]
        if not first and done < total and now_s - written_s < LINE_EVERY_S:
            return
        written_s = now_s
        remaining = (
            f", about {elapsed_s / done * (total - done):.0f} s to go" if 0 < done < total else ""
        )
        write(f"{part}: {done}/{total}, {elapsed_s:.0f} s{remaining}")

    return tell
