"""Whether `localize` knows what it knows: coverage, false contacts, efficiency, separation.

Four studies in one: (1) 95 % intervals over random scenes of the stated prior; (2) empty and
one-contact scenes, for false contacts; (3) cells of force x place against the Cramer-Rao bound,
with clean, Laplace and outlier noise; (4) two opposed contacts over separations and sensor
layouts. Truth is the large-deflection rod.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thigmo.bench.scenes import BOTH, COLUMN, LENGTH, SIGMA, SPAN
from thigmo.bench.study import Cell, Claim, Context, Outcome, Table
from thigmo.bench.truth import readings
from thigmo.localization import identifiability, localize, prior

Floats = NDArray[np.float64]

NOISES = ("gaussian", "laplace", "wide laplace", "outliers")
PLACES = (15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0, 50.0, 53.0)
MOMENTS = (0.003, 0.005, 0.008, 0.011)
LAYOUTS = (1.0, 2.75, 5.0, 7.25)
GAPS = (39.0, 34.0, 29.0, 23.5, 18.5, 13.0)
PAIRS = ((-0.016, 0.02), (-0.02, 0.03), (-0.03, 0.04))


def draw_noise(rng: np.random.Generator, kind: str, size: int) -> Floats:
    """Noise of one frame: Gaussian; Laplace; or Gaussian with 5 % gross outliers.

    "laplace" has the standard deviation that `localize` is told, "wide laplace" 1.41 times it
    (its scale parameter is the deviation).
    """
    if kind in ("laplace", "wide laplace"):
        wide = 1.0 if kind == "wide laplace" else np.sqrt(0.5)
        return np.asarray(wide * SIGMA * rng.laplace(size=size))
    out = SIGMA * rng.standard_normal(size)
    if kind == "outliers":
        bad = rng.random(size) < 0.05
        sizes = rng.uniform(6.0, 20.0, bad.sum()) * rng.choice([-1.0, 1.0], bad.sum())
        out[bad] += SIGMA * sizes
    return np.asarray(out)


def _felt(arcs: Floats, forces: Floats, position: Floats) -> Floats:
    return readings(arcs, forces, position, length=LENGTH, span=SPAN)


@dataclass(frozen=True)
class Trial:
    """One scene's answer against its truth."""

    reported: bool
    localized: bool
    covered: bool
    error: float


def prior_scene(task: tuple[int, int]) -> Trial:
    """A scene of the stated prior: arc uniform, base moment from the mixture, either sign."""
    rng = np.random.default_rng(task)
    arc = float(rng.uniform(0.0, LENGTH))
    mean, spread, log_weight = prior.BASE_MOMENT
    part = rng.choice(len(spread), p=np.exp(log_weight))
    moment = float(rng.normal(mean[part], spread[part])) / LENGTH
    clean = _felt(np.array([arc]), np.array([moment / max(arc, 0.5)]), BOTH)
    result = localize(
        clean + draw_noise(rng, "gaussian", 10), BOTH, length=LENGTH, span=SPAN, noise=SIGMA
    )
    if not result.contacts:
        return Trial(False, False, False, float("inf"))
    inside = [c.interval[0] - 1e-9 <= arc <= c.interval[1] + 1e-9 for c in result.contacts]
    error = min(abs(c.arc - arc) for c in result.contacts)
    return Trial(True, result.status == "localized", any(inside), error)


def empty_scene(task: tuple[int, int, int, bool]) -> int:
    """Contacts found in pure noise by a column of sensors (`known` noise or not)."""
    seed, index, sensors, known = task
    rng = np.random.default_rng([seed, index, sensors])
    position = BOTH if sensors == 10 else COLUMN[:sensors]
    result = localize(
        draw_noise(rng, "gaussian", sensors),
        position,
        length=LENGTH,
        span=SPAN,
        noise=SIGMA if known else None,
    )
    return len(result.contacts)


def single_scene(task: tuple[int, int, bool]) -> int:
    """Contacts found where there is one."""
    seed, index, known = task
    rng = np.random.default_rng([seed, index])
    arc = float(rng.uniform(15.0, LENGTH))
    force = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.003, 0.011)) / arc
    clean = _felt(np.array([arc]), np.array([force]), BOTH)
    noise = draw_noise(rng, "gaussian", 10)
    result = localize(clean + noise, BOTH, length=LENGTH, span=SPAN, noise=SIGMA if known else None)
    return len(result.contacts)


def cell(task: tuple[int, float, float, str, int]) -> tuple[float, float]:
    """RMSE (cm) and coverage in one cell of place, moment and noise."""
    seed, arc, moment, kind, count = task
    rng = np.random.default_rng([seed, int(arc * 10), int(moment * 1e4), NOISES.index(kind)])
    clean = _felt(np.array([arc]), np.array([moment / arc]), BOTH)
    errors = np.empty(count)
    covered = 0
    for i in range(count):
        result = localize(
            clean + draw_noise(rng, kind, 10),
            BOTH,
            length=LENGTH,
            span=SPAN,
            noise=SIGMA,
            contacts=1,
        )
        contact = result.contacts[0]
        errors[i] = contact.arc - arc
        covered += contact.interval[0] - 1e-9 <= arc <= contact.interval[1] + 1e-9
    return float(np.sqrt(np.mean(errors**2))), covered / count


def pair(task: tuple[int, float, float, int, int]) -> tuple[float, float, float, float, float]:
    """Two opposed contacts: shares found, localized, ambiguous, confidently wrong; RMSE (cm)."""
    seed, base, gap, which, count = task
    rng = np.random.default_rng([seed, int(base * 100), int(gap * 10), which])
    position = np.tile(base + 10.0 * np.arange(5), 2)
    truth = np.array([LENGTH - gap, LENGTH])
    clean = _felt(truth, np.array(PAIRS[which]) / truth, position)
    found = localized = ambiguous = wrong = 0
    squares = []
    for _ in range(count):
        result = localize(
            clean + draw_noise(rng, "gaussian", 10),
            position,
            length=LENGTH,
            span=SPAN,
            noise=SIGMA,
        )
        localized += result.status == "localized"
        ambiguous += result.status == "ambiguous"
        if len(result.contacts) == 2:
            found += 1
            ends = [contact.interval for contact in result.contacts]
            miss = any(
                not low - 1e-6 <= t <= high + 1e-6
                for (low, high), t in zip(ends, truth, strict=True)
            )
            squares += [(c.arc - t) ** 2 for c, t in zip(result.contacts, truth, strict=True)]
            wrong += miss and result.status == "localized"
        else:
            wrong += result.status == "localized"
    error = float(np.sqrt(np.mean(squares))) if squares else float("nan")
    return found / count, localized / count, ambiguous / count, wrong / count, error


def mode_switch(arc: float, bound: float) -> bool:
    """Whether a cell lies within two bounds of the tip or of where a second sensor sets in."""
    return LENGTH - arc < 2 * bound or arc - (COLUMN[1] + SPAN / 2) < 2 * bound


def coverage(context: Context) -> Outcome:
    """Coverage of intervals and statuses over the stated prior."""
    scenes = context.count(400, 10_000)
    trials = context.map(prior_scene, [(context.seed, i) for i in range(scenes)])
    told = [t for t in trials if t.reported]
    sure = [t for t in told if t.localized]
    pooled = float(np.mean([t.covered for t in told]))
    rows: list[tuple[Cell, ...]] = [
        ("reported", len(told), pooled, float(np.median([t.error for t in told]))),
        (
            "localized",
            len(sure),
            float(np.mean([t.covered for t in sure])),
            float(np.median([t.error for t in sure])),
        ),
    ]
    table = Table("coverage", ("answers", "count", "coverage", "median_error_cm"), rows)
    wrong = float(np.mean([not t.covered for t in sure]))
    return Outcome(
        [table],
        {},
        [
            Claim("95 % intervals cover, at least", pooled, 0.93, at_most=False),
            Claim("95 % intervals cover, at most", pooled, 0.97),
            Claim("localized, and wrong", wrong, 0.07),
        ],
    )


def false_alarms(context: Context) -> Outcome:
    """False contacts in empty scenes, false second ones in scenes with one."""
    scenes = context.count(300, 3000)
    rows: list[tuple[Cell, ...]] = []
    claims = []
    for known in (True, False):
        label = "known" if known else "unknown"
        for sensors in (2, 3, 5, 10):
            count = scenes if known else max(scenes // 5, 100)
            found = context.map(
                empty_scene, [(context.seed, i, sensors, known) for i in range(count)]
            )
            rate = float(np.mean(np.array(found) > 0))
            rows.append(("empty", label, sensors, count, rate))
            claims.append(Claim(f"false contacts, {sensors} readings, {label} noise", rate, 0.01))
        count = scenes if known else max(scenes // 10, 60)
        numbers = np.array(
            context.map(single_scene, [(context.seed, i, known) for i in range(count)])
        )
        rate = float(np.mean(numbers > 1))
        rows.append(("one contact", label, 10, count, rate))
        claims.append(Claim(f"false second contacts, {label} noise", rate, 0.05))
    columns = ("scene", "noise", "readings", "count", "false_rate")
    return Outcome([Table("false-alarms", columns, rows)], {}, claims)


def efficiency(context: Context) -> Outcome:
    """RMSE of each cell over its bound, for three kinds of noise."""
    count = context.count(60, 1000)
    bounds = identifiability(
        BOTH, length=LENGTH, span=SPAN, noise=SIGMA, arcs=PLACES, moments=MOMENTS
    ).bound
    cells = [
        (kind, m, a) for kind in NOISES for m in range(len(MOMENTS)) for a in range(len(PLACES))
    ]
    got = context.map(
        cell, [(context.seed, PLACES[a], MOMENTS[m], kind, count) for kind, m, a in cells]
    )
    rows: list[tuple[Cell, ...]] = []
    pooled: dict[str, list[tuple[float, float]]] = {kind: [] for kind in NOISES}
    worst_inside, least_cover = 0.0, 1.0
    for (kind, m, a), (rmse, cover) in zip(cells, got, strict=True):
        bound = float(bounds[m, a])
        edge = not bound < 2.0 or mode_switch(PLACES[a], bound)
        ratio = rmse / bound
        rows.append((kind, PLACES[a], MOMENTS[m], bound, rmse, ratio, cover, edge))
        if bound < 2.0:
            pooled[kind].append((rmse, bound))
        if kind == "gaussian":
            if not edge:
                worst_inside = max(worst_inside, ratio)
            if bound < 2.0:
                least_cover = min(least_cover, cover)
    total = {
        kind: float(np.sqrt(np.sum(np.square(pairs), axis=0)[0] / len(pairs)))
        for kind, pairs in pooled.items()
    }
    clean_bound = float(np.sqrt(np.mean(np.square([b for _, b in pooled["gaussian"]]))))
    columns = ("noise", "arc_cm", "moment", "bound_cm", "rmse_cm", "ratio", "coverage", "edge")
    return Outcome(
        [Table("efficiency", columns, rows)],
        {},
        [
            Claim("RMSE over bound, pooled", total["gaussian"] / clean_bound, 1.2),
            Claim("RMSE over bound, worst interior cell", worst_inside, 1.35),
            Claim("Laplace over clean", total["laplace"] / total["gaussian"], 1.5),
            Claim(
                "Laplace of 1.41 deviations over clean",
                total["wide laplace"] / total["gaussian"],
                1.5,
            ),
            Claim("outliers over clean", total["outliers"] / total["gaussian"], 1.5),
            Claim("least coverage of an identifiable cell", least_cover, 0.9, at_most=False),
        ],
    )


def separation(context: Context) -> Outcome:
    """Two opposed contacts over gap, force and layout."""
    count = context.count(10, 200)
    tasks = [
        (context.seed, base, gap, which, count)
        for base in LAYOUTS
        for gap in GAPS
        for which in range(len(PAIRS))
    ]
    got = context.map(pair, tasks)
    rows: list[tuple[Cell, ...]] = []
    at_limit, singular = [], []
    for (_, base, gap, which, _), shares in zip(tasks, got, strict=True):
        position = np.tile(base + 10.0 * np.arange(5), 2)
        bound = _pair_bound(position, gap, PAIRS[which])
        rows.append((base, gap, PAIRS[which][0], PAIRS[which][1], bound, *shares))
        if gap == 18.5 and bound < 2.5:
            at_limit.append(shares[0])
        if gap == 13.0 and base == 5.0:
            singular.append(shares[2])
    columns = (
        "first_centre_cm",
        "gap_cm",
        "proximal_moment",
        "distal_moment",
        "bound_cm",
        "two_found",
        "localized",
        "ambiguous",
        "confidently_wrong",
        "rmse_cm",
    )
    return Outcome(
        [Table("separation", columns, rows)],
        {},
        [
            Claim("told apart at 18.5 cm, least share", min(at_limit), 0.9, at_most=False),
            Claim("13 cm answered ambiguous, least share", min(singular), 0.95, at_most=False),
        ],
    )


def _pair_bound(position: Floats, gap: float, moments: tuple[float, float]) -> float:
    """The larger Cramer-Rao bound (cm) of two contacts, small deflection."""
    truth = np.array([LENGTH - gap, LENGTH])
    step = 1e-3

    def model(arcs: Floats) -> Floats:
        low = position[:, None] - SPAN / 2
        reach = np.clip(arcs - low, 0.0, None)
        inside = reach**2 / (2 * SPAN)
        return np.where(reach >= SPAN, arcs - position[:, None], inside)

    slope = (model(truth) - model(truth - step)) / step
    jacobian = np.hstack([model(truth), slope * (np.array(moments) / truth)])
    jacobian /= np.maximum(np.linalg.norm(jacobian, axis=0), 1e-12)
    scale = np.linalg.norm(slope * (np.array(moments) / truth), axis=0)
    information = jacobian.T @ jacobian / SIGMA**2
    if np.linalg.cond(information) > 1e12:
        return float("inf")
    return float(np.max(np.sqrt(np.diag(np.linalg.inv(information))[2:]) / scale))


def run(context: Context) -> Outcome:
    """All four, as `thigmo bench` runs them."""
    out = Outcome()
    for part in (coverage, false_alarms, efficiency, separation):
        one = part(context)
        out.tables += one.tables
        out.claims += one.claims
    return out
