"""Contacts by the readings of one instant, with the errors that robot.toml states.

What an exploration by the method `thesis` puts on its map, from each sweep's peak, and what viewers
see while a sweep goes on. The map of the other method is a fit to all sweeps (`fitted.py`).
"""

from __future__ import annotations

from math import nan
from typing import Any

import numpy as np

from thigmo.contact_status import POINT_ESTIMATE, WIDTH_SHARE
from thigmo.exploration.workspace import Bend, place_contact
from thigmo.localization import LocalizeResult, localize
from thigmo.reading_errors import errors_of
from thigmo.record import MapContact
from thigmo.robot import Peak, SensorTable
from thigmo.wiring import Wiring


def localize_frame(peak: Peak, wiring: Wiring, body_pressure: int, method: str) -> LocalizeResult:
    """Localize contacts from the averaged readings of one instant of a sweep.

    `body_pressure` is its number, `method` that of `localize`. Raises DataError if no sensor
    is usable.
    """
    config = wiring.config
    table = SensorTable.laid_out(wiring).warmed(peak.warmth)
    use = np.flatnonzero(table.usable(peak.side, peak.sensors) & np.isfinite(peak.curvature))
    sensors = [sensor for n in use if (sensor := wiring.read_sensors[n]) is not None]
    stated = errors_of(config, peak.side, body_pressure, sensors)
    averaged = {
        "noise": np.hypot(table.white, peak.added_noise)[use],  # zeros included
        "zero_error": 0.0,
        "shared_errors": table.shared[use],
    }
    return localize(
        peak.curvature[use],
        table.center_cm[use],
        length=peak.length_cm,
        span=table.span_cm[use],
        free_curvature=peak.free_curvature,
        width_limit=WIDTH_SHARE * config.body.length_cm,
        method=method,
        **(stated.arguments() | averaged),
    )


def point_estimates(
    result: LocalizeResult, peak: Peak, bend: Bend, readings: int, radius_cm: float
) -> list[MapContact]:
    """A frame's places of unknown error for the map, on the body as so many readings bend it.

    Each stage's place is a contact of its own: nothing shows whether two are the same obstacle.
    """
    contacts = []
    for contact in result.contacts:
        if contact.status != POINT_ESTIMATE:
            continue
        newtons: dict[str, Any] = {}
        if contact.newtons is not None:
            across = contact.newtons.across
            newtons = {"force_n": across.value, "force_interval_n": list(across.interval)}
        placed = place_contact(
            bend, contact.arc, contact.force, contact.interval, radius_cm=radius_cm,
            end_offset_cm=contact.end_offset,
        )  # fmt: skip
        contacts.append(
            MapContact(
                **placed._asdict(),
                **newtons,
                arc_cm=contact.arc,
                force_per_cm2=contact.force,
                interval_cm=contact.interval,
                status=contact.status,
                everted_length_cm=peak.length_cm,
                side=peak.side,
                model=result.hypothesis,
                readings=readings,
                probability=nan,
            )
        )
    return contacts
