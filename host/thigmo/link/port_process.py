"""The process that owns a serial port: relays its bytes and sends the heartbeat.

Run by `serial_port.SerialTransport` as `python -m thigmo.link.port_process URL BAUD`. It is a
process of its own because no thread of the host is safe from its interpreter lock: a long
compilation or fit would starve the heartbeat and put the robot into a fault. It imports little, and
talks over its standard streams (`pipe`).

The heartbeat is sent only while somebody is there to mind the robot: it stops when the host dies
(its stream ends, or this process has another parent) and when the host's main thread has not
touched the lease for 30 s, or 5 s while an output is energised; the next touch starts it again.
Either is a dead host, and an armed robot is then stopped (`stop`), so that a run that wakes up does
not carry on. While the body grows, the lease also ends with 12 mm of growth. Only a read or a write
touches the lease, in the thread that reacts to what the board says: a program that computes for
longer polls its robot meanwhile. The heartbeat holds while the board is mute, which may mean that
its boot loader is listening.

Stops also come from outside the host, which may hang: by Ctrl-C at its terminal (this process is
in the terminal's foreground group, as the host is), by a termination, and over a socket
(`stop_socket`).
"""

from __future__ import annotations

import errno
import math
import os
import signal
import sys
import threading
import time
from collections import deque
from typing import IO

import serial
from serial.tools.list_ports import comports

from thigmo.errors import LinkError, PortError
from thigmo.link.address import AddressLock
from thigmo.link.framing import Decoder, FrameError
from thigmo.link.heartbeat import HOLD_AFTER, HeartbeatSource
from thigmo.link.pipe import Kind, Packet, read_packet, write_packet
from thigmo.link.port_owner import owner
from thigmo.link.protocol import Activity, State, Telemetry
from thigmo.link.stop import Stopper
from thigmo.link.stop_socket import StopListener

LEASE_S = 30.0
ENERGISED_LEASE_S = 5.0  # a press or a motion that nobody minds
# Of the 2 cm that a dead host may cost; the rest is for the way of the stop, some 50 ms, and for
# the run-out of a spool at the highest speed that the board allows, 49 mm/s.
LEASE_UM = 12_000
_READ_S = 0.02
_READ_BYTES = 4096
_BACKLOG_BYTES = 4 << 20  # five minutes of telemetry for a host that does not read
_TICK_S = 0.02
_ORPHAN_S = 1.0  # for a dead host's stop to be confirmed
_STATE_S = 0.5  # age at which the state in the last telemetry no longer counts
# Time from a command until telemetry must show its motion: a board in motion sends a frame at least
# every 0.1 s, and a busy computer is late.
_SHOWN_S = 0.5
_ARMED = (State.READY, State.MOVING)


class Outbox:
    """Packets on their way to the host, written by a thread of their own.

    A host that does not read must stop neither the port nor the heartbeat: the oldest packets are
    dropped. Gaps in the numbers of telemetry tell so.
    """

    def __init__(self, stream: IO[bytes], backlog_bytes: int = _BACKLOG_BYTES) -> None:
        self._stream = stream
        self._limit = backlog_bytes
        self._packets: deque[Packet] = deque()
        self._size = 0
        self._closed = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def put(self, packet: Packet) -> None:
        """Queue a packet; never waits."""
        with self._changed:
            self._packets.append(packet)
            self._size += packet.size
            while self._size > self._limit:
                self._oldest()
            self._changed.notify()

    def close(self, wait_s: float) -> None:
        """Write the queued packets, for `wait_s` at most."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join(wait_s)

    def _oldest(self) -> Packet:
        packet = self._packets.popleft()
        self._size -= packet.size
        return packet

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._packets or self._closed)
                if not self._packets:
                    return
                packet = self._oldest()
            try:
                write_packet(self._stream, packet)
            except OSError:
                return  # the host is gone; the reader of its stream sees that too


class PortProcess:
    """The relay between one port and one host."""

    def __init__(self, port: serial.Serial, url: str, host_in: IO[bytes], outbox: Outbox) -> None:
        self.stopper = Stopper(time.monotonic)
        self._port = port
        self._url = url
        self._host = host_in
        self._outbox = outbox
        self._write_lock = threading.Lock()  # frames of heartbeat and host must not interleave
        self._heart_lock = threading.Lock()
        self._heartbeat: HeartbeatSource | None = None
        self._lease_s = self._written_s = time.monotonic()
        self._attended = False  # the main thread waits for its operator
        self._still_s = -math.inf  # time of the last telemetry without an energised output
        self._lease_ended = False
        self._touched_um: int | None = None  # length at the last touch, while the body grows
        self._decoder = Decoder()
        self._disarmed_until_s = -math.inf  # as far as its telemetry says
        self._leaving = threading.Lock()
        self._end = threading.Event()
        self._finished = threading.Event()  # nothing more is sent or heard
        self._parent = os.getppid()

    def run(self, stops: StopListener) -> None:
        """Relay until the host closes, dies, or the port is lost. Those who have called for a stop
        by then are answered; the port may be closed afterwards.
        """
        port = [
            threading.Thread(target=target, daemon=True) for target in (self._receive, self._beat)
        ]
        for thread in (*port, threading.Thread(target=self._obey, daemon=True)):
            thread.start()
        self._end.wait()
        with self._heart_lock:
            self._heartbeat = None
        stops.close()
        self._finished.set()
        for thread in port:
            thread.join()

    def leave(self) -> None:
        """Stop the robot that nobody minds any more, and end."""
        if not self._leaving.acquire(blocking=False):
            return
        with self._heart_lock:
            minded, self._heartbeat = self._heartbeat is not None, None
        if minded and self._may_move():
            self.stopper.stop(_ORPHAN_S)
        self._end.set()

    def _limit_s(self) -> float:
        """For how long the host may leave the lease untouched.

        Only a command energises an output, and telemetry shows it soon after: a board that was
        still by then is still until the next command.
        """
        if self._still_s - self._written_s <= _SHOWN_S:
            return ENERGISED_LEASE_S
        return math.inf if self._attended else LEASE_S

    def _may_move(self) -> bool:
        """Whether the board may be armed: one that lately said that it is not need not be stopped,
        and its next host needs no operator."""
        return time.monotonic() > self._disarmed_until_s

    def _fail(self, error: Exception) -> None:
        self.stopper.end()
        if not self._end.is_set():
            number, text = _cause(error)
            failure = LinkError(
                f"{self._url} was lost: {os.strerror(number) if number else text}",
                "check the cable and the board's power, and connect again",
            )
            self._outbox.put(Packet(Kind.FAILED, failure))
        self._end.set()

    def _send(self, data: bytes) -> None:
        try:
            with self._write_lock:
                self._port.write(data)
        except serial.SerialTimeoutException:
            pass  # a device that takes no bytes: the frame is lost, and the client repeats it
        except OSError as error:
            self._fail(error)

    def _receive(self) -> None:
        while not self._finished.is_set():
            try:
                data = self._port.read(1)
                # socket:// only says whether there are bytes, not how many: hence the loop.
                while data and len(data) < _READ_BYTES and (waiting := self._port.in_waiting):
                    data += self._port.read(min(waiting, _READ_BYTES))
            except OSError as error:
                self._fail(error)
                return
            if data:
                self.stopper.heard()
                heartbeat = self._heartbeat
                if heartbeat is not None:
                    heartbeat.heard()
                self._watch(data)
                self._outbox.put(Packet(Kind.DATA, data, time.monotonic()))

    def _watch(self, data: bytes) -> None:
        """Look for the board's state, and for the echo of a stop."""
        for frame in self._decoder.feed(data):
            self.stopper.take(frame)
            try:
                row = frame.message()
            except FrameError:
                continue  # another schema's
            if isinstance(row, Telemetry):
                armed = row.state_activity >> 4 in _ARMED
                self._disarmed_until_s = -math.inf if armed else time.monotonic() + _STATE_S
                moves = row.state_activity >> 4 == State.MOVING or row.motor != 0
                self._still_s = -math.inf if moves or any(row.drive) else time.monotonic()
                self._watch_growth(row)

    def _watch_growth(self, row: Telemetry) -> None:
        """Stop a robot that grows on while its host hangs."""
        if row.state_activity & 0xF != Activity.GROWING:
            self._touched_um = None
        elif (touched_um := self._touched_um) is None:
            self._touched_um = row.length_um
        elif row.length_um - touched_um > LEASE_UM:
            self._touched_um = None
            self.stopper.call()

    def _beat(self) -> None:
        """Thread: the heartbeat, the lease, and the repeats of a stop."""
        while not self._finished.wait(_TICK_S):
            if os.getppid() != self._parent and not self._leaving.locked():
                threading.Thread(target=self.leave, daemon=True).start()
            now = time.monotonic()
            frame = self.stopper.frame()
            if frame is not None:
                self._send(frame)
            with self._heart_lock:
                heartbeat = self._heartbeat
                if heartbeat is None:
                    continue
                if now - self._lease_s > self._limit_s():
                    if not self._lease_ended and self._may_move():
                        self.stopper.call()
                    self._lease_ended = True
                    continue
                self._lease_ended = False
                frame = heartbeat.beat(now)
                if frame is not None:
                    self._outbox.put(Packet(Kind.BEATEN, heartbeat.counter, time.monotonic()))
                    self._send(frame)

    def _obey(self) -> None:
        while not self._end.is_set():
            packet = read_packet(self._host)
            if packet is None:  # the host died
                self.leave()
                return
            if packet.kind == Kind.CLOSE:
                self._end.set()
                return
            self._lease_s = time.monotonic()
            self._attended = packet.kind == Kind.ATTENDED
            self._touched_um = None
            if packet.kind == Kind.WRITE:
                self._written_s = time.monotonic()
                self._send(packet.value)
            elif packet.kind == Kind.START:
                session, period_s = packet.value
                with self._heart_lock:
                    self._heartbeat = HeartbeatSource(session, period_s, hold_after=HOLD_AFTER)
            elif packet.kind == Kind.HUSH:
                with self._heart_lock:
                    self._heartbeat = None


def _cause(error: Exception) -> tuple[int, str]:
    """The errno of a failure, 0 if it has none, and its text."""
    number = getattr(error, "errno", None)
    cause = error.__context__  # termios.error has no errno, but pyserial's words around it
    if number is None and cause is not None and cause.args and isinstance(cause.args[0], int):
        number = cause.args[0]
    return number or 0, str(error)


def port_error(name: str, error: Exception) -> PortError:
    """The operator's error for a port that did not open."""
    number, text = _cause(error)
    lowered = text.lower()
    denied = number in (errno.EACCES, errno.EPERM)
    busy = number == errno.EBUSY or "exclusively lock" in lowered or "resource busy" in lowered
    if busy or (denied and os.name == "nt"):  # Windows says "access denied" for a port in use
        return PortError(f"{name} is in use{owner(name)}", "close the program that has it open")
    if denied:
        return PortError(
            f"no permission to open {name}",
            "add yourself to the group that owns it (often dialout or uucp) and sign in again",
        )
    ports = ", ".join(sorted(port.device for port in comports()))
    step = f"give one of: {ports}" if ports else "plug the board in: no serial port is there now"
    if number == errno.ENOENT or "filenotfound" in lowered or "no such file" in lowered:
        return PortError(f"there is no port {name}", step)
    if number in (errno.ENOTTY, errno.EISDIR, errno.EINVAL, errno.ENODEV, errno.ENXIO):
        return PortError(f"{name} is no serial port", step)
    if "not known" in lowered or "invalid url" in lowered:
        return PortError(f"{name} is no address that can be opened", step)
    step = "check that its server is running" if "://" in name else step
    return PortError(f"cannot open {name}: {text}", step)


def main() -> int:
    """Open the port named by the arguments and relay."""
    url, baud = sys.argv[1], int(sys.argv[2])
    # What the terminal sends to the host reaches this process as well, and must not end it: it is
    # needed to stop the robot.
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGTSTP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    outbox = Outbox(sys.stdout.buffer)
    program = os.getppid()  # which drives the robot
    try:
        lock = AddressLock(url, program)
        port = serial.serial_for_url(
            url, baudrate=baud, timeout=_READ_S, write_timeout=1.0, exclusive=True
        )
        relay = PortProcess(port, url, sys.stdin.buffer, outbox)
        stops = StopListener(url, relay.stopper.stop, program=program)
    except (OSError, ValueError, PortError) as error:
        failure = error if isinstance(error, PortError) else port_error(url, error)
        outbox.put(Packet(Kind.FAILED, failure))
        outbox.close(2.0)
        return 1
    outbox.put(Packet(Kind.OPENED))
    signal.signal(signal.SIGINT, lambda number, frame: relay.stopper.call())
    signal.signal(signal.SIGTERM, lambda number, frame: relay.stopper.call())
    relay.run(stops)
    port.close()
    lock.close()
    outbox.close(0.5)
    # The thread that reads the host's stream may hold its lock; a normal exit would wait for it.
    os._exit(0)


if __name__ == "__main__":
    sys.exit(main())
