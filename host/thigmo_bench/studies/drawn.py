"""Sweeps of the independent rod, as a robot would have recorded them.

Rooms with one peg, or none, on the left of the thesis's robot. The rod bends into them at each stop
of growth (`obstructed.Sweeper`); sensors, muscle and clock then err as those of one robot do.
Errors are drawn for each robot, within what its robot.toml states or the kind adds. None of them
comes from the emulator's one value or from what a fit expects.

Lengths in cm, bends in 1/cm, pressures in psi.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from thigmo.config import RobotConfig
from thigmo.mechanics import critical_moment
from thigmo.robot import Peak, SweepFrame, SweepResult
from thigmo.wiring import Wiring
from thigmo_bench.studies.obstructed import Mechanics, Obstacles, Sweeper, Swept
from thigmo_bench.studies.rod import Floats

RISE_S, FRAME_S = 5.0, 0.05  # of a half sweep on its way up
_PEAK_FRAMES = 10
_ROWS = 48  # bends at which the rod is solved; readings between are interpolated
_RADII_CM = (0.25, 2.5)
_NEAREST_CM = 10.0  # no peg is first touched nearer to the base
_TOUCH = (0.15, 0.85)  # of the highest bend, at which the longest body first touches the peg
# Drawn for each robot, evenly or one sigma: gain against the bend sign; loop of hysteresis
# over the stated error of the zero; the bend that turns the loop around, 1/cm; relative scale and
# offset (1/cm) from sweep to sweep; delay that the stated lag lacks, s.
AGAINST = (0.3, 1.0)
LOOP, LOOP_WIDTH = (0.5, 2.0), (2e-3, 1e-2)
SWEEP_SCALE, SWEEP_OFFSET = (0.0, 0.02), (0.0, 5e-4)
LAG_S = 0.08
_MOST_LAGS = 8  # first-order ones of equal time between pressure and bend, of which the board has 1
_FINE_S = 5e-3
_YIELDS_AT_CM = 45.0  # arc at which a peg that folds the base yields by what its kind says


@dataclass(frozen=True)
class Drawn:
    """A kind of robot and room: the most that is drawn for each."""

    peg: bool = True
    gains: float = 0.0  # one sigma of the sensors' gains, beside the stated one
    bend: float = 0.0  # the map's bend is off by as much, up or down
    friction: float = 0.0
    base_rad: float = 0.0  # by which the base turns at the moment that folds it
    yields_cm: float = 0.0  # by which a peg yields to a force that folds the base
    stiffness: float = 0.0  # amplitude of a wave along the body, relative
    taper: float = 0.0  # of the stiffness, from base to tip
    bend_wave: float = 0.0  # amplitude of a wave in the free curvature, relative
    round_tip: bool = False


KINDS: dict[str, Drawn] = {
    "as calibrated": Drawn(),
    "gains 5 % off": Drawn(gains=0.05),
    "gains 10 % off": Drawn(gains=0.1),
    "map 10 % off": Drawn(bend=0.1),
    "friction to 0.6": Drawn(friction=0.6),
    "base turns to 0.05 rad": Drawn(base_rad=0.05),
    "pegs yield to 1 cm": Drawn(yields_cm=1.0),
    "stiffness 20 % uneven": Drawn(stiffness=0.2),
    "taper 30 %": Drawn(taper=0.3),
    "muscle 10 % uneven": Drawn(bend_wave=0.1),
    "round tip": Drawn(round_tip=True),
    "empty": Drawn(peg=False),
}


@dataclass(frozen=True)
class DrawnRoom:
    """One robot's sweeps in one room, and what stood there."""

    sweeps: list[tuple[SweepResult, int]]  # with the numbers of their body pressures, in order
    peg: tuple[float, float, float] | None  # x, y and radius
    contact: tuple[float, float, float] | None  # arc, x and y at the last peak; None: untouched
    touched: bool  # at any bend of any stop
    ended: bool  # the rod found no equilibrium at some bend; frames from there on are left out


@dataclass(frozen=True)
class _Stop:
    """One everted length: the sweeps of all robots there."""

    length: float
    body_pressure: int
    free: Floats  # (T,) by the map of robot.toml, at the pressure that lags
    psi: Floats  # (T,)
    true: Floats  # (T, S) free curvature of the bodies
    ladder: Floats  # (K, S) bends at which the rod was solved
    places: Floats  # (N,) where it was read, cm
    swept: Swept


def rooms(
    kind: Drawn, config: RobotConfig, lengths: Sequence[float], count: int, seed: int
) -> list[DrawnRoom]:
    """Rooms of a kind, each explored to everted lengths by a robot with this robot.toml."""
    rng = np.random.default_rng([seed, 0x0DE])
    body = _bodies(kind, config, count, rng)
    muscle, tube = config.muscle("left"), config.body.radius_cm
    highest = muscle.maps[config.body.pressure_number(lengths[-1])].inflate.curvature(
        muscle.max_pressure_psi
    )
    x, y, radius = _pegs(rng, count, lengths[-1], tube, highest)
    if not kind.peg:
        x, y = np.full((2, count), np.nan)
    yields = rng.uniform(0.0, kind.yields_cm, (count, 1)) * _YIELDS_AT_CM / body.critical[:, None]
    pegs = replace(Obstacles.pegs(x, y, radius), compliance=yields)
    sensors = [_Sensors.draw(kind, config, rng) for _ in range(count)]
    places = np.unique(np.concatenate([drawn.places for drawn in sensors]))
    off = 1.0 + kind.bend * rng.choice([-1.0, 1.0], count)  # of all body pressures' maps alike
    lag_s = LAG_S * rng.standard_normal(count)
    stops = [
        _stop(length, off, lag_s, config, body, pegs, (places, sensors[0].span), rng)
        for length in lengths
    ]
    return [
        _room(
            room, stops, sensors[room], (float(x[room]), float(y[room]), float(radius[room])), rng
        )
        for room in range(count)
    ]


def _stop(
    length: float, off: Floats, lag_s: Floats, config: RobotConfig, body: Mechanics,
    pegs: Obstacles, read_at: tuple[Floats, float], rng: np.random.Generator,
) -> _Stop:  # fmt: skip
    """Sweep all robots at an everted length; `read_at`: places and span of all sensors."""
    muscle, count = config.muscle("left"), off.size
    body_pressure = config.body.pressure_number(length)
    curve = np.vectorize(muscle.maps[body_pressure].inflate.curvature)
    fine_s = np.arange(0.0, RISE_S + _FINE_S / 2, _FINE_S)
    psi = muscle.max_pressure_psi * np.sin(0.5 * math.pi * fine_s / RISE_S) ** 2
    frames = np.arange(0, fine_s.size, round(FRAME_S / _FINE_S))
    lagged = _through_lags(psi, muscle.lag_s, 1)[frames]
    behind = np.array(
        [
            _through_lags(psi, max(muscle.lag_s + late, 0.0), int(rng.integers(1, _MOST_LAGS + 1)))
            for late in lag_s
        ]
    ).T[frames]

    scale = off * (1.0 + muscle.maps[body_pressure].scale_se * rng.standard_normal(count))
    scale *= 1.0 + rng.uniform(*SWEEP_SCALE, count) * rng.standard_normal(count)
    offset = muscle.offset_se * rng.standard_normal(count)
    offset += rng.uniform(*SWEEP_OFFSET, count) * rng.standard_normal(count)
    true = scale * curve(behind) + offset
    way = np.linspace(0.0, 1.0, _ROWS)[:, None]
    ladder = true.min(axis=0) + way * np.ptp(true, axis=0)
    fold = critical_moment(
        1.0, config.body.critical_pressure_psi, config.body.pressures[body_pressure].pressure_psi
    )  # over the one that robot.toml states
    assert fold is not None
    stop_body = replace(body, length=length, critical=fold * body.critical)
    places, span = read_at
    return _Stop(
        length, body_pressure, curve(lagged), psi[frames], true, ladder, places,
        Sweeper(stop_body, pegs).sweep(ladder, places, span),
    )  # fmt: skip


def _through_lags(psi: Floats, lag_s: float, count: int) -> Floats:
    """Pressures (T,) behind so many first-order lags, of a sum of `lag_s`."""
    keeps = math.exp(-_FINE_S * count / lag_s) if lag_s else 0.0
    for _ in range(count):
        psi = np.asarray(lfilter([1.0 - keeps], [1.0, -keeps], psi))
    return psi


def _room(
    room: int, stops: Sequence[_Stop], sensors: _Sensors, peg: tuple[float, float, float],
    rng: np.random.Generator,
) -> DrawnRoom:  # fmt: skip
    """One robot's sweeps at all stops, as it would have read them."""
    sweeps: list[tuple[SweepResult, int]] = []
    ended = False
    for stop in stops:
        ladder, readings = stop.ladder[:, room], stop.swept.readings[:, room]
        alive = np.isfinite(readings).all(axis=1)
        ended |= not bool(alive.all())
        known = stop.true[:, room] <= ladder[alive].max(initial=-np.inf) + 1e-12
        frames = known.size if known.all() else int(np.argmin(known))
        if frames < _PEAK_FRAMES:
            continue
        curvature = readings[alive][:, np.searchsorted(stop.places, sensors.places)]
        clean = [
            np.interp(stop.true[:frames, room], ladder[alive], column) for column in curvature.T
        ]
        sweeps.append(
            (_result(sensors, stop, sensors.read(np.array(clean).T, rng)), stop.body_pressure)
        )
    arc, x, y = stops[-1].swept.contacts[-1, room, 0].tolist()
    felt = any(np.isfinite(stop.swept.contacts[:, room, 0, 0]).any() for stop in stops)
    return DrawnRoom(
        sweeps,
        peg if math.isfinite(peg[0]) else None,
        (arc, x, y) if math.isfinite(arc) else None,
        felt,
        ended,
    )


def _bodies(kind: Drawn, config: RobotConfig, count: int, rng: np.random.Generator) -> Mechanics:
    """Bodies of the config with a kind's flaws; lengths and folds are set at each stop."""
    body, critical = config.body, config.body.critical_curvature
    ideal = Mechanics.ideal(count, length=body.length_cm, radius=body.radius_cm, critical=critical)
    spread = body.critical_curvature_se / critical
    return replace(
        ideal,
        critical=critical * np.maximum(1.0 + spread * rng.standard_normal(count), 0.5),
        friction=rng.uniform(0.0, kind.friction, count),
        base_compliance=rng.uniform(0.0, kind.base_rad, count) / critical,
        rounding=np.full(count, body.radius_cm * kind.round_tip),
        taper=np.full(count, kind.taper),
        stiffness_wave=np.full(count, kind.stiffness),
        bend_wave=np.full(count, kind.bend_wave),
        phase=rng.uniform(0.0, 2.0 * math.pi, count),
    )


def _pegs(
    rng: np.random.Generator, count: int, length: float, tube: float, highest: float
) -> tuple[Floats, Floats, Floats]:
    """Pegs (count,) spread evenly over the part of the plane that the ideal body sweeps."""
    x, y, radius = np.empty((3, 0))
    while x.size < count:
        draws = 20 * count
        r = rng.uniform(*_RADII_CM, draws)
        arc = rng.uniform(_NEAREST_CM, length, draws)
        bend = rng.uniform(*_TOUCH, draws) * highest
        turn = arc * bend
        # The area that a step of the arc and one of the bend sweep.
        area = np.maximum(1.0 - (tube + r) * bend, 0.0) * (1.0 - np.cos(turn)) / bend**2
        kept = rng.uniform(0.0, length**2, draws) < area
        px = np.sin(turn) / bend - (tube + r) * np.sin(turn)
        py = (1.0 - np.cos(turn)) / bend + (tube + r) * np.cos(turn)
        kept &= py > tube + r + 0.3
        x, y, radius = (
            np.concatenate([old, new[kept]])
            for old, new in ((x, px), (y, py), (radius, r))
        )  # fmt: skip
    return x[:count], y[:count], radius[:count]


@dataclass(frozen=True)
class _Sensors:
    """One robot's sensors on the right: what they are, and how they err."""

    inputs: list[int]  # among all of the board's
    total: int
    places: Floats  # (M,) cm
    span: float
    gain: Floats
    against: Floats
    zero: Floats
    loop: Floats  # half width of the loop of hysteresis, 1/cm
    loop_width: Floats
    noise: Floats

    @classmethod
    def draw(cls, kind: Drawn, config: RobotConfig, rng: np.random.Generator) -> _Sensors:
        rows = Wiring.laid_out(config).read_sensors
        inputs = [n for n, sensor in enumerate(rows) if sensor and sensor.side == "right"]
        right_sensors = [sensor for sensor in rows if sensor and sensor.side == "right"]
        count = len(right_sensors)
        gains = np.hypot([sensor.gain_error for sensor in right_sensors], kind.gains)
        zero = np.array([sensor.zero_error for sensor in right_sensors])
        loop = zero * rng.uniform(*LOOP, count) * rng.choice([-1.0, 1.0], count)
        center = np.array([sensor.center_cm for sensor in right_sensors])
        center_se = np.array([sensor.center_se_cm for sensor in right_sensors])
        place = center_se * rng.standard_normal(count)
        return cls(
            inputs, len(rows),
            np.round(center + place, 6), right_sensors[0].span_cm,
            1.0 + gains * rng.standard_normal(count), rng.uniform(*AGAINST, count),
            zero * rng.standard_normal(count), loop, rng.uniform(*LOOP_WIDTH, count),
            np.array([sensor.noise for sensor in right_sensors]),
        )  # fmt: skip

    def read(self, clean: Floats, rng: np.random.Generator) -> Floats:
        """(T, M) readings of curvatures (T, M), from a rest without a loop."""
        bent = np.where(clean < 0.0, self.against * clean, clean)
        turn, loop = np.zeros(len(self.gain)), np.empty_like(bent)
        previous = np.zeros(len(self.gain))
        for row, value in enumerate(bent):
            change = value - previous
            way = np.sign(change)
            turn = way + (turn - way) * np.exp(-np.abs(change) / self.loop_width)
            loop[row], previous = self.loop * turn, value
        return self.gain * bent - loop + self.zero + self.noise * rng.standard_normal(bent.shape)


def _result(sensors: _Sensors, stop: _Stop, read: Floats) -> SweepResult:
    """What the host would have recorded: frames on the way up, and the peak."""
    out = [
        n
        for n, place in zip(sensors.inputs, sensors.places, strict=True)
        if place + sensors.span / 2 <= stop.length
    ]
    mask = sum(1 << n for n in out)
    curvature = np.full((len(read), sensors.total), np.nan)
    curvature[:, sensors.inputs] = read
    base = curvature[:, sensors.inputs[0]]
    frames = [
        SweepFrame("left", FRAME_S * number, psi, free, float(base[number]) - free)
        for number, (psi, free) in enumerate(
            zip(stop.psi[: len(read)].tolist(), stop.free[: len(read)].tolist(), strict=True)
        )
    ]
    last = slice(len(read) - _PEAK_FRAMES, len(read))
    peak = Peak(
        "left", FRAME_S * (len(read) - 1), stop.length, curvature[last].mean(axis=0),
        float(np.mean(stop.free[last])), float(np.mean(stop.psi[last])), mask, _PEAK_FRAMES,
    )  # fmt: skip
    return SweepResult(peaks=[peak], frames=frames, curvature=curvature, sensors=mask)
