"""Small AVR programs on the simulated chip, compiled once a session."""

from __future__ import annotations

import hashlib
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from thigmo.emulator import mega_build
from thigmo.emulator.chip import Cause, Chip
from thigmo.link.image import read_hex

PRELUDE = """
#include <avr/eeprom.h>
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>
#include <util/delay.h>
#define OUT ((volatile uint8_t*)0x1000)
#define OUT16 ((volatile uint16_t*)0x1000)
"""
OUT = 0x1000

Programs = Callable[[str], Chip]


@pytest.fixture(scope="session", autouse=True)
def _simulator() -> None:
    reason = mega_build.missing()
    if reason:
        pytest.skip(f"simulated Mega: {reason}")


@pytest.fixture(scope="session")
def program(tmp_path_factory: pytest.TempPathFactory) -> Programs:
    """A chip freshly powered on with a C program (its body, after the usual includes)."""
    folder = tmp_path_factory.mktemp("avr")

    def build(source: str) -> Chip:
        text = PRELUDE + source
        name = hashlib.sha256(text.encode()).hexdigest()[:16]
        image = folder / f"{name}.hex"
        if not image.exists():
            compile_program(text, image)
        chip = Chip()
        for address, data in read_hex(image):
            chip.write("flash", address, data)
        chip.reset(Cause.POWER_ON)
        return chip

    return build


def compile_program(text: str, image: Path) -> None:
    """Compile C for the ATmega2560 to Intel HEX."""
    source, elf = image.with_suffix(".c"), image.with_suffix(".elf")
    source.write_text(text)
    flags = ["-mmcu=atmega2560", "-DF_CPU=16000000UL", "-Os", "-std=gnu11", "-Wall", "-Werror"]
    subprocess.run(["avr-gcc", *flags, str(source), "-o", str(elf)], check=True)
    subprocess.run(["avr-objcopy", "-O", "ihex", str(elf), str(image)], check=True)
