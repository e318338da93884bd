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
from thigmo.studies.engine import Claim, Context, Outcome, Record

LENGTH = 53.0
_STEPS = 200
_KINDS = ("free", "touched gently", "swept into a peg")
_WAYS: dict[str, tuple[ModelChoice, float]] = {
    "arc": ("arc", 0.05),
    "beam": ("beam", 0.05),
    "elastica": ("elastica", 0.05),
    "auto, 1 cm": ("auto", 1.0),
    "auto, 0.2 cm": ("auto", 0.2),
    "auto, 0.05 cm": ("auto", 0.05),
}


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
    body = Rod(Tube(3.5, 0.01108), pegs, model=model, tolerance_cm=tolerance, cell_cm=cell)
    for k in range(_STEPS + 1):
        body.step(g * k / _STEPS, LENGTH)
    return body


def compare(seed: int, kind: str) -> list[tuple[float, float, str]]:
    """Every way on one scene: time of a step (us), error (cm), and the models used."""
    pegs, g = scene(kind, seed)
    arcs = np.linspace(0.0, LENGTH, 107)[1:].tolist()
    exact = follow(pegs, g, "elastica", 0.05, 0.25)
    runs = []
    for model, tolerance in _WAYS.values():
        began = perf_counter()
        body = follow(pegs, g, model, tolerance, 1.0)
        step_us = (perf_counter() - began) / _STEPS * 1e6
        off = [np.subtract(body.pose(s)[:2], exact.pose(s)[:2]) for s in arcs]
        error = float(np.hypot(*np.transpose(off)).max())
        runs.append((step_us, error, "+".join(sorted(body.counts))))
    return runs


def run(context: Context) -> Outcome:
    """Time against error of the plant's models."""
    count = context.count(5, 40)
    rows: list[Record] = []
    touched: list[float] = []
    excess: list[float] = []
    for number, kind in enumerate(_KINDS):
        seeds = [int(s) for s in context.rng(number).integers(0, 2**31, count)]
        runs = context.map(partial(compare, kind=kind), seeds, kind)
        for way, *mine in zip(_WAYS, *runs, strict=True):
            model, tolerance = _WAYS[way]
            times, errors, models = zip(*mine, strict=True)
            rows.append({
                "scene": kind, "model": way, "step_us": round(float(np.median(times)), 2),
                "median_cm": float(np.median(errors)), "worst_cm": max(errors),
                "used": "; ".join(sorted(set(models))),
            })  # fmt: skip
            if model == "auto":
                excess += [error - tolerance for _, error, used in mine if used != "arc"]
            if model == "elastica" and kind != "free":
                touched += times
    return Outcome(
        {"models": rows},
        claims=[
            Claim("error above the stated tolerance, worst scene", max(excess), 0.0, unit="cm"),
            Claim("a warm elastica step among pegs", float(np.median(touched)), 150.0, unit="us"),
        ],
    )
