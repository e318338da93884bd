"""A board on the desk: powered, muscles empty, nothing pressed; simulated or on a real port."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import pytest
from channel import LoopTransport
from raw_host import RawHost

from thigmo.emulator.board import EmulatedBoard
from thigmo.link import protocol as wire
from thigmo.link.transport import Transport, open_transport

SILENCE_S = 2.2  # a boot loader's 1.1 s, and two announces: a reset may cut the first frame
MAPS = list(product(range(3), range(2), wire.Branch))


@dataclass
class Stored:
    """A configuration, to be put back."""

    parameters: list[int]
    maps: list[tuple[int, ...]]
    generation: int


class Desk:
    """One board.

    Attributes:
        name: for messages.
        board: the simulated board, or None on a real port.
        host: who talks to it.
    """

    def __init__(self, name: str, board: EmulatedBoard | None) -> None:
        self.name = name
        self.board = board
        if board is not None:
            counts = np.full((16, 2), 660.0)
            counts[10:12] = 102.4  # empty muscles: 10 % of the supply
            board.set_analog(counts)
            self.transport: Transport = LoopTransport(board)
        else:
            self.transport = open_transport(name)
        self.host = RawHost(self.transport)
        self.boot = self.wait_for_boot()
        self.stored: Stored | None = None

    def wait_for_boot(self) -> wire.Announce | None:
        """Its first announce after opening or a restart; None if it did not restart."""
        frame = self.host.next_frame(lambda f: f.id == wire.Announce.ID, SILENCE_S)
        if frame is None:
            assert self.board is None, "a board that was reset announces itself"
            return None
        announce = frame.message()
        assert isinstance(announce, wire.Announce)
        return announce

    def restart(self) -> wire.Announce:
        """Reset the board: opening a port does, if it has DTR wired."""
        if self.board is not None:
            self.board.reset(wire.ResetCause.EXTERNAL)
            self.host.drop_pending()
        else:
            self.transport.close()
            self.transport = open_transport(self.name)
            self.host = RawHost(self.transport)
        announce = self.wait_for_boot()
        if announce is None:
            pytest.skip(f"{self.name} does not reset when it is opened")
        return announce

    def simulated(self) -> EmulatedBoard:
        """The board, for tests that press or cut something."""
        if self.board is None:
            pytest.skip("needs a simulated board")
        return self.board

    def calm(self) -> RawHost:
        """Hello, stop, defaults, no faults that can be cleared, no events."""
        host = self.host
        host.drop_pending()
        host.hello()
        if self.stored is None:
            self.stored = self._read()
        host.beating = False
        host.get(wire.Disarm())
        host.get(wire.ClearStop(host.get(wire.GetStatus()).stop_nonce))
        host.get(wire.LoadDefaults())
        host.get(wire.ClearFaults(0xFFFF))
        host.get(wire.AckEvent(host.get(wire.GetStatus()).event_number))
        for _ in range(10):  # after a restart its pressure filters take some milliseconds
            if host.get(wire.GetStatus()).conditions & wire.Condition.VENTED.mask:
                break
            host.listen(0.1)
        return host

    def ready(self) -> RawHost:
        """Calm and armed; a real robot whose sensors are not connected is no matter for this."""
        host = self.calm()
        faults = host.get(wire.GetStatus()).faults
        if faults and self.board is None:
            pytest.skip(f"faults keep {self.name} from arming: {wire.Fault.from_mask(faults)}")
        host.beating = True
        host.listen(0.05)
        host.get(wire.Arm())
        return host

    def put_back(self) -> None:
        """The configuration that was found; stored again if a test stored another."""
        if self.stored is None:
            return
        host = self.calm()
        for index, value in enumerate(self.stored.parameters):
            host.get(wire.SetParameter(index, value))
        host.get(wire.ApplyParameters())
        for place, values in zip(MAPS, self.stored.maps, strict=True):
            host.get(wire.SetMap(*place, values))
        if host.get(wire.GetStatus()).config_generation != self.stored.generation:
            host.save()

    def _read(self) -> Stored:
        host = self.host
        return Stored(
            [host.get(wire.GetParameter(n)).value for n in range(wire.PARAMETER_COUNT)],
            [host.get(wire.GetMap(*place)).curvature_e5 for place in MAPS],
            host.get(wire.GetStatus()).config_generation,
        )
