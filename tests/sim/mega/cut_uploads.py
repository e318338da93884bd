"""Mixtures of two images that a cut upload leaves, and a chip that is powered on with them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from thigmo.emulator import mega_build
from thigmo.emulator.chip import CYCLES_PER_MS, Cause, Chip
from thigmo.emulator.mega_sim import BOOT_SECTION, DRIVES, ESTOP, MOTOR_PWM
from thigmo.link.flash import HOLD
from thigmo.link.image import PAGE, read_hex

# An erased word is no instruction; the chip takes it for a skip (`sbrs r31, 7`, as it is but for
# one bit) or for nothing. libsimavr stops there, so it is given either.
SKIP, NOTHING = b"\xf7\xff", b"\x00\x00"

Pages = dict[int, bytes]
Mixture = tuple[int, str, Pages]


def pages(blocks: list[tuple[int, bytes]]) -> Pages:
    """Pages that an upload writes, by number, in the order in which avrdude writes them."""
    written: dict[int, bytearray] = {}
    for start, data in sorted(blocks):
        for at, byte in enumerate(data, start):
            written.setdefault(at // PAGE, bytearray(b"\xff" * PAGE))[at % PAGE] = byte
    return {number: bytes(data) for number, data in written.items()}


@dataclass
class UploadedBoard:
    """A chip whose flash is set and which is then powered on."""

    chip: Chip = field(default_factory=Chip)
    _flash: dict[int, bytes] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for address, data in read_hex(mega_build.BOOT_LOADER):
            self.chip.write("flash", address, data)
        self.chip.drive_pin(*ESTOP, False)
        blank = NOTHING * (PAGE // 2)
        self._flash = dict.fromkeys(range(BOOT_SECTION // PAGE), b"")
        self.program(dict.fromkeys(self._flash, blank))

    def program(self, flash: Pages) -> None:
        """Set all pages; those that are not given are blank."""
        blank = NOTHING * (PAGE // 2)
        for number, held in self._flash.items():
            if (page := flash.get(number, blank)) != held:
                self.chip.write("flash", number * PAGE, page)
                self._flash[number] = page

    @property
    def energised(self) -> bool:
        """Whether a transducer or the motor gets anything."""
        outputs = [(5, channel, pin) for channel, pin in enumerate(DRIVES)] + [(4, 0, MOTOR_PWM)]
        return any(
            self.chip.output(*pin) is not None
            and (self.chip.pwm(timer).connected[channel] or bool(self.chip.output(*pin)))
            for timer, channel, pin in outputs
        )

    def outcome_of(self, flash: Pages) -> str:
        """What it does after power-on with these pages: "energises", "starts", "stays", "runs"."""
        self.program(flash)
        chip = self.chip
        chip.reset(Cause.POWER_ON, 1)
        begun = chip.cycle
        for ms in (*range(1, 20), *range(20, 3001, 8)):  # the check itself takes 150
            chip.run(begun + ms * CYCLES_PER_MS)
            if self.energised:
                return "energises"
            if chip.tick_origin:
                return "starts"
            if self.quiet:
                return "stays"
        return "runs"

    @property
    def quiet(self) -> bool:
        """In the boot loader, in the guard's last loop, or in a page 0 that holds."""
        at = self.chip.pc
        around = self.chip.read("flash", at - 2, 6) if at else b""
        return (
            at >= BOOT_SECTION
            or b"\xa8\x95\xfe\xcf" in around
            or self.chip.read("flash", at, 2) == HOLD[:2]
        )


def mixtures(under: Pages, *uploads: Pages, cuts: Sequence[int] = ()) -> Iterator[Mixture]:
    """What a cut leaves: (pages written, state of the next, flash). `cuts`: these, else all."""
    flash = dict(under)
    written = 0
    for upload in uploads:
        for number, page in upload.items():
            if not cuts or written in cuts:
                yield written, "whole", flash
                # Pages 0 and 1 are run through, the others only read.
                for word in (NOTHING, SKIP) if number < 2 else (NOTHING,):
                    blank = word * (PAGE // 2)
                    yield written, "erased", flash | {number: blank}
                    half = len(page.rstrip(b"\xff")) // 4 * 2
                    yield written, "half", flash | {number: page[:half] + blank[half:]}
            flash[number] = page
            written += 1
    yield written, "whole", flash


def some(count: int) -> list[int]:
    """Cuts that `make test` tries; `make ci` tries all."""
    return sorted({*range(4), *range(4, count, 59), *range(count - 3, count)})
