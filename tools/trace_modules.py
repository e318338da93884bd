"""Counts the modules that an exploration enters between a sensor's count and a dot on the map.

    python tools/trace_modules.py            their number, and their names
    python tools/trace_modules.py --seed 2   of another run

It explores the default room. From the first state to the last, it notes every module of `thigmo` in
which a function is called. Fewer modules are fewer places to look at. What is counted turns counts
into contacts, or decides where to grow and sweep next. The robot's connection, its robot.toml and
the drawn map come before and after. A call from a module that only observes is not counted, nor is
what it calls:

- the emulator, which stands in for a robot,
- the stream and what publishes on it: viewers see the run, and it does not depend on them,
- the record and the documents of the run folder,
- pictures,
- scores against the emulator's truth, and the export of the map's obstacles: the dots are there.

Calls in other threads, in compiled code, and of functions that ran only as a module was imported
are not seen. Called by developers who change the structure.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from types import FrameType

from thigmo.exploration import explore
from thigmo.exploration.run import Exploration

OBSERVERS = (
    "thigmo.emulator",
    "thigmo.stream",
    "thigmo.robot.publishing",
    "thigmo.exploration.run_control",
    "thigmo.record",
    "thigmo.report",
    "thigmo.display",
    "thigmo.exploration.scoring",
    "thigmo.exploration.obstacles",
)
WALK = Exploration.run.__code__  # of the run's states


def module_name(frame: FrameType) -> str:
    """Name of the module that a frame's function belongs to."""
    return str(frame.f_globals.get("__name__", ""))


def in_walk(frame: FrameType) -> bool:
    """Whether a frame was called by the run's walk, and by no module that only observes."""
    caller: FrameType | None = frame
    while caller is not None and caller.f_code is not WALK:
        if module_name(caller).startswith(OBSERVERS):
            return False
        caller = caller.f_back
    return caller is not None


def entered(seed: int) -> set[str]:
    """Names of the modules that an exploration enters."""
    modules: set[str] = set()

    def note(frame: FrameType, event: str, _argument: object) -> None:
        if event != "call" or frame.f_code.co_name == "<module>":
            return
        name = module_name(frame)
        if name.startswith("thigmo.") and name not in modules and in_walk(frame):
            modules.add(name)

    with tempfile.TemporaryDirectory() as folder:
        sys.setprofile(note)
        try:
            explore("emulator://default", seed=seed, out=folder)
        finally:
            sys.setprofile(None)
    return modules


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seed", type=int, default=1, help="of the emulator's noise")
    names = sorted(entered(parser.parse_args().seed))
    print(len(names))
    print("\n".join(names))


if __name__ == "__main__":
    main()
