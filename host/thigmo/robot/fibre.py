"""A robot's fibre, read live: strains beside the board's telemetry, since their zeros.

A line of the interrogator goes with the telemetry that arrived nearest to it, at most
`interrogator.MAX_AGE_S` apart. For a record and for sweeps each line is stamped by the board's
clock, as the newest telemetry has it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from thigmo.config import RobotConfig, Side
from thigmo.errors import CommandRefusedError, InterrogatorError
from thigmo.link.inbox import TelemetryFrame
from thigmo.link.interrogator import MAX_AGE_S, Interrogator
from thigmo.record import FibreLine
from thigmo.robot.curvature import Floats
from thigmo.robot.idle_pressure import UNBENT_PSI

_FEWEST = 3  # lines of a reading
_LEAST_S = 1e-6  # between two stamps
_DRIFT = 5.0  # standard errors between the two halves of a zeroing
_MEDIAN_STEP = 0.954  # median step of normal noise from one reading to the next, over its sigma


@dataclass(frozen=True, slots=True)
class FibreReading:
    """Averaged strains over a while, one value for each reading of robot.toml's fibre."""

    t_s: float  #: host time at its middle
    strain_ue: Floats  #: shape (n,), as the interrogator says; NaN where lost
    curvature: Floats  #: shape (n,), 1/cm since the zeros; NaN without a zero, dead or lost
    lines: int  #: number averaged
    zero_age_s: float  #: since the zeros were taken
    length_cm: float  #: everted length by the encoder
    side: Side | None  #: to which a muscle bends the body
    free_curvature: float  #: by the board's map, signed, 1/cm


class Fibre:
    """The gratings of a robot, and the interrogator that reads them."""

    def __init__(
        self, config: RobotConfig, interrogator: Interrogator, take: Callable[[FibreLine], None]
    ) -> None:
        self.interrogator = interrogator
        interrogator.on_line.append(self._stamp)
        self._take = take  # called with each line, and with the zeros
        self._newest: TelemetryFrame | None = None
        self._t_s = -np.inf  # device time of the last line
        self._config, self._gratings = config, config.gratings
        self._needed = np.array([grating.usable for grating in self._gratings])
        self._ends = np.array([g.center_cm + g.span_cm / 2 for g in self._gratings])
        self._zero_s = -np.inf
        self._zero_ue = np.full(len(self._gratings), np.nan)

    def void(self) -> None:
        """Discard the zeros: gratings lie differently once the body has moved through its tip."""
        self._zero_ue = np.full(len(self._gratings), np.nan)
        self._tell_zeros()

    def _tell_zeros(self) -> None:
        self._take(FibreLine(self._t_s, tuple(self._zero_ue.tolist()), zero=True))

    def telemetry(self, frame: TelemetryFrame) -> None:
        """Take telemetry; the lines after it are stamped with its times."""
        self._newest = frame

    def tap(self, direction: str, frame: bytes, t_s: float) -> None:
        """Read the lines that came before a frame of the board. Signature of the link's tap."""
        if direction == "rx":
            self.interrogator.take()

    def _stamp(self, host_s: float, strain_ue: Floats) -> None:
        if self._newest is not None:
            device_s = host_s - self._newest.t_s + self._newest.device_s
            self._t_s = max(device_s, self._t_s + _LEAST_S)
            self._take(FibreLine(self._t_s, tuple(strain_ue.tolist())))

    def require(self) -> None:
        """Raise InterrogatorError unless the strains of all healthy gratings are of now."""
        self.interrogator.require(self._needed)

    def zero(self, since_s: float, length_cm: float) -> None:
        """Take the strains from a host time on as those of the straight body.

        Raises CommandRefusedError if they drift, as a body that still moves does.
        """
        lines = self._lines(since_s)[:, self._needed]
        halves = lines[: len(lines) // 2], lines[len(lines) // 2 :]
        apart = abs(np.nanmedian(halves[0], axis=0) - np.nanmedian(halves[1], axis=0))
        # From line to line, which drift does not raise; and what any reading may be off by.
        scatter = np.nanmedian(abs(np.diff(lines, axis=0)), axis=0) / _MEDIAN_STEP
        noise = np.array([grating.noise / abs(grating.raw_scale) for grating in self._gratings])
        if np.any(apart > noise[self._needed] + _DRIFT * scatter * (4 / len(lines)) ** 0.5):
            raise CommandRefusedError(
                "the fibre's strains still drift", "wait until the body rests", reason="drifting"
            )
        self._zero_ue = np.full(len(self._gratings), np.nan)
        self._zero_ue[self._needed] = np.nanmean(lines, axis=0)
        self._zero_ue[self._ends > length_cm + 1e-6] = np.nan
        self._zero_s = since_s
        self._tell_zeros()

    def _lines(self, since_s: float) -> Floats:
        lines = [strain for _, strain in self.interrogator.lines_since(since_s)]
        if len(lines) < 2 * _FEWEST:
            raise InterrogatorError(
                f"only {len(lines)} lines of strains came during the zeroing",
                "let the interrogator send 10 a second or more",
            )
        return np.array(lines)

    def reading(self, frames: Sequence[TelemetryFrame], since_s: float) -> FibreReading:
        """Average the lines from a host time on, each with the telemetry nearest to it."""
        came = np.array([frame.t_s for frame in frames])
        pairs = []
        for t_s, strain in self.interrogator.lines_since(since_s):
            nearest = int(np.argmin(abs(came - t_s))) if len(came) else -1
            if nearest >= 0 and abs(came[nearest] - t_s) <= MAX_AGE_S:
                pairs.append((t_s, strain, frames[nearest].message))
        if len(pairs) < _FEWEST:
            raise InterrogatorError(
                f"only {len(pairs)} lines of strains match the board's telemetry in time",
                "let the interrogator send 10 a second or more, and read for longer",
            )
        strain = np.array([strain_ue for _, strain_ue, _ in pairs])
        known = np.isfinite(strain).sum(axis=0) >= _FEWEST
        mean = np.full(len(known), np.nan)
        mean[known] = np.nanmean(strain[:, known], axis=0)
        scale = np.array([grating.raw_scale for grating in self._gratings])
        muscles = len(self._config.muscles)
        psi = np.mean([row.pressure_cpsi[:muscles] for *_, row in pairs], axis=0) / 100
        bent = float(psi.max(initial=0.0)) >= UNBENT_PSI
        return FibreReading(
            t_s=float(np.mean([t_s for t_s, *_ in pairs])),
            strain_ue=mean,
            curvature=np.asarray(scale * (mean - self._zero_ue)),
            lines=len(pairs),
            zero_age_s=pairs[-1][0] - self._zero_s,
            length_cm=pairs[-1][2].length_um / 1e4,
            side=self._config.muscle_sides[int(psi.argmax())] if bent else None,
            free_curvature=float(np.mean([row.free_e5 for *_, row in pairs]) * 1e-5 * bent),
        )

    def close(self) -> None:
        """Close the interrogator."""
        self.interrogator.close()
