"""Models of the body by need: what each costs and how wrong it is, on the same scenes.

Random scenes of three kinds (free, gently touched, swept into a peg) are followed step by step by
`arc`, `beam`, `elastica` and the automatic choice at several tolerances. Error is the largest
distance, along the body at the end, from an elastica with a four times finer mesh.
"""

from __future__ import annotations

from functools import partial
from time import perf_counter

import numpy as np

from thigmo.mechanics import ModelChoice, Peg, Rod, Tube
from thigmo.studies import charts
from thigmo.studies.engine import Claim, Context, Outcome, Record

LENGTH = 53.0
_STEPS = 200
_KINDS = ("free", "touched gently", "swept into a peg")
_WAYS: tuple[tuple[str, ModelChoice, float], ...] = (
    ("arc", "arc", 0.05),
    ("beam", "beam", 0.05),
    ("elastica", "elastica", 0.05),
    ("auto, 1 cm", "auto", 1.0),
    ("auto, 0.2 cm", "auto", 0.2),
    ("auto, 0.05 cm", "auto", 0.05),
)


def scene(kind: str, seed: int) -> tuple[list[Peg], float]:
    """Pegs and the free curvature at the end of the sweep."""
    rng = np.random.default_rng(seed)
    if kind == "free":
        return [], float(rng.uniform(-0.04, 0.04))
    g = float(rng.uniform(0.001, 0.004) if kind == "touched gently" else rng.uniform(0.015, 0.035))
    x = float(rng.uniform(15.0, 45.0))
    # Where the free body would be at a third to two thirds of the sweep.
    reach = 0.5 * g * float(rng.uniform(0.3, 0.7)) * x**2
    return [Peg(x, 1.75 + 0.6 + max(reach, 0.05), 0.6)], g


def follow(pegs: list[Peg], g: float, model: ModelChoice, tolerance: float, cell: float) -> Rod:
    """Sweep from straight to g in equal steps."""
    tube = Tube(3.5, 0.01108)
    body = Rod(tube, pegs, model=model, tolerance_cm=tolerance, cell_cm=cell)
    body.step(0.0, LENGTH)
    for k in range(1, _STEPS + 1):
        body.step(g * k / _STEPS, LENGTH)
    return body


def compare(seed: int, kind: str) -> list[tuple[str, float, float, str]]:
    """Every way on one scene: time of a step (us), error (cm), and the models used."""
    pegs, g = scene(kind, seed)
    exact = follow(pegs, g, "elastica", 0.05, 0.25)
    arcs = np.linspace(0.0, LENGTH, 107)[1:]
    truth = np.array([exact.pose(float(s))[:2] for s in arcs])
    runs = []
    for way, model, tolerance in _WAYS:
        began = perf_counter()
        body = follow(pegs, g, model, tolerance, 1.0)
        step_us = (perf_counter() - began) / _STEPS * 1e6
        found = np.array([body.pose(float(s))[:2] for s in arcs])
        error = float(np.hypot(*(found - truth).T).max())
        runs.append((way, step_us, error, "+".join(sorted(body.counts))))
    return runs


def run(context: Context) -> Outcome:
    """Time against error of the plant's models."""
    count = context.count(5, 40)
    figure, (axis,) = charts.panels(size=(7, 5), title="Models of the body, on the same scenes")
    rows: list[Record] = []
    points: dict[str, list[tuple[float, float]]] = {way: [] for way, _, _ in _WAYS}
    touched: list[float] = []
    excess: list[float] = []
    for number, kind in enumerate(_KINDS):
        seeds = [int(s) for s in context.rng(number).integers(0, 2**31, count)]
        runs = context.map(partial(compare, kind=kind), seeds, kind)
        for way, model, tolerance in _WAYS:
            mine = [found for some in runs for found in some if found[0] == way]
            _, times, errors, models = zip(*mine, strict=True)
            rows.append({
                "scene": kind, "model": way, "step_us": round(float(np.median(times)), 2),
                "median_cm": float(np.median(errors)), "worst_cm": max(errors),
                "used": "; ".join(sorted(set(models))),
            })  # fmt: skip
            points[way] += [(time, max(error, 1e-8)) for _, time, error, _ in mine]
            if model == "auto":
                excess += [error - tolerance for _, _, error, used in mine if used != "arc"]
            if model == "elastica" and kind != "free":
                touched += times
    for (way, at), marker in zip(points.items(), "os^Dvx", strict=True):
        axis.loglog(*np.array(at).T, marker, alpha=0.5, label=way)
    axis.set(xlabel="time of a step (us)", ylabel="largest error of position (cm)")
    axis.legend()
    return Outcome(
        {"models": rows},
        {"time-error": figure},
        [
            Claim("error above the stated tolerance, worst scene", max(excess), 0.0, unit="cm"),
            Claim("a warm elastica step among pegs", float(np.median(touched)), 150.0, unit="us"),
        ],
    )
