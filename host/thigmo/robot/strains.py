"""A fibre's strains by the board's clock, for the moments at which the board was read.

The live robot and the replay of a record fill it with the same lines in the same order.
"""

from __future__ import annotations

import numpy as np

from thigmo.link.interrogator import MAX_AGE_S
from thigmo.record import FibreLine
from thigmo.robot.curvature import Floats, SensorTable

_KEPT_S = 900.0  # a stage is over before
_MOST = 50_000  # lines, before older ones are dropped


class Strains:
    """Lines of strains, and how many have come."""

    def __init__(self) -> None:
        self.count = 0
        self._t_s: list[float] = []
        self._strain: list[tuple[float, ...]] = []

    def take(self, line: FibreLine) -> None:
        """Take a line; their times rise."""
        self.count += 1
        self._t_s.append(line.t_s)
        self._strain.append(line.strain_ue)
        if len(self._t_s) > _MOST:
            old = int(np.searchsorted(self._t_s, line.t_s - _KEPT_S))
            del self._t_s[:old], self._strain[:old]

    def beside(
        self, table: SensorTable, flex_sum: Floats, t_s: Floats, count: int | None = None
    ) -> Floats:
        """Raw readings (n, rows) of a table: the board's (n, inputs) at device times (n,), and
        strains, interpolated; NaN where none came within 0.2 s.

        `count`: only the first lines up to that number.
        """
        gratings = len(table.healthy) - table.inputs
        if not gratings:
            return flex_sum
        strains_ue = np.full((len(t_s), gratings), np.nan)
        end = None if count is None else len(self._t_s) - (self.count - count)
        times = np.array(self._t_s[:end])
        if len(times) and len(t_s):
            first = int(np.searchsorted(times, t_s.min() - 2 * MAX_AGE_S))
            times, strain = times[first:], np.array(self._strain[first:end])
            for number in np.flatnonzero(table.healthy[table.inputs :]):
                known = np.isfinite(strain[:, number])
                if known.any():
                    near = _apart(times[known], t_s) <= MAX_AGE_S
                    values = np.interp(t_s, times[known], strain[known, number])
                    strains_ue[:, number] = np.where(near, values, np.nan)
        return np.concatenate([flex_sum, strains_ue], axis=1)


def _apart(times: Floats, t_s: Floats) -> Floats:
    """From each of `t_s` to the nearest of `times`, which ascend."""
    index = np.searchsorted(times, t_s)
    ends = np.concatenate([[-np.inf], times, [np.inf]])
    return np.asarray(np.minimum(t_s - ends[index], ends[index + 1] - t_s))
