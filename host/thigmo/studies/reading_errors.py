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
from thigmo.studies.touches import BENT, FRICTION, GROUPS, SOFTNESS, TOUCHED, WAVES, rubbing

OFFSET = 5e-4  # 1/cm: 2 % of the actuator map's full scale
STEP = 1.6e-3  # 1/cm: one count of the converter


@dataclass(frozen=True)
class Frame:
    """Readings (N,) of one body, and what `localize` is told with them."""

    curvature: Floats
    position: Floats
    free: float
    told: dict[str, Any]


def _noise(rng: np.random.Generator, size: int) -> Floats:
    return SIGMA * rng.standard_normal(size)


@dataclass(frozen=True)
class Error:
    """One kind of error: how it changes a frame, and how `localize` is told."""

    # keyword arguments of `localize`, from the frame; None if it cannot be told
    tell: Callable[[Frame], dict[str, Any]] | None = None
    # what it does to a frame without noise
    clean: Callable[[np.random.Generator, Frame], Frame] = lambda rng, frame: frame
    noise: Callable[[np.random.Generator, int], Floats] = _noise  # on so many readings
    # what it does to readings with noise
    read: Callable[[np.random.Generator, Floats], Floats] = lambda rng, readings: readings
    groups: tuple[str, ...] = (*TOUCHED, "free", "free, bent")  # of scenes that it is tried on

    def spoil(self, rng: np.random.Generator, frame: Frame) -> Frame:
        """A frame without noise as it is read."""
        frame = self.clean(rng, frame)
        noisy = frame.curvature + self.noise(rng, frame.curvature.size)
        return replace(frame, curvature=self.read(rng, noisy))


def _gains(size: float) -> Error:
    def clean(rng: np.random.Generator, frame: Frame) -> Frame:
        gains = 1.0 + size * rng.standard_normal(frame.curvature.size)
        return replace(frame, curvature=frame.curvature * gains)

    return Error(lambda frame: {"gain_error": size}, clean)


def _map(size: float) -> Error:
    def clean(rng: np.random.Generator, frame: Frame) -> Frame:
        return replace(frame, free=frame.free / (1.0 + size * rng.standard_normal()))

    return Error(lambda frame: {"map_error": size}, clean, groups=(*BENT, "free, bent"))


def _offset(rng: np.random.Generator, frame: Frame) -> Frame:
    return replace(frame, curvature=frame.curvature + OFFSET * rng.standard_normal())


def _bad(offset: float | None) -> Error:
    """One reading is off by `offset`, or says nothing but zero."""

    def read(rng: np.random.Generator, readings: Floats) -> Floats:
        which = rng.integers(readings.size)
        sign = rng.choice([-1.0, 1.0])
        readings[which] = 0.0 if offset is None else readings[which] + sign * offset
        return readings

    return Error(read=read)


def _tell_friction(frame: Frame) -> dict[str, Any]:
    """A column: what friction at the contact that is found without it would add."""
    plain = ask(frame, {})
    if len(plain.contacts) != 1:
        return {}
    (contact,) = plain.contacts
    arc, force = np.array([[contact.arc]]), np.array([[contact.force]])
    smooth, rough = (
        solve(arc, force, length=LENGTH, free_curvature=frame.free, **rubbing(force, friction))
        .readings(frame.position, SPAN)
        for friction in (0.0, np.sqrt(np.mean(np.square(FRICTION))))
    )  # fmt: skip
    return {"shared_errors": (rough - smooth).T}


def _tell_uneven(frame: Frame) -> dict[str, Any]:
    """Columns: the bend under each sensor, times the shapes of the softness along the body."""
    phase = WAVES * frame.position
    shapes = SOFTNESS / np.sqrt(len(WAVES)) * np.concatenate([np.cos(phase), np.sin(phase)])
    return {"shared_errors": (shapes * (frame.curvature - frame.free)).T}


ERRORS: dict[str, Error] = {
    "none": Error(groups=tuple(GROUPS)[:6]),
    **{f"gains {percent} %": _gains(percent / 100) for percent in (3, 5, 10)},
    **{f"map {percent} %": _map(percent / 100) for percent in (5, 10)},
    "offset": Error(lambda frame: {"offset_error": OFFSET}, _offset),
    "friction": Error(_tell_friction, groups=("friction",)),
    "stiffness 20 %": Error(_tell_uneven, groups=("uneven",)),
    "one reading 2e-3 off": _bad(2e-3),
    "one reading 8e-3 off": _bad(8e-3),
    "one reading stuck": _bad(None),
    "Student's noise": Error(noise=lambda rng, n: SIGMA * rng.standard_t(4.0, n) / np.sqrt(2.0)),
    "noise twice stated": Error(noise=lambda rng, n: 2.0 * _noise(rng, n)),
    "noise half stated": Error(noise=lambda rng, n: 0.5 * _noise(rng, n)),
    "counts": Error(read=lambda rng, readings: np.round(readings / STEP) * STEP),
}
BAD = ("one reading 2e-3 off", "one reading 8e-3 off", "one reading stuck")
OTHER_NOISE = ("Student's noise", "noise twice stated", "noise half stated", "counts")


def ask(frame: Frame, told: dict[str, Any]) -> LocalizeResult:
    """What `localize` answers, told so much beside what it is always told."""
    return localize(
        frame.curvature, frame.position, length=LENGTH, span=SPAN, free_curvature=frame.free,
        noise=SIGMA, tube_radius=RADIUS, **frame.told, **told,
    )  # fmt: skip
