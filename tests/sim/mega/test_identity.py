"""The controller's arithmetic gives the same integers on the ATmega2560 as here.

The same program is built for both and run, the one in simavr. `int` has 16 bits there: this is what
a product in the wrong width would not survive.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from compiled import compiled

HERE = Path(__file__).parent
CORE = HERE.parents[2] / "firmware/core"
SOURCE = HERE / "identity.cpp"
WARN = ["-Wall", "-Wextra", "-Werror", f"-I{CORE}", SOURCE]
AVR = ["-mmcu=atmega2560", "-DF_CPU=16000000UL", "-Os", "-std=gnu++14", "-fno-exceptions"]


def _parts(output: str) -> dict[str, str]:
    plain = re.sub(r"\x1b\[[0-9;]*m", "", output)  # simavr colours what the chip prints
    return dict(re.findall(r"(\w+) ([0-9a-f]{4})\b", plain))


@pytest.mark.skipif(
    shutil.which("avr-g++") is None or shutil.which("simavr") is None,
    reason="avr-g++ or simavr is missing (.ci/packages.txt)",
)
def test_arithmetic_is_identical_on_the_mega() -> None:
    sanitize = ["-fsanitize=undefined", "-fno-sanitize-recover=all"]
    native = ["c++", "-std=c++14", "-O1", *sanitize, *WARN]
    program = compiled("identity", native, [SOURCE, CORE])
    image = compiled("identity-avr", ["avr-g++", *AVR, *WARN], [SOURCE, CORE])
    host_parts = _parts(
        subprocess.run([program], capture_output=True, text=True, check=True).stdout
    )
    simulated = subprocess.run(
        ["simavr", "-m", "atmega2560", "-f", "16000000", image],
        capture_output=True,
        text=True,
        check=False,
    )
    chip_parts = _parts(simulated.stdout + simulated.stderr)
    assert set(host_parts) == {"arithmetic", "constants", "pressure", "spool", "sensing"}
    assert chip_parts == host_parts
