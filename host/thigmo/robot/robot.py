"""The robot as an object: every command of the board in the lab's units, and waiting for its end.

Used by the exploration, the calibration and programs for the robot. Each concern
builds on the one before: `connected` (link, stream, state), `supervised` (waiting, faults, arming,
configuration), and here length, sensors and sweeps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import nullcontext

import numpy as np

from thigmo.config import RobotConfig
from thigmo.errors import CommandRefusedError, CommandTimeoutError, ConfigError, LinkError
from thigmo.link import protocol as wire
from thigmo.link.inbox import TelemetryFrame
from thigmo.link.transport import open_transport
from thigmo.operator_prompts import Operator
from thigmo.record import Truth
from thigmo.robot.creep import CreepWatch
from thigmo.robot.curvature import Floats, in_mask, mask_of
from thigmo.robot.fibre import FibreReading
from thigmo.robot.state import Reading, Recording, SweepFrame, SweepResult, together
from thigmo.robot.supervisor import OPEN, SHORT, Supervised
from thigmo.robot.watchers import GrowthWatcher, SweepWatcher, peak_frame
from thigmo.wiring import blind

JOG_CM = 5.0  # of tip that a jog turns the spool for, at most
_VENTED_PSI = 0.5
_FIBRE_ZERO_S = 1.0
_SETTLE_EXTRA_S = 30.0
_SWEEP_EXTRA_S = 15.0  # ramps at both ends, venting, retried commands


def connect(
    url: str,
    config: RobotConfig | None = None,
    seed: int | None = None,
    *,
    operator: Operator | None = None,
    realtime: bool = False,
) -> Robot:
    """Open a robot.

    Args:
        url: a serial port (`/dev/ttyACM0`, `COM3`), any pyserial URL (`socket://host:port`,
            `rfc2217://`), `emulator://SCENE`, `mega-sim://SCENE` or
            `micropython://SCENE`.
        config: sent to the board and verified at once; None leaves the board as it is.
        seed: of the emulator's noise.
        operator: sets the body pressure and measures the length when asked. An emulated robot uses
            its own. On hardware, None makes every such question a DataError.
        realtime: run the emulator at the speed of the wall clock.

    Raises:
        LinkError: no such port, no robot on it, another schema.
        ConfigError: a scene or configuration that cannot be used.
    """
    from thigmo.link.client import Client

    client = Client(open_transport(url, seed=seed, realtime=realtime))
    robot = Robot(client, url=url, operator=operator)
    if config is not None:
        try:
            robot.configure(config)
        except BaseException:
            robot.close()
            raise
    return robot


class Robot(Supervised):
    """A connected robot and its commands, as `connect` returns it.

    Every command raises CommandRefusedError if the board refuses it (its `reason` is a name of
    the schema), RobotFaultError if a fault is latched, and LinkError if the link fails.
    """

    # The everted length.

    def confirm_length(self, length_cm: float, *, settled: bool = False) -> None:
        """State the measured everted length, cm; `settled`: the everted sensors have settled."""
        self._wait_vented()
        self._request(wire.ConfirmLength(round(length_cm * 1e4), int(settled)))

    def known_length_cm(self) -> float:
        """Everted length, cm; if the board does not know it, the operator must measure it."""
        length_cm = self.status().length_cm
        if length_cm is None:
            length_cm = self.operator.everted_length_cm()
            self.confirm_length(length_cm)
        return length_cm

    def select_zone(self, zone: int) -> None:
        """Tell the board which body pressure is set, by its index in robot.toml, from 0."""
        self._request(wire.SelectZone(zone))

    def grow_to(self, length_cm: float, watcher: GrowthWatcher | None = None) -> float:
        """Pay out to an everted length and wait for it; returns the length reached, cm.

        Meanwhile the telemetry goes to `watcher`. Refused while the length is unknown or a muscle
        is under pressure.
        """
        if self._has_fibre:
            self._require_fibre()  # takes time, and the telemetry meanwhile is no growth's
        with self._telemetry_to(watcher.telemetry) if watcher else nullcontext():
            self._start(wire.GrowTo(round(length_cm * 1e4), 0))
            return self._finish(wire.Activity.GROWING, self._travel_s()) / 1e4

    def retract_to(self, length_cm: float) -> float:
        """Vent, then wind in to an everted length; returns the length reached, cm.

        Refused while the length is unknown, or a muscle is above 0.5 psi, because a bent body
        buckles when it is wound in.
        """
        self.vent()
        status = self.status()
        psi = max(status.pressure_psi)
        if psi >= _VENTED_PSI:
            raise CommandRefusedError(
                f"a muscle holds {psi:.2f} psi",
                f"empty it below {_VENTED_PSI} psi first",
                reason=wire.Reason.NOT_VENTED.key,
            )
        self._start(wire.RetractTo(round(length_cm * 1e4), 0))
        return self._finish(wire.Activity.RETRACTING, self._travel_s()) / 1e4

    def home(self) -> None:
        """Vent, then wind in slowly until the spool has stalled at the base twice: length zero.

        After a reset the operator must confirm the length, because a jammed spool stalls in the
        same way. Raises DataError if there is no operator.
        """
        self.vent()
        self._start(wire.Home())
        slowest_cm_s = self.parameter("home_speed_um_s")[0] / 1e4
        self._finish(wire.Activity.HOMING, 2 * self.config.body.length_cm / slowest_cm_s + 10)
        self.known_length_cm()

    def _travel_s(self) -> float:
        spool = self.config.spool
        return 3 * (self.config.body.length_cm / spool.max_speed_cm_s) + 10

    # The sensors.

    @property
    def oversample(self) -> int:
        """Number of conversions that a raw reading sums."""
        return self._table.oversample

    def follow_settling(self) -> None:
        """Watch how sensors settle after eversion, so that sweeps can use them before they have."""
        if self._creep is None:
            self._creep = CreepWatch(self.config, self.oversample)
            self._client.on_telemetry.append(self._creep.telemetry)

    def young_noise(self) -> Floats:
        """Standard error of the zeros of sensors set aside, (inputs,), 1/cm; inf if unknown."""
        if self._creep is None:
            return np.full(self._table.inputs, np.inf)
        _, sigma = self._creep.rest(self.status().t_s, self.aside)
        return np.where(np.isnan(sigma), np.inf, sigma)

    def set_aside(self, mask: int) -> None:
        """Have the board ignore the everted sensors of a mask, as if they were dead; 0: none.

        Outputs must be off. Sensors that have not everted stay in use, because the board refuses to
        bend the body while one lies in the tip's fold.
        """
        mask &= self.status().everted
        if mask == self.aside:
            return
        healthy = self._table.healthy
        enabled = [int(healthy[n] and not mask >> n & 1) for n in range(self._table.inputs)]
        self.set_parameter("flex_enabled", enabled)
        self.aside = mask

    def wait_settled(
        self,
        progress: Callable[[float], None] = lambda left_s: None,
        sensors: int = -1,
    ) -> None:
        """Wait until the everted sensors of a mask (default: all) are past their settling time.

        `progress` is called about once a second with the seconds that remain. Raises
        CommandTimeoutError if they do not settle.
        """
        end = self.now() + self.config.board.settle_s + _SETTLE_EXTRA_S
        while waiting := self._settling(sensors):
            if self.now() > end:
                raise CommandTimeoutError(
                    f"sensors {in_mask(waiting)} do not settle",
                    "check the board's parameter settle_ms",
                )
            left_s = self.settles_s(waiting)
            while left_s > 0:
                progress(left_s)
                self.wait(min(left_s, 1.0))
                left_s -= 1.0
            self.wait(0.02)

    def settles_s(self, sensors: int = -1) -> float:
        """Seconds until the everted sensors of a mask have settled; 0 once they have."""
        waiting = in_mask(self._settling(sensors))
        left = [self._client.request(wire.GetSensor(n)).settle_left_ms for n in waiting]
        return max(left, default=0) / 1e3

    def _settling(self, sensors: int) -> int:
        status = self.status()
        return status.everted & ~status.settled & sensors

    def zero(self) -> int:
        """Average the everted sensors' readings into their zeros; returns these sensors' mask.

        Refused unless the muscles are vented, and the sensors settled and free of drift. A fibre's
        strains are zeroed as well, if robot.toml names an interrogator.
        """
        if self._has_fibre:  # first: where it drifts, the board keeps its zeros
            self._wait_vented()
            self._require_fibre()
            began_s = self.now()
            self.wait(_FIBRE_ZERO_S)
            self._require_fibre().zero(began_s, self.status().length_cm or 0.0)
        mask = self.status().everted & mask_of(self._table.board.healthy) & ~self.aside
        self._before = self._table
        if mask:
            self._start(wire.ZeroSensors(mask))
            self._finish(wire.Activity.ZEROING, 20.0)
        q8 = {n: self._client.request(wire.GetSensor(n)).zero_sum_q8 for n in in_mask(mask)}
        self._table = self._table.zeroed({sensor: zero / 256 for sensor, zero in q8.items()})
        self._publisher.use(self.config, self._table.board)
        return mask

    def zeros(self) -> tuple[Floats, Floats]:
        """Zeros before and after the last zeroing, (inputs,) each, 1/cm; NaN where there is none.

        They count from the same reference as `GrowthWatcher.profile`.
        """
        return self._before.board.zeros, self._table.board.zeros

    def flex_circuit(self, sensor: int) -> tuple[bool, bool]:
        """Whether a flex sensor's circuit is open, and whether it is shorted, now."""
        flags = self._client.request(wire.GetSensor(sensor)).flags
        return bool(flags & OPEN), bool(flags & SHORT)

    def read(self, seconds: float = 0.5, *, despite_faults: bool = False) -> Reading:
        """Average telemetry over some seconds; `despite_faults` as for `wait`."""
        frames, flex = self._frames(seconds, despite_faults)
        table = self._table.board
        return Reading(
            t_s=float(np.mean([self._client.device_s(f.t_us) for f in frames])),
            curvature=table.curvature(flex.mean(axis=0)),
            spread=table.curvature(flex).std(axis=0),
            pressure_psi=self._psi(np.mean([f.pressure_cpsi for f in frames], axis=0).tolist()),
            length_cm=frames[-1].length_um / 1e4,
            frames=len(frames),
            resistance=table.resistance(flex.mean(axis=0)),
        )

    def read_fibre(self, seconds: float = 0.5) -> FibreReading:
        """Average the fibre's strains over some seconds, as curvature since `zero`.

        Raises InterrogatorError, after making the robot safe, if a healthy grating is not read, and
        ConfigError if the robot has no fibre that is read live.
        """
        self._require_fibre()
        began_s, heard = self.now(), list[TelemetryFrame]()
        with self._telemetry_to(heard.append):
            self.wait(seconds)
        return self._require_fibre().reading(heard, began_s)

    def record(self, seconds: float) -> Recording:
        """Return every telemetry frame of some seconds."""
        frames, flex = self._frames(seconds)
        return Recording(
            t_s=np.array([self._client.device_s(frame.t_us) for frame in frames]),
            resistance=self._table.resistance(flex),
            pressure_psi=np.array([self._psi(frame.pressure_cpsi) for frame in frames]),
        )

    def _frames(
        self, seconds: float, despite_faults: bool = False
    ) -> tuple[list[wire.Telemetry], Floats]:
        """Telemetry of a while, and its raw flex readings (n, inputs)."""
        heard: list[TelemetryFrame] = []
        with self._telemetry_to(heard.append):
            self.wait(seconds, despite_faults=despite_faults)
            if not heard:  # a busy computer may hear it late, and telemetry may be slow
                period_s = self.parameter("telemetry_ms")[0] / 1e3
                self.wait(max(1.0, 2 * period_s), despite_faults=despite_faults)
        if not heard:
            raise LinkError("no telemetry came", "check the parameter telemetry_ms")
        frames = [frame.message for frame in heard]
        if (count := len(frames[0].flex_sum)) != self._table.inputs:
            raise ConfigError(
                f"the robot of this board of {count} sensor inputs is not known",
                "send its robot.toml with `configure`",
            )
        return frames, np.array([frame.flex_sum for frame in frames], dtype=np.float64)

    def press(self, towards: str | float, psi: float, *, ramp_psi_s: float = 0.0) -> None:
        """Hold one muscle under pressure, and the others at none; returns at once.

        `towards` is the muscle's name, or the direction (degrees) towards which it bends the body.
        A set point below the transducer's live zero (about 2.2 psi) vents it. A ramp of 0 means the
        configured rate. Refused while a sensor is half everted. The operator is warned, once, of a
        muscle that no base sensor guards: no contact is felt while it bends the body.
        """
        wanted = wire.SetPressure(self._cpsi({towards: psi}), round(ramp_psi_s * 100))
        unguarded = self._request(wanted).detail
        name = self.config.muscles[self.config.muscle_number(towards)].name
        if unguarded and name not in self._warned_of:
            self._warned_of.add(name)
            self.operator.warn(
                f"no base sensor guards muscle {name}: no contact is felt while it bends the body"
            )

    def _cpsi(self, tops_psi: Mapping[str | float, float]) -> tuple[int, ...]:
        """Pressures as the board takes them; ConfigError for a muscle that the robot lacks."""
        found = [0] * self._client.capacity.muscles
        for towards, psi in tops_psi.items():
            found[self.config.muscle_number(towards)] = round(psi * 100)
        return tuple(found)

    # Sweeps.

    def sweep(
        self,
        tops_psi: Mapping[str | float, float],
        *,
        period_s: float,
        rising_only: bool = False,
        enough: Callable[[SweepResult], bool] | None = None,
    ) -> SweepResult:
        """Bend towards each muscle in turn along a half sine of pressure, and look for contacts.

        Args:
            tops_psi: peak pressure of each muscle, by its name or the direction (degrees) towards
                which it bends the body.
            period_s: period of the whole sine (`sweep_period_s` says how slow it must be).
            rising_only: vent each muscle after its peak, because the way back meets no contact
                that the way up did not.
            enough: with `rising_only`, called twenty times a second after the trigger has fired,
                with the readings of this bend so far; the last half second stands in for the peak.
                If it returns true, the muscle is vented at once.

        Refused while a sensor is half everted, or the length or the zone is unknown.

        Raises:
            ConfigError: the contact trigger has no sensor that works while a muscle bends the body.
        """
        for muscle in (self.config.muscles[self.config.muscle_number(at)] for at in tops_psi):
            if muscle in blind(self.config):
                raise ConfigError(
                    f"no healthy sensor at the base answers to muscle {muscle.name}: a sweep "
                    "towards it would feel no contact",
                    "repair a base sensor, or correct its `healthy` and `valid_direction` in "
                    "robot.toml; `Robot.press` bends the body without a trigger",
                )
        if not rising_only:
            return self._sweep(tops_psi, period_s)
        found = []
        for towards, psi in tops_psi.items():
            found.append(self._sweep({towards: psi}, period_s, rising=True, enough=enough))
            self.vent()
        return SweepResult.joined(found)

    def _sweep(
        self,
        tops_psi: Mapping[str | float, float],
        period_s: float,
        *,
        rising: bool = False,
        enough: Callable[[SweepResult], bool] | None = None,
    ) -> SweepResult:
        before = self.status()
        watcher = SweepWatcher(
            self._table,
            before.everted & before.settled & before.zeroed,
            before.length_cm or 0.0,
            self.aside,
            self._creep,
            rising,
            sides=self.config.muscle_sides,
            strains=self.strains,
        )
        truths: list[Truth | None] = []
        shown = 0

        def until() -> bool:
            nonlocal shown
            # A trigger may come before the pressure has risen: there is nothing to judge yet.
            if enough is None or not watcher.triggers or watcher.peaks:
                return False
            if len(watcher.frames) == shown:
                return False
            shown = len(watcher.frames)
            watcher.stopped = enough(watcher.result(together(truths), so_far=True))
            return watcher.stopped

        command = wire.Sweep(self._cpsi(tops_psi), round(period_s * 1e3), 1, 0)
        with self._telemetry_to(watcher.telemetry):
            self._start(command)
            for event in self._events(wire.Activity.SWEEPING, period_s + _SWEEP_EXTRA_S, until):
                if event.code == wire.EventCode.CONTACT:
                    watcher.triggered(event, self._client.device_s(event.t_us))
                elif event.code == wire.EventCode.PEAK:
                    truths.append(self.truth(self.config.muscle_sides[event.arg]))
                    # Before the next half overwrites them.
                    watcher.peaks.append(self.snapshots())
                    if rising:
                        watcher.end()
                        self._request(wire.Vent())
                        break
            watcher.end()
            if watcher.stopped:
                truths.append(self.truth(watcher.frames[-1].side))
                self._request(wire.Vent())
        return watcher.result(together(truths))

    def snapshots(self) -> list[SweepFrame]:
        """The readings captured around the last peak of a sweep, in time order."""
        first = self._client.request(wire.GetSnapshot(0))
        rest = [self._client.request(wire.GetSnapshot(n)) for n in range(1, first.count)]
        sides = self.config.muscle_sides
        return [peak_frame(one, self._client.device_s(one.t_us), sides) for one in (first, *rest)]
