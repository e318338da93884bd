"""Errors of sensors and models, one by one: what they do to readings, and how they are told.

Used by the accuracy study, which reads each group of bodies under each of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from thigmo.localization import LocalizeResult, localize
from thigmo.studies.rod import Floats, solve
from thigmo.studies.scenes import LENGTH, RADIUS, SIGMA, SPAN
from thigmo.studies.touches import BENT, FRICTION, GROUPS, SOFTNESS, TOUCHED, WAVES

OFFSET = 5e-4  # 1/cm: 2 % of the actuator map's full scale
STEP = 1.6e-3  # 1/cm: one count of the converter


@dataclass(frozen=True)
class Frame:
    """Readings (N,) of one body, and what `localize` is told with them."""

    curvature: Floats
    position: Floats
    free: float
    told: dict[str, Any]


Spoil = Callable[[np.random.Generator, Frame], Frame]


@dataclass(frozen=True)
class Error:
    """One kind of error: how it changes a frame, and how `localize` is told.

    Attributes:
        spoil: readings without noise and free curvature to those with the error.
        tell: keyword arguments of `localize`, from the frame; None if it cannot be told.
        groups: of scenes that it is tried on.
    """

    spoil: Spoil
    tell: Callable[[Frame], dict[str, Any]] | None = None
    groups: tuple[str, ...] = (*TOUCHED, "free", "free, bent")


def _noisy(rng: np.random.Generator, frame: Frame, curvature: Floats, size: float = 1.0) -> Frame:
    """The frame with these readings instead, and white noise on them."""
    noise = size * SIGMA * rng.standard_normal(curvature.size)
    return replace(frame, curvature=curvature + noise)


def _white(size: float = 1.0) -> Spoil:
    return lambda rng, frame: _noisy(rng, frame, frame.curvature, size)


def _gains(size: float) -> Error:
    def spoil(rng: np.random.Generator, frame: Frame) -> Frame:
        gains = 1.0 + size * rng.standard_normal(frame.curvature.size)
        return _noisy(rng, frame, frame.curvature * gains)

    return Error(spoil, lambda frame: {"gain_error": size})


def _map(size: float) -> Error:
    def spoil(rng: np.random.Generator, frame: Frame) -> Frame:
        free = frame.free / (1.0 + size * rng.standard_normal())
        return _noisy(rng, replace(frame, free=free), frame.curvature)

    return Error(spoil, lambda frame: {"map_error": size}, (*BENT, "free, bent"))


def _offset(rng: np.random.Generator, frame: Frame) -> Frame:
    return _noisy(rng, frame, frame.curvature + OFFSET * rng.standard_normal())


def _bad(offset: float | None) -> Error:
    """One reading is off by `offset`, or says nothing but zero."""

    def spoil(rng: np.random.Generator, frame: Frame) -> Frame:
        readings = _noisy(rng, frame, frame.curvature).curvature
        which = rng.integers(readings.size)
        sign = rng.choice([-1.0, 1.0])
        readings[which] = 0.0 if offset is None else readings[which] + sign * offset
        return replace(frame, curvature=readings)

    return Error(spoil)


def _student(rng: np.random.Generator, frame: Frame) -> Frame:
    noise = SIGMA * rng.standard_t(4.0, frame.curvature.size) / np.sqrt(2.0)
    return replace(frame, curvature=frame.curvature + noise)


def _counted(rng: np.random.Generator, frame: Frame) -> Frame:
    noisy = _noisy(rng, frame, frame.curvature).curvature
    return replace(frame, curvature=np.round(noisy / STEP) * STEP)


def _tell_friction(frame: Frame) -> dict[str, Any]:
    """A column: what friction at the contact that is found without it would add."""
    plain = ask(frame, {})
    if len(plain.contacts) != 1:
        return {}
    (contact,) = plain.contacts
    arc, force = np.array([[contact.arc]]), np.array([[contact.force]])
    along = np.sqrt(np.mean(np.square(FRICTION))) * np.abs(force)
    loads = {"tangential": along, "couple": np.sign(force) * RADIUS * along}
    smooth, rough = (
        solve(arc, force, length=LENGTH, free_curvature=frame.free, **some).readings(
            frame.position, SPAN
        )
        for some in ({}, loads)
    )
    return {"shared_errors": (rough - smooth).T}


def _tell_uneven(frame: Frame) -> dict[str, Any]:
    """Columns: the bend under each sensor, times the shapes of the softness along the body."""
    phase = WAVES * frame.position
    shapes = SOFTNESS / np.sqrt(len(WAVES)) * np.concatenate([np.cos(phase), np.sin(phase)])
    return {"shared_errors": (shapes * (frame.curvature - frame.free)).T}


ERRORS: dict[str, Error] = {
    "none": Error(_white(), groups=tuple(GROUPS)[:6]),
    **{f"gains {percent} %": _gains(percent / 100) for percent in (3, 5, 10)},
    **{f"map {percent} %": _map(percent / 100) for percent in (5, 10)},
    "offset": Error(_offset, lambda frame: {"offset_error": OFFSET}),
    "friction": Error(_white(), _tell_friction, ("friction",)),
    "stiffness 20 %": Error(_white(), _tell_uneven, ("uneven",)),
    "one reading 2e-3 off": _bad(2e-3),
    "one reading 8e-3 off": _bad(8e-3),
    "one reading stuck": _bad(None),
    "Student's noise": Error(_student),
    "noise twice stated": Error(_white(2.0)),
    "noise half stated": Error(_white(0.5)),
    "counts": Error(_counted),
}
BAD = ("one reading 2e-3 off", "one reading 8e-3 off", "one reading stuck")
OTHER_NOISE = ("Student's noise", "noise twice stated", "noise half stated", "counts")


def ask(frame: Frame, told: dict[str, Any]) -> LocalizeResult:
    """What `localize` answers, told so much beside what it is always told."""
    return localize(
        frame.curvature,
        frame.position,
        length=LENGTH,
        span=SPAN,
        free_curvature=frame.free,
        noise=SIGMA,
        tube_radius=RADIUS,
        **frame.told,
        **told,
    )
