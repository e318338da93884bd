"""The protocol as PROTOCOL.md states it, on every board: virtual, simulated Mega, any real port.

`pytest tests/protocol/test_conformance.py --robot /dev/ttyACM0` adds a real one. Nothing here moves
a motor or lets air into a muscle; the stored configuration is put back at the end.
"""

from __future__ import annotations

import random
from itertools import pairwise

import pytest
from desk import MAPS, Desk
from raw_host import LONG_S, RawHost, RawMessage

from thigmo.link import protocol as wire
from thigmo.link.framing import Frame, encode

R = wire.Reason
PARAMETER_BY_INDEX = [p for p in wire.PARAMETERS.values() for _ in range(p.count)]
DEFAULTS = [d for p in wire.PARAMETERS.values() for d in p.defaults]
SETTLE = wire.PARAMETERS["settle_ms"].index
TELEMETRY_MS = wire.PARAMETERS["telemetry_ms"].index
COMMANDS = [
    m for m in wire.MESSAGES.values() if issubclass(m, wire.Command) and m is not wire.Hello
]
UNKNOWN_ZONE = 255


@pytest.fixture
def host(desk: Desk) -> RawHost:
    return desk.calm()


@pytest.fixture
def ready(desk: Desk) -> RawHost:
    """The same, armed."""
    return desk.ready()


def stats(host: RawHost) -> wire.LinkStats:
    return host.get(wire.GetLinkStats())


def telemetry(frames: list[Frame]) -> list[wire.Telemetry]:
    return [m for f in frames if isinstance(m := f.message(), wire.Telemetry)]


def events(frames: list[Frame]) -> list[wire.Event]:
    return [m for f in frames if isinstance(m := f.message(), wire.Event)]


# Hello and announce.


def test_hello_tells_who_the_board_is(desk: Desk) -> None:
    reply = desk.host.hello(nonce=random.getrandbits(32))
    assert reply.status is wire.Status.OK
    assert reply.reason is R.NONE
    assert reply.protocol == wire.PROTOCOL
    assert reply.schema_hash == wire.SCHEMA_HASH
    assert reply.session != 0
    assert reply.receive_window >= 2 * wire.MAX_WIRE
    if desk.board is not None:
        assert (reply.board is wire.BoardKind.VIRTUAL) == (desk.name == "virtual")
    assert len(reply.firmware_version) == 3


def test_a_repeated_hello_gets_the_same_answer_and_changes_nothing(host: RawHost) -> None:
    first = host.hello(nonce=77)
    host.get(wire.GetStatus())
    seq = host.seq
    again = host.hello(nonce=77)
    assert again == first
    host.seq = seq
    assert host.get(wire.SetParameter(SETTLE, 5)).value == 5


def test_a_new_hello_opens_another_session(host: RawHost) -> None:
    first = host.hello()
    second = host.hello()
    assert first.session != second.session
    assert first.boot_nonce == second.boot_nonce


def zeroing(host: RawHost) -> tuple[int, wire.HelloReply]:
    """A new conversation in which an activity is under way; its nonce, and the answer to hello."""
    nonce = random.getrandbits(32)
    reply = host.hello(nonce)
    host.beating = True
    host.listen(0.05)
    host.get(wire.Arm())
    host.get(wire.ConfirmLength(100_000, 1))
    host.get(wire.ZeroSensors(0b00001_00001))
    return nonce, reply


def test_a_host_that_lost_its_session_goes_on_under_another_number(ready: RawHost) -> None:
    """What it began goes on; a repeat of that hello changes nothing; an older one is stale."""
    nonce, first = zeroing(ready)
    second = ready.hello(nonce=nonce, resumes=first.session)
    assert second.status is wire.Status.OK
    assert second.session not in (0, first.session)
    assert ready.hello(nonce=nonce, resumes=first.session) == second
    ready.beating = True
    report = ready.get(wire.GetStatus())
    assert (report.state, report.activity) == (wire.State.MOVING, wire.Activity.ZEROING)
    third = ready.hello(nonce=nonce, resumes=second.session)
    assert third.session not in (first.session, second.session)
    again = wire.Hello(wire.PROTOCOL, wire.SCHEMA_HASH, nonce)
    ready.send(again, seq=0, session=first.session)
    assert ready.answer(0, 0, 0.2) is None
    assert ready.get(wire.GetStatus()).activity is wire.Activity.ZEROING


def test_another_host_ends_what_moves_and_the_first_cannot_go_on(ready: RawHost) -> None:
    nonce, first = zeroing(ready)
    ready.hello(random.getrandbits(32))
    ended = (wire.EventCode.ACTIVITY_ABORTED, wire.Activity.ZEROING, R.OTHER_HOST)
    said = ready.next_frame(lambda f: ended in {(e.code, e.arg, e.value) for e in events([f])}, 1.0)
    assert said is not None
    report = ready.get(wire.GetStatus())
    assert (report.state, report.activity) == (wire.State.SAFE, wire.Activity.IDLE)
    refused = ready.hello(nonce=nonce, resumes=first.session)
    assert (refused.status, refused.reason) == (wire.Status.REFUSED, R.BAD_SESSION)
    assert refused.boot_nonce == first.boot_nonce
    assert ready.get(wire.GetStatus()).state is wire.State.SAFE, "the second's session goes on"


def test_a_board_that_restarted_has_no_session_to_go_on_with(desk: Desk) -> None:
    nonce = random.getrandbits(32)
    before = desk.calm().hello(nonce)
    desk.restart()
    refused = desk.host.hello(nonce=nonce, resumes=before.session)
    assert (refused.status, refused.reason) == (wire.Status.REFUSED, R.BAD_SESSION)
    assert refused.boot_nonce != before.boot_nonce


def test_a_replayed_hello_ends_no_conversation(host: RawHost) -> None:
    old = [host.hello(nonce=n).host_nonce for n in (501, 502, 503)]
    session = host.hello(nonce=504).session
    before = stats(host)
    for nonce in old:
        host.send(wire.Hello(wire.PROTOCOL, wire.SCHEMA_HASH, nonce), seq=0, session=0)
        assert host.answer(0, 0, 0.2) is None
    after = stats(host)
    assert host.session == session
    assert after.rx_stale - before.rx_stale == 3


@pytest.mark.parametrize("change", ["schema", "protocol"])
def test_another_schema_is_refused_with_the_boards_hash(host: RawHost, change: str) -> None:
    offered = (
        wire.Hello(wire.PROTOCOL, wire.SCHEMA_HASH ^ 1, 9)
        if change == "schema"
        else wire.Hello(wire.PROTOCOL + 1, wire.SCHEMA_HASH, 9)
    )
    host.send(offered, seq=3, session=0)
    frame = host.answer(3, 0)
    assert frame is not None
    reply = frame.message()
    assert isinstance(reply, wire.HelloReply)
    assert (reply.status, reply.reason) == (wire.Status.REFUSED, R.WRONG_SCHEMA)
    assert reply.schema_hash == wire.SCHEMA_HASH
    assert (reply.session, reply.host_nonce) == (0, 9)
    host.get(wire.GetStatus())  # and the conversation goes on


def test_a_hello_of_the_wrong_size_is_dropped(host: RawHost) -> None:
    for size in (0, 8, 10):
        host.send(RawMessage(wire.Hello.ID, bytes(size)), seq=0, session=0)
        assert host.answer(0, 0, 0.1) is None
    host.get(wire.GetStatus())


def test_a_restarted_board_announces_itself_until_the_first_hello(desk: Desk) -> None:
    host = desk.host
    before = host.hello()
    first = desk.restart()
    assert first.boot_nonce != before.boot_nonce
    assert first.schema_hash == wire.SCHEMA_HASH
    assert first.reset_cause is wire.ResetCause.EXTERNAL
    host = desk.host
    silence = host.listen(2.2)
    assert {f.id for f in silence} == {wire.Announce.ID}
    assert len(silence) in (4, 5)
    assert {f.message() for f in silence} == {first}
    reply = host.hello()
    assert reply.boot_nonce == first.boot_nonce
    assert reply.reset_cause is wire.ResetCause.EXTERNAL
    assert reply.session != before.session
    ids = {f.id for f in host.listen(0.7)}
    assert wire.Telemetry.ID in ids
    assert wire.Announce.ID not in ids


def test_a_restart_forgets_the_session_and_the_length(desk: Desk) -> None:
    host = desk.calm()
    host.get(wire.ConfirmLength(100_000, 1))
    session, seq = host.session, host.seq
    desk.restart()
    host = desk.host
    host.send(wire.GetStatus(), seq=seq + 1, session=session)
    frame = host.answer(seq + 1, session)
    assert frame is not None
    assert frame.message() == wire.Ack(wire.Status.REFUSED, R.BAD_SESSION, 0)
    host.hello()
    report = host.get(wire.GetStatus())
    assert not report.conditions & wire.Condition.LENGTH_KNOWN.mask
    assert report.zone == UNKNOWN_ZONE
    assert report.state in (wire.State.SAFE, wire.State.FAULT)


# Sessions and sequence.


def test_a_frame_of_another_session_is_answered_so_and_not_executed(host: RawHost) -> None:
    before = stats(host)
    for session in (host.session ^ 0x55, 0):
        host.send(wire.SetParameter(SETTLE, 1), seq=host.seq + 1, session=session)
        frame = host.answer(host.seq + 1, session)
        assert frame is not None
        assert frame.message() == wire.Ack(wire.Status.REFUSED, R.BAD_SESSION, 0)
    assert host.get(wire.GetParameter(SETTLE)).value == DEFAULTS[SETTLE]
    assert stats(host).rx_stale - before.rx_stale == 2


def test_a_repeat_gets_the_stored_reply_and_is_not_executed(host: RawHost) -> None:
    host.get(wire.SetParameter(SETTLE, 1))
    first = host.seq
    before = stats(host)
    host.get(wire.SetParameter(SETTLE, 2))
    for _ in range(3):
        host.send(wire.SetParameter(SETTLE, 2))
        frame = host.answer(host.seq, host.session)
        assert frame is not None
        assert frame.message() == wire.ParameterValue(wire.Status.OK, SETTLE, 2)
    host.send(wire.SetParameter(SETTLE, 1), seq=first)  # a stale copy
    assert host.answer(first, host.session, 0.2) is None
    host.send(wire.Disarm())  # another command under the last number
    assert host.answer(host.seq, host.session, 0.2) is None
    assert host.get(wire.GetParameter(SETTLE)).value == 2
    after = stats(host)
    assert after.rx_repeats - before.rx_repeats == 3
    assert after.rx_stale - before.rx_stale == 2


@pytest.mark.parametrize("step", [-1, -2, -3, 2, 3, 0x4000, 0x8000, -0x4000])
def test_a_frame_out_of_sequence_is_dropped_without_an_answer(host: RawHost, step: int) -> None:
    for _ in range(3):
        host.get(wire.GetStatus())
    before = stats(host)
    seq = (host.seq + step) & 0xFFFF
    host.send(wire.SetParameter(SETTLE, 1), seq=seq)
    assert host.answer(seq, host.session, 0.1) is None
    assert host.get(wire.GetParameter(SETTLE)).value == DEFAULTS[SETTLE]
    assert stats(host).rx_stale - before.rx_stale == 1


def test_the_sequence_wraps(host: RawHost) -> None:
    host.hello(seq=0xFFFD)
    for value in range(6):
        assert host.get(wire.SetParameter(SETTLE, value)).value == value
    assert host.seq == 3


def test_a_save_answers_in_progress_until_it_is_committed(host: RawHost) -> None:
    before = host.get(wire.GetStatus()).config_generation
    host.seq = (host.seq + 1) & 0xFFFF
    host.send(wire.SaveConfig())
    pending = 0
    while True:
        frame = host.answer(host.seq, host.session, 0.05)
        if frame is None:
            host.send(wire.SaveConfig())
            continue
        ack = frame.message()
        assert isinstance(ack, wire.Ack)
        if ack.status is not wire.Status.IN_PROGRESS:
            break
        pending += 1
        assert pending < 100
    assert pending >= 2
    assert ack == wire.Ack(wire.Status.OK, R.NONE, before + 1)
    assert host.get(wire.GetStatus()).config_generation == before + 1
    saved = events(host.listen(0.3))
    assert (saved[0].code, saved[0].value) == (wire.EventCode.SAVED, before + 1)


def test_during_a_save_nothing_else_is_executed(host: RawHost) -> None:
    host.seq = (host.seq + 1) & 0xFFFF
    saving = host.seq
    host.send(wire.SaveConfig())
    host.send(wire.SetParameter(SETTLE, 1), seq=saving + 1)
    assert host.answer(saving + 1, host.session, 0.05) is None
    host.hello()
    assert host.refusal(wire.SetParameter(SETTLE, 1)) == (R.BUSY, 0)
    assert host.get(wire.GetStatus()).activity is wire.Activity.SAVING
    for _ in range(40):
        if host.get(wire.GetStatus()).activity is wire.Activity.IDLE:
            break
        host.listen(0.2)
    assert host.get(wire.SetParameter(SETTLE, 1)).value == 1


# Messages that are none.


@pytest.mark.parametrize(
    "message_id",
    [0x00, 0x2F, 0x7F, wire.Ack.ID, wire.Telemetry.ID, wire.Event.ID, wire.Pulse.ID, 0xFF],
)
def test_an_unknown_id_is_refused(host: RawHost, message_id: int) -> None:
    before = stats(host)
    assert host.refusal(RawMessage(message_id, b"")) == (R.UNKNOWN_ID, message_id)
    assert stats(host).rx_repeats == before.rx_repeats, "answered at once"


def test_messages_are_as_long_as_the_capacity_says(host: RawHost) -> None:
    said = host.get(wire.GetCapacity())
    status = host.get(wire.GetStatus())
    assert len(status.pressure_cpsi) == said.muscles
    frame = host.next_frame(lambda f: f.id == wire.Telemetry.ID, 1.0)
    assert frame is not None
    row = wire.Telemetry.unpack(frame.payload)
    assert len(row.flex_sum) == said.sensors
    assert len(row.set_cpsi) == len(row.drive) == said.muscles
    assert (said.adc_bits, said.drive_full, said.motor_full, said.tick_us) == (10, 1599, 800, 1000)


@pytest.mark.parametrize("command", [wire.SetPressure, wire.Sweep])
def test_a_command_that_counts_other_muscles_is_refused(
    host: RawHost, command: type[wire.SetPressure | wire.Sweep]
) -> None:
    muscles = host.get(wire.GetCapacity()).muscles
    for count in {0, muscles - 1, muscles + 1, 255}:
        payload = bytes([count]) + bytes(command.SIZE - 1)
        assert host.refusal(RawMessage(command.ID, payload)) == (R.BAD_VALUE, muscles), count


@pytest.mark.parametrize("command", COMMANDS, ids=lambda m: m.NAME)
def test_a_command_of_the_wrong_size_is_refused(host: RawHost, command: type[wire.Message]) -> None:
    for size in {max(command.SIZE - 1, 0), command.SIZE + 1, wire.MAX_PAYLOAD} - {command.SIZE}:
        refused = host.refusal(RawMessage(command.ID, bytes(size)))
        assert refused == (R.BAD_LENGTH, command.ID), size


def test_noise_is_counted_and_the_next_frame_is_heard(host: RawHost) -> None:
    rng = random.Random(5)
    before = stats(host)
    for size in [60, 120] * 10:  # no frame has more than 96 bytes
        host.transport.write(bytes(rng.randrange(1, 256) for _ in range(size)) + b"\0")
        host.listen(0.01)
    host.transport.write(b"\x11" * 40 + b"\0")
    host.get(wire.GetStatus())
    assert stats(host).rx_bad - before.rx_bad == 21


def test_a_frame_that_was_cut_costs_only_itself(host: RawHost) -> None:
    frame = encode(wire.SetParameter(SETTLE, 1), host.seq + 1, host.session)
    for cut in range(1, len(frame) - 1):
        host.transport.write(frame[:cut] + b"\0")
    host.listen(0.05)
    assert host.get(wire.GetParameter(SETTLE)).value == DEFAULTS[SETTLE]


def test_no_flipped_bit_is_executed(host: RawHost) -> None:
    good = encode(wire.SetParameter(SETTLE, 1), host.seq + 1, host.session)
    for bit in range(8 * (len(good) - 1)):
        broken = bytearray(good)
        broken[bit // 8] ^= 1 << bit % 8
        host.transport.write(bytes(broken))
        if bit % 4 == 0:
            host.listen(0.01)
    host.listen(0.05)
    assert host.get(wire.GetParameter(SETTLE)).value == DEFAULTS[SETTLE]


# Heartbeats.


def test_a_heartbeat_is_answered_with_the_device_time(host: RawHost) -> None:
    times = []
    for counter in (1, 2, 7, 1000):
        host.send(wire.Heartbeat(counter), seq=0)
        frame = host.next_frame(lambda f: f.id == wire.Pulse.ID, 1.0)
        assert frame is not None
        pulse = frame.message()
        assert isinstance(pulse, wire.Pulse)
        assert pulse.counter == counter
        assert frame.session == host.session
        times.append(pulse.t_us)
        host.listen(0.05)
    for a, b in pairwise(times):
        assert 0 < (b - a) & 0xFFFF_FFFF < 5_000_000


def test_a_heartbeat_that_does_not_rise_or_is_anothers_keeps_nobody_alive(host: RawHost) -> None:
    host.send(wire.Heartbeat(10), seq=0)
    assert host.next_frame(lambda f: f.id == wire.Pulse.ID, 0.3)
    before = stats(host)
    host.send(wire.Heartbeat(10), seq=0)
    host.send(wire.Heartbeat(9), seq=0)
    host.send(wire.Heartbeat(11), seq=0, session=host.session ^ 1)
    host.send(RawMessage(wire.Heartbeat.ID, b"\x0b\0\0"), seq=0)
    assert host.next_frame(lambda f: f.id == wire.Pulse.ID, 0.2) is None
    assert stats(host).rx_stale - before.rx_stale == 4
    alive = wire.Condition.HOST_ALIVE.mask
    for _ in range(50):
        if not host.get(wire.GetStatus()).conditions & alive:
            break
        host.send(wire.Heartbeat(10), seq=0)
        host.listen(0.1)
    else:
        pytest.fail("a stale heartbeat kept the host alive")
    host.send(wire.Heartbeat(11), seq=0)
    assert host.next_frame(lambda f: f.id == wire.Pulse.ID, 0.3)
    host.listen(0.05)
    assert host.get(wire.GetStatus()).conditions & alive


def test_each_session_counts_its_heartbeats_anew(host: RawHost) -> None:
    host.send(wire.Heartbeat(5000), seq=0)
    assert host.next_frame(lambda f: f.id == wire.Pulse.ID, 0.3)
    host.hello()
    host.send(wire.Heartbeat(1), seq=0)
    assert host.next_frame(lambda f: f.id == wire.Pulse.ID, 0.3)


# Telemetry.


@pytest.mark.parametrize("period_ms", [5, 20, 100])
def test_telemetry_keeps_its_period_and_its_numbers(desk: Desk, period_ms: int) -> None:
    host = desk.calm()
    host.get(wire.SetParameter(TELEMETRY_MS, period_ms))
    host.get(wire.ApplyParameters())
    host.listen(0.2)
    frames = [f for f in host.listen(2.0) if f.id == wire.Telemetry.ID]
    if desk.board is not None:  # in virtual time; a port's host may be late
        assert len(frames) == pytest.approx(2000 / period_ms, abs=3)
    assert len(frames) > 5
    assert all(f.session == host.session for f in frames)
    assert all((b.seq - a.seq) & 0xFFFF == 1 for a, b in pairwise(frames))
    times = [row.t_us for row in telemetry(frames)]
    assert {(b - a) & 0xFFFF_FFFF for a, b in pairwise(times)} == {1000 * period_ms}


def test_telemetry_counts_from_each_hello(host: RawHost) -> None:
    host.listen(0.3)
    host.hello()
    frame = host.next_frame(lambda f: f.id == wire.Telemetry.ID and f.session == host.session, 0.5)
    assert frame is not None
    assert frame.seq <= 2


def test_telemetry_can_be_turned_off(host: RawHost) -> None:
    host.get(wire.SetParameter(TELEMETRY_MS, 0))
    host.get(wire.ApplyParameters())
    host.listen(0.1)
    assert not telemetry(host.listen(0.5))


def test_telemetry_flows_unbroken_while_commands_do(host: RawHost) -> None:
    before = stats(host)
    frames: list[Frame] = []
    for number in range(100):
        host.seq = (host.seq + 1) & 0xFFFF
        host.send(wire.GetParameter(number % len(DEFAULTS)))

        def answered(frame: Frame) -> bool:
            frames.append(frame)
            return frame.id == wire.ParameterValue.ID and frame.seq == host.seq

        assert host.next_frame(answered, 0.5)
    rows = [f for f in frames if f.id == wire.Telemetry.ID]
    assert len(rows) > 30
    lost = sum(((b.seq - a.seq) & 0xFFFF) - 1 for a, b in pairwise(rows))
    assert lost == stats(host).tx_dropped - before.tx_dropped == 0


def test_telemetry_agrees_with_the_status(host: RawHost) -> None:
    report = host.get(wire.GetStatus())
    (row, *_) = telemetry(host.listen(0.1))
    assert row.state_activity >> 4 == report.state
    assert row.state_activity & 15 == report.activity
    assert row.faults == report.faults
    assert row.pressure_cpsi == pytest.approx(report.pressure_cpsi, abs=50)
    assert (*row.drive, row.motor) == (0, 0, 0)


# Events.


def test_events_repeat_until_they_are_acknowledged(host: RawHost) -> None:
    newest = host.get(wire.GetStatus()).event_number
    generation = host.save()
    heard = [f for f in host.listen(1.5) if f.id == wire.Event.ID]
    assert len(heard) >= 3
    assert {(f.seq, f.session) for f in heard} == {(0, host.session)}
    assert len({f.payload for f in heard}) == 1
    event = heard[0].message()
    assert isinstance(event, wire.Event)
    assert event.number == (newest + 1) & 0xFFFF
    assert (event.code, event.value) == (wire.EventCode.SAVED, generation)
    assert host.get(wire.GetStatus()).event_number == event.number
    host.get(wire.AckEvent(event.number))
    host.listen(0.05)
    assert not events(host.listen(1.0))


def test_an_acknowledgement_covers_all_up_to_its_number(host: RawHost) -> None:
    host.save()
    host.save()
    host.save()
    numbers = sorted({e.number for e in events(host.listen(0.6))})
    assert len(numbers) == 3
    assert numbers == list(range(numbers[0], numbers[0] + 3))
    host.get(wire.AckEvent(numbers[0] - 1))
    assert {e.number for e in events(host.listen(0.6))} == set(numbers)
    host.get(wire.AckEvent(numbers[1]))
    host.listen(0.05)
    assert {e.number for e in events(host.listen(0.6))} == {numbers[2]}


def test_latched_events_outlive_the_conversation(host: RawHost) -> None:
    generation = host.save()
    host.listen(0.1)
    host.hello()
    heard = [f for f in host.listen(0.5) if f.id == wire.Event.ID and f.session == host.session]
    assert heard
    event = heard[0].message()
    assert isinstance(event, wire.Event)
    assert event.value == generation


def test_an_event_fits_its_place_on_the_wire(host: RawHost) -> None:
    host.save()
    frame = next(f for f in host.listen(0.5) if f.id == wire.Event.ID)
    assert len(frame.wire) + 1 <= 24


# Parameters and maps.


def test_defaults_are_the_schemas(host: RawHost) -> None:
    got = [host.get(wire.GetParameter(index)) for index in range(wire.PARAMETER_COUNT)]
    assert [reply.index for reply in got] == list(range(wire.PARAMETER_COUNT))
    assert [reply.value for reply in got] == DEFAULTS


def test_every_parameter_takes_its_whole_range_and_no_more(host: RawHost) -> None:
    for index, parameter in enumerate(PARAMETER_BY_INDEX):
        if index == TELEMETRY_MS:
            continue  # below
        for value in (parameter.low, parameter.high):
            assert host.get(wire.SetParameter(index, value)).value == value, parameter.name
            assert host.get(wire.GetParameter(index)).value == value, parameter.name
        for value in (parameter.low - 1, parameter.high + 1, -(1 << 31), (1 << 31) - 1):
            if parameter.low <= value <= parameter.high:
                continue
            refused = host.refusal(wire.SetParameter(index, value))
            assert refused == (R.BAD_VALUE, index), parameter.name
        assert host.get(wire.GetParameter(index)).value == parameter.high, parameter.name
        host.get(wire.SetParameter(index, DEFAULTS[index]))
    assert host.refusal(wire.SetParameter(TELEMETRY_MS, -1)) == (R.BAD_VALUE, TELEMETRY_MS)
    assert host.refusal(wire.SetParameter(TELEMETRY_MS, 10_001)) == (R.BAD_VALUE, TELEMETRY_MS)


@pytest.mark.parametrize("index", [wire.PARAMETER_COUNT, 1000, 0xFFFF])
def test_there_is_no_parameter_beyond_the_table(host: RawHost, index: int) -> None:
    assert host.refusal(wire.GetParameter(index))[0] is R.BAD_VALUE
    assert host.refusal(wire.SetParameter(index, 0))[0] is R.BAD_VALUE


def test_every_map_is_held_apart(host: RawHost) -> None:
    rng = random.Random(3)
    wanted = {}
    for place in MAPS:
        wanted[place] = tuple(rng.randint(-0x8000, 0x7FFF) for _ in range(wire.MAP_POINTS))
        host.get(wire.SetMap(*place, wanted[place]))
    for place in MAPS:
        reply = host.get(wire.GetMap(*place))
        assert (reply.zone, reply.muscle, reply.branch) == place
        assert reply.curvature_e5 == wanted[place]
    host.get(wire.LoadDefaults())
    assert host.get(wire.GetMap(*MAPS[0])).curvature_e5 != wanted[MAPS[0]]


@pytest.mark.parametrize("place", [(3, 0, 0), (255, 0, 0), (0, 2, 0), (0, 0, 2)])
def test_there_is_no_other_map(host: RawHost, place: tuple[int, int, int]) -> None:
    assert host.refusal(RawMessage(wire.GetMap.ID, bytes(place)))[0] is R.BAD_VALUE
    payload = bytes(place) + bytes(2 * wire.MAP_POINTS)
    assert host.refusal(RawMessage(wire.SetMap.ID, payload))[0] is R.BAD_VALUE


def test_what_was_saved_comes_back_after_a_restart(desk: Desk) -> None:
    host = desk.calm()
    host.get(wire.SetParameter(SETTLE, 12_345))
    host.get(wire.ApplyParameters())
    host.get(wire.SetMap(1, 1, wire.Branch.DEFLATE, tuple(range(11))))
    generation = host.save()
    host.get(wire.SetParameter(SETTLE, 54_321))  # not saved
    desk.restart()
    host = desk.host
    host.hello()
    assert host.get(wire.GetParameter(SETTLE)).value == 12_345
    reply = host.get(wire.GetMap(1, 1, wire.Branch.DEFLATE))
    assert reply.curvature_e5 == tuple(range(11))
    assert host.get(wire.GetStatus()).config_generation == generation


# Refusals that a desk can provoke.

NEEDS_ARMED: list[wire.Message] = [
    wire.Sweep((1500, 1500), 20_000, 1, 0),
    wire.SetPressure((500, 0), 0),
    wire.GrowTo(100_000, 0),
    wire.RetractTo(0, 0),
    wire.Home(),
    wire.ZeroSensors(1),
]


@pytest.mark.parametrize("command", NEEDS_ARMED, ids=lambda m: m.NAME)
def test_an_unarmed_board_moves_nothing(host: RawHost, command: wire.Message) -> None:
    state = host.get(wire.GetStatus()).state
    expected = R.FAULT_LATCHED if state is wire.State.FAULT else R.WRONG_STATE
    assert host.refusal(command)[0] is expected


@pytest.mark.parametrize("command", NEEDS_ARMED, ids=lambda m: m.NAME)
def test_a_latched_fault_refuses_all_that_moves(desk: Desk, command: wire.Message) -> None:
    board = desk.simulated()
    host = desk.ready()
    board.set_estop(True)
    host.listen(0.3)
    try:
        report = host.get(wire.GetStatus())
        assert report.state is wire.State.FAULT
        assert report.faults & wire.Fault.ESTOP.mask
        assert host.refusal(command)[0] in (R.FAULT_LATCHED, R.ESTOP)
        assert host.refusal(wire.Arm())[0] in (R.FAULT_LATCHED, R.ESTOP)
        remaining = host.get(wire.ClearFaults(0xFFFF)).detail
        assert remaining & wire.Fault.ESTOP.mask  # its cause is still there
    finally:
        board.set_estop(False)
        host.listen(0.3)
    assert host.refusal(wire.Arm())[0] is R.FAULT_LATCHED  # latched until cleared
    assert host.get(wire.ClearFaults(0xFFFF)).detail == 0
    host.get(wire.Arm())


def test_parameters_are_applied_as_a_whole_or_not_at_all(host: RawHost) -> None:
    index = {name: wire.PARAMETERS[name].index for name in ("over_pressure_cpsi", "heartbeat_ms")}
    most = wire.PARAMETERS["max_pressure_cpsi"].index
    host.get(wire.SetParameter(index["heartbeat_ms"], 400))
    host.get(wire.SetParameter(index["over_pressure_cpsi"], 1000))  # below the highest set point
    refused = (R.CONTRADICTION, index["over_pressure_cpsi"])
    assert host.refusal(wire.ApplyParameters()) == refused
    assert host.refusal(wire.ApplyParameters()) == refused  # what was set waits
    host.get(wire.SetParameter(most, 900))
    host.get(wire.ApplyParameters())
    host.hello()
    held = [host.get(wire.GetParameter(i)).value for i in (*index.values(), most)]
    assert held == [1000, 400, 900]


def test_a_hello_forgets_what_was_set_and_not_applied(host: RawHost) -> None:
    host.get(wire.SetParameter(SETTLE, 12_345))
    assert host.get(wire.GetParameter(SETTLE)).value == 12_345
    host.hello()
    assert host.get(wire.GetParameter(SETTLE)).value == DEFAULTS[SETTLE]
    host.get(wire.ApplyParameters())
    assert host.get(wire.GetParameter(SETTLE)).value == DEFAULTS[SETTLE]


def test_a_board_that_does_not_know_its_length_neither_bends_nor_grows(desk: Desk) -> None:
    desk.calm()
    desk.restart()
    host = desk.ready()
    for command in NEEDS_ARMED:
        if not isinstance(command, wire.Home):
            assert host.refusal(command)[0] is R.LENGTH_UNKNOWN, command


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (wire.ConfirmLength(-1, 1), R.BAD_VALUE),
        (wire.ConfirmLength(530_001, 1), R.OVER_LIMIT),
        (wire.SelectZone(3), R.BAD_VALUE),
        (wire.SelectZone(254), R.BAD_VALUE),
        (wire.GetSensor(10), R.BAD_VALUE),
        (wire.GetSensor(255), R.BAD_VALUE),
        (wire.GetSnapshot(254), R.NO_SNAPSHOT),
    ],
    ids=lambda value: getattr(value, "NAME", None),
)
def test_values_that_cannot_be(host: RawHost, command: wire.Message, reason: R) -> None:
    assert host.refusal(command)[0] is reason


def test_snapshots_are_none_before_the_first_sweep(desk: Desk) -> None:
    desk.calm()
    desk.restart()
    host = desk.calm()
    for index in (0, 9, 255):
        assert host.refusal(wire.GetSnapshot(index)) == (R.NO_SNAPSHOT, index)


def test_growth_and_retraction_know_their_limits(ready: RawHost) -> None:
    ready.get(wire.ConfirmLength(100_000, 1))
    assert ready.refusal(wire.GrowTo(530_001, 0)) == (R.OVER_LIMIT, 530_000)
    assert ready.refusal(wire.GrowTo(50_000, 0))[0] is R.BAD_VALUE  # that is a retraction
    assert ready.refusal(wire.GrowTo(200_000, 0xFFFF_FFFF))[0] is R.BAD_VALUE
    assert ready.refusal(wire.RetractTo(200_000, 0))[0] is R.BAD_VALUE  # that is growth
    assert ready.refusal(wire.RetractTo(-1, 0))[0] is R.BAD_VALUE


def test_a_bend_needs_whole_sensors_a_zone_and_zeros(ready: RawHost) -> None:
    bends = [wire.Sweep((1500, 1500), 20_000, 1, 0), wire.SetPressure((500, 0), 0)]
    ready.get(wire.ConfirmLength(50_000, 1))  # the first sensors' middle
    for bend in bends:
        assert ready.refusal(bend)[0] is R.HALF_EVERTED
    ready.get(wire.ConfirmLength(100_000, 1))
    ready.get(wire.SelectZone(UNKNOWN_ZONE))
    for bend in bends:
        assert ready.refusal(bend)[0] is R.ZONE_UNKNOWN
    ready.get(wire.ConfirmLength(100_000, 0))  # voids the zeros, too
    ready.get(wire.SelectZone(0))
    for bend in bends:
        assert ready.refusal(bend)[0] is R.NOT_ZEROED
    for mask in (0, 1 << 10):
        assert ready.refusal(wire.ZeroSensors(mask))[0] is R.BAD_VALUE
    assert ready.refusal(wire.ZeroSensors(1)) == (R.NOT_SETTLED, 0)


def test_one_activity_at_a_time_and_disarm_ends_it(ready: RawHost) -> None:
    ready.get(wire.ConfirmLength(100_000, 1))
    ready.get(wire.ZeroSensors(0b00001_00001))
    for command in NEEDS_ARMED:
        assert ready.refusal(command)[0] is R.BUSY, command
    assert ready.get(wire.GetStatus()).activity is wire.Activity.ZEROING
    ready.get(wire.Disarm())
    report = ready.get(wire.GetStatus())
    assert (report.state, report.activity) == (wire.State.SAFE, wire.Activity.IDLE)
    ended = (wire.EventCode.ACTIVITY_ABORTED, wire.Activity.ZEROING)
    assert ready.next_frame(lambda f: ended in {(e.code, e.arg) for e in events([f])}, 5.0)


def test_a_zeroed_board_still_refuses_bends_that_cannot_be(desk: Desk) -> None:
    desk.simulated()
    host = desk.ready()
    host.get(wire.ConfirmLength(100_000, 1))
    host.get(wire.SelectZone(0))
    host.get(wire.ZeroSensors(0b00001_00001))
    done = host.next_frame(
        lambda f: f.id == wire.Event.ID and f.payload[2] == wire.EventCode.ZEROED, 10.0
    )
    assert done is not None
    host.next_frame(
        lambda f: f.id == wire.Event.ID and f.payload[2] == wire.EventCode.ACTIVITY_DONE, 1.0
    )
    for sweep in [
        wire.Sweep((-1, 0), 20_000, 1, 0),
        wire.Sweep((0, 0), 20_000, 1, 0),
        wire.Sweep((1500, 0), 20_000, 0, 0),
        wire.Sweep((1500, 0), 10, 1, 0),
        wire.Sweep((1500, 0), 0xFFFF_FFFF, 1, 0),
    ]:
        assert host.refusal(sweep)[0] is R.BAD_VALUE, sweep
    assert host.refusal(wire.Sweep((1851, 0), 20_000, 1, 0)) == (R.OVER_LIMIT, 1850)
    assert host.refusal(wire.SetPressure((500, 500), 0))[0] is R.BAD_VALUE
    assert host.refusal(wire.SetPressure((-1, 0), 0))[0] is R.BAD_VALUE
    assert host.refusal(wire.SetPressure((0, 1851), 0)) == (R.OVER_LIMIT, 1850)
    report = host.get(wire.GetSensor(0))
    assert report.flags & 0b111 == 0b111  # everted, settled, zeroed
    assert not host.get(wire.GetSensor(1)).flags & 0b001


def test_disarm_and_vent_are_accepted_whether_armed_or_not(desk: Desk) -> None:
    host = desk.calm()
    host.get(wire.Disarm())
    host.get(wire.Vent())
    host = desk.ready()
    host.get(wire.Vent())
    assert host.get(wire.GetStatus()).state is wire.State.READY
    host.get(wire.Disarm())
    assert host.get(wire.GetStatus()).state is not wire.State.READY


# Stop.

STOPPED = wire.Fault.STOPPED.mask


@pytest.mark.parametrize(("seq", "session"), [(0, 0), (9, 0xFFFF), (0xFFFF, 1)])
def test_a_stop_is_obeyed_whatever_its_session_and_sequence(
    ready: RawHost, seq: int, session: int
) -> None:
    ready.stop(0xDEAD, seq=seq, session=session)
    report = ready.get(wire.GetStatus())  # and the conversation goes on
    assert report.state is wire.State.FAULT
    assert report.faults & STOPPED
    assert report.stop_nonce == 0xDEAD
    assert ready.refusal(wire.Arm())[0] is R.FAULT_LATCHED


def test_a_stop_ends_an_activity_and_is_told_in_an_event(ready: RawHost) -> None:
    ready.get(wire.ConfirmLength(100_000, 1))
    ready.get(wire.ZeroSensors(0b00001_00001))
    ready.stop(0x1234)
    said = {(e.code, e.arg): e.value for e in events(ready.listen(0.5))}
    assert said[wire.EventCode.FAULT, wire.Fault.STOPPED] == 0x1234
    assert said[wire.EventCode.ACTIVITY_ABORTED, wire.Activity.ZEROING] == R.FAULT_LATCHED
    assert ready.get(wire.GetStatus()).activity is wire.Activity.IDLE


def test_a_stop_does_not_wait_behind_a_command_that_works(host: RawHost) -> None:
    host.get(wire.SetParameter(SETTLE, random.randrange(600_000)))
    host.seq += 1
    host.send(wire.SaveConfig())
    host.stop(0x77)
    assert host.answer(host.seq, host.session, LONG_S) is not None  # and the save ends well
    assert host.get(wire.GetStatus()).faults & STOPPED


def test_a_stop_before_the_first_hello(desk: Desk) -> None:
    desk.restart()
    host = desk.host
    host.stop(0xB007)
    host.hello()
    report = host.get(wire.GetStatus())
    assert report.state is wire.State.FAULT
    assert report.stop_nonce == 0xB007


def test_a_stop_survives_another_host(host: RawHost) -> None:
    host.stop(0x5EED)
    host.hello()
    report = host.get(wire.GetStatus())
    assert report.state is wire.State.FAULT
    assert report.faults & STOPPED
    assert report.stop_nonce == 0x5EED
    assert host.refusal(wire.Arm())[0] is R.FAULT_LATCHED


def test_a_stop_survives_a_restart(desk: Desk) -> None:
    """Opening the port resets the board: no program gets round a stop so."""
    desk.calm().stop(0x5EED)
    desk.restart()
    host = desk.host
    host.hello()
    report = host.get(wire.GetStatus())
    assert report.faults & STOPPED
    assert report.stop_nonce == 0x5EED
    assert host.refusal(wire.Arm())[0] is R.FAULT_LATCHED
    host.get(wire.ClearStop(0x5EED))
    desk.restart()
    desk.host.hello()
    assert not desk.host.get(wire.GetStatus()).faults & STOPPED


def test_a_latched_fault_survives_a_restart_until_it_is_cleared(desk: Desk) -> None:
    host = desk.ready()
    host.beating = False
    host.listen(0.8)
    silent = wire.Fault.HOST_SILENT.mask
    assert host.get(wire.GetStatus()).faults & silent
    desk.restart()
    host = desk.host
    host.hello()
    assert host.get(wire.GetStatus()).faults & silent
    said = {(e.code, e.arg): e.value for e in events(host.listen(0.5))}
    assert said[wire.EventCode.FAULT, wire.Fault.HOST_SILENT] == -1
    assert host.refusal(wire.Arm())[0] is R.FAULT_LATCHED
    host.beat()
    assert not host.get(wire.ClearFaults(0xFFFF)).detail & silent
    desk.restart()
    desk.host.hello()
    assert not desk.host.get(wire.GetStatus()).faults & silent


def test_power_on_forgets_a_stop_and_faults(desk: Desk) -> None:
    board = desk.simulated()
    host = desk.ready()
    host.beating = False
    host.listen(0.8)
    host.stop(0x5EED)
    assert host.get(wire.GetStatus()).faults & wire.Fault.HOST_SILENT.mask
    board.reset(wire.ResetCause.POWER_ON)
    desk.host.drop_pending()
    desk.wait_for_boot()
    desk.host.hello()
    report = desk.host.get(wire.GetStatus())
    assert not report.faults & ~wire.Fault.BAD_CONFIG.mask
    assert report.stop_nonce == 0


def test_only_a_clear_that_names_the_latest_stop_lets_go(host: RawHost) -> None:
    host.stop(0x111)
    host.stop(0x222)
    assert host.get(wire.ClearFaults(0xFFFF)).detail & STOPPED
    for nonce in (0x111, 0, 0x222 ^ 1):
        assert host.refusal(wire.ClearStop(nonce))[0] is R.STOPPED_AGAIN
        assert host.get(wire.GetStatus()).faults & STOPPED
    assert host.get(wire.ClearStop(0x222)).detail & STOPPED == 0
    assert host.get(wire.GetStatus()).stop_nonce == 0
    host.get(wire.ClearStop(0x222))  # nothing is latched: nothing to do
    host.beat()
    host.get(wire.Arm())
    assert host.get(wire.GetStatus()).state is wire.State.READY


def test_a_stale_copy_may_stop_and_never_clears(host: RawHost) -> None:
    host.stop(0x111)
    clear = host.seq + 1
    host.get(wire.ClearStop(0x111))
    host.stop(0x111)  # an old copy of the stop
    for seq in (clear, clear - 1, host.seq):  # of the clear
        host.send(wire.ClearStop(0x111), seq=seq)
        host.answer(seq, host.session, 0.1)
        assert host.get(wire.GetStatus()).faults & STOPPED
    host.send(wire.ClearStop(0x111), seq=host.seq + 1, session=host.session ^ 1)
    assert host.get(wire.GetStatus()).faults & STOPPED
    host.get(wire.ClearStop(0x111))


def test_a_stop_among_noise_is_obeyed(host: RawHost) -> None:
    """Cut off frames before it, bytes lost and inserted: one whole copy is enough."""
    rng = random.Random(1)
    wired = encode(wire.Stop(0xCAFE), 0, 0)
    host.transport.write(encode(wire.GetStatus(), host.seq + 1, host.session)[:-4])
    for _ in range(20):
        at = rng.randrange(len(wired))
        host.transport.write(b"\0" + wired[:at] + rng.randbytes(rng.randint(1, 9)) + wired[at:])
        host.transport.write(b"\0" + wired[:at] + wired[at + 1 :])
        host.listen(0.05)
    host.transport.write(b"\0" + wired)
    echo = host.next_frame(lambda f: f.id == wire.Stopped.ID, 0.5)
    assert echo is not None
    assert echo.message() == wire.Stopped(0xCAFE)


@pytest.mark.parametrize("size", [0, 3, 5, 8])
def test_a_stop_of_the_wrong_size_is_dropped(host: RawHost, size: int) -> None:
    before = stats(host)
    host.send(RawMessage(wire.Stop.ID, bytes(size)), seq=0, session=0)
    assert host.next_frame(lambda f: f.id == wire.Stopped.ID, 0.1) is None
    assert not host.get(wire.GetStatus()).faults & STOPPED
    assert stats(host).rx_stale - before.rx_stale == 1


# Reports.


def test_every_sensor_reports(host: RawHost) -> None:
    host.get(wire.ConfirmLength(300_000, 0))
    for sensor in range(10):
        report = host.get(wire.GetSensor(sensor))
        assert report.sensor == sensor
        assert report.flex_sum <= 1023 * 16
        assert report.flags & 1 == (sensor % 5 < 3)  # everted: those at 5, 15 and 25 cm
        if report.flags & 1:
            assert 0 < report.settle_left_ms <= DEFAULTS[SETTLE]
    report = host.get(wire.GetStatus())
    assert report.everted_mask == 0b00111_00111
    assert report.length_um == pytest.approx(300_000, abs=100)
    assert report.conditions & wire.Condition.LENGTH_KNOWN.mask


def test_the_link_counts_what_it_hears(desk: Desk) -> None:
    host = desk.calm()
    first = stats(host)
    for _ in range(10):
        host.get(wire.GetStatus())
    second = stats(host)
    assert second.rx_frames - first.rx_frames == 11
    assert (second.rx_bad, second.rx_stale, second.rx_overruns) == (
        first.rx_bad,
        first.rx_stale,
        first.rx_overruns,
    )
    # Where time is virtual, a pass of the main loop takes none.
    board = host.hello().board
    virtual = board in (wire.BoardKind.VIRTUAL, wire.BoardKind.UNIX, wire.BoardKind.CORTEX_M3, 128)
    assert (second.loop_max_us > 0) is not virtual
    assert second.loop_max_us < 5000
