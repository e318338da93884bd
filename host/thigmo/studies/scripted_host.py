"""A host that says given commands at given times, for studies that replay one session many times.

The full client measures round trips and waits for answers; a replay must say the same words at the
same milliseconds whatever the board answers. It beats the heart, acknowledges events and keeps
them; a refused command is an error of the script. Used by the trigger's study and by the tests that
compare the virtual board with the simulated Mega.
"""

from __future__ import annotations

from collections.abc import Sequence

from thigmo.emulator.board import Board
from thigmo.emulator.plant import STEP_MS
from thigmo.errors import LinkError
from thigmo.link import protocol as wire
from thigmo.link.framing import Decoder, encode
from thigmo.link.heart import PERIOD_S, Heart

Script = Sequence[tuple[int, wire.Message]]
"""Commands with the milliseconds at which they are said, in order of time."""


_HELLO_MS = 50


class ScriptedHost:
    """Call `exchange` before each step of the board, which was just started.

    Args:
        board: no session is open on it.
        script: what to say, from 100 ms on; the hello is said before that.
        step_ms: between exchanges.

    Attributes:
        t_ms: since the first exchange.
        events: of the board, each once, in their order.
    """

    def __init__(self, board: Board, script: Script, step_ms: int = STEP_MS) -> None:
        self.t_ms = 0
        self.step_ms = step_ms
        self.events: list[wire.Event] = []
        self._board = board
        self._script = list(script)
        self._decoder = Decoder()
        self._heart: Heart | None = None
        self._seq = 0
        self._said: dict[int, wire.Message] = {}

    def exchange(self) -> None:
        """Hear what came, say what is due.

        Raises:
            LinkError: the board refused a command.
        """
        for frame in self._decoder.feed(self._board.read()):
            message = frame.message()
            if isinstance(message, wire.HelloReply):
                self._heart = Heart(message.session, PERIOD_S)
            elif isinstance(message, wire.Ack) and message.status is wire.Status.REFUSED:
                raise LinkError(
                    f"{self._said.get(frame.seq)} was refused: {message.reason.key}",
                    "mend the script",
                )
            elif isinstance(message, wire.Event):
                self._take(message)
        if self.t_ms == _HELLO_MS:
            self._board.write(encode(wire.Hello(wire.PROTOCOL, wire.SCHEMA_HASH, 1), 0, 0))
        if self._heart is not None:
            while self._script and self._script[0][0] <= self.t_ms:
                self._say(self._script.pop(0)[1])
            beat = self._heart.beat(self.t_ms / 1000)
            if beat is not None:
                self._board.write(beat)
        self.t_ms += self.step_ms

    def _take(self, event: wire.Event) -> None:
        if not self.events or self.events[-1].number != event.number:
            self.events.append(event)
        self._say(wire.AckEvent(event.number))

    def _say(self, message: wire.Message) -> None:
        assert self._heart is not None
        self._seq = (self._seq + 1) & 0xFFFF
        self._said[self._seq] = message
        self._board.write(encode(message, self._seq, self._heart.session))
