"""A contact on a map and a reading, from which tests make theirs by `dataclasses.replace`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from thigmo.record import MapContact, RunDocument, RunFolder
from thigmo.stream import Telemetry

CONTACT = MapContact(
    arc_cm=31.2,
    x_cm=27.5,
    y_cm=11.6,
    force_per_cm2=2.1e-4,
    interval_cm=(29.8, 32.7),
    status="localized",
    everted_length_cm=40.0,
    side="left",
    normal_rad=2.0,
    covariance_cm2=((0.7, 0.3), (0.3, 0.4)),
    track=[(26.4, 10.6), (27.5, 11.6), (28.6, 12.7)],
    model="side",
    readings=7,
)


def run_folder(
    parent: Path, folder: str, started: str = "2026-11-01T10:00:00", **changes: object
) -> Path:
    """A folder with the contacts.json of a run, and no record."""
    path = parent / folder
    path.mkdir()
    document = RunDocument("0", folder, "emulator://empty", started, outcome="full length")
    RunFolder(path).write_document(replace(document, **changes))  # type: ignore[arg-type]
    return path


def a_telemetry(t_s: float = 1.0, supply_v: float = 5.0) -> Telemetry:
    return Telemetry(
        t_s, 1.7e9 + t_s, t_s, (1.5, 0.0), (1.5, 0.0), (12.0, 0.0), (0.01,) * 10, (0.011,) * 10,
        0.01, 0.011, 30.0, -0.25, supply_v, "ready", "sweeping", ("stopped",), tuple(range(10)),
    )  # fmt: skip
