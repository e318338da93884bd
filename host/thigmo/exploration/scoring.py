"""Scores a run against a known room: contacts that it missed, and false ones.

The emulator knows its pegs and which of them each sweep's peak touched; on hardware a map that was
given says what to expect. The reasons are read off the run's own record.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from thigmo.config import RobotConfig
from thigmo.contact_status import POINT_ESTIMATE
from thigmo.exploration.map import errors, of_stage, true_touches
from thigmo.exploration.obstacles import GONE, occupancy
from thigmo.exploration.stall import Obstruction
from thigmo.record import (
    FalseContact,
    MapContact,
    MissedContact,
    Obstacle,
    RunDocument,
    TrueContact,
    Truth,
)
from thigmo.robot import TRIGGER_PER_CM

# A contact is the true one if it lies within this many standard deviations in the plane, none taken
# as smaller than a peg's size; or if its interval holds the true arc (an end is no sharper than
# this).
_SAME_SIGMA = 3.0
_FLOOR_CM = 1.0
_SURFACE_CM = 2.5  # a wall's line is no straighter than this, between points of its surface
_AHEAD_CM = 2.0  # a peg farther from a stalled tip did not stop it


def judged(
    document: RunDocument, config: RobotConfig, prior: Sequence[Obstacle] = ()
) -> RunDocument:
    """The document with its errors, and with what was missed and what is false."""
    known = document.truth.contacts if document.truth else []
    error_x, error = errors(document.contacts, known)
    missed: list[MissedContact] | None = None
    false = None
    if document.truth is not None:
        pegs = {true.peg: true for true in known}  # as touched last
        missed = [
            MissedContact(
                "truth", t.x_cm, t.y_cm, _why_missed(document, t, known, config),
                t.arc_cm, t.everted_length_cm, t.side,
            )
            for t in (pegs[peg] for peg in sorted(pegs.keys() - felt_pegs(document)))
        ]  # fmt: skip
        false = [
            FalseContact(index, contact.x_cm, contact.y_cm, _why_false(contact, known))
            for index, contact in enumerate(document.contacts)
            if not any(_same(contact, true, known) for true in known)
        ]
    if prior:
        why = "its place was swept without being felt: it is gone, or the map given is wrong"
        _, obstacles = occupancy(document, config.body.radius_cm, prior)
        gone = [obstacle for obstacle in obstacles if obstacle.source == GONE]
        missed = (missed or []) + [MissedContact("prior", o.x_cm, o.y_cm, why) for o in gone]
    return replace(document, error_x_cm=error_x, error_cm=error, missed=missed, false=false)


def true_obstruction(
    truth: Truth, obstruction: Obstruction, config: RobotConfig
) -> list[TrueContact]:
    """The true contact of a tip that stalled: what it touches, or the near face of a peg before it.

    The emulated tip is stopped just short of a peg that it meets, so its body reports no contact;
    one that is caught beside a peg touches it.
    """
    low, high = obstruction.interval_cm
    caught = [contact for contact in truth.contacts if contact.arc_cm > low - _AHEAD_CM]
    if caught:
        last = max(caught, key=lambda contact: contact.arc_cm)
        return [replace(last, everted_length_cm=obstruction.length_cm, side="")]
    faces = [
        TrueContact(p.x_cm - p.radius_cm, p.y_cm, obstruction.arc_cm, obstruction.arc_cm, n)
        for n, p in enumerate(truth.pegs)
        if abs(p.y_cm) < config.body.radius_cm + p.radius_cm
        and low - _AHEAD_CM <= p.x_cm - p.radius_cm <= high + _AHEAD_CM
    ]
    return sorted(faces, key=lambda face: abs(face.x_cm - obstruction.arc_cm))[:1]


def felt_pegs(document: RunDocument) -> set[int]:
    """Indices of the room's pegs that some sweep's peak touched and that are on the map."""
    truth = document.truth.contacts if document.truth else ()
    return {
        true.peg
        for true in truth
        if any(_same(contact, true, truth) for contact in document.contacts)
    }


def from_line(line: Sequence[tuple[float, float]], x: float, y: float) -> float:
    """Distance of a point from a line through points, cm."""
    points = np.array(line)
    if len(points) == 1:
        return float(np.hypot(points[0, 0] - x, points[0, 1] - y))
    start, way = points[:-1], np.diff(points, axis=0)
    along = ((np.array([x, y]) - start) * way).sum(axis=1)
    share = np.clip(along / np.maximum((way**2).sum(axis=1), 1e-12), 0.0, 1.0)
    away = start + share[:, None] * way - np.array([x, y])
    return float(np.hypot(away[:, 0], away[:, 1]).min())


def _same(contact: MapContact, true: TrueContact, truth: Sequence[TrueContact]) -> bool:
    covariance = np.asarray(contact.covariance_cm2) + _FLOOR_CM**2 * np.eye(2)
    apart = np.array([contact.x_cm - true.x_cm, contact.y_cm - true.y_cm])
    if (
        contact.status != POINT_ESTIMATE
        and apart @ np.linalg.solve(covariance, apart) < _SAME_SIGMA**2
    ):
        return True
    if contact.surface and from_line(contact.surface, true.x_cm, true.y_cm) < _SURFACE_CM:
        return contact.side == true.side
    low, high = contact.interval_cm
    held = low - _FLOOR_CM <= true.arc_cm <= high + _FLOOR_CM
    return held and true in true_touches(contact, truth)


def _why_missed(
    document: RunDocument, missed: TrueContact, truth: Sequence[TrueContact], config: RobotConfig
) -> str:
    sensors = [
        s for s in config.sensors if s.healthy and not (s.wrinkles and s.side == missed.side)
    ]
    first = min((s.center_cm - s.span_cm / 2 for s in sensors), default=np.inf)
    if missed.arc_cm <= first:
        return "below detection: nearer to the base than the first sensor, which it does not bend"
    near = [s for s in document.stages if of_stage(missed, s.everted_length_cm, missed.side)]
    if not near:
        return "the run ended before its stage was localized"
    stage = near[-1]
    deficit = stage.curvature_deficit_per_cm.get(missed.side)
    if deficit is not None and deficit < TRIGGER_PER_CM:
        return (
            f"moment below threshold: it held the base back by {max(deficit, 0.0):.5f} 1/cm at "
            f"most, and the trigger takes {TRIGGER_PER_CM} 1/cm"
        )
    stage_contacts = [c for c in document.contacts if of_stage(missed, c.everted_length_cm, c.side)]
    touched = [t for t in truth if of_stage(t, stage.everted_length_cm, missed.side)]
    if stage_contacts and len(stage_contacts) < len(touched):
        return "not separated from another contact of the same sweep"
    for contact in document.contacts:
        lengths = [*contact.merged, contact.everted_length_cm]
        if not any(of_stage(missed, length, contact.side) for length in lengths):
            continue
        pegs = {t.peg for t in truth for cm in lengths if of_stage(t, cm, contact.side)}
        if contact not in stage_contacts or (contact.kind == "peg" and len(pegs) > 1):
            return (
                f"felt, and taken for the {contact.kind} that other stages felt at "
                f"{contact.x_cm:.1f}, {contact.y_cm:.1f} cm"
            )
    if stage_contacts:
        return "placed elsewhere, beyond three standard deviations of its interval"
    reasons = [
        f"{t.status}: {t.message}" for t in stage.triggers if t.side == missed.side and t.message
    ]
    return reasons[-1] if reasons else "felt, and not localized at its last stage"


def _why_false(contact: MapContact, truth: Sequence[TrueContact]) -> str:
    if not contact.side and not contact.force_per_cm2:
        return "nothing stopped the tip: too little body pressure looks like an obstacle ahead"
    touched = true_touches(contact, truth)
    if not touched:
        return "nothing touched there at the sweep's peak: an error of the map or of the sensors"
    away = min(float(np.hypot(t.x_cm - contact.x_cm, t.y_cm - contact.y_cm)) for t in touched)
    return f"the nearest true contact of that sweep is {away:.1f} cm away"
