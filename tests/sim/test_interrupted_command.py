"""Ctrl-C and SIGTERM, whatever a command is doing: one line, and the status that shells expect."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from command import run_python
from served import comes

BOTH = [(signal.SIGINT, 130), (signal.SIGTERM, 143)]

LOADING = """
import sys, threading
class Slow:
    def find_spec(self, name, path, target=None):
        if name == "thigmo.cli.main":
            print("loading", flush=True)
            threading.Event().wait()
sys.meta_path.insert(0, Slow())
from thigmo.__main__ import run
run()
"""


# What raises the signal in itself, when it comes to a place.
AT_A_PLACE = """
import sys, signal
from importlib import import_module
from thigmo.cli import signals
number, module, name = int(sys.argv[1]), *sys.argv[2].split(":")
signals.be_ready()
owner = import_module(module)
for part in name.split(".")[:-1]:
    owner = getattr(owner, part)
real = getattr(owner, name.split(".")[-1])
def raising(*args, **options):
    signal.raise_signal(number)
    return real(*args, **options)
setattr(owner, name.split(".")[-1], raising)
sys.argv = ["thigmo", *sys.argv[3:]]
from thigmo.__main__ import run
run()
"""
AGAIN = "thigmo: interrupted; run it again\n"
KEPT = "thigmo: interrupted; what was finished is kept\n"


@pytest.mark.parametrize(
    ("place", "line", "number"),
    [
        ("typer.main:get_command", AGAIN, signal.SIGINT),
        ("typer.main:get_command", AGAIN, signal.SIGTERM),
        ("typer.core:TyperGroup.make_context", KEPT, signal.SIGINT),
        ("typer.core:TyperGroup.make_context", KEPT, signal.SIGTERM),
        ("typer.core:TyperGroup.invoke", KEPT, signal.SIGINT),
        ("thigmo.localization:localize", KEPT, signal.SIGTERM),
        ("rich.console:Console.print", KEPT, signal.SIGINT),
    ],
)
def test_at_a_place(place: str, line: str, number: signal.Signals) -> None:
    readings = ("localize", "example", "--length", "53", "--span", "5.5")
    ran = run_python(AT_A_PLACE, str(int(number)), place, *readings)
    assert (ran.code, ran.err) == (128 + number, line)


@pytest.mark.parametrize("number", [number for number, _ in BOTH])
def test_in_a_task_of_the_page(own_sockets: None, number: signal.Signals) -> None:
    page = ("watch", "--no-browser", "--port", "0")
    ran = run_python(AT_A_PLACE, str(int(number)), "asyncio:sleep", *page)
    assert ran.code == 0
    assert "Ctrl-C ends the page" in ran.err
    assert len(ran.err.splitlines()) == 1


@pytest.mark.parametrize("number", [number for number, _ in BOTH])
def test_after_its_end_it_ends_without_a_word(number: signal.Signals) -> None:
    script = (
        "import atexit, signal, sys; sys.argv = ['thigmo', '--version']\n"
        f"atexit.register(signal.raise_signal, {int(number)})\n"
        "from thigmo.__main__ import run; run()"
    )
    ran = run_python(script)
    assert (ran.code, ran.err) == (-number, "")
    assert ran.out.startswith("thigmo ")


def test_a_robot_that_a_thread_still_holds_at_the_end_is_not_told_of() -> None:
    script = (
        "import threading, thigmo; robot = thigmo.connect('emulator://empty', seed=1)\n"
        "threading.Thread(target=lambda: (robot, threading.Event().wait()), daemon=True).start()"
    )
    ran = run_python(script)
    assert (ran.code, ran.err) == (0, "")


def ended(program: subprocess.Popen[str], number: signal.Signals) -> tuple[int, str]:
    program.send_signal(number)
    _, said = program.communicate()
    return program.returncode, said


@pytest.mark.parametrize(("number", "code"), BOTH)
def test_while_it_loads(number: signal.Signals, code: int) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", LOADING], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "loading\n"
        assert ended(program, number) == (code, "thigmo: interrupted; run it again\n")


@pytest.mark.parametrize(("number", "code"), BOTH)
def test_while_it_reads(tmp_path: Path, number: signal.Signals, code: int) -> None:
    fifo = tmp_path / "r.csv"
    os.mkfifo(fifo)
    command = [sys.executable, "-m", "thigmo", "localize", str(fifo), "--length", "53"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as program:
        writers: list[int] = []
        assert comes(lambda: has_a_reader(fifo, writers))
        assert ended(program, number) == (
            code,
            "thigmo: interrupted; what was finished is kept\n",
        )
        os.close(writers[0])


def has_a_reader(fifo: Path, writers: list[int]) -> bool:
    """Whether the command waits for what it reads; the writer stays open."""
    try:
        writers.append(os.open(fifo, os.O_WRONLY | os.O_NONBLOCK))
    except OSError:
        return False
    return True


def test_a_signal_that_its_starter_ignores_is_ignored(tmp_path: Path) -> None:
    """As under `nohup`: the command goes on."""
    fifo = tmp_path / "r.csv"
    os.mkfifo(fifo)
    command = [sys.executable, "-m", "thigmo", "localize", str(fifo), "--length", "53", "--json"]
    with subprocess.Popen(
        ["/bin/sh", "-c", 'trap "" INT; exec "$@"', "sh", *command],
        stdout=subprocess.PIPE,
        text=True,
    ) as program:
        with fifo.open("w") as readings:  # waits for the reader
            program.send_signal(signal.SIGINT)
            readings.write("position,curvature\n5,0.0104\n15,0.0083\n25,0.006\n35,0.0041\n")
        out, _ = program.communicate()
    assert program.returncode == 0
    assert '"status"' in out
