"""The reference device behind a pseudo-terminal, in real time: what a serial port looks like.

A thread steps it by the monotonic clock. It keeps the device's times of the heartbeats that reached
it: where the computer is busy, device time slips against the wall clock, and a gap between beats is
one that the device saw.
"""

from __future__ import annotations

import os
import select
import threading
import time
import tty

from reference_device import ReferenceDevice

MOST_BEHIND_MS = 50


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
        began = time.monotonic()
        while not self._stop.is_set():
            ready, _, _ = select.select([self._master], [], [], 0.005)
            with self.lock:
                if ready:
                    self.device.write(os.read(self._master, 4096))
                behind = int((time.monotonic() - began) * 1000) - self.device.now_us // 1000
                if behind > MOST_BEHIND_MS:  # a busy computer: the device's time slips instead
                    began += (behind - MOST_BEHIND_MS) / 1000
                    behind = MOST_BEHIND_MS
                count = len(self.device.beats)
                self.device.step(behind)
                if len(self.device.beats) > count or len(self.device.beats) > len(self.beats):
                    self.beats += [self.now_s()] * (len(self.device.beats) - len(self.beats))
                out = self.device.read()
            if out and select.select([], [self._master], [], 0)[1]:
                os.write(self._master, out[:2048])
