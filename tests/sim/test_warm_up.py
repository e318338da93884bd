"""No answer is late because the compiler ran: an armed robot waits for no compilation."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

# In a process of its own: in this one, other tests have compiled everything.
_SCRIPT = """
import importlib, sys
from numba.core.dispatcher import Dispatcher
from thigmo import exploration

def compiled():
    return {
        f"{name}.{key}": len(value.signatures)
        for name, module in list(sys.modules.items())
        if name.startswith("thigmo.localization")
        for key, value in vars(module).items()
        if isinstance(value, Dispatcher)
    }

module = importlib.import_module("thigmo.exploration.explore")
before = {}
warm_up = module.warm_up

def warmed(config):
    warm_up(config)
    before.update(compiled())

module.warm_up = warmed
for scene in ("default", "two_pegs"):
    exploration.explore(f"emulator://{scene}", seed=1, out=sys.argv[1])
    after = compiled()
    print(scene, len(before), [name for name in after if after[name] != before.get(name)])
    module.warm_up = lambda config: None
"""


def test_everything_is_compiled_before_the_robot_is_armed(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _SCRIPT, str(tmp_path)], capture_output=True, text=True, check=True
    )
    told = [line.split(maxsplit=2) for line in done.stdout.splitlines()]
    assert [scene for scene, _, _ in told] == ["default", "two_pegs"]
    for _, known, late in told:
        assert int(known) > 10
        assert late == "[]"
