"""The Pico's program as a UF2 file, checked as `thigmo flash` checks it: uf2.py PROGRAM.bin OUT.uf2."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "host"))
from thigmo.link.pico import read_uf2, write_uf2  # noqa: E402

path = write_uf2(Path(sys.argv[2]), Path(sys.argv[1]).read_bytes())
print(f"{path.name}: {len(read_uf2(path).program)} bytes of program")
