"""An upload that is cut: whatever mixture of images it leaves, nothing is energised.

Each case is a flash, and a chip that is powered on with it. Three images of this repository's past,
which had no guard (firmware/mega/guard.h), are written under and over today's; so are one whose
guard had a CRC-16, and one of today with other options.
"""

from __future__ import annotations

import io
import subprocess
import tarfile
from binascii import crc_hqx
from functools import cache
from pathlib import Path

import pytest
from cut_uploads import UploadedBoard, mixtures, pages, some

from thigmo.emulator import mega_build
from thigmo.link.flash import in_safe_order
from thigmo.link.image import BUILD, PAGE, ROOT, WATCHDOG_ENTRY, make, read_hex

# Commits with other layouts of the image: 41, 84 and 92 KB of program.
PAST = ("ecd8b59", "6e0dbea", "7dc5063")
WITH_CRC_16 = "c90d69d"
WITH_GUARD = "today's at -O2"
UNDER = ("blank", WITH_GUARD, WITH_CRC_16, *PAST)


def build(name: str) -> Path:
    """The image of a commit of the past, or today's at -O2."""
    folder = BUILD / "past" / name.replace("'", "").replace(" ", "-")
    image = folder / "thigmo.hex"
    if name == WITH_GUARD:
        return make(ROOT / "firmware" / "mega", image, f"BUILD={folder}", "OPTIMIZE=-O2")
    if not image.exists():
        parts = ["firmware", "host/thigmo"] if name == WITH_CRC_16 else ["firmware"]  # for its seal
        archive = subprocess.run(
            ["git", "-C", str(ROOT), "archive", name, *parts], capture_output=True, check=False
        )
        if archive.returncode:
            pytest.skip(f"this checkout has no commit {name}: {archive.stderr.decode().strip()}")
        folder.mkdir(parents=True, exist_ok=True)
        with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as tar:
            tar.extractall(folder, filter="data")
        command = ["make", "-s", "-C", str(folder / "firmware" / "mega"), f"BUILD={folder}"]
        subprocess.run(command, check=True, capture_output=True)
    return image


@pytest.fixture(scope="module")
def board() -> UploadedBoard:
    return UploadedBoard()


@cache
def blocks(name: str) -> list[tuple[int, bytes]]:
    return read_hex(build(name)) if name != "blank" else []


@cache
def today() -> list[tuple[int, bytes]]:
    return read_hex(mega_build.firmware_hex())


@pytest.mark.parametrize("cuts", ["some", pytest.param("all", marks=pytest.mark.nightly)])
@pytest.mark.parametrize("under", UNDER)
def test_a_cut_upload_in_rising_order_starts_nothing_once_page_1_is_written(
    under: str, cuts: str, board: UploadedBoard
) -> None:
    old, new = pages(blocks(under)), pages(today())
    chosen = some(len(new)) if cuts == "some" else ()
    for written, state, flash in mixtures(old, new, cuts=chosen):
        if written < 2:
            continue  # the guard itself is not there: the next test
        whole = new.items() <= flash.items()
        assert board.outcome_of(flash) == ("starts" if whole else "stays"), (written, state)


@pytest.mark.parametrize("under", UNDER)
def test_a_cut_upload_in_rising_order_energises_nothing_before_page_1_is_written(
    under: str, board: UploadedBoard
) -> None:
    """Not by design: parts of the old image may run, and these do no harm for 3 s."""
    for written, state, flash in mixtures(pages(blocks(under)), pages(today()), cuts=range(2)):
        if written < 2:
            assert board.outcome_of(flash) != "energises", (written, state)


@pytest.mark.parametrize("at", [4, 600, 60_000, WATCHDOG_ENTRY])
def test_a_change_that_a_crc_16_does_not_see_starts_nothing(at: int, board: UploadedBoard) -> None:
    flash = pages(today())
    number, place = divmod(at, PAGE)
    page = bytearray(flash[number])
    for index, bits in enumerate((0x11021 << 3).to_bytes(3, "big"), place):  # its polynomial
        page[index] ^= bits
    assert page != flash[number]
    assert crc_hqx(page, 0xFFFF) == crc_hqx(flash[number], 0xFFFF)
    assert board.outcome_of(flash | {number: bytes(page)}) == "stays"
    assert board.outcome_of(flash) == "starts"


@pytest.mark.parametrize("cuts", ["some", pytest.param("all", marks=pytest.mark.ci)])
@pytest.mark.parametrize(
    ("way", "image"),
    [("over", image) for image in UNDER]
    + [("under", image) for image in UNDER if image != "blank"],
)
def test_thigmo_flash_that_is_cut_starts_nothing(
    image: str, way: str, cuts: str, board: UploadedBoard
) -> None:
    """Today's image over another one, and another one over today's."""
    old, new = (blocks(image), today()) if way == "over" else (today(), blocks(image))
    first, last = map(pages, in_safe_order(new))
    chosen = [*some(len(first)), len(first)] if cuts == "some" else ()
    for written, state, flash in mixtures(pages(old), first, last, cuts=chosen):
        outcome = board.outcome_of(flash)
        if state == "whole" and written in (0, len(first) + 1):
            assert outcome == ("starts" if flash else "stays")
        elif image in PAST and written == (0 if way == "over" else len(first)):
            # Its page 1 holds no guard to run into while page 0 is erased, for 4 ms.
            assert outcome != "energises", (written, state)
        else:
            assert outcome == "stays", (written, state)
