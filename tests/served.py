"""An emulated robot on a port in real time, which outlives its hosts.

Limits are in the robot's own time. Where the computer is busy, that time slips against the
wall clock, and a promise such as "off within half a second" can still be checked exactly.
"""

from __future__ import annotations

import select
import threading
import time
from collections.abc import Callable

from emulated import armed, scene_at
from port_holder import PortHolder

from thigmo.emulator import serve
from thigmo.emulator.lockstep import Lockstep
from thigmo.emulator.plant import STEP_S
from thigmo.link.framing import Decoder
from thigmo.link.heartbeat import PERIOD_S
from thigmo.link.protocol import Heartbeat, Stop

# A host that arms the robot on the port that it is given, sweeps and says so; and one that then
# stays.
SWEEP = """
import ctypes, sys
from thigmo.link import protocol as wire
from thigmo.link.client import Client
from thigmo.link.transport import open_transport
client = Client(open_transport(sys.argv[1]))
while not client.request(wire.GetStatus()).conditions & wire.Condition.HOST_ALIVE.mask:
    client.poll(0.01)
client.request(wire.Arm())
client.request(wire.Sweep((1200, 0), 24_000, 1, 0))
print("sweeping", flush=True)
"""
LIVE = SWEEP + "client.wait_for(lambda: False, 60.0)"
_LATEST_S = 5.0  # of real time, for a heartbeat of a host that lives on a computer that hangs
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


class _PatientServer(serve.PtyServer):
    """Lets the robot's time stand still while this computer keeps the host's port process from
    running.

    Attributes:
        patient: whether it also stands still rather than that the heartbeat stays away; not for a
            host that was ended.
        slow_s: of real time, to add to each step: what then takes long is the robot's, and not this
            computer's.
    """

    patient = True
    slow_s = 0.0
    _beat_s: float | None = None  # of the last heartbeat, by the robot's clock; None: none is due

    def __init__(self, lockstep: Lockstep, *, reset_on_open: bool) -> None:
        super().__init__(lockstep, reset_on_open=reset_on_open)
        self._holder = PortHolder(self.path)
        self._frames = Decoder()

    def _exchange(self) -> None:
        until = time.monotonic() + EVER_S
        while self._opened and self._holder.held_up() and time.monotonic() < until:
            time.sleep(STEP_S / 2)
        if not self._opened:
            self._beat_s = None
        elif self._beat_s is not None and self.lockstep.t_s - self._beat_s > 2 * PERIOD_S:
            self._await_heartbeat()
        if self.slow_s:
            time.sleep(self.slow_s)
        super()._exchange()

    def _await_heartbeat(self) -> None:
        """Read on until a heartbeat or a stop comes, or the port is closed.

        Commands alone are not enough: one thread of the host's port process may stand still, with
        the processor that it waits for, while another passes them on.
        """
        overdue_s, until = self._beat_s, time.monotonic() + _LATEST_S
        while self.patient and self._beat_s == overdue_s and time.monotonic() < until:
            if dict(self._poll.poll(20)).get(self._master, 0) & select.POLLHUP:
                return
            self._hear()
        if self._beat_s == overdue_s:
            self._beat_s = None  # this host has fallen silent

    def _take(self) -> bytes:
        data = super()._take()
        if data:
            self._holder.look()
        for frame in self._frames.feed(data):
            if frame.id in (Heartbeat.ID, Stop.ID):
                self._beat_s = self.lockstep.t_s
        return data


class ServedRobot(serve.ServedRobot):
    """A robot served by a thread.

    Args:
        lockstep: board and body.
        reset_on_open: as opening a port with DTR does.
    """

    _server: _PatientServer

    def __init__(self, lockstep: Lockstep, *, reset_on_open: bool = True) -> None:
        self.plant = lockstep.plant
        super().__init__(_PatientServer(lockstep, reset_on_open=reset_on_open))

    @property
    def off_for_s(self) -> float:
        """For how long it has been off, of its own time."""
        return self.lockstep.t_s - self.live_s

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
        return comes(lambda: self.off) and self.live_s - since <= seconds + 2 * STEP_S

    def close(self) -> None:
        """Pull the cable: the port is gone, and time stands still for the robot."""
        self.alone()
        super().close()


def ready_to_sweep() -> ServedRobot:
    """An emulated robot, zeroed in virtual time, then on a port in real time."""
    robot, transport = armed(scene_at(20.0), seed=3)
    with robot:  # which disarms it: armed, it would miss this host, and the next one arms it
        robot.select_body_pressure(0)
        robot.zero()
    # A board that keeps running while hosts come and go: opening does not reset it.
    return ServedRobot(transport.lockstep, reset_on_open=False)
