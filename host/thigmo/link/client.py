"""One conversation with a board: hello, commands, events, telemetry.

The client keeps one command outstanding, repeats it after a time-out measured from past round
trips until its deadline, and ends it in its typed reply or a typed error: never in two executions.
A command that found no answer ends the session, for a late copy of it must find the board deaf.
Events are acknowledged on their own, telemetry is counted, and a board that restarted is reported
from one that is slow by its boot nonce. Rules of the protocol: protocol/PROTOCOL.md.

Nothing here sleeps or asks a clock but the transport's: reading is waiting.
"""

from __future__ import annotations

import secrets
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeVar, cast

from thigmo.closing import Closing
from thigmo.errors import CommandRefusedError, CommandTimeoutError, LinkError
from thigmo.link import failures
from thigmo.link import protocol as wire
from thigmo.link.framing import Decoder, Frame, FrameError, encode
from thigmo.link.heartbeat import PERIOD_S
from thigmo.link.inbox import Inbox
from thigmo.link.round_trip import RoundTrip
from thigmo.link.stop import CONFIRM_S, REPEAT_S, UNCONFIRMED_CURE, StopCall
from thigmo.link.transport import Transport

R = TypeVar("R", bound=wire.Message)
Direction = Literal["tx", "rx"]
Tap = Callable[[Direction, bytes, float], None]

# The boot loader listens for 0.84 s after a reset and must hear nothing
# (docs/hardware/facts.md, The Mega). The first announce comes at the start of the firmware, so
# 1.6 s without one is a board that did not reset.
SILENCE_S = 1.6
# A stray byte keeps the boot loader for 9.3 s: a second, silent, wait before giving up.
BOOT_LOADER_S = 10.0
_IN_PROGRESS_S = 0.1
# A main thread that comes so late to its reading may have starved the thread that collects for it:
# it gets as long again before silence counts.
_LATE_S = 0.05
_SHORTEST_S = 1e-6
_NONCES = 32
_FOREIGN = 10  # frames of another session in a row: old ones that a bridge replays are fewer


@dataclass(slots=True)
class _Outstanding:
    """The command that waits for its answer."""

    message: wire.Command[Any]
    frame: bytes
    seq: int
    session: int
    deadline_s: float
    sent_s: float = 0.0
    next_s: float = 0.0
    attempts: int = 0
    answer: wire.Message | None = None
    orphaned: bool = False  # the board no longer knows the session
    refused_by: int | None = None  # hash of the schema of a board that refused a hello
    boot: int | None = None  # nonce of that board's boot
    cause: int = 0  # of its last reset


class Client(Inbox, Closing):
    """A conversation over a transport. A context manager: leaving it closes the transport."""

    def __init__(
        self, transport: Transport, *, connect: bool = True, heartbeat_s: float = PERIOD_S
    ) -> None:
        """Take an open transport, to close it with the client or if nobody answers; say hello."""
        super().__init__()
        self.transport = transport
        # Called with every good frame in and every frame out: direction, the bytes on the wire
        # without the closing zero, host time.
        self.taps: list[Tap] = []
        self._hello: wire.HelloReply | None = None
        self._capacity: wire.Capacity | None = None
        self._nonce = secrets.randbits(32)  # counts up: the board knows late copies of a hello
        self._heartbeat_s = heartbeat_s
        self._decoder = Decoder()
        self._round_trip = RoundTrip()
        self._seq = 0
        self._outstanding: _Outstanding | None = None
        self._broken: LinkError | None = None
        self._talking = False  # a session is open and no time-out has spoilt it
        self._connected = False  # a hello was answered, and no other `connect` has begun
        self._announce: wire.Announce | None = None
        self._other_hash: int | None = None
        self._strange = 0  # whole frames, heard before a hello was answered, that nobody here reads
        self._nonces: deque[int] = deque(maxlen=_NONCES)
        self._stop_call: StopCall | None = None
        self._heard_s = float("-inf")
        self._foreign = 0  # telemetry of another host's session, in a row
        self._handling = False
        if connect:
            try:
                self.connect()
            except BaseException:
                self.close()
                raise

    # Life.

    def close(self) -> None:
        """Stop the heartbeat and close the transport. Commands nothing: the board's limit acts."""
        self._talking = self._connected = False
        self.transport.close()

    @property
    def hello(self) -> wire.HelloReply:
        """Who the board is; raises LinkError before the first hello."""
        if self._hello is None:
            raise LinkError("no session with a board yet", "connect first")
        return self._hello

    @property
    def capacity(self) -> wire.Capacity:
        """What the board holds; asked once."""
        if self._capacity is None:
            self._capacity = self.request(wire.GetCapacity())
        return self._capacity

    @property
    def parameters(self) -> dict[str, wire.Parameter]:
        """The board's parameter table, by name."""
        has = self.capacity
        return wire.parameters(
            muscles=has.muscles, sensors=has.sensors, body_pressures=has.body_pressures,
            imus=has.imus,
        )  # fmt: skip

    def now(self) -> float:
        """Host seconds, by the transport's clock."""
        return self.transport.now()

    def connect(self) -> wire.HelloReply:
        """Open, or open again after a `BoardResetError`, a conversation.

        Listens before it speaks: opening a port may have reset the board, and its boot loader must
        hear nothing. Raises SchemaMismatchError for a board of another schema, NotARobotError if
        nothing, or something else, answers.
        """
        self._check_reentry()
        self.transport.stop_heartbeat()
        self._broken = None
        self._talking = self._connected = False
        self._outstanding = None
        self._announce = self._other_hash = self._capacity = None
        self._strange = 0
        garbage, frames = self._decoder.garbage, self._decoder.frames
        self._listen(SILENCE_S)
        if self._say_hello(wire.Hello.DEADLINE_S) is None:
            self._announce = None
            self._listen(BOOT_LOADER_S)
            if self._announce is None or self._say_hello(wire.Hello.DEADLINE_S) is None:
                if self._other_hash is not None:
                    raise failures.other_schema(self._other_hash, self.transport)
                raise failures.nobody(
                    self.transport,
                    announced=self._announce is not None,
                    frames=self._decoder.frames - frames,
                    strange=self._strange,
                    garbage=self._decoder.garbage - garbage,
                )
        return self.hello

    # Commands.

    def request(self, command: wire.Command[R], deadline_s: float | None = None) -> R:
        """Send a command and wait for its answer, for the schema's deadline if none is given.

        Raises:
            CommandRefusedError: the board said no; `reason` holds the schema's name for why.
            CommandTimeoutError: no answer by the deadline; it is unknown whether it was done.
            BoardResetError: the board restarted meanwhile; `connect` again.
            LinkError: the connection is gone, or the board talks to somebody else.
        """
        self._check_reentry()
        limit = command.DEADLINE_S if deadline_s is None else deadline_s
        until_s = self.now() + limit
        self._raise_if_broken()
        while self._outstanding is not None:  # an acknowledgement of an event
            self._pump(until_s)
            self._raise_if_broken()
            if self._outstanding is not None and self.now() >= until_s:
                raise failures.timed_out(command, limit)
        reply: wire.Message | None = None
        while reply is None:
            if not self._talking:
                self._resume(command, limit, until_s)
            outstanding = self._begin(command, until_s)
            reply = self._settle(outstanding, until_s)
            # An orphan that was sent once was surely not done, and may go again; one that was
            # repeated may have been done before the session was lost.
            if reply is None and not (outstanding.orphaned and outstanding.attempts == 1):
                if outstanding.orphaned:
                    self._resume(command, limit, until_s)
                raise failures.timed_out(command, limit)
        if isinstance(reply, wire.Ack) and reply.status is wire.Status.REFUSED:
            problem, step = reply.reason.words
            raise CommandRefusedError(
                f"the board refused {command.NAME}: {problem[:1].lower()}{problem[1:]}",
                step,
                reason=reply.reason.key,
                detail=reply.detail,
            )
        return cast("R", reply)

    def stop(self, within_s: float = CONFIRM_S) -> None:
        """Stop the robot, past any command that waits for its answer, and wait for the echo.

        Needs no conversation: it stops a board of any schema, in any state. The board's outputs
        are off then, and its fault `stopped` stays latched until an operator clears it. Raises
        CommandTimeoutError without an echo in time.
        """
        self._check_reentry()
        began_s = self.now()
        call = self._stop_call = StopCall(began_s, self._heard_s)
        while not call.confirmed:
            now_s = self.now()
            if now_s >= began_s + within_s:
                raise CommandTimeoutError(
                    f"the board did not confirm the stop within {within_s:g} s",
                    UNCONFIRMED_CURE,
                )
            frame = call.frame(now_s)
            if frame is not None:
                self._write(frame)
            self._pump(now_s + REPEAT_S)

    # Waiting.

    def poll(self, timeout_s: float = 0.0) -> None:
        """Handle what has arrived; wait up to `timeout_s` for the first bytes."""
        self._check_reentry()
        self._raise_if_broken()
        self._pump(self.now() + timeout_s)
        self._raise_if_broken()

    def wait_for(self, predicate: Callable[[], bool], timeout_s: float) -> bool:
        """Handle what arrives until the predicate holds; whether it does in time."""
        until_s = self.now() + timeout_s
        while not predicate():
            left_s = until_s - self.now()
            if left_s <= 0:
                return False
            self.poll(left_s)
        return True

    # Sending.

    def _write(self, frame: bytes) -> None:
        now = self.now()
        self.transport.write(frame)
        self._writes.append(now)
        for tap in self.taps:
            tap("tx", frame.strip(b"\0"), now)

    def _begin(
        self, command: wire.Command[Any], until_s: float, *, resumes: bool = False
    ) -> _Outstanding:
        """Make a command the outstanding one and send it.

        It is of the running session, or a hello: of none, or of the one that it resumes.
        """
        hello = isinstance(command, wire.Hello)
        session = 0 if hello and not resumes else self.session
        self._seq = 0 if hello else (self._seq + 1) & 0xFFFF
        frame = encode(command, self._seq, session)
        self._outstanding = _Outstanding(command, frame, self._seq, session, until_s)
        self._transmit(self._outstanding)
        return self._outstanding

    def _transmit(self, outstanding: _Outstanding) -> None:
        outstanding.sent_s = self.now()
        outstanding.next_s = outstanding.sent_s + self._round_trip.timeout_s
        outstanding.attempts += 1
        if outstanding.attempts > 1:
            self.stats.repeats += 1
        self._write(outstanding.frame)

    def _settle(self, outstanding: _Outstanding, until_s: float) -> wire.Message | None:
        """Wait for a command's answer; None if it ended without one."""
        while outstanding.answer is None and self._outstanding is outstanding:
            self._pump(until_s)
            self._raise_if_broken()
        return outstanding.answer

    def _say_hello(self, limit_s: float) -> wire.HelloReply | None:
        """Open a session; None if nobody answers in time. Raises SchemaMismatchError."""
        self._nonce = (self._nonce + 1) & 0xFFFF_FFFF
        hello = wire.Hello(wire.PROTOCOL, wire.SCHEMA_HASH, self._nonce)
        until_s = self.now() + limit_s
        outstanding = self._begin(hello, until_s)
        reply = self._settle(outstanding, until_s)
        if outstanding.refused_by is not None:
            raise failures.other_schema(outstanding.refused_by, self.transport)
        if not isinstance(reply, wire.HelloReply):
            return None
        new_boot = self._hello is None or reply.boot_nonce != self._hello.boot_nonce
        if reply.boot_nonce not in self._nonces:
            self._nonces.append(reply.boot_nonce)
        self._open(reply, new_boot)
        return reply

    def _open(self, reply: wire.HelloReply, new_boot: bool) -> None:
        self._hello = reply
        self._begin_session(reply.session, new_boot)
        self._talking = self._connected = True
        self._foreign = 0
        self.stats.hellos += 1
        self.transport.start_heartbeat(reply.session, self._heartbeat_s)

    def _resume(self, command: wire.Message, limit_s: float, until_s: float) -> None:
        """Open a new session after a lost one, by a command's deadline. Motion is not stopped."""
        previous = self.hello
        hello = wire.Hello(wire.PROTOCOL, wire.SCHEMA_HASH, previous.host_nonce)
        outstanding = self._begin(hello, until_s, resumes=True)
        reply = self._settle(outstanding, until_s)
        if isinstance(reply, wire.HelloReply):
            self._open(reply, new_boot=False)
        elif outstanding.boot == previous.boot_nonce:
            raise failures.taken_over()
        elif outstanding.refused_by == wire.SCHEMA_HASH:
            raise failures.restarted(wire.ResetCause(outstanding.cause))
        elif outstanding.refused_by is not None:
            raise failures.other_schema(outstanding.refused_by, self.transport)
        else:
            raise failures.timed_out(command, limit_s)

    # Receiving.

    def _listen(self, limit_s: float) -> None:
        """Send nothing until the board announces itself, or `limit_s` have passed."""
        until_s = self.now() + limit_s
        while self._announce is None and self.now() < until_s:
            self._pump(until_s)

    def _pump(self, until_s: float) -> None:
        """Read once, waiting until `until_s` at most; handle the bytes, and send what is due."""
        if self._outstanding is None and self._ack_due is not None and self._talking:
            number, self._ack_due = self._ack_due, None
            self._begin(wire.AckEvent(number), self.now() + wire.AckEvent.DEADLINE_S)
        now = self.now()
        wake_s = until_s
        if self._outstanding is not None:
            wake_s = min(wake_s, self._outstanding.next_s, self._outstanding.deadline_s)
        # What rounding leaves of a wait must not be too short for a virtual clock to step.
        data = self.transport.read(max(wake_s - now, _SHORTEST_S) if wake_s > now else 0.0)
        if not data and now > wake_s + _LATE_S:
            data = self.transport.read(_LATE_S)
        self._note_beats()
        if data:
            # A backlog is judged by when it came: a busy main thread is no silent board.
            self._take(data, self.transport.read_s)
            self._repeat(self.transport.read_s)
        else:
            self._repeat(self.now())

    def _repeat(self, now_s: float) -> None:
        outstanding = self._outstanding
        if outstanding is None:
            return
        if now_s >= outstanding.deadline_s:
            self._outstanding = None
            self._talking = False
            self.stats.timeouts += 1
        elif now_s >= outstanding.next_s:
            self._round_trip.back_off()
            self._transmit(outstanding)

    def _note_beats(self) -> None:
        for beat in self.transport.beats():
            self._beat_sent(beat)
            if self.taps:
                frame = encode(wire.Heartbeat(beat.counter), 0, self.session)[:-1]
                for tap in self.taps:
                    tap("tx", frame, beat.t_s)

    def _take(self, data: bytes, t_s: float) -> None:
        frames = self._decoder.feed(data)
        self._heard_s = self.now()
        if self._stop_call is not None:
            self._stop_call.heard(self._heard_s)
        self.stats.bad_frames = self._decoder.bad
        self._handling = True
        try:
            for frame in frames:
                for tap in self.taps:
                    tap("rx", frame.wire, t_s)
                self._handle(frame, t_s)
        finally:
            self._handling = False

    def _handle(self, frame: Frame, t_s: float) -> None:
        if frame.id == wire.Telemetry.ID:
            self._watch_session(frame.session)
            if wire.Telemetry.fits(frame.payload):
                self._take_telemetry(frame, t_s)
            else:
                self._strange += 1
            return
        if frame.id == wire.Stopped.ID and self._stop_call is not None:
            self._stop_call.take(frame)
            return
        if frame.id == wire.HelloReply.ID and self._refused(frame.payload):
            return
        try:
            message = frame.message()
        except FrameError:
            if frame.id == wire.Announce.ID and len(frame.payload) == wire.Announce.SIZE:
                # The layout of an announce is the same in every schema (`frozen`).
                self._other_hash = int.from_bytes(frame.payload[1:5], "little")
            else:
                self._strange += 1
            return
        if isinstance(message, wire.Announce):
            self._take_announce(message)
        elif isinstance(message, wire.Reply):
            self._take_reply(message, frame, t_s)
        elif isinstance(message, wire.Pulse) and frame.session == self.session:
            self._take_pulse(message, t_s)
        elif isinstance(message, wire.Event) and frame.session == self.session:
            self._take_event(message, t_s)

    def _refused(self, payload: bytes) -> bool:
        """Notice a hello's refusal, maybe by a board whose enumerations are unknown here.

        The layout of hello_reply is the same in every schema (`frozen` in schema.yaml).
        """
        outstanding = self._outstanding
        if outstanding is None or len(payload) != wire.HelloReply.SIZE:
            return False
        hello, nonce = outstanding.message, int.from_bytes(payload[-4:], "little")
        ours = isinstance(hello, wire.Hello) and hello.host_nonce == nonce
        schema_hash = int.from_bytes(payload[3:7], "little")
        if not ours or (schema_hash == wire.SCHEMA_HASH and payload[0] != wire.Status.REFUSED):
            return False
        outstanding.refused_by = schema_hash
        outstanding.boot, outstanding.cause = int.from_bytes(payload[11:15], "little"), payload[17]
        self._outstanding = None
        return True

    def _watch_session(self, session: int) -> None:
        """Notice that the board talks to somebody else, though this host asks it nothing."""
        if session == self.session or self._outstanding is not None or not self._talking:
            self._foreign = 0
            return
        self._foreign += 1
        if self._foreign == _FOREIGN:
            self._talking = False
            self._broken = failures.taken_over()

    def _take_announce(self, message: wire.Announce) -> None:
        self._announce = message
        if message.schema_hash != wire.SCHEMA_HASH:
            self._other_hash = message.schema_hash
        if message.boot_nonce in self._nonces:
            return  # heard before: it waits for a hello, or is a replay
        self._nonces.append(message.boot_nonce)
        if self._connected:  # a new boot
            self._talking = False
            self._outstanding = None
            self._broken = failures.restarted(message.reset_cause)

    def _take_reply(self, message: wire.Message, frame: Frame, t_s: float) -> None:
        outstanding = self._outstanding
        if outstanding is None:
            return
        request = outstanding.message
        if isinstance(request, wire.Hello):
            # Its header may be another schema's business; the nonce is what makes it ours.
            # That of a hello which resumes is as old as the conversation: its session must be new.
            ours = (
                isinstance(message, wire.HelloReply)
                and message.host_nonce == request.host_nonce
                and message.session != outstanding.session
            )
        else:
            ours = frame.seq == outstanding.seq and frame.session == outstanding.session
            ours = ours and isinstance(message, (request.REPLY, wire.Ack))
        if not ours:
            return
        if outstanding.attempts == 1:  # Karn: a repeat's answer may be the first one's
            self._round_trip.measure(max(t_s - outstanding.sent_s, 1e-4))
        if isinstance(message, wire.Ack):
            if message.status is wire.Status.IN_PROGRESS:
                outstanding.next_s = t_s + _IN_PROGRESS_S
                return
            if message.reason is wire.Reason.BAD_SESSION:
                self._talking = False
                self._outstanding = None
                outstanding.orphaned = True
                return
        outstanding.answer = message
        self._outstanding = None

    # Errors.

    def _check_reentry(self) -> None:
        if self._handling:
            raise RuntimeError("a callback of the link must not use the link")

    def _raise_if_broken(self) -> None:
        if self._broken is not None:
            raise self._broken
