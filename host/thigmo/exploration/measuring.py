"""How hard to press for a measurement.

The sweep that finds a contact goes to the muscle's highest pressure, and there the body may have
folded at its base or slipped off the peg: its peak is where the thesis measured, and not where a
contact is felt best. So a side that touched something is swept once more, to the pressure at
which the contact's moment came near the fold, and measured at that sweep's peak. If the fold limits
that moment, and somebody is there to raise the body pressure, the contact is pressed harder at a
higher one, where it takes a larger moment to fold the base.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from scipy.ndimage import median_filter

from thigmo.config import SIDES, SIGN, RobotConfig, Side
from thigmo.field import fold_moment
from thigmo.robot import TRIGGER_PER_CM, SensorTable, SweepFrame, SweepResult
from thigmo.robot.curvature import Floats

# Of the moment that folds the base. The slow sweep holds the base back farther than the fast one
# did at that pressure, so most measurements end past the fold: the larger signal is worth it.
_SHARE = 0.65
# The body pressure is raised for so many times the moment, or more.
_WORTH = 1.25
_SMOOTH = 5  # frames, a quarter of a second
# A peg right beside a straight beam that is to bend by g takes 1.5 g at its base, and less anywhere
# else: the beam's end stays where it is, which takes a force of 1.5 g EI over its lever.
_MOST_TAKEN = 1.5
# Standard errors of a reading by which a body that nothing holds may seem to be bent.
_SIGMAS = 5.0
_BENT_SENSORS = 2  # where so many are read: the zero of one may have moved by itself
_LOWEST_PSI = 4.0  # the muscle's live zero and dead band end well below


def caught_sides(sweep: SweepResult, table: SensorTable) -> set[Side]:
    """Sides whose sweep began with a body that something held bent.

    A tip in a gap, or a body that hangs on a peg which the last sweep slipped past. A peg beside a
    straight body takes from its bend what it takes of the muscle's, and no more.
    """
    caught: set[Side] = set()
    error = np.sqrt(np.diag(table.covariance))
    for side in SIDES:
        frames, readings = sweep.half(side)
        use = table.readable(side, sweep.sensors, readings)
        if not frames or not use.any():
            continue
        free = np.array([frame.free_curvature for frame in frames])
        rising = slice(0, int(np.argmax(SIGN[side] * free)) + 1)
        held = median_filter(readings[rising, use] - free[rising, None], (_SMOOTH, 1))
        beyond = np.abs(held) > _MOST_TAKEN * abs(free[rising, None]) + _SIGMAS * error[use]
        bent = np.count_nonzero(beyond, axis=0) >= _SMOOTH
        if np.count_nonzero(bent) >= min(_BENT_SENSORS, bent.size):
            caught.add(side)
    return caught


def touch_curvature(frames: Sequence[SweepFrame], side: Side) -> float | None:
    """Free curvature (1/cm) at which a side's bend was first held back; None if it was not."""
    side_frames = [frame for frame in frames if frame.side == side]
    first = np.flatnonzero(curvature_deficit(frames, side) > TRIGGER_PER_CM)
    return side_frames[first[0]].free_curvature if first.size else None


def curvature_deficit(frames: Sequence[SweepFrame], side: Side) -> Floats:
    """By how much the base was held back in each frame of a side's way up, 1/cm.

    A running median removes single outliers and keeps edges. The way down is left out: there the
    body may straighten sooner than the map says, as if it were held back.
    """
    pairs = [(f.excess, f.free_curvature) for f in frames if f.side == side]
    excess, free = np.array(pairs, dtype=np.float64).reshape(-1, 2).T
    smooth = -SIGN[side] * median_filter(excess, _SMOOTH, mode="mirror")
    return np.asarray(smooth[: int(np.argmax(SIGN[side] * free)) + 1] if pairs else smooth)


def held_now(frames: Sequence[SweepFrame], side: Side) -> float:
    """By how much a side's last quarter of a second holds the base back, 1/cm; 0 before that."""
    against = -SIGN[side]
    last = [against * f.excess for f in frames if f.side == side][-_SMOOTH:]
    return float(np.median(last)) if len(last) == _SMOOTH else 0.0


def pressed_enough(held_per_cm: float, config: RobotConfig, body_pressure: int) -> bool:
    """Whether the base is so near its fold that further bending would add nothing but the fold."""
    return held_per_cm >= _SHARE * fold_moment(config, body_pressure)


def pressing_body_pressure(
    frames: Sequence[SweepFrame], sides: Collection[Side], config: RobotConfig, body_pressure: int
) -> int:
    """Number of the body pressure at which contacts, felt at another, can be pressed hardest.

    `frames` are of the sweep that found them. A body under more pressure folds at a larger moment,
    but its muscles bend it less. From where the trigger fires, the base is held back further by at
    least about as much as the free body would have bent on.
    """
    if any(
        not pressed_enough(curvature_deficit(frames, side).max(initial=0.0), config, body_pressure)
        for side in sides
    ):
        return body_pressure  # the muscle or a slip limits the moment, and not the fold

    def pressed(candidate: int) -> float:
        """What the base can be held back by, 1/cm."""
        further = [
            config.muscle(side)
            .maps[candidate]
            .inflate.curvature(config.muscle(side).max_pressure_psi)
            - abs(touch_curvature(frames, side) or 0.0)
            for side in sides
        ]
        return min(TRIGGER_PER_CM + min(further), _SHARE * fold_moment(config, candidate))

    psi = [pressure.pressure_psi for pressure in config.body.pressures]
    best = max(
        (number for number in range(len(psi)) if psi[number] >= psi[body_pressure]), key=pressed
    )
    return best if pressed(best) > _WORTH * pressed(body_pressure) else body_pressure


def measuring_pressure(
    frames: Sequence[SweepFrame], side: Side, config: RobotConfig, body_pressure: int
) -> float:
    """Pressure (psi) to which to sweep a side again for the measurement.

    The lowest pressure on the way up at which the base is held back by its share of the fold's
    moment, or else that at which it is held back most; never more than the muscle holds.
    """
    highest = config.muscle(side).max_pressure_psi
    side_frames = [frame for frame in frames if frame.side == side]
    if len(side_frames) < _SMOOTH:
        return highest
    pressure = np.array([frame.pressure_psi for frame in side_frames])
    held = curvature_deficit(frames, side)
    reached = np.flatnonzero(held >= _SHARE * fold_moment(config, body_pressure))
    frame = reached[0] if reached.size else int(held.argmax())
    return float(min(max(pressure[frame], _LOWEST_PSI), highest))
