"""`emulator://SCENE`: a connection to the firmware core inside an emulated robot and room.

Virtual time passes only while the host reads: `read` advances the lockstep until there are bytes or
its time-out is over. So a run of minutes takes seconds and is the same each time. The heartbeat is
sent by the virtual clock. With `realtime` the steps are paced by the wall clock.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal
from urllib.parse import parse_qs

import numpy as np

from thigmo.config import RobotConfig
from thigmo.emulator.board import EmulatedBoard, virtual_board
from thigmo.emulator.fibre import EmulatedFibre
from thigmo.emulator.lockstep import Lockstep
from thigmo.emulator.plant import STEP_MS, Truth
from thigmo.emulator.scene import FaultTable, Scene
from thigmo.errors import ConfigError, LinkError
from thigmo.link.framing import Decoder
from thigmo.link.heartbeat import HOLD_AFTER, Beat, HeartbeatSource
from thigmo.link.stop import Stopper
from thigmo.link.stop_socket import StopListener
from thigmo.mechanics import Peg

if TYPE_CHECKING:
    from thigmo.camera import PictureSource, Sheet
    from thigmo.link.transport import Transport
    from thigmo.operator_prompts import Dowel, Operator

_KEPT_BEATS = 64
_SEEN_CM = 0.02  # of line: what an eye beside the spool sees


class EmulatedOperator:
    """The operator beside the emulated robot, who does what is asked without being waited for."""

    def __init__(self, transport: EmulatorTransport) -> None:
        self._transport = transport
        self._plant = transport.lockstep.plant
        self._about = transport.scene.operator
        self._line_cm = self._plant.line_cm
        self.meanwhile: Callable[[float], None] | None = None
        self._rng = np.random.default_rng([transport.seed, 0x0FE8])

    def everted_length_cm(self) -> float:
        """Measure the everted length."""
        error = self._about.length_error_cm * self._rng.standard_normal()
        return max(self._plant.length_cm + error, 0.0)

    def ready(self, request: str) -> None:
        """Do what a bring-up asks for; the emulated robot needs nothing."""

    def press_emergency_stop(self, pressed: bool) -> None:
        """Press or release the emergency stop."""
        self._transport.lockstep.board.set_estop(pressed)
        self._plant.estop = pressed
        self._transport.pass_time(0.1)

    def press_emergency_stop_soon(self) -> None:
        """Press the emergency stop in two seconds."""
        fault = FaultTable(kind="estop", at_s=self._transport.now() + 2.0, duration_s=3.0)
        self._transport.lockstep.faults.inject(fault)

    def valves_fitted(self) -> bool:
        """Whether Y1, Y2 and Y3 are there."""
        return self._transport.scene.enables.fitted

    def body_is_limp(self) -> bool:
        """Whether the body has lost its air."""
        return self._plant.body_psi < 0.2

    def spool_turned(self) -> Literal["out", "in", "not"]:
        """How the spool has turned since the last such question."""
        line_cm = self._plant.line_cm
        moved, self._line_cm = line_cm - self._line_cm, line_cm
        if abs(moved) < _SEEN_CM:
            return "not"
        return "out" if moved > 0 else "in"

    def set_body_pressure(self, pressure_psi: float) -> None:
        """Set the body's regulator; takes the scene's `operator.takes_s` of virtual time."""
        self._take_time()
        self._plant.set_body_pressure(pressure_psi)

    def warn(self, danger: str) -> None:
        """Nobody can be hurt by an emulated robot."""

    def place_pegs(self, pegs: Sequence[Dowel]) -> None:
        """Clear the room and put these pegs into it; takes `operator.takes_s` as well."""
        self._take_time()
        self._plant.place_pegs([Peg(peg.x, peg.y, peg.radius) for peg in pegs])

    def push_tip(self, y_cm: float | None) -> None:
        """Push the tip aside to y and hold it there; None lets go."""
        self._plant.hold([] if y_cm is None else [(self._plant.length_cm, y_cm)])

    def push_aside(self, pushes: Sequence[tuple[float, float]], radius_cm: float) -> None:
        """Hold points (arc, y) of the body aside, base first; takes `operator.takes_s` as well."""
        self._take_time()
        self._plant.hold(pushes, radius_cm)

    def _take_time(self) -> None:
        """Let the time pass that a request takes; a robot that is connected is read meanwhile."""
        (self.meanwhile or self._transport.pass_time)(self._about.takes_s)


class EmulatorTransport:
    """The link's Transport over a board in lockstep with a plant.

    `seed` determines all noise (None takes the scene's). With `realtime` virtual time keeps to the
    clock. The board runs `exchange_ms` between exchanges with the plant.
    """

    virtual = True

    def __init__(
        self,
        scene: Scene,
        board: EmulatedBoard,
        *,
        seed: int | None = None,
        realtime: bool = False,
        exchange_ms: int = STEP_MS,
        name: str = "",
    ) -> None:
        self.name = name or f"emulator://{scene.name}"
        self.scene = scene
        self.seed = scene.seed if seed is None else seed
        self.lockstep = Lockstep(scene, board, seed=self.seed, exchange_ms=exchange_ms)
        # The robot.toml that this robot's lab would have: the truth with its errors.
        self.config: RobotConfig = scene.believed(self.seed)
        self.operator: Operator = EmulatedOperator(self)
        self.read_s = 0.0  # host time at which the bytes last read had arrived
        self._heartbeat: HeartbeatSource | None = None
        self._stopper = Stopper(self.now)
        self._stops: StopListener | None = None
        self._echoes = Decoder()
        self._beats: deque[Beat] = deque(maxlen=_KEPT_BEATS)
        self._received = bytearray()
        self._realtime = realtime
        self._began = time.monotonic()
        self._closed = False

    def now(self) -> float:
        """Virtual seconds since the start."""
        return self.lockstep.t_s

    def take_stops(self) -> None:
        """Take stops from outside this program, as a port's process does, until it is closed.

        Raises PortError if it cannot listen for them.
        """
        self._stops = StopListener(
            self.name, self._stopper.stop, program=os.getpid(), emulated=True
        )

    def write(self, data: bytes) -> None:
        """Hand bytes to the board's UART."""
        self._require_open()
        self._send(data)

    def _send(self, data: bytes) -> None:
        if not self.lockstep.faults.host_silent:
            self.lockstep.board.write(data)

    def read(self, timeout_s: float) -> bytes:
        """Bytes as soon as there are any; b"" when so much virtual time passed without."""
        self._require_open()
        end = self.now() + timeout_s - 1e-9
        # Any wait, however short, makes time pass: the awaited bytes may lie between two steps.
        while not self._received and timeout_s > 0:
            self._advance()
            if self.now() >= end:
                break
        data = bytes(self._received)
        self._received.clear()
        return data

    def pass_time(self, seconds: float) -> None:
        """Let virtual time pass; bytes that the board sends meanwhile wait for `read`."""
        self._require_open()
        end = self.now() + seconds - 1e-9
        while self.now() < end:
            self._advance()

    def _advance(self) -> None:
        lockstep = self.lockstep
        if self._heartbeat is not None:
            now = self.now()
            frame = self._heartbeat.beat(now)
            if frame is not None and not lockstep.faults.host_silent:
                self._send(frame)
                self._beats.append(Beat(self._heartbeat.counter, now))
        stop = self._stopper.frame()
        if stop is not None:
            self._send(stop)
        lockstep.advance()
        data = lockstep.board.read()
        if data:
            self._received += data
            self._stopper.heard()
            if self._stopper.calling:
                for echo in self._echoes.feed(data):
                    self._stopper.take(echo)
            if self._heartbeat is not None:
                self._heartbeat.heard()
            self.read_s = self.now()
        if self._realtime:
            ahead = self.now() - (time.monotonic() - self._began)
            if ahead > 0:
                time.sleep(ahead)

    def start_heartbeat(self, session: int, period_s: float) -> None:
        """Beat by the virtual clock from now on."""
        self._heartbeat = HeartbeatSource(session, period_s, hold_after=HOLD_AFTER)

    def stop_heartbeat(self) -> None:
        """Send no further heartbeats."""
        self._heartbeat = None

    def beats(self) -> list[Beat]:
        """Heartbeats sent since the last call, oldest first (the last 64 at most)."""
        beats = list(self._beats)
        self._beats.clear()
        return beats

    def truth(self) -> Truth:
        """Pegs, contacts and shapes."""
        return self.lockstep.plant.truth()

    def overhead_pictures(self, sheet: Sheet, seed: int) -> tuple[PictureSource, float]:
        """Pictures of a camera above the room, and the camera's height (cm) by tape."""
        from thigmo.emulator.overhead import overhead_pictures  # OpenCV is an extra

        return overhead_pictures(self.truth, self.config.body, sheet, seed=seed)

    def interrogator(self) -> EmulatedFibre:
        """The interrogator of its fibre; nothing that was sent before is waiting."""
        self.lockstep.plant.fibre.read()
        return self.lockstep.plant.fibre

    def close(self) -> None:
        """Close; may be called twice."""
        self._closed = True
        self._heartbeat = None
        self._stopper.end()
        if self._stops is not None:
            self._stops.close()

    def _require_open(self) -> None:
        if self._closed:
            raise LinkError(f"{self.name} is closed", "open it again")


def parse_url(
    url: str, seed: int | None, **choices: tuple[str, ...]
) -> tuple[Scene, int, dict[str, str]]:
    """Scene, seed and further options of `emulator://SCENE?seed=N&OPTION=CHOICE`.

    The scene is a name or a path to a .toml file. The seed given comes first, then the address's,
    then the scene's. An option that is omitted takes its first choice.
    """
    place, _, query = url.partition("://")[2].partition("?")
    stated = {key: values[-1] for key, values in parse_qs(query, keep_blank_values=True).items()}
    text = stated.pop("seed", None)
    for key, value in stated.items():
        if value not in choices.get(key, ()):
            allowed = ["seed=NUMBER", *(f"{k}={' or '.join(c)}" for k, c in choices.items())]
            raise ConfigError(
                f"{url}: no option {key}={value}", f"give any of {', '.join(allowed)}"
            )
    if text is not None and seed is None:
        if not text.isdecimal():
            raise ConfigError(f"{url}: seed {text!r} is not a whole number", "give ?seed=NUMBER")
        seed = int(text)
    scene = Scene.load(place or "default")
    options = {key: allowed[0] for key, allowed in choices.items()} | stated
    return scene, scene.seed if seed is None else seed, options


def open_emulator(url: str, *, seed: int | None = None, realtime: bool = False) -> Transport:
    """Open `emulator://SCENE` with the firmware core on the virtual board that its robot needs."""
    scene, used, _ = parse_url(url, seed)
    board = virtual_board(scene.robot, used)
    opened = EmulatorTransport(scene, board, seed=used, realtime=realtime, name=url)
    opened.take_stops()
    return opened
