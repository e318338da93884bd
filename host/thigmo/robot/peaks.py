"""A sweep's peak: from the board's snapshots to the average that the localizer gets.

Shared by the live robot and the replay of a record, so that both give the same numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thigmo.config import SIDES
from thigmo.link import protocol as wire
from thigmo.robot.readings import Floats, SensorTable
from thigmo.robot.standing import StandingWatch
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


@dataclass(frozen=True, slots=True)
class SweepConditions:
    """What is known of the sensors when a sweep begins.

    Attributes:
        table: their constants.
        zero_sum: their zeros, sums of counts, shape (10,); NaN where there is none.
        oversample: conversions that a sum holds.
        sensors: mask of those everted, settled and zeroed.
        length_cm: everted length.
        young: mask of those everted and not settled, to be used as far as `standing` knows them.
        standing: what they rest at.
    """

    table: SensorTable
    zero_sum: Floats
    oversample: int
    sensors: int
    length_cm: float
    young: int = 0
    standing: StandingWatch | None = None

    def curvature(self, flex_sum: Floats) -> Floats:
        """Curvature (..., 10) in 1/cm of raw readings."""
        return self.table.curvature(flex_sum, self.zero_sum, self.oversample)


def average_peak(snapshots: Sequence[SnapshotReading], known: SweepConditions) -> Peak:
    """Average a peak's snapshots (thesis: ten of them), of the side that was inflated."""
    sums: Floats = np.asarray([s.flex_sum for s in snapshots], dtype=np.float64).mean(axis=0)
    at_s = float(np.mean([s.t_s for s in snapshots]))
    curvature = known.curvature(sums)
    added = np.zeros(len(curvature))
    sensors = known.sensors
    if known.standing is not None and known.young:
        late, sigma = known.standing.curvature(sums, at_s, known.young)
        settled = np.isfinite(late)
        curvature = np.where(settled, late, curvature)
        added = np.where(settled, sigma, added)
        sensors |= int(sum(1 << int(i) for i in np.flatnonzero(settled)))
    return Peak(
        side=snapshots[0].side,
        t_s=at_s,
        length_cm=known.length_cm,
        curvature=curvature,
        free_curvature=float(np.mean([s.free_curvature for s in snapshots])),
        pressure_psi=float(np.mean([s.lagged_psi for s in snapshots])),
        sensors=sensors,
        count=len(snapshots),
        added_noise=added,
    )
