"""Writes a firmware image to an Arduino Mega 2560 and checks that it runs.

avrdude does the writing, through the board's own boot loader; this module checks what goes in,
says what its failures mean, and waits for the hello of what booted.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from thigmo.errors import ConfigError, LinkError, NotARobotError, PortError
from thigmo.link import protocol as wire
from thigmo.link.client import Client
from thigmo.link.image import PAGE, Image, build_image, read_hex, read_image, write_hex
from thigmo.link.stored import StoredConfiguration
from thigmo.link.transport import open_transport

BOOT_LOADER_BAUD = 115_200
_DEADLINE_S = 180.0
_MEGA_2560 = "1e9801"
HOLD = b"\xff\xcf" * (PAGE // 2)
"""A page 0 that starts nothing: each word is a jump to itself, the outputs stay as a reset leaves
them, off."""

# What avrdude says, what it means, and what to do. First match counts.
_FAILURES: dict[str, LinkError] = {
    r"permission denied": PortError(
        "you may not open {port}", "join the port's group (often dialout) and log in again"
    ),
    r"(no such file|cannot find the file)": PortError(
        "there is no port {port}", "plug the board in and look which port appears"
    ),
    r"(busy|resource temporarily unavailable|access is denied)": PortError(
        "{port} is in use", "close the other program (a serial monitor?) and try again"
    ),
    r"(device signature = 0x(?!1e9801)|expected signature)": NotARobotError(
        "the board on {port} is no Mega 2560 (signature {signature})",
        "connect an Arduino Mega 2560, or give its port",
    ),
    r"(verification (error|mismatch)|content mismatch)": LinkError(
        "the board's memory differs from the image that was written",
        "flash again; if it happens twice, change the USB cable and its supply",
    ),
    r"timeout|getsync|not (in sync|responding)|can't communicate|programmer is not": NotARobotError(
        "no boot loader answers on {port}",
        "check that it is the Mega's port and press its reset button as you start again;"
        " a Mega without its boot loader needs an ISP programmer once",
    ),
    r"(can't open device|unable to open|cannot open port)": PortError(
        "{port} cannot be opened", "check the port's name, and that no other program uses it"
    ),
    r"(input/output error|write error|read error|disconnected)": LinkError(
        "the board went away while it was being written",
        "plug it in again and flash again: the boot loader survives that",
    ),
}


@dataclass(frozen=True, slots=True)
class Flashed:
    """What is on the board now."""

    image: Image
    hello: wire.HelloReply
    stored: StoredConfiguration


def flash(
    port: str,
    image: Path | None = None,
    *,
    avrdude: str = "avrdude",
    tell: Callable[[str], None] = lambda doing: None,
) -> Flashed:
    """Write an image to the board on a port, verify it, and wait until it says hello.

    `image` is an Intel HEX file; None takes this source tree's, built if need be. Raises
    ConfigError for a file that is no thigmo image, SchemaMismatchError before it writes one of
    another schema, and a LinkError where the port, the board or the line fails.
    """
    if "://" in port:
        raise ConfigError(f"{port} cannot be flashed", "give the serial port of a board")
    if image is None:
        tell("looking for the image")
    content = read_image(build_image() if image is None else image)
    content.require_own_schema()
    program = shutil.which(avrdude)
    if program is None:
        raise PortError(
            "avrdude is not installed", "install it (the Arduino IDE brings one) and try again"
        )
    if port.startswith("/") and not Path(port).exists():  # avrdude would try for minutes
        raise PortError(f"there is no port {port}", "plug the board in and look which port appears")
    tell(f"writing and verifying {len(content.program)} bytes")
    with TemporaryDirectory() as folder:
        for step, blocks in enumerate(in_safe_order(read_hex(content.path))):
            _run(program, port, write_hex(Path(folder) / f"step-{step}.hex", blocks))
    tell("waiting for the board's hello")
    return Flashed(content, *_meet(port))


def in_safe_order(
    blocks: list[tuple[int, bytes]],
) -> tuple[list[tuple[int, bytes]], list[tuple[int, bytes]]]:
    """Blocks of the two runs of avrdude that keep an incomplete program from starting.

    The first run writes a page 0 that only waits, and all other pages; the second run writes the
    real page 0. One run would not do: the boot loader erases page after page from 0, whatever
    address is written.
    """
    (start, program), *later_blocks = sorted(blocks)
    if start:
        raise ConfigError(f"the image begins at {start:#x}, not at 0", "build the image again")
    return [(0, HOLD + program[PAGE:]), *later_blocks], [(0, program[:PAGE])]


def _run(program: str, port: str, image: Path) -> None:
    command = [program, "-p", "atmega2560", "-c", "wiring", "-P", port]
    command += ["-b", str(BOOT_LOADER_BAUD), "-D", "-U", f"flash:w:{image}:i"]
    try:
        result = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_DEADLINE_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise LinkError(
            f"avrdude did not finish within {_DEADLINE_S:.0f} s",
            "unplug the board, plug it in and flash again",
        ) from error
    if result.returncode:
        raise explain(result.stderr + result.stdout, port)


def explain(output: str, port: str) -> LinkError:
    """Return the error that matches the output of a failed avrdude."""
    lowered = output.lower()
    match = re.search(r"device signature = 0x([0-9a-f]{6})", lowered)
    for pattern, error in _FAILURES.items():
        if re.search(pattern, lowered):
            signature = match[1] if match else "unknown"
            if "signature" in pattern and signature == _MEGA_2560:
                continue
            return type(error)(
                error.problem.format(port=port, signature=signature), error.next_step
            )
    lines = [line for line in output.splitlines() if "error" in line.lower()] or ["no message"]
    return LinkError(
        f"avrdude failed: {lines[0].strip()}", "flash again; report it if it happens again"
    )


def _meet(port: str) -> tuple[wire.HelloReply, StoredConfiguration]:
    """Connect to the new firmware; return its hello, and its use of the stored configuration."""
    try:
        client = Client(open_transport(port))
    except NotARobotError as error:
        raise NotARobotError(
            "the image was written and verified, but nothing on the board says hello",
            "press the board's reset button; if it stays silent, flash again",
        ) from error
    with client:
        if client.hello.board != wire.Board.MEGA:
            raise NotARobotError(
                f"{port} answers as {client.hello.board.name.lower()}, not as a Mega",
                "give the board's port",
            )
        return client.hello, StoredConfiguration.of(client.request(wire.GetConfigReport()))
