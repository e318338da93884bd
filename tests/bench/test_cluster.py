"""Studies on a Dask cluster: two worker processes on this machine, the real scheduler's address."""

from __future__ import annotations

import os

import numpy as np
import pytest

from thigmo.bench import Context
from thigmo.bench.study import connect_cluster
from thigmo.errors import DataError

distributed = pytest.importorskip("distributed", reason="needs `pip install thigmo[bench]`")


def work(item: int) -> tuple[float, int]:
    """Something numerical, and which process did it."""
    return float(np.linalg.norm(np.arange(item + 1.0))), os.getpid()


@pytest.mark.timeout(120)
def test_a_study_spreads_over_a_cluster_and_keeps_its_order() -> None:
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        client = connect_cluster(cluster.scheduler_address)
        try:
            seen: list[int] = []
            context = Context(
                backend="dask", jobs=2, progress=lambda part, done, total: seen.append(done)
            )
            found = context.map(work, range(12))
        finally:
            client.close()
    assert [value for value, _ in found] == [work(item)[0] for item in range(12)]
    assert os.getpid() not in {process for _, process in found}
    assert seen == list(range(13))


def test_no_scheduler_is_an_error_that_says_how_to_start_one() -> None:
    with pytest.raises(DataError, match="dask scheduler"):
        connect_cluster("tcp://127.0.0.1:9")
