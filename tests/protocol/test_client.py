"""The client against the reference device: what it says to the operator when things go wrong."""

from __future__ import annotations

from dataclasses import replace

import pytest
from channel import LoopTransport
from raw_host import RawMessage
from reference_device import ReferenceDevice

from thigmo.errors import (
    BoardResetError,
    CommandRefusedError,
    CommandTimeoutError,
    LinkError,
    NotARobotError,
    SchemaMismatchError,
)
from thigmo.link import protocol as wire
from thigmo.link.client import BOOT_LOADER_S, SILENCE_S, Client
from thigmo.link.framing import decode, encode

SETTLE = wire.PARAMETERS["settle_ms"].index


@pytest.fixture
def device() -> ReferenceDevice:
    return ReferenceDevice()


@pytest.fixture
def transport(device: ReferenceDevice) -> LoopTransport:
    return LoopTransport(device)


@pytest.fixture
def client(transport: LoopTransport) -> Client:
    return Client(transport)


def wait(client: Client, seconds: float) -> None:
    client.wait_for(lambda: False, seconds)


# Opening.


def test_an_announce_ends_the_silence(transport: LoopTransport) -> None:
    client = Client(transport)
    assert client.now() < 0.1
    assert client.hello.board is wire.BoardKind.VIRTUAL


def test_a_board_that_did_not_reset_is_greeted_after_the_silence(device: ReferenceDevice) -> None:
    Client(LoopTransport(device)).close()
    transport = LoopTransport(device)
    sent: list[float] = []
    client = Client(transport, connect=False)
    client.taps.append(lambda way, _, t: sent.append(t) if way == "tx" else None)
    client.connect()
    assert sent[0] == pytest.approx(SILENCE_S, abs=0.01)


class SleepyBoard(ReferenceDevice):
    """In its boot loader, which waits 0.84 s, or 9.3 s once it heard a byte (hardware/facts.md)."""

    heard = False

    def step(self, ticks: int = 1) -> None:
        self.silent = self.now_us < (9_300_000 if self.heard else 840_000)
        if self.silent:
            self.now_us += 1000 * ticks
            self._boot_us = self.now_us
        else:
            super().step(ticks)

    def write(self, data: bytes) -> None:
        if self.silent:
            self.heard = True
        super().write(data)


def test_the_boot_loader_hears_nothing() -> None:
    board = SleepyBoard()
    client = Client(LoopTransport(board))
    assert not board.heard
    assert client.now() < 0.9


def test_a_boot_loader_that_heard_a_stray_byte_is_waited_for() -> None:
    board = SleepyBoard()
    board.heard = True
    client = Client(LoopTransport(board))
    assert client.hello.session
    assert client.now() < 10.0


def test_nothing_answers() -> None:
    device = ReferenceDevice()
    device.silent = True
    transport = LoopTransport(device)
    with pytest.raises(NotARobotError, match="nothing answers on loop; check power and cable"):
        Client(transport)
    assert transport.now() < SILENCE_S + BOOT_LOADER_S + 7


class Deaf(ReferenceDevice):
    """Hears nothing, and announces itself or says the same bytes without end."""

    def __init__(self, says: bytes = b"", schema_hash: int = wire.SCHEMA_HASH) -> None:
        super().__init__(schema_hash=schema_hash)
        self.says = says

    def write(self, data: bytes) -> None:
        pass

    def read(self) -> bytes:
        return self.says or super().read()


def raw(kind: int, payload: bytes) -> bytes:
    return encode(RawMessage(kind, payload), 1, 2)


NEWER = bytearray(Deaf(schema_hash=0x0BADCAFE)._announce().pack())
NEWER[8] = NEWER[13] = 99  # board, reset cause
FLASH = r"another layout of the protocol.*run `thigmo flash --robot loop`"


@pytest.mark.parametrize(
    ("board", "error", "said"),
    [
        (Deaf(b"$GPGGA,092750.000\r\n"), NotARobotError, r"\d+ bytes .* from a robot; choose the"),
        (Deaf(), NotARobotError, "announces itself but does not answer"),
        (Deaf(raw(wire.Pulse.ID, wire.Pulse(1, 2).pack())), NotARobotError,
         "talks but does not answer; check the cable's"),
        (Deaf(schema_hash=0x0BADCAFE), SchemaMismatchError, "0badcafe"),
        (Deaf(raw(wire.Announce.ID, bytes(NEWER))), SchemaMismatchError, "0badcafe.*thigmo flash"),
        (Deaf(raw(wire.Telemetry.ID, bytes(wire.Telemetry.SIZE - 2))), SchemaMismatchError, FLASH),
        (Deaf(raw(0x7E, b"older")), SchemaMismatchError, FLASH),
        (Deaf(raw(wire.Pulse.ID, b"older")), SchemaMismatchError, FLASH),
    ],
    ids=[
        "something else", "announces", "talks", "another schema", "unknown enumerations",
        "telemetry of another size", "an unknown id", "a pulse of another size",
    ],
)  # fmt: skip
def test_what_does_not_answer_is_told_by_what_it_says(
    board: Deaf, error: type[LinkError], said: str
) -> None:
    transport = LoopTransport(board)
    transport.virtual = False
    with pytest.raises(error, match=said):
        Client(transport)
    assert transport.now() < 20


def test_another_schema_is_refused_with_both_hashes() -> None:
    device = ReferenceDevice(schema_hash=0xDEADBEEF)
    with pytest.raises(SchemaMismatchError) as caught:
        Client(LoopTransport(device))
    assert "deadbeef" in str(caught.value)
    assert f"{wire.SCHEMA_HASH:08x}" in str(caught.value)
    assert caught.value.next_step == "run `make install`"  # of a simulated board
    transport = LoopTransport(device)
    transport.virtual = False
    with pytest.raises(SchemaMismatchError, match="; run `thigmo flash --robot loop`"):
        Client(transport)


def test_a_board_that_this_host_does_not_list_is_a_board_like_others() -> None:
    class Unlisted(ReferenceDevice):
        """A lab's own board, number 200."""

        def _hello_reply(self, hello: wire.Hello, reason: wire.Reason) -> wire.HelloReply:
            return replace(super()._hello_reply(hello, reason), board=wire.BoardKind(200))

    client = Client(LoopTransport(Unlisted()))
    assert client.hello.board == 200
    assert client.hello.board.key == "unlisted_200"
    assert client.hello.board.doc == "Number 200, which this host does not list."
    assert wire.HelloReply.unpack(client.hello.pack()) == client.hello
    with pytest.raises(ValueError, match="256"):
        wire.BoardKind(256)


def test_another_schema_with_enumerations_unknown_here_is_still_named() -> None:
    class Newer(ReferenceDevice):
        """Its hello_reply has a board kind and a reason that this host does not know."""

        def write(self, data: bytes) -> None:
            for piece in data.split(b"\0"):
                if piece and (frame := decode(piece)).id == wire.Hello.ID:
                    hello = wire.Hello.unpack(frame.payload)
                    reply = bytearray(self._hello_reply(hello, wire.Reason.WRONG_SCHEMA).pack())
                    reply[1], reply[10] = 77, 99
                    self._send(RawMessage(wire.HelloReply.ID, bytes(reply)), frame.seq, 0)

    with pytest.raises(SchemaMismatchError, match="0badcafe"):
        Client(LoopTransport(Newer(schema_hash=0x0BADCAFE)))


# Commands.


def test_a_refusal_says_why_and_what_to_do(client: Client) -> None:
    with pytest.raises(CommandRefusedError) as caught:
        client.request(wire.Arm())
    assert caught.value.reason == "wrong_state"
    assert str(caught.value) == (
        "the board refused arm: the supervisor's state does not allow it; "
        "arm the robot, or clear its faults, first"
    )


def test_a_save_is_asked_for_again_until_it_is_done(
    client: Client, device: ReferenceDevice
) -> None:
    began = client.now()
    assert client.request(wire.SaveConfig()).detail == 1
    assert client.now() - began == pytest.approx(1.7, abs=0.05)
    assert device.counters["repeats"] > 5
    assert len(device.executed) == 1


@pytest.mark.parametrize("deadline_s", [None, 0.3])
def test_a_pulled_cable_ends_in_a_time_out_at_the_deadline(
    client: Client, transport: LoopTransport, deadline_s: float | None
) -> None:
    transport.cut = True
    began, took_s = client.now(), deadline_s or 2.0
    with pytest.raises(CommandTimeoutError, match=f"get_status got no answer within {took_s:g} s"):
        client.request(wire.GetStatus(), deadline_s=deadline_s)
    assert client.now() - began == pytest.approx(took_s, abs=0.01)


def test_a_late_copy_of_a_command_that_timed_out_is_not_executed(
    client: Client, transport: LoopTransport, device: ReferenceDevice
) -> None:
    frames: list[bytes] = []
    client.taps.append(lambda way, frame, _: frames.append(frame) if way == "tx" else None)
    transport.cut = True
    with pytest.raises(CommandTimeoutError):
        client.request(wire.SetParameter(SETTLE, 1))
    late = next(f for f in frames if decode(f).id == wire.SetParameter.ID)
    transport.cut = False
    client.request(wire.SetParameter(SETTLE, 2))
    device.write(late + b"\0")
    assert client.request(wire.GetParameter(SETTLE)).value == 2
    assert [m for _, m in device.executed] == [wire.SetParameter(SETTLE, 2)]
    assert client.stats.hellos == 2


def test_the_measured_round_trip_sets_the_repeat(device: ReferenceDevice) -> None:
    class Slow(LoopTransport):
        """Every answer takes 60 ms more."""

        def _receive(self, data: bytes) -> None:
            self.held.append((self._ticks + 60, data))
            while self.held and self.held[0][0] <= self._ticks:
                super()._receive(self.held.pop(0)[1])

    transport = Slow(device)
    transport.held = []
    client = Client(transport)
    for value in range(1, 40):
        client.request(wire.SetParameter(SETTLE, value))
    assert client._round_trip.smoothed_s == pytest.approx(0.061, abs=0.003)
    assert client.stats.repeats <= 2  # at first, before it is known


def test_a_stalled_main_thread_finds_its_answer_and_not_a_time_out(
    client: Client, device: ReferenceDevice, transport: LoopTransport
) -> None:
    """Five seconds pass between write and read; the answer lies in the backlog, stamped in time."""
    backlog: list[tuple[float, bytes]] = []

    def read(timeout_s: float) -> bytes:
        if not device.executed:
            return b""
        if transport.now() < 5.0:
            for ms in range(20):
                backlog.append((transport.now() + ms / 1000, device.read()))
                device.step(1)
            reply = backlog.pop(0)[1]  # goes behind some telemetry
            backlog.insert(10, (backlog[9][0], reply))
            backlog[:] = [item for item in backlog if item[1]]
            transport._ticks += 5000
        transport.read_s, data = backlog.pop(0)
        return data

    transport.read = read
    assert client.request(wire.SetParameter(SETTLE, 5)).value == 5
    assert client.stats.timeouts == 0


def other_host(device: ReferenceDevice, nonce: int) -> None:
    """Somebody else on the same line."""
    device.write(encode(wire.Hello(wire.PROTOCOL, wire.SCHEMA_HASH, nonce), 0, 0))


def test_a_host_whose_robot_was_taken_over_says_so_and_does_not_take_it_back(
    client: Client, device: ReferenceDevice
) -> None:
    other_host(device, 12345)
    session = device.session
    for _ in range(2):
        with pytest.raises(LinkError, match="another program has taken over the robot"):
            client.request(wire.SetParameter(SETTLE, 3))
    assert device.executed == []
    assert device.session == session
    client.connect()  # asked for, it may
    assert client.request(wire.SetParameter(SETTLE, 4)).value == 4


def test_a_host_that_only_waits_hears_that_its_robot_was_taken_over(
    client: Client, device: ReferenceDevice
) -> None:
    wait(client, 0.1)
    other_host(device, 12345)
    with pytest.raises(LinkError, match="another program has taken over the robot"):
        wait(client, 0.2)


def test_a_spoilt_session_goes_on_with_the_same_nonce_under_another_number(
    client: Client, device: ReferenceDevice, transport: LoopTransport
) -> None:
    before = client.hello
    transport.cut = True
    with pytest.raises(CommandTimeoutError):
        client.request(wire.GetParameter(SETTLE))
    transport.cut = False
    client.request(wire.GetParameter(SETTLE))
    assert client.hello.host_nonce == before.host_nonce
    assert client.hello.session == device.session != before.session


def test_an_orphan_that_was_repeated_is_left_open(
    client: Client, device: ReferenceDevice, transport: LoopTransport
) -> None:
    """Executed, its reply lost, then the session was lost: a second execution must not follow."""
    swallow = device.read

    def lose() -> None:
        if device.executed and device.session == session:
            swallow()
            if client.stats.repeats:
                nonce = client.hello.host_nonce
                resumes = wire.Hello(wire.PROTOCOL, wire.SCHEMA_HASH, nonce)
                device.write(encode(resumes, 0, session))

    session = device.session
    original = device.step

    def step(ticks: int) -> None:
        original(ticks)
        lose()

    device.step = step
    with pytest.raises(CommandTimeoutError, match="may or may not be done"):
        client.request(wire.SetParameter(SETTLE, 3))
    assert len(device.executed) == 1
    assert client.request(wire.GetParameter(SETTLE)).value == 3


# Resets.


def test_a_reset_in_mid_command_is_told_by_its_announce(
    client: Client, device: ReferenceDevice, transport: LoopTransport
) -> None:
    transport.reset_at = transport.bytes_passed + 5
    with pytest.raises(BoardResetError, match=r"restarted \(external\).*; connect again"):
        client.request(wire.SetParameter(SETTLE, 3))
    with pytest.raises(BoardResetError):
        client.poll(0.1)
    client.connect()
    assert client.request(wire.SetParameter(SETTLE, 4)).value == 4
    assert [m.value for _, m in device.executed] == [4]


def test_a_reset_while_nothing_is_asked_is_told_as_well(
    client: Client, device: ReferenceDevice
) -> None:
    device.reset(wire.ResetCause.WATCHDOG)
    with pytest.raises(BoardResetError, match="watchdog"):
        wait(client, 2.0)


def test_a_reset_is_told_even_after_a_command_that_found_no_answer(
    client: Client, device: ReferenceDevice
) -> None:
    device.silent = True  # in its boot loader
    with pytest.raises(CommandTimeoutError):
        client.request(wire.GetParameter(SETTLE))
    device.silent = False
    device.reset(wire.ResetCause.EXTERNAL)
    with pytest.raises(BoardResetError, match="external"):
        wait(client, 2.0)


def test_a_reset_whose_announces_are_lost_shows_in_the_next_hello(
    client: Client, device: ReferenceDevice, transport: LoopTransport
) -> None:
    transport.cut = True
    device.reset(wire.ResetCause.BROWN_OUT)
    client.poll(0.0)
    device.step(1)
    device.read()  # its first announce
    transport.cut = False
    with pytest.raises(BoardResetError, match="brown out"):
        client.request(wire.SetParameter(SETTLE, 4))
    assert device.executed == []


def test_a_replayed_announce_is_no_reset(client: Client, device: ReferenceDevice) -> None:
    device._send(device._announce(), 0, 0)
    wait(client, 0.1)
    assert client.request(wire.SetParameter(SETTLE, 4)).value == 4


def test_an_announce_of_an_earlier_boot_is_no_reset(
    client: Client, device: ReferenceDevice
) -> None:
    old = device._announce()
    device.reset(wire.ResetCause.EXTERNAL)
    with pytest.raises(BoardResetError):
        wait(client, 2.0)
    client.connect()
    device._send(old, 0, 0)
    wait(client, 0.1)
    assert client.request(wire.SetParameter(SETTLE, 4)).value == 4


# Waiting, events, telemetry, heart, clock.


def test_a_rest_of_a_wait_that_is_only_rounding_ends(device: ReferenceDevice) -> None:
    class Coarse(LoopTransport):
        """Takes a nanosecond for none, as a virtual clock with a tolerance does."""

        def read(self, timeout_s: float) -> bytes:
            return super().read(timeout_s - 1e-9)

    client = Client(Coarse(device))
    began = client.now()
    assert not client.wait_for(lambda: False, 1e-10)
    assert client.now() - began <= 0.002


def test_events_are_taken_once_and_acknowledged(client: Client, device: ReferenceDevice) -> None:
    device.event(wire.EventCode.CONTACT, 1, 512)
    assert client.wait_for(lambda: bool(client.events), 1.0)
    wait(client, 0.5)
    assert not device.events
    assert [e.message.value for e in client.events] == [512]
    assert client.events[0].device_us <= client.events[0].t_s * 1e6


def test_latched_events_outlive_a_new_conversation(device: ReferenceDevice) -> None:
    Client(LoopTransport(device)).close()
    device.event(wire.EventCode.FAULT, 3)
    second = Client(LoopTransport(device))
    assert second.wait_for(lambda: bool(second.events), 1.0)
    assert second.wait_for(lambda: not device.events, 1.0)


def test_a_full_queue_leaves_events_at_the_board(
    client: Client, device: ReferenceDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("thigmo.link.inbox._EVENTS", 3)
    for value in range(5):
        device.event(wire.EventCode.EVERTED, 0, value)
    wait(client, 1.0)
    assert len(client.events) == 3
    assert [e.value for e in device.events] == [3, 4]
    client.events.clear()
    wait(client, 1.0)
    assert [e.message.value for e in client.events] == [3, 4]
    assert not device.events


def test_the_heart_beats_from_the_hello_on(client: Client, device: ReferenceDevice) -> None:
    wait(client, 2.0)
    gaps = [b - a for (a, _), (b, _) in zip(device.beats, device.beats[1:], strict=False)]
    assert max(gaps) <= 101_000
    assert len(device.beats) == pytest.approx(20, abs=2)


def test_device_time_maps_to_host_time(client: Client, device: ReferenceDevice) -> None:
    wait(client, 10.0)
    t_us = client.clock.unwrap(device._t_us & 0xFFFF_FFFF)
    assert client.clock.to_host(t_us) == pytest.approx(client.now(), abs=0.002)
    assert client.device_s(device._t_us) == pytest.approx(device._t_us * 1e-6)


def test_a_callback_must_not_use_the_link(client: Client) -> None:
    client.on_telemetry.append(lambda _: client.poll(0.0))
    with pytest.raises(RuntimeError, match="callback"):
        wait(client, 0.1)


def test_the_taps_see_every_frame_both_ways(device: ReferenceDevice) -> None:
    tapped: list[tuple[str, int]] = []
    client = Client(LoopTransport(device), connect=False)
    client.taps.append(lambda way, frame, t: tapped.append((way, decode(frame).id)))
    client.connect()
    client.request(wire.SetParameter(SETTLE, 4))
    wait(client, 0.3)
    for expected in [
        ("rx", wire.Announce.ID),
        ("tx", wire.Hello.ID),
        ("rx", wire.HelloReply.ID),
        ("tx", wire.SetParameter.ID),
        ("rx", wire.ParameterValue.ID),
        ("tx", wire.Heartbeat.ID),
        ("rx", wire.Pulse.ID),
        ("rx", wire.Telemetry.ID),
    ]:
        assert expected in tapped
