"""A simulated Mega with its real boot loader behind a pseudo-terminal, for programs like avrdude.

Opening the port resets the chip, as DTR does. While bytes are under way the chip runs as fast as
it can; while both sides are silent it keeps to the wall clock, for the boot loader's and the
program's time-outs to fit each other.
"""

from __future__ import annotations

import contextlib
import os
import pty
import select
import threading
import time
import tty

from thigmo.emulator import mega_build
from thigmo.emulator.chip import CYCLES_PER_MS, Cause, Chip
from thigmo.emulator.mega_sim import BOOT_SECTION, ESTOP
from thigmo.link.image import read_hex

QUIET_MS = 5  # of device time without a byte, after which the wall clock rules


class PtyMega:
    """A context manager; `path` is the port."""

    def __init__(self, chip: Chip | None = None) -> None:
        if chip is None:
            chip = Chip()
            for address, data in read_hex(mega_build.BOOT_LOADER):
                chip.write("flash", address, data)
            chip.boot_at(BOOT_SECTION)
            chip.drive_pin(*ESTOP, False)
            chip.reset(Cause.POWER_ON)
        self.chip = chip
        self.opened = 0
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        self.path = os.ttyname(slave)
        os.close(slave)
        os.set_blocking(self._master, False)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> PtyMega:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        os.close(self._master)

    def _serve(self) -> None:
        poll = select.poll()
        poll.register(self._master, select.POLLIN | select.POLLHUP)
        open_now = False
        quiet = 0
        out = bytearray()
        while not self._stop.is_set():
            begun = time.monotonic()
            flags = dict(poll.poll(0)).get(self._master, 0)
            if bool(flags & select.POLLHUP) == open_now:
                open_now = not open_now
                if open_now:
                    self.opened += 1
                    self.chip.line_clear()
                    self.chip.reset(Cause.EXTERNAL)
                    out.clear()
            if not open_now:
                self._stop.wait(0.002)
                continue
            if flags & select.POLLIN:
                self.chip.send(os.read(self._master, 512))
                quiet = 0
            self.chip.run(self.chip.cycle + CYCLES_PER_MS)
            data, _ = self.chip.take()
            out += data
            if out:
                with contextlib.suppress(BlockingIOError):
                    del out[: os.write(self._master, out)]
            quiet = 0 if data or self.chip.line_backlog else quiet + 1
            if quiet > QUIET_MS:
                self._stop.wait(max(0.0, 0.001 - (time.monotonic() - begun)))
