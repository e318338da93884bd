"""The reference device behind a pseudo-terminal, in real time: what a serial port looks like.

A thread steps it by the monotonic clock. It keeps the device's times of the heartbeats that reached
it: where the computer is busy, device time slips against the wall clock, and stands still while the
host's port process is kept from running. A gap between beats is one that the device saw.
"""

from __future__ import annotations

import os
import select
import threading
import time
import tty

from port_holder import PortHolder
from reference_device import ReferenceDevice

_LONGEST_S = 0.05  # that passes at once


class PtyDevice:
    """A device on `port`; a context manager."""

    def __init__(self, device: ReferenceDevice) -> None:
        self.device = device
        self.beats: list[float] = []
        self._master, slave = os.openpty()
        tty.setraw(self._master)
        tty.setraw(slave)
        self.port = os.ttyname(slave)
        self._slave = slave  # kept open, or the master reads errors between two hosts
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self.lock = threading.Lock()

    def __enter__(self) -> PtyDevice:
        self._thread.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self.unplug()

    def unplug(self) -> None:
        """As if the cable were pulled: the port vanishes."""
        if not self._stop.is_set():
            self._stop.set()
            self._thread.join()
            os.close(self._master)
            os.close(self._slave)

    def now_s(self) -> float:
        """The device's time."""
        return self.device.now_us / 1e6

    def silent_for(self) -> float:
        """Seconds of the device's time since the last heartbeat."""
        return self.now_s() - self.beats[-1]

    def _run(self) -> None:
        holder, out = PortHolder(self.port), bytearray()
        due_s, last = 0.0, time.monotonic()
        while not self._stop.is_set():
            ready, _, _ = select.select([self._master], [], [], 0.005)
            if ready:
                holder.look()
            held_up = holder.held_up()
            with self.lock:
                if ready:
                    self.device.write(os.read(self._master, 4096))
                now = time.monotonic()
                due_s += 0.0 if held_up else min(now - last, _LONGEST_S)
                last = now
                self.device.step(int(due_s * 1000))
                due_s %= 0.001
                if len(self.device.beats) > len(self.beats):
                    self.beats += [self.now_s()] * (len(self.device.beats) - len(self.beats))
                out += self.device.read()
            if out and select.select([], [self._master], [], 0)[1]:
                del out[: os.write(self._master, out[:2048])]
