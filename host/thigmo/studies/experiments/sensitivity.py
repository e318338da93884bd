"""The sensitivity study: noise x sensors x norm, for the thesis's solver and for exact ones.

The thesis needs five readings with the 1-norm and two or three with the 2-norm without noise
(chapter 4). The question is whether the norm or the solver sets that limit. Its alternation is run
with both norms: it leaves a start at the tip only along a smooth objective, and so many kinks as
few sensors have stop it. The exact minimum of the 1-norm has no such limit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from thigmo.compiled import compiled
from thigmo.localization import localize
from thigmo.mechanics import Tube, push
from thigmo.studies.baselines import BASELINES, Problem
from thigmo.studies.engine import Claim, Context
from thigmo.studies.experiments import thesis

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

NOISES = (0.0, 1e-4, 3e-4, 6e-4, 1.2e-3)
SENSORS = (2, 3, 4, 5, 6, 8, 10)
METHODS = {
    "thesis's solver (1-norm)": "alternating",
    "thesis's solver (2-norm)": "alternating 2-norm",
    "exact 1-norm": "l1",
    "exact 2-norm": "l2",
    "posterior (default)": "exact",
}
_FAILURE_CM = 5.0
# The thesis "is able to perform minimization" from so many sensors on: here, a mean error below.
_WORKS_CM = 2.0


@dataclass(frozen=True)
class Cell:
    """One cell of the study: mean error (cm) and share of errors above 5 cm."""

    method: str
    noise: float
    sensors: int
    mean_cm: float
    failures: float


@compiled
def _smooth_value(
    y: Floats, x: Floats, arc: float, force: float, length: float, mu: float
) -> float:
    """2-norm of readings minus the beam, with the walls of [0, length]."""
    if arc <= 0.0 or arc >= length:
        return np.inf
    total = 0.0
    for i in range(y.size):
        total += (y[i] - force * max(arc - x[i], 0.0)) ** 2
    return float(np.sqrt(total) - mu * (np.log(arc) + np.log(length - arc)))


@compiled
def alternating_two_norm(y: Floats, x: Floats, length: float) -> float:
    """The thesis's alternation (`baselines.alternating`), but with the 2-norm; the arc.

    Args:
        y: (N,) readings, 1/mm.
        x: (N,) sensor centres, mm.
        length: mm.
    """
    arc = length
    for _ in range(100):
        along, square = 0.0, 0.0
        for i in range(y.size):
            reach = max(arc - x[i], 0.0)
            along += y[i] * reach
            square += reach * reach
        force = along / square if square > 0.0 else 0.0
        before = arc
        arc = min(max(arc, 1e-6 * length), (1.0 - 1e-6) * length)
        mu = 0.1
        for _level in range(12):
            here = _smooth_value(y, x, arc, force, length, mu)
            step = 0.02 * length
            while step > 1e-6 * length:
                up = _smooth_value(y, x, arc + step, force, length, mu)
                down = _smooth_value(y, x, arc - step, force, length, mu)
                if min(up, down) < here:
                    arc += step if up < down else -step
                    here = min(up, down)
                else:
                    step *= 0.5
            mu *= 0.2
        if abs(arc - before) <= 5.0:
            break
    return arc


def _answer(method: str, y: Floats, x: Floats, noise: float) -> float:
    if method == "alternating 2-norm":
        return float(alternating_two_norm(y / 10, x * 10, thesis.LENGTH_CM * 10)) / 10
    if method in BASELINES:
        spans = np.zeros(x.size)
        arcs, _ = BASELINES[method](Problem(y, x, spans, thesis.LENGTH_CM))
        return float(arcs[0])
    result = localize(
        y,
        x,
        length=thesis.LENGTH_CM,
        span=thesis.SPAN_CM,
        noise=max(noise, 1e-5),
        contacts=1,
        method=method,
    )
    return float(result.contacts[0].arc) if result.contacts else float("nan")


def cells(trials: int, context: Context) -> list[Cell]:
    """Run the study: contacts between 60 % of the length and the tip, 0.7 of the fold's moment.

    Sensors are spread evenly from 5 to 45 cm, one at a place, so that two of them already span the
    body.
    """
    items = [(noise, count, trials, context.seed) for noise in NOISES for count in SENSORS]
    return [cell for found in context.map(_methods, items, "noise and sensors") for cell in found]


def _methods(item: tuple[float, int, int, int]) -> list[Cell]:
    """All methods at one noise with so many sensors, over trials from a seed."""
    noise, sensors, trials, seed = item
    where = np.linspace(5.0, 45.0, sensors)
    errors: dict[str, list[float]] = {name: [] for name in METHODS}
    rng = np.random.default_rng([seed, sensors])
    for _ in range(trials):
        # Two sensors must both lie before the contact, or nobody can place it.
        arc = float(rng.uniform(max(0.6 * thesis.LENGTH_CM, 0.0), thesis.LENGTH_CM))
        at = where * min(1.0, (arc - 4.0) / 45.0) if sensors < 4 else where
        force = 0.7 * thesis.CRITICAL / arc * float(rng.choice([-1.0, 1.0]))
        body = push(
            force,
            arc,
            free_curvature=0.0,
            length=thesis.LENGTH_CM,
            tube=Tube(thesis.DIAMETER_CM),
        )
        clean = body.averages(at, thesis.SPAN_CM)
        y = clean + noise * rng.standard_normal(sensors)
        for name, method in METHODS.items():
            errors[name].append(abs(_answer(method, y, at, noise) - arc))
    found = []
    for name, values in errors.items():
        array = np.array(values)
        answered = array[np.isfinite(array)]
        mean = float(answered.mean()) if answered.size else float("nan")
        failures = float(np.mean(~(array <= _FAILURE_CM)))
        found.append(Cell(name, noise, sensors, mean, failures))
    return found


def claims(found: list[Cell]) -> list[Claim]:
    """What the study shows: the limit is the solver's, not the norm's."""

    def at(name: str, sensors: int) -> float:
        return next(
            c.mean_cm for c in found if (c.method, c.noise, c.sensors) == (name, 0.0, sensors)
        )

    return [
        Claim(
            f"without noise, {sensors} sensors: {text}, mean error",
            at(name, sensors),
            1.0,
            unit="cm",
        )
        for text, name, sensors in (
            ("exact 1-norm", "exact 1-norm", 2),
            ("exact 1-norm", "exact 1-norm", 3),
            ("exact 2-norm", "exact 2-norm", 2),
            ("default method", "posterior (default)", 2),
        )
    ]


def remarks(found: list[Cell]) -> list[str]:
    """From how many sensors on each method works without noise, and its errors below that."""
    told = []
    for name in METHODS:
        quiet = [c for c in found if c.method == name and c.noise == 0.0]
        bad = [c.sensors for c in quiet if not c.mean_cm <= _WORKS_CM]
        works = [n for n in SENSORS if n > max(bad, default=0)]
        start = f"from {works[0]} sensors on" if works else f"with no number up to {SENSORS[-1]}"
        errors = ", ".join(f"{c.mean_cm:.2g} ({c.sensors})" for c in quiet)
        told.append(
            f"{name}, without noise: mean error below {_WORKS_CM:g} cm {start}; "
            f"cm (sensors): {errors}"
        )
    return told


def figure(found: list[Cell]) -> Figure:
    """Mean error over the number of sensors, a panel a noise."""
    from matplotlib.figure import Figure

    picture = Figure(figsize=(3.2 * len(NOISES), 3.8), layout="constrained")
    for axis, noise in zip(picture.subplots(1, len(NOISES), sharey=True), NOISES, strict=True):
        for name in METHODS:
            some = [c for c in found if c.method == name and c.noise == noise]
            axis.plot(
                [c.sensors for c in some],
                [max(c.mean_cm, 1e-3) for c in some],
                marker="o",
                markersize=4,
                label=name,
            )
        axis.set(yscale="log", xlabel="number of sensors", title=f"noise {noise:g} 1/cm")
        axis.axvline(5, color="gray", linestyle=":", linewidth=1)
        axis.grid(which="both", alpha=0.2)
    picture.axes[0].set_ylabel("mean error of the arc (cm)")
    picture.axes[0].legend(fontsize=7)
    picture.suptitle("Sensitivity to noise, sensors and norm (dotted: the thesis's limit of five)")
    return picture
