"""Obstructions of growth, by the sensors: a peg that stopped the tip or bent the body aside.

The spool only pays out line; nothing measures its tension. If a peg stands ahead, the tip stalls,
the tail goes slack, and from there on the encoder's length is too long. But a sensor that everts
passes through the tip's fold, the tightest bend there is: its reading rises and falls again. A
sensor that should lie behind the tip and shows no such peak has not everted. How far it came shows
where the tip is.

A tip that meets a peg off its middle is not stopped but slides round it, and the vented robot then
leans on the peg with its side. If it is zeroed there, every later reading is wrong by that bend.
From one stage to the next a sensor's zero moves by its noise only. Zeros that move by more, each in
proportion to its lever, show that the body is held bent. It was bent as the tip passed the peg, and
the encoder gives that length. Wound in until its tip is clear of the peg, such a body straightens,
and its zeros come back. Zeros that do not come back have moved by themselves.

Or a sweep has slipped past a peg, and the vented body hangs on it from behind, with its end. Then
the zeros of several sensors move, in no proportion to levers. Wound in until its end is off the
peg, it straightens as well; the peg stands aside, so the growth is tried again.

A tip can also be caught beside an obstacle that a sweep pressed it against: the vented body stays
bent, and growth stalls at once. What stopped it is then where the readings put the tip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.ndimage import median_filter

from thigmo.config import SIDES, SIGN
from thigmo.exploration.growth import FOLD_MARGIN_CM
from thigmo.exploration.workspace import Bend, common_error, measured_bend
from thigmo.record import Stall
from thigmo.robot import Profile, SensorTable
from thigmo.robot.curvature import Floats

_SMOOTH = 5  # frames of a running median, a quarter of a second

# A rise of this share of one over the tube's radius is the fold's. The fold's own curvature is of
# that order, ten times this share even where a sensor averages it; creep and noise are less.
_FOLD = 0.0525  # 0.03 1/cm at the thesis's 1.75 cm
_PASSED = 0.5  # share of the rise by which a reading falls once the fold is past; creep is less
_SAME_PLACE_CM = 1.0
_LEVEL = 0.03  # share of the rise by which a reading may differ from its last and count as that
_ONSET_CM = 1.0  # a fold that has entered a sensor by less may go unseen

# Standard deviations of the sensors' calibrated noise by which zeros move together when the body is
# held bent; what remains of an eversion's creep is less.
_SIGMAS = 4.0
# A peg that holds the body bent moves every zero by its lever. Less than this share of their
# squares explained is a sensor that moved alone, or a body that hangs.
_EXPLAINED = 0.8
# Of what stops a growth, before anything is known: an obstacle against too little pressure, and of
# obstacles the share of walls, by themselves and where a known wall leads there.
_OBSTACLE_ODDS, _WALL, _WALL_KNOWN = 1.5, 0.25, 0.9
_WALL_OFF_CM = 3.0
# By how much a trial at the next higher body pressure, which is half as much again or more, changes
# the odds of an obstacle.
_MOVED_ON, _STOOD = 0.02, 30.0
# By how much later than the line says a fold leaves a sensor (cm): one sigma where the tip stops at
# once, and the mean where it slows.
_LATE_CM, _SLOWED_CM, _LATE_FLOOR = 0.3, 1.5, 1e-3
# Prior of a sensor's creep after its eversion: a sum of two exponential decays. Their time
# constants bracket the 6 to 10 s of docs/methods.md. Each amplitude (1/cm) has mean 0 and this
# standard deviation, half as much again as the 0.02 1/cm within which most sensors start.
_DECAYS_S, _CREEP = (5.0, 11.0), 0.03
_CLEAR_CM = 1.0  # wound in so far behind the peg, the tip is clear of it
_CAME_BACK = 0.5  # share of a bend
# The side comes to rest beside the peg's middle. Half of the bend is there when the tip's corner is
# on its way from the near face to the middle: up to a peg's radius before, which is not known.
_BACK_CM, _ON_CM = 1.0, 1.5


@dataclass(frozen=True, slots=True)
class Obstruction:
    """A peg in the way of growth. It stopped the tip, unless it is a `HeldBent`."""

    length_cm: float  # everted length
    arc_cm: float  # where the peg is, by the best guess
    interval_cm: tuple[float, float]  # it is within these
    sensors: int  # how many tell so
    force_per_cm2: float  # of the peg, over EI; signed as curvature
    # of the sensors that everted before the tip stood still: by how much later than the line says
    late_cm: tuple[float, ...] = field(default=(), kw_only=True)
    # the body as it stands still, up to the interval's end; None: no sensor was zeroed to tell
    body: Bend | None = field(default=None, kw_only=True)
    # share of the tip's way across that bends where no sensor reads could add to that of `body`
    unread: float = field(default=0.0, kw_only=True)


def causes(
    obstruction: Obstruction,
    walls: Sequence[Sequence[tuple[float, float]]] = (),
    *,
    moved_on: bool | None = None,
) -> Stall:
    """What may have stopped a growth, with probabilities; known walls are lines in the room (cm).

    `moved_on` says whether the tip did when the body pressure was raised; None: nobody tried.

    Where the pressure is too little for the tail's friction, the tip slows before it stops, and its
    fold leaves the last sensors later than the line says. A tip that an obstacle stops stops at
    once. In the emulator half of the tips without pressure slow by 2 cm and more, and no reading
    tells the others from an obstacle: only a trial at a higher body pressure would.
    """
    late = np.maximum(np.asarray(obstruction.late_cm, dtype=float), 0.0)
    odds = _OBSTACLE_ODDS
    if late.size:
        # Those side by side are late together, so they count as one.
        shortest = float(late.mean())
        at_once = np.exp(-0.5 * (shortest / _LATE_CM) ** 2) / _LATE_CM + _LATE_FLOOR
        slowing = 0.5 * at_once + 0.5 * np.exp(-shortest / _SLOWED_CM) / _SLOWED_CM
        odds *= float(at_once / slowing)
    if moved_on is not None:
        odds *= _MOVED_ON if moved_on else _STOOD
    obstacle = odds / (1 + odds)
    crossed = any(_crosses_path(wall, obstruction.interval_cm) for wall in walls)
    wall = obstacle * (_WALL_KNOWN if crossed else _WALL)
    return Stall(
        obstruction.arc_cm, obstruction.interval_cm, round(obstacle - wall, 4), round(wall, 4),
        round(1 - obstacle, 4), moved_on,
    )  # fmt: skip


def _crosses_path(line: Sequence[tuple[float, float]], interval: tuple[float, float]) -> bool:
    """Whether a wall, carried on, crosses the straight path within an interval of a stalled tip."""
    (x0, y0), (x1, y1) = line[0], line[-1]
    if abs(y1 - y0) < 1e-6:
        return False
    x = x0 - y0 * (x1 - x0) / (y1 - y0)
    return interval[0] - _WALL_OFF_CM <= x <= interval[1] + _WALL_OFF_CM


@dataclass(frozen=True, slots=True)
class HeldBent(Obstruction):
    """A peg on which the body leans while nothing inflates it."""

    curvature_se: float  # standard error of the bend, 1/cm
    hangs: bool  # on a peg that a sweep slipped past: where is not known
    bend: Floats  # (10,) by how much the zeros moved, 1/cm; NaN where that says nothing

    @property
    def clear_cm(self) -> float:
        """Everted length at which the tip is clear of the peg."""
        return max(self.interval_cm[0] - _CLEAR_CM, 0.0)

    def released(self, old_zeros: Floats, new_zeros: Floats) -> bool:
        """Whether the zeros (10,) came back when the tip was clear, as those of a held body do.

        True as well where no sensor can tell: what may be a peg is not grown into.
        """
        back = old_zeros - new_zeros
        known = np.isfinite(self.bend) & np.isfinite(back) & (back != 0.0)
        bend = self.bend[known]
        return not known.any() or float(bend @ back[known]) > _CAME_BACK * float(bend @ bend)


def stall(length_cm: Floats, bend: Floats, table: SensorTable, zeros: Floats) -> Obstruction | None:
    """What a growth's readings show of its tip; None if every sensor that was due has everted.

    At believed lengths (n,), ascending, the sensors read `bend` (n, 10) in 1/cm from any zero.
    `zeros` (10,) are what the straight body read before the growth; NaN without a zero.
    """
    if len(length_cm) <= 2 * _SMOOTH:
        return None
    start = table.center_cm - table.span_cm / 2
    end = table.center_cm + table.span_cm / 2
    due = table.healthy & (start > length_cm[0]) & (end + FOLD_MARGIN_CM <= length_cm[-1] + 0.05)
    due &= np.isfinite(bend).all(axis=0)
    rise = _FOLD / table.radius_cm
    late: list[float] = []
    for place in sorted(set(table.center_cm[due].tolist())):
        nearby = np.flatnonzero(due & (np.abs(table.center_cm - place) < _SAME_PLACE_CM))
        stalls = [
            _stalled(length_cm, bend[:, i], float(start[i]), float(end[i]), rise) for i in nearby
        ]
        stuck = [stalled for stalled in stalls if stalled is not None]
        if len(stuck) == len(nearby):
            tips, lows, highs = zip(*stuck, strict=True)
            tip = float(np.mean(tips))
            interval_cm = min(lows), max(highs)
            everted = table.healthy & (end + FOLD_MARGIN_CM <= length_cm[0])
            last = np.where(everted, np.median(bend[-_SMOOTH:], axis=0), np.nan) - zeros
            body = _stalled_body(interval_cm[1], last, table)
            unread = _unread_share(interval_cm[1], last, table)
            return Obstruction(
                tip, tip, interval_cm, len(nearby), 0.0,
                late_cm=tuple(late), body=body, unread=unread,
            )  # fmt: skip
        late = [_left_late(length_cm, bend[:, i], float(start[i]), float(end[i])) for i in nearby]
    return None


def _stalled_body(length_cm: float, curvature: Floats, table: SensorTable) -> Bend | None:
    """The body up to a length, by the readings (10,) of the side that reads more of its bend.

    NaN where a sensor does not tell; None if none does.
    """
    known = np.isfinite(curvature)
    sides = [known & table.answers(SIGN[side]) for side in SIDES]
    use = max(sides, key=lambda mask: abs(float(curvature[mask].sum())))
    if not use.any():
        return None
    center_cm = table.center_cm[use]
    curvature_se = common_error(length_cm, center_cm, table.covariance[np.ix_(use, use)])
    return replace(measured_bend(length_cm, center_cm, curvature[use]), curvature_se=curvature_se)


def _unread_share(length_cm: float, curvature: Floats, table: SensorTable) -> float:
    """How much of a bent body's reach across lies beyond the sensors that read it, up to a length.

    A body that the tip holds bent may bend either way farther out, as one that buckles does; one
    that reads straight is taken for straight. Readings (10,) are NaN where a sensor does not tell.
    """
    known = np.isfinite(curvature)
    error = np.sqrt(np.diag(table.covariance))
    if not known.any() or (np.abs(curvature[known]) < _SIGMAS * error[known]).all():
        return 0.0
    last = float(table.center_cm[known].max())
    beyond = table.center_cm[table.healthy & (table.center_cm < length_cm)]
    beyond = beyond[beyond > last + _SAME_PLACE_CM]
    read_cm = 0.5 * (last + float(beyond.min())) if beyond.size else length_cm
    return (1.0 - read_cm / length_cm) ** 2


def _before(length_cm: Floats, reading: Floats, start: float) -> float:
    """What a sensor read before the fold can have reached it, whatever is in doubt of its place."""
    clear = length_cm < start - FOLD_MARGIN_CM - _ONSET_CM
    if not clear.any():
        clear = length_cm < start
    return float(np.median(reading[clear][-_SMOOTH:]))


def _left_late(length_cm: Floats, reading: Floats, start: float, end: float) -> float:
    """By how much later than the line says the fold went past a sensor, cm."""
    unfolded = _before(length_cm, reading, start)
    rise = np.abs(median_filter(reading, _SMOOTH, mode="nearest") - unfolded)
    top = int(rise.argmax())
    low = np.flatnonzero(rise[top:] < _PASSED * rise[top])
    # It is past by half where the tip stands in the sensor's last quarter.
    return float(length_cm[top + low[0]] - (0.25 * start + 0.75 * end)) if low.size else 0.0


def _stalled(
    length_cm: Floats, reading: Floats, start: float, end: float, least: float
) -> tuple[float, float, float] | None:
    """(tip, low, high) of a sensor that the fold did not pass through; None if it did."""
    unfolded = _before(length_cm, reading, start)
    last = float(np.median(reading[-_SMOOTH:]))
    rise = np.abs(reading - unfolded)
    top = int(rise.argmax())
    if rise[top] < least:  # it has not reached the fold
        low, high = float(length_cm[0]), start + _ONSET_CM
        return (low + high) / 2, low, high
    if abs(reading[top] - last) >= _PASSED * rise[top]:
        return None
    # It lies in the fold: from where on its reading stayed as it is, the tip stood still.
    noise = float(np.std(reading[-_SMOOTH:]))
    level = np.abs(median_filter(reading, _SMOOTH, mode="nearest") - last)
    off = np.flatnonzero(level > _LEVEL * rise[top] + 3 * noise)
    tip = float(np.clip(length_cm[off[-1]] if off.size else start, start, end))
    return tip, start, end


def detect_held_bent(
    profile: Profile, old_zeros: Floats, new_zeros: Floats, table: SensorTable
) -> HeldBent | None:
    """What a growth's readings and the zeros around it show of the body; None if it is straight.

    `old_zeros` and `new_zeros` (10,) are NaN without a zero. Before the first of all zeros, the
    growth's own readings stand for it.
    """
    if len(profile.length_cm) < _SMOOTH:
        return None
    if np.isnan(old_zeros).all():
        profile, old_zeros, new_zeros = _first_zeros(profile, table)
    length_cm, bend = profile.length_cm, profile.bend
    moved = new_zeros - old_zeros
    known = table.healthy & np.isfinite(moved) & np.isfinite(bend).all(axis=0)
    for way in (1, -1):
        use = known & table.answers(way)
        count = int(use.sum())
        if count == 0:
            continue
        sigmas = moved[use] / table.noise[use]
        if way * float(sigmas.sum()) / np.sqrt(count) < _SIGMAS:
            continue
        passing = _half_bent(length_cm, bend[:, use] - old_zeros[use], moved[use])
        if passing is None:
            continue  # the zeros moved after the growth
        low, high = passing - _BACK_CM, min(passing + _ON_CM, float(length_cm[-1]))
        arc = (low + high) / 2
        lever = np.maximum(arc - table.center_cm[use], 0.0)
        if not lever.any():
            continue
        share = float(lever @ moved[use]) ** 2 / float(lever @ lever * (moved[use] @ moved[use]))
        hangs = share < _EXPLAINED
        if hangs:
            several = np.count_nonzero(np.abs(sigmas) > _SIGMAS) > 1
            if not several or passing > length_cm[0]:
                continue  # a sensor that moved alone, or something that came as the body grew
            low, high = float(length_cm[0]) - table.radius_cm, float(length_cm[-1])
        force = float(lever @ moved[use] / (lever @ lever))
        noise = float(table.noise[use].mean() / np.sqrt(count))
        shown = np.where(use, moved, np.nan)
        return HeldBent(float(length_cm[-1]), arc, (low, high), count, force, noise, hangs, shown)
    return None


def _first_zeros(profile: Profile, table: SensorTable) -> tuple[Profile, Floats, Floats]:
    """A growth before the first zeros, without creep, and estimated zeros before and after a bend.

    Only the sensors nearest to the base are used, which everted first. Each creeps back to its rest
    as a sum of a slow and a fast decay. A peg's bend appears in all of them at one length, at which
    the fit leaves the smallest residual.
    """
    old_zeros, new_zeros = np.full((2, len(table.center_cm)), np.nan)
    out_cm = table.center_cm + table.span_cm / 2 + FOLD_MARGIN_CM
    place_cm = np.min(out_cm[table.healthy], initial=np.inf)
    first = table.healthy & (out_cm <= place_cm + _SAME_PLACE_CM)
    rows = profile.length_cm > place_cm + _ONSET_CM
    t_s, bend = profile.t_s[rows], profile.bend[rows][:, first]
    straight = np.full((len(t_s), len(first)), np.nan)
    if len(t_s) > 4 * _SMOOTH:
        decays = np.exp(-(t_s - t_s[0])[:, None] / _DECAYS_S)
        design = np.zeros((len(t_s) + 2, 4))  # the decays' priors below the readings
        design[:-2, 0], design[:-2, 2:] = 1.0, decays
        design[-2:, 2:] = np.eye(2) * table.noise[first].mean() / _CREEP
        readings = np.vstack([bend, np.zeros((2, bend.shape[1]))])
        fits = []
        for onset in range(_SMOOTH, len(t_s) - _SMOOTH):
            design[:-2, 1] = np.arange(len(t_s)) >= onset
            fit = np.linalg.lstsq(design, readings)[0]
            fits.append((float(((design @ fit - readings) ** 2).sum()), fit))
        start, step, *creep = min(fits, key=lambda fit: fit[0])[1]
        old_zeros[first], new_zeros[first] = start, start + step
        straight[:, first] = bend - decays @ np.array(creep)
    return Profile(t_s, profile.length_cm[rows], straight), old_zeros, new_zeros


def _half_bent(length_cm: Floats, bend: Floats, moved: Floats) -> float | None:
    """Length up to which a growth showed less than half of the bend; None if it never did more."""
    share = bend @ moved / (moved @ moved)
    below = np.flatnonzero(median_filter(share, _SMOOTH, mode="nearest") < 0.5)
    if not below.size:
        return float(length_cm[0])  # it leant before: the last bend pushed it beside the peg
    return float(length_cm[below[-1]]) if below[-1] < len(share) - _SMOOTH else None
