"""Whether the free body bends as the actuator map says, wherever a sweep touches nothing.

A regulator set wrong, or a muscle that is not what it was, bends the whole body by the same share
more or less than the map says. A base that bends too little looks held back, as by a peg, and the
localizer would place that peg with confidence. But a contact begins at its touch, and bends the
body the less the nearer to it: what the tip's sensor shows, and all of them before the touch, is
the map's. The share is fitted to both sides of all sweeps at a body pressure (generalized least
squares) and tested against what calibration says of the errors of map, scales, zeros and lag.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thigmo.config import SIDES, RobotConfig, Side
from thigmo.exploration.measuring import GIVES_UP, held_back, held_sides, touch_curvature
from thigmo.exploration.reference import scale_errors
from thigmo.record import RunDocument
from thigmo.robot import TRIGGER_PER_CM, SensorTable, SweepResult
from thigmo.robot.readings import Floats
from thigmo.robot.sweep import RISING_RESIDUAL_LAG

_LEAST_PSI = 2.5  # below, the regulator is near its live zero
_BINS = 8  # of a side's sweep
# Of the standard error. Three body pressures are tested at up to three stages each, and a body's
# swing is not normally distributed: with 3.3, one healthy run in fifty was doubted.
_SIGMAS = 4.0


@dataclass(frozen=True, slots=True)
class MapDoubt:
    """A body that does not bend as its map says.

    Attributes:
        body_pressure_psi: at which it does not.
        share: by which it bends more (or, negative, less) than the map says.
        share_se: standard error of that, the map's own included.
    """

    body_pressure_psi: float
    share: float
    share_se: float

    def __str__(self) -> str:
        more = "more" if self.share > 0 else "less"
        return (
            f"untouched, the body bends {abs(self.share):.0%} {more} (+- {self.share_se:.0%}) than "
            f"robot.toml's map says at {self.body_pressure_psi:g} psi of body pressure, so the "
            "contacts felt are doubtful; check the body's regulator and the muscles' air, then "
            "explore again, or run `thigmo calibrate actuator --again`"
        )


@dataclass(frozen=True, slots=True)
class _Part:
    """What one side's sweep shows, averaged over parts of its rise; (n,) each, a row a reading.

    Attributes:
        sensor: which.
        free: free curvature by the map, 1/cm.
        departure: of the reading from it, 1/cm.
        contact: what a contact may have done to it, one sigma, 1/cm.
        lag: what the lag's error may have done, one sigma, 1/cm.
        swing: what the body's swing may have done, one sigma, 1/cm.
    """

    sensor: NDArray[np.int64]
    free: Floats
    departure: Floats
    contact: Floats
    lag: Floats
    swing: Floats


def with_doubt(document: RunDocument, doubt: MapDoubt | None) -> RunDocument:
    """The document with its doubt told, and the contacts that hang on the map doubtful.

    A peg that growth met is no matter of the map.
    """
    if doubt is None:
        return replace(document, doubt="")
    contacts = [
        replace(contact, status="doubtful") if contact.side else contact
        for contact in document.contacts
    ]
    return replace(document, contacts=contacts, doubt=str(doubt))


class MapError:
    """Collects the untouched part of every sweep, and tells whether the map holds there.

    Args:
        config: maps, scales, and what calibration says of their errors.
    """

    def __init__(self, config: RobotConfig) -> None:
        self._config = config
        self._table = SensorTable.of(config)
        self._scale_se = scale_errors(config)
        self._parts: dict[int, list[tuple[int, _Part]]] = {}

    def take(self, sweep: SweepResult, length_cm: float, zone: int) -> None:
        """Take both sides of a sweep that looked for contacts.

        Args:
            sweep: the sweep.
            length_cm: everted length.
            zone: index of the body-pressure zone.
        """
        for row, side in enumerate(SIDES):
            part = self._part(sweep, side, length_cm)
            if part is not None:
                self._parts.setdefault(zone, []).append((row, part))

    def _part(self, sweep: SweepResult, side: Side, length_cm: float) -> _Part | None:
        mine = [n for n, frame in enumerate(sweep.frames) if frame.side == side]
        frames = [sweep.frames[n] for n in mine]
        readings = sweep.curvature[mine]
        use = self._table.usable(side, sweep.sensors) & np.isfinite(readings).all(axis=0)
        sensors = np.flatnonzero(use)
        pressure = np.array([f.pressure_psi for f in frames])
        if not sensors.size or not pressure.size:
            return None
        rising = (np.arange(len(frames)) <= pressure.argmax()) & (pressure >= _LEAST_PSI)
        bins = [part for part in np.array_split(np.flatnonzero(rising), _BINS) if part.size > 1]
        free = np.array([f.free_curvature for f in frames])
        t_s = np.array([f.t_s for f in frames])
        held = np.maximum(held_back(sweep.frames, side), 0.0)
        touch = touch_curvature(sweep.frames, side) if side in held_sides(sweep) else None
        if touch is None:
            clear = np.abs(free).max() - held.max() / GIVES_UP
        else:
            clear = abs(touch) - TRIGGER_PER_CM / GIVES_UP
        center = self._table.center_cm[sensors]
        last = int(center.argmax())
        # A contact on the tip bends the last sensor by this share of what it bends the base.
        reach = (length_cm - center[last]) / (length_cm - center.min())
        lag_s = self._config.actuators.side(side).lag_s
        rows = []
        for part in bins:
            g = float(free[part].mean())
            rate = abs(float(np.polyfit(t_s[part], free[part], 1)[0]))
            swing = lag_s * rate * np.exp(-(float(t_s[part].mean()) - t_s[0]) / lag_s)
            untouched = np.abs(free[part]).max() <= clear
            contact = 0.0 if untouched else reach * float(held[part].mean())
            for index, sensor in enumerate(sensors):
                if untouched or index == last:
                    departure = float(readings[part, sensor].mean()) - g
                    rows.append(
                        (sensor, g, departure, contact,
                         RISING_RESIDUAL_LAG * lag_s * rate, swing)
                    )  # fmt: skip
        return _Part(*map(np.array, zip(*rows, strict=True))) if rows else None

    def doubt(self) -> MapDoubt | None:
        """The body pressure whose map is surely wrong, if one is; of several, the surest."""
        found = []
        for zone, parts in self._parts.items():
            share, error = self._share(parts, zone)
            if abs(share) > _SIGMAS * error:
                psi = self._config.body.zones[zone].pressure_psi
                found.append(MapDoubt(psi, share, error))
        return max(found, key=lambda doubt: abs(doubt.share) / doubt.share_se, default=None)

    def _share(self, parts: Sequence[tuple[int, _Part]], zone: int) -> tuple[float, float]:
        """Share of the free curvature by which all readings depart from it, and its error."""
        muscles = [self._config.actuators.side(side) for side in SIDES]
        count = [len(part.free) for _, part in parts]
        sweep = np.repeat(np.arange(len(parts)), count)
        side = np.repeat([row for row, _ in parts], count)
        sensor, g, departure, contact, lag, swing = (
            np.concatenate([getattr(part, field.name) for _, part in parts])
            for field in fields(_Part)
        )
        noise = self._table.noise[sensor]
        map_se = np.array([muscle.maps[zone].scale_se for muscle in muscles])[side]
        offset_se = np.array([muscle.offset_se for muscle in muscles])[side]

        def shared(sigma: Floats, *keys: NDArray[Any]) -> Floats:
            """Covariance of an error that readings with the same keys share."""
            same = np.logical_and.reduce([np.equal.outer(key, key) for key in keys])
            covariance: Floats = np.outer(sigma, sigma) * same
            return covariance

        covariance = (
            np.diag(noise**2)
            + shared(noise, sensor, sweep)  # zero and hysteresis
            + shared(offset_se, side)
            + shared(contact, sweep)
            + shared(self._scale_se[sensor] * g, sensor)
            + shared(map_se * g, side)
            + shared(lag, side)
            + shared(swing, side)
        )
        weighted = np.linalg.solve(covariance, g)
        variance = 1.0 / float(weighted @ g)
        return float(weighted @ departure) * variance, float(np.sqrt(variance))
