"""What the flex sensors said while the robot grew: the tip's fold passing through each of them.

Shared by the live robot and the replay of a record.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from thigmo.link import protocol as wire
from thigmo.robot.readings import Floats, SensorTable

_FRAME_SPACING_S = 0.05


@dataclass
class GrowthWatcher:
    """Thinned telemetry of one growth or several in a row."""

    # everted length by the spool's encoder, of each frame
    length_cm: list[float] = field(default_factory=list)
    # raw readings, left base first, of each frame
    flex_sum: list[tuple[int, ...]] = field(default_factory=list)
    _next_s: float = 0.0

    def telemetry(self, t_s: float, decode: Callable[[], wire.Telemetry]) -> None:
        """Take a telemetry frame of device time `t_s`; one in fifty milliseconds is decoded."""
        if t_s < self._next_s:
            return
        self._next_s = t_s + _FRAME_SPACING_S
        frame = decode()
        self.length_cm.append(frame.length_um / 1e4)
        self.flex_sum.append(tuple(frame.flex_sum))

    def profile(self, table: SensorTable) -> tuple[Floats, Floats]:
        """Lengths (n,) in cm, and what each sensor read there, (n, 10) in 1/cm, without a zero."""
        sums: Floats = np.asarray(self.flex_sum, dtype=np.float64)
        sums = sums.reshape(-1, len(table.center_cm))
        return np.asarray(self.length_cm), table.unzeroed(sums)
