"""Runs studies over cores or a cluster, and writes their tables, figures and claims.

A study is a function from a `Context` to an `Outcome`. Tables become CSV and JSON, figures PNG, SVG
and PDF; claims are the numbers that the project promises, each with its limit, printed with a
verdict. Called by `thigmo bench` and `thigmo experiment`; `thigmo_bench.studies` names the studies.
"""

from __future__ import annotations

import json
import math
import signal
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from thigmo.errors import DataError, RunFolderError
from thigmo.extras import require
from thigmo.files import write_whole
from thigmo.report.files import write_files

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Scale = Literal["quick", "full"]
Item = TypeVar("Item")
Value = TypeVar("Value")

Record = Mapping[str, float | int | str | bool]
"""A line of a table; units stand in the names of its columns."""

WORKERS_WITHIN_S = 10.0  # time to wait for a cluster's workers


def share(flags: Sequence[Any] | NDArray[Any]) -> float:
    """Share of flags that are true; NaN without flags."""
    return float(np.mean(flags)) if len(flags) else float("nan")


def last(item: Sequence[Any]) -> int:
    """The last element of an item: its number of cases, as from `parts`."""
    return int(item[-1])


def parts(total: int, size: int) -> list[tuple[int, int]]:
    """Number and size of the batches, of at most `size` each, that add up to `total`."""
    return [(k, min(size, total - size * k)) for k in range(-(-total // size))]


@dataclass(frozen=True)
class Claim:
    """A promised number with its limit."""

    text: str
    value: float
    limit: float
    at_most: bool = True
    unit: str = ""
    standard_error: float = 0.0  # of the value, by the size of its sample; NaN if it is not known

    def sentence(self, scale: Scale) -> str:
        """The claim with its verdict, as text. At quick scale, a miss is reported as undecided."""
        text = str(self)
        return text.replace("MISSED", "not met in a quick look") if scale == "quick" else text

    @property
    def holds(self) -> bool:
        """Whether the value keeps the promise."""
        return bool(self.value <= self.limit if self.at_most else self.value >= self.limit)

    def record(self) -> dict[str, Any]:
        """The claim as plain data, for JSON."""
        numbers = {"value": float(self.value), "limit": float(self.limit)}
        plain = {"claim": self.text, **numbers, "at_most": self.at_most, "unit": self.unit}
        if self.standard_error > 0.0:
            plain["standard_error"] = float(self.standard_error)
        return {**plain, "holds": self.holds}

    def __str__(self) -> str:
        sign = "<=" if self.at_most else ">="
        verdict = "holds" if self.holds else "MISSED"
        if not self.holds and not abs(self.value - self.limit) > 2 * self.standard_error:
            verdict = "not met, and not decided by so small a sample"
            if math.isfinite(self.standard_error):
                verdict += f" (+- {self.standard_error:.2g} {self.unit})"
        return (
            f"{self.text}: {self.value:.4g} {self.unit} (promised {sign} {self.limit:g}): {verdict}"
        )


@dataclass
class Outcome:
    """The results of a study."""

    # tables, figures: written into the folder, by name; no table is empty
    tables: dict[str, Sequence[Record]] = field(default_factory=dict)
    figures: dict[str, Figure] = field(default_factory=dict)
    claims: list[Claim] = field(default_factory=list)  # written, and printed with their verdicts
    notes: list[str] = field(default_factory=list)  # sentences that are printed
    summary: Sequence[Record] | None = None  # a table that is printed
    samples: Mapping[str, int] = field(default_factory=dict)  # cases of each part that was run
    published: tuple[str, ...] = ("rows",)  # names of the tables that `record` contains

    def record(self) -> dict[str, Any]:
        """Plain data for programs: rows of the published tables, claims and notes."""
        tables = {name: self.tables.get(name, []) for name in self.published}
        claims = [claim.record() for claim in self.claims]
        return tables | {"claims": claims, "notes": self.notes, "samples": dict(self.samples)}


@dataclass(frozen=True)
class Explorations:
    """Options of the study of explorations, and the earlier runs to compare it with."""

    kinds: tuple[str, ...] = ()  # of rooms; all if empty
    settings: tuple[str, ...] = ()  # efforts and budgets; those of the published study if empty
    method: str | None = None  # of `thigmo.explore`; None: the default
    against: Sequence[Record] = ()  # its table of runs from an earlier study


@dataclass(frozen=True)
class Context:
    """How to run: the seed, the size, and where the work goes."""

    seed: int = 0  # every random number of a study comes from it
    scale: Scale = "full"  # "quick" for a look (a minute a study), "full" for the published figures
    most: int | None = None  # cases of a group, whatever the scale; None: no limit
    jobs: int = 1  # processes on this machine (ignored by the dask backend)
    backend: str = "loky"  # joblib's: "loky" (processes here) or "dask" (a cluster)
    explorations: Explorations = field(default_factory=Explorations)
    # called with (part, done, total) as items finish
    progress: Callable[[str, int, int], None] = lambda part, done, total: None
    # called with the results so far when a part of the study is done; they are written, so that
    # stopping the rest loses nothing
    save: Callable[[Outcome], object] = lambda outcome: None
    samples: dict[str, int] = field(default_factory=dict)  # cases of each part that `map` has run

    def count(self, quick: int, full: int) -> int:
        """Number of cases at this scale."""
        cases = quick if self.scale == "quick" else full
        return cases if self.most is None else min(cases, self.most)

    def rng(self, *key: int) -> np.random.Generator:
        """An independent generator for a part of a study."""
        return np.random.default_rng([self.seed, *key])

    def map(
        self,
        function: Callable[[Item], Value],
        items: Iterable[Item],
        part: str,
        size: Callable[[Item], int] = lambda item: 1,
    ) -> list[Value]:
        """Run a picklable function over items, in order of the items; progress names the part.

        `size` is the number of cases in an item.
        """
        from joblib import Parallel, delayed, parallel_config

        items = list(items)
        self.samples[part] = self.samples.get(part, 0) + sum(map(size, items))
        calls = [delayed(function)(item) for item in items]
        self.progress(part, 0, len(calls))
        results: list[Value] = []
        # Ctrl-C reaches every process of a terminal; workers leave it to the main one.
        deaf = {"initializer": _ignore_interrupts} if self.backend == "loky" else {}
        with parallel_config(backend=self.backend, n_jobs=self.jobs, **deaf):
            for value in Parallel(return_as="generator")(calls):
                results.append(value)
                self.progress(part, len(results), len(calls))
        return results


def earlier_runs(file: Path) -> list[Record]:
    """The table of runs that an earlier study wrote as JSON.

    Raises:
        DataError: it is no such table.
    """
    try:
        rows = json.loads(file.read_text())
        runs = [row for row in rows if {"kind", "seed", "setting", "best_cm"} <= row.keys()]
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise DataError(f"{file} cannot be read as a table of runs: {error}", _RUNS) from None
    if not runs or len(runs) < len(rows):
        raise DataError(f"{file} is no table of runs", _RUNS)
    return runs


_RUNS = "give the exploration-runs.json of an earlier `thigmo bench exploration`"


def _ignore_interrupts() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


Study = Callable[[Context], Outcome]


def connect_cluster(address: str) -> Any:
    """Connect joblib's "dask" backend to a scheduler's address, e.g. "tcp://127.0.0.1:8786".

    Raises:
        NotInstalledError: dask is not installed.
        DataError: nobody answers at the address, or nobody works for it.
    """
    require("bench", "a cluster")
    from distributed import Client

    try:
        client = Client(address, timeout="5s")
    except (OSError, TimeoutError, ValueError) as error:
        raise DataError(
            f"no Dask scheduler answers at {address}", "start one with `dask scheduler`"
        ) from error
    try:
        client.wait_for_workers(1, timeout=WORKERS_WITHIN_S)
    except TimeoutError as error:
        client.close()
        raise DataError(
            f"the Dask scheduler at {address} has no workers",
            f"start some with `dask worker {address}`, in an environment like this one",
        ) from error
    return client


def write(outcome: Outcome, name: str, folder: Path) -> list[Path]:
    """Write a study's tables (CSV, JSON), figures (PNG, SVG, PDF) and claims (JSON) into a folder.

    Raises:
        RunFolderError: the folder cannot be written.
    """
    paths = write_files(name, folder, outcome.tables, outcome.figures)
    paths.append(folder / f"{name}-claims.json")
    with RunFolderError.from_os(f"cannot write to {folder}", "choose another --out"):
        write_whole(paths[-1], json.dumps(outcome.record()["claims"], indent=1))
    return paths
