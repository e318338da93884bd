"""A host that says exactly what a test tells it to, rules or not."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TypeVar

from thigmo.link import protocol as wire
from thigmo.link.framing import Decoder, Frame, encode
from thigmo.link.transport import Transport

M = TypeVar("M", bound=wire.Message)
ANSWER_S = 0.5
BEAT_S = 0.1
LONG_S = 15.0  # of commands that answer at their end


class RawMessage(wire.Message):
    """Any id with any payload."""

    def __init__(self, message_id: int, payload: bytes) -> None:
        self.ID = message_id  # type: ignore[misc]
        self.payload = payload

    def pack(self) -> bytes:
        return self.payload


class RawHost:
    """Frames to and from a board, without the client's help.

    Attributes:
        session, seq: of the conversation that `hello` opened.
        beating: sends heartbeats while it waits, as an armed board needs them.
    """

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        self.session = 0
        self.seq = 0
        self.decoder = Decoder()
        self.beating = False
        self._beat = 0
        self._beat_s = 0.0
        self._nonce = 1000
        self._frames: deque[Frame] = deque()

    def send(
        self, message: wire.Message, *, seq: int | None = None, session: int | None = None
    ) -> None:
        self.transport.write(
            encode(
                message,
                self.seq if seq is None else seq,
                self.session if session is None else session,
            )
        )

    def next_frame(self, wanted: Callable[[Frame], bool], timeout_s: float) -> Frame | None:
        """The next frame that is wanted; the others are thrown away."""
        until = self.transport.now() + timeout_s
        while True:
            while self._frames:
                frame = self._frames.popleft()
                if wanted(frame):
                    return frame
            left = until - self.transport.now()
            if left <= 0:
                return None
            if self.beating:
                self.beat()
                left = min(left, BEAT_S)
            self._frames += self.decoder.feed(self.transport.read(left))

    def beat(self) -> None:
        now = self.transport.now()
        if now >= self._beat_s:
            self._beat_s = now + BEAT_S
            self._beat += 1
            self.send(wire.Heartbeat(self._beat), seq=0)

    def listen(self, seconds: float) -> list[Frame]:
        """Everything that comes in so long."""
        frames: list[Frame] = []
        self.next_frame(lambda frame: frames.append(frame) or False, seconds)  # type: ignore[func-returns-value]
        return frames

    def drop_pending(self) -> None:
        self._frames.clear()
        self._frames += self.decoder.feed(self.transport.read(0.0))
        self._frames.clear()

    def answer(self, seq: int, session: int, timeout_s: float = ANSWER_S) -> Frame | None:
        """The reply to a frame; None if there is none in time."""
        return self.next_frame(
            lambda f: (f.seq, f.session) == (seq, session) and 0x80 <= f.id < 0xA0, timeout_s
        )

    def stop(self, nonce: int, *, seq: int = 0, session: int = 0) -> None:
        """Send a stop, and hear its echo."""
        self.send(wire.Stop(nonce), seq=seq, session=session)
        echo = self.next_frame(lambda f: f.id == wire.Stopped.ID, ANSWER_S)
        assert echo is not None, "no echo of a stop"
        assert echo.message() == wire.Stopped(nonce)

    def hello(self, nonce: int | None = None, seq: int = 0, resumes: int = 0) -> wire.HelloReply:
        """Open a conversation, or go on with one under another number."""
        if nonce is None:
            self._nonce += 1
            nonce = self._nonce
        hello = wire.Hello(wire.PROTOCOL, wire.SCHEMA_HASH, nonce)
        self.send(hello, seq=seq, session=resumes)
        frame = self.answer(seq, 0)
        assert frame is not None, "no answer to hello"
        reply = frame.message()
        assert isinstance(reply, wire.HelloReply)
        if reply.status is wire.Status.REFUSED:
            return reply
        self.session, self.seq = reply.session, seq
        self.beating = False
        self._beat, self._beat_s = 0, 0.0
        return reply

    def ask(self, message: wire.Message, timeout_s: float = ANSWER_S) -> wire.Message:
        """The reply to the next command, which is repeated once if the line lost it.

        A long command says that it is at work when it is repeated, and answers at its end.
        """
        self.seq = (self.seq + 1) & 0xFFFF
        for _ in range(2):
            self.send(message)
            frame = self.answer(self.seq, self.session, timeout_s)
            while frame is not None:
                reply = frame.message()
                if not isinstance(reply, wire.Ack) or reply.status is not wire.Status.IN_PROGRESS:
                    return reply
                frame = self.answer(self.seq, self.session, LONG_S)
        raise AssertionError(f"no answer to {message}")

    def get(self, message: wire.Command[M]) -> M:
        """The typed reply to a command that must not be refused."""
        reply = self.ask(message)
        assert type(reply) is message.REPLY, reply
        if isinstance(reply, wire.Ack):
            assert reply.status is wire.Status.OK, reply
        return reply  # type: ignore[return-value]

    def refusal(self, message: wire.Message) -> tuple[wire.Reason, int]:
        """Why a command that must be refused was, and the detail."""
        reply = self.ask(message)
        assert isinstance(reply, wire.Ack), reply
        assert reply.status is wire.Status.REFUSED, reply
        return reply.reason, reply.detail

    def save(self) -> int:
        self.seq = (self.seq + 1) & 0xFFFF
        self.send(wire.SaveConfig())
        frame = self.next_frame(
            lambda f: (
                f.id == wire.Ack.ID
                and f.seq == self.seq
                and f.payload[0] != wire.Status.IN_PROGRESS
            ),
            LONG_S,
        )
        assert frame is not None, "a save without an end"
        ack = frame.message()
        assert isinstance(ack, wire.Ack)
        assert ack.status is wire.Status.OK, ack
        return ack.detail
