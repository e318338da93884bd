"""A serial port, or any pyserial URL, held by a process of its own (`port_process`).

Here is the host's end: it starts that process, passes bytes, renews the heartbeat's lease whenever
the main thread reads or writes, and turns the process's complaints into typed errors.
"""

from __future__ import annotations

import queue
import subprocess
import sys
import threading
import time
from collections import deque
from contextlib import suppress
from weakref import WeakSet

from thigmo.errors import LinkError, PortError
from thigmo.link.heartbeat import Beat
from thigmo.link.pipe import Kind, Packet, read_packet, write_packet

_OPEN_S = 15.0  # a busy machine starts an interpreter slowly; socket:// waits for its peer
_TOUCH_S = 0.1
_QUEUE = 4096  # packets; if it is full, the port's process buffers, and at last drops, the oldest


# A main thread that has not touched its port for a while counts as hung, and the port's process
# then stops the robot. One that waits for the person beside the robot is not hung, which is a fact
# about the process: hence one list for it.
_open: WeakSet[SerialTransport] = WeakSet()


def waits_for_operator() -> None:
    """The main thread is about to wait for its operator: every port of this process hears of it."""
    for connection in list(_open):
        connection.attend()


class SerialTransport:
    """See `transport.Transport`; time is `time.monotonic`."""

    virtual = False

    def __init__(self, url: str, baud: int) -> None:
        """Open; raises PortError: missing, busy, not allowed, or no serial port."""
        self.name = url
        self.read_s = self._touched_s = self.now()
        self._beats: deque[Beat] = deque(maxlen=64)
        self._packets: queue.Queue[Packet | None] = queue.Queue(_QUEUE)
        self._failure: LinkError | None = None
        self._closing = threading.Event()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "thigmo.link.port_process", url, str(baud)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._to, self._from = self._process.stdin, self._process.stdout
        _open.add(self)
        self._collector = threading.Thread(target=self._collect, daemon=True)
        self._collector.start()
        try:
            self._await_open()
        except BaseException:
            self.close()
            raise

    def now(self) -> float:
        """Seconds of the monotonic clock, which both processes share."""
        return time.monotonic()

    @property
    def pid(self) -> int:
        """Process that holds the port."""
        return self._process.pid

    def write(self, data: bytes) -> None:
        """Send bytes; raises LinkError when the port is gone."""
        self._tell(Kind.WRITE, data)

    def read(self, timeout_s: float) -> bytes:
        """Bytes as soon as there are any; raises LinkError when the port is gone."""
        self._touch()
        until_s = self.now() + timeout_s
        while True:
            try:
                packet = self._packets.get(timeout=max(until_s - self.now(), 0.0))
            except queue.Empty:
                return b""
            self._touch()
            if packet is None:
                self._packets.put(None)  # every later read must see the end as well
                raise self._failure or LinkError(
                    f"the process that holds {self.name} died", "connect again"
                )
            if packet.kind == Kind.DATA:
                self.read_s = packet.t_s
                data: bytes = packet.value
                return data
            if packet.kind == Kind.BEATEN:
                self._beats.append(Beat(packet.value, packet.t_s))
            else:
                self._failure = packet.value
                raise packet.value

    def start_heartbeat(self, session: int, period_s: float) -> None:
        """Have the port's process send the heartbeat."""
        self._tell(Kind.START, (session, period_s))

    def stop_heartbeat(self) -> None:
        """Send no further heartbeats."""
        self._tell(Kind.HUSH)

    def attend(self) -> None:
        """The main thread waits for its operator now: no lease runs until it comes back."""
        if not self._closing.is_set() and self._failure is None:
            self._tell(Kind.ATTENDED)

    def beats(self) -> list[Beat]:
        """Heartbeats sent since the last call."""
        beats = list(self._beats)
        self._beats.clear()
        return beats

    def close(self) -> None:
        """Close the port and end its process."""
        if self._closing.is_set():
            return
        self._closing.set()
        with suppress(OSError):  # it is gone already
            write_packet(self._to, Packet(Kind.CLOSE))
            self._to.close()
        try:
            self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._collector.join()  # it has come to the stream's end
        self._from.close()

    def _tell(self, kind: Kind, value: object = None) -> None:
        self._touched_s = self.now()
        try:
            write_packet(self._to, Packet(kind, value))
        except (OSError, ValueError) as error:  # ValueError: closed here
            raise self._failure or LinkError(
                f"the process that holds {self.name} is gone", "connect again"
            ) from error

    def _touch(self) -> None:
        """Renew the heartbeat's lease; every read and write calls it, and so the main thread."""
        if self.now() - self._touched_s >= _TOUCH_S and self._failure is None:
            self._tell(Kind.LEASE)

    def _collect(self) -> None:
        """Thread: packets of the port's process into the queue; None marks their end."""
        while not self._closing.is_set():
            packet = read_packet(self._from)
            while not self._closing.is_set():
                with suppress(queue.Full):
                    self._packets.put(packet, timeout=0.2)
                    break
            if packet is None:
                return

    def _await_open(self) -> None:
        try:
            packet = self._packets.get(timeout=_OPEN_S)
        except queue.Empty:
            raise PortError(
                f"{self.name} did not open within {_OPEN_S:g} s", "check the address"
            ) from None
        if packet is None:
            raise PortError(f"the process for {self.name} did not start", "run the command again")
        if packet.kind == Kind.FAILED:
            raise packet.value
