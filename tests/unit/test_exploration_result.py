"""What `thigmo explore --json` prints of a contact that was felt at several lengths."""

from __future__ import annotations

from pathlib import Path

from thigmo.exploration import ExplorationResult
from thigmo.record import MapContact, RunDocument


def test_a_contact_tells_where_it_was_first_felt_and_last_measured() -> None:
    contact = MapContact(
        arc_cm=31.0,
        x_cm=29.5,
        y_cm=7.8,
        force_per_cm2=-2e-4,
        interval_cm=(29.0, 34.0),
        status="localized",
        everted_length_cm=53.0,
        side="left",
        normal_rad=1.0,
        covariance_cm2=((1.0, 0.0), (0.0, 1.0)),
        track=[],
        model="plain beam",
        readings=5,
        merged=[40.0, 50.0],
    )
    document = RunDocument(
        thigmo="0", name="n", url="u", started="2026-01-01T00:00:00", contacts=[contact]
    )
    printed = ExplorationResult(document, Path("runs/n")).as_json()["contacts"][0]
    assert printed["everted_length_cm"] == 40.0
    assert printed["measured_length_cm"] == 53.0
    assert "track" not in printed
