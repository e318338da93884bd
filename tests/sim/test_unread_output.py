"""What nobody reads stops nothing: explorations whose output goes nowhere, in a process each."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
import termios
from collections.abc import Callable
from pathlib import Path

import pytest
from emulated import last_stages, room_file
from served import comes

from thigmo.record import RunFolder

pytestmark = [
    pytest.mark.ci,
    pytest.mark.usefixtures("own_sockets"),
]


@pytest.fixture
def words(tmp_path: Path) -> list[str]:
    """The command that explores what is left of a room."""
    url, runs = room_file(tmp_path, last_stages(53.0)), str(tmp_path / "runs")
    return [sys.executable, "-m", "thigmo", "explore", "--robot", url, "--out", runs]


@pytest.fixture
def went_on(tmp_path: Path) -> Callable[[], bool]:
    """Whether the one run there is has come to its end, its record whole."""

    def ended() -> bool:
        (folder,) = map(RunFolder, (tmp_path / "runs").iterdir())
        assert folder.read_document().outcome == "full length"
        assert folder.map_path.exists()
        return not folder.read_log().truncated

    return ended


Went = Callable[[], bool]

# Prints numbers while a timer interrupts it every 0.2 ms.
INTERRUPTED = """
import signal, sys
from thigmo.cli import lossy_output

def interrupt(*_):
    global printing
    if printing:
        printing = False
        raise KeyboardInterrupt

lossy_output.be_lossy()
printing = False
signal.signal(signal.SIGALRM, interrupt)
signal.setitimer(signal.ITIMER_REAL, 2e-4, 2e-4)
number = 0
while number < 20_000:
    try:
        printing = True
        while number < 20_000:
            number += 1
            sys.{stream}.write(f"{number}\\n")
            sys.{stream}.flush()
    except KeyboardInterrupt:
        pass
printing = False
signal.setitimer(signal.ITIMER_REAL, 0)
"""


@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_an_interrupt_prints_nothing_twice(stream: str) -> None:
    code = INTERRUPTED.replace("{stream}", stream)
    run = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True)
    numbers = (run.stdout or run.stderr).split()
    assert run.returncode == 0, run.stderr[-300:]
    assert len(numbers) > 15_000, "too much was lost"
    assert len(numbers) == len(set(numbers))


def test_a_reader_that_leaves(words: list[str], went_on: Went) -> None:
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as run:
        assert run.stdout is not None
        assert run.stdout.readline()
        run.stdout.close()
        assert run.wait() == 0
    assert went_on()


def test_a_reader_that_takes_nothing(words: list[str], went_on: Went) -> None:
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    while os.get_blocking(writer) is False:
        try:
            os.write(writer, bytes(512))
        except BlockingIOError:
            os.set_blocking(writer, True)
    assert (
        subprocess.run(words, stderr=writer, stdout=subprocess.DEVNULL, check=False).returncode == 0
    )
    os.close(reader)
    os.close(writer)
    assert went_on()


@pytest.mark.parametrize("closed", [">&- 2>&-", "<&- >&- 2>&-", "2>/dev/full"])
def test_streams_that_are_closed_or_full(words: list[str], went_on: Went, closed: str) -> None:
    script = f'exec "$@" {closed}'
    run = subprocess.run(["sh", "-c", script, "sh", *words], check=False, capture_output=True)
    assert run.returncode == 0, run
    assert went_on()


def test_a_result_for_a_full_disk_is_one_line(words: list[str], went_on: Went) -> None:
    with Path("/dev/full").open("w") as full:
        run = subprocess.run(words, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert run.returncode == 1
    said = [line for line in run.stderr.splitlines() if "%" not in line]
    assert said == ["thigmo: the output was lost: No space left on device; write it elsewhere"]
    assert went_on()


@pytest.mark.parametrize(
    "command",
    ["--help", "--version", "scene --help", "params --robot emulator://empty", "bench --help"],
)
def test_every_command_says_in_one_line_that_its_result_is_lost(command: str) -> None:
    words = [sys.executable, "-m", "thigmo", *command.split()]
    with Path("/dev/full").open("w") as full:
        run = subprocess.run(words, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert (run.returncode, run.stderr.count("\n")) == (1, 1), run.stderr
    assert run.stderr.startswith("thigmo: the output was lost: No space left on device; ")


def test_a_terminal_that_is_closed(words: list[str], went_on: Went, tmp_path: Path) -> None:
    terminal, ours = os.openpty()

    def take() -> None:
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)

    run = subprocess.Popen(
        words, stdin=ours, stdout=ours, stderr=ours, start_new_session=True, preexec_fn=take
    )
    os.close(ours)
    assert comes(lambda: any(tmp_path.glob("runs/*/run.mcap")))
    os.close(terminal)  # which sends SIGHUP
    assert run.wait() == 0
    assert went_on()


STARTS = """
import sys
from thigmo.live.starting import exploration
run = exploration(sys.argv[1], sys.argv[2:], realtime=False)
print(run.pid, flush=True)
sys.stdin.read()
"""


def test_a_run_that_the_page_started_outlives_the_page(
    words: list[str], went_on: Went, tmp_path: Path
) -> None:
    url = f"emulator://{tmp_path / 'room.toml'}"
    starts = [sys.executable, "-c", STARTS, url, "--out", str(tmp_path / "runs")]
    with subprocess.Popen(starts, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as page:
        assert page.stdout is not None
        started = int(page.stdout.readline())
        assert comes(lambda: any(tmp_path.glob("runs/*/run.mcap")))
        page.kill()
    assert comes(lambda: not Path(f"/proc/{started}").exists())
    assert went_on()
