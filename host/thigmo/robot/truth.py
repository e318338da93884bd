"""What an emulated room knows, as plain data for the record; hardware knows nothing of the kind."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from thigmo.config import Side
from thigmo.record import TrueContact, TruePeg, Truth


def truth_now(known: Any, side: Side | None = None) -> Truth | None:
    """The room and its present contacts.

    Args:
        known: what a simulated room's `truth` gives (the emulator's Truth), or None.
        side: the muscle that is inflated.
    """
    if known is None:
        return None
    pegs = [TruePeg(float(p.x), float(p.y), float(p.radius)) for p in known.pegs]
    touching = [
        TrueContact(
            float(c.x), float(c.y), float(c.arc), float(known.length_cm), int(c.peg), side or ""
        )
        for c in known.contacts
    ]
    return Truth(pegs, touching)


def joined(truths: Sequence[Truth]) -> Truth | None:
    """The same room at several moments: all their contacts."""
    if not truths:
        return None
    return Truth(truths[0].pegs, [contact for truth in truths for contact in truth.contacts])
