"""The robot as an object: every command of the board in the lab's units, and waiting for its end.

Used by the exploration, the calibration and whoever writes a program for the robot. A fault that
the board latches while something is waited for is raised as `RobotFaultError` with the schema's
sentence. Each concern has its file, and builds on the one before: `connected` (link, stream,
state), `supervised` (configuration, faults, arming), `everting` (length), `sensing`, and sweeps
here.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack

from thigmo.config import SIDES, RobotConfig
from thigmo.link import protocol as wire
from thigmo.link.transport import open_transport
from thigmo.record import Truth
from thigmo.robot.operator import Operator
from thigmo.robot.sensing import Sensing
from thigmo.robot.state import SweepResult, together
from thigmo.robot.sweeping import SweepWatcher

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

    with ExitStack() as undo:
        transport = open_transport(url, seed=seed, realtime=realtime)
        undo.callback(transport.close)
        robot = Robot(Client(transport), url=url, operator=operator)
        if config is not None:
            undo.callback(robot.close)
            robot.configure(config)
        undo.pop_all()
    return robot


class Robot(Sensing):
    """A connected robot, with all that it can be told to do; what `connect` returns."""

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
            enough: with `rising_only`, shown what a side gave so far, twenty times a second once
                its trigger has fired, with its last half second as its peak; true vents it at once.

        Raises:
            CommandRefusedError: a sensor is half everted, the length or the zone is unknown.
            RobotFaultError: the board latched a fault; it is vented.
        """
        halves = ((left_psi, 0.0), (0.0, right_psi)) if rising_only else ((left_psi, right_psi),)
        found = []
        for half in halves:
            if not rising_only:
                found.append(self._sweep(half, period_s, cycles, hold_on_contact))
            elif max(half) > 0:
                found.append(self._sweep(half, period_s, 1, hold_on_contact, True, enough))
                self.vent()
        return SweepResult.joined(found)

    def _sweep(
        self,
        amplitudes_psi: tuple[float, float],
        period_s: float,
        cycles: int,
        hold_on_contact: bool,
        rising: bool = False,
        enough: Callable[[SweepResult], bool] | None = None,
    ) -> SweepResult:
        before = self.status()
        options = wire.SweepOption.HOLD_ON_CONTACT.mask if hold_on_contact else 0
        left_cpsi, right_cpsi = (round(psi * 100) for psi in amplitudes_psi)
        command = wire.Sweep(left_cpsi, right_cpsi, round(period_s * 1e3), cycles, options)
        usable = before.everted & before.settled & before.zeroed
        watcher = SweepWatcher(
            self._table,
            usable,
            before.length_cm or 0.0,
            self._aside,
            self._standing,
            rising,
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

        within_s = period_s * cycles + _SWEEP_EXTRA_S
        with self._telemetry_to(watcher.telemetry):
            self._start(command)
            for event in self._watch.activity(wire.Activity.SWEEPING, within_s, until):
                if event.code == wire.EventCode.CONTACT:
                    watcher.triggered(event, self._client.device_s(event.t_us))
                elif event.code == wire.EventCode.PEAK:
                    truths.append(self.truth(SIDES[event.arg]))
                    # Before the next half overwrites them.
                    watcher.peaks.append(self.snapshots())
                    if rising:
                        self._request(wire.Vent())
                        break
            if watcher.stopped:
                truths.append(self.truth(watcher.frames[-1].side))
                self._request(wire.Vent())
        return watcher.result(together(truths))
