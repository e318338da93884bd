"""From the model that was chosen to the answer in the caller's units."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import numpy.typing as npt

from thigmo.localization import prior
from thigmo.localization.first_look import Look
from thigmo.localization.information import place_bound
from thigmo.localization.model_choice import Options
from thigmo.localization.models import GRID, Fit, contact_curvature, precision, solve_columns
from thigmo.localization.readings import Readings
from thigmo.localization.result import Contact, LocalizeResult, Range, Status

Array = npt.NDArray[np.float64]


def contacts_of(
    readings: Readings, fit: Fit, options: Options, status: Status | None
) -> tuple[Contact, ...]:
    """Contacts in the caller's units; `status` overrides what the posterior says."""
    scale = readings.length
    out = []
    for j, (arc, force) in enumerate(zip(fit.arcs, fit.forces, strict=True)):
        low, high = fit.intervals[j]
        pieces = fit.pieces[j]
        own: Status = "localized"
        modes = _places(pieces) if len(fit.arcs) == 1 else len(pieces)
        if modes > 1 or high - low > options.width or _open(readings, fit, options):
            own = "ambiguous"
        out.append(
            Contact(
                float(arc) * scale,
                float(force) / scale**2,
                (float(low) * scale, float(high) * scale),
                status or own,
                tuple((near * scale, far * scale) for near, far, _ in pieces.tolist()),
                fit.deviation / scale**2,
                None if fit.end is None else fit.end.offset * scale,
            )
        )
    return tuple(out)


def contact_of(look: Look, options: Options, status: Status | None) -> Contact:
    """The contact of a first look that stands, in the caller's units; `status` as above."""
    scale = look.length
    own: Status = "localized"
    if (
        _places(look.pieces) > 1
        or look.high - look.low > options.width
        or not look.bound < options.width
    ):
        own = "ambiguous"
    return Contact(
        look.arc * scale,
        look.force / scale**2,
        (look.low * scale, look.high * scale),
        status or own,
        tuple([(near * scale, far * scale) for near, far, _ in look.pieces.tolist()]),
        look.deviation / scale**2,
    )


def _places(pieces: Array) -> int:
    """Modes of a single contact; the end is none of its own, if the interval reaches it."""
    if len(pieces) == 1:
        return 1
    return sum(near < 1.0 - 1.01 * prior.CORNER_WIDTH for near in pieces[:, 0].tolist())


def _open(readings: Readings, fit: Fit, options: Options) -> bool:
    """Whether only the ends of the body, not the readings, bound the place."""
    if len(fit.arcs) > 1:
        return fit.loose
    if fit.end is not None or options.within is not None:
        return False
    bound = fit.bound
    if math.isnan(bound):
        setting = fit.setting
        bound = place_bound(
            fit.arcs, fit.forces, setting.sensors, precision(fit, readings), setting.columns
        )
    return not bound < options.width


SENTENCE: dict[Status, str] = {
    "no contact": "the readings are those of the free body",
    "below detection": "a contact is not certain; average more readings or bend further",
    "localized": "one place explains the readings",
    "ambiguous": "the readings do not fix the place; see `intervals`",
}


def answer(
    readings: Readings,
    fit: Fit,
    contacts: tuple[Contact, ...],
    status: Status,
    model: str,
    message: str,
    odds: float,
    solve: partial[tuple[float, tuple[tuple[Range, ...], ...]]],
) -> LocalizeResult:
    """The result in the caller's units; `solve` finds the 1-norm optimum if it is asked for."""
    scale = readings.length
    return LocalizeResult(
        status,
        contacts,
        model,
        message,
        fit.noise / scale,
        odds,
        fit.nodes * scale,
        np.exp(fit.logp) / scale,
        tuple(int(i) for i in readings.index[fit.flagged]) if fit.flagged.any() else (),
        _parameters(readings, fit) if contacts else {},
        partial(_bend, readings, fit) if contacts else None,
        None,
        solve,
    )


def plain_answer(
    look: Look,
    contacts: tuple[Contact, ...],
    status: Status,
    message: str,
    solve: partial[tuple[float, tuple[tuple[Range, ...], ...]]],
) -> LocalizeResult:
    """As `answer`, of a first look that stands, or that finds nothing."""
    outliers: tuple[int, ...] = ()
    if look.flagged.any():
        outliers = tuple(look.chosen[: look.finite][look.flagged].tolist())
    return LocalizeResult(
        status,
        contacts,
        "plain beam" if contacts else "free body",
        message,
        look.noise / look.length,
        look.evidence - look.null,
        look.nodes[3],
        look.nodes[4],
        outliers,
        {},
        partial(_plain_bend, look) if contacts else None,
        None,
        solve,
    )


def _plain_bend(look: Look) -> Array:
    readings = look.readings()
    return _bend(readings, look.fit(readings))


def _bend(readings: Readings, fit: Fit) -> Array:
    """(K, 2) arc and contact curvature in the caller's units."""
    scale = readings.length
    return np.column_stack([GRID * scale, contact_curvature(fit, readings) / scale])


def _parameters(readings: Readings, fit: Fit) -> dict[str, float]:
    """Reported parameters of the model in the caller's units."""
    scale = readings.length
    power = {"tip_moment": 1, "fold_angle": 0}
    out = {}
    if fit.setting.labels:
        for label, unit, value in zip(
            fit.setting.labels, fit.setting.scales, solve_columns(fit, readings), strict=True
        ):
            if label:
                out[label] = float(value) * unit / scale ** power[label]
    if fit.end is not None:
        out["tangential_force"] = fit.end.tangential / scale**2
        # Its line passes beside the centreline.
        out["tip_moment"] = -fit.end.couple * fit.end.radius / scale
    if fit.stretch > 0.0:
        out["half_width"] = fit.stretch * scale
    return out
