"""`thigmo flash` into the real boot loader, on a simulated Mega behind a pseudo-terminal."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from pty_mega import PtyMega
from served import EVER_S
from typer.testing import CliRunner

from thigmo.cli.main import app
from thigmo.emulator import mega_build
from thigmo.emulator.chip import Cause, Chip
from thigmo.errors import (
    ConfigError,
    LinkError,
    NotARobotError,
    PortError,
    SchemaMismatchError,
)
from thigmo.link import client as client_module
from thigmo.link import flash as flasher
from thigmo.link import protocol as wire
from thigmo.link.image import MAGIC, read_hex, read_image, write_hex

needs_avrdude = pytest.mark.skipif(
    shutil.which("avrdude") is None or not mega_build.BOOT_LOADER.exists(),
    reason="avrdude or arduino-core-avr (the boot loader) is not installed",
)


@pytest.fixture(scope="module")
def image() -> Path:
    return mega_build.firmware_hex()


def patched(image: Path, target: Path, old: bytes, new: bytes) -> Path:
    """A copy of an image with some bytes replaced."""
    return write_hex(target, [(start, data.replace(old, new)) for start, data in read_hex(image)])


def test_the_image_says_what_it_is(image: Path) -> None:
    content = read_image(image)
    assert content.schema_hash == wire.SCHEMA_HASH
    assert content.protocol == wire.PROTOCOL
    assert 20_000 < len(content.program) < 130_000


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Waits in the computer's time for a chip whose own time may pass far more slowly."""
    monkeypatch.setattr(flasher, "_DEADLINE_S", 10 * flasher._DEADLINE_S)
    monkeypatch.setattr(client_module, "SILENCE_S", EVER_S)  # an announce ends it
    monkeypatch.setattr(wire.Hello, "DEADLINE_S", EVER_S)


@pytest.mark.realtime
@needs_avrdude
@pytest.mark.usefixtures("patient")
def test_flashing_writes_verifies_and_meets_the_new_firmware(image: Path) -> None:
    with PtyMega() as mega:
        mega.chip.write("flash", 0, bytes(range(256)) * 0x1C0)  # a program of before
        result = CliRunner().invoke(
            app, ["flash", "--robot", mega.path, "--image", str(image), "--json"]
        )
        assert result.exit_code == 0, result.output
        said = json.loads(result.stdout)
        assert said["bytes"] == len(read_image(image).program)
        assert said["schema_hash"] == f"{wire.SCHEMA_HASH:08x}"
        assert mega.opened == 3, "by avrdude for all but page 0, for page 0, and for the hello"
        for start, data in read_hex(image):
            assert mega.chip.read("flash", start, len(data)) == data


@pytest.mark.realtime
@needs_avrdude
def test_another_board_is_told_by_its_signature_and_left_as_it_was(image: Path) -> None:
    with PtyMega() as mega:
        # Where the boot loader answers with its signature: `ldi r24, 0x98` becomes 0x95.
        assert mega.chip.read("flash", 0x3F330, 2) == b"\x88\xe9"
        mega.chip.write("flash", 0x3F330, b"\x85\xe9")
        with pytest.raises(NotARobotError, match=r"no Mega 2560 \(signature 1e9501\); connect"):
            flasher.flash(mega.path, image)
        assert mega.chip.read("flash", 0, 1024) == b"\xff" * 1024


@pytest.mark.realtime
@needs_avrdude
def test_a_board_without_boot_loader_is_told_apart(image: Path) -> None:
    chip = Chip()
    chip.write("flash", 0, b"\xff\xcf")  # `rjmp .-2`: it runs, and says nothing
    chip.reset(Cause.POWER_ON)
    with PtyMega(chip) as mega, pytest.raises(NotARobotError, match="reset button"):
        flasher.flash(mega.path, image)


def test_an_image_of_another_schema_is_refused_before_anything_is_written(
    image: Path, tmp_path: Path
) -> None:
    schema_hash = wire.SCHEMA_HASH ^ 1
    wrong = patched(
        image,
        tmp_path / "other.hex",
        MAGIC + wire.SCHEMA_HASH.to_bytes(4, "little"),
        MAGIC + schema_hash.to_bytes(4, "little"),
    )
    with pytest.raises(SchemaMismatchError, match=f"{schema_hash:08x}.*{wire.SCHEMA_HASH:08x}"):
        flasher.flash("/dev/nonexistent", wrong)


def test_what_is_no_image_is_refused(tmp_path: Path) -> None:
    blink = tmp_path / "blink.hex"
    blink.write_text(":100000000C9435000C945D000C945D000C945D0024\n:00000001FF\n")
    with pytest.raises(ConfigError, match="not a thigmo image"):
        flasher.flash("/dev/nonexistent", blink)
    damaged = tmp_path / "damaged.hex"
    damaged.write_text(":100000000C9435000C945D000C945D000C945D0025\n")
    with pytest.raises(ConfigError, match="damaged"):
        flasher.flash("/dev/nonexistent", damaged)
    with pytest.raises(ConfigError, match="cannot read"):
        flasher.flash("/dev/nonexistent", tmp_path / "nowhere.hex")


def test_a_missing_port_is_named(image: Path) -> None:
    with pytest.raises(PortError, match="no port /dev/thigmo-nowhere"):
        flasher.flash("/dev/thigmo-nowhere", image)


def test_missing_avrdude_is_named(image: Path) -> None:
    with pytest.raises(PortError, match="avrdude is not installed"):
        flasher.flash("/dev/ttyACM0", image, avrdude="no-such-avrdude")


@pytest.mark.parametrize(
    ("output", "kind", "says"),
    [
        ("ser_open(): can't open device \"/dev/x\": Permission denied", PortError, "group"),
        ("ser_open(): can't open device \"/dev/x\": Device or resource busy", PortError, "use"),
        ("Device signature = 0x1e9801\nverification error, first mismatch at byte 0x0100",
         LinkError, "cable"),
        ("Device signature = 0x1e950f (probably m328p)\nexpected signature for ATmega2560 is 1E 98"
         " 01", NotARobotError, "1e950f"),
        ("avrdude error: timeout\navrdude error: timeout communicating with programmer\n"
         "avrdude error: unable to open programmer wiring on port /dev/x", NotARobotError,
         "reset button"),
        ("avrdude: ser_send(): write error: Input/output error", LinkError, "plug it in"),
        ("avrdude: something new error: 42", LinkError, "something new"),
    ],
)  # fmt: skip
def test_failures_of_avrdude_are_explained(output: str, kind: type[LinkError], says: str) -> None:
    error = flasher.explain(output, "/dev/x")
    assert type(error) is kind
    assert says in str(error)
    assert error.next_step
