"""The robot as an object: every command of the board in the lab's units, and waiting for its end.

Used by the exploration, the calibration and whoever writes a program for the robot. All waiting
is done by reading the link: with the emulator that is what advances time, on hardware the
heartbeat runs beside it. A fault that the board latches while something is waited for is raised
as `RobotFaultError` with the schema's sentence.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np

from thigmo.config import RobotConfig, Side
from thigmo.errors import CommandRefusedError, CommandTimeoutError, LinkError
from thigmo.link import protocol as wire
from thigmo.link.heart import PERIOD_S
from thigmo.link.stored import StoredConfiguration
from thigmo.link.transport import open_transport
from thigmo.record import Truth
from thigmo.robot.configuration import get_parameter, send_config, set_parameters
from thigmo.robot.growing import GrowthWatcher
from thigmo.robot.operator import NobodyThere, Operator
from thigmo.robot.peaks import snapshot_reading
from thigmo.robot.publishing import Publisher
from thigmo.robot.readings import Floats, SensorTable
from thigmo.robot.standing import StandingWatch
from thigmo.robot.state import Reading, Recording, SnapshotReading, Status, SweepResult
from thigmo.robot.sweeping import SweepWatcher
from thigmo.robot.truth import truth_now
from thigmo.robot.watch import Watch
from thigmo.stream import Hub, Message, Telemetry
from thigmo.stream.hub import QUEUE

if TYPE_CHECKING:
    from thigmo.link.client import Client, Tap
    from thigmo.link.protocol import Ack, Command
    from thigmo.link.received import TelemetryFrame

R = TypeVar("R", bound=wire.Message)

SENSORS = 10
VENTED_PSI = 0.5
_OPEN, _SHORT = 1 << 3, 1 << 4  # of sensor_report.flags
_UNKNOWN_ZONE = 255
_SETTLE_EXTRA_S = 30.0
_STREAM_S = 0.1
_VENT_S = 15.0  # muscles empty within a second or two; a blocked valve does not
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
            `rfc2217://`), `emulator://SCENE` or `mega-sim://SCENE`.
        config: sent to the board and verified at once; None leaves the board as it is.
        seed: of the emulator's noise.
        operator: who sets the body pressure and measures the length; None takes the emulator's
            own, and on hardware refuses what needs one.
        realtime: pace the emulator by the clock.

    Raises:
        LinkError: no such port, no robot on it, another schema.
        ConfigError: a scene or configuration that cannot be used.
    """
    from thigmo.link.client import Client

    transport = open_transport(url, seed=seed, realtime=realtime)
    try:
        robot = Robot(Client(transport), url=url, operator=operator)
    except BaseException:
        transport.close()
        raise
    if config is not None:
        try:
            robot.configure(config)
        except BaseException:
            robot.close()
            raise
    return robot


class Robot:
    """A connected robot. A context manager: leaving it vents, brakes and closes the link.

    Attributes:
        url: how it was opened.
        operator: who answers what the board cannot know.
        config: robot.toml as last sent with `configure`.
    """

    def __init__(self, client: Client, *, url: str = "", operator: Operator | None = None) -> None:
        self._client = client
        # A board that lives in this process starts anew with the next connection.
        self._watch = Watch(client, "" if client.transport.virtual else url)
        self.url = url
        self.operator: Operator = (
            operator if operator and not client.transport.operator
            else client.transport.operator or NobodyThere()
        )  # fmt: skip
        self.config = RobotConfig()
        self._table = SensorTable.of(self.config)
        self._zero_sum: Floats = np.full(SENSORS, np.nan)
        self._zero_before = self._zero_sum
        self._oversample = 16
        self._started = client.now()
        self._aside = 0
        self._standing: StandingWatch | None = None
        self._closed = False
        self._publisher = Publisher(client, self.config, self._zero_sum, self._oversample)

    # Life.

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is not None and issubclass(kind, KeyboardInterrupt):
            self.make_safe(interrupted=True)
        self.close()

    def make_safe(self, *, interrupted: bool = False) -> bool:
        """Valves to 0 mA and motor braked, if the board can still be reached; never raises.

        Args:
            interrupted: by an operator: `stop`, which waits behind no command and latches,
                instead of `disarm`.

        Returns:
            Whether the board acknowledged. If not, its own heartbeat limit does the same.
        """
        try:
            if interrupted:
                self.stop()
            else:
                self.disarm()
        except LinkError:
            return False
        return True

    def close(self) -> None:
        """Make the robot safe and close the link. May be called twice."""
        if self._closed:
            return
        self._closed = True
        try:
            self.make_safe()
        finally:
            self._client.close()
            self.hub.close()

    def record_frames(self, tap: Tap) -> None:
        """Call `tap(direction, frame, host time)` with every frame of the link from now on."""
        self._client.taps.append(tap)

    # The stream.

    @property
    def hub(self) -> Hub:
        """Where the robot publishes its telemetry, events and shape.

        Others may publish there as well: an exploration does.
        """
        return self._publisher.hub

    @property
    def epoch_s(self) -> float:
        """UTC seconds since 1970 at which the link's clock (`now`) was 0."""
        return self._publisher.epoch_s

    def on_telemetry(self, callback: Callable[[Telemetry], None]) -> Callable[[], None]:
        """Call `callback` with each telemetry frame, decoded, while the link is read.

        It must be quick, and must command nothing; commands go on meanwhile.

        Returns:
            A function that ends it.
        """

        def take(message: Message) -> None:
            if isinstance(message, Telemetry):
                callback(message)

        self.hub.attach(take, {Telemetry.CHANNEL})
        return lambda: self.hub.detach(take)

    def stream(
        self, seconds: float = np.inf, channels: Iterable[str] | None = None, size: int = QUEUE
    ) -> Iterator[Message]:
        """Messages as they come, read from the link meanwhile; commands may be sent between them.

        Another thread than the one that drives the robot takes `hub.subscribe()` instead.

        Args:
            seconds: for so long.
            channels: names of `thigmo.stream.CHANNELS`; None gives all.
            size: messages that are kept while nobody takes them; then the oldest are lost.

        Raises:
            LinkError: the connection is gone.
        """
        end = self.now() + seconds
        with self.hub.subscribe(channels, size) as heard:
            while self.now() < end:
                self._client.poll(min(end - self.now(), _STREAM_S))
                self._watch.forget()  # nobody waits for the board's events meanwhile
                # What is done between two messages takes time, and brings new ones.
                while self.now() < end and (message := heard.get(0.0)) is not None:
                    yield message

    def while_waiting(self, callback: Callable[[], None]) -> None:
        """Call `callback` whenever something of the board is waited for; it may raise, which ends
        the waiting, and must command nothing.
        """
        self._watch.interruptions.append(callback)

    def _decode(self) -> None:
        self._publisher.use(self.config, self._zero_sum, self._oversample)

    def _request(self, command: Command[R]) -> R:
        """Ask the board; a refusal because of a latched fault becomes that fault's error."""
        try:
            return self._client.request(command)
        except CommandRefusedError as error:
            if error.reason != wire.Reason.FAULT_LATCHED.key:
                raise
            faults = self.status().faults
            if not faults:
                raise
            raise self._watch.fault_error(faults) from error

    def _start(self, command: Command[Ack]) -> None:
        """Start something whose events are waited for."""
        self._watch.forget()
        self._request(command)

    # What is known without asking.

    @property
    def identity(self) -> dict[str, str]:
        """Who the board is, as strings for a record: firmware, board, schema, boot."""
        hello = self._client.hello
        return {
            "board": wire.Board(hello.board).key,
            "firmware": ".".join(str(part) for part in hello.firmware_version),
            "schema_hash": f"{hello.schema_hash:08x}",
            "boot_nonce": f"{hello.boot_nonce:08x}",
            "reset_cause": wire.ResetCause(hello.reset_cause).key,
        }

    @property
    def virtual(self) -> bool:
        """Whether waiting advances an emulator's time instead of the clock's."""
        return self._client.transport.virtual

    @property
    def known_config(self) -> RobotConfig | None:
        """The robot.toml that an emulated robot's lab would have; None on hardware."""
        known: RobotConfig | None = getattr(self._client.transport, "config", None)
        return known

    def now(self) -> float:
        """The link's clock, s: monotonic on hardware, virtual in the emulator."""
        return self._client.now()

    @property
    def elapsed_s(self) -> float:
        """Time since the connection, on the link's clock."""
        return self.now() - self._started

    def link_stats(self) -> dict[str, int]:
        """Counters of the link as the board sees it, by the schema's names."""
        return {
            name: value
            for name, value in asdict(self._client.request(wire.GetLinkStats())).items()
            if name != "status"
        }

    def scenery(self) -> Any:
        """The emulator's own truth (shapes included), for painting pictures; None on hardware."""
        return self._client.transport.truth()

    def truth(self) -> Truth | None:
        """What the emulated room knows now; None on hardware."""
        return truth_now(self._client.transport.truth())

    # Configuration.

    def configure(self, config: RobotConfig) -> bool:
        """Send robot.toml to the board, read it back, and store it there if it changed.

        A flex sensor's fault is cleared with it if the sensor is now marked unhealthy.

        Args:
            config: what the lab knows of its robot.

        Returns:
            Whether the board's configuration changed.

        Raises:
            ConfigError: a value that the board cannot hold, or does not give back.
            CommandRefusedError: an output is energised, or a value is out of range.
        """
        changed = send_config(self._client, config)
        self._oversample = 1 << self.parameter("oversample_log2")[0]
        self.config = config
        self._table = SensorTable.of(config)
        self._zero_sum = np.full(SENSORS, np.nan)
        self._decode()
        self._aside = 0
        status = self.status()
        if changed or status.config_generation == 0 or "bad_config" in status.faults:
            self.save()
        # What a configuration cures; the board keeps a fault whose cause lasts.
        cured = {"bad_config", *(("flex_open", "flex_short") if changed else ())}
        if cured & set(status.faults):
            self.clear_faults(*sorted(cured & set(status.faults)))
        return changed

    def parameter(self, name: str) -> list[int]:
        """A parameter of the schema as the board holds it, in its wire unit.

        Raises:
            ConfigError: no such parameter.
        """
        return get_parameter(self._client, name)

    def set_parameter(self, name: str, values: list[int]) -> None:
        """Set a parameter in the board's memory, in its wire unit; `save` stores it.

        Raises:
            ConfigError: no such parameter, a wrong number of values, or one out of range or that
                contradicts another.
        """
        set_parameters(self._client, {name: values})

    def load_defaults(self) -> None:
        """Give the board the schema's defaults, store them, and clear `bad_config`."""
        self._client.request(wire.LoadDefaults())
        self.save()
        self.clear_faults("bad_config")

    def save(self) -> int:
        """Store the configuration in the board; returns its generation. Takes seconds."""
        return self._client.request(wire.SaveConfig()).detail

    def stored_configuration(self) -> StoredConfiguration:
        """How the stored configuration fits the firmware that runs."""
        return StoredConfiguration.of(self._client.request(wire.GetConfigReport()))

    # State.

    def status(self) -> Status:
        """Ask the board for its whole state."""
        report = self._client.request(wire.GetStatus())
        conditions = frozenset(c.key for c in wire.Condition.from_mask(report.conditions))
        self._publisher.supply_v = report.supply_mv / 1e3
        return Status(
            state=wire.State(report.state).key,
            activity=wire.Activity(report.activity).key,
            zone=None if report.zone == _UNKNOWN_ZONE else report.zone,
            faults=tuple(f.key for f in wire.Fault.from_mask(report.faults)),
            conditions=conditions,
            t_s=self._client.device_s(report.t_us),
            length_cm=report.length_um / 1e4 if "length_known" in conditions else None,
            left_psi=report.left_cpsi / 100,
            right_psi=report.right_cpsi / 100,
            everted=report.everted_mask,
            settled=report.settled_mask,
            zeroed=report.zeroed_mask,
            config_generation=report.config_generation,
            supply_v=report.supply_mv / 1e3,
            encoder_errors=report.encoder_errors,
        )

    def clear_faults(self, *names: str) -> tuple[str, ...]:
        """Clear latched faults whose cause is gone.

        Args:
            names: the schema's names; none means all.

        Returns:
            Names of those that remain.
        """
        known = [wire.Fault[name.upper()] for name in names] or list(wire.Fault)
        mask = sum(fault.mask for fault in known)
        remaining = self._client.request(wire.ClearFaults(mask)).detail
        return tuple(fault.key for fault in wire.Fault.from_mask(remaining))

    def raise_faults(self) -> None:
        """Tell a latched fault, if there is one.

        Raises:
            RobotFaultError: a fault is latched.
        """
        faults = self.status().faults
        if faults:
            raise self._watch.fault_error(faults)

    def arm(self, *, body_air: bool = True) -> None:
        """Leave safe for ready: outputs may be energised from now on, and the body gets its air.

        Args:
            body_air: False leaves the body empty, if it has an enable.

        Raises:
            RobotFaultError: a fault is latched.
        """
        self.raise_faults()
        try:
            self._request(wire.Arm())
        except CommandRefusedError as error:
            if error.reason != "host_silent":
                raise
            # While an operator was asked nothing was heard of the board, and the heart held still.
            self.wait(2.0 * PERIOD_S)
            self._request(wire.Arm())
        if body_air:
            self._request(wire.BodyAir(1))

    def test_output(self, output: wire.Output, level: int, seconds: float) -> None:
        """Drive one output as it is; the board ends it by itself unless it is repeated.

        Args:
            output: which.
            level: transducer 0..400 (5 mA), motor -200..200 (a quarter of full).
            seconds: at most 0.5.

        Raises:
            CommandRefusedError: not armed, beyond a limit, or a muscle holds pressure (motor).
        """
        self._request(wire.TestOutput(output, level, round(seconds * 1e3)))

    def end_test(self) -> None:
        """End what `test_output` drives, now."""
        self._request(wire.Vent())

    def disarm(self) -> None:
        """Valves 0 mA, motor braked, activity aborted, state safe; `arm` leads back."""
        self._client.request(wire.Disarm())

    def stop(self) -> None:
        """At once, whatever is under way: valves 0 mA, motor braked, and so it stays.

        The board refuses to arm or to move until an operator clears the stop: `clear_stop`, or
        `thigmo clear`.

        Raises:
            CommandTimeoutError: the board did not confirm it.
        """
        self._client.stop()

    def clear_stop(self) -> bool:
        """Let a stopped robot go, on behalf of the operator who has looked at it.

        No program should call it on its own account. `clear_faults` leaves a stop latched.

        Returns:
            Whether one was latched.

        Raises:
            CommandRefusedError: the robot was stopped once more meanwhile.
        """
        report = self._client.request(wire.GetStatus())
        if not report.faults & wire.Fault.STOPPED.mask:
            return False
        self._client.request(wire.ClearStop(report.stop_nonce))
        return True

    def vent(self) -> None:
        """Empty both muscles and wait until they are empty.

        Raises:
            CommandTimeoutError: they stay under pressure.
        """
        self._request(wire.Vent())
        self._wait_vented()

    def _wait_vented(self) -> None:
        end = self.now() + _VENT_S
        while "vented" not in self.status().conditions:
            if self.now() > end:
                raise CommandTimeoutError(
                    f"a muscle still holds pressure {_VENT_S:.0f} s after venting",
                    "check the exhaust of its transducer",
                )
            self.wait(0.2)

    # Length.

    def confirm_length(self, length_cm: float, *, settled: bool = False) -> None:
        """Vouch for the everted length, as measured on the robot.

        Args:
            length_cm: measured.
            settled: the everted sensors have rested long enough already.

        Raises:
            CommandTimeoutError: a muscle stays under pressure.
        """
        self._wait_vented()
        self._request(wire.ConfirmLength(round(length_cm * 1e4), int(settled)))

    def select_zone(self, zone: int) -> None:
        """Tell the board which body pressure holds (index of robot.toml's body.zones)."""
        self._request(wire.SelectZone(zone))

    def grow_to(self, length_cm: float, watcher: GrowthWatcher | None = None) -> float:
        """Pay out to an everted length and wait for it; returns the length reached, cm.

        Args:
            length_cm: target.
            watcher: given the telemetry meanwhile.

        Raises:
            CommandRefusedError: the length is unknown, or a muscle is under pressure.
            RobotFaultError: the spool stalled.
        """
        with self._telemetry_to(watcher) if watcher else nullcontext():
            self._start(wire.GrowTo(round(length_cm * 1e4), 0))
            return self._watch.finish(wire.Activity.GROWING, self._travel_s()) / 1e4

    def retract_to(self, length_cm: float) -> float:
        """Vent, then wind in to an everted length; returns the length reached, cm.

        A bent body buckles when it is pulled in, so both muscles must be below 0.5 psi.

        Raises:
            CommandRefusedError: the length is unknown, or a muscle is under pressure.
            RobotFaultError: the spool stalled.
        """
        self.vent()
        status = self.status()
        if max(status.left_psi, status.right_psi) >= VENTED_PSI:
            raise CommandRefusedError(
                f"a muscle holds {max(status.left_psi, status.right_psi):.2f} psi",
                f"empty it below {VENTED_PSI} psi first",
                reason=wire.Reason.NOT_VENTED.key,
            )
        self._start(wire.RetractTo(round(length_cm * 1e4), 0))
        return self._watch.finish(wire.Activity.RETRACTING, self._travel_s()) / 1e4

    def home(self) -> None:
        """Vent, then wind in slowly until the spool stalls at the base, twice: length zero.

        After a reset the operator confirms the length, for a jam stalls like the base.

        Raises:
            DataError: the length was unknown, and there is no operator to measure it.
            RobotFaultError: nothing turns, or the encoder does not see it.
        """
        self.vent()
        self._start(wire.Home())
        slowest_cm_s = self.parameter("home_speed_um_s")[0] / 1e4
        self._watch.finish(wire.Activity.HOMING, 2 * self.config.body.length_cm / slowest_cm_s + 10)
        if self.status().length_cm is None:
            self.confirm_length(self.operator.everted_length_cm())

    def _travel_s(self) -> float:
        spool = self.config.spool
        return 3 * (self.config.body.length_cm / spool.max_speed_cm_s) + 10

    # Sensing.

    @property
    def oversample(self) -> int:
        """Conversions that a raw reading sums."""
        return self._oversample

    def wait(self, seconds: float, *, despite_faults: bool = False) -> None:
        """Let time pass, with the link alive.

        Args:
            seconds: so long.
            despite_faults: a fault is what is looked for; do not raise it.

        Raises:
            RobotFaultError: a fault was latched meanwhile.
        """
        if despite_faults:
            self._client.wait_for(lambda: False, seconds)
            self._watch.forget()
        else:
            self._watch.wait(seconds)

    def follow_settling(self) -> None:
        """Watch young sensors from now on, so that sweeps can use those that are set aside."""
        if self._standing is None:
            self._standing = StandingWatch(self.config, self._oversample)
            self._follow(self._standing)

    def young_noise(self) -> Floats:
        """Standard error of what sensors set aside rest at, (10,), 1/cm; infinite if unknown."""
        if self._standing is None:
            return np.full(SENSORS, np.inf)
        at_s = self.status().t_s
        _, sigma = self._standing.rest(at_s, self._aside)
        return np.where(np.isnan(sigma), np.inf, sigma)

    def set_aside(self, mask: int) -> None:
        """Have the board leave everted sensors out, as if they were dead; 0 takes all in again.

        Outputs must be off. Sensors that have not everted stay in use: the board refuses to bend
        the body while one lies in the tip's fold.

        Args:
            mask: of sensors, bit 0 = left base; those not everted are ignored.
        """
        mask &= self.status().everted
        if mask == self._aside:
            return
        healthy = self._table.healthy
        enabled = [int(healthy[n] and not mask >> n & 1) for n in range(SENSORS)]
        self.set_parameter("flex_enabled", enabled)
        self._aside = mask

    @property
    def aside(self) -> int:
        """Mask of the sensors that were set aside."""
        return self._aside

    def wait_settled(
        self,
        progress: Callable[[float], None] = lambda left_s: None,
        sensors: int = (1 << SENSORS) - 1,
    ) -> None:
        """Wait until everted sensors are past their settling time.

        Args:
            progress: told the seconds that are left, about once a second.
            sensors: mask of those to wait for, bit 0 = left base.

        Raises:
            CommandTimeoutError: they do not settle in their time.
            RobotFaultError: a fault was latched meanwhile.
        """
        end = self.now() + self.config.sensors.settle_s + _SETTLE_EXTRA_S
        while waiting := (status := self.status()).everted & ~status.settled & sensors:
            if self.now() > end:
                raise CommandTimeoutError(
                    f"sensors {[n for n in range(SENSORS) if waiting >> n & 1]} do not settle",
                    "check the board's parameter settle_ms",
                )
            reports = [
                self._client.request(wire.GetSensor(sensor))
                for sensor in range(SENSORS)
                if waiting >> sensor & 1
            ]
            left_s = max(report.settle_left_ms for report in reports) / 1e3
            while left_s > 0:
                progress(left_s)
                self.wait(min(left_s, 1.0))
                left_s -= 1.0
            self.wait(0.02)

    def zero(self) -> int:
        """Average the everted sensors' readings into their zeros.

        Returns:
            Mask of the sensors zeroed.

        Raises:
            CommandRefusedError: not vented, not settled, or drifting (`reason`).
        """
        enabled = np.flatnonzero(self._table.healthy)
        mask = self.status().everted & int(sum(1 << int(sensor) for sensor in enabled))
        mask &= ~self._aside
        self._zero_before = self._zero_sum.copy()
        if mask:
            self._start(wire.ZeroSensors(mask))
            self._watch.finish(wire.Activity.ZEROING, 20.0)
        for sensor in range(SENSORS):
            if mask >> sensor & 1:
                report = self._client.request(wire.GetSensor(sensor))
                self._zero_sum[sensor] = report.zero_sum_q8 / 256
        self._decode()
        return mask

    def zeros(self) -> tuple[Floats, Floats]:
        """The zeros before the last zeroing and after it, (10,) each; NaN where there is none.

        In 1/cm, from where `GrowthWatcher.profile` counts.
        """
        before = self._table.unzeroed(self._zero_before, self._oversample)
        return before, self._table.unzeroed(self._zero_sum, self._oversample)

    def flex_circuit(self, sensor: int) -> tuple[bool, bool]:
        """Whether a flex sensor's circuit is open, and whether it is shorted, now."""
        flags = self._client.request(wire.GetSensor(sensor)).flags
        return bool(flags & _OPEN), bool(flags & _SHORT)

    def read(self, seconds: float = 0.5, *, despite_faults: bool = False) -> Reading:
        """Average telemetry over a while.

        Args:
            seconds: so long.
            despite_faults: as for `wait`.

        Raises:
            LinkError: no telemetry came.
        """
        sums, pressures, times, lengths = [], [], [], []
        with self._client.collect(wire.Telemetry) as frames:
            self.wait(seconds, despite_faults=despite_faults)
        for frame in frames:
            sums.append(frame.flex_sum)
            pressures.append((frame.left_cpsi / 100, frame.right_cpsi / 100))
            times.append(self._client.device_s(frame.t_us))
            lengths.append(frame.length_um / 1e4)
        if not sums:
            raise LinkError("no telemetry came", "check the parameter telemetry_ms")
        flex = np.asarray(sums, dtype=np.float64)
        left, right = np.mean(pressures, axis=0)
        return Reading(
            t_s=float(np.mean(times)),
            curvature=self._table.curvature(flex.mean(axis=0), self._zero_sum, self._oversample),
            spread=self._table.curvature(flex, self._zero_sum, self._oversample).std(axis=0),
            left_psi=float(left),
            right_psi=float(right),
            length_cm=lengths[-1],
            frames=len(sums),
            resistance=self._table.resistance(flex.mean(axis=0), self._oversample),
        )

    def record(self, seconds: float) -> Recording:
        """Keep every telemetry frame of a while.

        Raises:
            LinkError: no telemetry came.
        """
        with self._client.collect(wire.Telemetry) as frames:
            self.wait(seconds)
        if not frames:
            raise LinkError("no telemetry came", "check the parameter telemetry_ms")
        flex = np.asarray([frame.flex_sum for frame in frames], dtype=np.float64)
        return Recording(
            t_s=np.array([self._client.device_s(frame.t_us) for frame in frames]),
            resistance=self._table.resistance(flex, self._oversample),
            left_psi=np.array([frame.left_cpsi / 100 for frame in frames]),
            right_psi=np.array([frame.right_cpsi / 100 for frame in frames]),
        )

    def press(
        self, *, left_psi: float = 0.0, right_psi: float = 0.0, ramp_psi_s: float = 0.0
    ) -> None:
        """Hold a muscle pressure (at most one side above zero); returns at once.

        A set point below the transducer's live zero (about 2.2 psi) vents that muscle.

        Args:
            left_psi, right_psi: set points.
            ramp_psi_s: slew rate; 0 = as configured.

        Raises:
            CommandRefusedError: a sensor is half everted, or a set point is above the limit.
        """
        ramp = round(ramp_psi_s * 100)
        self._request(wire.SetPressure(round(left_psi * 100), round(right_psi * 100), ramp))

    def snapshots(self) -> list[SnapshotReading]:
        """The readings captured around the last peak of a sweep, in time order."""
        first = self._client.request(wire.GetSnapshot(0))
        rest = [self._client.request(wire.GetSnapshot(n)) for n in range(1, first.count)]
        return [self._snapshot(reply) for reply in (first, *rest)]

    def _snapshot(self, reply: wire.Snapshot) -> SnapshotReading:
        return snapshot_reading(reply, self._client.device_s(reply.t_us))

    def sweep(
        self,
        *,
        left_psi: float,
        right_psi: float,
        period_s: float,
        cycles: int = 1,
        hold_on_contact: bool = False,
        rising_only: bool = False,
        enough: Callable[[SweepResult], bool] | None = None,
    ) -> SweepResult:
        """Bend to the left, then to the right, along a sine of pressure, and feel.

        Args:
            left_psi, right_psi: amplitudes; a side with 0 is left out.
            period_s: of the whole sine (`sweep_period_s` says how slow it must be).
            cycles: whole periods.
            hold_on_contact: keep the pressure when the trigger fires, until `vent` or `stop`.
            rising_only: vent each side after its peak: what the way back would feel, the way up
                has felt. One cycle.
            enough: with `rising_only`, shown what a side gave so far, about ten times a second once
                its trigger has fired, with its last half second as its peak; true vents it at once.

        Raises:
            CommandRefusedError: a sensor is half everted, the length or the zone is unknown.
            RobotFaultError: the board latched a fault; it is vented.
        """
        if rising_only:
            halves = []
            for left, right in ((left_psi, 0.0), (0.0, right_psi)):
                if max(left, right) > 0:
                    halves.append(
                        self._sweep(left, right, period_s, 1, hold_on_contact, True, enough)
                    )
                    self.vent()
            return SweepResult.joined(halves)
        return self._sweep(left_psi, right_psi, period_s, cycles, hold_on_contact, False, None)

    def _sweep(
        self,
        left_psi: float,
        right_psi: float,
        period_s: float,
        cycles: int,
        hold_on_contact: bool,
        rising: bool,
        enough: Callable[[SweepResult], bool] | None,
    ) -> SweepResult:
        before = self.status()
        options = wire.SweepOption.HOLD_ON_CONTACT.mask if hold_on_contact else 0
        truths: list[Truth] = []
        watcher = SweepWatcher(
            self._client.device_s, lambda side: self._peak_and_truth(side, truths), rising=rising
        )
        with self._telemetry_to(watcher):
            self._start(
                wire.Sweep(
                    round(left_psi * 100),
                    round(right_psi * 100),
                    round(period_s * 1e3),
                    cycles,
                    options,
                )
            )

            def told(so_far: bool = False) -> SweepResult:
                return watcher.result(
                    self._table,
                    self._zero_sum,
                    oversample=self._oversample,
                    sensors=before.everted & before.settled & before.zeroed,
                    length_cm=before.length_cm or 0.0,
                    truth=_joined(truths),
                    young=self._aside,
                    standing=self._standing,
                    so_far=so_far,
                )

            def until() -> bool:
                # A trigger may come before the pressure has risen: there is nothing to judge yet.
                if enough is None or not (watcher.triggers and watcher.frames) or watcher.peaks:
                    return False
                watcher.stopped = enough(told(so_far=True))
                return watcher.stopped

            for event in self._watch.activity(
                wire.Activity.SWEEPING, period_s * cycles + _SWEEP_EXTRA_S, until
            ):
                watcher.event(event)
                if rising and event.code == wire.EventCode.PEAK:
                    self._request(wire.Vent())
                    break
            if watcher.stopped:
                truth = truth_now(self._client.transport.truth(), watcher.frames[-1].side)
                truths += [truth] if truth else []
                self._request(wire.Vent())
        return told()

    def _follow(
        self, watcher: SweepWatcher | GrowthWatcher | StandingWatch
    ) -> Callable[[TelemetryFrame], None]:
        def take(frame: TelemetryFrame) -> None:
            watcher.telemetry(frame.device_us * 1e-6, lambda: frame.message)

        self._client.on_telemetry.append(take)
        return take

    @contextmanager
    def _telemetry_to(self, watcher: SweepWatcher | GrowthWatcher) -> Iterator[None]:
        take = self._follow(watcher)
        try:
            yield
        finally:
            self._client.on_telemetry.remove(take)

    def _peak_and_truth(self, side: Side, truths: list[Truth]) -> list[SnapshotReading]:
        truth = truth_now(self._client.transport.truth(), side)
        if truth is not None:
            truths.append(truth)
        return self.snapshots()


def _joined(truths: list[Truth]) -> Truth | None:
    if not truths:
        return None
    return Truth(truths[0].pegs, [contact for truth in truths for contact in truth.contacts])
