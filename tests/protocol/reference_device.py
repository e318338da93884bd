"""The board's side of the link in a hundred lines, by the rules of protocol/PROTOCOL.md.

The client is tested against it, and it keeps a log of what it executed, which the real firmware
does not. It steps in milliseconds like `thigmo.emulator._board.VirtualBoard`.
"""

from __future__ import annotations

import random
from collections import deque

from thigmo.link import protocol as wire
from thigmo.link.framing import Decoder, Frame, encode

SAVE_MS = 1700
TELEMETRY_MS = 5
ANNOUNCE_MS = 500
EVENT_MS = 100
NONCES = 8


class ReferenceDevice:
    """Executes set_parameter, get_parameter, save_config, get_status, ack_event; refuses the rest.

    Attributes:
        executed: (boot, message) of each command carried out, in order.
        stops: (time, nonce) of each copy of a stop.
        state: what its telemetry tells.
        counters: as get_link_stats would tell.
    """

    def __init__(self, seed: int = 0, schema_hash: int = wire.SCHEMA_HASH) -> None:
        self.schema_hash = schema_hash
        self.executed: list[tuple[int, wire.Message]] = []
        self.beats: list[tuple[int, int]] = []
        self.stops: list[tuple[int, int]] = []
        self.state = wire.State.SAFE
        self.counters = {"stale": 0, "repeats": 0, "bad": 0}
        self.now_us = 0
        self.boots = 0
        self.generation = 0
        self._rng = random.Random(seed)
        self.silent = False
        self._boot(wire.ResetCause.POWER_ON)

    def _boot(self, cause: wire.ResetCause) -> None:
        self.boots += 1
        self.boot_nonce = self._rng.getrandbits(32)
        self.cause = cause
        self.session = 0
        self._left = 0  # the session before this one, if its host came back
        self._decoder = Decoder()
        self._out = bytearray()
        self._last_seq = 0
        self._last_frame: Frame | None = None
        self._reply: wire.Message | None = None
        self._nonce: int | None = None
        self._nonces: deque[int] = deque(maxlen=NONCES)
        self._hello: bytes = b""
        self._beat = 0
        self._telemetry_seq = 0
        self._saving_ms = 0
        self._boot_us = self.now_us
        self.parameters = [d for p in wire.PARAMETERS.values() for d in p.defaults]
        self.events: deque[wire.Event] = deque()
        self._event_number = 0

    def reset(self, cause: int = wire.ResetCause.EXTERNAL) -> None:
        self._boot(wire.ResetCause(cause))

    def event(self, code: wire.EventCode, arg: int = 0, value: int = 0) -> None:
        self._event_number = (self._event_number + 1) & 0xFFFF
        self.events.append(wire.Event(self._event_number, code, self._t_us, arg, value))

    @property
    def _t_us(self) -> int:
        return (self.now_us - self._boot_us) & 0xFFFF_FFFF

    def step(self, ticks: int = 1) -> None:
        for _ in range(ticks):
            self.now_us += 1000
            ms = self._t_us // 1000
            if self._saving_ms:
                self._saving_ms -= 1
                if not self._saving_ms:
                    self.generation += 1
                    self._finish(wire.Ack(wire.Status.OK, wire.Reason.NONE, self.generation))
            if self.silent:
                continue
            if not self.session:
                if ms % ANNOUNCE_MS == 1:
                    self._send(self._announce(), 0, 0)
                continue
            if ms % EVENT_MS == 1:
                for event in self.events:
                    self._send(event, 0, self.session)
            if ms % TELEMETRY_MS == 0:
                self._telemetry_seq = (self._telemetry_seq + 1) & 0xFFFF
                flex = (ms & 0xFFF,) * 10
                row = wire.Telemetry(
                    self._t_us, flex, *((0, 0),) * 3, 0, 0, 0, 0, self.state << 4, 0
                )
                self._send(row, self._telemetry_seq, self.session)

    def write(self, data: bytes) -> None:
        if self.silent:
            return
        for frame in self._decoder.feed(data):
            self._handle(frame)
        self.counters["bad"] = self._decoder.bad

    def read(self) -> bytes:
        data = bytes(self._out)
        self._out.clear()
        return data

    def _send(self, message: wire.Message, seq: int, session: int) -> None:
        self._out += encode(message, seq, session)

    def _announce(self) -> wire.Announce:
        return wire.Announce(
            wire.PROTOCOL,
            self.schema_hash,
            (0, 1, 0),
            wire.BoardKind.VIRTUAL,
            self.boot_nonce,
            self.cause,
        )

    def _handle(self, frame: Frame) -> None:
        if frame.id == wire.Heartbeat.ID:
            counter = int.from_bytes(frame.payload, "little")
            if frame.session != self.session or counter <= self._beat:
                self.counters["stale"] += 1
                return
            self._beat = counter
            self.beats.append((self.now_us, counter))
            self._send(wire.Pulse(counter, self._t_us), 0, self.session)
            return
        if frame.id == wire.Stop.ID:
            self.stops.append((self.now_us, wire.Stop.unpack(frame.payload).nonce))
            self._send(wire.Stopped(self.stops[-1][1]), 0, 0)
            return
        if frame.id == wire.Hello.ID:
            self._take_hello(frame)
            return
        if frame.session != self.session or not self.session:
            self.counters["stale"] += 1
            refusal = wire.Ack(wire.Status.REFUSED, wire.Reason.BAD_SESSION, 0)
            self._send(refusal, frame.seq, frame.session)
            return
        if self._last_frame is not None and frame.seq == self._last_seq:
            if (frame.id, frame.payload) != (self._last_frame.id, self._last_frame.payload):
                self.counters["stale"] += 1
                return
            self.counters["repeats"] += 1
            pending = wire.Ack(wire.Status.IN_PROGRESS, wire.Reason.NONE, 0)
            self._send(self._reply or pending, frame.seq, frame.session)
            return
        if frame.seq != (self._last_seq + 1) & 0xFFFF:
            self.counters["stale"] += 1
            return
        self._last_seq, self._last_frame, self._reply = frame.seq, frame, None
        self._execute(frame.message())

    def _take_hello(self, frame: Frame) -> None:
        hello = wire.Hello.unpack(frame.payload)
        if hello.schema_hash != self.schema_hash:
            self._send(self._hello_reply(hello, wire.Reason.WRONG_SCHEMA), frame.seq, 0)
            return
        if frame.session and (not self.session or hello.host_nonce != self._nonce):
            self._send(self._hello_reply(hello, wire.Reason.BAD_SESSION), frame.seq, 0)
            return
        returns = frame.session != 0 and frame.session == self.session
        if hello.host_nonce == self._nonce and not returns:
            if frame.session in (0, self._left):
                self.counters["repeats"] += 1
                self._out += self._hello
            else:
                self.counters["stale"] += 1
            return
        late = self._nonce is not None and self._nonce - hello.host_nonce & 0xFFFF_FFFF < NONCES
        if (late or hello.host_nonce in self._nonces) and not returns:
            self.counters["stale"] += 1
            return
        self._left = frame.session
        self._nonce = hello.host_nonce
        self._nonces.append(hello.host_nonce)
        self.session = self._rng.randrange(1, 0x10000)
        self._last_seq, self._last_frame, self._reply = frame.seq, None, None
        self._beat = 0
        self._telemetry_seq = 0
        self._hello = encode(self._hello_reply(hello, wire.Reason.NONE), frame.seq, 0)
        self._out += self._hello

    def _hello_reply(self, hello: wire.Hello, reason: wire.Reason) -> wire.HelloReply:
        return wire.HelloReply(
            wire.Status.REFUSED if reason else wire.Status.OK,
            reason,
            wire.PROTOCOL,
            self.schema_hash,
            (0, 1, 0),
            wire.BoardKind.VIRTUAL,
            self.boot_nonce,
            0 if reason else self.session,
            self.cause,
            256,
            hello.host_nonce,
        )

    def _finish(self, reply: wire.Message) -> None:
        assert self._last_frame is not None
        self._reply = reply
        self._send(reply, self._last_frame.seq, self._last_frame.session)

    def _execute(self, message: wire.Message) -> None:
        ok = wire.Ack(wire.Status.OK, wire.Reason.NONE, 0)
        if isinstance(message, wire.SaveConfig):
            self.executed.append((self.boots, message))
            self._saving_ms = SAVE_MS
        elif isinstance(message, wire.SetParameter):
            self.executed.append((self.boots, message))
            self.parameters[message.index] = message.value
            self._finish(wire.ParameterValue(wire.Status.OK, message.index, message.value))
        elif isinstance(message, wire.GetParameter):
            value = self.parameters[message.index]
            self._finish(wire.ParameterValue(wire.Status.OK, message.index, value))
        elif isinstance(message, wire.AckEvent):
            while self.events and (message.number - self.events[0].number) & 0xFFFF < 0x8000:
                self.events.popleft()
            self._finish(ok)
        else:
            self._finish(wire.Ack(wire.Status.REFUSED, wire.Reason.WRONG_STATE, 0))
