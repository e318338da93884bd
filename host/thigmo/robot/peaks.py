"""A sweep's peak: from the board's snapshots to the average that the localizer gets.

Shared by the live robot and the replay of a record, so that both give the same numbers.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from thigmo.config import SIDES
from thigmo.link import protocol as wire
from thigmo.robot.readings import Floats, SensorTable
from thigmo.robot.state import Peak, SnapshotReading


def snapshot_reading(reply: wire.Snapshot, t_s: float) -> SnapshotReading:
    """A board's snapshot in host units; `t_s` is its unwrapped time."""
    return SnapshotReading(
        side=SIDES[reply.side],
        t_s=t_s,
        flex_sum=tuple(reply.flex_sum),
        pressure_psi=(reply.left_cpsi, reply.right_cpsi)[reply.side] / 100,
        lagged_psi=reply.lagged_cpsi / 100,
        base_curvature=reply.base_e5 / 1e5,
        free_curvature=reply.free_e5 / 1e5,
    )


def average_peak(
    snapshots: Sequence[SnapshotReading],
    zero_sum: Floats,
    table: SensorTable,
    *,
    oversample: int,
    sensors: int,
    length_cm: float,
) -> Peak:
    """Average a peak's snapshots (thesis: ten of them), of the side that was inflated."""
    sums: Floats = np.asarray([s.flex_sum for s in snapshots], dtype=np.float64).mean(axis=0)
    return Peak(
        side=snapshots[0].side,
        t_s=float(np.mean([s.t_s for s in snapshots])),
        length_cm=length_cm,
        curvature=table.curvature(sums, zero_sum, oversample),
        free_curvature=float(np.mean([s.free_curvature for s in snapshots])),
        pressure_psi=float(np.mean([s.lagged_psi for s in snapshots])),
        sensors=sensors,
        count=len(snapshots),
    )
