"""The sensitivity study: noise x sensors x norm, for the thesis's solver and for exact ones.

The thesis needs five readings with the 1-norm and two or three with the 2-norm without noise
(chapter 4). The question is whether the norm or the solver sets that limit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from thigmo.bench.study import Claim
from thigmo.experiments import thesis
from thigmo.localization import localize
from thigmo.localization.baselines import BASELINES, Problem
from thigmo.mechanics import Tube, push

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NOISES = (0.0, 1e-4, 3e-4, 6e-4, 1.2e-3)
SENSORS = (2, 3, 4, 5, 6, 8, 10)
METHODS = {
    "thesis's solver (1-norm)": "alternating",
    "exact 1-norm": "l1",
    "exact 2-norm": "l2",
    "posterior (default)": "exact",
}
_FAILURE_CM = 5.0


@dataclass(frozen=True)
class Cell:
    """One cell of the study: mean error (cm) and share of errors above 5 cm."""

    method: str
    noise: float
    sensors: int
    mean_cm: float
    failures: float


def _answer(method: str, y: np.ndarray, x: np.ndarray, noise: float) -> float:
    if method in BASELINES:
        spans = np.full(x.size, thesis.SPAN_CM)
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


def cells(trials: int, seed: int) -> list[Cell]:
    """Run the study: contacts between 60 % of the length and the tip, 0.7 of the fold's moment.

    Sensors are spread evenly from 5 to 45 cm, one at a place, so that two of them already span the
    body.
    """
    found = []
    for noise in NOISES:
        for sensors in SENSORS:
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

    names = list(METHODS)
    return [
        Claim(
            "without noise, 2 sensors: exact 1-norm, mean error", at(names[1], 2), 1.0, unit="cm"
        ),
        Claim(
            "without noise, 3 sensors: exact 1-norm, mean error", at(names[1], 3), 1.0, unit="cm"
        ),
        Claim(
            "without noise, 2 sensors: exact 2-norm, mean error", at(names[2], 2), 1.0, unit="cm"
        ),
        Claim(
            "without noise, 2 sensors: default method, mean error", at(names[3], 2), 1.0, unit="cm"
        ),
    ]


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
