"""The Pico's image, as `thigmo flash` writes it, on a simulated RP2040: what a lab would see."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from pico_machine import Pico, missing

from thigmo.emulator.micropython_build import BUILD
from thigmo.emulator.scene import Scene
from thigmo.emulator.transport import EmulatorTransport
from thigmo.link import protocol as wire
from thigmo.link.client import Client
from thigmo.link.pico import STORE_AT, build_uf2, read_uf2, write_uf2
from thigmo.robot.robot import Robot

pytestmark = pytest.mark.ci
BOOT_S = 0.12
START_CM = 20.0
RAM = 0x20000000


@pytest.fixture(scope="module")
def image() -> Path:
    if reason := missing():
        pytest.skip(reason)
    return build_uf2()


@pytest.fixture
def pico(image: Path) -> Iterator[Pico]:
    chip = Pico(image)
    yield chip
    chip.close()


@pytest.fixture
def transport(pico: Pico) -> EmulatorTransport:
    scene = Scene.load("empty").model_copy(update={"start_length_cm": START_CM})
    opened = EmulatorTransport(scene, pico, seed=5)
    opened.pass_time(BOOT_S)
    return opened


def test_the_image_is_one_that_the_boot_rom_starts(image: Path) -> None:
    read = read_uf2(image)  # blocks, boot stage, vectors, signature
    assert read.schema_hash == wire.SCHEMA_HASH
    assert len(read.program) <= STORE_AT


def test_what_the_controllers_core_runs_lies_in_ram(image: Path) -> None:
    """Code, constants and what they call: flash stands still while it is written."""
    folder = image.parent
    listed = subprocess.run(
        ["arm-none-eabi-nm", folder / "firmware.elf"], check=True, capture_output=True, text=True
    ).stdout
    places = {name: int(at, 16) for at, _, name in map(str.split, listed.splitlines()) if at != "U"}
    (built,) = (BUILD / "pico" / "CMakeFiles").rglob("pico.cpp.o")
    named = subprocess.run(
        ["arm-none-eabi-nm", built], check=True, capture_output=True, text=True
    ).stdout
    symbols = re.findall(r"^[0-9a-f]+ [TWVrR] (\S+)$", named, re.M)
    assert len(symbols) > 50
    assert [name for name in symbols if name in places and places[name] < RAM] == []


def ready(transport: EmulatorTransport) -> Client:
    """A client of a board that is armed with the defaults, stored; its length is known."""
    client = Client(transport)
    client.request(wire.LoadDefaults())  # core 0 writes the flash
    transport.pass_time(0.1)
    client.request(wire.ClearFaults(0xFFFF))
    robot = Robot(client)
    robot.confirm_length(START_CM, settled=True)
    robot.select_body_pressure(0)
    robot.arm()
    return client


def test_hello_growth_and_a_stop_that_outlasts_a_reset(
    pico: Pico, transport: EmulatorTransport
) -> None:
    client = ready(transport)
    assert client.hello.board is wire.BoardKind.PICO
    assert client.hello.reset_cause is wire.ResetCause.POWER_ON
    client.request(wire.GrowTo(205_000, 0))
    transport.pass_time(0.4)
    assert pico.motor > 0
    assert pico.motor_enables == (True, True)
    status = client.request(wire.GetStatus())
    # The chip's own interrupts have counted the encoder's edges.
    assert status.length_um == pytest.approx(1e4 * transport.lockstep.plant.length_cm, abs=200)
    assert status.length_um > 1e4 * START_CM + 500
    assert status.encoder_errors == 0
    assert status.supply_mv == pytest.approx(5000, abs=5)
    client.stop()
    assert pico.braked
    transport.pass_time(0.1)
    assert not any(pico.air + pico.motor_enables)
    stats = client.request(wire.GetLinkStats())
    assert (stats.rx_bad, stats.rx_overruns, stats.tx_dropped) == (0, 0, 0)
    assert stats.loop_max_us < 500
    pico.interrupt()
    pico.type("import machine; machine.reset()\r")
    transport.pass_time(0.1 + BOOT_S)
    assert pico.boots == 2
    again = Client(transport)
    assert again.hello.reset_cause is wire.ResetCause.EXTERNAL
    assert again.hello.boot_nonce != client.hello.boot_nonce
    assert again.request(wire.GetStatus()).faults & wire.Fault.STOPPED.mask
    assert pico.fetched == []  # the controller's core has not touched the flash


def test_ctrl_c_puts_the_outputs_off_before_python_goes_on(
    pico: Pico, transport: EmulatorTransport
) -> None:
    client = ready(transport)
    client.request(wire.TestOutput(wire.Output.TRANSDUCER, 0, 300, 500))
    transport.pass_time(0.05)
    assert pico.drive_enabled == (True, False)
    pico.type("\x03")
    pico.step(5)
    assert pico.drive_enabled == (False, False)
    pico.step(20)
    assert sum(pico.said["toggles"]) == 0
    pico.type("import os; print(sorted(os.listdir()))\r")
    pico.until("['main.py', 'pins.py']")  # for the lab to edit


def test_the_prompt_reads_and_commands_once_the_host_is_silent(
    pico: Pico, transport: EmulatorTransport
) -> None:
    client = Client(transport)
    client.request(wire.LoadDefaults())
    client.request(wire.ClearFaults(0xFFFF))
    transport.stop_heartbeat()
    pico.until(">>> ")
    transport.pass_time(0.7)
    for line, answer in (
        ("board.confirm_length(20, True); board.select_zone(0); board.length()", "20.0"),
        ("board.arm(); board.grow_to(20.5); board.state()", "'moving'"),
        ("board.curvature()", "None, None"),
    ):
        pico.type(line + "\r")
        pico.until(answer)
    transport.pass_time(0.1)
    assert pico.motor > 0
    transport.pass_time(0.7)
    assert pico.braked  # nobody beats
    pico.type("board.faults()\r")
    pico.until("host_silent")


def test_a_controller_that_stands_still_is_reset_by_the_watchdog(
    pico: Pico, transport: EmulatorTransport
) -> None:
    pico.interrupt()
    pico.type("board.start()\r")
    pico.step(50)
    off = "machine.mem32[0x40010004] = 1 << 16"  # power of the second core
    pico.type(f"import machine; {off}\r")
    transport.pass_time(0.5 + BOOT_S)
    assert pico.boots == 2
    assert Client(transport).hello.reset_cause is wire.ResetCause.WATCHDOG


def test_a_pin_map_that_the_chip_cannot_serve_is_refused(pico: Pico) -> None:
    pico.step(1000 * BOOT_S)
    pico.interrupt()
    pico.type("import thigmo_board; from pins import PINS\r")
    for name, pin, says in (
        ("link_tx", 14, "link_tx and link_rx"),
        ("adc_sck", 14, "adc_sck, adc_mosi and adc_miso"),
        ("supply", 22, "supply is not"),
        ("motor_pwm", 18, "share"),
        ("estop", 25, "on the Pico itself"),
    ):
        pico.type(f"thigmo_board.Board(PINS | {{'{name}': {pin}}}).start()\r")
        pico.until(says)


def test_conversions_begin_where_they_should(pico: Pico) -> None:
    pico.step(200)
    early, late = pico.said["starts"]
    assert late - early < 6.0  # of 40 us


def test_a_damaged_boot_stage_does_not_start(image: Path, tmp_path: Path) -> None:
    program = bytearray(read_uf2(image).program)
    program[100] ^= 1
    with pytest.raises(ConnectionError, match="boot2"):
        Pico(write_uf2(tmp_path / "damaged.uf2", bytes(program)))
