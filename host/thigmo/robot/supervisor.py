"""The board's supervisor and configuration: waiting for events, faults, parameters, arming."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, TypeVar

from thigmo.config import RobotConfig
from thigmo.errors import (
    CommandRefusedError,
    CommandTimeoutError,
    ConfigError,
    InterrogatorError,
    RobotFaultError,
)
from thigmo.link import protocol as wire
from thigmo.link.heart import PERIOD_S
from thigmo.link.interrogator import Interrogator, TcpSource
from thigmo.link.stored import StoredConfiguration
from thigmo.operator_prompts import Operator, Patient
from thigmo.robot.configuration import get_parameter, send_config, set_parameters
from thigmo.robot.curvature import SensorTable
from thigmo.robot.fibre import Fibre
from thigmo.robot.readings import Connected
from thigmo.wiring import muscle_outputs, sensor_name

if TYPE_CHECKING:
    from thigmo.link.client import Client
    from thigmo.link.protocol import Ack, Command

R = TypeVar("R", bound=wire.Message)

_SLICE_S = 0.25
_PROMPT_S = 0.1  # where somebody asks meanwhile whether to go on
_LINES_S = 2.0  # within which an interrogator sends its first lines
_STRAIGHTENS_S = 1.2  # six times the body's usual lag, and more than the time between two shapes
_VENT_S = 15.0  # muscles empty within a second or two; a blocked valve does not
OPEN, SHORT, _ENABLED = 1 << 3, 1 << 4, 1 << 5  # of sensor_report.flags
_OF_A_MUSCLE = (
    wire.Fault.OVER_PRESSURE, wire.Fault.PRESSURE_WIRE, wire.Fault.PRESSURE_STUCK,
    wire.Fault.PRESSURE_MISMATCH,
)  # fmt: skip
# What the value of a fault's event says, where it is not a channel.
_CAUSES = {
    wire.Fault.SPOOL_STALL: wire.StallCause, wire.Fault.SPOOL_SLIP: wire.SlipCause,
    wire.Fault.BAD_CONFIG: wire.ConfigCause, wire.Fault.INTERLOCK: wire.Reason,
}  # fmt: skip
_BEFORE_RESET = -1  # value of the event of a fault that was latched before the last reset
# What a fibre guards, where it is read live; what ends that; and what lays it otherwise.
_GUARDED = (wire.GrowTo, wire.Sweep, wire.SetPressure)
_UNGUARDED = (wire.Vent, wire.RetractTo, wire.Home)
_MOTIONS = (wire.GrowTo, wire.RetractTo, wire.Home, wire.TestOutput)
WITHOUT_BRAKE = "the emergency stop leaves the motor its supply; keep hands away and shut V1"
_BAD_SENSOR = {wire.Fault.FLEX_OPEN: OPEN, wire.Fault.FLEX_SHORT: SHORT}


class Supervised(Connected):
    """A robot that can be configured, armed and vented."""

    def __init__(self, client: Client, *, url: str = "", operator: Operator | None = None) -> None:
        super().__init__(client, url=url, operator=operator)
        if isinstance(self.operator, Patient):
            self.operator.meanwhile = self.wait

    def close(self) -> None:
        """Make the robot safe and close the link. May be called twice."""
        if isinstance(self.operator, Patient):
            self.operator.meanwhile = None
        super().close()

    # Waiting.

    def wait(self, seconds: float, *, despite_faults: bool = False) -> None:
        """Let time pass with the link alive; with `despite_faults`, a latched fault is no error."""
        if despite_faults:
            self._client.wait_for(lambda: False, seconds)
            self._forget()
            return
        for look in self._looks(seconds, _SLICE_S):
            for _ in look:
                pass

    def _looks(self, seconds: float, each_s: float) -> Iterator[Iterator[wire.Event]]:
        """Events of each look at the link, whenever messages come and `each_s` at the latest."""
        end = self.now() + seconds
        while (left := end - self.now()) > 0:
            self._client.poll(min(left, each_s))
            if self._guarded:
                self._require_fibre()
            for interrupt in self._interruptions:
                interrupt()
            yield self._taken()

    def _taken(self) -> Iterator[wire.Event]:
        while self._client.events:
            self._note_channels()
            event = self._client.events.popleft().message
            if event.code == wire.EventCode.FAULT:
                faults, fault = self.status().faults, wire.Fault(event.arg).key
                if fault in faults:  # it was not cleared since
                    raise self._fault_error(sorted(faults, key=lambda other: other != fault))
            yield event

    def _request(self, command: Command[R]) -> R:
        """Send a command; a refusal because of a latched fault raises that fault's error.

        If a live fibre guards this kind of motion, it is refused unless the fibre is read.
        """
        if isinstance(command, _MOTIONS) and self._fibre is not None:
            self._fibre.void()
        self._guarded = (isinstance(command, _GUARDED) and self._has_fibre) or (
            self._guarded and not isinstance(command, _UNGUARDED)
        )
        if self._guarded:
            self._require_fibre()
        try:
            return self._client.request(command)
        except CommandRefusedError as error:
            latched = error.reason == wire.Reason.FAULT_LATCHED.key
            if latched and (faults := self.status().faults):
                raise self._fault_error(faults) from error
            raise

    def _start(self, command: Command[Ack]) -> None:
        """Start an activity; its events are then waited for."""
        self._forget()
        self._request(command)

    def _events(
        self, activity: wire.Activity, within_s: float, until: Callable[[], bool] | None = None
    ) -> Iterator[wire.Event]:
        """Events of an activity that was started, including its last one (done, or zeroed).

        If `until` ends the wait, the caller must stop the activity. Raises CommandRefusedError if
        the board ends it early, CommandTimeoutError if it has not ended in time.
        """
        for look in self._looks(within_s, _PROMPT_S if until else _SLICE_S):
            for event in look:
                if event.code == wire.EventCode.ACTIVITY_ABORTED and event.arg == activity:
                    reason = wire.Reason(event.value)
                    what, cure = reason.words
                    raise CommandRefusedError(
                        f"{activity.key} ended early: {what}", cure, reason=reason.key
                    )
                yield event
                if event.code == wire.EventCode.ACTIVITY_DONE and event.arg == activity:
                    return
                if event.code == wire.EventCode.ZEROED and activity == wire.Activity.ZEROING:
                    return
            if until is not None and until():
                return
        raise CommandTimeoutError(
            f"{activity.key} has not ended within {within_s:.0f} s",
            "check the robot, then stop it and start again",
        )

    def _finish(self, activity: wire.Activity, within_s: float) -> int:
        """Wait for an activity's end; returns the last event's value."""
        return [event.value for event in self._events(activity, within_s)][-1]

    # The fibre.

    @property
    def _has_fibre(self) -> bool:
        return bool(self.config.gratings) and self.config.interrogator is not None

    def _require_fibre(self) -> Fibre:
        """The fibre, opened, with all its strains of now.

        Raises InterrogatorError if they are not, with the robot made safe: valves at 0 mA, motor
        braked. ConfigError for a robot without a fibre that is read live.
        """
        try:
            if self._fibre is None:
                self._fibre = self._opened_fibre()
            self._fibre.require()
        except InterrogatorError as error:
            if not self.make_safe():
                error.add_note("the board does NOT confirm that it is safe")
            raise
        return self._fibre

    def _opened_fibre(self) -> Fibre:
        address, count = self.config.interrogator, len(self.config.gratings)
        if address is None or not count:
            raise ConfigError(
                "the robot has no fibre that is read live",
                'give `interrogator = "host:port"` and its gratings in robot.toml',
            )
        source = self._room.interrogator() if self._room else TcpSource(address)
        interrogator = Interrogator(source, count, self.now)
        self._client.wait_for(lambda: interrogator.heard, _LINES_S)
        fibre = Fibre(self.config, interrogator, self._take_strains)
        # Its lines are read before the frame that comes after them is kept and handed on.
        self._client.taps.insert(0, fibre.tap)
        self._client.on_telemetry.insert(0, fibre.telemetry)
        return fibre

    # Faults.

    def _fault_error(self, faults: Sequence[str]) -> RobotFaultError:
        """The typed error of latched faults, the first of them in the schema's words.

        A fault of a channel names it, as far as it is known: a flex sensor by its report, a muscle
        by the channel that the fault's event names.
        """
        self._note_channels()
        first = wire.Fault[faults[0].upper()]
        what, cure = first.words
        others = f" (and {', '.join(faults[1:])})" if len(faults) > 1 else ""
        channel = self._fault_channels.get(first)
        if channel == _BEFORE_RESET:
            what, channel = f"{what} (before the board's last reset)", None
        if first in _OF_A_MUSCLE and channel is not None:
            what += f" ({muscle_outputs(self.config).get(channel, channel)} muscle)"
        if first in _CAUSES and channel is not None:
            what += f" ({_CAUSES[first](channel).words[0]})"
        if first in _BAD_SENSOR:
            flags = _BAD_SENSOR[first] | _ENABLED
            sensors = range(self._client.capacity.sensors)
            reports = (self._client.request(wire.GetSensor(n)) for n in sensors)
            bad = {report.sensor for report in reports if report.flags & flags == flags}
            if channel is not None:
                bad.add(channel)
            if bad:
                names = ", ".join(sensor_name(self.config, n) for n in sorted(bad))
                what += f": {names} (0 = at the base)"
            else:
                what += " now and then, at present none is"
            cure = cure.replace("in robot.toml", "in robot.toml (healthy = false)")
            if any(sensor.kind == "heading" for sensor in self.config.sensors):
                what = what.replace("A flex sensor's circuit is open", "An IMU does not answer")
                cure = cure.replace("its wire", "the IMUs at both its ends, and their bus")
        if first is wire.Fault.SPOOL_SLIP and (hint := _too_strong(self.config)):
            cure = f"{hint}; {cure}"
        # A board that lives in this process starts again with the next connection.
        if self.url and not self.virtual:
            cure = f"{cure} (`thigmo clear --robot {self.url}`)"
        return RobotFaultError(f"{first.key}{others}: {what}", cure, faults=tuple(faults))

    def clear_faults(self, *names: str) -> tuple[str, ...]:
        """Clear latched faults, named or all, whose cause is gone; names those that remain."""
        known = [wire.Fault[name.upper()] for name in names] or list(wire.Fault)
        mask = sum(fault.mask for fault in known)
        remaining = self._client.request(wire.ClearFaults(mask)).detail
        return tuple(fault.key for fault in wire.Fault.from_mask(remaining))

    def raise_faults(self) -> None:
        """Raise a latched fault, if there is one."""
        if faults := self.status().faults:
            raise self._fault_error(faults)

    # Arming.

    def arm(self, *, body_air: bool = True) -> None:
        """Leave safe for ready: outputs may be energised from now on, and the body gets its air.

        Without `body_air`, as in bring-up, the body stays empty, if it has an enable. With it,
        somebody must once have seen which way the spool turns (else ConfigError), and the operator
        is warned if the robot has no brake.
        """
        self.raise_faults()
        if body_air and not self.virtual and not self._briefed:
            self._brief()
        try:
            self._request(wire.Arm())
        except CommandRefusedError as error:
            if error.reason != "host_silent":
                raise
            # While an operator was asked nothing was heard of the board, and the heart held still.
            self.wait(2.0 * PERIOD_S)
            self._request(wire.Arm())
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
        self._request(wire.BodyAir(int(open_)))

    def test_output(self, output: wire.Output, level: int, seconds: float, muscle: int = 0) -> None:
        """Drive one output as it is; the board ends it by itself unless repeated, or at `vent`.

        `level`: of a `muscle`'s transducer 0..400 (5 mA), of the motor -200..200 (a quarter of
        full); `seconds`: at most 0.5. Refused unless armed; the motor's while a muscle holds
        pressure.
        """
        self._request(wire.TestOutput(output, muscle, level, round(seconds * 1e3)))

    def vent(self, *, wait: bool = True) -> None:
        """Empty the muscles, and wait until they are, by their sensors.

        Do not wait for sensors whose zeros are unknown. Raises CommandTimeoutError if they stay
        under pressure.
        """
        self._request(wire.Vent())
        if wait:
            self._wait_vented()

    def watch_emptying(self) -> None:
        """After a stop: keep the link alive until the muscles are empty and the body has followed,
        so that it is seen.

        Commands nothing, and ends without a word after the time in which they should have been.
        """
        end = self.now() + _VENT_S
        while "vented" not in self.status().conditions and self.now() < end:
            self.wait(0.2, despite_faults=True)
        self.wait(_STRAIGHTENS_S, despite_faults=True)

    def _wait_vented(self) -> None:
        end = self.now() + _VENT_S
        while "vented" not in self.status().conditions:
            if self.now() > end:
                raise CommandTimeoutError(
                    f"a muscle still holds pressure {_VENT_S:.0f} s after venting",
                    "check the exhaust of its transducer; if it is empty, its sensor's zero: "
                    "`thigmo bringup --robot PORT --from pressure`",
                )
            self.wait(0.2)

    # Configuration.

    def configure(self, config: RobotConfig) -> bool:
        """Send robot.toml to the board, read it back, and store it there if it changed.

        A flex sensor's fault is cleared with it if the sensor is now marked unhealthy. Returns
        whether the board's configuration changed. Raises ConfigError for a value that the board
        cannot hold, or does not give back; refused while an output is energised.
        """
        changed = send_config(self._client, config)
        self.config = config
        self._close_fibre()
        self._table = SensorTable.of(config, 1 << self.parameter("oversample_log2")[0])
        self.aside = 0
        self._publisher.use(config, self._table.board)
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
        return self._client.parameters

    def parameter(self, name: str) -> list[int]:
        """A parameter as the board holds it, in its wire unit; ConfigError if it has none of that
        name.
        """
        return get_parameter(self._client, name)

    def set_parameter(self, name: str, values: list[int]) -> None:
        """Set a parameter in the board's memory, in its wire unit; `save` stores it.

        Raises ConfigError as `configuration.set_parameters`.
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


def _too_strong(config: RobotConfig | None) -> str:
    """What to do if a body pressure pulls harder than the spool's friction holds; else nothing."""
    if config is None or config.spool.brake:
        return ""
    highest = max(zone.pressure_psi for zone in config.body.zones)
    pull, holds = config.body.pull_n(highest), config.spool.holding_n
    if pull <= holds:
        return ""
    return (
        f"{highest:g} psi pull {pull:.1f} N at the spool and its friction holds {holds:g} N: fit a "
        "brake or lower [[body.pressure]] (`thigmo robot check`)"
    )
