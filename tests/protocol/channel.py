"""A bad cable: loses, flips, truncates, inserts, duplicates and replays what passes.

`Channel` works on the chunks of one direction. `LoopTransport` joins a host to a device that
steps in milliseconds (the reference device, the virtual board) through one of them each way, in
virtual time, and can reset the device at any byte.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Callable
from typing import Protocol

from thigmo.link.heartbeat import Beat, HeartbeatSource

FAULTS = ("lose", "flip", "truncate", "drop_byte", "insert", "duplicate", "replay", "zero")


class Device(Protocol):
    """What both boards look like."""

    def step(self, ticks: int) -> None: ...
    def write(self, data: bytes) -> None: ...
    def read(self) -> bytes: ...
    def reset(self, cause: int) -> None: ...


class Channel:
    """Each chunk suffers one of the faults with a probability of `rate`."""

    def __init__(self, rng: random.Random, rate: float, faults: tuple[str, ...] = FAULTS) -> None:
        self.rate = rate
        self.faults = faults
        self._rng = rng
        self._past: deque[bytes] = deque(maxlen=200)
        self.injected = dict.fromkeys(faults, 0)

    def carry(self, data: bytes) -> bytes:
        """What arrives of what was sent."""
        if not data:
            return data
        self._past.append(data)
        if self._rng.random() >= self.rate:
            return data
        fault = self._rng.choice(self.faults)
        self.injected[fault] += 1
        result: bytes = getattr(self, f"_{fault}")(data)
        return result

    def _lose(self, data: bytes) -> bytes:
        return b""

    def _flip(self, data: bytes) -> bytes:
        broken = bytearray(data)
        for _ in range(self._rng.randint(1, 3)):
            broken[self._rng.randrange(len(broken))] ^= 1 << self._rng.randrange(8)
        return bytes(broken)

    def _truncate(self, data: bytes) -> bytes:
        return data[: self._rng.randrange(len(data))]

    def _drop_byte(self, data: bytes) -> bytes:
        at = self._rng.randrange(len(data))
        return data[:at] + data[at + 1 :]

    def _insert(self, data: bytes) -> bytes:
        at = self._rng.randrange(len(data) + 1)
        return data[:at] + self._rng.randbytes(self._rng.randint(1, 120)) + data[at:]

    def _zero(self, data: bytes) -> bytes:
        at = self._rng.randrange(len(data) + 1)
        return data[:at] + b"\0" + data[at:]

    def _duplicate(self, data: bytes) -> bytes:
        return data + data

    def _replay(self, data: bytes) -> bytes:
        stale = self._rng.choice(self._past)
        return stale + data if self._rng.random() < 0.5 else data + stale


class LoopTransport:
    """Host and device in one process, in virtual time: reading is what lets time pass."""

    virtual = True
    name = "loop"

    def __init__(
        self,
        device: Device,
        to_device: Channel | None = None,
        to_host: Channel | None = None,
    ) -> None:
        self.device = device
        clean = random.Random(0)
        self.to_device = to_device or Channel(clean, 0.0)
        self.to_host = to_host or Channel(clean, 0.0)
        self.read_s = 0.0
        self.reset_at: int | None = None  # the byte, counted both ways, at which the device resets
        self.bytes_passed = 0
        self.on_step: list[Callable[[], None]] = []
        self.cut = False  # the cable is out
        self._ticks = 0
        self._heartbeat: HeartbeatSource | None = None
        self._beats: deque[Beat] = deque(maxlen=64)
        self._inbound = b""

    def now(self) -> float:
        return self._ticks * 1e-3

    def write(self, data: bytes) -> None:
        self._deliver(self.to_device.carry(data))

    def read(self, timeout_s: float) -> bytes:
        end = self._ticks + max(0, math.ceil(timeout_s * 1000))
        while True:
            if self._inbound:
                data, self._inbound = self._inbound, b""
                self.read_s = self.now()
                return data
            if self._ticks >= end:
                return b""
            self._step()

    def start_heartbeat(self, session: int, period_s: float) -> None:
        self._heartbeat = HeartbeatSource(session, period_s)

    def stop_heartbeat(self) -> None:
        self._heartbeat = None

    def beats(self) -> list[Beat]:
        sent = list(self._beats)
        self._beats.clear()
        return sent

    def close(self) -> None:
        self._heartbeat = None

    def _step(self) -> None:
        self._ticks += 1
        if self._heartbeat is not None and (frame := self._heartbeat.beat(self.now())) is not None:
            self._beats.append(Beat(self._heartbeat.counter, self.now()))
            self.write(frame)
        self.device.step(1)
        for hook in self.on_step:
            hook()
        self._receive(self.to_host.carry(self.device.read()))

    def _count(self, data: bytes) -> int | None:
        """Bytes of this chunk before the reset, or None if it does not fall here."""
        before = self.bytes_passed
        self.bytes_passed += len(data)
        if self.reset_at is None or not before <= self.reset_at < self.bytes_passed:
            return None
        return self.reset_at - before

    def _deliver(self, data: bytes) -> None:
        if self.cut:
            return
        at = self._count(data)
        if at is None:
            self.device.write(data)
            return
        self.device.write(data[:at])
        self.reset_at = None
        self.device.reset(2)

    def _receive(self, data: bytes) -> None:
        if self.cut:
            return
        at = self._count(data)
        if at is None:
            self._inbound += data
            return
        self._inbound += data[:at]
        self.reset_at = None
        self.device.reset(2)
