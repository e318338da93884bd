"""The everted length: vouched for, grown, wound in, homed."""

from __future__ import annotations

from contextlib import nullcontext

from thigmo.errors import CommandRefusedError
from thigmo.link import protocol as wire
from thigmo.robot.growing import GrowthWatcher
from thigmo.robot.supervised import Supervised

VENTED_PSI = 0.5


class Everting(Supervised):
    """A robot that grows and is wound in."""

    def confirm_length(self, length_cm: float, *, settled: bool = False) -> None:
        """Vouch for the everted length, as measured on the robot.

        `settled`: the everted sensors have rested long enough already.

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

        A watcher is given the telemetry meanwhile.

        Raises:
            CommandRefusedError: the length is unknown, or a muscle is under pressure.
            RobotFaultError: the spool stalled.
        """
        with self._telemetry_to(watcher.telemetry) if watcher else nullcontext():
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
        psi = max(status.left_psi, status.right_psi)
        if psi >= VENTED_PSI:
            raise CommandRefusedError(
                f"a muscle holds {psi:.2f} psi",
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
