"""A robot's link, and what is known and said of it without commanding: the ground of `Robot`.

All waiting is done by reading the link: with the emulator that is what advances time, on hardware
the heartbeat runs beside it.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from thigmo.closing import Closing
from thigmo.config import RobotConfig, Side
from thigmo.errors import DataError, LinkError
from thigmo.link import protocol as wire
from thigmo.operator_prompts import Dowel, Operator, Simulated
from thigmo.record import FibreLine, TrueContact, TruePeg, Truth
from thigmo.robot.creep import CreepWatch
from thigmo.robot.curvature import SensorTable
from thigmo.robot.fibre import Fibre
from thigmo.robot.publishing import Publisher
from thigmo.robot.state import Status
from thigmo.robot.strains import Strains
from thigmo.stream import Command, Hello, Message, Server, Telemetry
from thigmo.stream.hub import QUEUE
from thigmo.version import VERSION

if TYPE_CHECKING:
    from thigmo.link.client import Client, Tap
    from thigmo.link.inbox import TelemetryFrame

_STREAM_S = 0.1
_UNKNOWN_ZONE = 255


class _Nobody:
    """The operator of a program that named none: every question is a DataError.

    Dangers are Python's warnings.
    """

    def everted_length_cm(self) -> float:
        raise DataError("the everted length is unknown", "measure it, and call confirm_length")

    def set_body_pressure(self, pressure_psi: float) -> None:
        raise DataError(
            f"the body pressure must be set to {pressure_psi:g} psi by hand",
            "set the regulator, and call select_zone",
        )

    def warn(self, danger: str) -> None:
        warnings.warn(danger, stacklevel=5)

    def place_pegs(self, pegs: Sequence[Dowel]) -> None:
        raise DataError("the room's dowels must be moved by hand", "name an operator to connect()")


class Connected(Closing):
    """A connected robot. A context manager: leaving it vents, brakes and closes the link.

    Attributes:
        url: how it was opened.
        virtual: whether waiting advances an emulator's time instead of the clock's.
        operator: who answers what the board cannot know.
        config: robot.toml as last sent with `configure`; before, `known_config` or the defaults.
        known_config: the robot.toml that an emulated robot's lab would have; None on hardware.
        hub: where it publishes telemetry, events and shape; an exploration does as well.
        aside: mask of the sensors that `set_aside` made the board leave out.
        strains: of a fibre that is read live.
        epoch_s: UTC seconds since 1970 at which the link's clock (`now`) was 0.
    """

    def __init__(self, client: Client, *, url: str = "", operator: Operator | None = None) -> None:
        self._client = client
        self.url = url
        self.virtual = client.transport.virtual
        room = client.transport
        self._room: Simulated | None = room if isinstance(room, Simulated) else None
        self.operator: Operator = self._room.operator if self._room else operator or _Nobody()
        self.known_config: RobotConfig | None = self._room.config if self._room else None
        self.config = self.known_config or RobotConfig()
        self._table = SensorTable.of(self.config)
        self._publisher = Publisher(client, self.config, self._table.board)
        self.hub, self.epoch_s = self._publisher.hub, self._publisher.epoch_s
        self._before = self._table  # the last zeroing
        self.aside = 0
        self._creep: CreepWatch | None = None
        self._fibre: Fibre | None = None  # opened where it is needed first
        self.strains = Strains()
        self._on_fibre: list[Callable[[FibreLine, float], None]] = []
        self._guarded = False  # whether what the fibre guards is under way
        self._fault_channels: dict[wire.Fault, int] = {}  # which only their events tell
        self._interruptions: list[Callable[[], None]] = []
        self._started = client.now()
        self._briefed = False  # the operator, since the connection
        self._warned_of: set[str] = set()  # muscles that no base sensor guards
        self._closed = False

    # Life.

    def __exit__(self, *error: object) -> None:
        if isinstance(error[1], KeyboardInterrupt):
            self.make_safe(interrupted=True)
        self.close()

    def make_safe(self, *, interrupted: bool = False) -> bool:
        """Valves to 0 mA and motor braked, if the board can still be reached; never raises.

        An interruption by an operator is a `stop`, which waits behind no command and latches; else
        it is a `disarm`. Returns whether the board acknowledged; if not, its own heartbeat limit
        does the same.
        """
        try:
            (self.stop if interrupted else self.disarm)()
        except LinkError:
            return False
        return True

    def close(self) -> None:
        """Make the robot safe and close the link. May be called twice."""
        if self._closed:
            return
        self._closed = True
        try:
            self.make_safe()
        finally:
            self._client.close()
            self.hub.close()
            self._close_fibre()

    def disarm(self) -> None:
        """Valves 0 mA, motor braked, activity aborted, state safe; `arm` leads back."""
        self._guarded = False
        self._client.request(wire.Disarm())

    def stop(self) -> None:
        """At once, whatever is under way: valves 0 mA, motor braked, and so it stays.

        The board refuses to arm or to move until an operator clears the stop: `clear_stop`, or
        `thigmo clear`. Raises CommandTimeoutError if the board does not confirm it.
        """
        self._client.stop()

    def clear_stop(self) -> bool:
        """End a stop, for an operator who has looked at the robot; whether there was one.

        No program should call it on its own account. `clear_faults` leaves a stop latched. Refused
        if the robot was stopped once more meanwhile.
        """
        report = self._client.request(wire.GetStatus())
        if not report.faults & wire.Fault.STOPPED.mask:
            return False
        self._client.request(wire.ClearStop(report.stop_nonce))
        return True

    # The stream.

    def record_frames(self, tap: Tap) -> None:
        """Call `tap(direction, frame, host time)` with every frame of the link from now on."""
        self._client.taps.append(tap)

    def record_fibre(self, take: Callable[[FibreLine, float], None]) -> None:
        """Call `take(line, host time)` with each line and zeroing of a fibre from now on."""
        self._on_fibre.append(take)

    def _take_strains(self, line: FibreLine) -> None:
        if line.zero:
            self._table = self._table.strained(line.t_s, line.strain_ue)
        else:
            self.strains.take(line)
        for take in self._on_fibre:
            take(line, self.now())

    def _close_fibre(self) -> None:
        if self._fibre is not None:
            self._client.taps.remove(self._fibre.tap)
            self._client.on_telemetry.remove(self._fibre.telemetry)
            self._fibre.close()
            self._fibre = None

    def on_telemetry(self, callback: Callable[[Telemetry], None]) -> Callable[[], None]:
        """Call `callback` with each telemetry frame, decoded, while the link is read.

        It must be quick, and must command nothing. Returns a function that ends it.
        """

        def take(message: Message) -> None:
            if isinstance(message, Telemetry):
                callback(message)

        self.hub.attach(take, {Telemetry.CHANNEL})
        return lambda: self.hub.detach(take)

    def stream(
        self, seconds: float = np.inf, channels: Iterable[str] | None = None, size: int = QUEUE
    ) -> Iterator[Message]:
        """Messages as they come, read from the link meanwhile; commands may be sent between them.

        Another thread than the one that drives the robot takes `hub.subscribe()` instead.

        Args:
            channels: names of `thigmo.stream.CHANNELS`; None gives all.
            size: messages that are kept while nobody takes them; then the oldest are lost.
        """
        end = self.now() + seconds
        with self.hub.subscribe(channels, size) as heard:
            while self.now() < end:
                self._client.poll(min(end - self.now(), _STREAM_S))
                self._forget()  # nobody waits for the board's events meanwhile
                # What is done between two messages takes time, and brings new ones.
                while self.now() < end and (message := heard.get(0.0)) is not None:
                    yield message

    def serve(self, name: str, folder: str, command: Callable[[Command, str], None]) -> Server:
        """Serve the hub to viewers, as a run of a name and with a run folder, if it has one.

        `command` is called with what a viewer asks or answers, in a thread of its own.
        """
        now_s = self.now()
        hello = Hello(
            now_s, self.epoch_s + now_s, self.url, name, folder, os.getpid(), VERSION,
            self.virtual,
        )  # fmt: skip
        return Server(self.hub, hello, command)

    @contextmanager
    def _telemetry_to(self, take: Callable[[TelemetryFrame], None]) -> Iterator[None]:
        self._client.on_telemetry.append(take)
        try:
            yield
        finally:
            self._client.on_telemetry.remove(take)

    def while_waiting(self, callback: Callable[[], None]) -> None:
        """Call `callback` during each wait for the board; an exception in it ends the wait.

        It must command nothing.
        """
        self._interruptions.append(callback)

    def _note_channels(self) -> None:
        for each in self._client.events:
            if each.message.code == wire.EventCode.FAULT:
                self._fault_channels[wire.Fault(each.message.arg)] = each.message.value

    def _forget(self) -> None:
        """Drop what was received and not asked for, before something new is started.

        A fault among it needs no attention here: the board refuses to start while it is latched.
        """
        self._note_channels()
        self._client.events.clear()

    # What is known.

    def status(self) -> Status:
        """Ask the board for its whole state."""
        report = self._client.request(wire.GetStatus())
        conditions = frozenset(c.key for c in wire.Condition.from_mask(report.conditions))
        supply_v = self._publisher.supply_v = report.supply_mv / 1e3
        return Status(
            state=report.state.key,
            activity=report.activity.key,
            zone=None if report.zone == _UNKNOWN_ZONE else report.zone,
            faults=tuple(f.key for f in wire.Fault.from_mask(report.faults)),
            conditions=conditions,
            t_s=self._client.device_s(report.t_us),
            length_cm=report.length_um / 1e4 if "length_known" in conditions else None,
            pressure_psi=self._psi(report.pressure_cpsi),
            everted=report.everted_mask,
            settled=report.settled_mask,
            zeroed=report.zeroed_mask,
            config_generation=report.config_generation,
            supply_v=supply_v,
            encoder_errors=report.encoder_errors,
        )

    def _psi(self, cpsi: Sequence[float]) -> tuple[float, ...]:
        """Pressures of the robot's muscles, of those that the board has."""
        return tuple(each / 100 for each in cpsi[: len(self.config.muscles)])

    @property
    def identity(self) -> dict[str, str]:
        """Who the board is, as strings for a record: firmware, board, schema, boot."""
        hello = self._client.hello
        return {
            "board": hello.board.key,
            "firmware": ".".join(str(part) for part in hello.firmware_version),
            "schema_hash": f"{hello.schema_hash:08x}",
            "boot_nonce": f"{hello.boot_nonce:08x}",
            "reset_cause": hello.reset_cause.key,
        }

    def now(self) -> float:
        """The link's clock, s: monotonic on hardware, virtual in the emulator."""
        return self._client.now()

    @property
    def elapsed_s(self) -> float:
        """Time since the connection, on the link's clock."""
        return self.now() - self._started

    def link_stats(self) -> dict[str, int]:
        """Counters of the link as the board sees it, by the schema's names."""
        stats = asdict(self._client.request(wire.GetLinkStats()))
        return {name: count for name, count in stats.items() if name != "status"}

    def scenery(self) -> Any:
        """The emulator's own truth (shapes included), for painting pictures; None on hardware."""
        return self._room.truth() if self._room else None

    def overhead_pictures(self, sheet: Any, seed: int = 0) -> Any:
        """Pictures of a camera above an emulated robot, and its height (cm); None on hardware.

        They are a `thigmo.camera.PictureSource`; `sheet` is the `Sheet` that lies on the table.
        """
        return self._room.overhead_pictures(sheet, seed) if self._room else None

    def truth(self, side: Side | Literal[""] = "") -> Truth | None:
        """What the emulated room knows now, of the side that is inflated; None on hardware."""
        known = self.scenery()
        if known is None:
            return None
        pegs = [TruePeg(float(p.x), float(p.y), float(p.radius)) for p in known.pegs]
        length = float(known.length_cm)
        touching = [
            TrueContact(float(c.x), float(c.y), float(c.arc), length, int(c.peg), side)
            for c in known.contacts
        ]
        return Truth(pegs, touching)
