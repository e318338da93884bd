"""An emulated robot on a port in real time, which outlives its hosts.

Limits are told in the robot's own time. Where the computer is busy, that time slips against the
wall clock, and a promise such as "off within half a second" can still be checked exactly.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from thigmo.emulator.lockstep import Lockstep
from thigmo.emulator.plant import STEP_S
from thigmo.emulator.serve import PtyServer
from thigmo.link.heart import PERIOD_S

EVER_S = 120.0  # of real time: what has not come by then never will


def comes(condition: Callable[[], bool], seconds: float = EVER_S) -> bool:
    """Wait in real time for a condition; whether it came."""
    never = threading.Event()
    until = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > until:
            return False
        never.wait(0.005)
    return True


class _PatientServer(PtyServer):
    """Lets the robot's time stand still rather than let a host fall silent that this computer
    keeps from running.

    Attributes:
        patient: whether it does; not for a host that was ended.
        slow_s: of real time, to add to each step: what then takes long is the robot's, and not this
            computer's.
    """

    patient = True
    slow_s = 0.0
    _heard_s: float | None = None  # by the robot's clock, since the port was opened

    def _exchange(self) -> None:
        if not self._opened:
            self._heard_s = None
        elif self._heard_s is not None and self.lockstep.t_s - self._heard_s > 2 * PERIOD_S:
            until = time.monotonic() + EVER_S
            while self.patient and not self._poll.poll(20) and time.monotonic() < until:
                pass
        if self.slow_s:
            time.sleep(self.slow_s)
        super()._exchange()

    def _take(self) -> bytes:
        data = super()._take()
        if data:
            self._heard_s = self.lockstep.t_s
        return data


class ServedRobot:
    """A robot served by a thread.

    Args:
        lockstep: board and body.
        reset_on_open: as opening a port with DTR does.

    Attributes:
        port: to be opened.
    """

    def __init__(self, lockstep: Lockstep, *, reset_on_open: bool = True) -> None:
        self.lockstep = lockstep
        self.board = lockstep.board
        self.plant = lockstep.plant
        self._server = _PatientServer(lockstep, reset_on_open=reset_on_open)
        self.port = self._server.path
        self._on = True
        self._live_until_s = 0.0
        self._thread = threading.Thread(target=lambda: self._server.run(self._keep_on))
        self._thread.start()

    def _keep_on(self) -> bool:
        """Asked before each step."""
        if not self.off:
            self._live_until_s = self.lockstep.t_s
        return self._on

    @property
    def energised(self) -> bool:
        """Whether a valve is driven."""
        return any(self.board.drive_enabled)

    @property
    def off(self) -> bool:
        """Whether no valve is driven and the motor is braked."""
        return not self.energised and self.board.motor == 0 and self.board.braked

    def alone(self) -> None:
        """From now on its hosts may fall silent."""
        self._server.patient = False

    def slow_motion(self) -> None:
        """From now on its time runs at a fifth of the clock's pace."""
        self._server.slow_s = 4 * STEP_S

    def off_within(self, seconds: float) -> bool:
        """Wait until it is off; whether it was within so many seconds of its own time."""
        since = self.lockstep.t_s
        self.alone()
        return comes(lambda: self.off) and self._live_until_s - since <= seconds + 2 * STEP_S

    def close(self) -> None:
        """Pull the cable: the port is gone, and time stands still for the robot."""
        self.alone()
        self._on = False
        self._thread.join()
        self._server.close()
