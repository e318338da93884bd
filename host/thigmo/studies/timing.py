"""What the studies of time share: one core, and the least of many repeats."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import process_time


@contextmanager
def one_core() -> Iterator[None]:
    """Keep this process, and those that it starts, to one core, where the system can."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def least_us(call: Callable[[], object], repeats: int) -> float:
    """Least time of the processor for a call (microseconds), after a first one that warms.

    That is the time on a core of its own, whatever else the computer does.
    """
    call()
    times = []
    for _ in range(repeats):
        start = process_time()
        call()
        times.append(process_time() - start)
    return min(times) * 1e6
