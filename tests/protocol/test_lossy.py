"""Over a bad cable no command is carried out twice or out of order, and each ends in time.

Against the reference device, which logs what it executes, and against the firmware core, whose
executions show in what it holds: a parameter counted upwards and the generation of its store.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from itertools import count

import numpy as np
import pytest
from channel import FAULTS, Channel, LoopTransport
from reference_device import ReferenceDevice

from thigmo.emulator._board import VirtualBoard
from thigmo.errors import BoardResetError, LinkError
from thigmo.link import protocol as wire
from thigmo.link.client import Client

SETTLE = wire.PARAMETERS["settle_ms"].index
RATES = (0.0, 0.02, 0.1, 0.2)
SLACK_S = 0.05  # a tick of the clock, and the round trip under way


def bad_cable(device: ReferenceDevice | VirtualBoard, rate: float, seed: int) -> LoopTransport:
    rng = random.Random(seed)
    return LoopTransport(device, Channel(rng, rate), Channel(rng, rate))


def virtual_board(seed: int) -> VirtualBoard:
    board = VirtualBoard(seed)
    counts = np.full((16, 2), 660.0)
    counts[10:12] = 102.4  # both muscles empty
    board.set_analog(counts)
    return board


def connected(transport: LoopTransport) -> Client:
    """A client; a hello may fail on such a line, and is then tried again."""
    client = Client(transport, connect=False)
    connect(client)
    return client


def connect(client: Client) -> None:
    for _ in range(10):
        try:
            client.connect()
        except LinkError:
            continue
        return
    pytest.fail("no conversation in ten attempts")


class Witness:
    """Sends commands and keeps what became of them."""

    def __init__(self, client: Client) -> None:
        self.client = client
        self.sent: list[wire.Message] = []
        self.done: list[wire.Message] = []
        self.unknown: list[wire.Message] = []

    def send(self, command: wire.Command[wire.Message]) -> wire.Message | None:
        """The reply, or None after a typed error; asserts that either comes by the deadline."""
        client = self.client
        self.sent.append(command)
        began = client.now()
        reply, failure = None, None
        try:
            reply = client.request(command)
        except LinkError as error:
            failure = error
        assert client.now() - began <= command.DEADLINE_S + SLACK_S, failure
        if failure is None:
            self.done.append(command)
            return reply
        assert failure.next_step
        self.unknown.append(command)
        if isinstance(failure, BoardResetError):
            connect(client)
        return None


def counted() -> Iterator[wire.SetParameter]:
    return (wire.SetParameter(SETTLE, value) for value in count(1))


def assert_executed_once_in_order(device: ReferenceDevice, witness: Witness) -> None:
    """Each value differs, so the log itself tells of repeats and of wrong order."""
    log = [m.value for _, m in device.executed if isinstance(m, wire.SetParameter)]
    assert log == sorted(set(log)), "executed twice or out of order"
    acknowledged = {m.value for m in witness.done if isinstance(m, wire.SetParameter)}
    assert acknowledged <= set(log), "acknowledged, but not executed"


@pytest.mark.parametrize(
    "seed", [*range(8), *(pytest.param(n, marks=pytest.mark.nightly) for n in range(8, 100))]
)
@pytest.mark.parametrize("rate", RATES)
def test_commands_execute_once_and_in_order(rate: float, seed: int) -> None:
    device = ReferenceDevice(seed)
    transport = bad_cable(device, rate, seed)
    witness = Witness(connected(transport))
    commands = counted()
    for _ in range(150):
        reply = witness.send(next(commands))
        if reply is not None:
            assert isinstance(reply, wire.ParameterValue)
            assert reply.value == witness.sent[-1].value  # of this command, not a stale one
    assert_executed_once_in_order(device, witness)
    assert len(witness.done) >= 145
    if rate == 0.0:
        assert witness.unknown == []
        assert witness.client.stats.repeats == 0


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_alone_is_survived(fault: str) -> None:
    device = ReferenceDevice(9)
    rng = random.Random(9)
    there, back = Channel(rng, 0.2, (fault,)), Channel(rng, 0.2, (fault,))
    witness = Witness(connected(LoopTransport(device, there, back)))
    commands = counted()
    for _ in range(100):
        witness.send(next(commands))
    assert there.injected[fault] > 10
    assert_executed_once_in_order(device, witness)
    assert len(witness.done) >= 97


@pytest.mark.parametrize("rate", RATES)
def test_a_save_that_takes_seconds_is_carried_out_once(rate: float) -> None:
    device = ReferenceDevice(3)
    witness = Witness(connected(bad_cable(device, rate, 3)))
    for _ in range(6):
        witness.send(wire.SaveConfig())
    saves = sum(isinstance(m, wire.SaveConfig) for _, m in device.executed)
    assert len(witness.done) <= saves <= len(witness.sent)
    assert len(witness.done) >= 5


@pytest.mark.parametrize("rate", RATES)
def test_every_event_arrives_once(rate: float) -> None:
    device = ReferenceDevice(4)
    client = connected(bad_cable(device, rate, 4))
    got: list[int] = []
    client.on_event.append(lambda event: got.append(event.message.value))
    for value in range(40):
        device.event(wire.EventCode.EVERTED, 0, value)
        client.wait_for(lambda: False, 0.05)
    client.wait_for(lambda: not device.events, 60.0)
    assert sorted(got) == list(range(40))
    assert not device.events


@pytest.mark.parametrize("rate", RATES)
def test_telemetry_is_counted_and_in_order(rate: float) -> None:
    device = ReferenceDevice(5)
    client = connected(bad_cable(device, rate, 5))
    times: list[int] = []
    client.on_telemetry.append(lambda frame: times.append(frame.device_us))
    client.wait_for(lambda: False, 10.0)
    assert times == sorted(set(times))
    stats = client.stats
    assert stats.telemetry + stats.telemetry_lost == pytest.approx(2000, abs=20)
    assert (stats.telemetry_lost == 0) == (rate == 0.0)
    assert stats.telemetry_lost <= 2000 * (rate + 0.05) * 2


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("rate", [0.0, 0.1])
def test_a_reset_at_any_byte_ends_in_a_typed_error_and_a_new_conversation(
    rate: float, seed: int
) -> None:
    rng = random.Random(seed)
    for at in range(0, 1400, 7):
        device = ReferenceDevice(at)
        transport = bad_cable(device, rate, at)
        transport.reset_at = at + rng.randrange(7)
        witness = Witness(connected(transport))
        commands = counted()
        while transport.reset_at is not None:
            witness.send(next(commands))
        for _ in range(5):
            witness.send(next(commands))
        assert device.boots == 2
        assert_executed_once_in_order(device, witness)
        assert len(witness.unknown) <= (1 if rate == 0.0 else 2), at
        assert witness.send(next(commands)) is not None or rate > 0.0
        witness.client.close()


def test_resets_again_and_again() -> None:
    device = ReferenceDevice(8)
    transport = bad_cable(device, 0.05, 8)
    rng = random.Random(8)
    witness = Witness(connected(transport))
    commands = counted()
    for _ in range(200):
        if transport.reset_at is None and rng.random() < 0.2:
            transport.reset_at = transport.bytes_passed + rng.randrange(400)
        witness.send(next(commands))
    assert device.boots > 10
    assert_executed_once_in_order(device, witness)
    assert len(witness.done) > 100


class Held:
    """What the firmware may hold, by what was acknowledged and what was left open."""

    def __init__(self) -> None:
        self.values: set[int] = set()
        self.certain = 0

    def acknowledged(self, value: int) -> None:
        self.values = {value}
        self.certain = value

    def open(self, value: int) -> None:
        self.values.add(value)


@pytest.mark.parametrize("rate", RATES)
def test_the_firmware_executes_once_and_in_order(rate: float) -> None:
    board = virtual_board(11)
    witness = Witness(connected(bad_cable(board, rate, 11)))
    held = Held()
    default = wire.PARAMETERS["settle_ms"].defaults[0]
    held.acknowledged(default)
    for number, setting in zip(range(80), counted(), strict=False):
        if witness.send(setting) is not None:
            held.acknowledged(setting.value)
        else:
            held.open(setting.value)
        if number % 4 == 0:
            reply = witness.send(wire.GetParameter(SETTLE))
            if isinstance(reply, wire.ParameterValue):
                assert reply.value in held.values
                held.acknowledged(reply.value)  # and a stale copy must not change it again
    assert len(witness.unknown) <= 3
    saves = 3
    for _ in range(saves):
        witness.send(wire.SaveConfig())
    report = witness.send(wire.GetStatus())
    assert isinstance(report, wire.StatusReport)
    lost = sum(isinstance(m, wire.SaveConfig) for m in witness.unknown)
    assert saves - lost <= report.config_generation <= saves


@pytest.mark.parametrize("seed", range(12))
def test_the_firmware_reset_at_any_byte(seed: int) -> None:
    board = virtual_board(seed)
    transport = bad_cable(board, 0.05, seed)
    rng = random.Random(seed)
    witness = Witness(connected(transport))
    held = Held()
    default = wire.PARAMETERS["settle_ms"].defaults[0]
    commands = counted()
    boots = board.boots
    transport.reset_at = transport.bytes_passed + rng.randrange(1500)
    for _ in range(25):
        command = next(commands)
        reply = witness.send(command)
        if board.boots != boots:
            boots = board.boots
            held.open(default)  # nothing was saved
        if reply is not None:
            held.acknowledged(command.value)
        else:
            held.open(command.value)
    reply = witness.send(wire.GetParameter(SETTLE))
    if isinstance(reply, wire.ParameterValue):
        assert reply.value in held.values
    assert transport.reset_at is None
    assert len(witness.unknown) <= 3


@pytest.mark.parametrize("rate", RATES)
def test_a_stop_is_confirmed_and_stays_whatever_the_line_repeats(rate: float) -> None:
    board = virtual_board(21)
    transport = bad_cable(board, rate, 21)
    witness = Witness(connected(transport))
    for number in range(10):
        before = witness.client.now()
        witness.client.stop()
        assert witness.client.now() - before < 1.0
        # Whatever else passes, old clears among it, the board stays stopped.
        for _ in range(10):
            witness.send(wire.ClearFaults(0xFFFF))
            report = witness.send(wire.GetStatus())
            if isinstance(report, wire.StatusReport):
                assert report.faults & wire.Fault.STOPPED.mask, number
                nonce = report.stop_nonce
        witness.send(wire.ClearStop(nonce))


def test_a_stop_is_not_sent_into_a_boot_loader() -> None:
    board = virtual_board(22)
    transport = LoopTransport(board)
    client = connected(transport)
    board.reset(wire.ResetCause.EXTERNAL)
    began = client.now()
    sent: list[float] = []
    client.taps.append(lambda way, _, t: sent.append(t - began) if way == "tx" else None)
    client.wait_for(lambda: client.now() > began + 0.7, 5.0)
    sent.clear()
    client.stop()
    assert sent[0] > 0.83  # the boot loader's time
    assert client.now() - began < 1.5
