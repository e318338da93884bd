"""The emulated robot's body and room: from valve currents and motor duty to analog levels.

One step is 10 ms. Air, muscles, swing and spool have their own lags; the body's shape is
quasi-static (a vine robot moves slowly) and is solved again only when something changed. White
noise is the board's (a pure function of seed, tick and channel); all else that is random is drawn
here from the seed. Driven by `transport.py`, `serve.py` and the tests.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, cos, exp, hypot, inf, isnan, nan, pi, radians, sin

import numpy as np
import numpy.typing as npt

from thigmo import config
from thigmo.emulator import _plant
from thigmo.emulator._plant import FlexSensor, Muscle, Spool, Swing
from thigmo.emulator.board import CHANNELS, DRIVE_FULL
from thigmo.emulator.fibre import EmulatedFibre
from thigmo.emulator.hand import hold
from thigmo.emulator.imus import ImuString
from thigmo.emulator.scene import Scene
from thigmo.errors import DataError
from thigmo.mechanics import (
    Obstacle,
    Peg,
    PegContact,
    Rod,
    Solution,
    Tube,
    Wall,
    critical_moment,
    peg_for,
)
from thigmo.wiring import Wiring

Floats = npt.NDArray[np.float64]

STEP_S = _plant.STEP_S
STEP_MS = 10
# Steps in which a flickering sensor is true, of how many.
_TRUE_STEPS, _FLICKER_STEPS = 2, 100
OPEN_COUNT = 0.0  # of an input whose wire is broken, or
SHORT_COUNT = 1023.9  # shorted to the supply
# An input without a sensor hangs on its divider alone, and never everts.
_NO_SENSOR = config.FlexSensor(center_cm=1e9, span_cm=0.0)
_TAUT_CM = 1e-3
_MOTOR_SWAPPED = ("motor_swapped", "both_swapped")
_ENCODER_SIGN = {
    "right": 1, "motor_swapped": 1, "encoder_swapped": -1, "both_swapped": -1,
    "encoder_unplugged": 0,
}  # fmt: skip
_LIMP_PSI = 0.05
_AIR_SHARE = 0.005  # of the body's pressure; nearer is there
_SMALLEST_CM = 0.5  # a shorter body has no shape worth solving


@dataclass(frozen=True)
class Truth:
    """The true room, body and contacts."""

    # All pegs of the room, those that gave way included, and walls as rows of pegs; while dowels
    # hold the body, only these dowels
    pegs: tuple[Peg, ...]
    length_cm: float  # everted length
    contacts: tuple[PegContact, ...]  # touching pegs, base first
    # `curvature` is without the fold and the rest shape
    centreline: Floats  # columns s, heading, curvature, x, y; shape (n, 5)
    gave_way: frozenset[int] = frozenset()  # numbers of the pegs that did, walls' rows left out


class _Switch:
    """A contact or brake that follows its coil after a time."""

    def __init__(self, on_s: float, off_s: float) -> None:
        self._after_s = {True: on_s, False: off_s}
        self._since_s = 0.0
        self.on = False

    def step(self, coil: bool) -> bool:
        """Advance one step; returns whether it is on."""
        self._since_s = 0.0 if coil is self.on else self._since_s + STEP_S
        if coil is not self.on and self._since_s >= self._after_s[coil]:
            self.on, self._since_s = coil, 0.0
        return self.on


class Plant:
    """Robot and room of a scene, random by `seed` (None takes the scene's).

    Attributes:
        wiring: where the robot's sensors and muscles hang.
    """

    def __init__(self, scene: Scene, seed: int | None = None) -> None:
        self.scene = scene
        rng = np.random.default_rng([scene.seed if seed is None else seed, 0x91A27])
        robot = scene.robot
        self._robot = robot
        self._rng = rng
        self.wiring = Wiring.laid_out(robot)
        board = self.wiring.size
        self.pressure_channel = first = board.sensors  # of the first muscle
        self.pegs = scene.peg_list()
        # Numbers of the obstacles that still stand; only these are part of the mechanics.
        self._obstacles: tuple[Obstacle, ...] = (*self.pegs, *scene.wall_list())
        self._gives_way = [table.gives_way or inf for table in (*scene.pegs, *scene.walls)]
        self._standing = list(range(len(self._obstacles)))
        self.steps = 0
        # A body of fixed length is there from the start.
        start_cm = scene.start_length_cm if robot.body.grows else robot.body.length_cm
        self.body_psi = robot.body.pressures[robot.body.pressure_number(start_cm)].pressure_psi
        self._regulator_psi = self.body_psi
        self._body_air = 0.0 if scene.enables.fitted else 1.0  # share of it that the body holds

        # Set by faults.
        muscles = len(robot.muscles)
        self.forced_outlet = np.full(muscles, np.nan)  # psi at which the transducers' outputs stand
        self.spool_stall = False  # the spool does not turn
        self.slip_cm_s = 0.0  # speed to which a failing brake lets the body pull the line
        self.motor_lost = False  # the motor's circuit is broken: neither drive nor damping
        self.motor_forced: int | None = None  # duty that a failed driver gives the motor
        self.encoder_share = 1.0  # of the counts that the encoder shows: 0 = it stands still
        self._encoder_missed = 0.0
        self.line_snapped = False  # nothing holds the body back
        self.estop = False  # pressed: its own contact cuts the motor's supply, if there is a brake
        self.contact_welded = False  # that of the motor's enable
        self.brake_stuck: bool | None = None  # open, closed, or as its coil says
        self.reference = 1.0  # what remains of the converter's reference
        self.stuck: dict[int, float] = {}  # counts at which analog inputs stand, by channel
        self.chatters: dict[int, float] = {}  # share of time for which a wire is open, by channel
        self.flex_noise: dict[int, float] = {}  # counts, by input
        # Faults of the pressure sensors: frozen value, highest value, factor, offset, noise; psi.
        self.pressure_frozen = np.full(muscles, np.nan)
        self.pressure_most = np.full(muscles, np.inf)  # psi that its sensor shows, but for moments
        self.pressure_gain = np.ones(muscles)
        self.pressure_offset = np.zeros(muscles)
        self.pressure_noisy = np.zeros(muscles)
        # Points (arc, y) of the centreline that `hold` keeps in place, cm.
        self.pushes: tuple[tuple[float, float], ...] = ()
        self._dowel_cm = 0.0
        self._held_body: Solution | None = None

        t, m = scene.transducer, scene.muscle
        self._muscles = tuple(
            Muscle(
                at_4ma_psi=t.at_4ma_psi, at_20ma_psi=t.at_20ma_psi, gain=1 + t.gain_error * draw,
                lag_s=t.lag_s, delay_s=t.delay_s, play_psi=t.hysteresis_psi,
                slew_psi_s=t.slew_psi_s, supply_psi=t.supply_psi, inflate_tau_s=m.inflate_tau_s,
                deflate_tau_s=m.deflate_tau_s, muscle_delay_s=m.delay_s,
                reversal_psi=muscle.reversal_psi,
            )
            for muscle, draw in zip(
                robot.muscles, rng.standard_normal(len(robot.muscles)), strict=True
            )
        )  # fmt: skip
        self._pressure_zero = t.sensor_zero_error_psi * rng.standard_normal(len(robot.muscles))
        # Share of each muscle's bend that is in the plane, positive to the left, and out of it.
        self._in_plane, self._out_of_plane = _parts(robot.muscles)
        self._planar = all(muscle.side for muscle in robot.muscles)
        self._swing, self._swing_out_of_plane = (
            Swing(frequency_hz=scene.body.frequency_hz, damping=scene.body.damping)
            for _ in range(2)
        )
        s = scene.spool
        sliding = s.stall_n * s.dead_zone / 800.0
        self._spool = Spool(
            damping=(s.stall_n - sliding) / s.line_cm_s, lag_s=s.lag_s, stall_n=s.stall_n,
            sliding_n=sliding, holding_n=max(robot.spool.holding_n, sliding),
            touch_n_s_cm=s.touch_n_s_m / 100,
            line_cm=robot.spool.payout_ratio * start_cm,
        )  # fmt: skip
        b = scene.brake
        self._contacts = _Switch(b.contact_s, b.contact_s)
        self._brake = _Switch(b.opens_s, b.closes_s)
        self.length_cm = start_cm
        wired = self.wiring.sensors
        turns = {n: s for n, s in enumerate(wired) if isinstance(s, config.HeadingSensor)}
        self._turning = np.array([*turns], dtype=np.intp)  # the inputs that IMUs are read into
        self.imus = ImuString(
            scene.imu, [*turns.values()], robot.board.divider_ohm, STEP_S, rng.spawn(1)[0]
        )
        # A thicker tube folds more gently at its tip, and what has been folded less creeps less;
        # what does not grow has no fold there.
        self._gentler = config.Body().radius_cm / robot.body.radius_cm
        self._fold_bend = scene.flex.fold_bend * self._gentler if robot.body.grows else 0.0
        self.fibre = EmulatedFibre(
            scene.fibre, robot.gratings, STEP_S, rng.spawn(1)[0], self._fold_bend
        )
        self._sensors = self._make_sensors(wired)
        everts = np.array([[s.center_cm, s.span_cm] for s in self._sensors])
        self._ends = everts @ [1.0, 0.5]
        self._centers, self._spans = np.array(
            [
                (s.center_cm, s.span_cm) if s else place
                for s, place in zip(wired, everts, strict=True)
            ]
            + [(s.center_cm, s.span_cm) for s in robot.gratings]
        ).T
        # Of the board's inputs, and then of the fibre's gratings, which tell the two bends apart.
        self._curvature = np.zeros(board.sensors + len(robot.gratings))
        self._reads = np.tile([1.0, 0.0], (len(self._curvature), 1))  # of either bend
        for n, sensor in enumerate(wired):
            if sensor is not None:
                sign = 1.0 if sensor.angle_deg < 180.0 else -1.0
                self._reads[n] = sign * np.ravel(_parts([sensor]))
        self.body = Rod(
            Tube(
                robot.body.diameter_cm,
                self._critical(),
                scene.body.base_compliance_cm,
                scene.body.tip_rounding_cm,
                robot.body.rest_pieces,
            ),
            self._obstacles,
            friction=scene.body.friction,
            **scene.plant.model_dump(),
        )
        self._solved_g = nan
        self.analog = np.zeros((max(CHANNELS, first + board.muscles), 2))
        # An input without a muscle has a divider that reads 0 psi (docs/another-robot.md).
        self.analog[first : first + board.muscles] = 102.4
        self.encoder = (self._encoder(), self._encoder())
        self.set_body_pressure(self.body_psi)
        self._solve(self.length_cm)
        self._evert(settled=scene.start_settled)
        self._sense()
        self.analog[:, 0] = self.analog[:, 1]

    # Construction.

    def _make_sensors(self, wired: Sequence[config.Sensor | None]) -> list[FlexSensor]:
        scene, f = self.scene, self.scene.flex
        # The muscle under each sensor, by number.
        muscle_at = {muscle.angle_deg: n for n, muscle in enumerate(scene.robot.muscles)}
        self._under = [muscle_at.get(s.angle_deg) if s else None for s in wired]
        draws = self._rng.standard_normal((len(wired), 2))
        phases = self._rng.uniform(0, 2 * pi, (len(wired), 2))
        sensors = []
        for i, on_input in enumerate(wired):
            sensor = on_input if isinstance(on_input, config.FlexSensor) else _NO_SENSOR
            flex_sensor = FlexSensor(
                loop_width=scene.noise.hysteresis_width, against_gain=f.against_gain,
                wrinkle=f.wrinkle, wrinkle_start_psi=f.wrinkle_start_psi,
                wrinkle_full_psi=max(f.wrinkle_full_psi, f.wrinkle_start_psi + 0.1),
                fold_bend=self._fold_bend, center_cm=sensor.center_cm, span_cm=sensor.span_cm,
                scale_per_ohm=sensor.scale_per_ohm, zero_ohm=sensor.zero_ohm,
                divider_ohm=scene.robot.board.divider_ohm, bend_sign=sensor.bend_sign,
                loop=scene.noise.hysteresis * draws[i, 0], creep_tau_s=sensor.settle_tau_s,
                stowed=f.stowed * draws[i, 1], phase_1=phases[i, 0], phase_2=phases[i, 1],
            )  # fmt: skip
            sensors.append(flex_sensor)
        return sensors

    def _critical(self) -> float | None:
        body = self._robot.body
        if not (self.scene.body.fold and body.folds):
            return None
        return critical_moment(body.critical_curvature, body.critical_pressure_psi, self.body_psi)

    def set_body_pressure(self, pressure_psi: float) -> None:
        """Turn the body's regulator: maps, fold and growth change with it."""
        self._regulator_psi = pressure_psi
        self._fill_body(self._body_air)

    def _fill_body(self, share: float) -> None:
        """Let the body hold a share of the regulator's pressure."""
        self._body_air = share
        # Cloth without air still has some stiffness; none at all has no shape to solve.
        pressure_psi = max(self._regulator_psi * share, min(_LIMP_PSI, self._regulator_psi))
        self.body_psi = pressure_psi
        self.body.critical_moment = self._critical()
        self._solved_g = nan
        for muscle, config_muscle in zip(self._muscles, self._robot.muscles, strict=True):
            maps = sorted(config_muscle.maps, key=lambda m: m.body_pressure_psi)
            mapped_psi = [m.body_pressure_psi for m in maps]
            branches = []
            for curves in ([m.inflate for m in maps], [m.deflate for m in maps]):
                constants = [
                    [curve.amplitude for curve in curves],
                    [curve.scale_psi for curve in curves],
                    [curve.offset_psi for curve in curves],
                ]
                branches.append([np.interp(pressure_psi, mapped_psi, row) for row in constants])
            muscle.set_maps(*branches)

    def hold(self, pushes: Sequence[tuple[float, float]], dowel_cm: float = 0.0) -> None:
        """Hold points (arc, y) of the centreline aside, cm, base first; with no points, let go.

        The room's pegs are out of reach meanwhile. Dowels of a radius hold them, or (0) fingers,
        which nobody sees. Raises DataError for a place or an arc beyond the body's reach.
        """
        for arc, _ in pushes:
            if not 0 < arc <= self.length_cm + 1e-6:
                raise DataError(
                    f"nothing can be held at {arc:.1f} cm of {self.length_cm:.1f} cm of robot",
                    "grow it first, or hold it nearer to its base",
                )
        self.pushes = tuple(pushes)
        self._dowel_cm = dowel_cm
        self._held_body = None
        self._solved_g = nan
        if self.pushes:
            self._solve(self.length_cm)

    def place_pegs(self, pegs: Sequence[Peg]) -> None:
        """Clear the room and put these pegs into it; DataError where one overlaps the base."""
        radius = self._robot.body.radius_cm
        for index, peg in enumerate(pegs):
            if hypot(peg.x, max(abs(peg.y) - radius, 0.0)) < peg.radius:
                raise DataError(f"peg {index} overlaps the robot's base at (0, 0)", "move it away")
        self.body.place(pegs)
        self.pegs = tuple(pegs)
        self._obstacles = self.pegs
        self._gives_way = [inf] * len(pegs)
        self._standing = list(range(len(pegs)))
        self._solve(self.length_cm)

    # What is known.

    @property
    def t_s(self) -> float:
        """Time since the start."""
        return self.steps * STEP_S

    @property
    def muscle_psi(self) -> tuple[float, ...]:
        """True pressure of each muscle."""
        return tuple(muscle.outlet_psi for muscle in self._muscles)

    @property
    def line_cm(self) -> float:
        """Line off the spool."""
        return self._spool.line_cm

    @property
    def line_n(self) -> float:
        """Pull on the line, N."""
        return self._spool.line_n

    @property
    def tail_jammed(self) -> bool:
        """Whether the tail cannot be wound in beyond where it jammed."""
        return self._spool.stop_cm > 0.0

    @tail_jammed.setter
    def tail_jammed(self, jammed: bool) -> None:
        self._spool.stop_cm = self._spool.line_cm if jammed else 0.0

    @property
    def free_curvature(self) -> float:
        """Present free curvature of the swinging body, 1/cm."""
        return self._swing.curvature

    @property
    def pressure_reading(self) -> tuple[float, ...]:
        """Pressures by the sensors, with their errors and faults, psi."""
        readings = []
        for n, true in enumerate(self.muscle_psi):
            psi = self.pressure_frozen[n]
            if isnan(psi):
                psi = true * self.pressure_gain[n] + self._pressure_zero[n]
                if self.pressure_noisy[n]:
                    psi += self.pressure_noisy[n] * self._rng.standard_normal()
                psi += self.pressure_offset[n]
            if self.steps % _FLICKER_STEPS >= _TRUE_STEPS:
                psi = min(psi, self.pressure_most[n])
            readings.append(float(psi))
        return tuple(readings)

    @property
    def sensor_curvature(self) -> Floats:
        """True mean curvature at each sensor, by input; 0 where not everted."""
        return self._curvature[: len(self._sensors)].copy()

    def truth(self) -> Truth:
        """Pegs, contacts and shape, now."""
        if (body := self._held_body) is not None:
            # Fingers touch nothing that a camera or a map could show.
            contacts = body.contacts if self._dowel_cm else ()
            line = np.column_stack([body.s, body.heading, body.curvature, body.x, body.y])
            pegs = tuple(peg_for(contact, self._dowel_cm) for contact in contacts)
            return Truth(pegs, self.length_cm, contacts, line)
        # Walls are rows of pegs here: of each, by its number, the row's first and the row.
        all_pegs = list(self.pegs)
        gave_way = frozenset(range(len(self.pegs))) - set(self._standing)
        rows: dict[int, tuple[int, list[Peg]]] = {}
        for number, obstacle in enumerate(self._obstacles):
            if isinstance(obstacle, Wall):
                rows[number] = len(all_pegs), _row(obstacle)
                all_pegs += rows[number][1]
        if self.length_cm < _SMALLEST_CM:
            return Truth(tuple(all_pegs), self.length_cm, (), np.zeros((1, 5)), gave_way)
        touching = []
        for contact in self.body.contacts():
            number = self._standing[contact.peg]
            if number in rows:
                first, row = rows[number]
                distances = [hypot(contact.x - peg.x, contact.y - peg.y) for peg in row]
                number = first + int(np.argmin(distances))
            touching.append(replace(contact, peg=number))
        return Truth(tuple(all_pegs), self.length_cm, tuple(touching), self.body.nodes(), gave_way)

    # Motion.

    def step(
        self,
        drive: tuple[int, ...],
        enabled: tuple[bool, ...],
        motor: int,
        braked: bool,
        air: tuple[bool, bool] = (False, False),
        motor_enables: tuple[bool, bool] = (False, False),
    ) -> None:
        """Advance by 10 ms under a board's outputs; `analog` and `encoder` then hold its inputs.

        If the scene has valves, muscles and body empty unless the air enables are held.
        """
        self.steps += 1
        outlets = self.forced_outlet
        if self.scene.enables.fitted:
            if not air[0]:
                outlets = np.zeros(len(self._muscles))
            self._move_body_air(open_=air[1])
        current = [
            20.0 * duty / DRIVE_FULL if opens else 0.0
            for duty, opens in zip(drive, enabled, strict=True)
        ]
        driven = zip(self._muscles, current, outlets, strict=False)
        bends = [muscle.advance(ma, psi) for muscle, ma, psi in driven]
        self._swing.follow(sum(share * g for share, g in zip(self._in_plane, bends, strict=True)))
        if not self._planar:
            pairs = zip(self._out_of_plane, bends, strict=True)
            self._swing_out_of_plane.follow(sum(share * g for share, g in pairs))
        encoder_start = self._encoder()
        if self.scene.spool.wiring in _MOTOR_SWAPPED:
            motor = -motor
        if self.motor_forced is not None:
            motor = self.motor_forced
        brake_n = self._switch_motor(*motor_enables)
        if self.motor_lost or not self.motor_power:
            motor, braked = 0, False
        pull_n = 0.0 if self.line_snapped else self.pull_n
        self._spool.advance(motor, braked or motor != 0, self.spool_stall, pull_n, brake_n)
        encoder_end = self._encoder()
        if self.encoder_share != 1.0:
            missed = (1.0 - self.encoder_share) * (encoder_end - encoder_start)
            self._encoder_missed += missed
            encoder_end -= missed
        self.encoder = (encoder_start, encoder_end)
        length = self._grown()
        moved = abs(self._swing.curvature - self._solved_g) > 1e-8
        if moved or length != self.length_cm or isnan(self._solved_g):
            self._solve(length)
        elif not self._planar:
            self._measure()
        self._sense()

    @property
    def motor_power(self) -> bool:
        """Whether the motor's driver has its supply."""
        return self._contacts.on or not self._robot.spool.brake

    def _switch_motor(self, supply: bool, release: bool) -> float:
        """Move contacts and brake for one step; returns the pull that the brake takes, N."""
        if not self._robot.spool.brake:
            return 0.0
        powered = self._contacts.step((supply or self.contact_welded) and not self.estop)
        open_ = self._brake.step(powered and release)
        if self.brake_stuck is not None:
            open_ = self.brake_stuck
        return 0.0 if open_ else self.scene.brake.holds_n

    @property
    def pull_n(self) -> float:
        """Tension of the tail: half of body pressure times section (docs/hardware/facts.md, Spool).

        A tip that stands still while line is paid out leaves the tail slack.
        """
        if self.slip_cm_s != 0.0:
            return self._spool.sliding_n + self._spool.damping * self.slip_cm_s
        if not self._robot.body.grows:
            return 0.0
        slack = self._spool.line_cm / self._robot.spool.payout_ratio - self.length_cm
        if slack > _TAUT_CM:
            return 0.0
        return self._robot.body.pull_n(self.body_psi)

    def _move_body_air(self, *, open_: bool) -> None:
        """Fill or empty the body through its valve for one step."""
        enables = self.scene.enables
        goal, tau_s = (1.0, enables.body_fills_s) if open_ else (0.0, enables.body_empties_s)
        share = goal + (self._body_air - goal) * exp(-STEP_S / tau_s)
        if abs(share - goal) < _AIR_SHARE:
            share = goal
        if share != self._body_air:
            self._fill_body(share)

    def _grown(self) -> float:
        """Length that line, body pressure and tail allow."""
        robot, body = self._robot, self.scene.body
        paid = self._spool.line_cm / robot.spool.payout_ratio
        allowed = min(robot.body.length_cm if self.line_snapped else paid, robot.body.length_cm)
        if allowed <= self.length_cm:
            return float(allowed)
        friction = robot.body.growth_psi_per_cm * self.length_cm
        excess_psi = self.body_psi - robot.body.growth_psi - friction
        rate = max(excess_psi, 0.0) * body.growth_cm_s_psi
        return float(min(allowed, self.length_cm + rate * STEP_S))

    def _solve(self, length: float) -> None:
        """Find the body's shape; a tip that is pushed back too hard does not grow."""
        g = self._swing.curvature
        if self.pushes:
            pushes = [(min(arc, length), y) for arc, y in self.pushes]
            self._held_body = hold(pushes, g, length, self.body.tube)
        grown = length > self.length_cm
        if length >= _SMALLEST_CM:
            if grown and self._standing:
                state = self.body.save()
                self.body.step(g, length)
                if self.body.axial_push() > self.scene.body.growth_force * self.body_psi:
                    self.body.restore(state)
                    self.body.step(g, self.length_cm)
                    length = self.length_cm
            else:
                self.body.step(g, length)
            self._let_go()
        changed = length != self.length_cm
        self.length_cm = length
        self._solved_g = g
        if changed:
            self._evert(settled=False)
        self._measure()

    def _let_go(self) -> None:
        """Take away what gives way to the present forces; the body bends on without it."""
        broken = {
            contact.peg
            for contact in self.body.contacts()
            if hypot(contact.normal, contact.tangential)
            > self._gives_way[self._standing[contact.peg]]
        }
        if broken:
            self._standing = [n for k, n in enumerate(self._standing) if k not in broken]
            self.body.place([self._obstacles[n] for n in self._standing])

    def _measure(self) -> None:
        """Mean curvature over the everted part of each sensor, towards its angle.

        Out of the plane the body is free: there it touches nothing and bends evenly.
        """
        if self.length_cm < _SMALLEST_CM:
            self._curvature[:] = 0.0
            return
        if self._held_body is not None:
            self._curvature[:] = self._held_body.averages(self._centers, self._spans)
        else:
            self.body.averages_into(self._centers, self._spans, self._curvature)
        in_plane, out_of_plane = self._reads.T
        self._curvature *= in_plane
        if not self._planar:
            self._curvature += out_of_plane * self._swing_out_of_plane.curvature

    def _evert(self, *, settled: bool) -> None:
        """Sensors that have just come out start to creep; those drawn in forget."""
        noise, flex = self.scene.noise, self.scene.flex
        for sensor, end in zip(self._sensors, self._ends, strict=True):
            if end > self.length_cm:
                sensor.stow()
            elif not sensor.everted:
                offset, creep = self._rng.standard_normal(2)
                began = -1e9 if settled else self.t_s
                creep_bend = self._gentler * flex.creep * abs(creep)
                sensor.evert(began, noise.per_eversion * offset, creep_bend)

    def _sense(self) -> None:
        analog = self.analog
        analog[:, 0] = analog[:, 1]
        length, t_s = self.length_cm, self.t_s
        wrinkling_psi = [0.0 if n is None else self._muscles[n].bend_psi for n in self._under]
        inputs = len(self._sensors)
        levels = zip(self._sensors, self._curvature[:inputs].tolist(), wrinkling_psi, strict=True)
        analog[:inputs, 1] = [s.count(bend, length, t_s, psi) for s, bend, psi in levels]
        self.fibre.step(self.steps, self._curvature[inputs:], length)
        if self._turning.size:
            analog[self._turning, 1] = self.imus.counts(self._curvature[self._turning], length)
        full = self.scene.transducer.sensor_full_psi
        for n, psi in enumerate(self.pressure_reading):
            analog[self.pressure_channel + n, 1] = 1024.0 * min(
                max(0.1 + 0.8 * psi / full, 0.0), 0.9999
            )
        for i, sigma in self.flex_noise.items():
            analog[i, 1] += sigma * self._rng.standard_normal()
        for channel, count in self.stuck.items():
            analog[channel, 1] = count
        for channel, share in self.chatters.items():
            if self._rng.random() < share:
                analog[channel, 1] = OPEN_COUNT
        if self.reference != 1.0:
            np.minimum(analog[:, 1] / self.reference, SHORT_COUNT, out=analog[:, 1])

    def adc_noise(self) -> Floats:
        """White noise of a conversion in counts, by channel."""
        sigma = np.zeros(len(self.analog))
        sigma[: len(self._sensors)] = self.scene.noise.white_counts
        sigma[self._turning] = 0.0  # reports of a bus
        first = self.pressure_channel
        sigma[first : first + len(self._muscles)] = self.scene.noise.pressure_counts
        return sigma

    def _encoder(self) -> float:
        line = self._spool.line_cm
        per_cm = self._robot.spool.counts_per_cm
        counts = per_cm * line * (1 + 0.5 * self.scene.spool.winding * line)
        return counts * _ENCODER_SIGN[self.scene.spool.wiring] - self._encoder_missed


def _row(wall: Wall) -> list[Peg]:
    """A wall as round pegs so near to each other that its surface is met to half a millimetre."""
    count = ceil(hypot(wall.end_x - wall.x, wall.end_y - wall.y) / wall.radius) + 1
    x, y = np.linspace([wall.x, wall.y], [wall.end_x, wall.end_y], count).T
    return [Peg(float(px), float(py), wall.radius) for px, py in zip(x, y, strict=True)]


def _parts(
    placed: Sequence[config.Muscle] | Sequence[config.Sensor],
) -> tuple[list[float], list[float]]:
    """Shares of a bend at each angle that are in the plane, to the left, and across it."""
    angles = [radians(thing.angle_deg) for thing in placed]
    return [sin(angle) for angle in angles], [cos(angle) for angle in angles]
