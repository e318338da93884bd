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


@dataclass(frozen=True)
class Error:
    """One kind of error: how it changes a frame, and how `localize` is told.

    Attributes:
        groups: of scenes that it is tried on.
        spoil: readings without noise and free curvature to those with the error.
        tell: keyword arguments of `localize`, from the frame; None if it cannot be told.
    """

    groups: tuple[str, ...]
    spoil: Callable[[np.random.Generator, Frame], Frame]
    tell: Callable[[Frame], dict[str, Any]] | None = None


def _white(rng: np.random.Generator, frame: Frame) -> Frame:
    noise = SIGMA * rng.standard_normal(frame.curvature.size)
    return replace(frame, curvature=frame.curvature + noise)


def _gains(size: float) -> Error:
    def spoil(rng: np.random.Generator, frame: Frame) -> Frame:
        gains = 1.0 + size * rng.standard_normal(frame.curvature.size)
        return _white(rng, replace(frame, curvature=frame.curvature * gains))

    return Error((*TOUCHED, "free", "free, bent"), spoil, lambda frame: {"gain_error": size})


def _map(size: float) -> Error:
    def spoil(rng: np.random.Generator, frame: Frame) -> Frame:
        return _white(rng, replace(frame, free=frame.free / (1.0 + size * rng.standard_normal())))

    return Error((*BENT, "free, bent"), spoil, lambda frame: {"map_error": size})


def _offset(size: float) -> Error:
    def spoil(rng: np.random.Generator, frame: Frame) -> Frame:
        return _white(rng, replace(frame, curvature=frame.curvature + size * rng.standard_normal()))

    return Error((*TOUCHED, "free", "free, bent"), spoil, lambda frame: {"offset_error": size})


def _bad(offset: float | None) -> Error:
    """One reading is off by `offset`, or says nothing but zero."""

    def spoil(rng: np.random.Generator, frame: Frame) -> Frame:
        readings = _white(rng, frame).curvature
        which = rng.integers(readings.size)
        sign = rng.choice([-1.0, 1.0])
        readings[which] = 0.0 if offset is None else readings[which] + sign * offset
        return replace(frame, curvature=readings)

    return Error((*TOUCHED, "free", "free, bent"), spoil)


def _noise(draw: Callable[[np.random.Generator, Floats], Floats]) -> Error:
    def spoil(rng: np.random.Generator, frame: Frame) -> Frame:
        return replace(frame, curvature=draw(rng, frame.curvature))

    return Error((*TOUCHED, "free", "free, bent"), spoil)


def _student(rng: np.random.Generator, clean: Floats) -> Floats:
    noise: Floats = SIGMA * rng.standard_t(4.0, clean.size) / np.sqrt(2.0)
    return clean + noise


def _twice(rng: np.random.Generator, clean: Floats) -> Floats:
    return clean + 2.0 * SIGMA * rng.standard_normal(clean.size)


def _half(rng: np.random.Generator, clean: Floats) -> Floats:
    return clean + 0.5 * SIGMA * rng.standard_normal(clean.size)


def _counted(rng: np.random.Generator, clean: Floats) -> Floats:
    counts: Floats = np.round((clean + SIGMA * rng.standard_normal(clean.size)) / STEP)
    return counts * STEP


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
    "none": Error(tuple(GROUPS)[:6], _white),
    "gains 3 %": _gains(0.03),
    "gains 5 %": _gains(0.05),
    "gains 10 %": _gains(0.1),
    "map 5 %": _map(0.05),
    "map 10 %": _map(0.1),
    "offset": _offset(OFFSET),
    "friction": Error(("friction",), _white, _tell_friction),
    "stiffness 20 %": Error(("uneven",), _white, _tell_uneven),
    "one reading 2e-3 off": _bad(2e-3),
    "one reading 8e-3 off": _bad(8e-3),
    "one reading stuck": _bad(None),
    "Student's noise": _noise(_student),
    "noise twice stated": _noise(_twice),
    "noise half stated": _noise(_half),
    "counts": _noise(_counted),
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
