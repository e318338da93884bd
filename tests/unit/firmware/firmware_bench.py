"""A board on the bench: hand-made analog inputs, and the protocol spoken by hand.

`Bench` is what the firmware's tests drive. It wires a virtual board, or the Mega's image, to inputs
that a test sets, steps both in 5 ms, beats the heart unless the test stops it, and sends one
command at a time.
`FlowingAir` and `TurningSpool` close the two loops that the firmware expects closed, as simply as
they can be.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from thigmo.emulator._board import VirtualBoard
from thigmo.emulator.board import EmulatedBoard
from thigmo.emulator.mega_sim import SimulatedMega
from thigmo.link import protocol as wire
from thigmo.link.framing import Decoder, encode

STEP_MS = 5
DIVIDER = 22_000.0
FLAT = 12_000.0
SCALE = 3.5e-5  # 1/cm per ohm, the default parameter
M = TypeVar("M", bound=wire.Message)


def flex_count(curvature: float) -> float:
    """Ideal count of a sensor of 12 kOhm flat at a curvature in 1/cm."""
    return 1024 * DIVIDER / (DIVIDER + FLAT + curvature / SCALE)


def pressure_count(psi: float) -> float:
    """Ideal count of the 60 psi sensor."""
    return 1024 * (0.1 + 0.8 * psi / 60)


class FlowingAir:
    """Transducers and muscles: each a lag from the current to the pressure."""

    def __init__(self, muscles: int = 2) -> None:
        self.gain = 1.0  # of the transducers
        self.psi = [0.0] * muscles
        self.stuck = [False] * muscles

    def step(self, board: VirtualBoard, dt: float) -> None:
        for side in range(len(self.psi)):
            milliampere = 20 * board.drive[side] / 1599 if board.drive_enabled[side] else 0.0
            mapped = 2 + 58 * (milliampere - 4) / 16 if milliampere >= 4 else 0.0
            wanted = self.gain * mapped
            if not self.stuck[side]:
                self.psi[side] += (wanted - self.psi[side]) * dt / 0.25


class TurningSpool:
    """A geared motor with a dead zone; it can jam, and the body's air can pull."""

    def __init__(self) -> None:
        self.counts = 0.0
        self.speed = 0.0
        self.jammed = False
        self.pull = 0.0  # counts/s while braked
        self.wall = -math.inf
        self.unseen = False  # the encoder is unplugged
        self.share = 1.0  # of the counts that it shows
        self.shown = 0.0

    def step(self, board: VirtualBoard, dt: float) -> None:
        duty = board.motor
        wanted = math.copysign(1790 * max(0, abs(duty) - 60) / 740, duty)
        self.speed += (wanted - self.speed) * dt / 0.07
        if self.jammed:
            self.speed = 0.0
        elif duty == 0:
            self.speed = self.pull
        previous = self.counts
        self.counts = max(self.wall, self.counts + self.speed * dt)
        if not self.unseen:
            self.shown += self.share * (self.counts - previous)


@dataclass
class Heard:
    """A message from the board."""

    seq: int
    session: int
    message: wire.Message


def free(psi: float) -> float:
    """The guessed map, 1/cm."""
    return 0.04 * math.tanh(psi / 10)


def bend(left: float, right: float) -> float:
    """Curvature of a body that follows the guessed map, 1/cm."""
    return free(left) - free(right)


@dataclass
class Bench:
    """One board, its inputs, and a host."""

    seed: int = 1
    eeprom: bytes = b""
    mega: bool = False  # the Mega's image on the simulated chip, in place of the virtual board
    noise: float = 0.8
    beating: bool = True
    # Curvature that each sensor feels, as a function of both pressures; a test may replace it.
    body: Callable[[float, float], float] = lambda left, right: 0.0
    # What a pressure sensor makes of the true pressure, psi; a test may replace it.
    sensor: Callable[[float], float] = lambda psi: psi
    curvature: np.ndarray = field(default_factory=lambda: np.zeros(10))
    override: dict[int, float] = field(default_factory=dict)  # channel -> ideal count

    def __post_init__(self) -> None:
        self.board: EmulatedBoard = self.made()
        if self.noise:
            self.board.set_adc_noise(np.full(16, self.noise))
        self.air = FlowingAir(len(self.board.drive))
        self.spool = TurningSpool()
        self.heard: list[Heard] = []
        self.events: dict[int, wire.Event] = {}
        self.raw = bytearray()
        self.decoder = Decoder()
        self.session = 0
        self.seq = 0
        self.beats = 0
        self.nonce = 0
        self.counts = self.inputs()

    def made(self) -> EmulatedBoard:
        if self.mega:
            return SimulatedMega(self.seed, self.eeprom, boot_loader=False)
        return VirtualBoard(self.seed, self.eeprom)

    # --- time ------------------------------------------------------------------------------------

    def inputs(self) -> np.ndarray:
        """Ideal counts of the channels now."""
        counts = np.zeros(16)
        bend = self.curvature + self.body(*self.air.psi)
        counts[:10] = [flex_count(k) for k in bend]
        counts[10:12] = [pressure_count(self.sensor(p)) for p in self.air.psi]
        for channel, value in self.override.items():
            counts[channel] = value
        return counts

    def step(self, ms: int = STEP_MS) -> list[Heard]:
        fresh: list[Heard] = []
        for _ in range(ms // STEP_MS):
            if self.beating and self.session and self.board.now_us // 1000 % 100 == 0:
                self.beat()
            previous = self.spool.shown
            self.air.step(self.board, STEP_MS * 1e-3)
            self.spool.step(self.board, STEP_MS * 1e-3)
            now_us = self.inputs()
            self.board.set_analog(np.ascontiguousarray(np.stack([self.counts, now_us], axis=1)))
            self.board.set_encoder(previous, self.spool.shown)
            self.counts = now_us
            self.board.step(STEP_MS)
            fresh += self.listen()
        return fresh

    def listen(self) -> list[Heard]:
        data = self.board.read()
        self.raw += data
        fresh = [Heard(f.seq, f.session, f.message()) for f in self.decoder.feed(data)]
        for arrival in fresh:
            if isinstance(arrival.message, wire.Event):
                self.events[arrival.message.number] = arrival.message
        self.heard += fresh
        return fresh

    def until(self, condition: Callable[[], bool], ms: int = 20_000) -> None:
        for _ in range(ms // STEP_MS):
            if condition():
                return
            self.step()
        raise AssertionError(f"not within {ms} ms")

    # --- talk ------------------------------------------------------------------------------------

    def send(self, message: wire.Message, seq: int, session: int) -> None:
        self.board.write(encode(message, seq, session))

    def beat(self) -> None:
        self.beats += 1
        self.send(wire.Heartbeat(self.beats), 0, self.session)

    def ask(self, message: wire.Message, ms: int = 6000) -> wire.Message:
        self.seq = (self.seq + 1) & 0xFFFF
        self.send(message, self.seq, self.session)
        for _ in range(ms // STEP_MS):
            for arrival in self.step():
                answers = arrival.seq == self.seq and arrival.session == self.session
                if answers and isinstance(arrival.message, wire.Reply):
                    return arrival.message
        raise AssertionError(f"no reply to {message}")

    def get(self, message: wire.Message, kind: type[M]) -> M:
        reply = self.ask(message)
        assert isinstance(reply, kind), reply
        return reply

    def do(self, message: wire.Message, ms: int = 6000) -> int:
        reply = self.ask(message, ms)
        assert isinstance(reply, wire.Ack | wire.ParameterValue), reply
        assert reply.status == wire.Status.OK, reply
        return reply.detail if isinstance(reply, wire.Ack) else reply.value

    def refused(self, message: wire.Message) -> wire.Reason:
        reply = self.ask(message)
        assert isinstance(reply, wire.Ack), reply
        assert reply.status == wire.Status.REFUSED, reply
        return reply.reason

    def hello(self) -> wire.HelloReply:
        """Wait for the board, open a session, start the heart."""
        self.until(lambda: any(isinstance(h.message, wire.Announce) for h in self.heard), 2000)
        self.nonce += 1
        self.seq = self.beats = self.session = 0
        reply = self.get(wire.Hello(wire.PROTOCOL, wire.SCHEMA_HASH, self.nonce), wire.HelloReply)
        self.session = reply.session
        self.seq = 1
        self.beat()
        self.step(200)  # until the muscles have been seen empty
        return reply

    def status(self) -> wire.StatusReport:
        return self.get(wire.GetStatus(), wire.StatusReport)

    def set(self, name: str, value: int, element: int = 0) -> None:
        self.stage(name, value, element)
        self.do(wire.ApplyParameters())

    def stage(self, name: str, value: int, element: int = 0) -> None:
        self.do(wire.SetParameter(wire.PARAMETERS[name].index + element, value))

    def event(self, code: wire.EventCode, arg: int | None = None) -> list[wire.Event]:
        return [
            e
            for _, e in sorted(self.events.items())
            if e.code == code and (arg is None or e.arg == arg)
        ]

    def ended(self, activity: wire.Activity) -> bool:
        """Whether an activity has ended by itself."""
        return bool(self.event(wire.EventCode.ACTIVITY_DONE, activity))

    def highest_psi(self, ms: int) -> float:
        """Highest pressure in a muscle over a time."""
        highest = 0.0
        for _ in range(ms // STEP_MS):
            self.step()
            highest = max(highest, *self.air.psi)
        return highest

    def faults(self) -> tuple[wire.Fault, ...]:
        return wire.Fault.from_mask(self.status().faults)

    # --- to a useful place -----------------------------------------------------------------------

    def prepare(self, **parameters: int) -> Bench:
        """Hello, defaults and these parameters in memory, faults cleared, armed."""
        self.hello()
        self.do(wire.LoadDefaults())
        for name, value in {"settle_ms": 1000, "zero_ms": 200, **parameters}.items():
            self.stage(name, value)
        for side in range(2):
            self.stage("lag_ms", 0, side)  # this body bends at once
        self.do(wire.ApplyParameters())
        assert self.do(wire.ClearFaults(0xFFFF)) == 0
        self.do(wire.Arm())
        return self

    def grown(self, length_um: int = 100_000, **parameters: int) -> Bench:
        """Prepared, of confirmed length, in zone 0, settled."""
        self.prepare(**parameters)
        self.do(wire.ConfirmLength(length_um, 1))
        self.do(wire.SelectZone(0))
        return self

    def zeroed(self, length_um: int = 100_000, **parameters: int) -> Bench:
        """Grown, with zeros for all that has everted."""
        self.grown(length_um, **parameters)
        mask = self.status().everted_mask
        self.do(wire.ZeroSensors(mask))
        self.until(lambda: bool(self.event(wire.EventCode.ZEROED)))
        return self

    def grow(self, length_um: int = 200_000) -> None:
        """Begin to grow; the motor turns."""
        self.do(wire.GrowTo(length_um, 0))
        self.until(lambda: self.board.motor > 200)

    def bend(self) -> None:
        """Begin a sweep; the left muscle holds 10 psi."""
        self.do(wire.Sweep((1500, 1500), 20_000, 1, 0))
        self.until(lambda: self.air.psi[0] > 10)

    def safe(self) -> bool:
        """Whether valves carry true zero and the motor is braked."""
        return self.board.drive_enabled == (False, False) and self.board.braked
