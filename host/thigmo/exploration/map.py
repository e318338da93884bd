"""The map that grows while the robot explores: contacts merged, errors known only by the room."""

from __future__ import annotations

from dataclasses import replace
from math import hypot

import numpy as np

from thigmo.record import MapContact, TrueContact

# Two contacts are one if they differ by less than this many standard deviations in the plane...
_SAME_SIGMA = 3.0
# ...where no place is taken as known better than this: the peg's own size and the slide along it.
_FLOOR_CM = 1.0


def merge(contacts: list[MapContact], new: MapContact) -> list[MapContact]:
    """Add a contact to the map, or fold it into one that is the same within the uncertainty.

    Of two that are the same the one with the narrower interval stays, and remembers the stages at
    which the other was felt.
    """
    for index, old in enumerate(contacts):
        if old.side == new.side and _distance_sigma(old, new) < _SAME_SIGMA:
            best, other = (new, old) if _rank(new) < _rank(old) else (old, new)
            stages = sorted({*best.merged, *other.merged, other.everted_length_cm})
            kept = replace(best, merged=[s for s in stages if s != best.everted_length_cm])
            return [*contacts[:index], kept, *contacts[index + 1 :]]
    return [*contacts, new]


def _rank(contact: MapContact) -> tuple[bool, float]:
    return (contact.status != "localized", contact.interval_cm[1] - contact.interval_cm[0])


def _distance_sigma(a: MapContact, b: MapContact) -> float:
    covariance = np.asarray(a.covariance_cm2) + np.asarray(b.covariance_cm2)
    covariance += _FLOOR_CM**2 * np.eye(2)
    apart = np.array([a.x_cm - b.x_cm, a.y_cm - b.y_cm])
    return float(np.sqrt(apart @ np.linalg.solve(covariance, apart)))


def best_contact(contacts: list[MapContact]) -> MapContact | None:
    """The contact that the run vouches for most: localized, with the narrowest interval."""
    return min(contacts, key=_rank, default=None)


def errors(
    contacts: list[MapContact], truth: list[TrueContact]
) -> tuple[float | None, float | None]:
    """(|x error|, distance in the plane) of the best contact, cm; (None, None) without either.

    It is compared with the true contact point on the robot's skin at the same stage's measurement;
    of several, with the nearest.
    """
    best = best_contact(contacts)
    if best is None:
        return None, None
    same = [t for t in truth if abs(t.everted_length_cm - best.everted_length_cm) < 0.5]
    if not same:
        return None, None
    nearest = min(same, key=lambda t: hypot(t.x_cm - best.x_cm, t.y_cm - best.y_cm))
    return (
        abs(nearest.x_cm - best.x_cm),
        hypot(nearest.x_cm - best.x_cm, nearest.y_cm - best.y_cm),
    )


def peg_ahead(contacts: list[MapContact], length_cm: float, radius_cm: float) -> bool:
    """Whether a contact lies on the straight path in front of the tip, which would buckle there."""
    return any(
        contact.x_cm > length_cm - radius_cm and abs(contact.y_cm) < radius_cm + _FLOOR_CM
        for contact in contacts
    )
