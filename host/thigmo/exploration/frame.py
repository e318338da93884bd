"""The thesis's contacts, by the readings of one instant: what its method puts on the map."""

from __future__ import annotations

from math import nan

from thigmo.contact_status import POINT_ESTIMATE
from thigmo.exploration.methods import THESIS
from thigmo.exploration.workspace import Bend, place_contact
from thigmo.field import fold_moment
from thigmo.localization import LocalizeResult, localize
from thigmo.record import MapContact
from thigmo.robot import Peak, SensorTable
from thigmo.wiring import Wiring


def localize_frame(peak: Peak, wiring: Wiring, body_pressure: int) -> LocalizeResult:
    """Localize contacts from the averaged readings of one instant of a sweep.

    `body_pressure` is its number. Raises DataError if no sensor is usable.
    """
    table = SensorTable.laid_out(wiring)
    use = table.readable(peak.side, peak.sensors, peak.curvature)
    return localize(
        peak.curvature[use],
        table.center_cm[use],
        length=peak.length_cm,
        span=table.span_cm[use],
        free_curvature=peak.free_curvature,
        critical_curvature=fold_moment(wiring.config, body_pressure),
        method=THESIS,
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
        placed = place_contact(
            bend, contact.arc, contact.force, contact.interval, radius_cm=radius_cm,
            end_offset_cm=contact.end_offset,
        )  # fmt: skip
        contacts.append(
            MapContact(
                **placed._asdict(),
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
