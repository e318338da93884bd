"""What the controller costs on each board, and where it ran: one table.

    python tools/boards.py              a table
    python tools/boards.py --json       one JSON object

The Mega's figures are those of tools/budgets.py, kept in docs/results. Memory of the MicroPython
boards is read from their built images: the controller's object, and the code of the module. Where
time is virtual, a tick has no jitter and no load of its own; QEMU counts instructions, not cycles.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from thigmo.emulator.micropython_build import BUILD, image

RESULTS = Path(__file__).resolve().parents[1] / "docs" / "results"
COLUMNS = ("tick", "jitter", "load", "RAM", "flash", "ran")
VIRTUAL = "virtual time"
CONTROL_JITTER = "control step's jitter"
NOT_MEASURABLE = "not measurable here"


def mega() -> dict[str, str]:
    """The simulated Mega's, cycle-exact."""
    kept = json.loads((RESULTS / "budgets.json").read_text())

    def figure(name: str) -> str:
        return f"{kept[name]['value']:.4g} {kept[name]['unit']}"

    return {
        "tick": "1 kHz, timer 1",
        "jitter": f"{figure('sampling jitter')} of sampling, "
        f"{figure(CONTROL_JITTER)} of the control step",
        "load": f"{figure('loop load, mean')}, worst 5 ms {figure('loop load, worst 5 ms')}",
        "RAM": f"{kept['static RAM']['value']:.0f} byte in all",
        "flash": f"{kept['flash']['value']:.0f} byte in all",
        "ran": "the image in simulation, cycle-exact; no Mega here",
    }


def micropython(kind: str, tools: str, tick: str, ran: str) -> dict[str, str]:
    """A MicroPython image's, from its object files."""
    image(kind)
    objects = BUILD / kind / "thigmo_board"

    def run(*command: object) -> list[list[str]]:
        done = subprocess.run([str(c) for c in command], check=True, stdout=subprocess.PIPE)
        return [line.split() for line in done.stdout.decode().splitlines()]

    symbols = run(f"{tools}nm", "-S", "-C", objects / "injected.o")
    (ram,) = (int(row[1], 16) for row in symbols if row[-1].endswith("robot_storage"))
    code = sum(int(row[0]) for row in run(f"{tools}size", *objects.glob("*.o"))[1:])
    return {
        "tick": tick,
        "jitter": NOT_MEASURABLE,
        "load": NOT_MEASURABLE,
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
            "unix", "", "injected, a thread of its own", "natively, for real; hardware injected"
        ),
        "MicroPython, Cortex-M3": micropython(
            "cortex-m3",
            "arm-none-eabi-",
            "injected, an interrupt",
            "in QEMU (MPS2-AN385); hardware injected",
        ),
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
