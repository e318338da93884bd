"""`thigmo emulate SCENE`: the emulated robot on a pseudo-terminal, in real time.

Any program that opens serial ports can talk to it. As on the Mega, opening the port resets the
board, which then sits in its boot loader for 0.84 s. The emulated body keeps its state through
that, and keeps moving when the program at the other end dies: then the board's own heartbeat limit
makes it safe. The person at the regulator does as prompted: whenever the host states the body
pressure to the board, the regulator is set to it.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from thigmo.closing import Closing
from thigmo.config import RobotConfig
from thigmo.emulator.board import require_usual, virtual_board
from thigmo.emulator.fibre import LineServer
from thigmo.emulator.lockstep import Lockstep
from thigmo.emulator.plant import STEP_S
from thigmo.emulator.scene import Scene
from thigmo.emulator.transport import EmulatorTransport
from thigmo.errors import PortError
from thigmo.extras import require_sources
from thigmo.link import protocol as wire
from thigmo.link.client import Client
from thigmo.link.framing import Decoder
from thigmo.link.protocol import ResetCause, SelectZone
from thigmo.robot.robot import Robot

# After a longer stall of this computer, virtual time slips. It is well below the board's limit of
# silence: a computer that hangs for a moment must not look like a host that fell silent.
_MOST_BEHIND_S = 0.05
_QUEUE = 65_536  # bytes kept for a program that does not read; beyond, they are lost


class PtyServer:
    """A lockstep behind the pseudo-terminal `path`, and a symbolic link to it for a stable name.

    With `reset_on_open` the board restarts when a program opens the port, as DTR does.
    """

    def __init__(
        self, lockstep: Lockstep, *, reset_on_open: bool = True, link: Path | None = None
    ) -> None:
        try:
            import pty
            import tty
        except ImportError as error:
            raise PortError(
                "this system has no pseudo-terminals", "use emulator://SCENE, or run it on Linux"
            ) from error
        self.lockstep = lockstep
        self._reset_on_open = reset_on_open
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        self.path = os.ttyname(slave)
        # With no end of ours open, the master sees a hang-up while nobody else has the port open.
        os.close(slave)
        os.set_blocking(self._master, False)
        self._poll = select.poll()
        self._poll.register(self._master, select.POLLIN | select.POLLHUP)
        self._opened = False
        self._out = bytearray()
        self._heard = Decoder()
        self._link = link
        robot = lockstep.scene.robot
        self._fibre = (
            LineServer(robot.interrogator, lockstep.plant.fibre) if robot.interrogator else None
        )
        if link is None:
            return
        try:
            if link.is_symlink():
                link.unlink()
            link.symlink_to(self.path)
        except OSError as error:
            os.close(self._master)
            raise PortError(
                f"cannot make the link {link}: {error.strerror}", "choose another place"
            ) from error

    def close(self) -> None:
        """Close the port and remove the link; a second time does nothing."""
        if self._master < 0:
            return
        os.close(self._master)
        self._master = -1
        if self._fibre is not None:
            self._fibre.close()
        if self._link is not None and self._link.is_symlink():
            self._link.unlink()

    def run(self, keep_on: Callable[[], bool] = lambda: True) -> None:
        """Serve in real time while `keep_on()` says so."""
        began = time.monotonic() - self.lockstep.t_s
        while keep_on():
            wait_s = self.lockstep.t_s + STEP_S - (time.monotonic() - began)
            if wait_s > 0 and self._opened:
                self._poll.poll(max(1, round(wait_s * 1000)))
            elif wait_s > 0:  # a hang-up would end a poll at once
                time.sleep(wait_s)
            elif wait_s < -_MOST_BEHIND_S:
                began -= wait_s
            self._exchange()

    def _exchange(self) -> None:
        """Bytes in, one step, bytes out."""
        events = dict(self._poll.poll(0)).get(self._master, 0)
        opened = not events & select.POLLHUP
        board = self.lockstep.board
        if opened and not self._opened:
            self._out.clear()
            if self._reset_on_open:
                board.reset(int(ResetCause.EXTERNAL))
        self._opened = opened
        if events & select.POLLIN:
            self._hear()
        self.lockstep.advance()
        if self._fibre is not None:
            self._fibre.exchange()
        self._out += board.read()
        if not opened:
            self._out.clear()
        elif self._out:
            self._give()

    def _hear(self) -> None:
        """The bytes that have come, to the board."""
        data = self._take()
        if data and not self.lockstep.faults.host_silent:
            self.lockstep.board.write(data)
            self._set_regulator(data)

    def _set_regulator(self, data: bytes) -> None:
        """The body pressure that the host names, if it does."""
        pressures = self.lockstep.plant.scene.robot.body.pressures
        for frame in self._heard.feed(data):
            if frame.id != SelectZone.ID or len(frame.payload) != SelectZone.SIZE:
                continue
            body_pressure = SelectZone.unpack(frame.payload).zone
            if body_pressure < len(pressures):
                self.lockstep.plant.set_body_pressure(pressures[body_pressure].pressure_psi)

    def _take(self) -> bytes:
        with suppress(OSError):  # closed between poll and read
            return os.read(self._master, 4096)
        return b""

    def _give(self) -> None:
        with suppress(OSError):  # full: the program does not read
            del self._out[: os.write(self._master, self._out)]
        if len(self._out) > _QUEUE:
            del self._out[: len(self._out) - _QUEUE]


class ServedRobot(Closing):
    """A robot on a server's port, served by a thread; it lives on when its cable is pulled.

    Attributes:
        port: the path to open.
        plugged: whether the cable is plugged; assign to it to pull or plug the cable.
        live_s: when the robot was last energised, by its own clock.
    """

    def __init__(self, server: PtyServer) -> None:
        self.lockstep = server.lockstep
        self.board = server.lockstep.board
        self.port = server.path
        self.plugged = True
        self.live_s = 0.0
        self._server = server
        self._closed = False
        self._thread = threading.Thread(target=self._live)
        self._thread.start()

    def close(self) -> None:
        """Take the robot off the port and end its time."""
        self._closed = True
        self._thread.join()

    @property
    def energised(self) -> bool:
        """Whether a transducer is driven."""
        return any(self.board.drive_enabled)

    @property
    def off(self) -> bool:
        """Whether no transducer is driven and the motor is braked."""
        return not self.energised and self.board.motor == 0 and self.board.braked

    def _live(self) -> None:
        """Thread: the robot's time passes, on the port and then off it."""
        self._server.run(lambda: self._look() and self.plugged)
        self._server.close()
        while self._look():
            self.lockstep.advance()
            time.sleep(STEP_S)

    def _look(self) -> bool:
        if not self.off:
            self.live_s = self.lockstep.t_s
        return not self._closed


def brought_up(robot: RobotConfig | None = None) -> bytes:
    """Store of a board that `thigmo bringup` has passed: defaults, and a spool that was watched.

    The board is the one that the robot needs; None is the thesis's.
    """
    room = Scene.load("empty")
    room.robot = robot or room.robot
    board = virtual_board(room.robot, 0)
    with Client(EmulatorTransport(room, board)) as client:
        client.request(wire.LoadDefaults())
        index = client.parameters["direction_seen"].index
        client.request(wire.SetParameter(index, 1))
        client.request(wire.ApplyParameters())
        client.request(wire.SaveConfig())
    return board.eeprom


def configured(room: Scene) -> bytes:
    """Store of a usual board that holds the robot of a scene, as its lab knows it."""
    board = virtual_board(room.robot, 0, brought_up(room.robot))
    transport = EmulatorTransport(room, board)
    with Client(transport) as client:
        Robot(client).configure(transport.config)
    return board.eeprom


def attend(scene: str | Path) -> None:
    """Serve a scene beside MicroPython's prompt in this terminal, until it is left.

    The prompt's `thigmo_board` is the controller of the scene's robot, which knows its constants. A
    host may open the robot's link, which is printed, as on a Pico.

    Raises PortError where MicroPython cannot be built, NotInstalledError in a wheel.
    """
    require_sources("thigmo.emulator.micropython", "MicroPython's prompt")
    from thigmo.emulator.micropython import STORE_SIZE, MicroPythonBoard

    room = Scene.load(scene)
    require_usual(room.robot)
    board = MicroPythonBoard(room.seed, configured(room)[:STORE_SIZE], attended=True)
    server = PtyServer(Lockstep(room, board), reset_on_open=False)
    print(f"{room.name}: a host may open {server.path}; Ctrl-D leaves the prompt", file=sys.stderr)
    previous = signal.signal(signal.SIGINT, lambda *_: None)  # Ctrl-C is for the prompt
    try:
        server.run(lambda: not board.ended)
    finally:
        signal.signal(signal.SIGINT, previous)
        server.close()


def serve(
    scene: str | Path,
    *,
    link: Path | None = None,
    config: Path | None = None,
    announce: Callable[[str], None] = print,
) -> None:
    """Serve a scene until the program is interrupted.

    Args:
        scene: a scene's name or the path of its file.
        link: a symbolic link to make to the port.
        config: where to write this robot's constants, as its lab knows them.
        announce: called with where the port is, once it can be opened.
    """
    room = Scene.load(scene)
    board = virtual_board(room.robot, room.seed, brought_up(room.robot))
    lockstep = Lockstep(room, board)
    server = PtyServer(lockstep, link=link)
    port = server.path if link is None else link
    try:
        message = f"{room.name}: open {port}; Ctrl-C ends it"
        if config is not None:
            believed = room.believed()
            if not (config.exists() and RobotConfig.load(config) == believed):
                believed.save(config)
            message += f"\nIts constants: thigmo explore --robot {port} --config {config}"
        announce(message)
        server.run()
    finally:
        server.close()
