"""Waiting for the board: events as they come, faults and aborted activities as typed errors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from thigmo.config import SIDES
from thigmo.errors import CommandRefusedError, CommandTimeoutError, RobotFaultError
from thigmo.link import protocol as wire
from thigmo.robot.readings import SENSORS, sensor_name

if TYPE_CHECKING:
    from thigmo.link.client import Client

_SLICE_S = 0.25
_PROMPT_S = 0.1  # where somebody asks meanwhile whether to go on
# Of sensor_report.flags.
_OPEN, _SHORT, _ENABLED = 1 << 3, 1 << 4, 1 << 5
_OF_A_MUSCLE = (
    wire.Fault.OVER_PRESSURE, wire.Fault.PRESSURE_WIRE, wire.Fault.PRESSURE_STUCK,
    wire.Fault.PRESSURE_MISMATCH,
)  # fmt: skip
_OF_A_SENSOR = (wire.Fault.FLEX_OPEN, wire.Fault.FLEX_SHORT)


class Watch:
    """Reads a client's events; a fault among them is raised.

    Its message names the url to clear the fault at; empty where it goes with the connection.
    """

    def __init__(self, client: Client, url: str = "") -> None:
        self._client = client
        self._url = url
        self._channels: dict[wire.Fault, int] = {}
        # Called after each look at the link; what they raise ends the waiting.
        self.interruptions: list[Callable[[], None]] = []

    def _looks(self, seconds: float, each_s: float) -> Iterator[Iterator[wire.Event]]:
        """The events of each look at the link, whenever messages come and `each_s` at the latest.

        Raises RobotFaultError for a fault that the board latched.
        """
        end = self._client.now() + seconds
        while (left := end - self._client.now()) > 0:
            self._client.poll(min(left, each_s))
            for interrupt in self.interruptions:
                interrupt()
            yield self._taken()

    def _taken(self) -> Iterator[wire.Event]:
        while self._client.events:
            self._note_channels()
            event = self._client.events.popleft().message
            if event.code == wire.EventCode.FAULT:
                self._raise_if_latched(wire.Fault(event.arg))
            yield event

    def _note_channels(self) -> None:
        """Remember the channels of faults, which only their events tell."""
        for each in self._client.events:
            if each.message.code == wire.EventCode.FAULT:
                self._channels[wire.Fault(each.message.arg)] = each.message.value

    def _raise_if_latched(self, fault: wire.Fault) -> None:
        """Raise a fault unless it was cleared since its event."""
        latched = wire.Fault.from_mask(self._client.request(wire.GetStatus()).faults)
        if fault in latched:
            others = (other.key for other in latched if other is not fault)
            raise self.fault_error((fault.key, *others))

    def fault_error(self, faults: tuple[str, ...]) -> RobotFaultError:
        """The typed error of latched faults, the first of them in the schema's words.

        A flex sensor is named, and so is a muscle, if the fault's event told which.
        """
        self._note_channels()
        first = wire.Fault[faults[0].upper()]
        what, cure = first.told
        others = f" (and {', '.join(faults[1:])})" if len(faults) > 1 else ""
        channel = self._channels.get(first)
        if first in _OF_A_MUSCLE and channel is not None:
            what += f" ({SIDES[channel]} muscle)"
        if first in _OF_A_SENSOR:
            bad = self._bad_sensors(_OPEN if first is wire.Fault.FLEX_OPEN else _SHORT)
            if channel is not None:
                bad = sorted({*bad, channel})
            if bad:
                what += f": {', '.join(sensor_name(n) for n in bad)} (0 = at the base)"
            else:
                what += " now and then, at present none is"
            cure = cure.replace("in robot.toml", "in robot.toml (healthy = false)")
        if self._url:
            cure = f"{cure} (`thigmo clear --robot {self._url}`)"
        return RobotFaultError(f"{first.key}{others}: {what}", cure, faults=faults)

    def _bad_sensors(self, flag: int) -> list[int]:
        """Enabled sensors whose report has the flag."""
        reports = (self._client.request(wire.GetSensor(n)) for n in range(SENSORS))
        return [r.sensor for r in reports if r.flags & flag and r.flags & _ENABLED]

    def forget(self) -> None:
        """Drop what was received and not asked for, before something new is started.

        A fault among it needs no attention here: the board refuses to start while it is latched.
        """
        self._note_channels()
        self._client.events.clear()

    def wait(self, seconds: float) -> None:
        """Let time pass; raises RobotFaultError if the board latched a fault."""
        for look in self._looks(seconds, _SLICE_S):
            for _ in look:
                pass

    def activity(
        self, activity: wire.Activity, within_s: float, until: Callable[[], bool] | None = None
    ) -> Iterator[wire.Event]:
        """Events of an activity that was started, its last one (done, or zeroed) included.

        Who ends it by `until` has to stop the activity.

        Raises:
            CommandRefusedError: the board ended it early; `reason` says why.
            RobotFaultError: the board latched a fault.
            CommandTimeoutError: it has not ended in time.
        """
        for look in self._looks(within_s, _PROMPT_S if until else _SLICE_S):
            for event in look:
                if event.code == wire.EventCode.ACTIVITY_ABORTED and event.arg == activity:
                    reason = wire.Reason(event.value)
                    what, cure = reason.told
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

    def finish(self, activity: wire.Activity, within_s: float) -> int:
        """Wait for an activity's end; returns the last event's value. Raises as `activity`."""
        value = 0
        for event in self.activity(activity, within_s):
            value = event.value
        return value
