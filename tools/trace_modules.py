"""Counts the modules that an exploration enters between a sensor's count and a dot on the map.

    python tools/trace_modules.py            their number, and their names
    python tools/trace_modules.py --seed 2   of another run

It explores the default room and notes every module of `thigmo` in which a function is called after
the robot is connected. The emulator is left out: on a robot it is not there. Called by developers
who change the structure: fewer modules are fewer places to look at.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from types import FrameType

from thigmo.exploration import explore

LEFT_OUT = ("thigmo.emulator",)


def entered(seed: int) -> set[str]:
    """Names of the modules whose functions an exploration calls."""
    modules: set[str] = set()

    def note(frame: FrameType, event: str, _argument: object) -> None:
        if event == "call" and frame.f_code.co_name != "<module>":
            modules.add(frame.f_globals.get("__name__", ""))

    with tempfile.TemporaryDirectory() as folder:
        sys.setprofile(note)
        try:
            explore("emulator://default", seed=seed, out=folder)
        finally:
            sys.setprofile(None)
    return {
        name for name in modules if name.startswith("thigmo.") and not name.startswith(LEFT_OUT)
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seed", type=int, default=1, help="of the emulator's noise")
    names = sorted(entered(parser.parse_args().seed))
    print(len(names))
    print("\n".join(names))


if __name__ == "__main__":
    main()
