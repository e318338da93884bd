"""Studies on a Dask cluster: two worker processes on this machine, the real scheduler's address."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from thigmo.cli.main import app
from thigmo.errors import DataError
from thigmo_bench.studies import Context, Outcome
from thigmo_bench.studies.engine import connect_cluster

distributed = pytest.importorskip("distributed", reason="needs `pip install thigmo[bench]`")


def work(item: int) -> tuple[float, int]:
    """Something numerical, and which process did it."""
    return float(np.linalg.norm(np.arange(item + 1.0))), os.getpid()


def study(context: Context) -> Outcome:
    """A table of which process did what."""
    norms = context.map(work, range(12), "norms")
    return Outcome({"norms": [{"norm": norm, "process": process} for norm, process in norms]})


def test_the_command_runs_a_study_on_a_cluster_by_its_address(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("thigmo_bench.studies.load", lambda name: study)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        address = cluster.scheduler_address
        options = ["--backend", "dask", "--scheduler", address, "--out", str(tmp_path)]
        done = CliRunner().invoke(app, ["bench", "scaling", *options])
    assert done.exit_code == 0, done.output
    rows = json.loads((tmp_path / "scaling-norms.json").read_text())
    assert [row["norm"] for row in rows] == [work(item)[0] for item in range(12)]
    assert os.getpid() not in {row["process"] for row in rows}
    assert "scaling, norms: 12/12" in done.stderr


def test_a_scheduler_without_workers_is_an_error_that_says_how_to_start_some(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("thigmo_bench.studies.engine.WORKERS_WITHIN_S", 0.2)
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=None) as cluster,
        pytest.raises(DataError, match="dask worker"),
    ):
        connect_cluster(cluster.scheduler_address)


def test_no_scheduler_is_an_error_that_says_how_to_start_one() -> None:
    with pytest.raises(DataError, match="dask scheduler"):
        connect_cluster("tcp://127.0.0.1:9")
