"""Commands the board: sends requests, waits for activities, and raises its faults as typed errors.

Every wait reads the link. With the emulator this advances time; on hardware the heartbeat runs
beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeVar

from thigmo.config import RobotConfig
from thigmo.errors import (
    CommandRefusedError,
    CommandTimeoutError,
    InterrogatorError,
    LinkError,
    RobotFaultError,
)
from thigmo.link import protocol as wire
from thigmo.robot.fibre import Fibre
from thigmo.robot.fibre_guard import FibreGuard
from thigmo.robot.state import RobotStatus, pressures_psi
from thigmo.wiring import Wiring

if TYPE_CHECKING:
    from thigmo.link.client import Client
    from thigmo.link.inbox import TelemetryFrame
    from thigmo.link.protocol import Ack, Command

R = TypeVar("R", bound=wire.Message)

_SLICE_S = 0.25
_PROMPT_S = 0.1  # where somebody asks meanwhile whether to go on
_STRAIGHTENS_S = 1.2  # six times the body's usual lag, and more than the time between two shapes
_VENT_S = 15.0  # muscles empty within a second or two; a blocked valve does not
_UNKNOWN_ZONE = 255
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
_BAD_SENSOR = {wire.Fault.FLEX_OPEN: OPEN, wire.Fault.FLEX_SHORT: SHORT}


class Supervisor:
    """Commands a board and waits for it.

    Attributes:
        on_wait: called during each wait for the board; an exception ends the wait. It must
            not command the board.
        on_status: called with each state that the board reports on request.
    """

    def __init__(self, link: Client, wiring: Wiring, fibre: FibreGuard, address: str = "") -> None:
        self.link = link
        self.fibre = fibre
        self.on_wait: list[Callable[[], None]] = []
        self.on_status: list[Callable[[RobotStatus], None]] = []
        self._wiring = wiring
        self._address = address  # at which an operator clears faults; empty if there is none
        self._fault_channels: dict[wire.Fault, int] = {}  # which only their events tell

    def use(self, wiring: Wiring) -> None:
        """Take the names of muscles and sensors from this robot, from now on."""
        self._wiring = wiring

    def status(self) -> RobotStatus:
        """Ask the board for its whole state."""
        report = self.link.request(wire.GetStatus())
        conditions = frozenset(c.key for c in wire.Condition.from_mask(report.conditions))
        status = RobotStatus(
            state=report.state.key,
            activity=report.activity.key,
            body_pressure=None if report.zone == _UNKNOWN_ZONE else report.zone,
            faults=tuple(fault.key for fault in wire.Fault.from_mask(report.faults)),
            conditions=conditions,
            t_s=self.link.device_s(report.t_us),
            length_cm=report.length_um / 1e4 if "length_known" in conditions else None,
            pressure_psi=pressures_psi(report.pressure_cpsi, self._wiring),
            everted=report.everted_mask,
            settled=report.settled_mask,
            zeroed=report.zeroed_mask,
            config_generation=report.config_generation,
            supply_v=report.supply_mv / 1e3,
            encoder_errors=report.encoder_errors,
        )
        for callback in self.on_status:
            callback(status)
        return status

    # Outputs off.

    def make_safe(self, *, interrupted: bool = False) -> bool:
        """As `Robot.make_safe`."""
        try:
            (self.link.stop if interrupted else self.disarm)()
        except LinkError:
            return False
        return True

    def disarm(self) -> None:
        """Valves 0 mA, motor braked, activity aborted, state safe."""
        self.fibre.guarding = False
        self.link.request(wire.Disarm())

    def clear_stop(self) -> bool:
        """End a latched stop. Returns whether there was one."""
        report = self.link.request(wire.GetStatus())
        if not report.faults & wire.Fault.STOPPED.mask:
            return False
        self.link.request(wire.ClearStop(report.stop_nonce))
        return True

    def vent(self) -> None:
        """Begin to empty the muscles, without waiting until they are empty."""
        self.request(wire.Vent())

    def wait_vented(self) -> None:
        """Wait until the muscles are empty, by their sensors; CommandTimeoutError if they stay."""
        end = self.link.now() + _VENT_S
        while "vented" not in self.status().conditions:
            if self.link.now() > end:
                raise CommandTimeoutError(
                    f"a muscle still holds pressure {_VENT_S:.0f} s after venting",
                    "check the exhaust of its transducer; if it is empty, its sensor's zero: "
                    "`thigmo bringup --robot PORT --from pressure`",
                )
            self.wait(0.2)

    def watch_emptying(self) -> None:
        """As `Robot.watch_emptying`."""
        end = self.link.now() + _VENT_S
        while "vented" not in self.status().conditions and self.link.now() < end:
            self.wait(0.2, despite_faults=True)
        self.wait(_STRAIGHTENS_S, despite_faults=True)

    # Waiting.

    def wait(self, seconds: float, *, despite_faults: bool = False) -> None:
        """Wait with the link alive. With `despite_faults`, a latched fault is no error."""
        if despite_faults:
            self.link.wait_for(lambda: False, seconds)
            self.forget()
            return
        for look in self._looks(seconds, _SLICE_S):
            for _ in look:
                pass

    @contextmanager
    def telemetry_to(self, take: Callable[[TelemetryFrame], None]) -> Iterator[None]:
        """Pass the telemetry that arrives during a `with` block to a function."""
        self.link.on_telemetry.append(take)
        try:
            yield
        finally:
            self.link.on_telemetry.remove(take)

    def _looks(self, seconds: float, each_s: float) -> Iterator[Iterator[wire.Event]]:
        """Yield the events received so far, once and then at every message or every `each_s`."""
        end = self.link.now() + seconds
        left = seconds
        while True:
            self.link.poll(min(max(left, 0.0), each_s))
            if self.fibre.guarding:
                self.require_fibre()
            for callback in self.on_wait:
                callback()
            yield self._taken()
            left = end - self.link.now()
            if left <= 0.0:
                return

    def _taken(self) -> Iterator[wire.Event]:
        while self.link.events:
            self._note_channels()
            event = self.link.events.popleft().message
            if event.code == wire.EventCode.FAULT:
                faults, fault = self.status().faults, wire.Fault(event.arg).key
                if fault in faults:  # it was not cleared since
                    raise self.fault_error(sorted(faults, key=lambda name: name != fault))
            yield event

    def _note_channels(self) -> None:
        for received in self.link.events:
            event = received.message
            if event.code == wire.EventCode.FAULT:
                self._fault_channels[wire.Fault(event.arg)] = event.value

    def forget(self) -> None:
        """Drop messages that nobody waits for, before something new is started.

        A fault among them needs no attention here: while it is latched the board refuses to start.
        """
        self._note_channels()
        self.link.events.clear()

    # Commands.

    def request(self, command: Command[R]) -> R:
        """Send a command. If a latched fault makes the board refuse it, raise that fault's error.

        If a live fibre guards this kind of motion, it is refused unless the fibre is read.
        """
        self.fibre.before(command)
        if self.fibre.guarding:
            self.require_fibre()
        try:
            return self.link.request(command)
        except CommandRefusedError as error:
            latched = error.reason == wire.Reason.FAULT_LATCHED.key
            if latched and (faults := self.status().faults):
                raise self.fault_error(faults) from error
            raise

    def require_fibre(self) -> Fibre:
        """As `FibreGuard.require`. If the strains are out of date, the robot is made safe first."""
        try:
            return self.fibre.require()
        except InterrogatorError as error:
            if not self.make_safe():
                error.add_note("the board does NOT confirm that it is safe")
            raise

    def start(self, command: Command[Ack]) -> None:
        """Start an activity. Then wait for it with `events` or `finish`."""
        self.forget()
        self.request(command)

    def events(
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
                    problem, cure = reason.words
                    raise CommandRefusedError(
                        f"{activity.key} ended early: {problem}", cure, reason=reason.key
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

    def finish(self, activity: wire.Activity, within_s: float) -> int:
        """Wait for an activity's end; returns the last event's value."""
        return [event.value for event in self.events(activity, within_s)][-1]

    # Faults.

    def raise_faults(self) -> None:
        """Raise a latched fault, if there is one."""
        if faults := self.status().faults:
            raise self.fault_error(faults)

    def clear_faults(self, *names: str) -> tuple[str, ...]:
        """Clear latched faults, named or all, whose cause is gone. Returns those that remain."""
        known = [wire.Fault[name.upper()] for name in names] or list(wire.Fault)
        mask = sum(fault.mask for fault in known)
        remaining = self.link.request(wire.ClearFaults(mask)).detail
        return tuple(fault.key for fault in wire.Fault.from_mask(remaining))

    def fault_error(self, faults: Sequence[str]) -> RobotFaultError:
        """The typed error of latched faults; its text is the schema's for the first of them.

        It names the sensor or muscle at fault if that is known: a flex sensor by the board's report
        of sensors, a muscle by the channel in the fault's event.
        """
        self._note_channels()
        first = wire.Fault[faults[0].upper()]
        problem, cure = first.words
        further = f" (and {', '.join(faults[1:])})" if len(faults) > 1 else ""
        channel = self._fault_channels.get(first)
        if channel == _BEFORE_RESET:
            problem, channel = f"{problem} (before the board's last reset)", None
        if first in _OF_A_MUSCLE and channel is not None:
            problem += f" ({self._wiring.muscle_name(channel)} muscle)"
        if first in _CAUSES and channel is not None:
            problem += f" ({_CAUSES[first](channel).words[0]})"
        if first in _BAD_SENSOR:
            names = self._bad_sensors(_BAD_SENSOR[first], channel)
            problem += (
                f": {names} (0 = at the base)" if names else " now and then, at present none is"
            )
            cure = cure.replace("in robot.toml", "in robot.toml (healthy = false)")
            sensors = self._wiring.config.sensors
            fault_words = dict(pair for sensor in sensors for pair in sensor.fault_words.items())
            for words, other_words in fault_words.items():
                problem = problem.replace(words, other_words)
                cure = cure.replace(words, other_words)
        if first is wire.Fault.SPOOL_SLIP and (hint := _too_strong(self._wiring.config)):
            cure = f"{hint}; {cure}"
        if self._address:
            cure = f"{cure} (`thigmo clear --robot {self._address}`)"
        return RobotFaultError(f"{first.key}{further}: {problem}", cure, faults=tuple(faults))

    def _bad_sensors(self, flag: int, channel: int | None) -> str:
        """Names of the enabled sensors with a flag set, and of the one that an event named."""
        flags = flag | _ENABLED
        numbers = range(self.link.capacity.sensors)
        reports = (self.link.request(wire.GetSensor(number)) for number in numbers)
        bad = {report.sensor for report in reports if report.flags & flags == flags}
        if channel is not None:
            bad.add(channel)
        return ", ".join(self._wiring.sensor_name(number) for number in sorted(bad))


def _too_strong(config: RobotConfig) -> str:
    """What to do if a body pressure pulls harder than the spool's friction holds; else empty."""
    if config.spool.brake:
        return ""
    highest = max(pressure.pressure_psi for pressure in config.body.pressures)
    pull, holds = config.body.pull_n(highest), config.spool.holding_n
    if pull <= holds:
        return ""
    return (
        f"{highest:g} psi pull {pull:.1f} N at the spool and its friction holds {holds:g} N: fit a "
        "brake or lower [[body.pressure]] (`thigmo robot check`)"
    )
