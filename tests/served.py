"""An emulated robot on a port in real time, which outlives its hosts.

Limits are told in the robot's own time. Where the computer is busy, that time slips against the
wall clock, and a promise such as "off within half a second" can still be checked exactly.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from port_holder import PortHolder

from thigmo.emulator._board import VirtualBoard
from thigmo.emulator.lockstep import Lockstep
from thigmo.emulator.plant import STEP_S
from thigmo.emulator.scene import Scene
from thigmo.emulator.serve import PtyServer, brought_up
from thigmo.emulator.transport import EmulatorTransport
from thigmo.link import protocol as wire
from thigmo.link.client import Client
from thigmo.link.heart import PERIOD_S

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
    """Lets the robot's time stand still while this computer keeps the host's port process from
    running.

    Attributes:
        patient: whether it also stands still rather than that the host falls silent; not for a
            host that was ended.
        slow_s: of real time, to add to each step: what then takes long is the robot's, and not this
            computer's.
    """

    patient = True
    slow_s = 0.0
    _heard_s: float | None = None  # by the robot's clock, since the port was opened

    def __init__(self, lockstep: Lockstep, *, reset_on_open: bool) -> None:
        super().__init__(lockstep, reset_on_open=reset_on_open)
        self._holder = PortHolder(self.path)

    def _exchange(self) -> None:
        until = time.monotonic() + EVER_S
        while self._opened and self._holder.held_up() and time.monotonic() < until:
            time.sleep(STEP_S / 2)
        if not self._opened:
            self._heard_s = None
        elif self._heard_s is not None and self.lockstep.t_s - self._heard_s > 2 * PERIOD_S:
            while self.patient and not self._poll.poll(20) and time.monotonic() < until:
                pass
        if self.slow_s:
            time.sleep(self.slow_s)
        super()._exchange()

    def _take(self) -> bytes:
        data = super()._take()
        if data:
            self._holder.look()
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

    @property
    def off_for_s(self) -> float:
        """For how long it has been off, of its own time."""
        return self.lockstep.t_s - self._live_until_s

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


def ready_to_sweep() -> ServedRobot:
    """An emulated robot, zeroed in virtual time, then on a port in real time."""
    scene = Scene.load("empty").model_copy(update={"start_length_cm": 20.0})
    transport = EmulatorTransport(scene, VirtualBoard(3, brought_up()), seed=3)
    client = Client(transport)
    vented = wire.Condition.VENTED.mask
    while not client.request(wire.GetStatus()).conditions & vented:
        client.poll(0.01)
    client.request(wire.ConfirmLength(200_000, 1))
    client.request(wire.SelectZone(0))
    client.request(wire.ClearFaults(0xFFFF))
    client.request(wire.Arm())
    client.request(wire.ZeroSensors(0b00011_00011))
    report = client.request(wire.GetStatus())
    assert client.wait_for(lambda: any(_done(e.message) for e in client.events), 30.0), report
    client.request(wire.AckEvent(client.request(wire.GetStatus()).event_number))
    client.request(wire.Disarm())  # armed, it would miss this host: the next one arms it
    # A board that keeps running while hosts come and go: opening does not reset it.
    return ServedRobot(transport.lockstep, reset_on_open=False)


def _done(event: wire.Event) -> bool:
    return event.code == wire.EventCode.ACTIVITY_DONE and event.arg == wire.Activity.ZEROING
