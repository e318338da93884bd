"""A contact on a map, from which tests make theirs by `dataclasses.replace`."""

from __future__ import annotations

from thigmo.record import MapContact

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
