"""The host explores with the real image: the last growth stage of the default room.

Both boards run the same controller; the Mega's encoder edges, PWM and UART are its own, so the
contact must be the same one, at the same place within the reading's noise.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from thigmo.exploration import explore

pytestmark = pytest.mark.ci


def test_the_last_stage_finds_the_same_contact_on_both_boards(
    late_url: str, tmp_path: Path
) -> None:
    room = late_url.partition("://")[2]
    contacts = {
        board: explore(f"{board}://{room}", seed=1, out=tmp_path, name=board).document
        for board in ("emulator", "mega-sim")
    }
    for document in contacts.values():
        assert document.outcome == "full length"
        assert len(document.contacts) == 1
        assert document.error_x_cm is not None
        assert document.error_x_cm < 3.0
    virtual, mega = (contacts[board].contacts[0] for board in ("emulator", "mega-sim"))
    assert mega.side == virtual.side
    assert mega.arc_cm == pytest.approx(virtual.arc_cm, abs=1.5)
