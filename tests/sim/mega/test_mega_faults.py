"""Harm done to the real image: power, resets, hangs, cables, a USB bridge that makes bytes up."""

from __future__ import annotations

import random
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from rig import Rig, open_rig

from thigmo.emulator.chip import Cause
from thigmo.emulator.mega_sim import SimulatedMega
from thigmo.emulator.scene import Scene
from thigmo.emulator.usb_bridge import UsbBridge
from thigmo.errors import BoardResetError, CommandRefusedError, RobotFaultError
from thigmo.link import protocol as wire
from thigmo.link.framing import Decoder, encode

SETTLE = wire.PARAMETERS["settle_ms"].index
# Of the two slots (firmware/core/config/store.h), and what it may hold: committed, spoiled, blank.
COMMIT_BYTES = (16, 16 + 2048 // 2 - 8)
WHOLE_COMMIT_BYTES = (0xA7, 0x00, 0xFF)


# --- power cut while saving -----------------------------------------------------------------------
def ask(mega: SimulatedMega, message: wire.Message, seq: int, session: int) -> wire.Message:
    """One command to a board without a plant; its reply."""
    mega.write(encode(message, seq, session))
    decoder = Decoder()
    for _ in range(100):
        mega.step(1)
        for frame in decoder.feed(mega.read()):
            if frame.seq == seq and 0x80 <= frame.id < 0xA0:
                return frame.message()
    raise AssertionError(f"no answer to {message}")


def booted(eeprom: bytes) -> tuple[SimulatedMega, int]:
    """A board that starts with this EEPROM, and the session of its hello."""
    mega = SimulatedMega(3, eeprom, boot_loader=False)
    mega.step(300)
    reply = ask(mega, wire.Hello(wire.PROTOCOL, wire.SCHEMA_HASH, 5), 0, 0)
    assert isinstance(reply, wire.HelloReply)
    return mega, reply.session


def stored(eeprom: bytes) -> tuple[int, int, bool]:
    """What a board makes of an EEPROM: generation, the marked parameter, whether it is valid."""
    mega, session = booted(eeprom)
    value = ask(mega, wire.GetParameter(SETTLE), 1, session)
    status = ask(mega, wire.GetStatus(), 2, session)
    assert isinstance(value, wire.ParameterValue)
    assert isinstance(status, wire.StatusReport)
    valid = bool(status.conditions & wire.Condition.CONFIG_VALID.mask)
    return status.config_generation, value.value, valid


def save(mega: SimulatedMega, session: int, value: int) -> list[bytes]:
    """Set the marked parameter and save; the EEPROM after each byte that was written."""
    assert isinstance(ask(mega, wire.SetParameter(SETTLE, value), 1, session), wire.ParameterValue)
    ask(mega, wire.ApplyParameters(), 2, session)
    contents = [mega.eeprom]
    mega.write(encode(wire.SaveConfig(), 3, session))
    decoder = Decoder()
    for _ in range(6000):
        mega.step(1)
        now = mega.eeprom
        if now != contents[-1]:
            contents.append(now)
        for frame in decoder.feed(mega.read()):
            message = frame.message()
            if isinstance(message, wire.Ack) and message.status is wire.Status.OK:
                return contents
    raise AssertionError("the save does not end")


def test_a_power_cut_at_any_byte_of_a_save_leaves_the_old_or_the_new_whole(
    stored_config: bytes, many: Callable[[int], int]
) -> None:
    mega, session = booted(stored_config)
    generation, old, valid = stored(stored_config)
    assert valid
    contents = save(mega, session, old + 1)
    assert len(contents) > 100
    assert stored(contents[-1]) == (generation + 1, old + 1, True)
    rng = random.Random(1)
    results = set()
    steps = list(pairwise(contents))
    for before, after in rng.sample(steps, min(many(30), len(steps))):
        (address,) = np.flatnonzero(np.frombuffer(before, "u1") != np.frombuffer(after, "u1"))
        # The byte that was being written may hold anything.
        torn = bytearray(before)
        torn[address] = rng.choice(
            [0xFF, 0x00, before[address] & after[address], rng.randrange(256)]
        )
        result = stored(bytes(torn))
        if address in COMMIT_BYTES and torn[address] not in WHOLE_COMMIT_BYTES:
            assert not result[2]
            continue
        assert result in {(generation, old, True), (generation + 1, old + 1, True)}, address
        results.add(result)
    assert len(results) >= 1


def cut_in_a_save(eeprom: bytes, byte: int) -> bytes:
    """The EEPROM after a save that sets another value, its power cut in the write of a byte."""
    mega, session = booted(eeprom)
    ask(mega, wire.SetParameter(SETTLE, 12_345), 1, session)
    ask(mega, wire.ApplyParameters(), 2, session)
    mega.cut_power_after(byte)
    mega.write(encode(wire.SaveConfig(), 3, session))
    for _ in range(3000):
        mega.step(1)
        if not mega.powered:
            break
    assert not mega.powered
    assert mega.drive_enabled == (False, False)
    return mega.eeprom


@pytest.mark.parametrize("byte", [7, 150, 300])
def test_power_that_fails_in_a_save_comes_back_to_the_old_configuration(
    stored_config: bytes, byte: int
) -> None:
    assert stored(cut_in_a_save(stored_config, byte)) == stored(stored_config)


def test_a_commit_byte_that_a_power_cut_left_in_between_is_damage(stored_config: bytes) -> None:
    """Nothing tells it from a flipped bit: the board asks for the configuration again."""
    _, _, valid = stored(cut_in_a_save(stored_config, 0))
    assert not valid


# --- hangs and resets -----------------------------------------------------------------------------
def sweeping(scene: Scene, eeprom: bytes) -> Rig[SimulatedMega]:
    """A robot in the middle of a sweep, its left muscle under pressure."""
    rig = open_rig(scene, eeprom)
    rig.prepare()
    rig.client.request(wire.Sweep((1200, 0), 8000, 1, 0))
    rig.robot.wait(1.5)
    assert rig.board.drive_enabled[0]
    assert rig.board.drive[0] > 300
    return rig


def notice_reset(rig: Rig[SimulatedMega], within_ms: int = 8000) -> None:
    """The board starts again, and the client says so, its heart beating all the while.

    The heart holds itself once the board is mute; the beats that were on their way keep the boot
    loader for 5.3 s after the last of them, as do the repeats of a command under way (2 s).
    """
    with pytest.raises(BoardResetError):
        rig.client.wait_for(lambda: False, within_ms / 1000)


@pytest.mark.parametrize("interrupts", [True, pytest.param(False, marks=pytest.mark.ci)])
def test_a_hung_loop_is_ended_by_the_watchdog(
    full_length: Scene, stored_config: bytes, interrupts: bool
) -> None:
    rig = sweeping(full_length, stored_config)
    rig.board.hang(interrupts=interrupts)
    assert rig.until_off(400) <= 280
    assert rig.board.chip.resets(Cause.WATCHDOG) == 1
    notice_reset(rig, 1200)  # no wait for the boot loader; a reset may cut an announcement
    assert rig.client.connect().reset_cause is wire.ResetCause.WATCHDOG
    rig.pass_ms(300)
    status = rig.client.request(wire.GetStatus())
    assert status.faults & wire.Fault.WATCHDOG.mask
    assert not status.conditions & wire.Condition.LENGTH_KNOWN.mask
    assert rig.off
    # The next start is no watchdog's.
    rig.board.reset(wire.ResetCause.EXTERNAL)
    notice_reset(rig)
    assert rig.client.connect().reset_cause is wire.ResetCause.EXTERNAL


@pytest.mark.parametrize("cause", [wire.ResetCause.EXTERNAL, wire.ResetCause.POWER_ON])
def test_the_port_opened_or_the_power_cycled_in_a_sweep_is_safe_and_noticed(
    full_length: Scene, stored_config: bytes, cause: wire.ResetCause
) -> None:
    rig = sweeping(full_length, stored_config)
    rig.board.reset(cause)
    assert rig.off, "pins float, and are pulled down"
    notice_reset(rig)
    assert rig.client.connect().reset_cause is cause
    rig.pass_ms(500)
    rig.robot.arm()
    rig.client.request(wire.SelectZone(2))
    with pytest.raises(CommandRefusedError, match="length"):
        rig.client.request(wire.Sweep((1200, 0), 8000, 1, 0))


def test_a_pulled_cable_vents_within_the_heartbeat_limit(
    full_length: Scene, stored_config: bytes
) -> None:
    rig = sweeping(full_length, stored_config)
    rig.board.plug(False)
    assert 300 <= rig.until_off(1000) <= 520
    rig.board.plug(True)
    rig.pass_ms(100)
    with pytest.raises(RobotFaultError, match="host_silent"):
        rig.robot.wait(1.0)


def test_a_sagging_supply_is_a_fault_and_a_failing_one_a_brown_out(
    full_length: Scene, stored_config: bytes
) -> None:
    rig = sweeping(full_length, stored_config)
    rig.board.set_supply_mv(4200)
    assert rig.until_off(200) <= 60
    with pytest.raises(RobotFaultError, match="brown_out"):
        rig.robot.wait(1.0)
    rig.board.set_supply_mv(5000)
    rig.board.reset(wire.ResetCause.BROWN_OUT)
    notice_reset(rig)
    assert rig.client.connect().reset_cause is wire.ResetCause.BROWN_OUT


def test_a_stray_byte_in_the_boot_loaders_window_delays_the_start_but_not_for_ever() -> None:
    mega = SimulatedMega(3)
    mega.step(300)
    mega.write(b"\x55")
    mega.step(700)
    assert not mega.running
    for _ in range(12_000):
        mega.step(1)
        if mega.running:
            break
    assert mega.running
    # Half of 16e6 turns of ten cycles, counted from the byte on; then the check of the image.
    assert 5_300 < mega.now_us / 1000 < 5_300 + 300
    assert mega.drive_enabled == (False, False)


# --- the line -------------------------------------------------------------------------------------
@pytest.mark.parametrize("baud", [250_000, pytest.param(500_000, marks=pytest.mark.ci)])
def test_no_command_is_lost_or_done_twice_over_a_bridge_that_inserts_and_replays(
    full_length: Scene, stored_config: bytes, baud: int
) -> None:
    usb = UsbBridge(9, insert=0.03, replay=0.03)
    rig = open_rig(full_length, stored_config, usb=usb, baud=baud)
    rng = random.Random(4)
    held = {n: rig.client.request(wire.GetParameter(n)).value for n in range(40, 44)}
    for _ in range(120):
        number = rng.choice(list(held))
        if rng.random() < 0.5:
            held[number] = held[number] ^ 1
            reply = rig.client.request(wire.SetParameter(number, held[number]))
        else:
            reply = rig.client.request(wire.GetParameter(number))
        assert (reply.index, reply.value) == (number, held[number])
    stats = rig.client.request(wire.GetLinkStats())
    assert usb.inserted > 3
    assert usb.replayed > 3
    assert stats.rx_overruns == 0
    assert rig.client.hello.board is wire.BoardKind.MEGA
