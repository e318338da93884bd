"""Seals an image: `seal.py LINKED IMAGE` (both Intel HEX) adds the CRC without which guard.h starts nothing.

The Makefile calls it. It needs Python 3.11 and no package.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "host"))

from thigmo.link.image import read_hex, seal, write_hex

linked, image = map(Path, sys.argv[1:])
write_hex(image, seal(read_hex(linked)))
