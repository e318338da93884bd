"""The robot as an object: every command of the board in the lab's units, and waiting for its end.

Used by the exploration, the calibration and programs for the robot. A robot is made of parts, each
of which keeps its own state: the link (`link.client`), the supervisor (requests, waiting, faults),
the guard of a fibre, the readings (zeros, sensors that count), and the publisher.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from thigmo.closing import Closing
from thigmo.config import RobotConfig, Side
from thigmo.errors import CommandRefusedError, ConfigError
from thigmo.link import protocol as wire
from thigmo.link.heartbeat import PERIOD_S
from thigmo.link.stored import StoredConfiguration
from thigmo.link.transport import open_transport
from thigmo.operator_prompts import NoOperator, Operator, Patient, Simulated
from thigmo.record import FibreLine, TrueContact, TruePeg, Truth
from thigmo.robot.configuration import get_parameter, send_config, set_parameters
from thigmo.robot.curvature import Floats
from thigmo.robot.fibre import FibreReading
from thigmo.robot.fibre_guard import FibreGuard
from thigmo.robot.idle_pressure import VENTED_PSI
from thigmo.robot.publishing import Publisher
from thigmo.robot.readings import Readings
from thigmo.robot.retraction import Retraction
from thigmo.robot.state import Reading, Recording, RobotStatus, SweepFrame, SweepResult, together
from thigmo.robot.strains import Strains
from thigmo.robot.supervisor import Supervisor
from thigmo.robot.watchers import GrowthWatcher, SweepWatcher, peak_frame
from thigmo.stream import Command, Hello, Message, Server, Telemetry
from thigmo.stream.hub import QUEUE, Hub
from thigmo.version import VERSION
from thigmo.wiring import Wiring

if TYPE_CHECKING:
    from thigmo.link.client import Client, Tap

JOG_CM = 5.0  # of tip that a jog turns the spool for, at most
WITHOUT_BRAKE = "the emergency stop leaves the motor its supply; keep hands away and shut V1"
_STREAM_S = 0.1
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


class Robot(Closing):
    """A connected robot and its commands, as `connect` returns it.

    A context manager: leaving it vents, brakes and closes the link. Every command raises
    CommandRefusedError if the board refuses it (its `reason` is a name of the schema),
    RobotFaultError if a fault is latched, and LinkError if the link fails.

    Attributes:
        url: how it was opened.
        virtual: whether waiting advances an emulator's time instead of the clock's.
        operator: who answers what the board cannot know.
        wiring: where its sensors and muscles hang.
        known_config: the robot.toml that an emulated robot's lab would have; None on hardware.
        link: the conversation with its board.
        supervisor: sends the commands and waits for them.
        readings: its sensors, with their zeros.
        fibre: its fibre, if it has one that is read live.
        publisher: tells viewers of it.
    """

    def __init__(self, client: Client, *, url: str = "", operator: Operator | None = None) -> None:
        self.link = client
        self.url = url
        self.virtual = client.transport.virtual
        transport = client.transport
        self._simulated = transport if isinstance(transport, Simulated) else None
        simulated = self._simulated
        self.operator: Operator = simulated.operator if simulated else operator or NoOperator()
        self.known_config: RobotConfig | None = simulated.config if simulated else None
        self.wiring = Wiring.laid_out(self.known_config or RobotConfig())
        self.fibre = FibreGuard(client, self.config, simulated)
        # A board that lives in this process starts again with the next connection.
        address = "" if self.virtual else url
        self.supervisor = Supervisor(client, self.wiring, self.fibre, address)
        self.readings = Readings(self.supervisor, self.wiring)
        self.publisher = Publisher(client, self.wiring, self.readings.table.board)
        self.supervisor.on_status.append(self.publisher.note_status)
        self.readings.on_zero.append(lambda table: self.publisher.use(self.wiring, table.board))
        self._started_s = client.now()
        self._briefed = False  # the operator, since the connection
        self._warned_muscles: set[str] = set()  # those that no base sensor guards
        self._closed = False
        if isinstance(self.operator, Patient):
            self.operator.meanwhile = self.wait

    # Life.

    def __exit__(self, *error: object) -> None:
        if isinstance(error[1], KeyboardInterrupt):
            self.make_safe(interrupted=True)
        self.close()

    def make_safe(self, *, interrupted: bool = False) -> bool:
        """Valves to 0 mA and motor braked, if the board can still be reached; never raises.

        An interruption by an operator is a `stop`, which waits behind no command and latches; else
        it is a `disarm`. Returns whether the board acknowledged; if not, its own heartbeat limit
        does the same.
        """
        return self.supervisor.make_safe(interrupted=interrupted)

    def close(self) -> None:
        """Make the robot safe and close the link. May be called twice."""
        if isinstance(self.operator, Patient):
            self.operator.meanwhile = None
        if self._closed:
            return
        self._closed = True
        try:
            self.make_safe()
        finally:
            self.link.close()
            self.hub.close()
            self.fibre.close()

    def disarm(self) -> None:
        """Valves 0 mA, motor braked, activity aborted, state safe; `arm` leads back."""
        self.supervisor.disarm()

    def stop(self) -> None:
        """At once, whatever is under way: valves 0 mA, motor braked, and so it stays.

        The board refuses to arm or to move until an operator clears the stop: `clear_stop`, or
        `thigmo clear`. Raises CommandTimeoutError if the board does not confirm it.
        """
        self.link.stop()

    def clear_stop(self) -> bool:
        """End a stop, for an operator who has looked at the robot; whether there was one.

        No program should call it on its own account. `clear_faults` leaves a stop latched. Refused
        if the robot was stopped once more meanwhile.
        """
        return self.supervisor.clear_stop()

    # What is known.

    @property
    def config(self) -> RobotConfig:
        """robot.toml as last sent with `configure`; before, `known_config` or the defaults."""
        return self.wiring.config

    def status(self) -> RobotStatus:
        """Ask the board for its whole state."""
        return self.supervisor.status()

    @property
    def identity(self) -> dict[str, str]:
        """Who the board is, as strings for a record: firmware, board, schema, boot."""
        hello = self.link.hello
        return {
            "board": hello.board.key,
            "firmware": ".".join(str(part) for part in hello.firmware_version),
            "schema_hash": f"{hello.schema_hash:08x}",
            "boot_nonce": f"{hello.boot_nonce:08x}",
            "reset_cause": hello.reset_cause.key,
        }

    def now(self) -> float:
        """The link's clock, s: monotonic on hardware, virtual in the emulator."""
        return self.link.now()

    @property
    def elapsed_s(self) -> float:
        """Time since the connection, on the link's clock."""
        return self.now() - self._started_s

    @property
    def epoch_s(self) -> float:
        """UTC seconds since 1970 at which the link's clock (`now`) was 0."""
        return self.publisher.epoch_s

    def link_stats(self) -> dict[str, int]:
        """Counters of the link as the board sees it, by the schema's names."""
        stats = asdict(self.link.request(wire.GetLinkStats()))
        return {name: count for name, count in stats.items() if name != "status"}

    def scenery(self) -> Any:
        """The emulator's own truth (shapes included), for painting pictures; None on hardware."""
        return self._simulated.truth() if self._simulated else None

    def overhead_pictures(self, sheet: Any, seed: int = 0) -> Any:
        """Pictures of a camera above an emulated robot, and its height (cm); None on hardware.

        They are a `thigmo.camera.PictureSource`; `sheet` is the `Sheet` that lies on the table.
        """
        return self._simulated.overhead_pictures(sheet, seed) if self._simulated else None

    def truth(self, side: Side | Literal[""] = "") -> Truth | None:
        """What the emulated room knows now, of the side that is inflated; None on hardware."""
        scenery = self.scenery()
        if scenery is None:
            return None
        pegs = [
            TruePeg(float(p.x), float(p.y), float(p.radius), number in scenery.gave_way)
            for number, p in enumerate(scenery.pegs)
        ]
        length = float(scenery.length_cm)
        touching = [
            TrueContact(float(c.x), float(c.y), float(c.arc), length, int(c.peg), side)
            for c in scenery.contacts
        ]
        return Truth(pegs, touching)

    # The stream.

    @property
    def hub(self) -> Hub:
        """Where it publishes telemetry, events and shape; an exploration does as well."""
        return self.publisher.hub

    def record_frames(self, tap: Tap) -> None:
        """Call `tap(direction, frame, host time)` with every frame of the link from now on."""
        self.link.taps.append(tap)

    def record_fibre(self, take: Callable[[FibreLine, float], None]) -> None:
        """Call `take(line, host time)` with each line and zeroing of a fibre from now on."""
        self.fibre.on_line.append(lambda line: take(line, self.now()))

    def on_telemetry(self, callback: Callable[[Telemetry], None]) -> Callable[[], None]:
        """Call `callback` with each telemetry frame, decoded, while the link is read.

        It must be quick, and must command nothing. Returns a function that ends it.
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
            channels: names of `thigmo.stream.CHANNELS`; None gives all.
            size: messages that are kept while nobody takes them; then the oldest are lost.
        """
        end = self.now() + seconds
        with self.hub.subscribe(channels, size) as subscription:
            while self.now() < end:
                self.link.poll(min(end - self.now(), _STREAM_S))
                self.supervisor.forget()  # nobody waits for the board's events meanwhile
                # What is done between two messages takes time, and brings new ones.
                while self.now() < end and (message := subscription.get(0.0)) is not None:
                    yield message

    def serve(self, name: str, folder: str, command: Callable[[Command, str], None]) -> Server:
        """Serve the hub to viewers, as a run of a name and with a run folder, if it has one.

        `command` is called with what a viewer asks or answers, in a thread of its own.
        """
        now_s = self.now()
        hello = Hello(
            now_s, self.epoch_s + now_s, self.url, name, folder, os.getpid(), VERSION,
            self.virtual,
        )  # fmt: skip
        return Server(self.hub, hello, command)

    # Waiting and faults.

    def wait(self, seconds: float, *, despite_faults: bool = False) -> None:
        """Let time pass with the link alive; with 0 s, only take what has come.

        With `despite_faults`, a latched fault is no error.
        """
        self.supervisor.wait(seconds, despite_faults=despite_faults)

    def while_waiting(self, callback: Callable[[], None]) -> None:
        """Call `callback` during each wait for the board; an exception in it ends the wait.

        It must command nothing.
        """
        self.supervisor.on_wait.append(callback)

    def raise_faults(self) -> None:
        """Raise a latched fault, if there is one."""
        self.supervisor.raise_faults()

    def clear_faults(self, *names: str) -> tuple[str, ...]:
        """Clear latched faults, named or all, whose cause is gone; names those that remain."""
        return self.supervisor.clear_faults(*names)

    # Arming.

    def arm(self, *, body_air: bool = True) -> None:
        """Leave safe for ready: outputs may be energised from now on, and the body gets its air.

        Without `body_air`, as in bring-up, the body stays empty, if it has an enable. With it,
        somebody must once have seen which way the spool turns (else ConfigError), and the operator
        is warned if the robot has no brake.
        """
        self.raise_faults()
        if body_air and self.config.body.grows and not self.virtual and not self._briefed:
            self._brief()
        try:
            self.supervisor.request(wire.Arm())
        except CommandRefusedError as error:
            if error.reason != "host_silent":
                raise
            # While an operator was asked nothing was heard of the board, and the heartbeat paused.
            self.wait(2.0 * PERIOD_S)
            self.supervisor.request(wire.Arm())
        while self.status().activity == wire.Activity.TESTING.key:  # the brake is being proved
            self.wait(0.1)
        if body_air:
            self.body_air(True)

    def _brief(self) -> None:
        """What an operator must have seen and know before the robot moves by itself."""
        if not self.parameter("direction_seen")[0]:
            raise ConfigError(
                "nobody has confirmed yet which way the spool of this robot turns",
                f"run `thigmo bringup --robot {self.url or 'PORT'} --from motor --to motor`: it "
                "asks once, and the board keeps the answer",
            )
        if not self.parameter("brake_fitted")[0]:
            self.operator.warn(f"no brake is fitted: {WITHOUT_BRAKE}")
        self._briefed = True

    def body_air(self, open_: bool) -> None:
        """Hold the body's air enable, or let it go; only while armed."""
        self.supervisor.request(wire.BodyAir(int(open_)))

    def test_output(self, output: wire.Output, level: int, seconds: float, muscle: int = 0) -> None:
        """Drive one output as it is; the board ends it by itself unless repeated, or at `vent`.

        `level`: of a `muscle`'s transducer 0..400 (5 mA), of the motor -200..200 (a quarter of
        full); `seconds`: at most 0.5. Refused unless armed; the motor's while a muscle holds
        pressure.
        """
        self.supervisor.request(wire.TestOutput(output, muscle, level, round(seconds * 1e3)))

    # Configuration.

    def configure(self, config: RobotConfig) -> bool:
        """Send robot.toml to the board, read it back, and store it there if it changed.

        A flex sensor's fault is cleared with it if the sensor is now marked unhealthy. Returns
        whether the board's configuration changed. Raises ConfigError for a value that the board
        cannot hold, or does not give back; refused while an output is energised.
        """
        wiring = Wiring.laid_out(config)
        changed = send_config(self.link, wiring)
        self.wiring = wiring
        self.fibre.use(config)
        self.supervisor.use(wiring)
        self.readings.use(wiring)
        self.publisher.use(wiring, self.readings.table.board)
        status = self.status()
        if changed or status.config_generation == 0 or "bad_config" in status.faults:
            self.save()
        # What a configuration cures; the board keeps a fault whose cause lasts.
        cured = {"bad_config", *(("flex_open", "flex_short", "pressure_wire") if changed else ())}
        if cured & set(status.faults):
            self.clear_faults(*sorted(cured & set(status.faults)))
        return changed

    @property
    def parameters(self) -> dict[str, wire.Parameter]:
        """The parameters that the board has, by name."""
        return self.link.parameters

    def parameter(self, name: str) -> list[int]:
        """A parameter as the board holds it, in its wire unit; ConfigError if it has none of that
        name.
        """
        return get_parameter(self.link, name)

    def set_parameter(self, name: str, values: list[int]) -> None:
        """Set a parameter in the board's memory, in its wire unit; `save` stores it.

        Raises ConfigError as `configuration.set_parameters`.
        """
        set_parameters(self.link, {name: values})

    def load_defaults(self) -> None:
        """Give the board the schema's defaults, store them, and clear `bad_config`."""
        self.link.request(wire.LoadDefaults())
        self.save()
        self.clear_faults("bad_config")

    def save(self) -> int:
        """Store the configuration in the board; returns its generation. Takes seconds."""
        return self.link.request(wire.SaveConfig()).detail

    def stored_configuration(self) -> StoredConfiguration:
        """How the stored configuration fits the firmware that runs."""
        return StoredConfiguration.of(self.link.request(wire.GetConfigReport()))

    # The everted length.

    def confirm_length(self, length_cm: float, *, settled: bool = False) -> None:
        """State the measured everted length, cm; `settled`: the everted sensors have settled."""
        self.supervisor.wait_vented()
        self.supervisor.request(wire.ConfirmLength(round(length_cm * 1e4), int(settled)))

    def known_length_cm(self) -> float:
        """Everted length, cm; if the board does not know it, it is measured."""
        length_cm = self.status().length_cm
        return self.measure_length() if length_cm is None else length_cm

    def measure_length(self) -> float:
        """Have the operator measure the everted length, cm, and confirm it to the board.

        A body that does not grow has its full one.
        """
        body = self.config.body
        length_cm = self.operator.everted_length_cm() if body.grows else body.length_cm
        self.confirm_length(length_cm, settled=not body.grows)
        return length_cm

    def pressurize(self, body_pressure: int) -> None:
        """Have the operator set a body pressure, if it has air, and tell the board."""
        pressure_psi = self.config.body.pressures[body_pressure].pressure_psi
        if pressure_psi:
            self.operator.set_body_pressure(pressure_psi)
        self.select_body_pressure(body_pressure)

    def select_body_pressure(self, body_pressure: int) -> None:
        """Tell the board which body pressure is set, by its index in robot.toml, from 0."""
        self.supervisor.request(wire.SelectZone(body_pressure))

    def grow_to(self, length_cm: float, watcher: GrowthWatcher | None = None) -> float:
        """Pay out to an everted length and wait for it; returns the length reached, cm.

        Meanwhile the telemetry goes to `watcher`. Refused while the length is unknown or a muscle
        is under pressure.
        """
        supervisor = self.supervisor
        if self.fibre.fitted:
            supervisor.require_fibre()  # takes time, and the telemetry meanwhile is no growth's
        with supervisor.telemetry_to(watcher.telemetry) if watcher else nullcontext():
            supervisor.start(wire.GrowTo(round(length_cm * 1e4), 0))
            return supervisor.finish(wire.Activity.GROWING, self._travel_s()) / 1e4

    def retract_to(self, length_cm: float) -> Retraction:
        """Vent, then wind in to an everted length, cm; returns the length reached and its doubt.

        Refused while the length is unknown, or a muscle is above 0.5 psi, because a bent body
        buckles when it is wound in.
        """
        self.vent()
        status = self.status()
        psi = max(status.pressure_psi, default=0.0)
        if psi >= VENTED_PSI:
            raise CommandRefusedError(
                f"a muscle holds {psi:.2f} psi",
                f"empty it below {VENTED_PSI:g} psi first",
                reason=wire.Reason.NOT_VENTED.key,
            )
        self.supervisor.start(wire.RetractTo(round(length_cm * 1e4), 0))
        reached_cm = self.supervisor.finish(wire.Activity.RETRACTING, self._travel_s()) / 1e4
        return Retraction.of(self.link.request(wire.GetTip()), self.wiring, reached_cm)

    def home(self) -> None:
        """Vent, then wind in slowly until the spool has stalled at the base twice: length zero.

        After a reset the operator must confirm the length, because a jammed spool stalls in the
        same way. Raises DataError if there is no operator.
        """
        self.vent()
        self.supervisor.start(wire.Home())
        slowest_cm_s = self.parameter("home_speed_um_s")[0] / 1e4
        within_s = 2 * self.config.body.length_cm / slowest_cm_s + 10
        self.supervisor.finish(wire.Activity.HOMING, within_s)
        self.known_length_cm()

    def _travel_s(self) -> float:
        spool = self.config.spool
        return 3 * (self.config.body.length_cm / spool.max_speed_cm_s) + 10

    # The sensors.

    @property
    def oversample(self) -> int:
        """Number of conversions that a raw reading sums."""
        return self.readings.table.oversample

    @property
    def aside(self) -> int:
        """Mask of the sensors that `set_aside` made the board leave out."""
        return self.readings.aside

    @property
    def strains(self) -> Strains:
        """Strains of a fibre that is read live."""
        return self.readings.strains

    def follow_settling(self) -> None:
        """Watch how sensors settle after eversion, so that sweeps can use them before they have."""
        self.readings.follow_settling()

    def young_noise(self) -> Floats:
        """Standard error of the zeros of sensors set aside, (inputs,), 1/cm; inf if unknown."""
        return self.readings.young_noise()

    def set_aside(self, mask: int) -> None:
        """Have the board ignore the everted sensors of a mask, as if they were dead; 0: none.

        Outputs must be off. Sensors that have not everted stay in use, because the board refuses to
        bend the body while one lies in the tip's fold.
        """
        self.readings.set_aside(mask)

    def wait_settled(
        self,
        progress: Callable[[float], None] = lambda left_s: None,
        sensors: int = -1,
    ) -> None:
        """Wait until the everted sensors of a mask (default: all) are past their settling time.

        `progress` is called about once a second with the seconds that remain. Raises
        CommandTimeoutError if they do not settle.
        """
        self.readings.wait_settled(progress, sensors)

    def settles_s(self, sensors: int = -1) -> float:
        """Seconds until the everted sensors of a mask have settled; 0 once they have."""
        return self.readings.settles_s(sensors)

    def zero(self, sensors: int = -1) -> int:
        """Average the everted sensors' readings into their zeros; returns these sensors' mask.

        Sensors outside of the mask `sensors` keep their zeros; -1 is all of them. Refused
        unless the muscles are vented, and the sensors settled and free of drift. A fibre's
        strains are zeroed as well, if robot.toml names an interrogator.
        """
        return self.readings.zero(sensors)

    def zeros(self) -> tuple[Floats, Floats]:
        """Zeros before and after the last zeroing, (inputs,) each, 1/cm; NaN where there is none.

        They count from the same reference as `GrowthWatcher.profile`.
        """
        return self.readings.previous_zeros.board.zeros, self.readings.table.board.zeros

    def flex_circuit(self, sensor: int) -> tuple[bool, bool]:
        """Whether a flex sensor's circuit is open, and whether it is shorted, now."""
        return self.readings.circuit(sensor)

    def read(self, seconds: float = 0.5, *, despite_faults: bool = False) -> Reading:
        """Average telemetry over some seconds; `despite_faults` as for `wait`."""
        return self.readings.read(seconds, despite_faults=despite_faults)

    def read_fibre(self, seconds: float = 0.5) -> FibreReading:
        """Average the fibre's strains over some seconds, as curvature since `zero`.

        Raises InterrogatorError, after making the robot safe, if a healthy grating is not read, and
        ConfigError if the robot has no fibre that is read live.
        """
        return self.readings.read_fibre(seconds)

    def record(self, seconds: float) -> Recording:
        """Return every telemetry frame of some seconds."""
        return self.readings.record(seconds)

    # The muscles.

    def press(self, towards: str | float, psi: float, *, ramp_psi_s: float = 0.0) -> None:
        """Hold one muscle under pressure, and the others at none; returns at once.

        `towards` is the muscle's name, or the angle (degrees) towards which it bends the body.
        A set point below the transducer's live zero (about 2.2 psi) vents it. A ramp of 0 means the
        configured rate. Refused while a sensor is half everted. The operator is warned, once, of a
        muscle that no base sensor guards: no contact is felt while it bends the body.
        """
        command = wire.SetPressure(self._cpsi({towards: psi}), round(ramp_psi_s * 100))
        unguarded = self.supervisor.request(command).detail
        name = self.config.muscles[self.config.muscle_number(towards)].name
        if unguarded and name not in self._warned_muscles:
            self._warned_muscles.add(name)
            self.operator.warn(
                f"no base sensor guards muscle {name}: no contact is felt while it bends the body"
            )

    def vent(self, *, wait: bool = True) -> None:
        """Empty the muscles, and wait until they are, by their sensors.

        Do not wait for sensors whose zeros are unknown. Raises CommandTimeoutError if they stay
        under pressure.
        """
        self.supervisor.vent()
        if wait:
            self.supervisor.wait_vented()

    def watch_emptying(self) -> None:
        """After a stop: keep the link alive until the muscles are empty and the body has followed,
        so that it is seen.

        Commands nothing, and ends without a word after the time in which they should have been.
        """
        self.supervisor.watch_emptying()

    def _cpsi(self, tops_psi: Mapping[str | float, float]) -> tuple[int, ...]:
        """Pressures as the board takes them; ConfigError for a muscle that the robot lacks."""
        cpsi = [0] * self.link.capacity.muscles
        for towards, psi in tops_psi.items():
            cpsi[self.config.muscle_number(towards)] = round(psi * 100)
        return tuple(cpsi)

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
            tops_psi: peak pressure of each muscle, by its name or the angle (degrees) towards
                which it bends the body.
            period_s: period of the whole sine (`sweep_period_s` says how slow it must be).
            rising_only: vent each muscle after its peak, because the way back meets no contact
                that the way up did not.
            enough: with `rising_only`, called twenty times a second after the trigger has fired,
                with the readings of this bend so far; the last half second stands in for the peak.
                If it returns true, the muscle is vented at once.

        Refused while a sensor is half everted, or the length or the body pressure is unknown.

        Raises:
            ConfigError: the contact trigger has no sensor that works while a muscle bends the body.
        """
        for muscle in (
            self.config.muscles[self.config.muscle_number(towards)] for towards in tops_psi
        ):
            if muscle in self.wiring.unguarded_muscles:
                raise ConfigError(
                    f"no healthy sensor at the base answers to muscle {muscle.name}: a sweep "
                    "towards it would feel no contact",
                    "repair a base sensor, or correct its `healthy` and `bend_sign` in "
                    "robot.toml; `Robot.press` bends the body without a trigger",
                )
        if not rising_only:
            return self._sweep(tops_psi, period_s)
        parts = []
        for towards, psi in tops_psi.items():
            parts.append(self._sweep({towards: psi}, period_s, rising=True, enough=enough))
            self.vent()
        return SweepResult.joined(parts)

    def _sweep(
        self,
        tops_psi: Mapping[str | float, float],
        period_s: float,
        *,
        rising: bool = False,
        enough: Callable[[SweepResult], bool] | None = None,
    ) -> SweepResult:
        status = self.status()
        sides = self.config.muscle_sides
        watcher = SweepWatcher(
            self.readings.table,
            status.everted & status.settled & status.zeroed,
            status.length_cm or 0.0,
            self.aside,
            self.readings.creep,
            rising,
            sides=sides,
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

        supervisor = self.supervisor
        within_s = period_s + _SWEEP_EXTRA_S
        with supervisor.telemetry_to(watcher.telemetry):
            supervisor.start(wire.Sweep(self._cpsi(tops_psi), round(period_s * 1e3), 1, 0))
            for event in supervisor.events(wire.Activity.SWEEPING, within_s, until):
                if event.code == wire.EventCode.CONTACT:
                    watcher.triggered(event, self.link.device_s(event.t_us))
                elif event.code == wire.EventCode.PEAK:
                    truths.append(self.truth(sides[event.arg]))
                    # Before the next half overwrites them.
                    watcher.peaks.append(self.snapshots())
                    if rising:
                        watcher.end()
                        supervisor.vent()
                        break
            watcher.end()
            if watcher.stopped:
                truths.append(self.truth(watcher.frames[-1].side))
                supervisor.vent()
        return watcher.result(together(truths))

    def snapshots(self) -> list[SweepFrame]:
        """The readings captured around the last peak of a sweep, in time order."""
        first = self.link.request(wire.GetSnapshot(0))
        rest = [self.link.request(wire.GetSnapshot(n)) for n in range(1, first.count)]
        sides = self.config.muscle_sides
        return [peak_frame(shot, self.link.device_s(shot.t_us), sides) for shot in (first, *rest)]
