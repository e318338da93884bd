"""What the controller costs on each board, and where it ran: one table.

    python tools/boards.py              a table
    python tools/boards.py --json       one JSON object

The Mega's figures are those of tools/budgets.py, kept in docs/results. Memory of the MicroPython
boards is read from their built images: the controller's object, and the code of the module. Where
time is virtual, a tick has no jitter and no load of its own; QEMU counts instructions, not cycles.
The Pico's come from its image on the simulated chip of the tests (rp2040js), whose cycles are those
of the processor's manual, without waits for a bus.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from thigmo.emulator.micropython_build import BUILD, image
from thigmo.emulator.scene import Scene
from thigmo.emulator.transport import EmulatorTransport
from thigmo.link import protocol as wire
from thigmo.link.client import Client
from thigmo.link.pico import build_uf2, read_uf2

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "sim" / "micropython"))
from pico_machine import Pico

RESULTS = Path(__file__).resolve().parents[1] / "docs" / "results"
COLUMNS = ("tick", "jitter", "load", "RAM", "flash", "ran")
VIRTUAL = "virtual time"
CONTROL_JITTER = "control step's jitter"
NOT_MEASURABLE = "not measurable: its ticks come over a wire, as fast as this machine sends them"
NO_CYCLES = "not measurable: its ticks come over a wire, and QEMU counts instructions, not cycles"
PICO_RAM = 264 * 1024
SESSION_S = 0.3


def mega() -> dict[str, str]:
    """The simulated Mega's, cycle-exact."""
    budgets = json.loads((RESULTS / "budgets.json").read_text())

    def figure(name: str) -> str:
        return f"{budgets[name]['value']:.4g} {budgets[name]['unit']}"

    return {
        "tick": "1 kHz, timer 1",
        "jitter": f"{figure('sampling jitter')} of sampling, "
        f"{figure(CONTROL_JITTER)} of the control step",
        "load": f"{figure('loop load, mean')}, worst 5 ms {figure('loop load, worst 5 ms')}",
        "RAM": f"{budgets['static RAM']['value']:.0f} byte in all",
        "flash": f"{budgets['flash']['value']:.0f} byte in all",
        "ran": "the image in simulation, cycle-exact; no Mega here",
    }


def _run(*command: object) -> list[list[str]]:
    process = subprocess.run([str(c) for c in command], check=True, stdout=subprocess.PIPE)
    return [line.split() for line in process.stdout.decode().splitlines()]


def pico() -> dict[str, str]:
    """The Pico's, from its image and a session on the simulated chip."""
    uf2 = build_uf2()
    chip = Pico(uf2)
    transport = EmulatorTransport(Scene.load("empty"), chip, seed=5)
    transport.pass_time(SESSION_S)
    client = Client(transport)
    transport.pass_time(SESSION_S)
    pass_us = client.request(wire.GetLinkStats()).loop_max_us
    early, late = chip.said["starts"]
    chip.close()
    elf = uf2.with_name("firmware.elf")
    rows = _run("arm-none-eabi-size", "-A", elf)
    sections = {row[0]: int(row[1]) for row in rows if len(row) == 3 and row[1].isdigit()}
    used = sum(sections[name] for name in (".data", ".bss"))
    (robot,) = (
        int(row[1], 16)
        for row in _run("arm-none-eabi-nm", "-S", "-C", elf)
        if row[-1].endswith("robot_storage")
    )
    return {
        "tick": "1 kHz, a hardware alarm on a core of its own",
        "jitter": f"{late - early:.1f} us of sampling",
        "load": f"longest pass of the loop {pass_us} us of 1000",
        "RAM": f"{used} byte of {PICO_RAM} in all, {robot} of the controller",
        "flash": f"{len(read_uf2(uf2).program)} byte in all",
        "ran": "the image in simulation (rp2040js, no boot ROM); no Pico here",
    }


def micropython(kind: str, tools: str, tick: str, why_not: str, ran: str) -> dict[str, str]:
    """A MicroPython image's, from its object files."""
    image(kind)
    objects = BUILD / kind / "thigmo_board"
    symbols = _run(f"{tools}nm", "-S", "-C", objects / "injected.o")
    (ram,) = (int(row[1], 16) for row in symbols if row[-1].endswith("robot_storage"))
    code = sum(int(row[0]) for row in _run(f"{tools}size", *objects.glob("*.o"))[1:])
    return {
        "tick": tick,
        "jitter": why_not,
        "load": why_not,
        "RAM": f"{ram} byte of the controller",
        "flash": f"{code} byte of the module",
        "ran": ran,
    }


def table() -> dict[str, dict[str, str]]:
    """Board -> column -> text."""
    return {
        "Mega 2560": mega(),
        "virtual board": dict.fromkeys(COLUMNS, VIRTUAL)
        | {"RAM": "of this machine", "flash": "of this machine", "ran": "natively, for real"},
        "MicroPython, unix port": micropython(
            "unix",
            "",
            "injected, a thread of its own",
            NOT_MEASURABLE,
            "natively, for real; hardware injected",
        ),
        "MicroPython, Cortex-M3": micropython(
            "cortex-m3",
            "arm-none-eabi-",
            "injected, an interrupt",
            NO_CYCLES,
            "in QEMU (MPS2-AN385); hardware injected",
        ),
        "MicroPython, Raspberry Pi Pico": pico(),
    }


def main() -> None:
    rows = table()
    if "--json" in sys.argv[1:]:
        print(json.dumps(rows, indent=2))
        return
    print("| board | " + " | ".join(COLUMNS) + " |")
    print("| --- " * (len(COLUMNS) + 1) + "|")
    for board, row in rows.items():
        print(f"| {board} | " + " | ".join(row[column] for column in COLUMNS) + " |")


if __name__ == "__main__":
    main()
