"""How far a study is: a bar on a terminal, on a pipe a line now and then; both on stderr."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic

Tell = Callable[[str, int, int], None]

LINE_EVERY_S = 10.0


@contextmanager
def study_progress() -> Iterator[Tell]:
    """Yields a function of (part, done, total) that shows how far each part is."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lines(lambda text: console.print(text, highlight=False, soft_wrap=True), monotonic)
        return
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(24),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
    )
    tasks: dict[str, int] = {}

    def tell(part: str, done: int, total: int) -> None:
        if part not in tasks:
            tasks[part] = bar.add_task(part, total=total)
        if done == 0:
            bar.reset(tasks[part], total=total)  # type: ignore[arg-type]
        bar.update(tasks[part], completed=done)  # type: ignore[arg-type]

    with bar:
        yield tell


def lines(write: Callable[[str], object], clock: Callable[[], float]) -> Tell:
    """A line a part at its start and end, and one every ten seconds between them."""
    began: dict[str, float] = {}
    told = clock()

    def tell(part: str, done: int, total: int) -> None:
        nonlocal told
        now = clock()
        first = done == 0 or part not in began
        if first:
            began[part] = now
        gone = now - began[part]
        if not first and done < total and now - told < LINE_EVERY_S:
            return
        told = now
        left = f", about {gone / done * (total - done):.0f} s left" if 0 < done < total else ""
        write(f"{part}: {done}/{total}, {gone:.0f} s{left}")

    return tell
