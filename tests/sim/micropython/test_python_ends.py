"""Whatever Python does, outputs go off first: Ctrl-C, Ctrl-D, errors, a full heap, mpremote."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import threading
import tty
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from rig import Rig

from thigmo.emulator.micropython import MicroPythonBoard, Processor
from thigmo.errors import CommandTimeoutError, LinkError, PortError
from thigmo.link import protocol as wire
from thigmo.link.client import Client

Make = Callable[..., Rig[MicroPythonBoard]]
ON: list[Processor] = ["unix", "cortex-m3"]

# Programs that go on after what should end them: only the module can put outputs off.
SWALLOWS = """from main import board
try:
    while True: pass
except BaseException as error:
    print("swallowed", type(error))
    while True: pass
"""
RAISES = """from main import board
def broken(name, arg, value):
    if name == "activity_done" and arg == 5: raise ValueError("a lamp that broke")
board.on_event(broken)
"""
FILLS = """from main import board
def fill(name, arg, value):
    hog = []
    while name == "activity_done" and arg == 5: hog.append(bytearray(5000))
board.on_event(fill)
"""
HOARDS = """from main import board
hog = []
try:
    while True:
        if board.activity() == "pressing":
            while True: hog.append(bytearray(5000))
except MemoryError:
    hog = None
    print("MemoryError swallowed")
    while True: pass
"""


class Port:
    """A serial port, in mpremote's eyes, that is a board's prompt."""

    def __init__(self, board: MicroPythonBoard) -> None:
        self._board = board
        self._open = True
        self._ours, theirs = os.openpty()
        tty.setraw(theirs)
        self.path = os.ttyname(theirs)
        self._theirs = theirs  # kept open, so that ours never hangs up
        self._thread = threading.Thread(target=self._carry)

    def __enter__(self) -> Port:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._open = False
        self._thread.join()
        os.close(self._ours)
        os.close(self._theirs)

    def _carry(self) -> None:
        sent = len(self._board.printed())
        while self._open:
            if select.select([self._ours], [], [], 0.01)[0]:
                self._board.type(os.read(self._ours, 64))
            sent += os.write(self._ours, self._board.printed(sent))

    def mpremote(self, robot: Rig[MicroPythonBoard], *words: str | Path) -> str:
        """What a command of mpremote prints; the robot's time passes meanwhile."""
        command = [sys.executable, "-m", "mpremote", "connect", self.path, *map(str, words)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as ran:
            robot.until(lambda: ran.poll() is not None, limit_s=60)
            assert ran.stdout is not None
            return ran.stdout.read().replace("\r\n", "\n")


@pytest.mark.parametrize("on", ON)
def test_ctrl_c_puts_outputs_off(bench: Make, on: Processor) -> None:
    robot = bench(on)
    robot.press()
    robot.board.interrupt()
    robot.until(lambda: not robot.board.running)
    assert robot.airless
    robot.board.type(b"board.curvature()\r")
    robot.until(lambda: "the controller does not run: Ctrl-C" in robot.board.console())


@pytest.mark.parametrize("on", ON)
def test_typing_at_the_prompt_changes_nothing(bench: Make, on: Processor) -> None:
    robot = bench(on)
    robot.press()
    robot.board.type(b"for n in range(3): print('typed', n * 7)\r\r")
    robot.until(lambda: "typed 14" in robot.board.console())
    robot.board.type(b"1 / 0\r")
    robot.until(lambda: "ZeroDivisionError" in robot.board.console())
    assert robot.board.running
    assert robot.board.drive_enabled == (True, False)


@pytest.mark.parametrize("on", ON)
def test_ctrl_d_puts_outputs_off(bench: Make, on: Processor) -> None:
    robot = bench(on)
    robot.press()
    robot.board.type(b"\x04")
    robot.until(lambda: not robot.board.running)
    assert robot.airless


def test_outputs_are_off_though_the_program_swallows_ctrl_c(bench: Make) -> None:
    robot = bench(program=SWALLOWS)
    robot.press()
    robot.board.interrupt()
    robot.until(lambda: "swallowed" in robot.board.console())
    robot.transport.pass_time(0.01)
    assert robot.airless
    assert not robot.board.running


@pytest.mark.parametrize(
    ("program", "error"), [(RAISES, "ValueError: a lamp that broke"), (FILLS, "MemoryError")]
)
def test_an_error_in_the_callback_puts_outputs_off(bench: Make, program: str, error: str) -> None:
    robot = bench(program=program)
    robot.press()
    with suppress(LinkError, CommandTimeoutError):  # nobody answers
        robot.robot.vent()  # whose event it does not bear
    robot.until(lambda: error in robot.board.console())
    robot.transport.pass_time(0.01)
    assert robot.airless
    assert not robot.board.running
    robot.board.type(b"board.state()\r")
    robot.until(lambda: "the controller does not run: " in robot.board.console())


def test_a_full_heap_puts_outputs_off_though_the_program_goes_on(bench: Make) -> None:
    robot = bench(program=HOARDS)
    robot.prepare()
    with suppress(LinkError, CommandTimeoutError):  # nobody answers
        robot.robot.press("left", 8.0)
    robot.until(lambda: "MemoryError swallowed" in robot.board.console())
    robot.transport.pass_time(0.01)
    assert robot.airless
    assert not robot.board.running


def test_a_program_that_has_ended_is_a_silent_board(bench: Make) -> None:
    robot = bench()
    robot.press()
    robot.board.interrupt()
    robot.until(lambda: not robot.board.running)
    with pytest.raises(LinkError):
        robot.client.request(wire.GetStatus())


def test_mpremote_that_comes_in_finds_outputs_off_and_a_raw_prompt(bench: Make) -> None:
    robot = bench("cortex-m3")
    robot.press()
    robot.board.type(b"\r\x03\x03")  # as mpremote enters the raw prompt
    robot.until(lambda: not robot.board.running)
    assert robot.airless
    robot.board.type(b"\r\x01")
    robot.until(lambda: "raw REPL; CTRL-B to exit" in robot.board.console())
    robot.board.type(b"print(6 * 7)\x04")
    robot.until(lambda: "OK42" in robot.board.console())
    assert robot.airless


def test_mpremote_runs_a_script_that_has_the_controller_until_its_end(
    bench: Make, tmp_path: Path
) -> None:
    """mpremote itself, at a serial port that is the Cortex-M3's prompt."""
    robot = bench("cortex-m3")
    robot.press()
    script = tmp_path / "script.py"
    script.write_text("from main import board\nprint(board.state(), board.running())\n")
    with Port(robot.board) as port:
        assert port.mpremote(robot, "exec", "print('raw')") == "raw\n"
        assert not robot.board.running
        assert robot.airless
        assert port.mpremote(robot, "run", script) == "boot True\n"
        robot.until(lambda: not robot.board.running)
    assert robot.airless


def test_a_raw_prompt_alone_puts_outputs_off(bench: Make) -> None:
    robot = bench("cortex-m3")
    robot.press()
    robot.board.type(b"\x01")
    robot.until(lambda: not robot.board.running)
    assert robot.airless


def test_a_pin_that_the_lab_names_for_itself_is_allowed(bench: Make) -> None:
    bench()
    board = MicroPythonBoard(5, program="import pins\npins.PINS['lamp'] = 22\nimport main")
    board.step(900)
    assert board.running


def test_after_a_soft_reset_the_program_begins_again_and_a_stop_stays(bench: Make) -> None:
    robot = bench("cortex-m3")
    robot.press()
    robot.client.stop()
    stop_nonce = robot.client.request(wire.GetStatus()).stop_nonce
    assert stop_nonce
    robot.board.interrupt()
    robot.until(lambda: not robot.board.running)
    robot.board.type(b"\x04")  # Ctrl-D
    robot.until(lambda: "soft reboot" in robot.board.console())
    robot.board.type(b"from main import board\r")
    robot.until(lambda: robot.board.running)
    assert robot.board.boots == 2
    client = Client(robot.transport)
    assert client.hello.reset_cause is wire.ResetCause.EXTERNAL
    status = client.request(wire.GetStatus())
    assert status.stop_nonce == stop_nonce
    assert robot.airless


@pytest.mark.parametrize("on", ON)
def test_bytes_of_the_link_are_no_keys_at_the_prompt(bench: Make, on: Processor) -> None:
    robot = bench(on)
    robot.press()
    before = robot.board.console()
    robot.transport.write(b"\x03\x04\x01\x02\x03\r" * 40)
    robot.robot.wait(0.5)
    assert robot.board.running
    assert robot.board.console() == before
    assert robot.board.drive_enabled == (True, False)


@pytest.mark.parametrize(
    ("edit", "complaint"),
    [
        ("pins.PINS['estop'] = 0", "'estop' and 'link_tx' share pin 0"),
        ("pins.PINS['estop'] = 30", "pin 'estop' is not 0 to 29"),
        ("del pins.PINS['estop']", "pins lacks 'estop'"),
        ("pins.PINS = 7", "pins is a dictionary"),
    ],
)
def test_a_wrong_pin_map_starts_nothing_and_says_why(
    bench: Make, edit: str, complaint: str
) -> None:
    bench()
    board = MicroPythonBoard(5, program=f"import pins\n{edit}\nimport main")
    with pytest.raises(PortError, match=complaint):
        board.step(900)
    assert board.drive_enabled == (False, False)
    assert not board.running
